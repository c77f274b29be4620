"""The angle of the table at the stamps of samples, and where the gyros deny it.

An encoder may hang, leap, lose steps or be stamped by a clock that is set. Where the table's rate
changes, its readings alone do not show that, and a stretch at constant rate merely ends. But the
gyros feel the table turn as well: the integral of their rate along the axis, less the Earth's,
follows the encoder to minutes of arc from a stretch on to the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.earth import EARTH_RATE
from sinstool.core.order_statistics import SIGMA_PER_MAD, median
from sinstool.core.rotation import wrapped
from sinstool.methods.hse.encoder import TableAngle
from sinstool.methods.hse.segments import Segment

# Gyros that walk by 0.1 deg/sqrt(h) or drift by 1 deg/h part from the encoder by less than this
# until the next stretch, rad; and stamps that jitter by less than so many of their sigmas.
LEAST_DENIED, SIGMAS = np.radians(0.1), 8.0
# Ratios of the gyros' rate and the encoder's are those of so long, s.
_BLOCK_S = 1.0
# Where in its interval a sample's stamp lies: that edge's angle belongs to it.
_STAMP = {"start": 0.0, "mid": 0.5, "end": 1.0}


@dataclass(frozen=True)
class StampedAngle:
    """The table over the samples of one :class:`~sinstool.methods.hse.encoder.TableAngle`.

    Attributes
    ----------
    alpha : ndarray, shape (n,)
        Angle at the stamps, rad.
    nearest : ndarray of int64, shape (n,)
        Number of the stretch that each sample lies in, or is nearest to in time.
    off : ndarray, shape (n,)
        By how much the gyros say that the angle is off, rad, within half a turn: since that
        stretch, or where it is of another piece since most of the samples.
    denied : ndarray of bool, shape (n,)
        Where that is more than noise of gyros and jitter of stamps make.
    """

    alpha: FloatArray
    nearest: IntArray
    off: FloatArray
    denied: BoolArray


def stamped_angles(
    smooth: Sequence[TableAngle],
    read: Sequence[TableAngle],
    stretches: Sequence[Segment],
    axial: FloatArray,
    latitude: float,
    imu_stamp: str,
) -> list[StampedAngle]:
    """Angle of the table at the stamps of samples, and where the gyros deny it.

    Smoothed, which suits stamps that jitter, in the stretches at constant rate; as it was read
    where the rate changes, as the mean of a quarter of a second to each side lags there by
    minutes of arc.

    Parameters
    ----------
    smooth, read : sequence of TableAngle
        With and without smoothing.
    stretches : sequence of Segment
        Those of the log that are in use, one at least.
    axial : ndarray, shape (n,)
        Rate of the gyros along the (down) axis at all samples of the log, rad/s.
    latitude : float
        rad.
    imu_stamp : {'end', 'mid', 'start'}

    Returns
    -------
    list of StampedAngle
        One for each piece.
    """
    # The axis is all but vertical
    by_gyros = [_turned(piece, axial + EARTH_RATE * np.sin(latitude)) for piece in smooth]
    ratios = [_ratio(smooth[s.piece], by_gyros[s.piece], s) for s in stretches]
    angles = []
    for number, (piece, raw, turned) in enumerate(zip(smooth, read, by_gyros, strict=True)):
        alpha, steady, felt = (
            _at_stamps(edges, imu_stamp) for edges in (raw.alpha, piece.alpha, turned)
        )
        middles = np.arange(0.5, len(piece)) * piece.interval_s
        nearest = _nearest(np.asarray(piece.start_s + middles), stretches)
        off, sigma = np.zeros(len(piece)), 0.0
        for k in np.unique(nearest).tolist():
            here, own = nearest == k, stretches[k].piece == number
            rows = slice(stretches[k].first, stretches[k].stop) if own else here
            apart = alpha * ratios[k] - felt
            level = _one_in_the_middle(apart[rows])
            sigma = max(sigma, SIGMA_PER_MAD * float(median(np.abs(apart[rows] - level))))
            if own:
                alpha[rows] = steady[rows]
                apart[rows] = steady[rows] * ratios[k] - felt[rows]
            # Whole turns that an encoder missed are of no account: it shows where the table points
            off[here] = wrapped(apart[here] - level)
        denied = np.abs(off) > max(LEAST_DENIED, SIGMAS * sigma)
        angles.append(StampedAngle(alpha, nearest, off, denied))
    return angles


def _turned(piece: TableAngle, rate: FloatArray) -> FloatArray:
    """Angle by rates, at the edges of the intervals of a piece."""
    steps = rate[piece.first : piece.first + len(piece)] * piece.interval_s
    return np.concatenate([[0.0], np.cumsum(steps)])


def _ratio(piece: TableAngle, turned: FloatArray, stretch: Segment) -> float:
    """Rate of the gyros over that of the encoder, as it mostly is in a stretch."""
    size = min(max(1, round(_BLOCK_S / piece.interval_s)), stretch.stop - stretch.first)
    edges = slice(stretch.first, stretch.stop + 1, size)
    return float(median(np.diff(turned[edges]) / np.diff(piece.alpha[edges])))


def _one_in_the_middle(values: FloatArray) -> float:
    """The median, but a value that there is."""
    return float(np.partition(values, len(values) // 2)[len(values) // 2])


def _at_stamps(edges: FloatArray, imu_stamp: str) -> FloatArray:
    weight = _STAMP[imu_stamp]
    return np.asarray((1.0 - weight) * edges[:-1] + weight * edges[1:])


def _nearest(seconds: FloatArray, stretches: Sequence[Segment]) -> IntArray:
    """Number of the stretch that each time lies in, or is nearest to."""
    begins = np.array([s.start_s for s in stretches])
    ends = np.array([s.start_s + s.duration_s for s in stretches])
    # half-way between the end of one and the beginning of the next
    edges = 0.5 * (ends[:-1] + begins[1:])
    return np.searchsorted(edges, seconds)
