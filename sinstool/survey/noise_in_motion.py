"""White noise of an IMU that moves, by what changes from one sample to the next."""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray
from sinstool.core.order_statistics import median
from sinstool.methods.alignment.still import WINDOW_NS
from sinstool.survey.source import Source

# Windows in motion, and at rest, that show it.
LEAST_MOVING, LEAST_STILL = 60, 8
# Means of windows at rest scatter by chance as if a filter had taken off less than this.
LEAST_FILTERED = 1.3
# The median of the mean square of three unit normals.
MEDIAN_OF_THREE = 0.789


def walks_in_motion(source: Source) -> tuple[float, float] | None:
    """Random walks in motion, of angle, rad/sqrt(s), and of velocity, (m/s)/sqrt(s), of an axis.

    Motion of the vehicle lasts for many samples, and noise for one: the noise is no more than what
    high differences of neighbours show. A sensor's own filter makes these small; how much, a rest
    shows, whatever shakes it there: noise that a filter lets pass scatters the means of windows.

    Returns
    -------
    tuple of float, or None
        None where the log moves or rests too little.
    """
    windows = source.survey.windows
    still = np.zeros(len(windows), np.bool_)
    for span in source.survey.spans:
        first, last = np.searchsorted(windows.start_ns, [span.start_ns, span.end_ns])
        still[first:last] = True
    if np.count_nonzero(~still) < LEAST_MOVING or np.count_nonzero(still) < LEAST_STILL:
        return None
    axis = np.sqrt(source.survey.duration_s / windows.count.sum() / 3.0)
    walks: list[float] = []
    for fast, mean in ((windows.gyro_fast, windows.gyro), (windows.accel_fast, windows.accel)):
        moving, resting = (axis * _median_known(fast[rows]) for rows in (~still, still))
        if not resting > 0.0:
            return None
        filtered = _of_means(mean, still) / resting
        walks.append(moving * filtered if filtered > LEAST_FILTERED else moving)
    return (walks[0], walks[1]) if min(walks) > 0.0 else None


def _median_known(values: FloatArray) -> float:
    """Median of those that are not NaN; NaN where there is none."""
    return float(median(values[~np.isnan(values)]))


def _of_means(mean: FloatArray, still: BoolArray) -> float:
    """Random walk by the means of windows at rest, less what drifts; NaN without three in a row."""
    inside = still[2:] & still[1:-1] & still[:-2]
    if not inside.any():
        return np.nan
    change = (mean[2:] - 2.0 * mean[1:-1] + mean[:-2])[inside]
    square = float(median(np.mean(change**2, axis=1))) / MEDIAN_OF_THREE
    return float(np.sqrt(square / 6.0 * WINDOW_NS * 1e-9))
