"""Options of a turntable rig, and of the calibration of its heading-sensitive error."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator

from sinstool.config.logs import RIG_INPUT
from sinstool.core.options import Group, option

# What `calibrate-hse` takes
CALIBRATION_OPTIONS = (*RIG_INPUT, "calibration", "output.overwrite")


def _rig(table: dict[str, Any]) -> dict[str, Any]:
    from sinstool.methods.hse.rig import from_table

    from_table(table)  # complains with the path of the key
    return table


RigTable = Annotated[dict[str, Any], AfterValidator(_rig)]
"""The table ``[rig]``; see :func:`sinstool.methods.hse.rig.from_table`."""


class CalibrationOptions(Group):
    """How the heading-sensitive error is calibrated."""

    title = "Calibration"

    method: Literal["joint", "heading", "axial"] = option(
        "joint",
        "joint: slope of heading over rate and the encoder's delay, from all azimuths. heading:"
        " slope of heading alone. axial: gyro rate along the axis against the encoder",
        brief="joint (heading and encoder, the default), heading, or axial (gyro against encoder)",
    )
    form: Literal["regressor", "paper"] = option(
        "regressor",
        "with --method heading: a weighted regression, or the paper's unweighted line through the"
        " mean at each rate",
    )
    weights: Literal["turns", "equal"] = option(
        "turns", "weights of the runs: by the scatter of their turns, or equal"
    )
    drift: bool = option(False, "also estimate a drift of heading with time")
    settle: float = option(
        2.0,
        "time left out at both ends of a stretch at constant rate, in s",
        "S",
        brief="time left out at both ends of a stretch, in s (default: 2)",
        ge=0,
    )
    min_turns: int = option(
        10,
        "whole turns that a run must have",
        "N",
        brief="whole turns that a run must have (default: 10)",
        ge=1,
    )
    min_duration: float = option(60.0, "shortest run, in s", "S", gt=0)
    align_duration: float = option(
        600.0, "longer stretches are split into repeats of this length, in s", "S", gt=0
    )
    skip_warmup: float = option(
        0.0,
        "time left out at the start of every log, in s",
        "S",
        brief="time left out at the start of every log, in s (default: 0)",
        ge=0,
    )
    exclude: tuple[str, ...] = option(
        (),
        "runs to leave out, by ID; repeatable",
        "ID",
        brief="runs to leave out, by ID; repeatable",
    )
    azimuth: tuple[str, ...] = option(
        (),
        "azimuth of the base in a log, in degrees, for the table of headings; repeatable",
        "LOG=DEG",
        brief="azimuth of the base in a log, in degrees; repeatable",
    )
    keep_outliers: bool = option(
        False, "keep outlying repeats, which by default are left out and listed"
    )
    level_rate: Literal["off", "auto", "on"] = option(
        "off", "remove the rate at which the base tilts, as the accelerometers show it"
    )
    gyro_bias_sigma: float = option(
        0.003, "uncertainty of each gyro's bias, deg/h (axial method)", "DEG/H", ge=0
    )


class HseOptions(Group):
    """Compensation of the heading-sensitive error."""

    title = "Heading-sensitive error"

    hse: str | None = option(
        None,
        "calibration written by calibrate-hse, for a log of the same rig; corrects the heading in"
        " every stretch at constant rate",
        "FILE",
        brief="correct the heading by this calibration",
    )
    force: bool = option(
        False, "apply a calibration of another rig, or one that is not significant"
    )
