"""Noise coefficients of inertial sensors in SI units, and a filter's settings from them.

With samples ``dt`` apart a variance p of :mod:`sinstool.methods.allan.model` is, by IEEE Std
952-1997, annex C:

==============  =====================  ============================================
term            coefficient            unit for a gyro, for an accelerometer
==============  =====================  ============================================
quantisation    Q = sqrt(p) dt         rad, m/s
white           N = sqrt(p dt)         rad/sqrt(s), (m/s)/sqrt(s)
flicker         B = sqrt(p)            rad/s, m/s^2
random walk     K = sqrt(p / dt)       (rad/s)/sqrt(s), (m/s^2)/sqrt(s)
ramp            R = r / dt             rad/s^2, m/s^3
==============  =====================  ============================================
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import hypot, sqrt
from typing import Literal

import numpy as np

from sinstool.methods.allan.likelihood import NAMES, NoiseFit
from sinstool.methods.sensor_errors import SensorGrade

Sensor = Literal["gyro", "accel"]
SENSORS: tuple[Sensor, ...] = ("gyro", "accel")
AXES = ("x", "y", "z")
# Powers of the sampling interval that turn samples into seconds
_POWERS = {"quantisation": 1.0, "white": 0.5, "flicker": 0.0, "random_walk": -0.5, "ramp": -1.0}
# The largest Allan deviation of a first-order Markov process of 1 sigma is 0.6176 (IEEE Std
# 952-1997, eq. C.22, at 1.89 correlation times); that of flicker noise is 0.6643 B.
MARKOV_OF_FLICKER = 0.6643 / 0.6176

# Density of a vehicle's own accelerations, (m/s)/sqrt(s): 0.7 m/s^2 for 5 s each, say.
MANOEUVRE = 2.2


@dataclass(frozen=True)
class Coefficient:
    """One coefficient in SI units.

    Attributes
    ----------
    value : float or None
        None where the data does not show it.
    low, high : float
        The 95 % interval; of what is not visible 0 and an upper bound.
    """

    value: float | None
    low: float
    high: float


AxisNoise = Mapping[str, Coefficient]
"""Coefficients of one axis by the names of the terms."""

SensorNoise = Mapping[str, AxisNoise]
"""Those of the axes that were measured, by their letters."""


@dataclass(frozen=True)
class ImuNoise:
    """Noise of an IMU as it was measured at rest.

    Attributes
    ----------
    gyro, accel : mapping of str to mapping
        Axes that could be measured.
    rate_hz : float
        Of the samples it was measured on.
    """

    gyro: SensorNoise
    accel: SensorNoise
    rate_hz: float

    def of(self, sensor: Sensor) -> SensorNoise:
        """Noise of one of the two sensors."""
        return self.gyro if sensor == "gyro" else self.accel


def coefficients(fit: NoiseFit, interval: float) -> dict[str, Coefficient]:
    """Coefficients of a fit to samples so many seconds apart."""
    by_name = {}
    for name in NAMES:
        term, unit = fit.terms[name], interval ** _POWERS[name]
        value = None if term.value is None else term.value * unit
        by_name[name] = Coefficient(value, term.low * unit, term.high * unit)
    return by_name


def over_axes(noise: SensorNoise, term: str) -> Coefficient | None:
    """One figure for all axes: the root mean square over those that show the term.

    Returns
    -------
    Coefficient or None
        Where no axis shows it, the largest of their bounds. None where no axis was measured.
    """
    axes = [axis[term] for axis in noise.values() if term in axis]
    if not axes:
        return None
    visible = [axis for axis in axes if axis.value is not None]
    if not visible:
        return Coefficient(None, 0.0, max(axis.high for axis in axes))
    mean = [_rms([getattr(axis, name) for axis in visible]) for name in ("value", "low", "high")]
    return Coefficient(*mean)


def _rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def as_measured(noise: ImuNoise, grade: SensorGrade, scale_states: bool = False) -> SensorGrade:
    """Errors of a grade, with the noise that was measured in place of the grade's.

    A filter has one state for each bias: flicker noise becomes a first-order Markov process with
    the same largest Allan deviation, and a random walk adds to what drives it. Of a term that the
    rest was too short to show the grade's value stays, but for the bound where that is less.

    Parameters
    ----------
    grade : SensorGrade
        For what no rest shows: biases at the start, scale factors, correlation times.
    scale_states : bool, optional
        The filter has states for the scale factors of the accelerometers. In one that has none,
        what they do in manoeuvres counts as white noise.
    """
    changes: dict[str, float] = {}
    walks = {"gyro": "angle_random_walk", "accel": "velocity_random_walk"}
    for sensor in SENSORS:
        measured = noise.of(sensor)
        white = over_axes(measured, "white")
        if white is not None and white.value is not None:
            changes[walks[sensor]] = white.value
        instability = f"{sensor}_instability"
        changes[instability] = wandering(measured, getattr(grade, instability), grade.bias_time_s)
    if not scale_states:
        walk = changes.get("velocity_random_walk", grade.velocity_random_walk)
        changes["velocity_random_walk"] = hypot(walk, MANOEUVRE * grade.accel_scale)
    return replace(grade, **changes)


def wandering(noise: SensorNoise, assumed: float, time_s: float) -> float:
    """Standard deviation of the Markov process that stands for flicker noise and random walk.

    That of the worst axis: an accelerometer on which gravity rests shows its scale factor too.

    Parameters
    ----------
    assumed : float
        What to take as far as nothing is visible.
    time_s : float
        Its correlation time.
    """
    # A Markov process with this sigma is driven as the random walk is
    of_walk = sqrt(0.5 * time_s)
    visible, bounds = [], []
    for axis in noise.values():
        if "flicker" in axis and "random_walk" in axis:
            flicker, walk = axis["flicker"], axis["random_walk"]
            bounds.append(hypot(MARKOV_OF_FLICKER * flicker.high, of_walk * walk.high))
            if flicker.value is not None or walk.value is not None:
                slow = MARKOV_OF_FLICKER * (flicker.value or 0.0), of_walk * (walk.value or 0.0)
                visible.append(hypot(*slow))
    if visible:
        return max(visible)
    return min([assumed, *([max(bounds)] if bounds else [])])
