"""A turntable rig, and how its heading-sensitive error is calibrated from its logs."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator

from sinstool.core.options import Group, option


def _rig(table: dict[str, Any]) -> dict[str, Any]:
    from sinstool.methods.hse.rig import from_table

    from_table(table)  # complains with the path of the key
    return table


RigTable = Annotated[dict[str, Any], AfterValidator(_rig)]
"""The table ``[rig]``; see :func:`sinstool.methods.hse.rig.from_table`."""


class CalibrationOptions(Group):
    """How the heading-sensitive error is calibrated."""

    method: Literal["joint", "heading", "axial"] = option(
        "joint",
        "joint: slope of heading over rate and the encoder's delay, from all azimuths;"
        " heading: slope of heading alone; axial: gyro rate along the axis against the encoder",
    )
    form: Literal["regressor", "paper"] = option(
        "regressor",
        "of --method heading; paper: the published unweighted line through the mean at each rate",
    )
    weights: Literal["turns", "equal"] = option(
        "turns", "of the runs: by the scatter of their turns, or all the same"
    )
    drift: bool = option(False, "estimate a drift of heading with time too")
    settle: float = option(
        2.0, "seconds left out at both ends of a stretch at constant rate", "S", ge=0
    )
    min_turns: int = option(10, "whole turns that a run needs", "N", ge=1)
    min_duration: float = option(60.0, "seconds that a run needs", "S", gt=0)
    align_duration: float = option(
        600.0, "longer stretches are split into repeats of this many seconds", "S", gt=0
    )
    skip_warmup: float = option(0.0, "seconds left out after the start of every log", "S", ge=0)
    exclude: tuple[str, ...] = option((), "runs to leave out, by their ID", "ID")
    azimuth: tuple[str, ...] = option(
        (), "LOG=DEG: azimuth that the stand showed, for the table of headings", "LOG=DEG"
    )
    keep_outliers: bool = option(
        False, "use repeats that do not belong too (by default they are left out and named)"
    )
    level_rate: Literal["off", "auto", "on"] = option(
        "off", "take out the rate at which the base tilts, seen by the accelerometers"
    )
    gyro_bias_sigma: float = option(
        0.003, "deg/h, what is not known of each gyro's bias (axial method)", "DEG/H", ge=0
    )


class HseOptions(Group):
    """Heading-sensitive error, to be taken out."""

    hse: str | None = option(
        None,
        "calibration written by calibrate-hse: the log is of its rig, whose heading is"
        " corrected in every stretch at constant rate",
        "FILE",
    )
    force: bool = option(
        False, "apply a calibration of another rig, or one that is not significant"
    )
