"""The keys of ``--json``, made from the dataclasses that hold the results."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from itertools import groupby
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

from sinstool.core.finding import Finding
from sinstool.pipelines.align.result import AlignResult
from sinstool.pipelines.allan.result import AllanResult
from sinstool.pipelines.export.result import ExportResult
from sinstool.pipelines.info.result import Inspection
from sinstool.pipelines.plan import Choice
from sinstool.pipelines.process.errors_against_truth import RunErrors
from sinstool.pipelines.process.filter_used import FilterUsed
from sinstool.pipelines.process.height_used import HeightDamping
from sinstool.pipelines.process.result import ProcessResult
from sinstool.pipelines.process.vehicle_used import VehicleUsed

RESULTS: dict[str, type] = {
    "process": ProcessResult,
    "info": Inspection,
    "align": AlignResult,
    "allan": AllanResult,
    "export": ExportResult,
}
# Names that the classes import for type checking only; those of private fields do not matter.
NAMES = {
    **{kind.__name__: kind for kind in (RunErrors, VehicleUsed, FilterUsed, HeightDamping)},
    "FilterStart": object,
}
# The page describes the keys that stand for these.
ELSEWHERE = {(AllanResult, "axes")}
WORDS = {str: "text", int: "integer", float: "number", bool: "true or false", Finding: "finding",
         Choice: "choice", np.ndarray: "list of numbers"}  # fmt: skip
ATTRIBUTES = re.compile(r"^Attributes\n-+\n(.*?)(?=^\w[\w ]*\n-{3,}$|\Z)", re.DOTALL | re.MULTILINE)
ROLE = re.compile(r":\w+:`~?(?:[\w.]*\.)?(\w+)`")
ENTRY = re.compile(r"^(\S.*)\n((?:^(?: .*)?\n?)*)", re.MULTILINE)


def json_keys(command: str) -> str:
    """A table of the keys for each key at the top.

    Raises
    ------
    ValueError
        There is no such result, or a field has no description.
    """
    if command not in RESULTS:
        raise ValueError(f"no result of {command}")
    tables: dict[str, list[str]] = {}
    alike = groupby(rows(RESULTS[command]), lambda row: (row[0].rpartition(".")[0], row[2]))
    for (_, text), group in alike:
        keys, kinds = zip(*((key, kind) for key, kind, _ in group), strict=True)
        names = [keys[0], *(key.rpartition(".")[2] for key in keys[1:])]
        shown = re.sub(r"\bNone\b", "null", text).replace("<", "&lt;").replace("|", "\\|")
        row = f"| {', '.join(f'`{name}`' for name in names)} | {'; '.join(dict.fromkeys(kinds))} "
        tables.setdefault(re.split(r"[.\[]", keys[0])[0], []).append(f"{row}| {shown} |")
    # Keys without others below them share one table
    single = [table[0] for table in tables.values() if len(table) == 1]
    parts = [single, *(table for table in tables.values() if len(table) > 1)]
    head = ["| key | value | what it is |", "|---|---|---|"]
    return "\n\n".join("\n".join([*head, *part]) for part in parts if part)


def rows(kind: type, prefix: str = "") -> Iterator[tuple[str, str, str]]:
    """Key, kind of value, and description of each field of a dataclass and of those in it."""
    described, hints = descriptions(kind), get_type_hints(kind, localns=NAMES)
    for field in fields(kind):
        name, key = field.name, prefix + field.name
        if name.startswith("_") or (kind, name) in ELSEWHERE:
            continue
        if name not in described:
            raise ValueError(f"{kind.__name__}.{name} has no description")
        word, many, inner = _word(hints[name], name)
        yield key, word, described[name]
        for one in inner:
            yield from rows(one, f"{key}{'[]' if many else ''}.")


def descriptions(kind: type) -> dict[str, str]:
    """What the docstring of a dataclass, and of those that it extends, says of each attribute."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__[:-1]):
        listed = ATTRIBUTES.search(inspect.cleandoc(vars(base).get("__doc__") or ""))
        for head, text in ENTRY.findall(listed[1] + "\n" if listed else ""):
            words = ROLE.sub(r"`\1`", " ".join(text.split())).replace("``", "`")
            found |= dict.fromkeys(head.partition(" : ")[0].split(", "), words)
    return found


def _word(hint: Any, name: str) -> tuple[str, bool, list[type]]:
    """A type in words, whether it is a list, and the dataclasses in it whose keys follow."""
    options = [one for one in get_args(hint) if one is not type(None)]
    null = " or null" if type(None) in get_args(hint) else ""
    origin = get_origin(hint)
    if origin is tuple:
        word, _, inner = _word(options[0], name)
        return f"list of {word.removesuffix(' or null').removeprefix('list of ')}s", True, inner
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return "object", False, []
    if options and origin is not None:
        words = [_word(one, name) for one in options]
        shown = dict.fromkeys(word for word, _, _ in words)
        inner = [one for _, _, kinds in words for one in kinds]
        return " or ".join(shown) + null, any(many for _, many, _ in words), inner
    if hint is int and name.endswith("_ns"):
        return "text, ns", False, []
    if hint in WORDS:
        return WORDS[hint], False, []
    if is_dataclass(hint) and isinstance(hint, type):
        return "object", False, [hint]
    return "text", False, []
