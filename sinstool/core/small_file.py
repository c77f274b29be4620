"""Small text files written by hand, read up to a size limit."""

from __future__ import annotations

from pathlib import Path

from sinstool.core.errors import ConfigurationError

# Bytes; the longest reasonable file has some kilobytes
MOST = 2**20


def read_text(path: Path, option: str = "", hint: str = "") -> str:
    """Text of a small file, such as a configuration or a calibration, without a byte order mark.

    Parameters
    ----------
    option : str, optional
        The option that named it, for the error.
    hint : str, optional
        What to do if it cannot be read.

    Raises
    ------
    ConfigurationError
        If it cannot be read, is longer than 1 MiB, or is not UTF-8.
    """
    name = f"{option} {path}" if option else str(path)
    try:
        # Devices and pipes may never end
        with path.open("rb") as stream:
            content = stream.read(MOST + 1)
    except OSError as exc:
        raise ConfigurationError(f"{name}: cannot be read ({exc.strerror})", hint) from exc
    if len(content) > MOST:
        what = f"{name}: cannot be read (longer than the {MOST // 2**20} MiB that are accepted)"
        raise ConfigurationError(what, hint)
    try:
        return content.decode("utf-8-sig")  # editors of Windows begin files with a mark
    except UnicodeDecodeError as exc:
        raise ConfigurationError(f"{name}: cannot be read (it is not text)", hint) from exc
