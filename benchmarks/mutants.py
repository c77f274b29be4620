"""Change one numerical line at a time, and see whether a test notices.

    nice python benchmarks/mutants.py --count 200 --seed 1 --folder /tmp/mutants

Lines are drawn by the seed from the methods and the pipelines: a sign, an operator, a comparison,
a bound, a factor or an index is changed, in a copy of the project. All tests run once on the copy
as it is: which functions each of them reaches, how long it takes, and whether it passes. Then, for
each mutant, those that reach it run, the nearest and quickest first, until one fails or --seconds
of them have run; a mutant that all of these let pass survives. Those that survived a quick look
can be judged again by more tests, with --numbers and more --seconds. Compiled loops are kept in
the copy, and only those that hold the mutant or call what does are compiled again, with little
optimisation. Lines that no quick test reaches are judged by the slow tests of their folder. A
folder that is given is kept: the next run uses the copy and what is known of its tests, but for
tests that were written or changed since, which it takes over.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path

from benchmarks.mutant_lines import Function, Mutant, Program, sites

ROOT = Path(__file__).resolve().parents[1]
COPIED = ("sinstool", "tests", "sample_data", "benchmarks", "docs", "docsite", "pyproject.toml",
          "mkdocs.yml", "README.md")  # fmt: skip
LEFT_OUT = ("tests/io", "tests/docs", "tests/benchmarks", "tests/test_house.py",
            "tests/acceptance", "tests/campaign")  # fmt: skip
# Compiling takes longer than most tests
ENVIRONMENT = {"NUMBA_OPT": "1", "NUMBA_LOOP_VECTORIZE": "0", "NUMBA_NUM_THREADS": "1",
               "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # fmt: skip
# Imported once, before the processes of the tests begin as copies of this one
HEAVY = (
    "numpy", "numpy.testing", "scipy.linalg", "scipy.optimize", "scipy.signal", "scipy.stats",
    "scipy.spatial.transform", "scipy.integrate", "scipy.interpolate", "numba",
    "numba.core.caching", "hypothesis", "hypothesis.extra.numpy", "mcap.reader", "mcap.writer",
    "rosbags.highlevel", "pydantic", "click", "rich.progress", "matplotlib.figure", "allantools",
    "mpmath", "pandas",
)  # fmt: skip
COMPILING = 120.0
QUICK, SLOW_S = "not slow", 300.0


class Copy:
    """A copy of the project in which one mutant at a time lives."""

    def __init__(self, folder: Path) -> None:
        self.root = (folder / "project").resolve()
        self.known = folder / "tests.json"
        self.log = folder / "log.txt"
        self.aside = folder / "aside"
        if not self.root.exists():
            self._make(folder)
        self.changed = self._take_over_tests()
        self.program = Program(self.root)

    def _make(self, folder: Path) -> None:
        self.root.mkdir(parents=True)
        for name in COPIED:
            source = ROOT / name
            if source.is_dir():
                no_caches = shutil.ignore_patterns("__pycache__")
                shutil.copytree(source, self.root / name, ignore=no_caches)
            elif source.exists():
                shutil.copy(source, self.root / name)
        if (ROOT.parent / "shared").exists():
            (folder / "shared").symlink_to((ROOT.parent / "shared").resolve())

    def _take_over_tests(self) -> list[str]:
        """Copy tests and their helpers that are not as in the copy; returns the files of tests."""
        changed = []
        for source in sorted((ROOT / "tests").rglob("*.py")):
            name = str(source.relative_to(ROOT))
            target = self.root / name
            if not target.exists() or target.read_bytes() != source.read_bytes():
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(source, target)
                if source.name.startswith("test_") and not name.startswith(LEFT_OUT):
                    changed.append(name)
        return changed

    def learn(self, tests: Sequence[str]) -> None:
        """Run tests on the copy as it is, unless that is known already."""
        if not self.known.exists():
            left_out = [f"--ignore={name}" for name in LEFT_OUT]
            self._run([*tests, *left_out], 1e5, learn=True)
        elif self.changed:
            before = json.loads(self.known.read_text())
            self._run(self.changed, 1e5, learn=True)
            after = json.loads(self.known.read_text())
            for node, test in before["tests"].items():
                if node.partition("::")[0] not in self.changed:
                    after["tests"][node] = test
                    after["failed"] += [node] * (node in before["failed"])
            self.known.write_text(json.dumps(after))
        self.changed = []
        known = json.loads(self.known.read_text())
        self.failed = set(known["failed"])
        self.tests: dict[str, float] = {}
        self.reaching: dict[tuple[str, str], set[str]] = defaultdict(set)
        for node, test in known["tests"].items():
            if node not in self.failed:
                self.tests[node] = test["seconds"]
                for path, inside in test["functions"]:
                    self.reaching[path, inside].add(node)

    def tests_of(self, mutant: Mutant, seconds: float) -> tuple[list[str], float, int]:
        """Tests that reach a mutant, nearest files first, as many as the time allows.

        Returns their node IDs, how long they take, and how many have been left out.
        """
        places = self.program.reached_from(mutant)
        nodes = set().union(*(self.reaching.get(place, set()) for place in places))
        mirrored = Path(mutant.path.replace("sinstool/", "tests/", 1))
        own = mirrored.with_name(f"test_{mirrored.name}")
        files: dict[str, list[tuple[float, str]]] = defaultdict(list)
        for node in nodes:
            files[node.partition("::")[0]].append((self.tests[node], node))

        def distance(file: str) -> tuple[bool, int, float]:
            common = len(Path(os.path.commonpath([file, mirrored])).parts)
            return file != str(own), -common, min(files[file])[0]

        ranked = [pair for file in sorted(files, key=distance) for pair in sorted(files[file])]
        chosen, total = [], 0.0
        for took, node in ranked:
            if total + took <= seconds or not chosen:
                chosen.append(node)
                total += took
        return chosen, total, len(ranked) - len(chosen)

    def slow_tests_of(self, mutant: Mutant) -> list[str]:
        """Files with slow tests in the folder of a mutant's module, not those below it."""
        folder = (self.root / mutant.path.replace("sinstool/", "tests/", 1)).parent
        slow = [p for p in sorted(folder.glob("test_*.py")) if "mark.slow" in p.read_text()]
        return [str(p.relative_to(self.root)) for p in slow]

    def judge(
        self, mutant: Mutant, nodes: Sequence[str], seconds: float, marks: str = QUICK
    ) -> str:
        """Whether tests with these marks notice: '' or what did."""
        path = self.root / mutant.path
        text, stat = path.read_bytes(), path.stat()
        affected, _ = self.program.compiled_with(mutant)
        try:
            path.write_bytes(of_same_size(text, mutant))
            # Neither numba nor Python looks at more: what they keep of the rest of the file holds.
            os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
            _forget_bytecode(path)
            self._set_aside(affected)
            limit = 20.0 + 5.0 * seconds + COMPILING * bool(affected)
            return self._run(nodes, limit, marks=marks)
        finally:
            path.write_bytes(text)
            os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
            _forget_bytecode(path)
            self._put_back(affected)

    def _compiled_files(self, functions: Iterable[Function]) -> list[Path]:
        found = []
        for f in functions:
            source = self.root / f.path
            start = f"{source.stem}.{f.inside.replace('<', '').replace('>', '')}-{f.line}."
            found += [
                p for p in (source.parent / "__pycache__").glob("*.nb?") if p.name.startswith(start)
            ]
        return found

    def _set_aside(self, functions: Iterable[Function]) -> None:
        for old in self._compiled_files(functions):
            target = self.aside / old.relative_to(self.root)
            target.parent.mkdir(parents=True, exist_ok=True)
            old.rename(target)

    def _put_back(self, functions: Iterable[Function]) -> None:
        for new in self._compiled_files(functions):
            new.unlink()
        for old in list(self.aside.rglob("*.nb?")):
            old.rename(self.root / old.relative_to(self.aside))

    def _run(
        self, arguments: Sequence[str], seconds: float, learn: bool = False, marks: str = QUICK
    ) -> str:
        """Run tests in a process of their own; '' or the first that failed."""
        child = os.fork()
        if not child:
            with suppress(BaseException):
                self._test(arguments, seconds, learn, marks)
            os._exit(99)
        used = _waited(child, 10.0 * seconds)
        if os.WIFSIGNALED(used):
            return f"no end ({signal.Signals(os.WTERMSIG(used)).name})"
        status = os.waitstatus_to_exitcode(used)
        if learn or status == 0:
            return ""
        said = self.log.read_text(errors="replace").split("\n")
        failed = [line for line in said if line.startswith(("FAILED", "ERROR"))]
        # A file whose import fails has no tests to collect, which is noticed too.
        if not failed:
            raise RuntimeError(f"pytest ends with {status}: {said[-30:]}")
        return failed[0].split(" - ")[0]

    def _test(self, arguments: Sequence[str], seconds: float, learn: bool, marks: str) -> None:
        import pytest

        os.setsid()
        os.chdir(self.root)
        with self.log.open("wb") as log:
            os.dup2(log.fileno(), 1)
            os.dup2(log.fileno(), 2)
        for name in [n for n in sys.modules if n.split(".")[0] in ("benchmarks", "tests")]:
            del sys.modules[name]
        sys.path[:] = [str(self.root), *(p for p in sys.path if Path(p or ".").resolve() != ROOT)]
        os.environ["PYTHONPATH"] = str(self.root)
        resource.setrlimit(resource.RLIMIT_CPU, (int(seconds) + 1, int(seconds) + 10))
        options = ["-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-o", f"addopts=-m '{marks}'"]
        if not learn:
            os._exit(pytest.main([*options, "-x", *arguments]))
        from benchmarks.reached_functions import Reached

        seen = Reached(self.root)
        status = pytest.main([*options, *arguments], [seen])
        sys.settrace(None)
        self.known.write_text(json.dumps({"tests": seen.tests, "failed": seen.failed}))
        os._exit(status)


def of_same_size(text: bytes, mutant: Mutant) -> bytes:
    """The file with the mutant in it and as many bytes as before: a docstring gives or takes."""
    grown = len(mutant.new.encode()) - len(mutant.old.encode())
    changed = text[: mutant.begin] + mutant.new.encode() + text[mutant.end :]
    if text[:3] != b'"""' or text.index(b"\n") < 3 + grown:
        raise ValueError(f"{mutant.path} does not begin with a docstring")
    return changed[:3] + b" " * -grown + changed[3 + max(grown, 0) :]


def _forget_bytecode(path: Path) -> None:
    for old in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
        old.unlink()


def _waited(child: int, seconds: float) -> int:
    """Wait for a process, and end it with all that it began where it waits itself."""
    begun = time.monotonic()
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if not done and time.monotonic() - begun < seconds:
            time.sleep(0.02)
            continue
        with suppress(OSError):
            os.killpg(child, signal.SIGKILL)
        return status if done else os.waitpid(child, 0)[1]


def draw(root: Path, only: str, count: int, seed: int) -> tuple[list[Mutant], int]:
    """Mutants of so many lines, and how many lines there are."""
    by_line: dict[tuple[str, int], list[Mutant]] = defaultdict(list)
    for mutant in sites(root, only):
        by_line[mutant.path, mutant.line].append(mutant)
    # A line counts once, however many numbers stand in it.
    lines = sorted(by_line)
    chosen = random.Random(seed)
    sample = chosen.sample(lines, min(count, len(lines)))
    return [chosen.choice(by_line[line]) for line in sample], len(lines)


def run(copy: Copy, mutants: dict[int, Mutant], tests: Sequence[str], seconds: float) -> None:
    """Judge mutants, by their number in the sample, and print the score."""
    began = time.monotonic()
    copy.learn(tests)
    print(
        f"{len(copy.tests)} tests known after {(time.monotonic() - began) / 60.0:.0f} min,"
        f" {len(copy.failed)} fail without a mutant: {sorted(copy.failed)[:10]}",
        flush=True,
    )
    survivors = []
    for number, mutant in mutants.items():
        nodes, expected, left_out = copy.tests_of(mutant, seconds)
        begun = time.monotonic()
        slow = [] if nodes else copy.slow_tests_of(mutant)
        if slow:
            nodes = slow
            verdict = copy.judge(mutant, nodes, SLOW_S, "slow")
        else:
            verdict = copy.judge(mutant, nodes, expected) if nodes else ""
        if not verdict:
            survivors.append(mutant)
            verdict = f"{len(nodes)} tests passed, {left_out} left out"
            word = "SURVIVES"
        else:
            word = "killed"
        print(f"{number:3d} {time.monotonic() - begun:4.0f} s {word} {mutant}  {verdict}",
              flush=True)  # fmt: skip
    killed = len(mutants) - len(survivors)
    print(
        f"\nkilled {killed} of {len(mutants)} ({100.0 * killed / max(len(mutants), 1):.1f} %) in"
        f" {(time.monotonic() - began) / 60.0:.0f} min; survivors:"
    )
    for mutant in survivors:
        print(f"  {mutant}")


def main() -> None:
    """Read the options and run."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    p.add_argument("--count", type=int, default=200)
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--first", type=int, default=1, help="number of the first of them to judge")
    p.add_argument("--numbers", type=int, nargs="+", help="judge only these of them")
    p.add_argument("--only", default="", help="part of a path")
    p.add_argument("--tests", nargs="+", default=["tests"], help="files and folders of tests")
    p.add_argument("--seconds", type=float, default=60.0, help="of tests for a mutant")
    p.add_argument("--folder", type=Path, help="where the copy is made and kept")
    args = p.parse_args()
    os.environ |= ENVIRONMENT
    for name in HEAVY:
        with suppress(ImportError):
            __import__(name)
    with ExitStack() as stack:
        folder = args.folder or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        copy = Copy(folder)
        mutants, lines = draw(copy.root, args.only, args.count, args.seed)
        print(f"{len(mutants)} of {lines} numerical lines, seed {args.seed}", flush=True)
        numbers = args.numbers or range(args.first, len(mutants) + 1)
        run(copy, {n: mutants[n - 1] for n in numbers}, args.tests, args.seconds)


if __name__ == "__main__":
    main()
