"""The GNSS side: integrated specific force from velocity and position.

``i`` is the Earth frame ECEF frozen at the origin of time. The specific force integrated in
``i`` follows from velocity, the Earth's rate and gravity alone; no transport rate is needed,
and no pole and no date line is special.
"""

from __future__ import annotations

import numpy as np

from sinstool.core import earth
from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.order_statistics import median


def to_inertial(vectors_e: FloatArray, time_s: FloatArray) -> FloatArray:
    """Vectors of ECEF in ``i``: ``C_e^i(t) = R_z(omega_ie t)``, eq. (2) of Qu et al.

    Parameters
    ----------
    vectors_e : ndarray, shape (n, 3)
    time_s : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n, 3)
    """
    c, s = np.cos(earth.EARTH_RATE * time_s), np.sin(earth.EARTH_RATE * time_s)
    x, y = vectors_e[..., 0], vectors_e[..., 1]
    return np.stack([c * x - s * y, s * x + c * y, vectors_e[..., 2]], axis=-1)


def dcm_ni(latitude: FloatArray, longitude: FloatArray, time_s: FloatArray) -> FloatArray:
    """Inertial to NED, ``C_i^n(t) = C_e^n C_i^e(t)``; eq. (1) of Qu et al.

    Parameters
    ----------
    latitude, longitude, time_s : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n, 3, 3)
    """
    return earth.dcm_ne(latitude, np.asarray(longitude) + earth.EARTH_RATE * np.asarray(time_s))


def velocity_reference(
    time_s: FloatArray,
    latitude: FloatArray,
    longitude: FloatArray,
    height: FloatArray,
    velocity_n: FloatArray,
) -> FloatArray:
    """Specific force integrated from the first fix, in ``i``.

    ``d/dt (C_e^i v^e) = C_b^i f + C_e^i (g^e - omega_ie x v^e)``, integrated by the trapezoid
    rule between fixes; eq. (4) of Qu et al. in its integrated form.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Since the origin, increasing.
    latitude, longitude, height : ndarray, shape (n,)
    velocity_n : ndarray, shape (n, 3)
        Without gaps: leave out fixes that have none.

    Returns
    -------
    ndarray, shape (n, 3)
        m/s; zero at the very first fix.
    """
    c_en = np.swapaxes(earth.dcm_ne(latitude, longitude), -1, -2)
    velocity_e = np.einsum("nij,nj->ni", c_en, velocity_n)
    gravity_e = np.einsum("nij,nj->ni", c_en, earth.gravity_n(latitude, height))
    coriolis = np.stack(
        [-earth.EARTH_RATE * velocity_e[:, 1], earth.EARTH_RATE * velocity_e[:, 0], 0.0 * time_s],
        axis=-1,
    )
    velocity_i = to_inertial(velocity_e, time_s)
    integrand = to_inertial(coriolis - gravity_e, time_s)
    before = np.concatenate([integrand[:1], integrand[:-1]])
    step = np.diff(time_s, prepend=time_s[:1])
    integral = np.cumsum(0.5 * step[:, None] * (before + integrand), axis=0)
    return np.asarray(velocity_i - velocity_i[:1] + integral)


def acceleration_reference(
    time_s: FloatArray,
    latitude: FloatArray,
    longitude: FloatArray,
    height: FloatArray,
    velocity_n: FloatArray,
    central: bool,
) -> tuple[FloatArray, IntArray, IntArray, IntArray]:
    """Specific force at fixes, from differentiated velocity, in ``i``; eq. (4) of Qu et al.

    Parameters
    ----------
    time_s, latitude, longitude, height, velocity_n
        As for :func:`velocity_reference`.
    central : bool
        Difference of the neighbours on both sides, else of the fix and the one before.

    Returns
    -------
    force_i : ndarray, shape (n, 3)
        m/s^2.
    at, newer, older : ndarray of int64, shape (n,)
        Fix at which it stands, and the two whose velocities were differenced.
    """
    count = len(time_s)
    span = 2 if central else 1
    newer = np.arange(span, count)
    older = newer - span
    at = newer - 1 if central else newer
    step = time_s[newer] - time_s[older]
    usual = median(np.diff(time_s)) if count > 1 else 0.0
    close = step <= 1.5 * span * usual  # a difference over a gap is no derivative
    at, newer, older, step = at[close], newer[close], older[close], step[close]
    rate = (velocity_n[newer] - velocity_n[older]) / step[:, None]
    lat, h, v = latitude[at], height[at], velocity_n[at]
    turning = 2.0 * earth.earth_rate_n(lat) + earth.transport_rate_n(lat, h, v)
    force_n = rate + np.cross(turning, v) - earth.gravity_n(lat, h)
    c_in = np.swapaxes(dcm_ni(lat, longitude[at], time_s[at]), -1, -2)
    return np.einsum("nij,nj->ni", c_in, force_n), at, newer, older


def position_reference(
    time_s: FloatArray, latitude: FloatArray, longitude: FloatArray, height: FloatArray
) -> FloatArray:
    """Specific force integrated twice from positions alone, in ``i``.

    ``r_i(t) - r_i(0)`` less the double integral of gravitation; what start position and start
    velocity add is a constant and a slope, which the caller takes out.

    Parameters
    ----------
    time_s, latitude, longitude, height : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n, 3)
        m.
    """
    r_e = earth.ecef(latitude, longitude, height)
    c_en = np.swapaxes(earth.dcm_ne(latitude, longitude), -1, -2)
    gravitation_e = np.einsum("nij,nj->ni", c_en, earth.gravity_n(latitude, height))
    gravitation_e[:, :2] -= earth.EARTH_RATE**2 * r_e[:, :2]  # gravity less its centrifugal part
    r_i = to_inertial(r_e, time_s)
    gravitation = to_inertial(gravitation_e, time_s)
    step = np.diff(time_s)[:, None]
    once = np.zeros_like(r_i)
    np.cumsum(0.5 * step * (gravitation[1:] + gravitation[:-1]), axis=0, out=once[1:])
    twice = np.zeros_like(r_i)
    # Exact where gravitation is linear between fixes.
    inner = step * once[:-1] + step**2 * (gravitation[:-1] / 3.0 + gravitation[1:] / 6.0)
    np.cumsum(inner, axis=0, out=twice[1:])
    return np.asarray(r_i - r_i[0] - twice)
