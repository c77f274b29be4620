"""The smoother over the epochs of a log, forwards and backwards, and its attitudes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.order_statistics import median
from sinstool.core.rotation import conjugate, exp, from_dcm, log, multiply, to_dcm
from sinstool.methods.attitude_smoother import kernels, state
from sinstool.methods.attitude_smoother.constant_errors import felt, lag, turned_wrongly
from sinstool.methods.attitude_smoother.correction import Correction
from sinstool.methods.attitude_smoother.epochs import ACCEL, Epochs, merged
from sinstool.methods.attitude_smoother.filter_step import DIVERGED
from sinstool.methods.attitude_smoother.heading_update import NO_FIELD
from sinstool.methods.attitude_smoother.magnetometer import North
from sinstool.methods.attitude_smoother.model import (
    FOLLOWER,
    GRAVITY,
    LARGE_BIAS,
    VEHICLE,
    MotionModel,
    SensorModel,
    as_calibrated,
    likely_accel_bias,
)
from sinstool.methods.attitude_smoother.start import NO_KINDS, Prior, first_state, parameters
from sinstool.methods.sensor_errors import CALIBRATED

NO_PRIOR = Prior()
# Epochs whose steps of the filter are stored at a time.
SEGMENT = 500
# Epochs whose turns are computed at a time
AT_ONCE = 1 << 14
# Mean gravity on Earth, m/s^2, and the largest difference from it anywhere below 3 km.
MEAN_GRAVITY, GRAVITY_RANGE = 9.807, 0.03
# Standard deviation of an angle of which nothing is known, rad.
UNKNOWN_ANGLE = np.pi / np.sqrt(3.0)
# In motion a larger excess than this is not due to accelerometer biases alone, m/s^2.
LIKELY_EXCESS = 0.3
# Where the gyro bias is as uncertain as LARGE_BIAS, rad/s, or the first tilt proves wrong by FAR,
# rad, linearising about the filter's own estimates is too far off. The smoother then runs again,
# linearised about its last result (an iterated smoother: each pass is a Gauss-Newton step), until a
# pass changes no tilt by CLOSE, rad. Where the bias is unknown the first passes assume stronger
# accelerations, so that they can leave a wrong start.
FAR, CLOSE = 0.05, 1e-3
PASSES = 20
WIDER = (4.0, 3.0, 2.0, 1.5)
# A pass that is less likely than an earlier one by LESS_LIKELY, nat, leads away from the solution.
# The result is then the last one within AS_LIKELY of the most likely, its covariance widened by its
# own step; likewise where the passes do not converge.
LESS_LIKELY, AS_LIKELY = 3.0, 0.5
# Where the variance of velocity exceeds this many times that of the model of a vehicle, the model
# is fitted to the result of the passes and they run again, at most ROUNDS times.
MORE, ROUNDS = 1.2, 4
# A vehicle's accelerations last long enough for epochs of a second: this many of 0.2 s.
COARSE = 5
# The result for a vehicle whose velocity follows its heading stands if it is more likely by this,
# nat, than without that; else the passes are repeated from the other result.
FOLLOWS_MARGIN = 3.0
# Manoeuvres last some seconds, but the likelihood counts each second as if it were independent.
TEMPERED = 0.25
NO_STATES = np.empty((0, state.STATE))
NOTHING_FOUND = np.empty(0)
# The variances of the accelerometers' biases among the numbers kept of a covariance.
BIASES = slice(14, 17)


def smooth(
    epochs: Epochs,
    motion: MotionModel,
    sensors: SensorModel,
    prior: Prior = NO_PRIOR,
    north: North | None = None,
) -> Correction:
    """Smooth over a whole log.

    Parameters
    ----------
    epochs : Epochs
        At least one; with rest marked.
    motion : MotionModel
    sensors : SensorModel
    prior : Prior, optional
        Of the first attitude, and of gravity.
    north : North, optional
        Headings of a magnetometer, which take the place of the prior heading.

    Returns
    -------
    Correction
    """
    if not motion.c0:
        motion = replace(motion, finds_bias=sensors.accel_bias > 0.0)
        if north is None:
            epochs = merged(epochs, COARSE, by_kind=True)
    run = _Run(epochs, sensors, prior, north)
    result = run.converged(motion)
    if not motion.c0 and (sensors.bias > LARGE_BIAS or result.likelihood <= DIVERGED):
        # a wrong bias turns the velocity wrongly, which in turn confirms the wrong bias: the
        # likelihood tells which of the results is right
        other = run.converged(_freed(motion) if motion.follows else _following(motion))
        found = [result, other]
        if motion.follows and other.likelihood > result.likelihood - FOLLOWS_MARGIN:
            found.append(run.converged(motion, other.states))
            result = max(found, key=lambda one: one.likelihood)
        if not result.likelihood > DIVERGED:
            result = other
        if result.likelihood > DIVERGED:
            result = _widened(result, found)
    smoothed, covariance = result.states, result.covariance
    q = from_dcm(smoothed[:, :9].reshape(-1, 3, 3))
    attitude = covariance[:, :9].reshape(-1, 3, 3).copy()
    gyro_bias = _found_bias(sensors, smoothed, covariance)
    if gyro_bias is not None:
        sensors = as_calibrated(sensors, gyro_bias)
    poor = 0.0
    if sensors.bias_removed is not None and sensors.accel_bias:
        off = gravity_off(_gravity_shown(epochs, smoothed), prior.gravity)
        poor = likely_accel_bias(gyro_bias, off)
    if motion.finds_bias:
        shown = covariance[-1, BIASES]
        left = _of_poor(shown, result.accel_bias, poor)
        sigma = sqrt(np.mean(left))
        attitude[:, [0, 1], [0, 1]] += np.mean(left - shown) / GRAVITY**2
        # Misalignment of the gyros' axes and those of the accelerometers: the tilt of a vehicle
        # that turns refers to the vertical in the gyros' axes.
        attitude[:, [0, 1], [0, 1]] += sensors.rate_error**2
    else:
        # The bias of a level accelerometer looks like a tilt.
        sigma = accel_bias_sigma(
            max(sensors.accel_bias, poor), _gravity_shown(epochs, smoothed), prior.gravity
        )
        attitude[:, [0, 1], [0, 1]] += (sigma / GRAVITY) ** 2
    attitude[:, [0, 1], [0, 1]] += lag(epochs, smoothed, attitude, sensors)[:, None]
    if north is None:
        attitude[:, 2, 2] += prior.heading**2 + turned_wrongly(felt(epochs, smoothed, 2), sensors)
    else:
        attitude[:, 2, 2] += north.variance
    bound_sigmas(attitude)
    return Correction(
        epochs.time_ns,
        q,
        _turns(q),
        smoothed[:, state.B : state.B + 3].copy(),
        attitude,
        np.sqrt(covariance[:, 9:12]),
        sigma,
        smoothed[-1, state.A : state.A + 3].copy() if motion.finds_bias else None,
        not result.likelihood > DIVERGED,
    )


def bound_sigmas(covariance_n: FloatArray) -> None:
    """Limit sigmas to that of a uniformly distributed angle, the largest there is.

    Where the filter left its linear range variances may be negative or not finite: nothing is known
    of the angle there.
    """
    variance = np.einsum("nii->ni", covariance_n)
    astray = ~((variance > 0.0) & np.isfinite(variance)).all(axis=1)
    covariance_n[astray] = UNKNOWN_ANGLE**2 * np.eye(3)
    share = np.minimum(1.0, UNKNOWN_ANGLE / np.sqrt(np.einsum("nii->ni", covariance_n)))
    covariance_n *= share[:, :, None] * share[:, None, :]


def _turns(q: FloatArray) -> FloatArray:
    """Rotation vectors from each attitude to the next."""
    out = np.empty((max(len(q) - 1, 0), 3))
    # This many at a time, as each is held in memory several times
    for begin in range(0, len(out), AT_ONCE):
        end = min(begin + AT_ONCE, len(out))
        out[begin:end] = log(multiply(q[begin + 1 : end + 1], conjugate(q[begin:end])))
    return out


@dataclass(frozen=True)
class _Result:
    """Result of passes that converged: states and covariances at the limits of epochs, likelihood.

    `accel_bias` is the standard deviation of the accelerometers' biases that was assumed, m/s^2.
    """

    states: FloatArray
    covariance: FloatArray
    likelihood: float
    accel_bias: float


@dataclass(frozen=True)
class _Run:
    """Passes over a log, with what all of them have in common."""

    epochs: Epochs
    sensors: SensorModel
    prior: Prior
    north: North | None

    def converged(self, motion: MotionModel, near: FloatArray = NO_STATES) -> _Result:
        """Pass until the tilt no longer changes; the first pass is linear about `near`, if any."""
        epochs, sensors = self.epochs, self.sensors
        field = NO_FIELD if self.north is None else self.north.rows
        covariance = np.empty((len(epochs) + 1, state.KEPT))
        wider = WIDER if self.sensors.bias > LARGE_BIAS and not len(near) else ()
        rounds, most = 0, DIVERGED
        kept: _Result | None = None
        for k in range(PASSES):
            model = motion.with_density(motion.density * wider[k]) if k < len(wider) else motion
            first = _first(epochs, model, sensors, self.prior, self.north)
            before = near
            near, likelihood = _pass(epochs, model, sensors, first, field, before, covariance)
            if kept is not None and not likelihood > most - LESS_LIKELY:
                return kept
            begun = before if len(before) else first[0][None]
            close = CLOSE if len(before) else FAR
            if k < len(wider) or not likelihood > DIVERGED:
                continue
            result = _Result(near, covariance, likelihood, sensors.accel_bias)
            if _moved(begun, near[: len(begun)]) < close:
                fitted = _as_fast(motion, epochs, near, covariance)
                bias = self._bias_shown(motion, near, covariance)
                more = bias**2 > MORE * sensors.accel_bias**2
                if (fitted is motion and not more) or rounds == ROUNDS:
                    return result
                motion, rounds, most, kept = fitted, rounds + 1, DIVERGED, None
                sensors = replace(sensors, accel_bias=bias) if more else sensors
            elif len(before) and likelihood > most - AS_LIKELY:
                most, kept = max(most, likelihood), _farther(result, before, 1.0)
        return kept or self._nothing(motion)

    def _nothing(self, motion: MotionModel) -> _Result:
        """Result where the filter diverged: the integrated attitude, of which nothing is known."""
        x, _ = _first(self.epochs, motion, self.sensors, self.prior, self.north)
        covariance = np.zeros((len(self.epochs) + 1, state.KEPT))
        covariance[:, [0, 4, 8]] = UNKNOWN_ANGLE**2
        covariance[:, 9:12] = self.sensors.bias**2
        covariance[:, BIASES] = self.sensors.accel_bias**2
        states = np.tile(x, (len(covariance), 1))
        return _Result(states, covariance, DIVERGED, self.sensors.accel_bias)

    def _bias_shown(
        self, motion: MotionModel, smoothed: FloatArray, covariance: FloatArray
    ) -> float:
        """Standard deviation of the accelerometers' biases, from their grade and a pass, m/s^2."""
        if not motion.finds_bias:
            return 0.0
        shown = _gravity_shown(self.epochs, smoothed)
        found = smoothed[-1, state.A : state.A + 3] ** 2 + covariance[-1, BIASES]
        return accel_bias_sigma(self.sensors.accel_bias, shown, self.prior.gravity, found)


def _as_fast(
    motion: MotionModel, epochs: Epochs, smoothed: FloatArray, covariance: FloatArray
) -> MotionModel:
    """The model with the mean square velocity that a pass has found, where that is larger.

    How fast a vehicle may be at its first and at its last epoch sets how wrong a constant tilt may
    be, and the value of a car is too small for an aircraft.
    """
    moving = ~epochs.rest & ~epochs.gap
    if motion.c0 or not moving.any():
        return motion
    level = smoothed[:-1][moving, state.V : state.V + 2] ** 2
    if motion.follows:
        level = level + covariance[:-1][moving, 12:14]
    variance = float(np.mean(level))
    return motion.with_velocity(variance) if variance > MORE * motion.velocity_variance else motion


def _freed(motion: MotionModel) -> MotionModel:
    """The model without the constraint that a wrong bias spoils: velocity along the heading."""
    return replace(VEHICLE, density=motion.density, finds_bias=motion.finds_bias)


def _following(motion: MotionModel) -> MotionModel:
    """The model of a vehicle whose velocity follows its heading, with the same density."""
    return replace(FOLLOWER, density=motion.density, finds_bias=motion.finds_bias)


def _widened(best: _Result, found: list[_Result]) -> _Result:
    """The best of several results, its covariance widened by their distances from it.

    A circle with small biases and straight travel with large ones can be about as likely, though
    they are far apart and each has small sigmas.
    """
    weight = np.exp([TEMPERED * (one.likelihood - best.likelihood) for one in found])
    weight /= weight.sum()
    wide = best
    for share, one in zip(weight, found, strict=True):
        if one is not best:
            wide = _farther(wide, one.states, share)
    return wide


def _farther(result: _Result, other: FloatArray, share: float) -> _Result:
    """A result with its covariance widened by a share of the squared distance of other states."""
    covariance = result.covariance.copy()
    q = from_dcm(result.states[:, :9].reshape(-1, 3, 3))
    off = log(multiply(from_dcm(other[:, :9].reshape(-1, 3, 3)), conjugate(q)))
    covariance[:, :9] += share * (off[:, :, None] * off[:, None, :]).reshape(-1, 9)
    bias = slice(state.B, state.B + 3)
    covariance[:, 9:12] += share * (other[:, bias] - result.states[:, bias]) ** 2
    return replace(result, covariance=covariance)


def _gravity_shown(epochs: Epochs, smoothed: FloatArray) -> float:
    """Size of gravity that the log shows, m/s^2: at rest, else the smoother's estimate."""
    if epochs.rest.any():
        return gravity_at_rest(epochs)
    excess = float(median(smoothed[:, state.G]))
    return GRAVITY + min(max(excess, -LIKELY_EXCESS), LIKELY_EXCESS)


def gravity_at_rest(epochs: Epochs) -> float:
    """Size of gravity, m/s^2, in the epochs that are marked as rest."""
    force = epochs.values[epochs.rest, ACCEL : ACCEL + 3]
    return float(median(np.linalg.norm(force, axis=1)))


def _found_bias(
    sensors: SensorModel, smoothed: FloatArray, covariance: FloatArray
) -> FloatArray | None:
    """Bias of gyros that may be uncalibrated, rad/s; None if calibrated, or not known.

    Where it is known best, as one that wanders far is known only at a rest; NaN for axes of which
    it is not known even there, as where a rest may be an even turn.
    """
    sigma = np.sqrt(covariance[:, 9:12])
    known = sigma < CALIBRATED
    if sensors.bias_removed is None or not known.any():
        return None
    best = int(np.lexsort((sigma.max(axis=1), -known.sum(axis=1)))[0])
    bias = smoothed[best, state.B : state.B + 3] + sensors.bias_removed
    return np.asarray(np.where(known[best], bias, np.nan))


def gravity_off(shown: float, gravity: float | None) -> float:
    """Difference of gravity in a log from that of its place, m/s^2.

    Where no place is known, the least difference from gravity anywhere.
    """
    if gravity is None:
        return max(0.0, abs(shown - MEAN_GRAVITY) - GRAVITY_RANGE)
    return shown - gravity


def _of_poor(shown: FloatArray, grade: float, poor: float) -> FloatArray:
    """Variances left of the accelerometers' biases if these are worse than their grade allows.

    Parameters
    ----------
    shown : ndarray, shape (3,)
        Variances left with the biases of the grade, m^2/s^4.
    grade, poor : float
        Standard deviations assumed, and of worse sensors, m/s^2.
    """
    if poor <= grade:
        return shown
    information = np.maximum(1.0 / shown - 1.0 / grade**2, 0.0)
    return np.asarray(1.0 / (information + 1.0 / poor**2))


def accel_bias_sigma(
    grade: float, shown: float, gravity: float | None, found: FloatArray = NOTHING_FOUND
) -> float:
    """Standard deviation of the bias of an accelerometer axis, m/s^2.

    Parameters
    ----------
    grade : float
        That of their grade; it counts as three axes beside those that the log shows. 0: there are
        no biases.
    shown : float
        Size of gravity in the log, m/s^2.
    gravity : float or None
        Local, m/s^2.
    found : ndarray, shape (m,), optional
        Mean squares of biases that a filter has estimated, m^2/s^4.
    """
    if not grade:
        return 0.0
    off = gravity_off(shown, gravity)
    return sqrt((3.0 * grade**2 + off**2 + found.sum()) / (4.0 + len(found)))


def _first(
    epochs: Epochs,
    motion: MotionModel,
    sensors: SensorModel,
    prior: Prior,
    north: North | None,
) -> tuple[FloatArray, FloatArray]:
    """State and covariance before the first epoch, turned to where a magnetometer shows north."""
    x, p = first_state(epochs, motion, sensors, prior.tilt)
    if north is not None:
        x[:9] = (to_dcm(exp([0.0, 0.0, north.start])) @ x[:9].reshape(3, 3)).ravel()
        p[2, 2] = north.start_sigma**2
    return x, p


def _moved(before: FloatArray, after: FloatArray) -> float:
    """Largest change of the tilt between two passes, rad."""
    up = slice(6, 9)  # the last row of the attitude matrix
    return float(np.sqrt(np.max(np.sum((after[:, up] - before[:, up]) ** 2, axis=1))))


def _pass(
    epochs: Epochs,
    motion: MotionModel,
    sensors: SensorModel,
    first: tuple[FloatArray, FloatArray],
    field: FloatArray,
    near: FloatArray,
    covariance: FloatArray,
) -> tuple[FloatArray, float]:
    """One pass forwards and backwards; smoothed states, shape (n + 1, STATE), and likelihood.

    Parameters
    ----------
    first : tuple of ndarray
        State and covariance before the first epoch.
    field : ndarray, shape (n, FIELD_WIDTH) or (0, FIELD_WIDTH)
        Of the magnetometer.
    near : ndarray, shape (n + 1, STATE) or (0, STATE)
        States of the last pass, to linearise about; none: the filter's own estimates.
    covariance : ndarray, shape (n + 1, KEPT)
        Output: covariances of the attitude and variances of the gyro bias.
    """
    n, count, rows = motion.states, len(epochs), epochs.values
    par = parameters(motion, sensors, epochs.omega_in_n)
    smoothed = np.empty((count + 1, state.STATE))
    last = np.empty(state.STATE), np.empty(state.KEPT)
    stored, scratch = kernels.storage(min(SEGMENT, count), n), kernels.scratch(n)
    segments = [(begin, min(begin + SEGMENT, count)) for begin in range(0, count, SEGMENT)]

    def forward(begin: int, end: int, x: FloatArray, p: FloatArray, dx: FloatArray) -> float:
        one = kernels.forward(
            rows, field, begin, end, par, n, x, p, near, dx, *last, NO_KINDS, *stored, *scratch
        )  # fmt: skip
        return float(one)

    x, p, dx = first[0].copy(), first[1].copy(), np.zeros(state.ERRORS)
    starts, likelihood = [], 0.0
    for segment in segments:
        starts.append((x.copy(), p.copy(), dx.copy()))
        likelihood += forward(*segment, x, p, dx)
    smoothed[count], covariance[count] = last
    for segment, start in zip(reversed(segments), reversed(starts), strict=True):
        if segment is not segments[-1]:  # whose steps are still stored
            forward(*segment, *start)
        kernels.backward(
            *segment,
            n,
            motion.c0 > 0.0,
            *stored,
            x,
            p,
            dx,
            smoothed,
            covariance,
            len(near) > 0,
            *scratch,
        )
    return smoothed, likelihood
