"""Lines that can be changed, and which functions feel a change: for ``mutants.py``."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

WHERE = ("sinstool/methods", "sinstool/pipelines")
SWAPPED = {
    ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.MatMult: "-",
    ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!=", ast.NotEq: "==",
}  # fmt: skip
NAMES = {"sin": "cos", "cos": "sin", "minimum": "maximum", "maximum": "minimum", "min": "max"}
MODULE = "<module>"
# Decorators of what numba compiles
COMPILING = {"njit", "kernel", "part"}


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
        Function that the line is in, with the classes and functions around it.
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
        self.inside, self.around = MODULE, ""
        self.found: list[Mutant] = []

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        outer = self.inside, self.around
        self.inside = self.around + node.name
        self.around = f"{self.inside}.<locals>."
        for statement in node.body:
            self.visit(statement)
        self.inside, self.around = outer

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        outer, self.around = self.around, f"{self.around}{node.name}."
        for statement in node.body:
            if isinstance(statement, ast.FunctionDef):
                self.visit(statement)
        self.around = outer

    def visit_Raise(self, _: ast.Raise) -> None:
        """What an error says is no number."""

    def visit_JoinedStr(self, _: ast.JoinedStr) -> None:
        """Nor is a text."""

    def visit_Call(self, node: ast.Call) -> None:
        """Nor are words that are joined, or a line of the log; a size of -1 may be -2 as well."""
        if isinstance(node.func, ast.Attribute):
            if isinstance(node.func.value, ast.Constant):
                return
            if node.func.attr == "reshape":
                node.args = [one for one in node.args if not isinstance(one, ast.UnaryOp)]
        elif isinstance(node.func, ast.Name) and node.func.id == "log_choice":
            return
        self.generic_visit(node)

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


@dataclass(frozen=True)
class Function:
    """A function, and the names in it.

    Attributes
    ----------
    path, inside : str
        As in :class:`Mutant`.
    line : int
        The first, decorators included: numba names its files by it.
    compiled : bool
        Whether numba compiles it.
    names : frozenset of str
        All that it and the functions in it refer to, attributes too.
    """

    path: str
    inside: str
    line: int
    compiled: bool
    names: frozenset[str]

    @property
    def name(self) -> str:
        return self.inside.rpartition(".")[2]


def _names(node: ast.AST) -> frozenset[str]:
    every = ast.walk(node)
    return frozenset(
        n.id if isinstance(n, ast.Name) else n.attr
        for n in every
        if isinstance(n, ast.Name | ast.Attribute)
    )


def _functions(path: str, body: list[ast.stmt], around: str, compiled: bool) -> Iterator[Function]:
    for node in body:
        if isinstance(node, ast.ClassDef):
            yield from _functions(path, node.body, f"{around}{node.name}.", compiled)
        elif isinstance(node, ast.FunctionDef):
            own = compiled or any(COMPILING & _names(d) for d in node.decorator_list)
            line = min([node.lineno, *(d.lineno for d in node.decorator_list)])
            inside = around + node.name
            yield Function(path, inside, line, own, _names(node))
            yield from _functions(path, node.body, f"{inside}.<locals>.", own)


class Program:
    """Who refers to whom, by name: too many rather than too few."""

    def __init__(self, root: Path) -> None:
        self.functions: list[Function] = []
        self.tables: list[tuple[str, frozenset[str], frozenset[str]]] = []
        """Files, names that they set outside of functions, and names that these are made of."""
        for folder in ("sinstool", "tests"):
            for path in sorted((root / folder).rglob("*.py")):
                name = str(path.relative_to(root))
                body = ast.parse(path.read_bytes()).body
                self.functions += _functions(name, body, "", False)
                for node in body:
                    if isinstance(node, ast.Assign | ast.AnnAssign) and node.value:
                        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                        left = frozenset[str]().union(*map(_names, targets))
                        self.tables.append((name, left, _names(node.value)))
        self.at = {(f.path, f.inside): f for f in self.functions}

    def compiled_with(self, mutant: Mutant) -> tuple[set[Function], set[str]]:
        """Compiled functions that hold a mutant or call what does, and the names of all these."""
        own = self.at[mutant.path, mutant.inside]
        if not own.compiled:
            return set(), set()
        # A function that stands in another is known by that one's name outside of it.
        names = {part.rpartition(".")[2] for part in own.inside.split(".<locals>.")}
        found = {own}
        grown = True
        while grown:
            new = {f for f in self.functions if f.compiled and f not in found and f.names & names}
            more = {n for _, left, right in self.tables if right & names for n in left} - names
            found |= new
            more |= {f.name for f in new} - names
            names |= more
            grown = bool(more)
        return found, names

    def reached_from(self, mutant: Mutant) -> set[tuple[str, str]]:
        """Functions, not compiled ones, from which a mutant is run: paths and names in them."""
        found, names = self.compiled_with(mutant)
        result = {(mutant.path, mutant.inside)}
        if found:
            result |= {(f.path, f.inside) for f in self.functions if f.names & names}
        return result
