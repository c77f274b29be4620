"""A start of a filter whose errors are independent."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sinstool.methods.ins_gnss.settings import Start
from sinstool.methods.strapdown.navigation import initial_state

FloatArray = NDArray[np.float64]


def start(
    latitude: float,
    longitude: float,
    height: float,
    velocity_n: ArrayLike,
    q_nb: ArrayLike,
    sigma_position_n: ArrayLike,
    sigma_velocity_n: ArrayLike,
    sigma_attitude_n: ArrayLike,
    **more: object,
) -> Start:
    """A start with independent errors.

    Parameters
    ----------
    latitude, longitude, height : float
        rad, rad, m.
    velocity_n : array_like, shape (3,)
        m/s.
    q_nb : array_like, shape (4,)
    sigma_position_n, sigma_velocity_n, sigma_attitude_n : array_like, shape (3,) or float
        m, m/s, rad.
    **more
        Other attributes of :class:`Start`.

    Returns
    -------
    Start
    """

    def square(sigma: ArrayLike) -> FloatArray:
        return np.diag(np.broadcast_to(np.asarray(sigma, dtype=np.float64), (3,)) ** 2)

    return Start(
        initial_state(latitude, longitude, height, velocity_n, q_nb),
        square(sigma_position_n),
        square(sigma_velocity_n),
        square(sigma_attitude_n),
        **more,  # type: ignore[arg-type]
    )
