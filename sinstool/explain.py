"""What is chosen, and why, said where it is chosen; the command line shows it with ``-v``."""

from __future__ import annotations

import logging

LOGGER = logging.getLogger("sinstool.choices")


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
