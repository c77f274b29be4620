"""Results of commands as plain values, the contents of ``--json``.

The name of a field is its key and contains its unit. Times in ns, whose names end in ``_ns``, are
strings, because readers of JSON take numbers for doubles, which cannot hold them; NaN and infinity
become null; headings run from 0 to 360 deg.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from math import isfinite
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from sinstool.core.finding import Finding, Severity, exit_status


def as_json(value: Any, name: str = "") -> Any:
    """A value as JSON can hold it.

    Parameters
    ----------
    value : object
        Dataclasses become objects, without fields whose names begin with an underscore; arrays
        become lists.
    name : str, optional
        Its key; integers under keys that end in ``_ns`` become strings.
    """
    if value is None or isinstance(value, (bool, np.bool_)):
        return None if value is None else bool(value)
    if isinstance(value, (int, np.integer)):
        return str(int(value)) if name.endswith("_ns") else int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if isfinite(value) else None
    if isinstance(value, Finding):
        return value.to_json()
    if is_dataclass(value):
        own = {field.name: getattr(value, field.name) for field in fields(value)}
        return as_json({key: part for key, part in own.items() if not key.startswith("_")})
    if isinstance(value, Mapping):
        return {str(key): as_json(part, str(key)) for key, part in value.items()}
    if isinstance(value, np.ndarray):
        return as_json(value.tolist(), name)
    if isinstance(value, (list, tuple)):
        return [as_json(part, name) for part in value]
    return str(value) if isinstance(value, Path) else value


class Result:
    """The result of a command: a dataclass with findings, whose fields are the keys of JSON."""

    SCHEMA: ClassVar[str]
    OPTIONAL: ClassVar[tuple[str, ...]] = ()
    """Keys that are left out if their value is None."""
    findings: tuple[Finding, ...]

    @property
    def exit_status(self) -> int:
        """Exit status of the command: 0, 3 if something was lost or withheld, 1 if it failed."""
        return exit_status(self.findings)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The texts of all findings that are more than notes, the gravest first."""
        worst_first = sorted(self.findings, key=lambda f: -f.severity)
        return tuple(str(f) for f in worst_first if f.severity > Severity.NOTE)

    def to_json(self) -> dict[str, Any]:
        """The values of ``--json``, with the name and version of their schema."""
        values = as_json(self)
        for key in self.OPTIONAL:
            if values[key] is None:
                del values[key]
        return {"schema": self.SCHEMA, **values, "warnings": list(self.warnings)}

    def row(self) -> dict[str, Any]:
        """The values of ``--json`` of one log among many, with ``status`` and ``exit``."""
        values = self.to_json()
        values.setdefault("status", "lost" if self.exit_status else "done")
        return {**values, "exit": self.exit_status}


def compass(heading_deg: float) -> float:
    """A heading from 0 up to 360 deg, clockwise from north."""
    turned = heading_deg % 360.0
    return 0.0 if turned == 360.0 else turned


def fields_in(source: Any, kind: type) -> dict[str, Any]:
    """The fields of a dataclass that are also attributes of a value."""
    names = (field.name for field in fields(kind))
    return {name: getattr(source, name) for name in names if hasattr(source, name)}
