"""A navigation that is carried back from a later state, and its covariance.

A step of the errors forward is ``x' = F x + w``, so that before it ``P = F^-1 (P' + Q) F^-T``.
Errors of sensors are as large as the filter assumes, and vary as they do there.

References
----------
.. [1] P. D. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
   Systems", 2nd ed., 2013, section 14.2.4: errors resolved in local axes, less the small terms.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.rotation import skew, to_dcm
from sinstool.methods.ins_gnss import states
from sinstool.methods.ins_gnss.parameters import sensor_densities
from sinstool.methods.ins_gnss.settings import TURN, Start
from sinstool.methods.sensor_errors import SensorGrade
from sinstool.methods.strapdown import navigation
from sinstool.methods.strapdown.velocity import Increments

STEP_S = 1.0
# Blocks of three errors: position, velocity, attitude, biases and scale factors of both sensors.
P, V, A, BG, BA, SG, SA = (slice(3 * k, 3 * k + 3) for k in range(7))
SIZE = 21


def navigated_back(start: Start, updates: Increments) -> FloatArray:
    """States before each update and after the last, which is the start's.

    Parameters
    ----------
    start : Start
        At the end of the last update.
    updates : Increments
        n of them, biases not taken off.

    Returns
    -------
    ndarray, shape (n + 1, SIZE)
        See :func:`~sinstool.methods.strapdown.navigation.initial_state`.
    """
    dt = updates.interval
    rows = np.empty((len(dt) + 1, navigation.SIZE))
    rows[-1] = start.nav
    navigation.navigate_backward(
        start.nav.copy(),
        np.ascontiguousarray(updates.rotation_vector - start.gyro_bias * dt[:, None]),
        np.ascontiguousarray(updates.velocity_increment - start.accel_bias * dt[:, None]),
        np.ascontiguousarray(dt),
        rows[:-1],
    )
    return rows


def carried_back(
    start: Start,
    imu: SensorGrade,
    updates: Increments,
    q_nb: FloatArray,
    turned_unseen: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Covariances of position, velocity and attitude before a start.

    Parameters
    ----------
    start : Start
        At the end of the last update.
    updates : Increments
        n of them, biases not taken off.
    q_nb : ndarray, shape (n + 1, 4)
        Attitude at the start of each, and at the end of the last.
    turned_unseen : ndarray, shape (n, 3), optional
        Variances of turns during each update that the gyros have not seen, NED, rad^2.

    Returns
    -------
    seconds : ndarray, shape (m,)
        Before the start, from 0 on.
    covariance : ndarray, shape (m, 9, 9)
        North, east, down: m, m/s, rad.
    """
    dt = updates.interval
    p = _first(start, imu)
    if not len(dt):
        return np.array([0.0, STEP_S]), np.array([p[:9, :9]] * 2)
    c_nb = to_dcm(q_nb[:-1])
    turned = updates.rotation_vector - start.gyro_bias * dt[:, None]
    gained = updates.velocity_increment - start.accel_bias * dt[:, None]
    before = np.cumsum(dt[::-1])[::-1]  # the start's time less that of each update's start
    begins = np.flatnonzero(np.diff(np.floor(before / STEP_S), prepend=np.inf))

    def total(values: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(values, begins, axis=0))

    across = np.zeros((len(dt), 6)) if updates.lost is None else updates.lost
    lost = np.concatenate(
        [np.einsum("nij,nj,nkj->nik", c_nb, across[:, of], c_nb) for of in (P, V)], axis=1
    )
    steps = zip(
        total(dt),
        total(np.einsum("nij,nj->ni", c_nb, gained)),
        total(c_nb * dt[:, None, None]),
        total(c_nb * turned[:, None, :]),
        total(c_nb * gained[:, None, :]),
        np.zeros((len(begins), 3)) if turned_unseen is None else total(turned_unseen),
        total(lost),
        strict=True,
    )
    seconds, covariances = [0.0], [p[:9, :9]]
    densities = _noise(imu)
    for length, force, turn, turn_scale, force_scale, unseen, bridged in reversed(list(steps)):
        f = np.eye(SIZE)
        f[P, V] = length * np.eye(3)
        f[V, A], f[V, BA], f[V, SA] = skew(force), turn, force_scale
        f[P, A], f[P, BA], f[P, SA] = (
            0.5 * length * f[V, A],
            0.5 * length * turn,
            (0.5 * length * force_scale),
        )
        f[A, BG], f[A, SG] = turn, turn_scale
        noise = np.diag(densities * length)
        # Misalignment tilts the attitude across the axis of a turn
        turned_n = turn_scale.sum(axis=1)
        angle = max(float(np.linalg.norm(turned_n)), 1e-12)
        across = angle * np.eye(3) - np.outer(turned_n, turned_n) / angle
        noise[A, A] += imu.gyro_misalignment**2 * TURN * across + np.diag(unseen) + bridged[:3]
        noise[V, V] += bridged[3:]
        back = np.linalg.inv(f)
        p = back @ (p + noise) @ back.T
        seconds.append(seconds[-1] + float(length))
        covariances.append(p[:9, :9])
    return np.array(seconds), np.array(covariances)


def _first(start: Start, imu: SensorGrade) -> FloatArray:
    p = np.zeros((SIZE, SIZE))
    p[P, P], p[V, V] = start.covariance_position_n, start.covariance_velocity_n
    p[A, A] = start.covariance_attitude_n
    gyro = imu.gyro_bias if start.gyro_bias_sigma is None else start.gyro_bias_sigma
    accel = imu.accel_bias if start.accel_bias_sigma is None else start.accel_bias_sigma
    for block, sigma in ((BG, gyro), (BA, accel), (SG, imu.gyro_scale), (SA, imu.accel_scale)):
        p[block, block] = sigma**2 * np.eye(3)
    return p


def _noise(imu: SensorGrade) -> FloatArray:
    """Power densities of what drives the errors, shape (21,)."""
    q, of = np.zeros(SIZE), sensor_densities(imu)
    q[V], q[A], q[BG], q[BA] = (
        of[block]
        for block in (states.VELOCITY, states.ATTITUDE, states.GYRO_BIAS, states.ACCEL_BIAS)
    )
    q[SG], q[SA] = of[states.GYRO_SCALE], of[states.ACCEL_SCALE]
    return q
