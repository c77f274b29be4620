"""First runs of the whole command where it may not keep what it compiles, or many begin at once.

    python benchmarks/first_runs.py
    python benchmarks/first_runs.py --log LOG

Eight runs of `process` begin at the same time with an empty cache; then again with what they left
there. Another user runs an installation that is not theirs, with a home of their own and without
one; a user without a home runs one that nobody may write. Every run must exit with 0, write what
a usual run writes, byte for byte, and print what that prints, and where the cache cannot be kept,
the one line that says how it can. What another user does is run by root only. Exits with 1 where
that does not hold.

With a log, prints instead what its first run costs in each mode: processor time with an empty
cache, and in the run after it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.commands import PROGRAM, run_child
from benchmarks.common import parser, print_table

ROOT = Path(__file__).resolve().parents[1]
LOG = ROOT / "sample_data" / "coning.mcap"
NOBODY = 65534
# Another user, who may read everything, as root's own Python may be where others may not look
OTHER = ("setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups",
         "--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search")  # fmt: skip


def start(
    out: Path, environment: dict[str, str], user: Sequence[str] = (), installed: Path = ROOT
) -> subprocess.Popen[str]:
    """Begin a run of an installation, as another user if there is one."""
    log = out.with_name("log.mcap")
    arguments = ["process", str(log), "-o", str(out), "--overwrite", "-q", "--latitude", "45"]
    return subprocess.Popen(
        [*user, *PROGRAM, *arguments],
        cwd=out.parent,
        env=os.environ
        | {"PYTHONPATH": str(installed), "PYTHONDONTWRITEBYTECODE": "1"}
        | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def judge(name: str, runs: Sequence[subprocess.Popen[str]], outs: Sequence[Path], same: bytes,
          usual: str, lines: int = 0) -> int:  # fmt: skip
    """Wait for runs, print a line of what came of them, and return how many are wrong.

    Parameters
    ----------
    usual : str
        What any run prints about the log.
    lines : int, optional
        How many more lines are expected.
    """
    begun = time.monotonic()
    wrong = 0
    for run, out in zip(runs, outs, strict=True):
        said = run.communicate()[0].replace(usual, "").strip()
        fine = run.returncode == 0 and len(said.splitlines()) == lines and "Traceback" not in said
        fine = fine and (not lines or "NUMBA_CACHE_DIR" in said)
        if not (fine and out.read_bytes() == same):
            wrong += 1
            print(f"  {name}: status {run.returncode}: {said}")
    seconds = time.monotonic() - begun
    print(f"{name}: {len(runs)} runs, {wrong} wrong, {seconds:.0f} s", flush=True)
    return wrong


def costs(log: Path) -> None:
    """Print the processor time of a first run, and of the one after it, in each mode."""
    rows = []
    for mode in ("attitude", "ins-gnss"):
        with tempfile.TemporaryDirectory() as name:
            os.environ["NUMBA_CACHE_DIR"] = name
            run = [*PROGRAM, "process", str(log), "-o", str(Path(name, "out.mcap")), "--overwrite"]
            first, second = (run_child([*run, "-q", "--mode", mode])[2] for _ in range(2))
        rows.append((mode, f"{first:.1f}", f"{second:.1f}", f"{first - second:.1f}"))
    print_table(("mode", "first run, s", "second run, s", "compiling, s"), rows)


def main(arguments: Sequence[str] | None = None) -> int:
    words = parser(__doc__, runs=8)
    words.add_argument("--log", type=Path, help="what a first run on this log costs")
    options = words.parse_args(arguments)
    if options.log is not None:
        costs(options.log)
        return 0
    wrong = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        shutil.copy(LOG, folder / "log.mcap")
        usual = folder / "usual.mcap"
        said = start(usual, {}).communicate()[0].strip()
        same = usual.read_bytes()

        outs = [folder / f"{k}.mcap" for k in range(options.runs)]
        cache = {"NUMBA_CACHE_DIR": str(folder / "cache")}
        for which in ("an empty cache", "what they left in it"):
            wrong += judge(f"at once, {which}", [start(o, cache) for o in outs], outs, same, said)

        if os.geteuid() or not shutil.which("setpriv"):
            print("neither root nor setpriv: runs of another user are left out")
            return 1 if wrong else 0
        installed = folder / "installed"
        no_caches = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / "sinstool", installed / "sinstool", ignore=no_caches)
        theirs = folder / "theirs"
        theirs.mkdir()
        os.chown(theirs, NOBODY, NOBODY)
        shutil.copy(LOG, theirs / "log.mcap")
        (theirs / "home").mkdir()
        os.chown(theirs / "home", NOBODY, NOBODY)
        out = theirs / "out.mcap"
        home = {"HOME": str(theirs / "home"), "XDG_CACHE_HOME": ""}
        nowhere = {"HOME": "/proc", "XDG_CACHE_HOME": "/proc"}
        for shown, environment, lines in (
            ("another user, with a home", home, 0),
            ("another user, with what that run left", home, 0),
            ("another user, a read-only installation and no home", nowhere, 1),
        ):
            runs = [start(out, environment, OTHER, installed)]
            wrong += judge(shown, runs, [out], same, said, lines)
        left = [p for p in folder.rglob("*") if ".sinstool-part" in p.name]
        left += [p for p in (folder / "cache").rglob("*.nb*") if p.suffix != ".nbc"]
        if left:
            wrong += 1
            print(f"left behind: {left}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
