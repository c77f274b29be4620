"""The angle of the table at the edges of the gyro intervals.

A gyro sample is a mean over an interval. Taking it for the value at its stamp is an error of half
an interval, and a time error tau looks exactly like a heading-sensitive error of slope tau: 1 ms
causes 206 arcsec of heading for each rad/s. So times are treated with care here. Stamps are
subtracted as int64, since seconds since 1970 as float64 have a grain of 0.24 us. The stamps of
the gyros carry the jitter of whatever stamped them, their intervals do not: a line through the
stamps of each stretch without lost samples gives the edges. The encoder's jitter is averaged
over a quarter of a second to each side, stamps together with readings, which is exact at
constant rate and keeps the angle monotone.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sinstool.core.arrays import ArrayLike, FloatArray
from sinstool.core.english import counted
from sinstool.core.errors import AlignmentError
from sinstool.core.parts import njit
from sinstool.methods.hse.rig import EncoderModel
from sinstool.methods.hse.time_grid import stamps, time_grids

SMOOTHING_S = 0.25
"""To each side, s."""

_ENCODER_GAP_INTERVALS = 5.0
_ENCODER_GAP_S = 0.25
_EDGE_OF_STAMP = {"end": -1.0, "mid": -0.5, "start": 0.0}
_GRAINS = 1e-9  # s, of stamps


@dataclass(frozen=True)
class TableAngle:
    """The table's angle over gyro samples of which none is lost.

    Attributes
    ----------
    first : int
        Row of the first gyro sample.
    start_s : float
        Time at which its interval begins, s after the first gyro stamp of the log.
    interval_s : float
        Interval of samples, s.
    alpha : ndarray, shape (n + 1,)
        Angle about the downward axis, rad, not wrapped, where the intervals of the n samples
        begin and end.
    jitter_s, wander_s : float
        Of the gyro stamps; see :class:`~sinstool.methods.hse.time_grid.TimeGrid`.
    """

    first: int
    start_s: float
    interval_s: float
    alpha: FloatArray
    jitter_s: float = 0.0
    wander_s: float = 0.0

    def __len__(self) -> int:
        return len(self.alpha) - 1


def table_angle(
    gyro_time_ns: ArrayLike,
    encoder_time_ns: ArrayLike,
    reading: ArrayLike,
    model: EncoderModel,
    imu_stamp: str = "end",
    smoothing_s: float = SMOOTHING_S,
) -> list[TableAngle]:
    """Angle of the table at the edges of the gyro intervals.

    Parameters
    ----------
    gyro_time_ns : array_like of int64, shape (n,)
        Increasing.
    encoder_time_ns : array_like of int64, shape (m,)
        On the same clock, not decreasing; of readings with one stamp the first counts.
    reading : array_like, shape (m,)
        In the unit of the model, wrapped at a whole turn or not. The table must turn by less than
        half a turn from one reading to the next, or its direction is ambiguous.
    imu_stamp : {'end', 'mid', 'start'}
        Where the stamp lies in the interval over which a gyro sample is the mean.
    smoothing_s : float
        Readings are averaged over this much to each side; 0 for none.

    Returns
    -------
    list of TableAngle
        In order: stretches without lost gyro samples that the encoder covers without a gap.

    Raises
    ------
    AlignmentError
        If stamps run backwards, readings are not finite, or there are fewer than two.
    """
    gyro_times = stamps(gyro_time_ns, "gyro")
    if not len(gyro_times):
        return []
    tracks = _tracks(encoder_time_ns, reading, model, int(gyro_times[0]), smoothing_s)
    pieces = []
    for grid in time_grids(gyro_times):
        dt = grid.interval_s
        begins = grid.start_s + _EDGE_OF_STAMP[imu_stamp] * dt
        for seconds, alpha in tracks:
            # edges k with track start <= begins + k dt + delay <= track end
            late = begins + model.delay
            low = max(0, int(np.ceil((seconds[0] - late - _GRAINS) / dt)))
            high = min(grid.count, int(np.floor((seconds[-1] - late + _GRAINS) / dt)))
            # An encoder that is read with the gyro does not cover all of the first interval, or of
            # the last: the angle goes on steadily for that one
            low = 0 if low == 1 else low
            high = grid.count if high == grid.count - 1 else high
            if high - low < 1:
                continue
            at = late + np.arange(low, high + 1) * dt
            pieces.append(
                TableAngle(
                    grid.first + low,
                    begins + low * dt,
                    dt,
                    _angle_at(np.asarray(at, np.float64), seconds, alpha),
                    grid.jitter_s,
                    grid.wander_s,
                )
            )
    return pieces


def _angle_at(at: FloatArray, seconds: FloatArray, alpha: FloatArray) -> FloatArray:
    """Angle between readings, and at the rate of the nearest second beyond their ends."""
    angle = np.interp(at, seconds, alpha)
    last = len(seconds) - 1
    early = int(min(np.searchsorted(seconds, seconds[0] + 1.0), last))
    late = int(max(np.searchsorted(seconds, seconds[-1] - 1.0) - 1, 0))
    for beyond, end, other in ((at < seconds[0], 0, early), (at > seconds[-1], last, late)):
        rate = (alpha[other] - alpha[end]) / (seconds[other] - seconds[end])
        angle[beyond] = alpha[end] + rate * (at[beyond] - seconds[end])
    return np.asarray(angle)


def _tracks(
    time_ns: ArrayLike, reading: ArrayLike, model: EncoderModel, origin_ns: int, smoothing_s: float
) -> list[tuple[FloatArray, FloatArray]]:
    """Seconds after the origin and alpha, smoothed, for each stretch of readings."""
    times = stamps(time_ns, "encoder")
    position = np.asarray(reading, dtype=np.float64)
    if position.shape != times.shape:
        raise ValueError(f"{len(times)} encoder stamps, but readings of shape {position.shape}")
    if len(times) < 2:
        raise AlignmentError(
            f"the encoder has {counted(len(times), 'reading')}",
            "give the topic of the table's angle",
        )
    bad = int(np.count_nonzero(~np.isfinite(position)))
    if bad:
        raise AlignmentError(f"{bad} encoder readings are not finite", "drop them from the log")
    steps = np.diff(times)
    if steps.min() < 0:
        raise AlignmentError(
            f"encoder stamps run backwards at reading {int(np.argmin(steps >= 0)) + 1}",
            "sort them by stamp",
        )
    if steps.min() == 0:
        fresh = np.concatenate(([True], steps > 0))
        times, position = times[fresh], position[fresh]
        steps = np.diff(times)
    if not len(steps):
        raise AlignmentError("all encoder readings have the same stamp", "check their topic")
    interval = float(np.median(steps)) * 1e-9
    longest = max(_ENCODER_GAP_INTERVALS * interval, _ENCODER_GAP_S)
    cuts = np.flatnonzero(steps > longest * 1e9) + 1
    edges = np.concatenate(([0], cuts, [len(times)]))
    seconds = (times - origin_ns) * 1e-9
    turn = 360.0 if model.unit == "deg" else 2.0 * np.pi
    half = round(smoothing_s / interval)
    tracks = []
    for begin, end in pairwise(edges.tolist()):
        if end - begin < 2:
            continue
        angle = np.empty(end - begin)
        _unwrap(position[begin:end], turn, angle)
        if model.unit == "deg":
            angle = np.radians(angle)
        alpha = model.sign * _corrected(angle, model) + model.offset
        at, smooth = np.empty_like(alpha), np.empty_like(alpha)
        _smooth(seconds[begin:end], alpha, half, at, smooth)
        tracks.append((at, smooth))
    return tracks


def _corrected(angle: FloatArray, model: EncoderModel) -> FloatArray:
    """Readings in rad, corrected for the calibrated harmonics."""
    corrected = angle
    for order, cosine, sine in model.harmonics:
        phase = order * angle
        corrected = corrected - cosine * np.cos(phase) - sine * np.sin(phase)
    return corrected


@njit(cache=True, nogil=True)
def _unwrap(position, turn, out):  # type: ignore[no-untyped-def]
    """Add whole turns to each reading, so that no step is more than half a turn."""
    turns = 0.0
    out[0] = position[0]
    for i in range(1, len(position)):
        turns -= np.round((position[i] - position[i - 1]) / turn)
        out[i] = position[i] + turns * turn


@njit(cache=True, nogil=True)
def _add(total, lost, value):  # type: ignore[no-untyped-def]
    """A sum with one more value, and its rounding error (Kahan)."""
    value -= lost
    more = total + value
    return more, (more - total) - value


@njit(cache=True, nogil=True)
def _smooth(seconds, alpha, half, at, smooth):  # type: ignore[no-untyped-def]
    """Means of times and angles over ``half`` readings to each side, fewer near the ends.

    Fewer on both sides, so that the ends stay where they are. Sums slide along; what each
    addition rounds off is carried on (Kahan), as there are very many.
    """
    n = len(alpha)
    low, high = 0, 0  # readings [low, high) are summed, less those of the first
    sum_t, sum_a, lost_t, lost_a = 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        wide = min(half, i, n - 1 - i)
        while high < i + wide + 1:
            sum_t, lost_t = _add(sum_t, lost_t, seconds[high] - seconds[0])
            sum_a, lost_a = _add(sum_a, lost_a, alpha[high] - alpha[0])
            high += 1
        while low < i - wide:
            sum_t, lost_t = _add(sum_t, lost_t, seconds[0] - seconds[low])
            sum_a, lost_a = _add(sum_a, lost_a, alpha[0] - alpha[low])
            low += 1
        at[i] = seconds[0] + sum_t / (high - low)
        smooth[i] = alpha[0] + sum_a / (high - low)
