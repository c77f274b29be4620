"""What a vehicle may do in a gap of its IMU, by what it does in times as long without one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.timeline import SECOND
from sinstool.methods.alignment.still import WINDOW_NS
from sinstool.survey.imu import Survey

WINDOW_S = WINDOW_NS / SECOND
# Fewer places in a log than this do not show it.
LEAST_PLACES = 40


@dataclass(frozen=True)
class MotionInGaps:
    """Departures from the mean motion on both sides of a time, over the root of its length.

    Attributes
    ----------
    force : float
        Of the velocity increment about the axis with most, m/s/sqrt(s).
    tilt, heading : float
        Of the rotation across the specific force, of one axis, and about it, rad/sqrt(s).
    """

    force: float
    tilt: float
    heading: float


def motion_in_gaps(survey: Survey, most_s: float) -> MotionInGaps | None:
    """Motion to expect in a log's gaps, from its windows of half a second.

    It is that of the livelier half of the log: a vehicle that stands half of the time moves in its
    gaps as much as another. The length of time is that of the longest gap, as departures grow
    faster than the root of it.

    Parameters
    ----------
    most_s : float
        Longer gaps are not bridged.

    Returns
    -------
    MotionInGaps or None
        None without gaps, or where too little of the log is without.
    """
    lengths = [s for _, s in survey.gaps if s <= most_s]
    if not lengths:
        return None
    count = int(np.ceil(max(lengths) / WINDOW_S))
    windows, wide = survey.windows, count + 2
    if len(windows) < wide + LEAST_PLACES:
        return None
    sums = np.cumsum(np.concatenate([np.zeros((1, 6)), _motion(survey)]), axis=0)
    first = np.arange(len(windows) - wide + 1)
    # Windows in a row, all of them full
    apart = windows.start_ns[first + wide - 1] - windows.start_ns[first]
    full = windows.count >= 0.9 * np.median(windows.count)
    holes = np.cumsum(np.concatenate([[0], ~full]))
    good = (holes[first + wide] == holes[first]) & (apart < (wide - 0.5) * WINDOW_S * SECOND)
    first = first[good]
    if len(first) < LEAST_PLACES:
        return None
    inside = sums[first + wide - 1] - sums[first + 1]
    sides = sums[first + wide] - sums[first] - inside
    departure = inside - 0.5 * count * sides
    up = sums[first + wide, 3:] - sums[first, 3:]
    up = up / np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-9)
    about = np.einsum("ni,ni->n", departure[:, :3], up)
    across = np.square(departure[:, :3]).sum(axis=1) - about**2
    root = np.sqrt(count * WINDOW_S)
    return MotionInGaps(
        force=max(_lively(np.square(column)) for column in departure[:, 3:].T) / root,
        tilt=_lively(0.5 * across) / root,
        heading=_lively(about**2) / root,
    )


def _motion(survey: Survey) -> FloatArray:
    """Rotation and velocity increment of each window, shape (n, 6)."""
    windows = survey.windows
    return WINDOW_S * np.concatenate([windows.gyro, windows.accel], axis=1)


def _lively(squares: FloatArray) -> float:
    """Root of the mean of the larger half."""
    half = np.sort(squares)[len(squares) // 2 :]
    return float(np.sqrt(half.mean()))
