"""Where and how an INS/GNSS filter starts: attitude, position, velocity, and how well known.

Heading is what is hard. A sensor may be mounted anyhow, so that the course says nothing of it, and
gyros of a cheap one do not feel the Earth. What is left is the change of velocity: as soon as the
vehicle accelerates, `sinstool.methods.alignment.inflight` gives the attitude of that stretch, and
the gyros carry it back to the first fix, where the filter begins. Rest, where there is any, gives
the gyro bias first, without which that would not work over more than seconds.

References
----------
.. [1] P. D. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
   Systems", 2nd ed., 2013, sections 5.6 and 14.3.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sinstool.core import earth
from sinstool.core.earth import displaced
from sinstool.core.errors import AlignmentError
from sinstool.core.rotation import rotate, skew, wrapped
from sinstool.core.streams import GnssEpochs
from sinstool.methods.alignment.inflight import (
    AlignmentSettings,
    GnssFixes,
    ImuIncrements,
    InFlightAlignment,
    SensorGrade,
    align_in_flight,
)
from sinstool.methods.alignment.still import StillSpan, WindowStage, still_spans
from sinstool.methods.ins_gnss.settings import Settings, Start
from sinstool.methods.strapdown.attitude import AttitudePropagator
from sinstool.methods.strapdown.navigation import initial_state

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

TWICE_USED = 1.5
"""Factor on sigmas of an alignment in motion: its fixes are used again by the filter."""

# Bias of a cheap gyro that never rested, where that of its grade does not fit; what a bias known
# from rest moves until later; rad/s.
_UNKNOWN_BIAS = float(np.deg2rad(0.5))
_BIAS_MOVES = float(np.deg2rad(0.005))
# Fixes further from the start than this say nothing of it, s.
_NEAR_S = 2.0
# Stretches tried from the first motion on, s, and when one is good enough: heading, rad.
_STRETCHES_S = (15.0, 25.0, 40.0, 70.0, 120.0)
_GOOD = float(np.deg2rad(1.5))
_MOVING = 2.0  # m/s
_AT_REST = 1.0  # m/s: more is no rest
_BEFORE_MOTION_S = 5.0
_LATER_S = 60.0
_TRIES = 10
_ROAD_SCALE = 3e-3
_FIRST_NS = 300_000_000_000
# Not carried over gaps of so many intervals, nor further than gyros keep an attitude to this, rad.
_GAP = 5.0
_POOR = 3.0  # chi2 of an alignment
_FAR = float(np.deg2rad(10.0))


@dataclass(frozen=True)
class Beginning:
    """A filter's start, and where it comes from.

    Attributes
    ----------
    time_ns : int
        An IMU sample's: the first update of the filter begins there.
    how : str
        In words.
    """

    start: Start
    time_ns: int
    how: str
    warnings: tuple[str, ...] = ()


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
) -> Start:
    """Start from a known attitude and what GNSS says around it.

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
        Known already, rad/s.
    gyro_bias_sigma : float, optional
        How well.

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
    velocity, p_velocity = _velocity(time_ns, when, gnss, settings)
    position, p_position = _position(time_ns, when, gnss, settings, velocity, p_velocity)
    arm = rotate(attitude, lever)
    swing = rotate(attitude, np.cross(np.asarray(omega_eb_b, dtype=np.float64), lever))
    velocity = velocity - swing
    lat, lon, height = position
    lat, lon = displaced(lat, lon, height, -arm[0], -arm[1])
    turn_arm, turn_swing = skew(arm), skew(swing)
    return Start(
        initial_state(float(lat), float(lon), float(height + arm[2]), velocity, attitude),
        p_position + turn_arm @ psi @ turn_arm.T,
        p_velocity + turn_swing @ psi @ turn_swing.T,
        psi,
        np.asarray(gyro_bias, dtype=np.float64),
        np.zeros(3),
        gyro_bias_sigma,
    )


def find_start(imu: ImuIncrements, gnss: GnssEpochs, settings: Settings) -> Beginning:
    """Start of a log of which nothing but the data is known.

    Parameters
    ----------
    imu : ImuIncrements
        Body axes. It may be mounted anyhow in the vehicle.
    gnss : GnssEpochs
        Position and velocity, as stamped.
    settings : Settings
        Latency, lever arm and noises.

    Returns
    -------
    Beginning
        At the first IMU sample that has fixes around it.

    Raises
    ------
    AlignmentError
        If there is no GNSS velocity, or the vehicle never accelerates enough for heading.
    """
    latency = round(settings.gnss_latency * 1e9)
    usable = _joined(gnss)
    if not len(usable):
        raise AlignmentError(
            "no GNSS epoch has position and velocity", "give an initial attitude, or use a position"
        )
    begin = max(int(imu.time_ns[0]), int(usable.time_ns[0]) - latency)
    row = int(np.searchsorted(imu.time_ns, begin))
    if row >= len(imu) - 1:
        raise AlignmentError("GNSS begins after the last IMU sample", "check the clocks")
    interval = np.diff(imu.time_ns, prepend=imu.time_ns[0]) * 1e-9
    interval[0] = interval[1] if len(imu) > 1 else 0.0
    rest, scatter = _first_rest(imu, interval, usable, latency)
    bias, sigma, words = _bias(rest, scatter, settings)
    freed = ImuIncrements(
        imu.time_ns, imu.delta_theta - bias * interval[:, None], imu.delta_velocity
    )
    answer = _first_alignment(freed, usable, settings, sigma)
    if rest is None and settings.grade == "mems" and (answer is None or answer.chi2 > _POOR):
        sigma, words = _UNKNOWN_BIAS, "gyro bias not known"
        answer = _first_alignment(freed, usable, settings, sigma) or answer
    if answer is None:
        raise AlignmentError(
            "no stretch of the log gives a heading: the velocity changes too little, or the clocks"
            " of IMU and GNSS differ",
            "give an initial attitude",
        )
    if answer.errors is not None and np.max(answer.errors.sigma["gyro_bias"]) < sigma:
        bias = bias + answer.errors.gyro_bias
        sigma = float(np.max(answer.errors.sigma["gyro_bias"]))
    solved = int(np.searchsorted(imu.time_ns, answer.t_ns))
    usual = float(np.median(interval))
    away = abs(float(imu.time_ns[solved] - imu.time_ns[row])) * 1e-9
    far = np.any(interval[row + 1 : solved + 1] > _GAP * usual) or sigma * away > _FAR
    if far and solved > row:
        row, away = solved, 0.0
    time_ns = int(imu.time_ns[row])
    part = slice(min(row, solved) + 1, max(row, solved) + 1)
    theta = imu.delta_theta[part] - bias * interval[part, None]
    latitude = float(usable.latitude[0])
    if solved >= row:
        q_nb = carried_back(answer.q_nb, theta, interval[part], latitude)
    else:  # the stretch began before the first fix
        carrier = AttitudePropagator(answer.q_nb, earth.earth_rate_n(latitude))
        q_nb = np.asarray(carrier.push(theta, interval[part])[-1])
    covariance = TWICE_USED**2 * answer.cov + (sigma * away) ** 2 * np.eye(3)
    covariance += (settings.imu.angle_random_walk**2 * away) * np.eye(3)
    rate = imu.delta_theta[row + 1] / interval[row + 1] - bias
    start = start_at(
        time_ns,
        q_nb,
        covariance,
        usable,
        settings,
        omega_eb_b=rate,
        gyro_bias=bias,
        gyro_bias_sigma=sigma,
    )
    span = (answer.t_stop_ns - answer.t_q_ns) * 1e-9
    how = (
        f"attitude from {span:.0f} s of velocity changes, carried over {away:.0f} s by the gyros;"
        f" {words}; heading known to {np.rad2deg(np.sqrt(covariance[2, 2])):.1f} deg"
    )
    return Beginning(start, time_ns, how, answer.warnings)


def carried_back(
    q_nb: ArrayLike, delta_theta: FloatArray, interval: FloatArray, latitude: float
) -> FloatArray:
    """Attitude at the start of some increments from that at their end.

    Parameters
    ----------
    q_nb : array_like, shape (4,)
        At the end.
    delta_theta : ndarray, shape (n, 3)
        Without bias, rad.
    interval : ndarray, shape (n,)
        s.
    latitude : float
        rad; the vehicle stays near it.

    Returns
    -------
    ndarray, shape (4,)
    """
    end = np.asarray(q_nb, dtype=np.float64)
    if not len(interval):
        return end
    carrier = AttitudePropagator(end, -earth.earth_rate_n(latitude))
    return np.asarray(carrier.push(-delta_theta[::-1], interval[::-1])[-1])


def _joined(gnss: GnssEpochs) -> GnssEpochs:
    """Epochs with a velocity, and a position: their own, or one between those around them."""
    rows = gnss.rows(gnss.has_velocity)
    placed = gnss.rows(gnss.has_position & np.isfinite(gnss.height))
    alone = ~(rows.has_position & np.isfinite(rows.height))
    if not len(placed) or not alone.any():
        return rows.rows(~alone)
    t = (rows.time_ns - placed.time_ns[0]) * 1e-9
    placed_s = (placed.time_ns - placed.time_ns[0]) * 1e-9
    near = np.clip(np.searchsorted(placed_s, t), 0, len(placed_s) - 1)
    away = np.minimum(np.abs(placed_s[near] - t), np.abs(placed_s[np.maximum(near - 1, 0)] - t))
    longitude = np.interp(t, placed_s, np.unwrap(placed.longitude))
    longitude = wrapped(longitude)
    joined = replace(
        rows,
        latitude=np.where(alone, np.interp(t, placed_s, placed.latitude), rows.latitude),
        longitude=np.where(alone, longitude, rows.longitude),
        height=np.where(alone, np.interp(t, placed_s, placed.height), rows.height),
        sigma_position_n=np.where(
            alone[:, None], placed.sigma_position_n[near], rows.sigma_position_n
        ),
    )
    return joined.rows(~alone | (away < _NEAR_S))


def _first_rest(
    imu: ImuIncrements, interval: FloatArray, gnss: GnssEpochs, latency: int
) -> tuple[StillSpan | None, float]:
    """The first rest of 3 s, or else the longest of the first minutes; sigma of its mean rate.

    A steady turn is as still for the IMU, but not for GNSS.

    Half-second means say how well the mean is known: an engine that idles shakes the samples far
    more than their means.
    """
    stage = WindowStage()
    good = interval > 0.0
    seconds = interval[good, None]
    theta, velocity = imu.delta_theta[good], imu.delta_velocity[good]
    stage.push(imu.time_ns[good], theta / seconds, velocity / seconds)
    windows = stage.finish()
    limit = imu.time_ns[0] + _FIRST_NS
    spans = [s for s in still_spans(windows) if s.duration_s >= 1.5 and s.start_ns < limit]
    valid = gnss.time_ns - latency
    fast = valid[np.linalg.norm(gnss.velocity_n[:, :2], axis=1) > _AT_REST]
    spans = [s for s in spans if not np.any((fast >= s.start_ns) & (fast <= s.end_ns))]
    if not spans:
        return None, 0.0
    long = [s for s in spans if s.duration_s >= 3.0]
    rest = long[0] if long else max(spans, key=lambda s: s.duration_s)
    inside = (windows.start_ns >= rest.start_ns) & (windows.start_ns < rest.end_ns)
    means = windows.gyro[inside]
    return rest, float(means.std(axis=0, ddof=1).max() / np.sqrt(len(means)))


def _bias(
    rest: StillSpan | None, scatter: float, settings: Settings
) -> tuple[FloatArray, float, str]:
    """Gyro bias, how well it is known, and words.

    The rate of the Earth is in the mean of a rest. Gyros good enough to feel it are better
    than that: their bias is left to alignment and filter.
    """
    grade = settings.imu.gyro_bias
    if rest is None:
        return np.zeros(3), grade, "gyro bias as its grade"
    if grade < 2.0 * earth.EARTH_RATE:
        return np.zeros(3), grade, "gyro bias as its grade"
    sigma = float(np.sqrt(scatter**2 + earth.EARTH_RATE**2 + _BIAS_MOVES**2))
    return rest.gyro.copy(), sigma, f"gyro bias from {rest.duration_s:.0f} s of rest"


def _first_alignment(
    imu: ImuIncrements, gnss: GnssEpochs, settings: Settings, bias_sigma: float
) -> InFlightAlignment | None:
    """The first stretch with motion that gives a heading."""
    noise = settings.imu
    grade = SensorGrade(
        bias_sigma,
        noise.accel_bias,
        max(noise.accel_scale, _ROAD_SCALE if settings.grade == "mems" else 0.0),
        max(noise.accel_scale, _ROAD_SCALE if settings.grade == "mems" else 0.0),
        noise.angle_random_walk,
        noise.velocity_random_walk,
    )
    sigma_v = np.where(np.isfinite(gnss.sigma_velocity_n), gnss.sigma_velocity_n, 0.0).max(axis=1)
    white = float(np.hypot(max(settings.gnss.velocity_white), max(settings.gnss.velocity_markov)))
    fixes = GnssFixes(
        gnss.time_ns,
        gnss.latitude,
        gnss.longitude,
        gnss.height,
        np.where(np.isfinite(gnss.velocity_n), gnss.velocity_n, 0.0),
        np.where(sigma_v > 0.0, sigma_v, white),
    )
    base = AlignmentSettings(
        gate="off",
        at="start",
        refine=True,
        refine_latency_sigma=0.05,
        grade=grade,
        gnss_sigma_v=white,
        gnss_latency_s=settings.gnss_latency,
        lever_arm_b=settings.lever_arm_b,
        series=False,
    )
    best: InFlightAlignment | None = None
    for begin, end in _stretches(imu, gnss):
        try:
            answer = align_in_flight(imu, fixes, replace(base, start_ns=begin, end_ns=end))
        except AlignmentError:
            continue
        if answer.status not in ("ok", "degraded"):
            continue
        if best is None or answer.sigma_worst < best.sigma_worst:
            best = answer
        if np.sqrt(answer.cov[2, 2]) < _GOOD:
            return answer
    return best


def _stretches(imu: ImuIncrements, gnss: GnssEpochs) -> Iterator[tuple[int, int]]:
    """From the first motion on, longer and longer; then from a minute later."""
    speed = np.linalg.norm(gnss.velocity_n[:, :2], axis=1)
    moving = np.flatnonzero(speed > _MOVING)
    first = int(gnss.time_ns[moving[0]]) if len(moving) else int(gnss.time_ns[0])
    last = int(imu.time_ns[-1])
    for k in range(_TRIES):
        begin = first + round((k * _LATER_S - _BEFORE_MOTION_S) * 1e9)
        for span in _STRETCHES_S:
            end = begin + round((_BEFORE_MOTION_S + span) * 1e9)
            yield max(begin, int(imu.time_ns[0])), min(end, last)
            if end >= last:
                break
        if begin + round(_LATER_S * 1e9) >= last:
            return


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
    good = gnss.has_position & np.isfinite(gnss.height)
    left, _, _, _ = _around(time_ns, when, good, "position")
    away = float(time_ns - when[left]) * 1e-9
    sigma = _sigma(
        gnss.sigma_position_n[left], settings.gnss.position_white, settings.gnss.position_markov
    )
    lat, lon, height = gnss.latitude[left], gnss.longitude[left], gnss.height[left]
    north, east, down = velocity * away
    place = np.array([*displaced(lat, lon, height, north, east), height - down])
    return place, np.diag(sigma**2) + away**2 * p_velocity


def _around(
    time_ns: int, when: IntArray, good: NDArray[np.bool_], what: str
) -> tuple[int, int, float, float]:
    """Rows before and after, the share of the latter, and the time to the nearest, s."""
    rows = np.flatnonzero(good)
    times = when[rows]
    k = int(np.searchsorted(times, time_ns, side="right"))
    left, right = max(k - 1, 0), min(k, len(rows) - 1)
    if len(rows) == 0 or min(abs(int(times[left]) - time_ns), abs(int(times[right]) - time_ns)) > (
        _NEAR_S * 1e9
    ):
        raise AlignmentError(f"no GNSS {what} within {_NEAR_S:g} s of the start", "start elsewhere")
    span = int(times[right] - times[left])
    share = float(np.clip((time_ns - int(times[left])) / span, 0.0, 1.0)) if span else 0.0
    inside = int(times[left]) <= time_ns <= int(times[right])
    if inside and span < 2.0 * _NEAR_S * 1e9:
        # between two fixes the velocity is off by the bend alone
        apart = 0.1 * share * (1.0 - share) * span * 1e-9
    else:
        apart = abs(time_ns - int(times[left])) * 1e-9
    return int(rows[left]), int(rows[right]), share, apart


def _sigma(own: FloatArray, white: ArrayLike, markov: ArrayLike) -> FloatArray:
    """Noise of a fix: its own where it gives one, else that of the model."""
    model = np.hypot(np.asarray(white, dtype=np.float64), np.asarray(markov, dtype=np.float64))
    return np.where(np.isfinite(own) & (own > 0.0), np.maximum(own, white), model)
