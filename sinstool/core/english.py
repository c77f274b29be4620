"""Counts, and other numbers, in sentences."""

from __future__ import annotations


def counted(count: int, noun: str) -> str:
    """A count with its noun, whose plural is regular: "1 gap", "2 gaps", "2 fixes"."""
    ending = "" if count == 1 else "es" if noun.endswith(("x", "ch")) else "s"
    return f"{count} {noun}{ending}"


def counted_clause(count: int, noun: str, verb: str, verbs: str) -> str:
    """A count, its noun and the verb that agrees: "1 sample holds", "2 samples hold"."""
    return f"{counted(count, noun)} {verb if count == 1 else verbs}"


def in_seconds(value: float, digits: int = 4) -> str:
    """A length of time with so many digits, or all of its whole seconds: "0.25 s", "28800 s"."""
    text = f"{value:.{digits}g}"
    return f"{value:.0f} s" if "e+" in text else f"{text} s"


def heading_text(heading_deg: float, digits: int) -> str:
    """A heading from 0 up to 360 deg, clockwise from north: what is rounded to 360 is 0."""
    return f"{round(heading_deg, digits) % 360.0:.{digits}f}"
