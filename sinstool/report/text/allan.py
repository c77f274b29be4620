"""The text of `sinstool allan`: a figure for each term and axis, in the units of data sheets."""

from __future__ import annotations

import click

from sinstool.core.english import in_seconds
from sinstool.core.units import ARCSEC, DEGREE_PER_HOUR, DEGREE_PER_ROOT_HOUR, MICRO_G
from sinstool.methods.allan.coefficients import Coefficient, Sensor
from sinstool.pipelines.allan.result import AllanResult, Axis
from sinstool.report.text.table import aligned, table

# Of each term: what it is called, its unit on data sheets, and that in SI
SHOWN: dict[Sensor, dict[str, tuple[str, str, float]]] = {
    "gyro": {
        "quantisation": ("quantisation", "arcsec", ARCSEC),
        "white": ("angle random walk", "deg/sqrt(h)", DEGREE_PER_ROOT_HOUR),
        "flicker": ("bias instability", "deg/h", DEGREE_PER_HOUR),
        "random_walk": ("rate random walk", "deg/h/sqrt(h)", DEGREE_PER_HOUR / 60.0),
        "ramp": ("rate ramp", "deg/h/h", DEGREE_PER_HOUR / 3600.0),
    },
    "accel": {
        "quantisation": ("quantisation", "m/s", 1.0),
        "white": ("velocity random walk", "ug/sqrt(Hz)", MICRO_G),
        "flicker": ("bias instability", "ug", MICRO_G),
        "random_walk": ("acceleration random walk", "ug/sqrt(h)", MICRO_G / 60.0),
        "ramp": ("acceleration ramp", "ug/h", MICRO_G / 3600.0),
    },
}
TITLES: dict[Sensor, str] = {"gyro": "gyro", "accel": "accelerometer"}


def print_noise(result: AllanResult) -> None:
    """Print the measured noise."""
    rest = result.rest
    count = len(rest.stretches)
    lengths = f"{count} stretches, the longest {rest.longest_s:.1f} s" if count > 1 else "a stretch"
    table(
        [
            ("log", result.input.path),
            ("IMU", f"{result.imu.topic}, {1.0 / rest.interval_s:.6g} Hz"),
            ("rest", f"{rest.total_s:.1f} s in {lengths}; averaging times up to"
             f" {in_seconds(result.averaging_s[-1])}"),
        ]
        + ([("written", result.output)] if result.output else [])
    )  # fmt: skip
    for sensor in ("gyro", "accel"):
        click.echo("")
        for line in aligned(_rows(result, sensor), (False, False, *(False,) * 3)):
            click.echo(line)


def _rows(result: AllanResult, sensor: Sensor) -> list[tuple[str, ...]]:
    axes = result.of(sensor)
    rows = [(TITLES[sensor], "unit", *(axis.axis for axis in axes))]
    for term, (name, unit, size) in SHOWN[sensor].items():
        rows.append((name, unit, *(_cell(axis, term, size) for axis in axes)))
    return rows


def _cell(axis: Axis, term: str, size: float) -> str:
    if axis.status != "measured":
        return axis.status
    return shown(axis.coefficients[term], size)


def shown(coefficient: Coefficient, size: float) -> str:
    """A coefficient in some unit: with its 95 % interval, or the bound that it is below."""
    if coefficient.value is None:
        return f"below {coefficient.high / size:.3g}"
    low, high = coefficient.low / size, coefficient.high / size
    return f"{coefficient.value / size:.4g} ({low:.4g} to {high:.4g})"
