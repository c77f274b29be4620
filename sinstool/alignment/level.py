"""Roll and pitch from gravity."""

from __future__ import annotations

import numpy as np

from sinstool.rotation import from_euler


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
