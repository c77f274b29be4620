"""Figures of noise at rest: Allan deviations of each sensor, with intervals, fits and slopes."""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.units import DEGREE_PER_HOUR, MICRO_G
from sinstool.methods.allan.coefficients import SENSORS, Sensor, over_axes
from sinstool.methods.allan.model import FLICKER
from sinstool.pipelines.allan.result import AllanResult, Axis
from sinstool.pipelines.allan.run import LogNoise
from sinstool.report.figure import Figure, Series
from sinstool.report.figures.parts import both_sides, positive

UNITS: dict[Sensor, tuple[str, float]] = {
    "gyro": ("deg/h", DEGREE_PER_HOUR),
    "accel": ("µg", MICRO_G),
}
TITLES: dict[Sensor, str] = {"gyro": "Gyro", "accel": "Accelerometer"}
SLOPES = {
    "quantisation": "quantisation, slope -1",
    "white": "white noise, slope -1/2",
    "flicker": "bias instability, level",
    "random_walk": "random walk, slope +1/2",
    "ramp": "ramp, slope +1",
}
_GREY = 9


def figures(noise: LogNoise) -> tuple[Figure, ...]:
    """A figure for each sensor of which an axis was measured."""
    return tuple(
        _figure(noise, sensor)
        for sensor in SENSORS
        if any(axis.status == "measured" for axis in noise.result.of(sensor))
    )


def _figure(noise: LogNoise, sensor: Sensor) -> Figure:
    result = noise.result
    unit, size = UNITS[sensor]
    tau = result.averaging_s
    series: list[Series] = []
    for k, axis in enumerate(result.of(sensor)):
        if axis.status != "measured":
            continue
        low, high = noise.band(axis)
        series += [
            Series(axis.axis, positive(axis.deviation / size), tau, colour=k),
            both_sides(f"{axis.axis}, 95 %", tau, low / size, high / size, k),
            Series(
                f"{axis.axis}, terms",
                positive(_terms(axis, tau) / size),
                tau,
                "dashed",
                False,
                k,
            ),
            Series(
                f"{axis.axis}, Hadamard",
                positive(axis.hadamard / size),
                tau,
                "points",
                _drifts(axis),
                k,
            ),
        ]
    series += _slopes(result, sensor, tau, size)
    values = np.concatenate([a.deviation for a in result.of(sensor) if a.status == "measured"])
    least, most = float(np.min(values)) / size, float(np.max(values)) / size
    return Figure(
        f"allan_{sensor}",
        f"{TITLES[sensor]}: Allan deviation",
        tau,
        tuple(series),
        "averaging time, s",
        f"deviation, {unit}",
        log_x=True,
        log_y=True,
        y_range=(0.3 * least, 2.0 * most),
        notes=(
            "Each axis with the 95 % interval of its deviations. Grey lines are the visible terms,"
            " over the axes; the legend also shows those of an axis together, and the Hadamard"
            " deviation, which a steady drift leaves alone.",
        ),
    )


def _drifts(axis: Axis) -> bool:
    """Whether a drift dominates the Allan but not the Hadamard deviation, which ignores drift."""
    ramp = axis.coefficients.get("ramp")
    return ramp is not None and ramp.value is not None


def curve(term: str, value: float, tau: FloatArray) -> FloatArray:
    """Allan deviation of one term, by its coefficient in SI units."""
    slopes = {
        "quantisation": np.sqrt(3.0) / tau,
        "white": 1.0 / np.sqrt(tau),
        "flicker": np.full(len(tau), np.sqrt(FLICKER)),
        "random_walk": np.sqrt(tau / 3.0),
        "ramp": tau / np.sqrt(2.0),
    }
    return np.asarray(value * slopes[term])


def _terms(axis: Axis, tau: FloatArray) -> FloatArray:
    """Sum of all visible terms of an axis, over the range of the fit."""
    parts = [curve(t, c.value, tau) ** 2 for t, c in axis.coefficients.items() if c.value]
    total = np.sqrt(np.sum(parts, axis=0)) if parts else np.full(len(tau), np.nan)
    return np.where(tau >= 0.999 * axis.from_s, total, np.nan)


def _slopes(result: AllanResult, sensor: Sensor, tau: FloatArray, size: float) -> list[Series]:
    lines = []
    for term, name in SLOPES.items():
        coefficient = over_axes(result.noise.of(sensor), term)
        if coefficient is not None and coefficient.value is not None:
            y = positive(curve(term, coefficient.value, tau) / size)
            lines.append(Series(name, y, tau, colour=_GREY))
    return lines
