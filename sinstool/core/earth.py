"""Earth model: WGS-84 ellipsoid, rotation, gravity.

Angles in rad, heights ellipsoidal in m, positive up. Every function broadcasts over its
arguments; vectors are in NED on a last axis of length 3.

References
----------
.. [1] NIMA TR8350.2, "Department of Defense World Geodetic System 1984", 3rd ed., 2000.
.. [2] P. D. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
   Systems", 2nd ed., 2013, chapter 2.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import ArrayLike, FloatArray

SEMI_MAJOR_AXIS = 6378137.0
"""Equatorial radius, m; table 3.1 of [1]_."""

FLATTENING = 1.0 / 298.257223563
"""(a - b) / a; table 3.1 of [1]_."""

SEMI_MINOR_AXIS = SEMI_MAJOR_AXIS * (1.0 - FLATTENING)
"""Polar radius, m."""

ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)
"""First eccentricity, squared."""

EARTH_RATE = 7.292115e-5
"""Angular rate of the Earth against inertial space, rad/s; table 3.1 of [1]_."""

GRAVITATIONAL_CONSTANT = 3.986004418e14
"""GM of the Earth with its atmosphere, m^3/s^2; table 3.1 of [1]_."""

NORMAL_GRAVITY_EQUATOR = 9.7803253359
"""On the ellipsoid, m/s^2; table 3.4 of [1]_."""

SOMIGLIANA = 0.00193185265241
"""k of Somigliana's formula, b gamma_p / (a gamma_e) - 1; table 3.4 of [1]_."""

_GRAVITY_M = 0.00344978650684  # omega^2 a^2 b / GM, table 3.4 of [1]

GRAVITY_PER_HEIGHT = 2.0 / SEMI_MAJOR_AXIS * (1.0 + FLATTENING + _GRAVITY_M)
"""Relative decrease of normal gravity with height at the equator, 1/m; eq. 2.139 of [2]_."""

GRAVITY_PER_HEIGHT_SIN2 = 4.0 / SEMI_MAJOR_AXIS * FLATTENING
"""How much less it decreases, per sine squared of the latitude, 1/m; eq. 2.139 of [2]_."""

NORTH_GRAVITY_PER_HEIGHT = -8.08e-9
"""North component by height and sin(2 latitude), 1/s^2, as plumb lines curve; eq. 2.140 of [2]_."""


def earth_rate_n(latitude: ArrayLike) -> FloatArray:
    """Angular rate of the Earth in NED, ``omega_ie_n``.

    Parameters
    ----------
    latitude : array_like, shape (...)
        Geodetic latitude, rad.

    Returns
    -------
    ndarray, shape (..., 3)
        rad/s; eq. 2.123 of [2]_ of the module.
    """
    lat = np.asarray(latitude, dtype=np.float64)
    return EARTH_RATE * np.stack([np.cos(lat), np.zeros_like(lat), -np.sin(lat)], axis=-1)


def radii_of_curvature(latitude: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Radii of curvature of the ellipsoid.

    Parameters
    ----------
    latitude : array_like, shape (...)
        Geodetic latitude, rad.

    Returns
    -------
    meridian : ndarray, shape (...)
        Along the meridian (north-south), m; eq. 2.105 of [2]_ of the module.
    transverse : ndarray, shape (...)
        In the prime vertical (east-west), m; eq. 2.106.
    """
    sin_lat = np.sin(np.asarray(latitude, dtype=np.float64))
    square = 1.0 - ECCENTRICITY_SQUARED * sin_lat * sin_lat
    transverse = SEMI_MAJOR_AXIS / np.sqrt(square)
    meridian = transverse * (1.0 - ECCENTRICITY_SQUARED) / square
    return np.asarray(meridian), np.asarray(transverse)


def normal_gravity(latitude: ArrayLike, height: ArrayLike = 0.0) -> FloatArray:
    """Down component of gravity, centrifugal acceleration included.

    Parameters
    ----------
    latitude : array_like, shape (...)
        Geodetic latitude, rad.
    height : array_like, shape (...), optional
        Ellipsoidal height, m.

    Returns
    -------
    ndarray, shape (...)
        m/s^2, positive: Somigliana's closed form on the ellipsoid (eq. 4-1 of [1]_ of the
        module) and its second-order continuation upward (eq. 4-3).
    """
    lat = np.asarray(latitude, dtype=np.float64)
    h = np.asarray(height, dtype=np.float64)
    sin2 = np.sin(lat) ** 2
    on_ellipsoid = (
        NORMAL_GRAVITY_EQUATOR
        * (1.0 + SOMIGLIANA * sin2)
        / np.sqrt(1.0 - ECCENTRICITY_SQUARED * sin2)
    )
    per_height = GRAVITY_PER_HEIGHT - GRAVITY_PER_HEIGHT_SIN2 * sin2
    return np.asarray(on_ellipsoid * (1.0 - per_height * h + 3.0 * (h / SEMI_MAJOR_AXIS) ** 2))


def gravity_n(latitude: ArrayLike, height: ArrayLike = 0.0) -> FloatArray:
    """Gravity vector in NED, ``g_n``; at rest the specific force is its negative.

    Parameters
    ----------
    latitude : array_like, shape (...)
        Geodetic latitude, rad.
    height : array_like, shape (...), optional
        Ellipsoidal height, m.

    Returns
    -------
    ndarray, shape (..., 3)
        m/s^2. Down is :func:`normal_gravity`; north grows with height as the plumb line
        bends, eq. 2.140 of [2]_ of the module.
    """
    lat, h = np.broadcast_arrays(
        np.asarray(latitude, dtype=np.float64), np.asarray(height, dtype=np.float64)
    )
    north = NORTH_GRAVITY_PER_HEIGHT * h * np.sin(2.0 * lat)
    return np.stack([north, np.zeros_like(north), normal_gravity(lat, h)], axis=-1)


def transport_rate_n(latitude: ArrayLike, height: ArrayLike, velocity_n: ArrayLike) -> FloatArray:
    """Angular rate of NED against the Earth because the vehicle moves, ``omega_en_n``.

    Parameters
    ----------
    latitude : array_like, shape (...)
        Geodetic latitude, rad; NED has no transport rate at a pole.
    height : array_like, shape (...)
        Ellipsoidal height, m.
    velocity_n : array_like, shape (..., 3)
        Velocity against the Earth in NED, m/s.

    Returns
    -------
    ndarray, shape (..., 3)
        rad/s; eq. 5.44 of [2]_ of the module.

    Raises
    ------
    ValueError
        If the last axis of the velocity is not of length 3.
    """
    velocity = np.asarray(velocity_n, dtype=np.float64)
    if velocity.ndim == 0 or velocity.shape[-1] != 3:
        raise ValueError(f"Expected `velocity_n` to have shape (..., 3), got {velocity.shape}.")
    lat = np.asarray(latitude, dtype=np.float64)
    h = np.asarray(height, dtype=np.float64)
    meridian, transverse = radii_of_curvature(lat)
    about_down = -velocity[..., 1] * np.tan(lat) / (transverse + h)
    north, east, down = np.broadcast_arrays(
        velocity[..., 1] / (transverse + h), -velocity[..., 0] / (meridian + h), about_down
    )
    return np.stack([north, east, down], axis=-1)


def horizontal_metres(
    d_latitude: ArrayLike, d_longitude: ArrayLike, latitude: ArrayLike, height: ArrayLike = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Lengths to the north and to the east of small differences of position.

    Parameters
    ----------
    d_latitude, d_longitude : array_like, shape (...)
        rad.
    latitude, height : array_like, shape (...)
        Of the place, rad and m.

    Returns
    -------
    north, east : ndarray, shape (...)
        m; from eq. 2.111 of [2]_ of the module.
    """
    lat, h = np.asarray(latitude, dtype=np.float64), np.asarray(height, dtype=np.float64)
    meridian, transverse = radii_of_curvature(lat)
    north = np.asarray(d_latitude) * (meridian + h)
    return north, np.asarray(d_longitude) * (transverse + h) * np.cos(lat)


def displaced(
    latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike, north: ArrayLike, east: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Latitude and longitude near a place: the inverse of :func:`horizontal_metres`.

    Parameters
    ----------
    latitude, longitude, height : array_like, shape (...)
        Of the place, rad and m.
    north, east : array_like, shape (...)
        m.

    Returns
    -------
    latitude, longitude : ndarray, shape (...)
        rad; the longitude may be beyond the date line.
    """
    lat, h = np.asarray(latitude, dtype=np.float64), np.asarray(height, dtype=np.float64)
    meridian, transverse = radii_of_curvature(lat)
    return (
        np.asarray(lat + np.asarray(north) / (meridian + h)),
        np.asarray(np.asarray(longitude) + np.asarray(east) / ((transverse + h) * np.cos(lat))),
    )


def ecef(latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike) -> FloatArray:
    """Cartesian position in the Earth frame ``e``.

    Parameters
    ----------
    latitude, longitude, height : array_like, shape (...)
        rad and m.

    Returns
    -------
    ndarray, shape (..., 3)
        m; eq. 2.112 of [2]_ of the module.
    """
    lat, lon, h = np.broadcast_arrays(
        *(np.asarray(value, dtype=np.float64) for value in (latitude, longitude, height))
    )
    _, transverse = radii_of_curvature(lat)
    across = (transverse + h) * np.cos(lat)
    up = ((1.0 - ECCENTRICITY_SQUARED) * transverse + h) * np.sin(lat)
    return np.stack([across * np.cos(lon), across * np.sin(lon), up], axis=-1)


def dcm_ne(latitude: ArrayLike, longitude: ArrayLike) -> FloatArray:
    """Rotation from the Earth frame to NED, ``C_ne``.

    Parameters
    ----------
    latitude, longitude : array_like, shape (...)
        rad.

    Returns
    -------
    ndarray, shape (..., 3, 3)
        Eq. 2.150 of [2]_ of the module.
    """
    lat, lon = np.broadcast_arrays(
        np.asarray(latitude, dtype=np.float64), np.asarray(longitude, dtype=np.float64)
    )
    sl, cl, so, co = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    out = np.empty((*lat.shape, 3, 3))
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 2] = -sl * co, -sl * so, cl
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = -so, co, 0.0
    out[..., 2, 0], out[..., 2, 1], out[..., 2, 2] = -cl * co, -cl * so, -sl
    return out


def local_position_n(origin: ArrayLike, position: ArrayLike) -> FloatArray:
    """Position in the tangent plane of an origin: the straight line to it, along NED there.

    Parameters
    ----------
    origin : array_like, shape (3,)
        Latitude, longitude (rad) and ellipsoidal height (m).
    position : array_like, shape (..., 3)
        The same.

    Returns
    -------
    ndarray, shape (..., 3)
        North, east, down at the origin, m.
    """
    o, p = np.asarray(origin, dtype=np.float64), np.asarray(position, dtype=np.float64)
    away = ecef(p[..., 0], p[..., 1], p[..., 2]) - ecef(o[0], o[1], o[2])
    return np.asarray(away @ dcm_ne(o[0], o[1]).T)
