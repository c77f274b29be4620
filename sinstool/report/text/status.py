"""How one of many logs ended, in a word or two."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

# From the worst on, as a reader looks for what went wrong
ORDER = ("failed", "missing", "lost", "complete (lost)", "done", "complete")


def shown_status(row: Mapping[str, Any]) -> str:
    """Status of a row, which of an output that was there already also says what it lacks.

    Parameters
    ----------
    row : mapping
        A line of ``--json``, with ``status`` and ``exit``.
    """
    lost = row["status"] == "complete" and row.get("exit") == 3
    return "complete (lost)" if lost else str(row["status"])
