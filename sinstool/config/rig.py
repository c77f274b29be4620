"""A turntable rig, and how its heading-sensitive error is calibrated from its logs."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field

from sinstool.config.group import Group
from sinstool.methods.hse.rig import from_table


def _rig(table: dict[str, Any]) -> dict[str, Any]:
    from_table(table)  # complains with the path of the key
    return table


RigTable = Annotated[dict[str, Any], AfterValidator(_rig)]
"""The table ``[rig]``; see :func:`sinstool.methods.hse.rig.from_table`."""


class CalibrationOptions(Group):
    """How the heading-sensitive error is calibrated."""

    method: Literal["joint", "heading", "axial"] = Field(
        "joint",
        description="joint: slope of heading over rate and the encoder's delay, from all azimuths;"
        " heading: slope of heading alone; axial: gyro rate along the axis against the encoder",
    )
    form: Literal["regressor", "paper"] = Field(
        "regressor",
        description="of --method heading; paper: the published unweighted line through the mean at"
        " each rate",
    )
    weights: Literal["turns", "equal"] = Field(
        "turns", description="of the runs: by the scatter of their turns, or all the same"
    )
    drift: bool = Field(False, description="estimate a drift of heading with time too")
    settle: float = Field(
        2.0, ge=0, description="seconds left out at both ends of a stretch at constant rate"
    )
    min_turns: int = Field(10, ge=1, description="whole turns that a run needs")
    min_duration: float = Field(60.0, gt=0, description="seconds that a run needs")
    align_duration: float = Field(
        600.0, gt=0, description="longer stretches are split into repeats of this many seconds"
    )
    skip_warmup: float = Field(
        0.0, ge=0, description="seconds left out after the start of every log"
    )
    exclude: tuple[str, ...] = Field((), description="runs to leave out, by their ID")
    azimuth: tuple[str, ...] = Field(
        (), description="LOG=DEG: azimuth that the stand showed, for the table of headings"
    )
    keep_outliers: bool = Field(
        False, description="use repeats that do not belong too (by default they are left out, told)"
    )
    level_rate: Literal["off", "auto", "on"] = Field(
        "off", description="take out the rate at which the base tilts, seen by the accelerometers"
    )
    gyro_bias_sigma: float = Field(
        0.003, ge=0, description="deg/h, what is not known of each gyro's bias (axial method)"
    )


class HseOptions(Group):
    """Heading-sensitive error, to be taken out."""

    hse: str | None = Field(
        None,
        description="calibration written by calibrate-hse: the log is of its rig, whose heading is"
        " corrected in every stretch at constant rate",
    )
    force: bool = Field(
        False, description="apply a calibration of another rig, or one that is not significant"
    )
