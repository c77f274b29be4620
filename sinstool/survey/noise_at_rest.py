"""White noise of gyros at rest, by what of it is left in means over seconds.

A single sample also holds the steps of a laser gyro's counts, vibration, and the sway of a vehicle
in the wind. These stay within an angle, so that they vanish from the rate over longer times;
the random walk of the angle does not. It is at most what any averaging time shows: the Allan
variance at each is that of the white noise, and of all else [1]_.

References
----------
.. [1] IEEE Std 952-1997, annex C.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.earth import EARTH_RATE
from sinstool.methods.alignment.still import WINDOW_NS, StillSpan, Windows
from sinstool.methods.sensor_errors import IMU_GRADES, LIKELY, grade_by_noise

# Averaging times of which a rest holds fewer than this show little, and so do shorter rests, s.
LEAST_TIMES, LEAST_S = 10, 30.0
_WINDOW_S = WINDOW_NS * 1e-9


def walk_of_means(windows: Windows, rest: StillSpan) -> float | None:
    """Random walk of angle, rad/sqrt(s) of an axis, by means over seconds of a rest.

    None where the rest is short, or where its mean rate is not that of the Earth: gyros so good
    show it, and a driver that takes the mean off at rest makes any gyro seem as good.

    Parameters
    ----------
    rest : StillSpan
        Of these windows.
    """
    walks = _walks(windows, windows.gyro, rest)
    if walks is None:
        return None
    walk = float(walks.min())
    bias = IMU_GRADES[grade_by_noise(walk)].gyro_bias
    by_chance = walks[-1] / np.sqrt(rest.duration_s)
    off = abs(float(np.linalg.norm(rest.gyro)) - EARTH_RATE)
    return walk if off <= LIKELY * np.hypot(bias, by_chance) else None


def velocity_walk_of_means(windows: Windows, rest: StillSpan) -> float | None:
    """Random walk of velocity, (m/s)/sqrt(s) of an axis, by means over seconds of a rest.

    What shakes the vehicle at rest, such as an engine, is not in them, or little of it. None where
    the rest is short.
    """
    walks = _walks(windows, windows.accel, rest)
    return None if walks is None else float(walks.min())


def _walks(windows: Windows, values: FloatArray, rest: StillSpan) -> FloatArray | None:
    """Random walks by means over several lengths; None where the rest is short."""
    first, last = np.searchsorted(windows.start_ns, [rest.start_ns, rest.end_ns])
    means = values[first:last]
    if len(means) * _WINDOW_S < LEAST_S or np.any(
        np.diff(windows.start_ns[first:last]) != WINDOW_NS
    ):
        return None
    summed = np.vstack([np.zeros((1, 3)), np.cumsum(means * _WINDOW_S, axis=0)])
    sizes = 2 ** np.arange(int(np.log2(len(means) / LEAST_TIMES)) + 1)
    return np.array([_walk_at(summed, size) for size in sizes.tolist()])


def _walk_at(angle: FloatArray, size: int) -> float:
    """Random walk that gives the Allan deviation of angles at so many windows."""
    change = angle[2 * size :] - 2.0 * angle[size:-size] + angle[: -2 * size]
    return float(np.sqrt(np.mean(change**2) / (2.0 * size * _WINDOW_S)))
