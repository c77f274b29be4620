"""Choices and their reasons, logged where they are made; ``-v`` prints them."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

LOGGER = logging.getLogger("sinstool.choices")
_LOG = "log"


def log_choice(what: str, why: str) -> None:
    """Log a choice with its reason.

    Parameters
    ----------
    what : str
        What is chosen, in a word or two: ``mode``, ``Imu topic``. ``log`` begins the choices for
        another log.
    why : str
        The choice and its reason, in one line.
    """
    LOGGER.info("%s: %s", what, why)


def choices_are_shown() -> bool:
    """Whether choices are being printed or recorded."""
    return LOGGER.isEnabledFor(logging.INFO)


class _Recorder(logging.Handler):
    """Records what one thread logs."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.lines: list[str] = []
        self._thread = threading.get_ident()

    def emit(self, record: logging.LogRecord) -> None:
        """Record a line."""
        if record.thread == self._thread:
            self.lines.append(record.getMessage())


@contextmanager
def record_choices(enabled: bool) -> Iterator[list[str]]:
    """Record the choices of this thread, for :func:`replay` elsewhere.

    Parameters
    ----------
    enabled : bool
        Whether to record at all.

    Yields
    ------
    list of str
        The choices so far; it grows while they are made.
    """
    if not enabled:
        yield []
        return
    recorder, before = _Recorder(), LOGGER.level
    LOGGER.addHandler(recorder)
    LOGGER.setLevel(logging.INFO)
    try:
        yield recorder.lines
    finally:
        LOGGER.removeHandler(recorder)
        LOGGER.setLevel(before)


def replay(name: str, choices: Sequence[str]) -> None:
    """Log recorded choices.

    Parameters
    ----------
    name : str
        Name of the log, for choices that do not begin with it.
    """
    if choices and not choices[0].startswith(f"{_LOG}: "):
        log_choice(_LOG, name)
    for text in choices:
        LOGGER.info("%s", text)
