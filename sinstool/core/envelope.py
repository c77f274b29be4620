"""Extremes and samples of columns of any length, in bounded memory."""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray

# Groups are merged in pairs at twice this number, so that at least this many are kept.
GROUPS = 1000
# A hole is drawn where time goes on by so many usual groups.
HOLE_GROUPS = 1.5


class Envelope:
    """Lowest, highest and first values of groups of consecutive rows.

    All groups hold one number of rows, a power of two that grows with the log. The answer does
    not depend on how rows are cut into blocks.

    Parameters
    ----------
    groups : int, optional
        How many groups to keep at least, where there are so many rows.
    """

    def __init__(self, columns: int, groups: int = GROUPS) -> None:
        self.rows_per_group = 1
        self._most = 2 * groups
        self._times = np.empty((0, 2), np.int64)
        self._values = np.empty((0, 3, columns))
        self._rest_times = np.empty(0, np.int64)
        self._rest = np.empty((0, columns))
        self._final = np.empty((0, columns))

    def push(self, time_ns: IntArray, values: FloatArray) -> None:
        """Take the next rows.

        Parameters
        ----------
        time_ns : ndarray of int64, shape (n,)
            Increasing.
        values : ndarray, shape (n, columns)
            NaN where there is none.
        """
        self._rest_times = np.concatenate([self._rest_times, time_ns])
        self._rest = np.concatenate([self._rest, values])
        if len(values):
            self._final = values[-1:].copy()
        while True:
            room = self._most - len(self._times)
            count = min(room, len(self._rest) // self.rows_per_group)
            self._append(count, self.rows_per_group)
            if len(self._times) < self._most:
                return
            self._times = np.stack([self._times[::2, 0], self._times[1::2, 1]], axis=1)
            self._values = _merged(self._values[::2], self._values[1::2])
            self.rows_per_group *= 2

    def _append(self, count: int, size: int) -> None:
        if not count:
            return
        rows = count * size
        times = self._rest_times[:rows].reshape(count, size)
        values = self._rest[:rows].reshape(count, size, -1)
        low, high = np.fmin.reduce(values, axis=1), np.fmax.reduce(values, axis=1)
        self._times = np.concatenate([self._times, times[:, [0, -1]]])
        self._values = np.concatenate([self._values, np.stack([low, high, values[:, 0]], axis=1)])
        self._rest_times, self._rest = self._rest_times[rows:], self._rest[rows:]

    def groups(self) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
        """The extremes and samples so far.

        Returns
        -------
        times : ndarray of int64, shape (m, 2)
            First and last of each group, ns.
        low, high, first : ndarray, shape (m, columns)
        """
        times, values = self._times, self._values
        if len(self._rest):  # rows that do not fill a group yet
            ends = self._rest_times[[0, -1]][None, :]
            low, high = np.fmin.reduce(self._rest, axis=0), np.fmax.reduce(self._rest, axis=0)
            last = np.stack([low, high, self._rest[0]])[None]
            times, values = np.concatenate([times, ends]), np.concatenate([values, last])
        return times, values[:, 0], values[:, 1], values[:, 2]

    def curves(self, origin_ns: int) -> tuple[FloatArray, FloatArray]:
        """Every column as a curve through its extremes, to its last value.

        Parameters
        ----------
        origin_ns : int
            Time 0 of the curves.

        Returns
        -------
        seconds : ndarray, shape (k,)
        values : ndarray, shape (k, columns)
            A row of NaN where time has a hole.
        """
        times, low, high, first = self.groups()
        seconds = _seconds(times, origin_ns)
        before, within = _holes(times)
        if self.rows_per_group == 1:
            return with_holes(seconds[:, 0], low, before)
        # Where a group begins near its highest, that comes first: a curve that falls has no teeth
        falls = high - first < first - low
        ends = [np.where(falls, high, low), np.where(falls, low, high)]
        both = np.stack(ends, axis=1).reshape(2 * len(low), -1)
        holes = np.sort(np.concatenate([2 * before, 2 * within + 1]))
        seconds = seconds.reshape(-1)
        # The last row ends the curve, be it an extreme or not; alone in its group it is one point
        keep = len(both) - 1 if len(self._rest) == 1 else len(both)
        if keep == len(both) and not np.array_equal(both[-1:], self._final, equal_nan=True):
            both = np.concatenate([both, self._final])
            seconds, keep = np.append(seconds, seconds[-1]), len(both)
        return with_holes(seconds[:keep], both[:keep], holes[holes < keep])

    def samples(self, origin_ns: int) -> tuple[FloatArray, FloatArray]:
        """The first row of every group; as :meth:`curves`."""
        times, _, _, first = self.groups()
        before, within = _holes(times)
        holes = np.union1d(before, within[within + 1 < len(times)] + 1)
        return with_holes(_seconds(times[:, 0], origin_ns), first, holes)


def _seconds(time_ns: IntArray, origin_ns: int) -> FloatArray:
    return np.asarray((time_ns - origin_ns) * 1e-9, dtype=np.float64)


def _merged(left: FloatArray, right: FloatArray) -> FloatArray:
    low = np.fmin(left[:, 0], right[:, 0])
    high = np.fmax(left[:, 1], right[:, 1])
    return np.stack([low, high, left[:, 2]], axis=1)


def _holes(times: IntArray) -> tuple[IntArray, IntArray]:
    """Groups before which, and groups within which time has a hole."""
    if len(times) < 3:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    usual = float(np.median(np.diff(times[:, 0])))
    before = np.flatnonzero(times[1:, 0] - times[:-1, 1] > HOLE_GROUPS * usual) + 1
    within = np.flatnonzero(times[:, 1] - times[:, 0] > (1.0 + HOLE_GROUPS) * usual)
    return before, within


def with_holes(
    seconds: FloatArray, values: FloatArray, before: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Rows of NaN before these rows, so that no line is drawn there.

    Parameters
    ----------
    seconds : ndarray, shape (n,)
    values : ndarray, shape (n, columns)
    before : ndarray of int
    """
    return np.insert(seconds, before, seconds[before]), np.insert(values, before, np.nan, axis=0)
