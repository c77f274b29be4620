"""Errors for users: one class for each kind, with a one-line message that helps.

Every message says what was wrong, where (file, topic, time) and what to do. The command
line prints that line alone and exits with ``exit_code``; a traceback appears only with
``-vv``. Code outside :mod:`sinstool.cli` raises these and never prints.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# What to do about a damaged log; the command line replaces AGAIN by the whole command to run
AGAIN = "run again with --salvage"
SALVAGE_HINT = f"{AGAIN} to use the undamaged parts"


def one_line(text: str) -> str:
    """Text without control characters, which names in a log may hold.

    Returns
    -------
    str
        Line ends become spaces, other control characters U+FFFD.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else " " if c.isspace() else "\ufffd" for c in text)


# Control characters except tab and line feed, marks that change the direction of text, and the
# lone surrogates that Python makes of file names that are not UTF-8
_INVISIBLE = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff]"
)


def visible(text: str) -> str:
    """Text of several lines without control characters of terminals or browsers.

    Returns
    -------
    str
        Each such character becomes U+FFFD.
    """
    return _INVISIBLE.sub("\ufffd", text)


class SinstoolError(Exception):
    """Root of all errors a user can cause.

    Parameters
    ----------
    message : str
        What was wrong and where, in one line without a full stop.
    hint : str, optional
        What to do about it; printed after the message.
    """

    exit_code = 1

    def __init__(self, message: str, hint: str = "") -> None:
        self.message = one_line(message)
        self.hint = one_line(hint)
        super().__init__(self.message)

    def __str__(self) -> str:
        return f"{self.message}: {self.hint}" if self.hint else self.message


class ConfigurationError(SinstoolError):
    """An option or a key of the configuration file is unknown, mistyped or impossible."""

    exit_code = 2


class LogError(SinstoolError):
    """A log cannot be read as it is.

    Parameters
    ----------
    path : path-like
        The log.
    message : str
        What is wrong with it.
    hint : str, optional
        What to do.
    offset : int, optional
        Byte offset in the file at which the problem was found.
    """

    def __init__(
        self, path: Path | str, message: str, hint: str = "", offset: int | None = None
    ) -> None:
        self.path = Path(path)
        where = f" (at byte {offset})" if offset is not None else ""
        super().__init__(f"{path}: {message}{where}", hint)


class NotALogError(LogError):
    """The file is missing, empty, or not in a format that sinstool reads."""


def no_such_log(path: Path) -> NotALogError:
    """Error for a path at which nothing is, also of an address elsewhere."""
    # Path leaves one of the two slashes
    remote = re.match(r"[a-z][a-z0-9+.-]+:/", str(path)) is not None
    hint = "sinstool reads files: copy it to this machine, or mount what holds it" if remote else ""
    return NotALogError(path, "there is no such file or folder", hint)


class DamagedLogError(LogError):
    """The log is truncated or a part of it is corrupt."""


class UnsupportedLogError(LogError):
    """The log is whole but uses an encoding, compression or version that sinstool does not read."""


class TopicError(LogError):
    """The requested topic is missing, of the wrong type, or one of several."""


class DataError(LogError):
    """The values in a topic contradict their declaration (units, rates, time)."""


class AlignmentError(SinstoolError):
    """The requested method cannot determine the initial attitude from this log.

    Parameters
    ----------
    uncertain : bool, optional
        Whether an attitude was found that is too uncertain to use.
    consistent : bool, optional
        Whether that attitude agrees with the data, so that a wrong latency, lever arm or unit is
        not the cause.
    """

    def __init__(
        self, message: str, hint: str = "", uncertain: bool = False, consistent: bool = False
    ) -> None:
        self.uncertain = uncertain
        self.consistent = consistent
        super().__init__(message, hint)


@contextmanager
def in_log(path: Path) -> Iterator[None]:
    """Name the log in errors of alignments, which are computed from arrays alone."""
    try:
        yield
    except AlignmentError as exc:
        if exc.message.startswith(one_line(f"{path}: ")):
            raise
        message = f"{path}: {exc.message}"
        raise AlignmentError(message, exc.hint, exc.uncertain, exc.consistent) from exc


class OutputError(SinstoolError):
    """The output cannot be written: it exists, is the input, or its folder refuses it."""


class UncachedWarning(UserWarning):
    """Compiled code cannot be cached, so the next run will be slow again."""
