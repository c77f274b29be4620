"""Answers of coning algorithms to classical coning at one frequency."""

import numpy as np

from sinstool.methods.coning import response


def drift_from_phi(phi, duration, frequency):
    """rad/s; see :func:`sinstool.methods.coning.response.drifts_from_phi`."""
    drift = response.drifts_from_phi(np.asarray(phi)[np.newaxis], duration, np.array([frequency]))
    return float(drift[0])


def coning_samples(half_angle, frequency, interval, count, gyro_kind):
    """Shape (count, 3)."""
    one = np.array([frequency])
    return response.coning_samples(half_angle, one, interval, count, gyro_kind)[0]


def coning_drift(algorithm, half_angle, frequency, interval, gyro_kind="mean-rate", **points):
    """rad/s."""
    at = np.array([float(frequency)])
    return float(
        response.coning_drifts(algorithm, half_angle, at, interval, gyro_kind, **points)[0]
    )


def coning_gain(algorithm, frequency, interval, gyro_kind="mean-rate", **points):
    """Fraction of the coning rate."""
    at = np.array([float(frequency)])
    return float(response.coning_gains(algorithm, at, interval, gyro_kind, **points)[0])


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
    return 4.0 * np.pi * frequency * np.sin(0.5 * half_angle) ** 2
