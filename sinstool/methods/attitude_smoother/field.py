"""The magnetic field over epochs, in navigation axes of an integrated attitude."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.rotation import normalise, to_dcm
from sinstool.core.streams import Magnetometer, Solution
from sinstool.core.timeline import SECOND
from sinstool.methods.attitude_smoother.epochs import Epochs
from sinstool.methods.attitude_smoother.model import EPOCH_S


@dataclass(frozen=True)
class EpochField:
    """Readings of a magnetometer in the epochs of a log.

    Attributes
    ----------
    field : ndarray, shape (n, 3)
        Mean, in navigation axes of the integrated attitude, T.
    attitude : ndarray, shape (n, 3, 3)
        Mean of the integrated attitude's matrix at the samples: what turns a field that is fixed in
        the body, as that of magnetised iron, into the mean it adds.
    count : ndarray, shape (n,)
        Samples; where there are none the others are 0.
    """

    field: FloatArray
    attitude: FloatArray
    count: FloatArray


class FieldStage:
    """Means of the field from blocks of integrated attitude.

    Each sample is turned with the attitude at its own time, so that a body that turns within an
    epoch does no harm.

    Parameters
    ----------
    measured : Magnetometer
        By time.
    max_gap_ns : int
        Longest interval between solutions that is no gap.
    """

    def __init__(self, measured: Magnetometer, max_gap_ns: int) -> None:
        self._measured, self._max_gap_ns = measured, max_gap_ns
        self._next = 0
        self._origin: int | None = None
        self._last: tuple[np.ndarray, FloatArray] | None = None
        self._numbers: list[np.ndarray] = []
        self._sums: list[FloatArray] = []

    def push(self, solution: Solution) -> None:
        """Take the next solutions, those that an `EpochStage` takes."""
        times, q = solution.time_ns, solution.q_nb
        if self._origin is None:
            self._origin = int(times[0])
            self._next = int(np.searchsorted(self._measured.time_ns, times[0], "right"))
        if self._last is not None:
            times = np.concatenate([self._last[0], times])
            q = np.concatenate([self._last[1], q])
        self._last = times[-1:], q[-1:]
        until = int(np.searchsorted(self._measured.time_ns, times[-1], "right"))
        rows = slice(self._next, until)
        self._next = max(self._next, until)
        at, field = self._measured.time_ns[rows], self._measured.field[rows]
        after = np.searchsorted(times, at, "left")
        usable = (after > 0) & (times[after] - times[after - 1] <= self._max_gap_ns)
        if not usable.any():
            return
        at, field, after = at[usable], field[usable], after[usable]
        share = ((at - times[after - 1]) / (times[after] - times[after - 1]))[:, None]
        before, behind = q[after - 1], q[after]
        behind = np.where(np.einsum("ij,ij->i", before, behind)[:, None] < 0.0, -behind, behind)
        matrix = to_dcm(normalise((1.0 - share) * before + share * behind))
        columns = np.empty((len(at), 13))
        columns[:, :3] = np.einsum("nij,nj->ni", matrix, field)
        columns[:, 3:12] = matrix.reshape(-1, 9)
        columns[:, 12] = 1.0
        seconds = (at - self._origin) / SECOND
        numbers, first = np.unique(np.ceil(seconds / EPOCH_S - 1e-6), return_index=True)
        self._numbers.append(numbers)
        self._sums.append(np.add.reduceat(columns, first, axis=0))

    def means(self, epochs: Epochs) -> EpochField:
        """Means over the epochs that came of the same solutions."""
        summed = np.zeros((len(epochs), 13))
        if self._numbers:
            middle = (np.concatenate(self._numbers) - 0.5) * (EPOCH_S * SECOND)
            limits = epochs.time_ns - (self._origin or 0)
            epoch = np.clip(np.searchsorted(limits, middle) - 1, 0, len(epochs) - 1)
            np.add.at(summed, epoch, np.concatenate(self._sums))
        summed[epochs.gap] = 0.0
        count = summed[:, 12]
        mean = summed[:, :12] / np.maximum(count, 1.0)[:, None]
        return EpochField(mean[:, :3], mean[:, 3:].reshape(-1, 3, 3), count)
