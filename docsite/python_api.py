"""The page of the Python API, made from the docstrings of `import sinstool`."""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Iterator
from typing import Any

import sinstool

# In the order of a session; classes stand beside the functions that give them.
ORDER = (
    "open_log", "Log", "survey", "process", "Result", "align", "navigate", "integrate", "Imu",
    "allan", "compare_coning", "coning", "calibrate_hse", "simulate", "Simulated", "Solution",
    "GnssEpochs", "Baro", "BaroHeight", "Magnetometer", "Finding", "SinstoolError",
)  # fmt: skip
# Given by functions, and not names of their own
GIVEN = {
    "Simulated": "sinstool.api.simulate",
    "Finding": "sinstool.core.finding",
    **dict.fromkeys(
        ("Solution", "GnssEpochs", "Baro", "BaroHeight", "Magnetometer"), "sinstool.core.streams"
    ),
}
SECTION = re.compile(r"^(\w[\w ]*)\n-{3,}$", re.MULTILINE)
ROLE = re.compile(r":\w+:`~?(?:[\w.]*\.)?(\w+)`")
LISTS = ("Parameters", "Attributes", "Returns", "Raises")


def python_api() -> str:
    """All of it, as Markdown."""
    left_out = {*sinstool.__all__} - {*ORDER, "__version__"}
    if left_out:
        raise ValueError(f"docsite/python_api.py has no place for {', '.join(sorted(left_out))}")
    return "\n".join(line for name in ORDER for line in _entry(name))


def _value(name: str) -> Any:
    return getattr(importlib.import_module(GIVEN[name]) if name in GIVEN else sinstool, name)


def _entry(name: str) -> Iterator[str]:
    value = _value(name)
    if inspect.ismodule(value):
        yield from (f"## {name}", "", _text(inspect.getdoc(value) or ""), "")
        for one in value.__all__:
            yield from _described(f"{name}.{one}", getattr(value, one), "###")
        return
    yield from _described(name, value, "##")
    if inspect.isclass(value):
        for key, member in _members(value):
            yield from _described(f"{name}.{key}", member, "###")


def _members(kind: type) -> Iterator[tuple[str, Any]]:
    """Public methods and properties; those of all streams are described once, with IMU."""
    bases = kind.__mro__[:-1] if kind is sinstool.Imu else (kind,)
    for base in reversed(bases):
        if base.__module__.startswith("sinstool."):
            for key, member in vars(base).items():
                if not key.startswith("_") and (
                    inspect.isfunction(member) or isinstance(member, (property, classmethod))
                ):
                    yield key, member


def _described(name: str, value: Any, level: str) -> Iterator[str]:
    value = getattr(value, "__func__", value)
    anchor = name.lower().replace(".", "-")
    yield from (f"{level} {name} {{#{anchor}}}", "")
    if inspect.isfunction(value):
        yield from ("```text", _signature(name, value), "```", "")
    yield from _docstring(inspect.getdoc(value) or "")


def _signature(name: str, function: Any) -> str:
    """How it is called, without annotations, which the list of parameters says in words."""
    parts, keywords = [], False
    for p in inspect.signature(function).parameters.values():
        if p.name in ("self", "cls"):
            continue
        if p.kind is p.KEYWORD_ONLY and not keywords:
            parts.append("*")
            keywords = True
        prefix = {p.VAR_POSITIONAL: "*", p.VAR_KEYWORD: "**"}.get(p.kind, "")
        default = "" if p.default is p.empty else f"={p.default!r}"
        parts.append(f"{prefix}{p.name}{default}")
    return f"{name}({', '.join(parts)})"


def _docstring(text: str) -> Iterator[str]:
    """A numpydoc docstring as Markdown."""
    parts = SECTION.split(text)
    yield from (_text(parts[0]), "")
    for title, body in zip(parts[1::2], parts[2::2], strict=True):
        body = body.strip("\n")
        yield from (f"**{title}**", "")
        if title == "Examples":
            yield from ("```pycon", body, "```")
        elif title in LISTS:
            yield from _listed(body)
        else:
            yield _text(body)
        yield ""


def _listed(body: str) -> Iterator[str]:
    """Entries, ``name : type`` with an indented text each."""
    for line, text in re.findall(r"^(\S.*)\n?((?:^(?: .*)?\n?)*)", body, re.MULTILINE):
        name, _, kind = line.partition(" : ")
        names = ", ".join(_linked(one) for one in name.split(", "))
        said = " ".join(text.split())
        yield f"* {names}{f' ({_text(kind)})' if kind else ''}{': ' if said else ''}{_text(said)}"


def _linked(name: str) -> str:
    """A name, or classes with ``or`` between them, with links to what this page describes."""
    parts = name.split(" or ")
    linked = [f"[`{one}`](#{one.lower()})" if one in ORDER else f"`{one}`" for one in parts]
    return " or ".join(linked)


def _text(text: str) -> str:
    """Prose in reStructuredText as Markdown."""
    text = ROLE.sub(r"`\1`", text).replace("``", "`")
    return text.replace("<", "&lt;").strip()
