"""A record at one place, divided into rest and half-second windows of motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sinstool.core import earth, rotation
from sinstool.core.english import counted
from sinstool.methods.alignment.inflight_types import FloatArray, ImuIncrements
from sinstool.methods.alignment.still import WINDOW_NS, WindowStage, still_spans
from sinstool.methods.strapdown.attitude import AttitudePropagator

# A gap longer than this, s, interrupts the attitude carried by the gyros.
_GAP_S = 0.1
_HUBER_ROUNDS = 5
# Median length of a vector by the standard deviation of its three components.
_MEDIAN_TO_SIGMA = 1.5382
# Averaging times, in windows, at which the noise of the gyros is estimated, and the least number of
# windows of a rest that is used for it.
_ALLAN_WINDOWS = (1, 4, 16)
_ALLAN_LEAST = 20
_DIFFERENCES = 4
# A rest is a rocking base if gravity is steadier by this factor in the axes that the gyros keep,
# over so many windows.
_ROCKING = 1.5
_ROCKING_WINDOWS = 4


@dataclass(frozen=True)
class Stretch:
    """A stretch of the record.

    Attributes
    ----------
    duration : float
        s.
    rate : ndarray, shape (3,)
        Mean angular rate, body axes, rad/s.
    force : ndarray, shape (3,)
        Mean specific force in body axes, m/s^2; in motion in those at the stretch's start.
    turn : ndarray, shape (4,)
        Rotation of the body against inertial space over it, by the gyros.
    force_variance : float
        Of each component of `force`, (m/s^2)^2.
    """

    still: bool
    duration: float
    rate: FloatArray
    force: FloatArray
    turn: FloatArray
    force_variance: float


@dataclass(frozen=True)
class Record:
    """Stretches without gaps, in order, and the measurements over them.

    Attributes
    ----------
    angle_random_walk : float
        White noise of one gyro, rad/sqrt(s).
    walk_at_rest : bool
        That noise was seen in the mean rates of a rest too, not only from sample to sample.
    velocity_random_walk : float
        White noise of one accelerometer, (m/s)/sqrt(s).
    shake : float
        Robust standard deviation of a window's mean specific force in motion, m/s^2.
    """

    stretches: list[Stretch]
    start_ns: int
    end_ns: int
    duration_s: float
    angle_random_walk: float
    walk_at_rest: bool
    velocity_random_walk: float
    shake: float
    warnings: tuple[str, ...]


def cut(imu: ImuIncrements) -> Record:
    """Cut a record; of one with gaps the longest part.

    Parameters
    ----------
    imu : ImuIncrements
        Row 0 only serves as history.

    Returns
    -------
    Record
        With no stretch if there are fewer than three samples.
    """
    imu, warnings = _longest_part(imu)
    time, dtheta, dvelocity = imu.time_ns, imu.delta_theta, imu.delta_velocity
    if len(time) < 3:
        start = int(time[0]) if len(time) else 0
        return Record([], start, start, 0.0, 0.0, False, 0.0, 0.0, warnings)
    dt = np.diff(time) * 1e-9
    last, dtheta, dvelocity = dtheta[:-1], dtheta[1:], dvelocity[1:]
    rate, force = dtheta / dt[:, None], dvelocity / dt[:, None]
    # The first row is only history: its interval is not known.
    coned = dtheta.copy()
    coned[1:] += np.cross(last[1:], dtheta[1:]) / 12.0
    attitudes = AttitudePropagator([1.0, 0.0, 0.0, 0.0]).push(coned, dt)
    start_q = np.concatenate([[[1.0, 0.0, 0.0, 0.0]], attitudes[:-1]])
    middle = rotation.multiply(start_q, rotation.exp(0.5 * dtheta))
    inertial = rotation.rotate(middle, dvelocity)
    stage = WindowStage()
    stage.push(time[1:], rate, force)
    windows = stage.finish()
    index = (time[1:] - time[1]) // WINDOW_NS
    first = np.flatnonzero(np.concatenate([[True], np.diff(index) > 0]))
    last_row = np.concatenate([first[1:], [len(index)]]) - 1

    def total(values: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(values, first, axis=0))

    duration = total(dt)
    mean_inertial = total(inertial) / duration[:, None]
    spans = still_spans(windows)
    member = np.full(len(first), -1)
    for k, span in enumerate(spans):
        inside = (windows.start_ns >= span.start_ns) & (windows.start_ns < span.end_ns)
        if inside.sum() >= _ALLAN_LEAST:
            member[inside] = k
    off = _unsteady(mean_inertial, np.cumsum(duration) - 0.5 * duration)
    if _rocks(total(dvelocity) / duration[:, None], mean_inertial, member):
        member[:] = -1
    moving = member < 0
    shake = float(np.median(off[moving]) * np.sqrt(3.0) / _MEDIAN_TO_SIGMA) if moving.any() else 0.0
    at_rest = _allan(total(dtheta) / duration[:, None], member)
    angle = max(_white(dtheta, dt, index), at_rest)
    velocity = _white(dvelocity, dt, index)
    begin_q, end_q = start_q[first], attitudes[last_row]
    turn = rotation.multiply(rotation.conjugate(begin_q), end_q)
    in_start_axes = rotation.rotate(rotation.conjugate(begin_q), mean_inertial)
    sums = np.concatenate([total(dtheta), total(dvelocity)], axis=1)
    stretches: list[Stretch] = []
    k = 0
    while k < len(first):
        end = k + 1
        if not moving[k]:
            while end < len(first) and member[end] == member[k]:
                end += 1
        span_s = float(duration[k:end].sum())
        mean = sums[k:end].sum(axis=0) / span_s
        across = rotation.multiply(rotation.conjugate(begin_q[k]), end_q[end - 1])
        one = Stretch(not moving[k], span_s, mean[:3], mean[3:], across, velocity**2 / span_s)
        if moving[k]:
            # A knock must not weigh more than it deserves, nor rocking less than it shakes.
            rough = one.force_variance + max(shake**2, float(off[k]) ** 2)
            one = replace(one, turn=turn[k], force=in_start_axes[k], force_variance=rough)
        stretches.append(one)
        k = end
    return Record(
        stretches,
        int(time[0]),
        int(time[-1]),
        float(dt.sum()),
        angle,
        at_rest > 0.0,
        velocity,
        shake,
        warnings,
    )


def _longest_part(imu: ImuIncrements) -> tuple[ImuIncrements, tuple[str, ...]]:
    """The longest part of a record between gaps, without repeated times, and a warning of gaps."""
    imu = imu.rows(np.diff(imu.time_ns, prepend=imu.time_ns[:1] - 1) > 0)
    breaks = np.flatnonzero(np.diff(imu.time_ns) > _GAP_S * 1e9) + 1
    if not len(breaks):
        return imu, ()
    edges = np.concatenate([[0], breaks, [len(imu)]])
    longest = int(np.argmax(np.diff(edges)))
    imu = imu.rows(slice(int(edges[longest]), int(edges[longest + 1])))
    text = (
        f"the record has {counted(len(breaks), 'gap')} of more than {_GAP_S:g} s; its longest part"
        f" of {(imu.time_ns[-1] - imu.time_ns[0]) * 1e-9:.0f} s is used"
    )
    return imu, (text,)


def _unsteady(force: FloatArray, middle: FloatArray) -> FloatArray:
    """Difference of each window's force from gravity, root mean square of the axes.

    In axes that do not turn gravity goes round once a day; drifting gyros add a slow trend. A fit
    of both that heeds outliers little (Huber's weights).
    """
    t = (middle - middle[0]) / 3600.0
    day = earth.EARTH_RATE * 3600.0 * t
    basis = np.stack([np.ones_like(t), t, t * t, np.cos(day), np.sin(day)], axis=1)
    off = np.zeros(len(force))
    weight = np.ones(len(force))
    for _ in range(_HUBER_ROUNDS):
        root = np.sqrt(weight)[:, None]
        fit, *_ = np.linalg.lstsq(root * basis, root * force, rcond=None)
        off = np.linalg.norm(force - basis @ fit, axis=1) / np.sqrt(3.0)
        weight = 1.0 / np.maximum(off / max(2.0 * float(np.median(off)), 1e-12), 1.0)
    return np.asarray(off)


def _rocks(bodily: FloatArray, inertial: FloatArray, member: np.ndarray) -> bool:
    """Whether a rest is a rocking base: gravity sways in the body, not in the axes gyros keep."""
    lag = _ROCKING_WINDOWS
    pairs = (member[lag:] >= 0) & (member[:-lag] >= 0)
    if not pairs.any():
        return False
    sway, left = (
        np.median(np.linalg.norm(f[lag:] - f[:-lag], axis=1)[pairs]) for f in (bodily, inertial)
    )
    return bool(sway > _ROCKING * left)


def _white(increment: FloatArray, dt: FloatArray, index: np.ndarray) -> float:
    """White noise from sample to sample: that of the median window, so that knocks are left out.

    By fourth differences: rocking at 1 Hz and 1 rad/s leaves 2e-5 rad/s in them at 100 Hz.
    """
    if len(dt) <= _DIFFERENCES:
        return 0.0
    # Fourth differences of white noise have the sum of the squared coefficients, 70, of its power.
    power = np.mean(np.diff(increment / dt[:, None], n=_DIFFERENCES, axis=0) ** 2, axis=1) / 70.0
    density = power * dt[_DIFFERENCES:]
    starts = np.flatnonzero(np.concatenate([[True], np.diff(index[_DIFFERENCES:]) > 0]))
    counts = np.diff(np.concatenate([starts, [len(density)]]))
    return float(np.sqrt(np.median(np.add.reduceat(density, starts) / counts)))


def _allan(mean_rate: FloatArray, member: np.ndarray) -> float:
    """White noise as it appears in the Allan variance at rest, the largest of some times.

    A sensor that filters its output shows less noise from sample to sample than it integrates.
    """
    walks = [0.0]
    for span in np.unique(member[member >= 0]):
        rows = mean_rate[member == span]
        for many in _ALLAN_WINDOWS:
            clusters = len(rows) // many
            if clusters >= _ALLAN_LEAST:
                mean = rows[: clusters * many].reshape(clusters, many, 3).mean(axis=1)
                variance = 0.5 * np.mean(np.diff(mean, axis=0) ** 2)
                walks.append(float(np.sqrt(variance * many * WINDOW_NS * 1e-9)))
    return max(walks)
