"""The velocity at a start by the positions around it, less the motion that the IMU shows.

A velocity derived from positions alone is a mean over seconds, in which a vehicle accelerates and
its antenna swings to and fro. With an attitude, the IMU shows both. What it leaves of the positions
is a straight line, bent by the errors of attitude and sensors, whose sizes are known:

    r(t) = p_0 + v_0 t + psi x s(t) + b_g t x s(t) / 3 + b_a t^2 / 2

s is the second integral of the specific force. The term with the gyros' bias b_g is exact for a
constant force, and small.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.rotation import skew

# Fewer positions show no velocity.
LEAST = 3


def velocity_by_positions(
    seconds: FloatArray,
    place_n: FloatArray,
    force_way_n: FloatArray,
    fall_n: FloatArray,
    sigma_m: FloatArray,
    covariance_attitude_n: FloatArray,
    gyro_bias_sigma: float,
    accel_bias_sigma: float,
) -> tuple[FloatArray, FloatArray] | None:
    """Velocity at a time by least squares, with the errors of attitude and sensors as unknowns.

    Parameters
    ----------
    seconds : ndarray, shape (n,)
        From that time.
    place_n : ndarray, shape (n, 3)
        Of the IMU, NED, m, from any place.
    force_way_n : ndarray, shape (n, 3)
        Second integral of the specific force from that time, NED, m.
    fall_n : ndarray, shape (3,)
        Gravity and the Coriolis acceleration, NED, m/s^2.
    sigma_m : ndarray, shape (3,)
        White noise of positions, m.
    covariance_attitude_n : ndarray, shape (3, 3)
        rad^2.
    gyro_bias_sigma, accel_bias_sigma : float
        Of what is left of the biases, rad/s and m/s^2.

    Returns
    -------
    (ndarray, shape (3,), ndarray, shape (3, 3)) or None
        m/s, and its covariance, which grows with residuals larger than expected; None with too few
        positions.
    """
    n = len(seconds)
    if n < LEAST:
        return None
    t = seconds[:, None, None]
    line = place_n - force_way_n - 0.5 * fall_n * seconds[:, None] ** 2
    turn, one = -skew(force_way_n), np.broadcast_to(np.eye(3), (n, 3, 3))
    model = np.concatenate([one, t * one, turn, t * turn / 3.0, 0.5 * t**2 * one], axis=2)
    model = (model / sigma_m[:, None]).reshape(3 * n, 15)
    measured = (line / sigma_m).ravel()
    prior = np.zeros((15, 15))
    prior[6:9, 6:9] = np.linalg.inv(covariance_attitude_n + 1e-12 * np.eye(3))
    prior[9:12, 9:12] = np.eye(3) / max(gyro_bias_sigma, 1e-9) ** 2
    prior[12:, 12:] = np.eye(3) / max(accel_bias_sigma, 1e-9) ** 2
    covariance = np.asarray(np.linalg.inv(model.T @ model + prior))
    found = covariance @ (model.T @ measured)
    left = measured - model @ found
    square = float(left @ left + found @ prior @ found) / (3 * n - 6)
    return found[3:6], np.asarray(covariance[3:6, 3:6] * max(square, 1.0))
