"""Initial state and parameters of a filter over epochs."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.methods.attitude_smoother import kernels, state
from sinstool.methods.attitude_smoother.epochs import DURATION, JB, Epochs, mean_force
from sinstool.methods.attitude_smoother.heading_update import NO_FIELD
from sinstool.methods.attitude_smoother.model import GRAVITY, LARGE_BIAS, MotionModel, SensorModel

FIRST_S = 3.0
# Standard deviations of tilt and heading at the start, rad: with a heading so certain its variance
# later is that of its change since the start.
TILT, HEADING = 0.2, 1e-4
# For a filter that takes the kinds of epochs as they are marked.
NO_KINDS = np.empty(0)


@dataclass(frozen=True)
class Prior:
    """Prior information about a log, beyond its samples.

    Attributes
    ----------
    heading : float
        Standard deviation of the first heading, rad; with 0 the covariance of heading is that of
        its change since the start.
    tilt : float or None
        See :func:`first_state`; None: unknown.
    gravity : float or None
        Local gravity, m/s^2; None: unknown.
    """

    heading: float = 0.0
    tilt: float | None = None
    gravity: float | None = None


def first_state(
    epochs: Epochs, motion: MotionModel, sensors: SensorModel, tilt: float | None = None
) -> tuple[FloatArray, FloatArray]:
    """State and covariance before the first epoch.

    Parameters
    ----------
    tilt : float, optional
        Standard deviation of the tilt at which the integration started, rad, but for what the bias
        of the accelerometers does to it. Without it the first tilt is the one that levels the mean
        specific force of the first seconds.

    Returns
    -------
    x : ndarray, shape (STATE,)
    p : ndarray, shape (n, n)
    """
    n = motion.states
    x = np.zeros(state.STATE)
    levelled = tilt is not None and tilt < TILT
    x[:9] = (np.eye(3) if levelled else upright(mean_force(epochs, FIRST_S))).ravel()
    x[state.B : state.B + 3] = sensors.bias_mean
    variance = np.empty(n)
    variance[:2] = TILT**2
    if tilt is not None and levelled:
        variance[:2] = tilt**2 + (sensors.accel_bias / GRAVITY) ** 2
    variance[2] = HEADING**2
    variance[3:6] = motion.first_velocity_variance
    variance[6:9] = sensors.bias**2
    variance[9] = sensors.gravity**2
    variance[10:] = sensors.accel_bias**2 if motion.finds_bias else motion.position_variance
    p = np.diag(variance)
    if levelled and motion.finds_bias:
        # the accelerometers that it was levelled by have the bias that is to be found
        row = epochs.values[0]
        north, east = row[JB : JB + 6].reshape(2, 3) / max(row[DURATION], 1e-9) / GRAVITY
        p[:2, 10:] = sensors.accel_bias**2 * np.stack([east, -north])
        p[10:, :2] = p[:2, 10:].T
    return x, p


def upright(force: FloatArray) -> FloatArray:
    """Matrix of the shortest rotation that turns a vector upwards, against gravity.

    Parameters
    ----------
    force : ndarray, shape (3,)
        NED.
    """
    size = sqrt(force @ force)
    if not size > 0.0:
        return np.eye(3)
    x, y, z = (force / size).tolist()
    # about (-y, x, 0), whose length is the sine, by an angle with the cosine -z
    square = x * x + y * y
    if square < 1e-24:
        return np.diag([1.0, 1.0, 1.0] if z < 0.0 else [1.0, -1.0, -1.0])
    k = (1.0 + z) / square
    return np.array(
        [[1.0 - k * x * x, -k * x * y, x], [-k * x * y, 1.0 - k * y * y, y], [-x, -y, -z]]
    )


def parameters(
    motion: MotionModel, sensors: SensorModel, omega_in_n: FloatArray | None = None
) -> FloatArray:
    """Parameters of the compiled filter, in its order."""
    return np.array(
        [
            motion.c1,
            motion.c0,
            motion.density,
            sensors.angle_random_walk,
            hypot(sensors.rate_error, sensors.missed),
            sensors.bias_walk,
            sensors.zero_rate,
            sensors.velocity_walk,
            sensors.gravity_walk,
            motion.velocity_variance,
            motion.position_variance,
            # level specific force at rest: the bias there, and the bias where the tilt was levelled
            np.sqrt(2.0) * sensors.accel_bias,
            sensors.bias_drift,
            # a linearisation so far off may deny rests wrongly: each pass checks them again
            float(sensors.bias > LARGE_BIAS),
            *(np.zeros(3) if omega_in_n is None else omega_in_n),
            float(motion.follows),
            sensors.stop_rate,
        ]
    )


def filtered(
    epochs: Epochs,
    motion: MotionModel,
    sensors: SensorModel,
    tilt: float | None = None,
    kinds: FloatArray = NO_KINDS,
) -> float:
    """Log likelihood of a log under a model of its motion.

    Parameters
    ----------
    tilt : float, optional
        See :func:`first_state`.
    kinds : ndarray, shape (n,), optional
        Output: the kind of each epoch, MOVING to AT_REST, as the filter judges it.

    Returns
    -------
    float
        Log likelihood of the specific force in the moving epochs; `DIVERGED` where the filter
        diverged.
    """
    x, p = first_state(epochs, motion, sensors, tilt)
    par = parameters(motion, sensors, epochs.omega_in_n)
    n, rows = motion.states, epochs.values
    return float(
        kernels.forward(
            rows, NO_FIELD, 0, len(rows), par, n, x, p, np.empty((0, state.STATE)),
            np.zeros(state.ERRORS), np.empty(state.STATE), np.empty(state.KEPT), kinds,
            *kernels.storage(0, n), *kernels.scratch(n),
        )
    )  # fmt: skip
