"""Overlapping Allan and Hadamard variances of rates, streamed, with gaps that nothing bridges.

A segment of n samples has n + 1 phases, the sums of its samples. Second differences of phases m
apart are the Allan variance at m samples (Riley, Handbook of Frequency Stability Analysis, NIST
SP 1065, eq. 10 to 12), third differences the Hadamard variance. Differences are taken within
segments only; the sums of their squares over all segments are pooled.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.parts import njit

PER_OCTAVE = 3
# So many phases of an axis are kept; of longer logs every second, fourth, ... one, which serves
# the averaging times of at least so many samples between two that are kept.
MOST_PHASES = 2_000_000
COARSE = 64
# Differences this short are summed as blocks come, while they are in the processor's cache.
NEAR = 2048
ROWS = 16384
# The longest averaging time goes this often into the longest segment.
TIMES = 4


def stride_for(samples: int) -> int:
    """Stride, a power of two, at which phases of a segment of so many samples are stored."""
    stride = 1
    while samples > MOST_PHASES * stride:
        stride *= 2
    return stride


def averaging_lags(samples: int) -> IntArray:
    """Averaging times in samples, evenly spaced in the logarithm, shape (k,).

    Parameters
    ----------
    samples : int
        Of the longest segment; the longest averaging time is a quarter of it.

    Returns
    -------
    ndarray of int64
        Rising; powers of two among them. Empty for fewer than four samples.
    """
    if samples < TIMES:
        return np.empty(0, np.int64)
    steps = int(np.floor(PER_OCTAVE * np.log2(samples / TIMES) + 1e-9)) + 1
    stride = stride_for(samples)
    lags = np.round(2.0 ** (np.arange(steps) / PER_OCTAVE)).astype(np.int64)
    coarse = lags >= COARSE * stride
    lags[coarse] = np.round(lags[coarse] / stride) * stride
    return np.asarray(np.unique(lags))


@dataclass(frozen=True)
class Variances:
    """Allan and Hadamard variances of several columns.

    Attributes
    ----------
    lags : ndarray of int64, shape (k,)
        Averaging times in samples.
    allan, hadamard : ndarray, shape (k, c)
        Variances, in the square of the unit of the samples; NaN where nothing is so long, and that
        of Hadamard where the averaging time is no power of two.
    terms, hadamard_terms : ndarray of int64, shape (k,)
        Differences that each is the mean square of.
    """

    lags: IntArray
    allan: FloatArray
    hadamard: FloatArray
    terms: IntArray
    hadamard_terms: IntArray


class VarianceStage:
    """Sums up the differences of segments whose samples come in blocks.

    Parameters
    ----------
    lags : ndarray of int64, shape (k,)
        See :func:`averaging_lags`.
    stride : int
        One phase of so many is kept of a segment; lags of at least `COARSE` times as many must be
        multiples of it.
    columns : int
        Of the samples.
    block : int
        Phases so many samples apart are given back of each segment; a multiple of `stride`.
    hadamard : bool, optional
        Sum up third differences too, at powers of two.
    """

    def __init__(
        self, lags: IntArray, stride: int, columns: int, block: int, hadamard: bool = True
    ) -> None:
        self.lags = lags
        self.stride = stride
        self.block = block
        self.lengths: list[int] = []
        """Samples of each segment so far."""
        self.phases: list[FloatArray] = []
        """Phases of each segment, `block` samples apart, shape (n, columns)."""
        self._short = lags[lags < (max(NEAR, COARSE * stride) if stride > 1 else NEAR)]
        self._long = lags[len(self._short) :]
        self._third = np.isin(lags, 1 << np.arange(63)) if hadamard else np.zeros(len(lags), bool)
        self._sums = np.zeros((2, len(lags), columns))
        self._terms = np.zeros((2, len(lags)), np.int64)
        self._tail = np.empty((columns, 0))
        self._phases: list[FloatArray] = []
        self._count = 0

    def begin(self) -> None:
        """Begin a segment, after ending the one before."""
        self.end()
        self._phases = [np.zeros((len(self._tail), 1))]
        self._tail = np.zeros((len(self._tail), 1))
        self._count = 0

    def push(self, values: FloatArray) -> None:
        """Add samples to the segment.

        Parameters
        ----------
        values : ndarray, shape (n, columns)
            Best without their mean, so that sums stay small.
        """
        phase = np.cumsum(values, axis=0).T
        phase += self._tail[:, -1:]
        first = -self._count - 1 + self.stride * (self._count // self.stride + 1)
        self._phases.append(phase[:, first :: self.stride].copy())
        if len(self._short):
            joined = np.hstack((self._tail, phase))
            for column, row in enumerate(joined):
                self._add(self._short, row, column, 0, self._tail.shape[1])
            longest = 3 * int(self._short[-1])
            self._tail = joined[:, -longest:].copy()
        else:
            self._tail = phase[:, -1:].copy()
        self._count += len(values)

    def end(self) -> None:
        """End the segment."""
        if self._count:
            phases = []
            # Column by column, so that no second copy of all there is has to be made
            for column in range(len(self._tail)):
                phase = np.concatenate([part[column] for part in self._phases])
                self._add(self._long // self.stride, phase, column, len(self._short), 0)
                phases.append(phase[:: self.block // self.stride].copy())
            self.lengths.append(self._count)
            self.phases.append(np.stack(phases, axis=1))
        self._phases = []
        self._count = 0

    def _add(self, lags: IntArray, phase: FloatArray, column: int, at: int, begin: int) -> None:
        """Sums of the squared differences of a column that end at or after one of its phases."""
        count = len(phase)
        for k, lag in enumerate(lags.tolist(), start=at):
            third = bool(self._third[k])
            if column == 0:
                for order in (2, 3) if third else (2,):
                    terms = count - order * lag - max(begin - order * lag, 0)
                    self._terms[order - 2, k] += max(terms, 0)
            first = max(begin - 2 * lag, 0)
            if count - 2 * lag > first:
                self._sums[:, k, column] += _squares(phase, lag, first, third)

    def finish(self) -> Variances:
        """The variances of all segments."""
        self.end()
        with np.errstate(invalid="ignore", divide="ignore"):
            scaled = self._sums / self._terms[:, :, None] / self.lags[None, :, None] ** 2.0
        return Variances(
            self.lags, scaled[0] / 2.0, scaled[1] / 6.0, self._terms[0], self._terms[1]
        )


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def _squares(phase, lag, first, third):  # type: ignore[no-untyped-def]
    """Sums of squared second differences of phases from one on, and of third ones ending there."""
    second_sum, third_sum = 0.0, 0.0
    end = phase.shape[0] - 2 * lag
    alone = min(max(lag, first), end) if third else end
    # Slices, of whose indices the compiler knows that none is negative: ten times as fast
    a, b, c = phase[first:alone], phase[first + lag :], phase[first + 2 * lag :]
    for i in range(a.shape[0]):
        d = c[i] - 2.0 * b[i] + a[i]
        second_sum += d * d
    if alone < end:
        before, a = phase[alone - lag :], phase[alone:end]
        b, c = phase[alone + lag :], phase[alone + 2 * lag :]
        for i in range(a.shape[0]):
            d = c[i] - 2.0 * b[i] + a[i]
            e = d - (b[i] - 2.0 * a[i] + before[i])
            second_sum += d * d
            third_sum += e * e
    return second_sum, third_sum
