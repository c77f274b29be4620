"""The valid words nearest to a misspelt one."""

from __future__ import annotations

from collections.abc import Iterable


def nearest(word: str, candidates: Iterable[str]) -> str:
    """The name that a user may have meant.

    Returns
    -------
    str
        ``did you mean X?``; '' if no candidate is near.
    """
    import difflib

    words = list(candidates)
    near = difflib.get_close_matches(word, words, n=1)
    # A part of a topic's name is enough: by letters alone, /imu is not near /sensors/imu/data.
    near = near or [k for k in words if len(word.strip("/")) > 2 and word.strip("/") in k][:1]
    return f"did you mean {near[0]}?" if near else ""
