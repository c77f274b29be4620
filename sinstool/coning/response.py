"""How any coning algorithm answers classical coning, in closed form.

In classical coning every update is the one before it, turned about the cone's axis. The
product of any number of them is therefore known from one: no simulation, no accumulated
rounding, valid for large cone angles and beyond half the sample rate.

References
----------
.. [1] L. E. Goodman, A. R. Robinson, "Effect of finite rotations on gyroscopic sensing
   devices", J. Applied Mechanics 25, 1958, 210-213 (the solid angle of a cone).
"""

from __future__ import annotations

from math import atan2, copysign, cos, pi, sin, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sinstool.coning.algorithm import ConingAlgorithm
from sinstool.coning.increments import DEFAULT_POINTS, GyroKind, RateIntegrator, convert

FloatArray = NDArray[np.float64]

# A cone this narrow has no terms beyond theta**2 left in float64's relative 1e-8.
_NARROW = 1e-4


def drift_from_phi(rotation_vector: ArrayLike, duration: float, frequency: float) -> float:
    """Long-term drift of an algorithm from its answer for one update of classical coning.

    Parameters
    ----------
    rotation_vector : array_like, shape (3,)
        Answer for any one update, rad, of coning about the body's z axis whose rate vector
        turns about +z (as in :func:`coning_samples`).
    duration : float
        Of the update, s.
    frequency : float
        Of the coning, Hz.

    Returns
    -------
    float
        rad/s, positive where the computed attitude drifts the way the mean of the gyro's z
        axis points, as it does with too little compensation.

    Raises
    ------
    ValueError
        If the rotation vector is not of length 3.

    Notes
    -----
    With ``e = exp(phi)`` of the first update and ``r`` the turn of the pattern about z over
    one update, the product of K updates is ``(e r)**K r**-K``. True updates give an ``e r``
    that turns by exactly as much as ``r``; the drift is the difference of the two angles
    per update. The difference is formed from ``cos(A) - cos(h)`` of the half angles, which
    does not cancel, so the result is good to about 1e-13 of the coning rate.
    """
    phi = np.asarray(rotation_vector, dtype=np.float64)
    if phi.shape != (3,):
        raise ValueError(f"Expected `rotation_vector` to have shape (3,), got {phi.shape}.")
    angle = float(np.linalg.norm(phi))
    e_z = float(phi[2]) * (sin(0.5 * angle) / angle if angle else 0.5)
    e_w = cos(0.5 * angle)
    h = pi * frequency * duration
    cos_h, sin_h = cos(h), sin(h)
    # cos A = cos h + delta, with e_w - 1 = -2 sin(angle/4)**2
    delta = -2.0 * sin(0.25 * angle) ** 2 * cos_h - e_z * sin_h
    square = sin_h * sin_h - 2.0 * delta * cos_h - delta * delta
    sin_a = copysign(sqrt(max(square, 0.0)), e_w * sin_h + e_z * cos_h)
    cos_a = cos_h + delta
    if sin_a * sin_h > 0.0:
        sine = cos_h * (-2.0 * delta * cos_h - delta * delta) / (sin_a + sin_h) - sin_h * delta
    else:
        sine = sin_a * cos_h - cos_a * sin_h
    difference = atan2(sine, cos_a * cos_h + sin_a * sin_h)
    return -2.0 * difference / duration


def coning_rate(half_angle: float, frequency: float) -> float:
    """Rate that classical coning feigns on the gyro of the cone's axis.

    Parameters
    ----------
    half_angle : float
        Of the cone, rad.
    frequency : float
        Of the coning, Hz.

    Returns
    -------
    float
        Magnitude of the mean z rate, rad/s: the solid angle per time,
        ``2 pi f * 2 sin(half_angle / 2)**2``.
    """
    return 4.0 * pi * frequency * sin(0.5 * half_angle) ** 2


def coning_samples(
    half_angle: float, frequency: float, interval: float, count: int, gyro_kind: GyroKind
) -> FloatArray:
    """Exact gyro samples of classical coning about the body's z axis.

    Parameters
    ----------
    half_angle : float
        Of the cone, rad.
    frequency : float
        Of the coning, Hz.
    interval : float
        Between samples, s.
    count : int
        Number of samples; the first is at time 0.
    gyro_kind : {"rate", "mean-rate", "increment"}
        See the conventions in :mod:`sinstool`.

    Returns
    -------
    ndarray, shape (count, 3)
        rad/s or rad. Attitude ``q = [cos(a/2), sin(a/2) cos Wt, sin(a/2) sin Wt, 0]``
        has the rate ``W [-sin a sin Wt, sin a cos Wt, -2 sin(a/2)**2]``.
    """
    turn = 2.0 * pi * frequency
    k = np.arange(count)
    # Whole turns are taken off in units of turns: beyond half the sample rate too.
    late = 2.0 * pi * np.mod(frequency * interval * k, 1.0)
    z = -2.0 * turn * sin(0.5 * half_angle) ** 2
    if gyro_kind == "rate":
        scale, gain, phase = 1.0, turn * sin(half_angle), late
    else:
        # Over an interval: the rate at its middle times sin(lambda/2) / (lambda/2).
        scale = interval if gyro_kind == "increment" else 1.0
        gain = 2.0 * sin(half_angle) * sin(0.5 * turn * interval) / interval
        phase = late - 0.5 * turn * interval
    rate = np.stack([-gain * np.sin(phase), gain * np.cos(phase), np.full(count, z)], axis=-1)
    return scale * rate


def coning_drift(
    algorithm: ConingAlgorithm,
    half_angle: float,
    frequency: float,
    interval: float,
    gyro_kind: GyroKind = "mean-rate",
    *,
    points: int = DEFAULT_POINTS,
) -> float:
    """Long-term drift of an algorithm in classical coning.

    Parameters
    ----------
    algorithm : ConingAlgorithm
        With all the history and look-ahead it wants.
    half_angle : float
        Of the cone, rad.
    frequency : float
        Of the coning, Hz.
    interval : float
        Between gyro samples, s.
    gyro_kind : {"rate", "mean-rate", "increment"}, optional
        What the samples are; turned into what the algorithm takes as a log would be.
    points : int, optional
        Samples of the rate interpolation.

    Returns
    -------
    float
        rad/s; positive for too little compensation.
    """
    integrator = RateIntegrator(points)
    pad = points  # beyond the algorithm's own window, so that no stencil is off its centre
    first = pad + max(algorithm.before, 1)
    count = first + algorithm.samples + algorithm.after + pad
    gyro = coning_samples(half_angle, frequency, interval, count, gyro_kind)
    dt = np.full(count, interval)
    if gyro_kind == "rate" and algorithm.takes == "increments":
        x = np.zeros_like(gyro)
        x[1:] = integrator.increments(gyro, dt, 1, count - 1)
    else:
        x = convert(gyro, dt, gyro_kind, algorithm.takes)
    window = slice(first - max(algorithm.before, 1), first + algorithm.samples + algorithm.after)
    phi = algorithm.rotation_vectors(x[window], dt[window], max(algorithm.before, 1), 1)
    return drift_from_phi(phi[0], algorithm.samples * interval, frequency)


def coning_gain(
    algorithm: ConingAlgorithm,
    frequency: float,
    interval: float,
    gyro_kind: GyroKind = "mean-rate",
    *,
    points: int = DEFAULT_POINTS,
) -> float:
    """Fraction of the true coning rate that an algorithm reproduces, for narrow cones.

    Parameters
    ----------
    algorithm : ConingAlgorithm
        With all the history and look-ahead it wants.
    frequency : float
        Of the coning, Hz; not a multiple of the update rate, where the sampled motion is
        a constant rate and the fraction unbounded.
    interval : float
        Between gyro samples, s.
    gyro_kind : {"rate", "mean-rate", "increment"}, optional
        What the samples are.
    points : int, optional
        Samples of the rate interpolation.

    Returns
    -------
    float
        1 for a perfect algorithm, 0 for one that sees no coning at all.
    """
    drift = coning_drift(algorithm, _NARROW, frequency, interval, gyro_kind, points=points)
    return 1.0 - drift / coning_rate(_NARROW, frequency)
