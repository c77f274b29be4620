"""Two IMUs that publish on one topic, so that their samples alternate.

Mounted in different ways they feel gravity along different axes, and what is integrated is neither
the one's motion nor the other's. A vibration near half of the sampling rate alternates, too, but
what it adds to one sample it takes off the next, so that they differ in size where two sensors both
feel gravity. And it beats with the sampling, within a second or within a minute, while one rotation
turns what the one sensor feels into what the other does all the time.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.finding import Finding, Severity
from sinstool.core.streams import Imu
from sinstool.methods.alignment.still import Windows

# Specific forces of the two sensors differ by more than this, m/s^2, of which their sizes have at
# most this share.
APART, SIZE = 1.0, 0.25
# What changes from one sample of a sensor to its next, to the step between the sensors.
SMOOTH = 0.25
# All but few samples of a second differ from those beside them by this share of the median at
# least: a vibration beats with the sampling, and its samples do not.
FEW, STEADY = 0.15, 0.4
# Share of all seconds in which samples alternate.
MOSTLY = 0.7
LEAST_SECONDS = 5
# Differences follow from the mean specific force and one rotation to this share of the median.
RIGID = 0.2
# Fits of that rotation, each with the signs of the one before, as no sample tells whose it is.
FITS = 10


def may_alternate(windows: Windows) -> bool:
    """Whether specific forces change from sample to sample by as much as two sensors differ."""
    if len(windows) < 2 * LEAST_SECONDS:
        return False
    # half of the difference is the deviation, and alternation has the most noise of all
    noisy = (windows.accel_fast > 0.5 * APART) & (windows.accel_fast > windows.accel_std)
    return bool(np.mean(noisy) > MOSTLY)


def apart(blocks: Iterable[Imu], rate_hz: float) -> float:
    """How far apart two sensors are whose samples alternate, m/s^2; 0 if they do not.

    Parameters
    ----------
    blocks : iterable of Imu
        In order.
    rate_hz : float
        Of the samples.

    Returns
    -------
    float
        Median difference of their specific forces.
    """
    size = 2 * max(8, round(0.5 * rate_hz))
    found: list[float] = []
    pairs: list[tuple[FloatArray, FloatArray]] = []
    for block in blocks:
        for begin in range(0, len(block) - size + 1, size):
            accel = block.accel[begin : begin + size]
            pairs.append(_two(accel))
            found.append(_alternates(accel, *pairs[-1]))
    if len(found) < LEAST_SECONDS or np.count_nonzero(found) < MOSTLY * len(found):
        return 0.0
    if not _rigid(*(np.array(each) for each in zip(*pairs, strict=True))):
        return 0.0
    return float(np.median([one for one in found if one]))


def _off(accel: FloatArray) -> FloatArray:
    """Differences of samples from those beside them."""
    return np.asarray(accel[1:-1] - 0.5 * (accel[:-2] + accel[2:]))


def _two(accel: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Means of the samples to either side of those beside them, shape (3,) each."""
    off = _off(accel)
    ours = off @ np.linalg.svd(off, full_matrices=False)[2][0] > 0.0
    if ours.all() or not ours.any():
        return accel.mean(axis=0), accel.mean(axis=0)
    return accel[1:-1][ours].mean(axis=0), accel[1:-1][~ours].mean(axis=0)


def _alternates(accel: FloatArray, one: FloatArray, other: FloatArray) -> float:
    """Difference of samples from those beside them, m/s^2; 0 if they are of one sensor."""
    far = np.linalg.norm(_off(accel), axis=1)
    low, difference = (float(v) for v in np.quantile(far, [FEW, 0.5]))
    if difference < APART or low < STEADY * difference:
        return 0.0
    # medians, as a lost sample changes the order
    between = np.median(np.linalg.norm(np.diff(accel, axis=0), axis=1))
    within = np.median(np.linalg.norm(accel[2:] - accel[:-2], axis=1))
    if within > SMOOTH * between:
        return 0.0
    sizes = abs(float(np.linalg.norm(one)) - float(np.linalg.norm(other)))
    return difference if sizes < SIZE * difference else 0.0


def _rigid(one: FloatArray, other: FloatArray) -> bool:
    """Whether one rotation turns the one's specific forces into the other's, shape (n, 3) each.

    With a rotation by an angle about an axis, the difference is the cross product of their mean and
    of the axis, times twice the tangent of half of the angle.
    """
    difference, mean = one - other, 0.5 * (one + other)
    size = np.median(np.linalg.norm(difference, axis=1))
    across = np.zeros((len(mean), 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        across[:, i, j], across[:, i, k] = -mean[:, k], mean[:, j]
    signs = np.sign(difference @ np.linalg.svd(difference, full_matrices=False)[2][0])
    for _ in range(FITS):
        signed = signs[:, None] * difference
        axis = np.linalg.lstsq(across.reshape(-1, 3), signed.ravel(), rcond=None)[0]
        followed = across @ axis
        signs = np.where(np.einsum("ni,ni->n", difference, followed) < 0.0, -1.0, 1.0)
    left = np.linalg.norm(signs[:, None] * difference - followed, axis=1)
    return bool(np.median(left) < RIGID * size)


def finding(topic: str, difference: float) -> Finding:
    """What to tell of it."""
    return Finding(
        "two-sensors",
        f"samples of {topic} alternate between two specific forces {difference:.2g} m/s^2 apart, as"
        " if two IMUs published on it: nothing computed from both is to be trusted",
        severity=Severity.LOST,
        answer="give each IMU a topic of its own, or choose another topic with --imu-topic",
        numbers={"apart_m_s2": difference},
    )
