"""Which output files a command has completed, for whoever has to say so when it breaks off."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

_outputs: ContextVar[list[Path] | None] = ContextVar("_outputs", default=None)


@contextmanager
def completed_outputs() -> Iterator[list[Path]]:
    """Collect the files that are completed inside.

    Yields
    ------
    list of Path
        Grows with every file, in their order.
    """
    outputs: list[Path] = []
    token = _outputs.set(outputs)
    try:
        yield outputs
    finally:
        _outputs.reset(token)


def record_output(*paths: Path) -> None:
    """Add files to those that :func:`completed_outputs` collects, if it does."""
    outputs = _outputs.get()
    if outputs is not None:
        outputs += paths
