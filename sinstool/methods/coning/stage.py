"""Rotation vectors from the gyro samples of one segment, block by block.

A segment is a stretch of a log without gaps. Its first sample gives the instant at which it
starts; every interval after that belongs to exactly one update, and the results are the same, bit
for bit, however the segment is cut into blocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import ArrayLike, FloatArray, IntArray
from sinstool.methods.coning import increments
from sinstool.methods.coning.algorithm import ConingAlgorithm


@dataclass(frozen=True)
class RotationVectors:
    """Rotation vectors of consecutive updates.

    Attributes
    ----------
    sample : ndarray of int64, shape (n,)
        Number within the segment, from 0, of the gyro sample at which each update ends.
    time_ns : ndarray of int64, shape (n,)
        Time of that sample.
    interval : ndarray, shape (n,)
        Duration of each update, s.
    rotation_vector : ndarray, shape (n, 3)
        Of the body over the update against inertial space, in the body frame, rad.
    """

    sample: IntArray
    time_ns: IntArray
    interval: FloatArray
    rotation_vector: FloatArray


class ConingStage:
    """State of a coning algorithm that runs over one segment.

    Parameters
    ----------
    algorithm : ConingAlgorithm
        See :func:`sinstool.methods.coning.registry.algorithm`; its form for the kind of sample is
        used.
    gyro_kind : {"rate", "mean-rate", "increment"}
        What the samples are; see `sinstool.core.conventions`. Rates for an algorithm
        that takes increments are integrated by
        :class:`~sinstool.methods.coning.increments.RateIntegrator`; increments for one that takes
        rates are divided by their intervals.
    nominal_interval : float, optional
        Interval of the log's gyro, s. Needed for ``mean-rate`` and ``increment``, whose
        first sample belongs to the interval before the segment and serves as history.
    points : int, optional
        Samples of the rate interpolation.

    Raises
    ------
    ValueError
        If an argument is impossible or the nominal interval is missing.
    """

    def __init__(
        self,
        algorithm: ConingAlgorithm,
        gyro_kind: increments.GyroKind,
        *,
        nominal_interval: float | None = None,
        points: int = increments.DEFAULT_POINTS,
    ) -> None:
        if gyro_kind not in increments.GYRO_KINDS:
            raise ValueError(
                f"Expected `gyro_kind` to be one of {increments.GYRO_KINDS}, got {gyro_kind!r}."
            )
        if gyro_kind == "rate":
            nominal_interval = np.nan  # a rate has no interval: nothing may use that of row 0
        elif nominal_interval is None or not nominal_interval > 0.0:
            raise ValueError(
                f"Expected a positive `nominal_interval` for {gyro_kind}, got {nominal_interval}."
            )
        algorithm = algorithm.for_kind(gyro_kind)
        self.algorithm = algorithm
        self.gyro_kind: increments.GyroKind = gyro_kind
        self._first_interval = float(nominal_interval)
        self._integrator = (
            increments.RateIntegrator(points)
            if gyro_kind == "rate" and algorithm.takes == "increments"
            else None
        )
        self._tails = [algorithm.shorter(n) for n in range(1, algorithm.samples)]
        self._keep = max(a.before for a in [algorithm, *self._tails])
        self._rates = _Window(0)  # waiting for their neighbours, with an integrator only
        self._rows = _Window(1 if self._integrator else 0)  # as the algorithm takes them
        self._last_sample_ns: int | None = None
        self._last_update_ns = 0
        self._next_increment = 1
        self._next = 1  # first row of the next update
        self._finished = False

    def push(self, gyro: ArrayLike, time_ns: ArrayLike) -> RotationVectors:
        """Take the next samples of the segment.

        Parameters
        ----------
        gyro : array_like, shape (n, 3)
            Samples in the body frame: rad/s, or rad for increments.
        time_ns : array_like of int64, shape (n,)
            Their times, strictly increasing from block to block.

        Returns
        -------
        RotationVectors
            Of the updates that are complete with their look-ahead; may be none.

        Raises
        ------
        ValueError
            If shapes do not fit or time does not increase.
        RuntimeError
            After :meth:`finish`.
        """
        if self._finished:
            raise RuntimeError("The segment is finished; a new one needs a new stage.")
        samples = np.asarray(gyro, dtype=np.float64)
        times = np.asarray(time_ns)
        if samples.ndim != 2 or samples.shape[1] != 3 or times.shape != samples.shape[:1]:
            raise ValueError(
                f"Expected shapes (n, 3) and (n,), got {samples.shape} and {times.shape}."
            )
        if not np.issubdtype(times.dtype, np.integer) and times.size:
            raise ValueError(f"Expected `time_ns` to be integer nanoseconds, got {times.dtype}.")
        times = times.astype(np.int64)
        if len(samples):
            self._append(samples, times, self._intervals(times))
        return self._drain(final=False)

    def finish(self) -> RotationVectors:
        """Updates from the samples left over at the end of the segment.

        Returns
        -------
        RotationVectors
            Of the updates that were waiting for later samples, and of one shorter update
            if fewer intervals are left than the algorithm takes.

        Raises
        ------
        RuntimeError
            If called twice.
        """
        if self._finished:
            raise RuntimeError("The segment is finished already.")
        self._finished = True
        return self._drain(final=True)

    def _intervals(self, times: IntArray) -> FloatArray:
        if self._last_sample_ns is None:
            steps = np.diff(times)
            dt = np.concatenate([[self._first_interval], steps * 1e-9])
            self._last_update_ns = int(times[0])
        else:
            steps = np.diff(times, prepend=np.int64(self._last_sample_ns))
            dt = steps * 1e-9
        if np.any(steps <= 0):
            raise ValueError("Time does not increase within the segment.")
        self._last_sample_ns = int(times[-1])
        return dt

    def _append(self, samples: FloatArray, times: IntArray, dt: FloatArray) -> None:
        if self._integrator is not None:
            self._rates.append(samples, dt, times)
            return
        x = increments.convert(samples, dt, self.gyro_kind, self.algorithm.takes)
        self._rows.append(x, dt, times)

    def _integrate(self, final: bool) -> None:
        """Turn rates whose neighbours have come into increments."""
        assert self._integrator is not None
        window = self._rates
        count = window.end - self._next_increment - (0 if final else self._integrator.after)
        if count <= 0:
            return
        first = self._next_increment - window.start
        rows = slice(first, first + count)
        self._rows.append(
            self._integrator.increments(window.x, window.dt, first, count),
            window.dt[rows],
            window.time_ns[rows],
        )
        self._next_increment += count
        window.forget(self._next_increment - self._integrator.before)

    def _drain(self, final: bool) -> RotationVectors:
        if self._integrator is not None:
            self._integrate(final)
        window = self._rows
        size = self.algorithm.samples
        rows = max(window.end - self._next, 0)
        count = max(rows - (0 if final else self.algorithm.after), 0) // size
        first = self._next - window.start
        ends = self._next + size * np.arange(1, count + 1) - 1
        phi = self.algorithm.rotation_vectors(window.x, window.dt, first, count)
        left = rows - count * size if final else 0
        if left:
            tail = self._tails[left - 1]
            last = tail.rotation_vectors(window.x, window.dt, first + count * size, 1)
            phi = np.concatenate([phi, last])
            ends = np.append(ends, window.end - 1)
        times = window.time_ns[ends - window.start]
        interval = np.diff(times, prepend=np.int64(self._last_update_ns)) * 1e-9
        if len(ends):
            self._next = int(ends[-1]) + 1
            self._last_update_ns = int(times[-1])
            window.forget(self._next - self._keep)
        return RotationVectors(ends.astype(np.int64), times, interval, phi)


class _Window:
    """Consecutive rows of a segment: those that are still needed."""

    def __init__(self, start: int) -> None:
        self.start = start  # number of the first row within the segment
        self.x: FloatArray = np.empty((0, 3))
        self.dt: FloatArray = np.empty(0)
        self.time_ns: IntArray = np.empty(0, dtype=np.int64)

    @property
    def end(self) -> int:
        return self.start + len(self.x)

    def append(self, x: FloatArray, dt: FloatArray, time_ns: IntArray) -> None:
        self.x = np.concatenate([self.x, x])
        self.dt = np.concatenate([self.dt, dt])
        self.time_ns = np.concatenate([self.time_ns, time_ns])

    def forget(self, before: int) -> None:
        """Drop the rows with numbers less than `before`."""
        gone = before - self.start
        if gone > 0:
            self.x = self.x[gone:]
            self.dt = self.dt[gone:]
            self.time_ns = self.time_ns[gone:]
            self.start += gone
