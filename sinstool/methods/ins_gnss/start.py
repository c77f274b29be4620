"""Start of an INS/GNSS filter with a known attitude: position and velocity from GNSS.

References
----------
.. [1] P. D. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
   Systems", 2nd ed., 2013, sections 5.6 and 14.3.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import ArrayLike, BoolArray, FloatArray, IntArray
from sinstool.core.earth import displaced
from sinstool.core.errors import AlignmentError
from sinstool.core.rotation import rotate, skew
from sinstool.core.streams import GnssEpochs
from sinstool.methods.ins_gnss.settings import Settings, Start
from sinstool.methods.strapdown.navigation import initial_state

TWICE_USED = 1.5
"""On the sigmas of an alignment in motion: it uses fixes that the filter is going to use again."""

# Fixes further from the start than this say nothing of it, s.
NEAR_S = 2.0
# Sigma of a height that no fix shows, m, and of its change beyond the nearest one that does, m/s.
UNKNOWN_HEIGHT, CLIMB = 1000.0, 5.0


def start_at(
    time_ns: int,
    q_nb: ArrayLike,
    covariance_attitude_n: ArrayLike,
    gnss: GnssEpochs,
    settings: Settings,
    *,
    omega_eb_b: ArrayLike = (0.0, 0.0, 0.0),
    gyro_bias: ArrayLike = (0.0, 0.0, 0.0),
    gyro_bias_sigma: float | None = None,
    of_imu: tuple[FloatArray, FloatArray] | None = None,
) -> Start:
    """Start from an attitude and the fixes around its time.

    Parameters
    ----------
    time_ns : int
        When the attitude holds.
    q_nb : array_like, shape (4,)
        Of an alignment.
    covariance_attitude_n : array_like, shape (3, 3)
        Of the small rotation in NED between it and the truth, rad^2.
    gnss : GnssEpochs
        As stamped; latency, lever arm and noise where the fixes give none are those of
        `settings`.
    omega_eb_b : array_like, shape (3,), optional
        Angular rate then, for the velocity of the antenna against the IMU, rad/s.
    gyro_bias : array_like, shape (3,), optional
        rad/s.
    gyro_bias_sigma : float, optional
        How well.
    of_imu : (ndarray, shape (3,), ndarray, shape (3, 3)), optional
        Velocity of the IMU then, m/s, and its covariance, in place of those of the fixes.

    Returns
    -------
    Start
        Position and velocity are those of GNSS between the two fixes around the start, or of
        the nearest one carried on; their covariances hold the fix's noise, white and slow, what
        the vehicle may have done meanwhile, and the lever arm's turn by the attitude error.

    Raises
    ------
    AlignmentError
        If no position or no velocity lies within 2 s.
    """
    attitude = np.asarray(q_nb, dtype=np.float64)
    psi = np.asarray(covariance_attitude_n, dtype=np.float64)
    lever = np.asarray(settings.lever_arm_b, dtype=np.float64)
    when = gnss.time_ns - round(settings.gnss_latency * 1e9)
    swing = rotate(attitude, np.cross(np.asarray(omega_eb_b, dtype=np.float64), lever))
    turned = skew(swing) @ psi @ skew(swing).T
    if of_imu is None:
        of_antenna, p_antenna = _velocity(time_ns, when, gnss, settings)
        velocity, p_velocity = of_antenna - swing, p_antenna + turned
    else:
        velocity, p_velocity = of_imu
        of_antenna, p_antenna = velocity + swing, p_velocity + turned
    position, p_position = _position(time_ns, when, gnss, settings, of_antenna, p_antenna)
    arm = rotate(attitude, lever)
    lat, lon, height = position
    lat, lon = displaced(lat, lon, height, -arm[0], -arm[1])
    turn_arm = skew(arm)
    return Start(
        initial_state(float(lat), float(lon), float(height + arm[2]), velocity, attitude),
        p_position + turn_arm @ psi @ turn_arm.T,
        p_velocity,
        psi,
        np.asarray(gyro_bias, dtype=np.float64),
        np.zeros(3),
        gyro_bias_sigma,
        by_fixes=True,
    )


def _velocity(
    time_ns: int, when: IntArray, gnss: GnssEpochs, settings: Settings
) -> tuple[FloatArray, FloatArray]:
    good = gnss.has_velocity
    left, right, share, apart = _around(time_ns, when, good, "velocity")
    values = np.where(np.isfinite(gnss.velocity_n), gnss.velocity_n, 0.0)
    z = (1.0 - share) * values[left] + share * values[right]
    sigma = _sigma(
        gnss.sigma_velocity_n[left], settings.gnss.velocity_white, settings.gnss.velocity_markov
    )
    down = np.isfinite(gnss.velocity_n[left, 2])
    sigma[2] = sigma[2] if down else max(sigma[2], 1.0)
    # A car or aircraft does not accelerate by more than 3 m/s^2 without showing it in both fixes
    sigma = np.hypot(sigma, 3.0 * apart)
    return z, np.diag(sigma**2)


def _position(
    time_ns: int,
    when: IntArray,
    gnss: GnssEpochs,
    settings: Settings,
    velocity: FloatArray,
    p_velocity: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    whole = gnss.has_position & np.isfinite(gnss.height)
    near = np.abs(when - time_ns) <= NEAR_S * 1e9
    left, _, _, _ = _around(
        time_ns, when, whole if (whole & near).any() else gnss.has_position, "position"
    )
    away = float(time_ns - when[left]) * 1e-9
    sigma = _sigma(
        gnss.sigma_position_n[left], settings.gnss.position_white, settings.gnss.position_markov
    )
    lat, lon, height = gnss.latitude[left], gnss.longitude[left], gnss.height[left]
    if not np.isfinite(height):
        height, sigma[2] = _height(time_ns, when, gnss, whole)
    north, east, down = velocity * away
    place = np.array([*displaced(lat, lon, height, north, east), height - down])
    return place, np.diag(sigma**2) + away**2 * p_velocity


def _height(
    time_ns: int, when: IntArray, gnss: GnssEpochs, whole: BoolArray
) -> tuple[float, float]:
    """Height and its sigma, m, where fixes have none: that of the nearest one that has."""
    rows = np.flatnonzero(whole)
    if not len(rows):
        return 0.0, UNKNOWN_HEIGHT
    apart = np.abs(when[rows] - time_ns)
    nearest = int(np.argmin(apart))
    own = float(np.nan_to_num(gnss.sigma_position_n[rows[nearest], 2]))
    climbed = CLIMB * float(apart[nearest]) * 1e-9
    return float(gnss.height[rows[nearest]]), min(float(np.hypot(own, climbed)), UNKNOWN_HEIGHT)


def _around(
    time_ns: int, when: IntArray, good: BoolArray, what: str
) -> tuple[int, int, float, float]:
    """Rows before and after, the share of the latter, and the time from them, s.

    Both are the nearest row where the time does not lie between two that are near each other.
    """
    rows = np.flatnonzero(good)
    times = when[rows]
    k = int(np.searchsorted(times, time_ns, side="right"))
    left, right = max(k - 1, 0), min(k, len(rows) - 1)
    near = min((left, right), key=lambda row: abs(int(times[row]) - time_ns)) if len(rows) else 0
    if len(rows) == 0 or abs(int(times[near]) - time_ns) > NEAR_S * 1e9:
        raise AlignmentError(
            f"no GNSS {what} within {NEAR_S:g} s of the start",
            "use --start to begin where there are fixes, or leave --align out",
        )
    span = int(times[right]) - int(times[left])
    if not (int(times[left]) <= time_ns <= int(times[right]) and 0 < span < 2.0 * NEAR_S * 1e9):
        return int(rows[near]), int(rows[near]), 0.0, abs(time_ns - int(times[near])) * 1e-9
    share = (time_ns - int(times[left])) / span
    # between two fixes the velocity is off by the bend alone
    return int(rows[left]), int(rows[right]), share, 0.1 * share * (1.0 - share) * span * 1e-9


def _sigma(own: FloatArray, white: ArrayLike, markov: ArrayLike) -> FloatArray:
    """Noise of a fix: its own where it gives one, else that of the model."""
    model = np.hypot(np.asarray(white, dtype=np.float64), np.asarray(markov, dtype=np.float64))
    return np.where(np.isfinite(own) & (own > 0.0), np.maximum(own, white), model)
