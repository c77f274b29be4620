"""A body at rest on the Earth."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sinstool.core import earth, rotation
from sinstool.simulation.truth import ImuTruth, check_times


def static(
    time_ns: ArrayLike,
    q_nb: ArrayLike,
    latitude: float,
    height: float = 0.0,
) -> ImuTruth:
    """Exact samples of a body at rest: Earth rate and the reaction to gravity.

    Parameters
    ----------
    time_ns : array_like of int64, shape (n,)
        Instants, increasing, two at least; see
        :func:`~sinstool.simulation.truth.sample_times`.
    q_nb : array_like, shape (4,)
        Attitude of FRD in NED.
    latitude : float
        Geodetic, rad.
    height : float, optional
        Ellipsoidal, m.

    Returns
    -------
    ImuTruth
        ``omega_ib_b = C_bn omega_ie_n`` and ``f_b = -C_bn g_n``, the same in every row.

    Raises
    ------
    ValueError
        If a shape is wrong, the quaternion zero or time not increasing.
    """
    times, interval = check_times(time_ns)
    attitude = rotation.normalise(q_nb)
    if attitude.shape != (4,):
        raise ValueError(f"Expected `q_nb` to have shape (4,), got {attitude.shape}.")
    q_bn = rotation.conjugate(attitude)
    rows = (len(times), 1)
    rate = np.tile(rotation.rotate(q_bn, earth.earth_rate_n(latitude)), rows)
    force = np.tile(rotation.rotate(q_bn, -earth.gravity_n(latitude, height)), rows)
    return ImuTruth(
        time_ns=times,
        interval=interval,
        gyro_rate=rate,
        gyro_mean_rate=rate.copy(),
        gyro_increment=rate * interval[:, np.newaxis],
        specific_force=force,
        mean_specific_force=force.copy(),
        q_nb=np.tile(attitude, rows),
    )
