"""Coning algorithms compared on a log: which, against what, and what counts as a difference."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator

from sinstool.config.coning import ConingOptions
from sinstool.core.errors import ConfigurationError
from sinstool.core.options import Group, option
from sinstool.methods.coning.registry import algorithm

# What `compare-coning` takes; of [coning] what says which coning is motion
COMPARISON_OPTIONS = (
    "comparison",
    "coning.passband",
    "coning.stopband",
    "coning.gyro_response",
    "coning.sp_preset",
    "input",
)


class ComparisonOptions(Group):
    """Coning algorithms compared on a log."""

    algorithms: tuple[str, ...] = option(
        (), "coning algorithms (default: ten; with --paper more than it needs)", "A,B,..."
    )
    reference: str = option(
        "auto",
        "what the others are measured against: an algorithm, auto (quatfiter-4), or none",
        "NAME",
    )
    decimate: tuple[Annotated[int, Field(ge=1)], ...] = option(
        (1, 2, 4), "also as if logged at lower rates: one sample of so many", "M,..."
    )
    window: float = option(10.0, "drift is measured in windows of this many seconds", "S", gt=0)
    tolerance: float = option(0.01, "drift that does not matter", "DEG/H", ge=0)
    truth: str | None = option(
        None,
        "true attitude as reference: Imu, QuaternionStamped, PoseStamped or Odometry, or CSV",
        "TOPIC|FILE",
    )
    phase: Literal["consistent", "literal"] = option(
        "consistent", "with --paper: how eq. (20) is read"
    )

    @field_validator("algorithms")
    @classmethod
    def _algorithms(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        for name in names:
            _exists(name)
        return tuple(dict.fromkeys(names))

    @field_validator("reference")
    @classmethod
    def _reference(cls, name: str) -> str:
        if name not in ("auto", "none"):
            _exists(name)
        return name

    @field_validator("decimate")
    @classmethod
    def _native_first(cls, numbers: tuple[int, ...]) -> tuple[int, ...]:
        return tuple(dict.fromkeys((1, *numbers)))


def _exists(name: str) -> None:
    try:
        algorithm(name)
    except ConfigurationError as exc:
        raise ValueError(str(exc)) from exc


def check_comparison(comparison: ComparisonOptions, coning: ConingOptions) -> None:
    """Whether the options of a comparison fit each other.

    Raises
    ------
    ConfigurationError
    """
    if comparison.truth is not None and comparison.reference != "auto":
        raise ConfigurationError("give --truth or --reference, not both")
    if coning.sp_preset == "auto" and coning.passband is None:
        raise ConfigurationError(
            "--sp-preset auto tunes to the coning in a passband", "give --passband HZ"
        )
