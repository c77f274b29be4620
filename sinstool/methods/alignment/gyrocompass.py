"""Gyrocompassing: heading and tilt at rest, from the Earth's rotation and gravity.

The record is cut into stretches without motion and half-second windows of motion (knocks, a
rocking base). In the first kind the body keeps its attitude against the Earth, so the mean
angular rate is the Earth's rate, the mean specific force the reaction to gravity. In the second
the gyros carry the attitude on, and gravity, seen through the attitude that the gyros keep in
inertial space, turns with the Earth: that alone shows heading [1]_ [2]_. Both are measurements of
one linear filter over attitude and sensor biases. Its covariance holds what limits every
gyrocompass: the bias of the gyro that points east.

References
----------
.. [1] Y. Qin, G. Yan, D. Gu, J. Zheng, "A clever way of SINS coarse alignment despite rocking
   ship", J. Northwestern Polytechnical University 23(5), 2005.
.. [2] P. M. G. Silson, "Coarse alignment of a ship's strapdown inertial attitude reference
   system using velocity loci", IEEE Trans. Instrumentation and Measurement 60(6), 2011.
.. [3] P. D. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
   Systems", 2nd ed., 2013, section 5.6.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sinstool.core import earth, rotation
from sinstool.core.chi_square import upper_point
from sinstool.core.errors import AlignmentError
from sinstool.core.rotation import skew
from sinstool.methods.alignment.gyrocompass_stretches import Record, Stretch, cut
from sinstool.methods.alignment.inflight_types import (
    OK_SIGMA,
    REFUSE_SIGMA,
    TACTICAL,
    UNIFORM_SIGMA,
    FloatArray,
    ImuIncrements,
    Status,
)
from sinstool.methods.alignment.initial import level
from sinstool.methods.alignment.wahba import solve_svd
from sinstool.methods.sensor_errors import SensorGrade

# Where gravity's direction changes by more than this from window to window the vehicle drives.
_MAX_SHAKE = 0.5  # m/s^2
# Of the Earth's rate is horizontal less than this part: a word about the pole.
_NEAR_POLE = 0.15
_LEAST_S = 5.0
_ROUNDS = 5
# Squared innovations that consistent errors exceed once in so many records.
_DOUBT = 1e-4
# Of so many records of a grade, one shows biases that seem larger. Axes that lose less of a bias's
# variance than this share of what others lose do not show it.
_UNUSUAL, _SEEN = 1e-3, 0.1
_SETTLED = float(np.deg2rad(0.02))
_TILT, _HEADING = 1.0, 3.0  # prior of the attitude about the first guess, rad


@dataclass(frozen=True)
class Gyrocompass:
    """The answer, at the last sample used.

    Attributes
    ----------
    status : {'ok', 'degraded', 'level-only', 'unobservable'}
        ``ok`` up to 1 deg about the worst axis, ``degraded`` up to 5 deg, ``level-only`` where
        heading is worse than that: the attitude then has heading 0, which says nothing.
    t_ns, t_start_ns : int
        When the attitude holds; where the record used begins.
    q_nb : ndarray, shape (4,)
        With ``w >= 0``; NaN where the status is ``unobservable``.
    cov : ndarray, shape (3, 3)
        Of psi in NED, rad^2: the attitude found is ``(I + [psi x]) C_nb``.
    sigma_rad : ndarray, shape (3,)
        About north, east, down.
    sigma_heading : float
        As predicted, before a bad heading is declared unknown, rad.
    gyro_bias, accel_bias : ndarray, shape (3,)
        What the sensors have too much, as far as it shows, rad/s and m/s^2.
    gyro_bias_sigma, accel_bias_sigma : ndarray, shape (3,)
    angle_random_walk, velocity_random_walk : float
        White noise as measured, rad/sqrt(s) and (m/s)/sqrt(s).
    still_s : float
        Time at rest.
    chi2 : float
        Squared innovations by their prediction; about 1.
    """

    status: Status
    t_ns: int
    t_start_ns: int
    q_nb: FloatArray
    cov: FloatArray
    sigma_rad: FloatArray
    sigma_heading: float
    gyro_bias: FloatArray
    accel_bias: FloatArray
    gyro_bias_sigma: FloatArray
    accel_bias_sigma: FloatArray
    angle_random_walk: float
    velocity_random_walk: float
    still_s: float
    chi2: float
    warnings: tuple[str, ...]


def gyrocompass(
    imu: ImuIncrements, latitude: float, height: float = 0.0, grade: SensorGrade = TACTICAL
) -> Gyrocompass:
    """Attitude of a vehicle that stays where it is.

    Biases of which the Earth's rate shows more than the grade allows are taken to be as large about
    all axes: that of the gyro that points east, which turns heading, shows nowhere.

    Parameters
    ----------
    imu : ImuIncrements
        A record at one place. Knocks and rocking are allowed, driving is not.
    latitude : float
        Geodetic, rad.
    height : float, optional
        Ellipsoidal, m.
    grade : SensorGrade, optional
        Biases and scale of the sensors. White noise is measured; only where there is no rest
        long enough, that of the gyros is at least the grade's.

    Raises
    ------
    AlignmentError
        If the record is too short.
    """
    record = cut(imu)
    if record.duration_s < _LEAST_S:
        raise AlignmentError(
            f"gyrocompassing needs {_LEAST_S:g} s of data without a gap, and there are"
            f" {record.duration_s:.1f} s",
            "stand still for a minute or more",
        )
    where = _Place(earth.earth_rate_n(latitude), earth.gravity_n(latitude, height))
    still_s = sum(s.duration for s in record.stretches if s.still)
    drives = still_s < 0.5 * record.duration_s and record.shake > _MAX_SHAKE
    walk = record.angle_random_walk
    if not record.walk_at_rest:
        walk = max(walk, grade.angle_random_walk)
    q_start = _first_guess(record.stretches, where)
    q_start, run = _settled(record.stretches, q_start, where, grade, walk)
    bias = _bias_shown(run, grade)
    if bias > grade.gyro_bias and not drives:
        size = 3600.0 / np.deg2rad(1.0)
        text = (
            f"the mean rate at rest is not the Earth's: it shows gyro biases of {size * bias:.2g}"
            f" deg/h, where {size * grade.gyro_bias:.2g} are expected; the uncertainty of heading"
            " is enlarged to match. Check the grade, the latitude and whether the vehicle stood"
            " still"
        )
        record = replace(record, warnings=(*record.warnings, text))
        grade = replace(grade, gyro_bias=bias)
        _, run = _settled(record.stretches, q_start, where, grade, walk)
    return _answer(record, run, latitude, grade, drives)


@dataclass(frozen=True)
class _Place:
    omega_n: FloatArray
    g_n: FloatArray


@dataclass(frozen=True)
class _Run:
    """End of a pass: reference attitude, errors [psi, gyro bias, accel bias], covariance."""

    q_nb: FloatArray
    x: FloatArray
    p: FloatArray
    chi2: float
    freedom: int
    attitude_map: FloatArray
    bias_map: FloatArray


def _settled(
    stretches: list[Stretch],
    q_start: FloatArray,
    where: _Place,
    grade: SensorGrade,
    random_walk: float,
) -> tuple[FloatArray, _Run]:
    """The filter about its own estimate of the attitude at the start, and that attitude."""
    for _ in range(_ROUNDS):
        run = _filter(stretches, q_start, where, grade, random_walk)
        at_start = np.linalg.solve(run.attitude_map, run.x[:3] - run.bias_map @ run.x[3:6])
        # Linear in the error of the reference: once more about the estimate, while that moves.
        if np.linalg.norm(at_start) < _SETTLED:
            break
        q_start = rotation.normalise(rotation.multiply(rotation.exp(-at_start), q_start))
    return q_start, run


def _bias_shown(run: _Run, grade: SensorGrade) -> float:
    """Likeliest size of the gyros' biases, rad/s, if it is clearly more than the grade's.

    Along axes that the record shows, what the prior variance s^2 has lost, s^4 / (s^2 + r), tells
    the noise r with which it shows a bias, and the estimate x the bias with noise,
    x (s^2 + r) / s^2.
    """
    prior = grade.gyro_bias**2
    lost, axes = np.linalg.eigh(prior * np.eye(3) - run.p[3:6, 3:6])
    seen = lost > _SEEN * lost[-1]
    if not prior * lost[-1] > 0.0:
        return grade.gyro_bias
    x, lost = (run.x[3:6] @ axes)[seen], lost[seen]
    if np.sum(x**2 / lost) <= upper_point(len(x), _UNUSUAL):
        return grade.gyro_bias
    square = np.mean((x * prior / lost) ** 2 - (prior**2 / lost - prior))
    return float(np.sqrt(max(square, prior)))


def _first_guess(stretches: list[Stretch], where: _Place) -> FloatArray:
    """Attitude at the start.

    From the longest stretch without motion: down from gravity, north from the horizontal part of
    the Earth's rate, Groves eqs (5.100), (5.101), (5.105) of [3]_. Without one: the rotation
    between the loci of gravity in the axes that the gyros keep and in those of the Earth at the
    start, by least squares (Wahba's problem).
    """
    still = [s for s in stretches if s.still]
    before = _attitudes_by_gyros(stretches)
    if still:
        best = max(still, key=lambda s: s.duration)
        flat = level(best.force)
        rate = rotation.rotate(flat, best.rate)
        heading = np.arctan2(-rate[1], rate[0])
        q_nb = rotation.multiply(rotation.exp([0.0, 0.0, heading]), flat)
        index = next(k for k, s in enumerate(stretches) if s is best)
        turned = rotation.exp(where.omega_n * sum(s.duration for s in stretches[:index]))
        back = rotation.conjugate(before[index])
        return rotation.normalise(rotation.multiply(turned, rotation.multiply(q_nb, back)))
    ends = np.cumsum([s.duration for s in stretches])
    middle = ends - 0.5 * np.array([s.duration for s in stretches])
    seen = rotation.rotate(np.array(before), np.array([s.force for s in stretches]))
    expected = rotation.rotate(rotation.exp(middle[:, None] * where.omega_n), -where.g_n)
    weight = np.array([1.0 / s.force_variance for s in stretches])
    return rotation.from_dcm(solve_svd((weight[:, None] * expected).T @ seen))


def _attitudes_by_gyros(stretches: list[Stretch]) -> list[FloatArray]:
    """Attitude of the body at the start of each stretch in its axes at the start of the first.

    Against inertial space in motion; through rest it is what the gyros measured there.
    """
    q = np.array([1.0, 0.0, 0.0, 0.0])
    parts = []
    for s in stretches:
        parts.append(q)
        turn = rotation.exp(s.rate * s.duration) if s.still else s.turn
        q = rotation.normalise(rotation.multiply(q, turn))
    return parts


def _filter(
    stretches: list[Stretch],
    q_start: FloatArray,
    where: _Place,
    grade: SensorGrade,
    random_walk: float,
) -> _Run:
    """Run the linear filter about the attitude that the gyros give from ``q_start``.

    Errors are psi (reference is ``(I + [psi x]) C_nb``) and the biases. Measured in NED are
    ``C f + g = [g x] psi + C b_a`` and, at rest,
    ``C omega - omega_ie = -[omega_ie x] psi + C b_g``; in motion
    ``d psi/dt = -omega_ie x psi + C b_g``, the equations of section 14.2 of [3]_ with the
    position known.
    """
    force = np.mean([s.force for s in stretches], axis=0)
    # A scale error of the accelerometers is one more bias, as what they feel stays the same.
    bias_variance = np.concatenate(
        [
            (_TILT**2, _TILT**2, _HEADING**2),
            np.full(3, grade.gyro_bias**2),
            grade.accel_bias**2 + (grade.accel_scale * force) ** 2,
        ]
    )
    p = np.diag(bias_variance)
    x = np.zeros(9)
    q = q_start
    skew_g, skew_omega = skew(where.g_n), skew(where.omega_n)
    attitude_map, bias_map = np.eye(3), np.zeros((3, 3))
    squares, count = 0.0, -3
    for s in stretches:
        c = rotation.to_dcm(q)
        h = np.zeros((6 if s.still else 3, 9))
        h[:3, :3], h[:3, 6:] = skew_g, c
        z = np.empty(len(h))
        half = np.zeros(3) if s.still else -0.5 * s.duration * where.omega_n
        z[:3] = rotation.rotate(rotation.exp(half), c @ s.force) + where.g_n
        r = np.full(len(h), s.force_variance)
        if s.still:
            h[3:, :3], h[3:, 3:6] = -skew_omega, c
            z[3:] = c @ s.rate - where.omega_n
            r[3:] = random_walk**2 / s.duration
        else:
            phi = np.eye(3) - skew_omega * s.duration
            step = 0.5 * (c + rotation.to_dcm(rotation.multiply(q, s.turn))) * s.duration
            move = np.eye(9)
            move[:3, :3], move[:3, 3:6] = phi, step
            x, p = move @ x, move @ p @ move.T
            p[:3, :3] += random_walk**2 * s.duration * np.eye(3)
            attitude_map, bias_map = phi @ attitude_map, phi @ bias_map + step
        innovation = z - h @ x
        variance = h @ p @ h.T + np.diag(r)
        gain = np.linalg.solve(variance, h @ p).T
        squares += float(innovation @ np.linalg.solve(variance, innovation))
        count += len(h)
        x = x + gain @ innovation
        left = np.eye(9) - gain @ h
        p = left @ p @ left.T + (gain * r) @ gain.T
        x[3:] *= np.exp(-s.duration / grade.bias_time_s)
        decay = np.exp(-s.duration / grade.bias_time_s * np.repeat([0.0, 1.0], [3, 6]))
        p = decay[:, None] * p * decay + np.diag((1.0 - decay**2) * bias_variance)
        if not s.still:
            q = rotation.multiply(rotation.exp(-where.omega_n * s.duration), q)
            q = rotation.normalise(rotation.multiply(q, s.turn))
    return _Run(q, x, p, squares / max(count, 1), max(count, 1), attitude_map, bias_map)


def _answer(
    record: Record, run: _Run, latitude: float, grade: SensorGrade, drives: bool
) -> Gyrocompass:
    """The result of the last pass, with its status."""
    warnings = list(record.warnings)
    still_s = sum(s.duration for s in record.stretches if s.still)
    p = run.p
    if run.chi2 > upper_point(run.freedom, _DOUBT) / run.freedom and not drives:
        warnings.append(
            "the sensors disagree with gravity and the Earth's rate: squared"
            f" innovations are {run.chi2:.1f} times as large as their errors allow; the"
            " uncertainty is enlarged to match. Check the grade, the latitude and whether the"
            " vehicle stood still"
        )
        p = p * run.chi2
    cov = p[:3, :3].copy()
    sigma_heading = float(np.sqrt(cov[2, 2]))
    worst = float(np.sqrt(np.linalg.eigvalsh(cov)[-1]))
    tilt = float(np.sqrt(np.linalg.eigvalsh(cov[:2, :2])[-1]))
    q_nb = rotation.normalise(rotation.multiply(rotation.exp(-run.x[:3]), run.q_nb))
    horizontal = float(np.cos(latitude))
    if horizontal < _NEAR_POLE:
        warnings.append(
            f"only {100.0 * horizontal:.1f} % of the Earth's rate is horizontal at latitude"
            f" {np.rad2deg(latitude):.2f} deg: heading is that much harder to see"
        )
    status: Status = "ok" if worst <= OK_SIGMA else "degraded"
    if drives:
        warnings.append(
            f"the vehicle moves: its specific force changes by {record.shake:.1f} m/s^2 from one"
            " half second to the next; gyrocompassing needs it to stay where it is"
        )
        status, q_nb = "unobservable", np.full(4, np.nan)
    elif worst > REFUSE_SIGMA:
        predicted = np.rad2deg(min(sigma_heading, np.pi))
        alone = np.rad2deg(grade.gyro_bias / max(earth.EARTH_RATE * horizontal, 1e-12))
        warnings.append(
            f"heading is not observable: predicted sigma {predicted:.1f} deg after"
            f" {record.duration_s:.0f} s; a gyro bias of"
            f" {np.rad2deg(grade.gyro_bias) * 3600.0:.3g} deg/h alone makes"
            f" {min(alone, predicted):.1f} deg at this latitude. This needs better gyros, a longer"
            " rest or GNSS in motion"
        )
        if tilt <= OK_SIGMA:
            roll, pitch, _ = rotation.to_euler(q_nb)
            status, q_nb = "level-only", rotation.from_euler([roll, pitch, 0.0])
        else:
            status, q_nb = "unobservable", np.full(4, np.nan)
        cov[2, :] = cov[:, 2] = 0.0
        cov[2, 2] = UNIFORM_SIGMA**2
    elif status == "degraded":
        warnings.append(
            f"heading is uncertain: predicted sigma {np.rad2deg(sigma_heading):.1f} deg"
        )
    return Gyrocompass(
        status,
        record.end_ns,
        record.start_ns,
        q_nb if q_nb[0] >= 0.0 else -q_nb,
        cov,
        np.sqrt(np.diag(cov)),
        sigma_heading,
        run.x[3:6],
        run.x[6:],
        np.sqrt(np.diag(p)[3:6]),
        np.sqrt(np.diag(p)[6:]),
        record.angle_random_walk,
        record.velocity_random_walk,
        still_s,
        run.chi2,
        tuple(warnings),
    )
