"""When to align: calm flight by limits on force, rate and their changes.

Qu et al., eqs. (12) and (13): sensors saturate and GNSS suffers in a boost, and there the
derivative of velocity lags; the start therefore waits until both inertial norms and their
changes are small, and the stop until they have been small for a while.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import ROUNDING, BoolArray, FloatArray, IntArray
from sinstool.core.order_statistics import median
from sinstool.core.units import STANDARD_GRAVITY
from sinstool.methods.alignment.inflight_types import GateLimits, ImuIncrements

LIFT_OFF_FORCE = 2.0 * STANDARD_GRAVITY
LIFT_OFF_S = 0.1
MIN_FOR_CLIPPING = 100
BLOCK_ROWS = 65_536
_TIME_SLACK = 1e-6


@dataclass(frozen=True)
class Dynamics:
    """Inputs of the gate, sample by sample.

    Attributes
    ----------
    time_ns : ndarray of int64, shape (n,)
    force, force_step, rate, rate_step : ndarray, shape (n,)
        Norms: m/s^2, m/s^3, rad/s, rad/s^2. The first changes are 0.
    """

    time_ns: IntArray
    force: FloatArray
    force_step: FloatArray
    rate: FloatArray
    rate_step: FloatArray

    def within(self, limits: GateLimits) -> BoolArray:
        """The first four tests of eqs. (12) and (13), shape (4, n)."""
        return np.stack(
            [
                self.force < limits.f_set,
                self.force_step < limits.f_step_set,
                self.rate < limits.w_set,
                self.rate_step < limits.w_step_set,
            ]
        )


def dynamics(imu: ImuIncrements, smooth: int = 1) -> Dynamics:
    """Norms of force and rate, and of their changes over one sample.

    Parameters
    ----------
    smooth : int
        Samples up to each whose mean stands for it, before anything else.
    """
    step = np.diff(imu.time_ns) * 1e-9
    if not len(step):
        step = np.ones(1)
    step = np.concatenate([step[:1], step])[: len(imu)]
    norms = np.empty((4, len(imu)))
    for k, increment in ((0, imu.delta_velocity), (2, imu.delta_theta)):
        # A block at a time, as a long log has more samples than should be held several times.
        before = np.empty((0, 3))
        for begin in range(0, len(imu), BLOCK_ROWS):
            rows = slice(begin, begin + BLOCK_ROWS)
            value = increment[rows] / step[rows, None]
            if smooth > 1:
                early = slice(max(begin - smooth + 1, 0), begin + BLOCK_ROWS)
                mean = _trailing_mean(increment[early] / step[early, None], smooth)
                value = mean[begin - early.start :]
            change = np.diff(value, axis=0, prepend=before if begin else value[:1])
            before = value[-1:]
            norms[k, rows] = np.linalg.norm(value, axis=1)
            norms[k + 1, rows] = np.linalg.norm(change / step[rows, None], axis=1)
    return Dynamics(imu.time_ns, norms[0], norms[1], norms[2], norms[3])


def _trailing_mean(values: FloatArray, width: int) -> FloatArray:
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(values, axis=0)])
    end = np.arange(1, len(values) + 1)
    begin = np.maximum(end - width, 0)
    return np.asarray((sums[end] - sums[begin]) / (end - begin)[:, None])


def run_lengths(flags: BoolArray) -> IntArray:
    """Number of true flags in a row up to each sample."""
    index = np.arange(len(flags))
    last = np.maximum.accumulate(np.where(flags, -1, index)) if len(flags) else index
    return np.asarray(np.where(flags, index - last, 0))


def lift_off(motion: Dynamics) -> int | None:
    """Index of the first sample of the first 0.1 s above 2 g; None where there is none."""
    above = motion.force > LIFT_OFF_FORCE
    if not above.any():
        return None
    index = np.arange(len(above))
    begin = index - run_lengths(above) + 1
    time = motion.time_ns
    step = median(np.diff(time)) if len(time) > 1 else 0.0
    long = (time - time[np.minimum(begin, index)] + step) * 1e-9 >= LIFT_OFF_S - _TIME_SLACK
    first = np.flatnonzero(above & long)
    return int(begin[first[0]]) if len(first) else None


def find_start(motion: Dynamics, limits: GateLimits, lift_off_ns: int) -> int | None:
    """First sample at which alignment may start, eq. (12).

    Returns
    -------
    int or None
        Index; the ``n_set1``-th sample in a row that passes all five tests.
    """
    late = (motion.time_ns - lift_off_ns) * 1e-9 >= limits.t_set1 - _TIME_SLACK
    runs = run_lengths(motion.within(limits).all(axis=0) & late)
    ends = np.flatnonzero(runs >= max(limits.n_set1, 1))
    return int(ends[0]) if len(ends) else None


def find_stop(motion: Dynamics, limits: GateLimits, start: int) -> int | None:
    """First sample at which alignment is over, eq. (13).

    Parameters
    ----------
    start : int
        Index of the start.

    Returns
    -------
    int or None
        The ``n_set2``-th sample in a row that is calm and ``t_set2`` after the start.
    """
    elapsed = (motion.time_ns - motion.time_ns[start]) * 1e-9
    calm = motion.within(limits).all(axis=0) & (elapsed >= limits.t_set2 - _TIME_SLACK)
    ends = np.flatnonzero(run_lengths(calm) >= max(limits.n_set2, 1))
    return int(ends[0]) if len(ends) else None


def why_no_start(motion: Dynamics, limits: GateLimits, lift_off_ns: int) -> str:
    """Which limits kept eq. (12) from holding, and for how long."""
    late = (motion.time_ns - lift_off_ns) * 1e-9 >= limits.t_set1 - _TIME_SLACK
    if not late.any():
        last = (motion.time_ns[-1] - lift_off_ns) * 1e-9
        if last < 0.0:
            return "it ends before lift-off"
        return f"it ends {last:.1f} s after lift-off, but the gate waits {limits.t_set1:g} s"
    after = motion.time_ns[late]
    every = np.diff(motion.time_ns)
    step = float(median(every)) * 1e-9 if len(every) else 0.0
    blocked = (~motion.within(limits)[:, late]).sum(axis=1) * step
    names = ("|f|", "change of f", "|omega|", "change of omega")
    parts = [f"{n} for {b:.1f} s" for n, b in zip(names, blocked, strict=True) if b > 0.0]
    return f"of {len(after) * step:.1f} s, over the limit: " + ", ".join(parts)


def saturated(imu: ImuIncrements, gyro_limit: float | None, accel_limit: float | None) -> BoolArray:
    """Samples with an axis at the end of its range.

    Parameters
    ----------
    gyro_limit, accel_limit : float, optional
        Ranges, rad/s and m/s^2; unknown ones are not tested.

    Returns
    -------
    ndarray of bool, shape (n,)
        True also for the sample after, whose interval may begin at the limit.
    """
    step = np.diff(imu.time_ns, prepend=imu.time_ns[:1]) * 1e-9
    if len(step) > 1:
        step[0] = step[1]
    hit = np.zeros(len(imu), dtype=bool)
    for values, limit in ((imu.delta_theta, gyro_limit), (imu.delta_velocity, accel_limit)):
        if limit is not None:
            hit |= (np.abs(values) >= (1.0 - 1e-6) * limit * step[:, None]).any(axis=1)
    hit[1:] |= hit[:-1].copy()
    return hit


def looks_clipped(imu: ImuIncrements) -> str | None:
    """Sensor whose largest value comes many times in a row, as where it is clipped.

    Returns
    -------
    str or None
        ``gyro x`` or alike. At least five samples in a row hold exactly the extreme value of
        their axis, while that is far above what is usual there.
    """
    step = np.diff(imu.time_ns)[:, None] * 1e-9
    for name, values in (("gyro", imu.delta_theta), ("accelerometer", imu.delta_velocity)):
        if len(step) < MIN_FOR_CLIPPING:
            break
        size = np.abs(values[1:]) / step
        top = size.max(axis=0)
        usual = median(size, axis=0)
        # A laser gyro at rest counts 0 or 1
        steps = np.abs(np.concatenate([values, np.diff(values, axis=0)]))
        counted = steps > ROUNDING * steps.max(axis=0)
        smallest = np.min(steps, axis=0, where=counted, initial=np.inf) / float(median(step))
        for axis in range(3):
            at_top = size[:, axis] >= top[axis] * (1.0 - 1e-6)
            if (
                top[axis] > 10.0 * max(usual[axis], smallest[axis])
                and run_lengths(at_top).max() >= 5
            ):
                return f"{name} {'xyz'[axis]}"
    return None
