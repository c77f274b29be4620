"""Roll and pitch from gravity."""

from __future__ import annotations

import numpy as np

from sinstool.core.rotation import exp, from_euler, multiply, rotate


def level(specific_force_b: np.ndarray, heading: float = 0.0) -> np.ndarray:
    """Attitude of a body at rest from its specific force.

    At rest ``f_b = -C_bn g_n``, so the measured specific force points up.

    Parameters
    ----------
    specific_force_b : ndarray, shape (3,)
        Mean specific force in body axes (FRD), m/s^2; its size does not matter.
    heading : float
        Heading to give the attitude, rad.

    Returns
    -------
    ndarray, shape (4,)
        q_nb.

    Raises
    ------
    ValueError
        The specific force is zero.

    References
    ----------
    Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems,
    2nd ed., eqs (5.100)-(5.101).
    """
    f = np.asarray(specific_force_b, dtype=np.float64)
    if f.shape != (3,):
        raise ValueError(f"specific_force_b must have shape (3,), got {f.shape}")
    if not np.linalg.norm(f) > 0.0:
        raise ValueError("specific force is zero: it has no direction")
    roll = np.arctan2(-f[1], -f[2])
    pitch = np.arctan2(f[0], np.hypot(f[1], f[2]))
    return from_euler([roll, pitch, heading])


def tilted(
    q_nb: np.ndarray, covariance: np.ndarray, specific_force_b: np.ndarray, accel_bias: float
) -> tuple[np.ndarray, np.ndarray]:
    """An attitude at rest that was found otherwise, made better by its specific force.

    Parameters
    ----------
    q_nb : ndarray, shape (4,)
    covariance : ndarray, shape (3, 3)
        Of psi in NED, rad^2: `q_nb` is ``(I + [psi x])`` times the true one.
    specific_force_b : ndarray, shape (3,)
        Mean at rest, body axes (FRD), m/s^2.
    accel_bias : float
        Its uncertainty about each axis, m/s^2.

    Returns
    -------
    q_nb : ndarray, shape (4,)
    covariance : ndarray, shape (3, 3)
        After one update with both horizontal components: at rest these are zero, and
        ``f_N = g psi_E`` up to sign where an attitude is wrong.
    """
    size = float(np.linalg.norm(specific_force_b))
    seen = rotate(q_nb, specific_force_b) / size
    # -e_d turned by psi: (-psi_E, psi_N, -1).
    measured = np.array([seen[1], -seen[0]])
    h = np.eye(2, 3)
    gain = (
        covariance
        @ h.T
        @ np.linalg.inv(h @ covariance @ h.T + (accel_bias / size) ** 2 * np.eye(2))
    )
    keep = np.eye(3) - gain @ h
    better = keep @ covariance @ keep.T + (accel_bias / size) ** 2 * gain @ gain.T
    return multiply(exp(-(gain @ measured)), q_nb), better
