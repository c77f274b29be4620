"""Change one numerical line at a time, and see whether a test notices.

    python benchmarks/mutants.py --count 200 --seed 1 --jobs 2

Lines are drawn by the seed from the methods and the pipelines: a sign, an operator, a comparison,
a bound, a factor or an index is changed, in a copy of the project. The tests that import the module
run first, those of the neighbourhood after that; a mutant that all of them let pass survives.
Compiled loops of everything that imports the module are compiled again for each mutant.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from queue import SimpleQueue

ROOT = Path(__file__).resolve().parents[1]
WHERE = ("sinstool/methods", "sinstool/pipelines")
COPIED = ("sinstool", "tests", "sample_data", "benchmarks", "docs", "docsite", "pyproject.toml",
          "mkdocs.yml", "README.md")  # fmt: skip
NEAR, WIDE = 6, 12
SWAPPED = {
    ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.MatMult: "-",
    ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!=", ast.NotEq: "==",
}  # fmt: skip
NAMES = {"sin": "cos", "cos": "sin", "minimum": "maximum", "maximum": "minimum", "min": "max"}
MODULE = "<module>"


@dataclass(frozen=True)
class Mutant:
    """One change of one line.

    Attributes
    ----------
    path : str
        Below the root.
    begin, end : int
        Bytes of the file that are replaced.
    old, new : str
    line : int
    inside : str
        Function that the line is in.
    """

    path: str
    begin: int
    end: int
    old: str
    new: str
    line: int
    inside: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line} ({self.inside}): {self.old} -> {self.new}"


class _Sites(ast.NodeVisitor):
    """All places of a file that can be changed."""

    def __init__(self, path: str, text: bytes) -> None:
        self.path, self.text = path, text
        self.starts = [0]
        for line in text.split(b"\n"):
            self.starts.append(self.starts[-1] + len(line) + 1)
        self.inside = MODULE
        self.found: list[Mutant] = []

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        outer, self.inside = self.inside, node.name
        for statement in node.body:
            self.visit(statement)
        self.inside = outer

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        for statement in node.body:
            if isinstance(statement, ast.FunctionDef):
                self.visit(statement)

    def visit_Raise(self, _: ast.Raise) -> None:
        """What an error says is no number."""

    def visit_JoinedStr(self, _: ast.JoinedStr) -> None:
        """Nor is a text."""

    def visit_BinOp(self, node: ast.BinOp) -> None:
        self._between(node.left, node.right, type(node.op))
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        sides = [node.left, *node.comparators]
        for (left, right), op in zip(pairwise(sides), node.ops, strict=True):
            self._between(left, right, type(op))
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        self._between(node.target, node.value, type(node.op), "=")
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        if isinstance(node.op, ast.USub):
            begin = self._at(node.lineno, node.col_offset)
            self._add(begin, begin + 1, "+", node.lineno)
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        value = node.value
        if isinstance(value, bool) or not isinstance(value, int | float):
            return
        begin = self._at(node.lineno, node.col_offset)
        end = self._at(node.end_lineno or 0, node.end_col_offset or 0)
        if isinstance(value, int):
            new = str(value + 1)
        else:
            new = "1.0" if value == 0.0 else repr(1.5 * value)
        self._add(begin, end, new, node.lineno)

    def visit_Attribute(self, node: ast.Attribute) -> None:
        if node.attr in NAMES:
            end = self._at(node.end_lineno or 0, node.end_col_offset or 0)
            self._add(end - len(node.attr), end, NAMES[node.attr], node.end_lineno or 0)
        self.generic_visit(node)

    def _at(self, line: int, column: int) -> int:
        return self.starts[line - 1] + column

    def _between(self, left: ast.expr, right: ast.expr, op: type, after: str = "") -> None:
        """The operator that stands between two expressions."""
        if op not in SWAPPED:
            return
        begin = self._at(left.end_lineno or 0, left.end_col_offset or 0)
        end = self._at(right.lineno, right.col_offset)
        gap = self.text[begin:end].decode()
        sign = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.MatMult: "@",
                ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==",
                ast.NotEq: "!="}[op] + after  # fmt: skip
        place = gap.find(sign)
        if place >= 0 and "#" not in gap:
            begin += len(gap[:place].encode())
            new = SWAPPED[op] + after
            self._add(begin, begin + len(sign), new, left.end_lineno or 0)

    def _add(self, begin: int, end: int, new: str, line: int) -> None:
        if self.inside != MODULE:
            old = self.text[begin:end].decode()
            self.found.append(Mutant(self.path, begin, end, old, new, line, self.inside))


def sites(root: Path, only: str) -> list[Mutant]:
    """Every change that can be made below `WHERE`."""
    found = []
    for folder in WHERE:
        for path in sorted((root / folder).rglob("*.py")):
            name = str(path.relative_to(root))
            if only in name:
                text = path.read_bytes()
                visitor = _Sites(name, text)
                visitor.visit(ast.parse(text))
                found += visitor.found
    return found


def module_of(path: str) -> str:
    """Dotted name of a file."""
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def importers(root: Path, folder: str) -> dict[str, set[str]]:
    """Modules of the package that each file of a folder imports, by its path."""
    arrows = {}
    for path in sorted((root / folder).rglob("*.py")):
        names = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module:
                names |= {node.module, *(f"{node.module}.{a.name}" for a in node.names)}
            elif isinstance(node, ast.Import):
                names |= {a.name for a in node.names}
        arrows[str(path.relative_to(root))] = {n for n in names if n.startswith("sinstool")}
    return arrows


def dependents(module: str, package: dict[str, set[str]]) -> list[set[str]]:
    """Files of the package that reach a module, by the number of steps; itself first."""
    steps = [{path for path in package if module_of(path) == module}]
    seen = set(steps[0])
    while steps[-1]:
        names = {module_of(path) for path in steps[-1]}
        new = {p for p, imports in package.items() if p not in seen and imports & names}
        seen |= new
        steps.append(new)
    return steps[:-1]


def nearest_tests(
    mutant: Mutant, package: dict[str, set[str]], tests: dict[str, set[str]]
) -> list[str]:
    """Files of tests that may notice, the nearest first: of the same name, of the same folder."""
    mirrored = Path(mutant.path.replace("sinstool/", "tests/", 1))
    own = mirrored.with_name(f"test_{mirrored.name}")
    ranked: dict[str, tuple[int, int]] = {}
    for step, files in enumerate(dependents(module_of(mutant.path), package)):
        names = {module_of(path) for path in files}
        for path, imports in tests.items():
            if imports & names and Path(path).name.startswith("test_"):
                common = len(os.path.commonpath([path, str(mirrored)]))
                ranked.setdefault(path, (step, -common))
    if str(own) in tests:
        ranked[str(own)] = (-1, 0)
    return sorted(ranked, key=lambda path: (*ranked[path], path))


class Copy:
    """A copy of the project in which one mutant at a time lives."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "project"
        self.root.mkdir(parents=True)
        for name in COPIED:
            source = ROOT / name
            if source.is_dir():
                shutil.copytree(source, self.root / name)
            elif source.exists():
                shutil.copy(source, self.root / name)
        if (ROOT.parent / "shared").exists():
            (folder / "shared").symlink_to((ROOT.parent / "shared").resolve())

    def judge(self, mutant: Mutant, rounds: Iterable[Sequence[str]], reach: set[str],
              timeout: float) -> str:  # fmt: skip
        """Whether tests notice: '' or what did."""
        path = self.root / mutant.path
        text = path.read_bytes()
        try:
            path.write_bytes(text[: mutant.begin] + mutant.new.encode() + text[mutant.end :])
            self._forget(reach)
            for files in rounds:
                verdict = self._run(files, timeout) if files else ""
                if verdict:
                    return verdict
            return ""
        finally:
            path.write_bytes(text)
            self._forget(reach)

    def _forget(self, reach: set[str]) -> None:
        """Remove compiled loops of all files that reach the mutant; numba would not notice."""
        for name in reach:
            path = self.root / name
            for old in (path.parent / "__pycache__").glob(f"{path.stem}.*.nb?"):
                old.unlink()

    def _run(self, files: Sequence[str], timeout: float) -> str:
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *files]
        variables = {**os.environ, "PYTHONPATH": str(self.root), "NUMBA_NUM_THREADS": "1"}
        try:
            done = subprocess.run(
                command, cwd=self.root, env=variables, capture_output=True, text=True,
                timeout=timeout,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return "no end"
        if done.returncode == 0:
            return ""
        failed = [line for line in done.stdout.split("\n") if line.startswith(("FAILED", "ERROR"))]
        return failed[0].split(" - ")[0] if failed else "tests cannot start"


def run(count: int, seed: int, jobs: int, only: str, timeout: float) -> None:
    """Judge mutants and print the score."""
    package, tests = importers(ROOT, "sinstool"), importers(ROOT, "tests")
    every = sites(ROOT, only)
    # A line counts once, however many numbers stand in it.
    lines = sorted({(m.path, m.line) for m in every})
    draw = random.Random(seed)
    chosen = draw.sample(lines, min(count, len(lines)))
    by_line: dict[tuple[str, int], list[Mutant]] = {}
    for mutant in every:
        by_line.setdefault((mutant.path, mutant.line), []).append(mutant)
    mutants = [draw.choice(by_line[line]) for line in chosen]
    print(f"{len(mutants)} of {len(lines)} numerical lines, seed {seed}", flush=True)
    began, copies = time.monotonic(), SimpleQueue[Copy]()
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(jobs) as pool:
        for job in range(jobs):
            copies.put(Copy(Path(folder) / str(job)))

        def judged(mutant: Mutant) -> tuple[Mutant, str]:
            copy = copies.get()
            try:
                near = nearest_tests(mutant, package, tests)
                reach = set().union(*dependents(module_of(mutant.path), package))
                rounds = (near[:NEAR], near[NEAR : NEAR + WIDE])
                return mutant, copy.judge(mutant, rounds, reach, timeout)
            finally:
                copies.put(copy)

        survivors = list(_printed(pool.map(judged, mutants)))
    killed = len(mutants) - len(survivors)
    print(
        f"\nkilled {killed} of {len(mutants)} ({100.0 * killed / max(len(mutants), 1):.0f} %) in"
        f" {(time.monotonic() - began) / 60.0:.0f} min; survivors:"
    )
    for mutant in survivors:
        print(f"  {mutant}")


def _printed(results: Iterable[tuple[Mutant, str]]) -> Iterator[Mutant]:
    for mutant, verdict in results:
        print(f"{'killed ' if verdict else 'SURVIVES'} {mutant}  {verdict}", flush=True)
        if not verdict:
            yield mutant


def main() -> None:
    """Read the options and run."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    p.add_argument("--count", type=int, default=200)
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--jobs", type=int, default=2)
    p.add_argument("--only", default="", help="part of a path")
    p.add_argument("--timeout", type=float, default=400.0, help="of one run of tests, s")
    args = p.parse_args()
    run(args.count, args.seed, args.jobs, args.only, args.timeout)


if __name__ == "__main__":
    main()
