"""Whether values of an axis lie at the end of its range."""

from __future__ import annotations

import numpy as np

# Several consecutive samples at the largest value are a stop, unless as many are just below it, as
# where a slow motion turns back, or the axis is always near it. But where its values otherwise
# change from sample to sample, only a stop holds one of them for HELD_RUN samples.
SATURATION_RUN = 3
SATURATION_RATIO = 2.0
HELD_RUN, CHANGING = 20, 0.5
# After a calibration the values at the end of a range are not all the same, but close together: at
# least CROWDED times as many as below them, in runs of CROWDED_RUN in the mean, at CROWDED_TIMES
# occasions. Of a sine 0.8 times as many lie there, and the steps to them are twice those from one
# to another.
CROWDED, CROWDED_RUN, CROWDED_TIMES, CROWDED_STEP = 1.5, 3.0, 3.0, 4.0

# A saturated axis is at the end of its range from this share of its largest value on.
STOP_SHARE = 0.997


def stopped(row: np.ndarray, usual: float) -> bool:
    """Whether the largest value of an axis is the end of its range.

    Parameters
    ----------
    row : ndarray, shape (11,)
        Extremes of the axis, as in :class:`~sinstool.survey.tally.Tally`.
    usual : float
        Root mean square of its means over half a second.
    """
    largest, run, _, _, _, at_largest, just_below, others, changed, *_ = row.tolist()
    if run < SATURATION_RUN or at_largest <= just_below:
        return False
    return largest > SATURATION_RATIO * usual or (run >= HELD_RUN and changed > CHANGING * others)


def crowded(crowds: np.ndarray) -> np.ndarray:
    """Whether the largest rates lie close together.

    Parameters
    ----------
    crowds : ndarray, shape (2, 3, 6)
        Of positive and negative rates of each axis, as in :class:`~sinstool.survey.tally.Tally`.

    Returns
    -------
    ndarray of bool, shape (2, 3)
    """
    _, near, below, times, reached, inside = np.moveaxis(crowds, -1, 0)
    often = (times >= CROWDED_TIMES) & (near >= CROWDED_RUN * times)
    abrupt = reached * (near - times) >= CROWDED_STEP * inside * times
    return np.asarray(often & abrupt & (near > CROWDED * below))
