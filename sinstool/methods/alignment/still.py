"""Stillness: half-second windows of inertial data, and the spans without motion.

A gyro can be biased by degrees per second, so stillness is judged on variance, never on the
mean; the means only have to stay what they were.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import comb, dist, sqrt

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.order_statistics import median
from sinstool.core.parts import kernel, part
from sinstool.core.quaternion_kernels import EXACT, dcm, increment_quaternion, product
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE, STANDARD_GRAVITY
from sinstool.methods.lulls import lulls

WINDOW_NS = 500_000_000
# Noise of working sensors at rest, with an engine idling: beyond this something moves.
MAX_GYRO_STD = 0.06  # rad/s, norm over the axes
MAX_ACCEL_STD = 0.35  # m/s^2
# Within a span the noise may grow to this many times its smallest so far, or to these small values,
# as by a knock on the table; the means must not change in any case.
STD_GROWTH = 2.5
KNOCK_STD = (0.012, 0.15)
# Slow rotation or tilting shows in the means: allowed change beside the noise of a mean.
GYRO_STEP = 0.003  # rad/s
ACCEL_STEP = 0.05  # m/s^2
MEAN_SIGMAS = 4.0
# A steady mean rate, rad/s, beyond the zero-rate offset of all but the worst gyros.
STEADY_TURN = 10.0 * DEGREE
MIN_SAMPLES = 4
LONGEST_STEP_S = 0.2  # between samples that turns are integrated over
MIN_WINDOWS = 2
# Where a recorder lost samples for a second or so, a rest goes on: nothing moves off and comes to
# rest again with the same tilt in that time. So many windows after the one before it.
MOST_APART = 3
# No accelerometer is further off gravity, or off what it usually shows, at rest, m/s^2.
OFF_GRAVITY = 0.8

# Columns of a window row
_INDEX, _COUNT, _MEAN, _SQUARES, _CHANGES, _TURNED = 0, 1, 2, 8, 14, 20
WIDTH = 34
# Of rates in rad/s, and of those that are read as such and are in deg/s
UNITS = (1.0, DEGREE)
# Order of the differences that show white noise, and the factor of its variance in them: motion,
# which lasts for many samples, cancels in them.
ORDER = 6
_OF_DIFFERENCES = comb(2 * ORDER, ORDER)


@dataclass(frozen=True)
class Windows:
    """Half-second windows of a stream, in order; windows without samples are absent.

    Attributes
    ----------
    start_ns : ndarray of int64, shape (n,)
    count : ndarray of int64, shape (n,)
    gyro, accel : ndarray, shape (n, 3)
        Means, rad/s and m/s^2.
    gyro_std, accel_std : ndarray, shape (n,)
        Root of the summed variances of the axes.
    gyro_fast, accel_fast : ndarray, shape (n,)
        The same of what changes from sample to sample only: noise, without motion. NaN where there
        are too few samples.
    turn : ndarray, shape (2, n, 4)
        Quaternions of the rotation from the beginning of each to its end, by every sample; if
        rates are in rad/s, and if they are in deg/s.
    force : ndarray, shape (2, n, 3)
        Mean specific force in the axes that the body then had at the beginning, m/s^2.
    """

    start_ns: np.ndarray
    count: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray
    gyro_std: np.ndarray
    accel_std: np.ndarray
    gyro_fast: np.ndarray
    accel_fast: np.ndarray
    turn: np.ndarray
    force: np.ndarray

    def __len__(self) -> int:
        return len(self.start_ns)


class WindowStage:
    """Accumulates windows from blocks of ordered samples; its state is the open window."""

    def __init__(self) -> None:
        self._origin: int | None = None
        self._last: int | None = None
        self._open = np.zeros(WIDTH)
        # Differences of each order up to the last, and how many samples they are of
        self._differences, self._samples = np.zeros((ORDER, 6)), np.zeros(1, np.int64)
        self._closed: list[np.ndarray] = []

    def push(self, time_ns: np.ndarray, gyro: np.ndarray, accel: np.ndarray) -> None:
        """Add ordered samples.

        Parameters
        ----------
        time_ns : ndarray of int64, shape (n,)
        gyro, accel : ndarray, shape (n, 3)
        """
        if not len(time_ns):
            return
        if self._origin is None:
            self._origin = int(time_ns[0])
        index = (time_ns - self._origin) // WINDOW_NS
        # What a sample before a gap measured is not what happened in it
        seconds = np.diff(time_ns, prepend=time_ns[0] if self._last is None else self._last) * 1e-9
        self._last = int(time_ns[-1])
        seconds[seconds > LONGEST_STEP_S] = 0.0
        rows = np.empty((len(time_ns) + 1, WIDTH))
        closed = _accumulate(
            index, seconds, gyro, accel, self._open, rows, self._differences, self._samples
        )
        if closed:
            self._closed.append(rows[:closed].copy())

    def finish(self) -> Windows:
        """All windows so far, the open one included."""
        parts = list(self._closed)
        if self._open[_COUNT] > 0:
            parts.append(self._open[None, :].copy())
        rows = np.concatenate(parts) if parts else np.empty((0, WIDTH))
        count = rows[:, _COUNT : _COUNT + 1]
        variance = rows[:, _SQUARES:_CHANGES] / np.maximum(count - 1.0, 1.0)
        turned = rows[:, _TURNED:].reshape(-1, len(UNITS), 7).swapaxes(0, 1)
        changes = rows[:, _CHANGES:_TURNED] / (_OF_DIFFERENCES * count)
        changes[np.cumsum(count) <= 2 * ORDER] = np.nan
        return Windows(
            (self._origin or 0) + rows[:, _INDEX].astype(np.int64) * WINDOW_NS,
            rows[:, _COUNT].astype(np.int64),
            rows[:, _MEAN : _MEAN + 3],
            rows[:, _MEAN + 3 : _MEAN + 6],
            np.sqrt(variance[:, :3].sum(axis=1)),
            np.sqrt(variance[:, 3:].sum(axis=1)),
            np.sqrt(changes[:, :3].sum(axis=1)),
            np.sqrt(changes[:, 3:].sum(axis=1)),
            turned[:, :, :4],
            turned[:, :, 4:] / np.maximum(count, 1.0),
        )


@dataclass(frozen=True)
class StillSpan:
    """A stretch in which nothing moved.

    Attributes
    ----------
    gyro, accel : ndarray, shape (3,)
        Means over it, rad/s and m/s^2.
    gyro_std, accel_std : float
        Noise of single samples, norm over the axes.
    lull : bool
        It may be part of a slow motion, see `lulls`, or its specific force is neither of gravity's
        size nor of that which is usual in the log, as in a turn of an aircraft.
    """

    start_ns: int
    end_ns: int
    samples: int
    gyro: np.ndarray
    accel: np.ndarray
    gyro_std: float
    accel_std: float
    lull: bool = False

    @property
    def duration_s(self) -> float:
        """Length in seconds."""
        return (self.end_ns - self.start_ns) / 1e9


def still_spans(windows: Windows) -> list[StillSpan]:
    """Spans of at least a second in which nothing moved, across short gaps of the samples.

    Returns
    -------
    list of StillSpan
        In order of time.
    """
    quiet = (windows.gyro_std < MAX_GYRO_STD) & (windows.accel_std < MAX_ACCEL_STD)
    spans: list[StillSpan] = []
    begin: int | None = None
    last = 0
    total = turning = shaking = 0.0
    gyro: list[float] = []
    accel: list[float] = []
    # Numbers of Python, as a log of hours has ten thousands of windows
    starts, counts = windows.start_ns.tolist(), windows.count.tolist()
    gyros, accels = windows.gyro.tolist(), windows.accel.tolist()
    noise = zip(windows.gyro_std.tolist(), windows.accel_std.tolist(), strict=True)
    for k, (joins, (gyro_std, accel_std)) in enumerate(zip(quiet.tolist(), noise, strict=True)):
        if counts[k] < MIN_SAMPLES:
            continue  # at the edge of a gap: too few to say anything
        if begin is not None:
            joins_span = (
                joins
                and starts[k] - starts[last] <= MOST_APART * WINDOW_NS
                and gyro_std <= max(STD_GROWTH * turning, KNOCK_STD[0])
                and accel_std <= max(STD_GROWTH * shaking, KNOCK_STD[1])
                and dist(gyros[k], gyro) < GYRO_STEP + MEAN_SIGMAS * gyro_std / sqrt(counts[k])
                and dist(accels[k], accel) < ACCEL_STEP + MEAN_SIGMAS * accel_std / sqrt(counts[k])
            )
            if not joins_span:
                _close(spans, windows, begin, last + 1)
                begin = None
        if not joins:
            continue
        weight = float(counts[k])
        if begin is None:
            begin, total, turning, shaking = k, 0.0, gyro_std, accel_std
            gyro, accel = gyros[k], accels[k]
        gyro = _mean(gyro, total, gyros[k], weight)
        accel = _mean(accel, total, accels[k], weight)
        last, total = k, total + weight
        turning, shaking = min(turning, gyro_std), min(shaking, accel_std)
    if begin is not None:
        _close(spans, windows, begin, last + 1)
    return _with_lulls(spans, windows)


def _with_lulls(spans: list[StillSpan], windows: Windows) -> list[StillSpan]:
    """Spans, those marked that may be part of a slow motion."""
    begins = np.searchsorted(windows.start_ns, [span.start_ns for span in spans])
    ends = np.searchsorted(windows.start_ns, [span.end_ns for span in spans])
    found = lulls(
        windows.gyro,
        windows.gyro_std**2 / 3.0 / np.maximum(windows.count, 1),
        np.column_stack([windows.gyro_std, windows.accel_std]) ** 2,
        np.diff(windows.start_ns, prepend=0) == WINDOW_NS,
        zip(begins.tolist(), ends.tolist(), strict=True),
        WINDOW_NS / SECOND,
    )
    usual = float(median(np.linalg.norm(windows.accel, axis=1))) if spans else 0.0
    sizes = [float(np.linalg.norm(span.accel)) for span in spans]
    off = [min(abs(size - STANDARD_GRAVITY), abs(size - usual)) > OFF_GRAVITY for size in sizes]
    return [replace(span, lull=a or b) for span, a, b in zip(spans, found, off, strict=True)]


def _mean(one: list[float], weight: float, other: list[float], more: float) -> list[float]:
    """Weighted mean of two vectors."""
    return [(a * weight + b * more) / (weight + more) for a, b in zip(one, other, strict=True)]


def _close(spans: list[StillSpan], windows: Windows, begin: int, end: int) -> None:
    """Add the span of windows [begin, end), less its last window: motion began somewhere in it."""
    if end < len(windows):
        end -= 1
    if end - begin >= MIN_WINDOWS:
        spans.append(span_of(windows, begin, end))


def span_of(windows: Windows, begin: int, end: int) -> StillSpan:
    """The span of windows [begin, end), of which nothing is asked."""
    part = slice(begin, end)
    count = windows.count[part].astype(float)
    return StillSpan(
        int(windows.start_ns[begin]),
        int(windows.start_ns[end - 1]) + WINDOW_NS,
        int(count.sum()),
        count @ windows.gyro[part] / count.sum(),
        count @ windows.accel[part] / count.sum(),
        float(np.sqrt(count @ windows.gyro_std[part] ** 2 / count.sum())),
        float(np.sqrt(count @ windows.accel_std[part] ** 2 / count.sum())),
    )


def lead_in(spans: list[StillSpan], first_ns: int) -> StillSpan | None:
    """The span that begins with the log (first sample at ``first_ns``), if there is one."""
    if spans and spans[0].start_ns <= first_ns:
        return spans[0]
    return None


@kernel()
def _accumulate(index, seconds, gyro, accel, state, rows, differences, samples):  # type: ignore[no-untyped-def]
    """Welford sums per window; closed windows go to ``rows``, the open one stays in ``state``."""
    closed = 0
    for i in range(index.shape[0]):
        if state[1] > 0 and state[0] != index[i]:
            for a in range(len(state)):
                rows[closed, a] = state[a]
                state[a] = 0.0
            closed += 1
        if state[1] == 0:
            state[20] = state[27] = 1.0
        state[0] = index[i]
        state[1] += 1.0
        half = 0.5 * seconds[i]
        x, y, z = half * gyro[i, 0], half * gyro[i, 1], half * gyro[i, 2]
        _turn(state, 20, x, y, z, accel, i)
        _turn(state, 27, DEGREE * x, DEGREE * y, DEGREE * z, accel, i)
        for a in range(6):
            value = gyro[i, a] if a < 3 else accel[i, a - 3]
            delta = value - state[2 + a]
            state[2 + a] += delta / state[1]
            state[8 + a] += delta * (value - state[2 + a])
            for order in range(differences.shape[0]):
                before = differences[order, a]
                differences[order, a] = value
                value -= before
            if samples[0] >= differences.shape[0]:
                state[14 + a] += value * value
        samples[0] += 1
    return closed


@part()
def _turn(
    state: FloatArray, first: int, x: float, y: float, z: float, accel: FloatArray, i: int
) -> None:
    """Turn the axes by twice a vector, rad, and add the force that is felt half-way."""
    dw, dx, dy, dz = increment_quaternion(x, y, z, EXACT)
    qw, qx, qy, qz = state[first], state[first + 1], state[first + 2], state[first + 3]
    qw, qx, qy, qz = product(qw, qx, qy, qz, dw, dx, dy, dz)
    c00, c01, c02, c10, c11, c12, c20, c21, c22 = dcm(qw, qx, qy, qz)
    fx, fy, fz = accel[i, 0], accel[i, 1], accel[i, 2]
    state[first + 4] += c00 * fx + c01 * fy + c02 * fz
    state[first + 5] += c10 * fx + c11 * fy + c12 * fz
    state[first + 6] += c20 * fx + c21 * fy + c22 * fz
    qw, qx, qy, qz = product(qw, qx, qy, qz, dw, dx, dy, dz)
    state[first], state[first + 1], state[first + 2], state[first + 3] = qw, qx, qy, qz
