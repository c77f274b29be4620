"""The page of every command, and the single figure for a paper, each a whole file.

Pages of many logs may share the script that draws them, which then lies beside them.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sinstool.core.errors import ConfigurationError, OutputError
from sinstool.core.whole_file import check_output, write_whole
from sinstool.report.extra import borrowed

if TYPE_CHECKING:
    from sinstool.report.sections import Page

# Every command asks whether a report could be written; what draws it is imported where it is.
PAGES = (".html", ".htm")
FORMATS = (".png", ".pdf", ".svg")


def check_report(
    path: Path | None, *, inputs: Sequence[Path] = (), overwrite: bool = False
) -> None:
    """Refuse a report that could not be written, before the work that it is about.

    Parameters
    ----------
    path : Path or None
        Its suffix says what it is to be: a page (.html) or the main figure (.png, .pdf, .svg).
        None for no report, which is fine.
    inputs : sequence of Path, optional
        Files that must not be written over.
    overwrite : bool, optional
        Whether `path` may exist.

    Raises
    ------
    ConfigurationError
        If the suffix is another, or an image is asked for and the extra ``report`` is not
        installed.
    OutputError
        If the file exists, is an input or cannot be written.
    """
    if path is None:
        return
    suffix = path.suffix.lower()
    if suffix in FORMATS:
        borrowed("matplotlib.figure")
    elif suffix not in PAGES:
        raise ConfigurationError(
            f"the report {path} has {f'the suffix {suffix}' if suffix else 'no suffix'}",
            f"use one of {', '.join((PAGES[0], *FORMATS))}",
        )
    check_output(path, list(inputs), overwrite)


def write_report(
    path: Path,
    page: Page,
    *,
    inputs: Sequence[Path] = (),
    overwrite: bool = False,
    script: Path | None = None,
) -> None:
    """Write by suffix: the page as one whole HTML file, or its first figure alone.

    Parameters
    ----------
    inputs : sequence of Path, optional
        Files that must not be written over.
    overwrite : bool, optional
        Whether `path` may exist.
    script : Path, optional
        That of :func:`~sinstool.report.library.share_script`, of which the page then has a link;
        by default the page is complete in itself.

    Raises
    ------
    ConfigurationError
        As by :func:`check_report`.
    OutputError
        As by :func:`check_report`, and if the page has no figure to write alone.
    """
    check_report(path, inputs=inputs, overwrite=overwrite)
    suffix = path.suffix.lower()
    if suffix in PAGES:
        from sinstool.report.markup import markup

        write_whole(path, markup(page, None if script is None else _link(script, path)))
    elif page.figures:
        from sinstool.report.static import image

        write_whole(path, image(page.figures[0], suffix))
    else:
        raise OutputError(f"there is no figure for {path}", "ask for a page (.html)")


def _link(target: Path, page: Path) -> str:
    """Relative link from a page to a file."""
    return Path(os.path.relpath(target.absolute(), page.absolute().parent)).as_posix()
