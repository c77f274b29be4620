"""What benchmarks of whole commands need.

Nothing is imported here that is not of the standard library: a child's peak memory counts from its
parent's size when it began, so the parent stays a bare interpreter.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# An installed package has its modules as bytecode. A checkout writes its own, unless this is set:
# then every run compiles them anew, which takes a tenth of a second and more.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
PROGRAM = (sys.executable, "-m", "sinstool")


def sinstool(*arguments: object) -> None:
    """Run a command that must end well; what it prints is not shown."""
    subprocess.run([*PROGRAM, *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)


def run_child(arguments: list[str]) -> tuple[str, float, float, float]:
    """Run a program; its output, wall and CPU seconds and peak memory in MB."""
    with tempfile.TemporaryFile() as out:
        began = time.perf_counter()
        pid = os.posix_spawn(
            arguments[0],
            arguments,
            os.environ,
            file_actions=[(os.POSIX_SPAWN_DUP2, out.fileno(), 1)],
        )
        _, status, usage = os.wait4(pid, 0)
        wall = time.perf_counter() - began
        out.seek(0)
        text = out.read().decode()
    if status:
        raise SystemExit(f"{' '.join(arguments)} failed: {text}")
    return text, wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024 / 1e6


@contextmanager
def folder_for_logs(folder: Path | None) -> Iterator[Path]:
    """The folder that was chosen, made where it is not there; without one a temporary folder."""
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        yield folder
        return
    with tempfile.TemporaryDirectory(prefix="sinstool.") as name:
        yield Path(name)
