"""What is chosen, and why, said where it is chosen; the command line shows it with ``-v``."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

LOGGER = logging.getLogger("sinstool.choices")
_LOG = "log"


def explain(what: str, why: str) -> None:
    """Say what was chosen.

    Parameters
    ----------
    what : str
        A word or two: ``mode``, ``Imu topic``.
    why : str
        The choice and its reason, in a line. ``log`` begins what is said of another log.
    """
    LOGGER.info("%s: %s", what, why)


def asked_for() -> bool:
    """Whether anybody listens."""
    return LOGGER.isEnabledFor(logging.INFO)


class _Kept(logging.Handler):
    """What one thread says."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.lines: list[str] = []
        self._thread = threading.get_ident()

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a line."""
        if record.thread == self._thread:
            self.lines.append(record.getMessage())


@contextmanager
def explained(wanted: bool) -> Iterator[list[str]]:
    """Keep what is chosen meanwhile, in this thread, for :func:`say_again` elsewhere.

    Parameters
    ----------
    wanted : bool
        Else nothing is kept.

    Yields
    ------
    list of str
        Grows.
    """
    if not wanted:
        yield []
        return
    kept, before = _Kept(), LOGGER.level
    LOGGER.addHandler(kept)
    LOGGER.setLevel(logging.INFO)
    try:
        yield kept.lines
    finally:
        LOGGER.removeHandler(kept)
        LOGGER.setLevel(before)


def say_again(name: str, choices: Sequence[str]) -> None:
    """Say what was chosen elsewhere.

    Parameters
    ----------
    name : str
        Of the log, where the choices do not begin with it.
    """
    if choices and not choices[0].startswith(f"{_LOG}: "):
        explain(_LOG, name)
    for text in choices:
        LOGGER.info("%s", text)
