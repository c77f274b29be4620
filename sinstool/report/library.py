"""The script that draws figures: packed into a page, or a file that many pages share.

plotly.js (bundle ``basic``, MIT licence) comes with the package; ``assets/README.md`` says from
where. A page by itself carries it compressed, which makes a page of 5 MB one of half a megabyte.
"""

from __future__ import annotations

import gzip
import hashlib
from importlib.resources import files
from pathlib import Path

from sinstool.core.whole_file import make_folder, write_whole

PLOTLY = "plotly-basic-4.1.1.min.js.gz"
OWN = "page.js"


def packed_library() -> bytes:
    """plotly.js, compressed with gzip."""
    return _asset(PLOTLY)


def page_script() -> str:
    """The script of sinstool that has plotly.js draw the figures of a page."""
    return _asset(OWN).decode("utf-8")


def share_script(folder: Path) -> Path:
    """Write the script that all pages in a folder and below it share, unless it is there.

    Parameters
    ----------
    folder : Path
        Made if it is missing.

    Returns
    -------
    Path
        Absolute. The name has a hash of the content, so that pages of another version of sinstool
        in the same folder keep theirs.

    Raises
    ------
    OutputError
    """
    content = gzip.decompress(packed_library()) + b"\n" + _asset(OWN)
    path = folder.absolute() / f"figures-{hashlib.sha256(content).hexdigest()[:12]}.js"
    make_folder(folder)
    if not path.is_file() or path.read_bytes() != content:
        write_whole(path, content)
    return path


def _asset(name: str) -> bytes:
    return (files("sinstool.report") / "assets" / name).read_bytes()
