"""Even intervals of gyro samples behind stamps that jitter, and samples lost between them.

Stamps are subtracted as int64, since seconds since 1970 as float64 have a grain of 0.24 us.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sinstool.core.arrays import ArrayLike, BoolArray, FloatArray, IntArray
from sinstool.core.errors import AlignmentError
from sinstool.core.streams import Imu

LONGEST_GAP = 1.5
"""Of nominal gyro intervals; beyond it samples are lost."""

LONGEST_FILLED_S = 0.1
"""A gap of samples up to this long is filled, s."""

# Stamps before and after a long interval that decide whether samples are lost there or one
# stamp was late: the late one is followed by stamps that are where they should be.
_NEIGHBOURS = 20


@dataclass(frozen=True)
class TimeGrid:
    """Gyro samples one after the other with none lost, and the line through their stamps.

    Attributes
    ----------
    first : int
        Row of the first sample.
    count : int
        Number of samples.
    start_s : float
        Time of the first sample on the line, s after the origin.
    interval_s : float
        Interval of samples, s.
    jitter_s : float
        Root mean square of the stamps about the line.
    wander_s : float
        Largest distance of a second's mean of stamps from the line: not jitter, but a clock
        that did not run evenly.
    """

    first: int
    count: int
    start_s: float
    interval_s: float
    jitter_s: float
    wander_s: float


def time_grids(time_ns: ArrayLike) -> list[TimeGrid]:
    """Stretches of gyro samples without a gap.

    Parameters
    ----------
    time_ns : array_like of int64, shape (n,)
        Stamps, increasing; the first is the origin.

    Returns
    -------
    list of TimeGrid
        In order.

    Raises
    ------
    AlignmentError
        If stamps do not increase.
    """
    times = stamps(time_ns, "gyro")
    if len(times) < 2:
        return []
    steps = np.diff(times)
    if steps.min() <= 0:
        at = int(np.argmin(steps > 0))
        raise AlignmentError(
            f"gyro stamps do not increase (sample {at + 1} of {len(times)})",
            "sort them and drop repeated ones",
        )
    nominal = float(np.median(steps))
    cuts, _ = _lost(times, steps, nominal)
    edges = np.concatenate(([0], cuts, [len(times)]))
    return [_line(times, begin, end, round(nominal)) for begin, end in pairwise(edges.tolist())]


def filled(imu: Imu) -> tuple[Imu, BoolArray]:
    """Samples of a rig with short gaps filled, so that one lost message does not end a run.

    At constant rate what is fixed to the body is constant, and Earth rate and gravity turn slowly
    in it: over 0.1 s at 200 deg/s a straight line between the samples on either side is off by
    1 % of the horizontal Earth rate at most, or 0.3 arcsec of heading in a run of ten minutes.

    Parameters
    ----------
    imu : Imu
        Samples of the log in its axes; stamps increase.

    Returns
    -------
    imu : Imu
        With samples in gaps of up to :data:`LONGEST_FILLED_S`, on straight lines between their
        neighbours; without orientation.
    made : ndarray of bool, shape (n,)
        True for the samples that were filled in.
    """
    times = stamps(imu.time_ns, "gyro")
    steps = np.diff(times)
    nominal = float(np.median(steps)) if len(steps) else 0.0
    cuts, lost = _lost(times, steps, nominal)
    short = lost * nominal * 1e-9 <= LONGEST_FILLED_S
    cuts, lost = cuts[short], lost[short]
    after = np.repeat(cuts, lost)
    number = np.arange(len(after)) - np.repeat(np.cumsum(lost) - lost, lost) + 1
    share = number / np.repeat(lost + 1, lost)

    def with_made(column: np.ndarray) -> np.ndarray:
        weights = share.reshape(-1, *(1,) * (column.ndim - 1))
        step = weights * (column[after] - column[after - 1])
        if column.dtype == np.int64:
            step = np.round(step).astype(np.int64)
        return np.insert(column, after, column[after - 1] + step, axis=0)

    made = np.insert(np.zeros(len(times), dtype=np.bool_), after, True)
    columns = (imu.time_ns, imu.log_time_ns, imu.gyro, imu.accel)
    return Imu(*(with_made(column) for column in columns)), made


def stamps(time_ns: ArrayLike, whose: str) -> IntArray:
    """A column of stamps as int64, ns.

    Raises
    ------
    ValueError
        If they are not a column of integers.
    """
    times = np.asarray(time_ns)
    if times.ndim != 1 or not np.issubdtype(times.dtype, np.integer):
        raise ValueError(f"{whose} times must be a column of int64 ns, got {times.dtype}")
    return times.astype(np.int64)


def _lost(times: IntArray, steps: IntArray, nominal: float) -> tuple[IntArray, IntArray]:
    """Rows before which samples are lost, and how many."""
    cuts = np.flatnonzero(steps > LONGEST_GAP * nominal) + 1
    lost = _missing(times, cuts, nominal, np.zeros_like(cuts), np.full_like(cuts, len(times)))
    # counted again without the stamps beyond the gaps before and after
    cuts = cuts[lost > 0]
    edges = np.concatenate(([0], cuts, [len(times)]))
    lost = _missing(times, cuts, nominal, edges[:-2], edges[2:])
    return cuts[lost > 0], lost[lost > 0]


def _missing(
    times: IntArray, cuts: IntArray, nominal: float, first: IntArray, stop: IntArray
) -> IntArray:
    """Samples that are missing before each of these rows, by stamps of rows [first, stop)."""
    window = np.arange(_NEIGHBOURS)
    after = cuts[:, None] + window
    before = cuts[:, None] - 1 - window

    def offset(rows: IntArray) -> FloatArray:
        inside = np.clip(rows, first[:, None], stop[:, None] - 1)
        since = (times[inside] - times[cuts - 1][:, None]) - (inside - cuts[:, None] + 1) * nominal
        return np.asarray(np.median(since, axis=1))

    return np.asarray(np.ceil((offset(after) - offset(before)) / nominal - 0.5), dtype=np.int64)


def _line(times: IntArray, begin: int, end: int, nominal: int) -> TimeGrid:
    """Least-squares line through the stamps of rows [begin, end)."""
    n = end - begin
    k = np.arange(n)
    # small integers, exact in float64; stamps themselves are not
    late = (times[begin:end] - times[begin] - k * nominal).astype(np.float64)
    x = k - (n - 1) / 2.0
    slope = float(x @ late / (x @ x)) if n > 1 else 0.0
    rest = late - late.mean() - slope * x
    start = late.mean() - slope * (n - 1) / 2.0
    per_second = max(1, round(1e9 / nominal))
    whole = n // per_second * per_second
    means = rest[:whole].reshape(-1, per_second).mean(axis=1) if whole else rest[:0]
    return TimeGrid(
        first=begin,
        count=n,
        start_s=(float(times[begin] - times[0]) + float(start)) * 1e-9,
        interval_s=(nominal + slope) * 1e-9,
        jitter_s=float(np.sqrt(np.mean(rest**2))) * 1e-9,
        wander_s=float(np.abs(means).max()) * 1e-9 if len(means) else 0.0,
    )
