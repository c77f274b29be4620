"""A skewed triad of gyros on a turntable at rest on the Earth, with its possible errors.

The angle of the table is known in closed form: constant rates joined by ramps of constant
acceleration, and a ripple of the rate that follows the angle. What the gyros integrate along
the axis is then exact, and Earth rate and gravity across it are Gauss-Legendre quadratures of
the exact angle over each interval, with an error below rounding. Errors follow section 1 of
[1]_: the calibration that the user believes in differs from the true one, which is how they
arise in life. Noise is added to increments, so that a quantised gyro loses no angle.

References
----------
.. [1] H. Yu et al., "On-line calibration and compensation of heading-sensitive error for triad
   constant-rate biased RLG system", J. NUDT 35(4), 2013, 161-165.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sinstool.core import rotation
from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.earth import earth_rate_n, gravity_n
from sinstool.core.first_order import carry_over
from sinstool.core.rotation import skew
from sinstool.simulation.turntable import TableProfile

IDEAL_AXIS = (-1.0 / np.sqrt(3.0),) * 3
"""Direction of the axis in ``s`` where all gyros stand at 54.74 degrees to it."""

# Nodes of the quadrature by the largest half-angle of an interval, rad: errors below 1e-16.
_FEW, _MANY, _SMALL = 3, 9, 0.01
_STAMPS = {"end": 1.0, "mid": 0.5, "start": 0.0}


@dataclass(frozen=True)
class HseRigSetup:
    """A rig and its true parameters.

    Attributes
    ----------
    latitude : float
        rad.
    heading, theta, gamma : float
        Of the base ``b0`` in the middle of the log, rad; 3-2-1 as for a vehicle.
    axis : tuple of 3 float
        Unit vector of the axis of rotation in ``s``, downward.
    K_g : tuple of tuple of float
        True, lower triangular: rates of the raw triad become rates in ``s``.
    K_a : tuple of tuple of float
        True: raw accelerations become those in ``s``.
    epsilon, kappa : tuple of 3 float
        The believed K_g is ``(I + Lambda) K_g`` with these below and on the diagonal of Lambda
        (eps1 at row 2, eps2 and eps3 at row 3); eq. (1) of [1]_ of the module.
    xi : tuple of 3 float
        The believed C_s^b is ``(I - [xi x]) C_s^b``; eq. (2).
    imu_rate, encoder_rate : float
        Hz.
    imu_stamp : {'end', 'mid', 'start'}
        Of the interval that a sample is the mean over.
    epoch_ns : int
        Added to all stamps.
    """

    latitude: float = 0.49
    heading: float = 0.7
    theta: float = 0.0
    gamma: float = 0.0
    axis: tuple[float, ...] = IDEAL_AXIS
    K_g: tuple[tuple[float, ...], ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    K_a: tuple[tuple[float, ...], ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    epsilon: tuple[float, ...] = (0.0, 0.0, 0.0)
    kappa: tuple[float, ...] = (0.0, 0.0, 0.0)
    xi: tuple[float, ...] = (0.0, 0.0, 0.0)
    imu_rate: float = 500.0
    encoder_rate: float = 500.0
    imu_stamp: str = "end"
    epoch_ns: int = 1_700_000_000_000_000_000


@dataclass(frozen=True)
class HseRigErrors:
    """Errors of sensors and table; all 0 by default.

    Attributes
    ----------
    angle_random_walk : float
        rad/sqrt(s).
    gyro_bias : tuple of 3 float
        rad/s, of the raw triad.
    gyro_drift, gyro_drift_time_s : float
        Standard deviation, rad/s, and correlation time, s, of a first-order Gauss-Markov
        process in each gyro.
    gyro_quantum : float
        rad; angle of one count.
    gyro_scale : float
        Relative; the gyros give ``1 + gyro_scale`` times the rate.
    velocity_random_walk : float
        (m/s)/sqrt(s).
    accel_bias : tuple of 3 float
        m/s^2, raw.
    lever_arm : tuple of 3 float
        m: the accelerometers in ``b``, from the axis.
    encoder_lsb : float
        rad; readings are rounded to multiples of it.
    encoder_harmonics : tuple of (int, float, float)
        ``(k, amplitude, phase)``: the reading is wrong by ``amplitude sin(k reading + phase)``.
    encoder_sign : int
        Of the readings against the angle about the downward axis.
    encoder_offset : float
        rad; angle at reading 0.
    encoder_delay : float
        s; a reading is that much older than its stamp.
    encoder_jitter : float
        s; standard deviation of the encoder's stamps.
    encoder_wrap : {'turn', 'half-turn', 'none'}
        Readings in [0, 2 pi), [-pi, pi), or counted on.
    encoder_degrees : bool
        Readings in degrees.
    imu_jitter : float
        s; standard deviation of the IMU's stamps.
    clock : float
        Relative; stamps run ``1 + clock`` times as fast as time.
    ripple, ripple_order, ripple_phase : float, int, float
        The table's rate is ``1 + ripple cos(order angle + phase)`` times what it should be.
    base_drift_n : tuple of 3 float
        Rate at which the base turns, rad/s in NED.
    """

    angle_random_walk: float = 0.0
    gyro_bias: tuple[float, ...] = (0.0, 0.0, 0.0)
    gyro_drift: float = 0.0
    gyro_drift_time_s: float = 1000.0
    gyro_quantum: float = 0.0
    gyro_scale: float = 0.0
    velocity_random_walk: float = 0.0
    accel_bias: tuple[float, ...] = (0.0, 0.0, 0.0)
    lever_arm: tuple[float, ...] = (0.0, 0.0, 0.0)
    encoder_lsb: float = 0.0
    encoder_harmonics: tuple[tuple[int, float, float], ...] = ()
    encoder_sign: int = 1
    encoder_offset: float = 0.0
    encoder_delay: float = 0.0
    encoder_jitter: float = 0.0
    encoder_wrap: str = "turn"
    encoder_degrees: bool = False
    imu_jitter: float = 0.0
    clock: float = 0.0
    ripple: float = 0.0
    ripple_order: int = 1
    ripple_phase: float = 0.0
    base_drift_n: tuple[float, ...] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class HseRigTruth:
    """Truth of a simulated log.

    Attributes
    ----------
    alpha, rate : ndarray, shape (n,)
        Angle, rad, and rate, rad/s, of the table at the IMU's (undisturbed) stamps.
    q_nb : ndarray, shape (n, 4)
        Attitude of the body there.
    C_nb0 : ndarray, shape (3, 3)
        Attitude of the base in the middle of the log.
    heading, theta, gamma : float
        Its angles, rad; heading in [0, 2 pi).
    C23 : float
        East component of the axis.
    X : ndarray, shape (3, 3)
        Relative error of rates in ``b`` as the user computes them, scale and clock included.
    lambda2 : float
        ``-3 X33``, rad: the heading-sensitive error coefficient.
    K_g, C_s_to_b : ndarray, shape (3, 3)
        True.
    """

    alpha: FloatArray
    rate: FloatArray
    q_nb: FloatArray
    C_nb0: FloatArray
    heading: float
    theta: float
    gamma: float
    C23: float
    X: FloatArray
    lambda2: float
    K_g: FloatArray
    C_s_to_b: FloatArray


@dataclass(frozen=True, eq=False)
class HseRigLog:
    """A simulated log.

    Attributes
    ----------
    time_ns : ndarray of int64, shape (n,)
    gyro : ndarray, shape (n, 3)
        Mean rates of the raw triad, rad/s.
    accel : ndarray, shape (n, 3)
        Mean raw specific forces, m/s^2.
    encoder_time_ns : ndarray of int64, shape (m,)
    encoder_position : ndarray, shape (m,)
        rad, or degrees if so set up.
    believed_K_g, believed_C_s_to_b : ndarray, shape (3, 3)
        The calibration that the user has.
    """

    time_ns: IntArray
    gyro: FloatArray
    accel: FloatArray
    encoder_time_ns: IntArray
    encoder_position: FloatArray
    believed_K_g: FloatArray
    believed_C_s_to_b: FloatArray
    truth: HseRigTruth


def hse_rig(
    plateaus: Sequence[tuple[float, float]],
    setup: HseRigSetup | None = None,
    errors: HseRigErrors | None = None,
    *,
    acceleration: float = np.radians(5.0),
    start_angle: float = 0.3,
    seed: int = 0,
) -> HseRigLog:
    """A log of the rig.

    Parameters
    ----------
    plateaus : sequence of (float, float)
        Rates of the table, rad/s, and how long each is held, s; positive is clockwise seen
        from above.
    acceleration : float
        rad/s^2 between plateaus.
    start_angle : float
        rad at the start.
    seed : int
        Of the random numbers.

    Raises
    ------
    ValueError
        If a setting is impossible.
    """
    setup = setup or HseRigSetup()
    errors = errors or HseRigErrors()
    table = _Table(TableProfile(plateaus, acceleration), errors, start_angle)
    random = np.random.default_rng(seed)
    dt = 1.0 / setup.imu_rate
    n = int(np.floor(table.profile.duration * setup.imu_rate + 1e-9))
    if n < 2:
        raise ValueError("the log would hold fewer than two samples")
    middle = 0.5 * n * dt
    C_nb0 = rotation.to_dcm(rotation.from_euler([setup.gamma, setup.theta, setup.heading]))
    base = _Base(C_nb0, np.array(errors.base_drift_n), middle)
    K_g, K_a = np.array(setup.K_g), np.array(setup.K_a)
    C_s_to_b = _axis_matrix(setup.axis)

    begins = np.arange(n, dtype=np.float64) * dt
    rate_b, force_b = _means(table, base, begins, dt, setup, errors)
    raw = rate_b @ np.linalg.solve(K_g, C_s_to_b.T).T
    gyro = _gyro_errors(raw, dt, errors, random)
    accel = force_b @ np.linalg.solve(K_a, C_s_to_b.T).T
    accel += np.array(errors.accel_bias)
    if errors.velocity_random_walk:
        accel += errors.velocity_random_walk / np.sqrt(dt) * random.standard_normal((n, 3))

    at = begins + _STAMPS[setup.imu_stamp] * dt
    encoder_at, position = _encoder(table, setup, errors)
    believed_K_g = (np.eye(3) + _lambda(setup.epsilon, setup.kappa)) @ K_g
    believed_C = (np.eye(3) - skew(setup.xi)) @ C_s_to_b
    scale = (1.0 + errors.gyro_scale) * (1.0 + errors.clock)
    X = scale * (believed_C @ believed_K_g @ np.linalg.solve(K_g, C_s_to_b.T)) - np.eye(3)
    alpha, rate, _ = table.angle(at)
    half = 0.5 * alpha
    q_b0b = np.stack([np.cos(half), 0.0 * half, 0.0 * half, np.sin(half)], axis=-1)
    truth = HseRigTruth(
        alpha=alpha,
        rate=rate,
        q_nb=rotation.multiply(base.q_nb0(at), q_b0b),
        C_nb0=C_nb0,
        heading=float(setup.heading % (2.0 * np.pi)),
        theta=setup.theta,
        gamma=setup.gamma,
        C23=float(C_nb0[1, 2]),
        X=X,
        lambda2=float(-3.0 * X[2, 2]),
        K_g=K_g,
        C_s_to_b=C_s_to_b,
    )
    return HseRigLog(
        time_ns=_stamps(at, errors.imu_jitter, setup, errors, random),
        gyro=gyro,
        accel=accel,
        encoder_time_ns=_stamps(encoder_at, errors.encoder_jitter, setup, errors, random),
        encoder_position=position,
        believed_K_g=believed_K_g,
        believed_C_s_to_b=believed_C,
        truth=truth,
    )


class _Table:
    """Angle with ripple: ``alpha + (ripple / k) sin(k alpha + phase)``."""

    def __init__(self, profile: TableProfile, errors: HseRigErrors, start: float) -> None:
        self.profile = profile
        self._errors = errors
        self._start = start

    def angle(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        angle, rate, acceleration = self.profile.angle(t)
        angle = angle + self._start
        ripple, k = self._errors.ripple, self._errors.ripple_order
        if ripple:
            phase = k * angle + self._errors.ripple_phase
            gain = 1.0 + ripple * np.cos(phase)
            acceleration = acceleration * gain - ripple * k * np.sin(phase) * rate**2
            rate = rate * gain
            angle = angle + ripple / k * np.sin(phase)
        return angle, rate, acceleration


class _Base:
    """Attitude of a base that turns slowly at a constant rate in NED."""

    def __init__(self, C_nb0: FloatArray, drift_n: FloatArray, middle: float) -> None:
        self.C_nb0 = C_nb0
        self.drift_n = drift_n
        self._middle = middle

    def q_nb0(self, t: FloatArray) -> FloatArray:
        """Attitude; shape (n, 4), or (1, 4) for a base at rest."""
        if not self.drift_n.any():
            return rotation.from_dcm(self.C_nb0)[np.newaxis]
        turned = rotation.exp(self.drift_n * (t - self._middle)[:, np.newaxis])
        return rotation.multiply(turned, rotation.from_dcm(self.C_nb0))

    def in_b0(self, vector_n: FloatArray, t: FloatArray) -> FloatArray:
        """A vector of NED in ``b0``; shape (n, 3), or (1, 3) for a base at rest."""
        if not self.drift_n.any():
            return (self.C_nb0.T @ vector_n)[np.newaxis]
        turned = rotation.exp(-self.drift_n * (t - self._middle)[:, np.newaxis])
        return rotation.rotate(turned, vector_n) @ self.C_nb0


def _means(
    table: _Table,
    base: _Base,
    begins: FloatArray,
    dt: float,
    setup: HseRigSetup,
    errors: HseRigErrors,
) -> tuple[FloatArray, FloatArray]:
    """Mean rate and specific force in ``b`` over intervals, rad/s and m/s^2."""
    middles = begins + 0.5 * dt
    edges, _, _ = table.angle(np.append(begins, begins[-1] + dt))
    # the base moves by less than rounding within an interval
    u = base.in_b0(earth_rate_n(setup.latitude) + base.drift_n, middles)
    f = base.in_b0(-gravity_n(setup.latitude), middles)
    cos, sin = np.zeros_like(begins), np.zeros_like(begins)
    lever = np.zeros((len(begins), 3))
    arm = np.array(errors.lever_arm)
    small = 0.5 * np.abs(np.diff(edges)).max() < _SMALL
    nodes, weights = np.polynomial.legendre.leggauss(_FEW if small else _MANY)
    for node, weight in zip(nodes, 0.5 * weights, strict=True):
        angle, rate, acceleration = table.angle(middles + 0.5 * dt * node)
        cos += weight * np.cos(angle)
        sin += weight * np.sin(angle)
        if arm.any():
            lever[:, 0] += weight * (-(rate**2) * arm[0] - acceleration * arm[1])
            lever[:, 1] += weight * (-(rate**2) * arm[1] + acceleration * arm[0])
    rate_b = _turned_back(u, cos, sin)
    rate_b[:, 2] += np.diff(edges) / dt
    return rate_b, _turned_back(f, cos, sin) + lever


def _turned_back(v: FloatArray, cos: FloatArray, sin: FloatArray) -> FloatArray:
    """``Rz(-alpha) v`` for means of cos alpha and sin alpha."""
    out = np.empty((len(cos), 3))
    out[:, 0] = cos * v[:, 0] + sin * v[:, 1]
    out[:, 1] = cos * v[:, 1] - sin * v[:, 0]
    out[:, 2] = v[:, 2]
    return out


def _gyro_errors(
    raw: FloatArray, dt: float, errors: HseRigErrors, random: np.random.Generator
) -> FloatArray:
    """Raw rates as the gyros give them."""
    n = len(raw)
    rate = (1.0 + errors.gyro_scale) * raw + np.array(errors.gyro_bias)
    if errors.gyro_drift:
        decay = np.exp(-dt / errors.gyro_drift_time_s)
        step = errors.gyro_drift * np.sqrt(1.0 - decay**2)
        driven = step * random.standard_normal((n, 3))
        driven[0] = errors.gyro_drift * random.standard_normal(3)
        carry_over(np.full(n, decay), driven)
        rate += driven
    if errors.angle_random_walk:
        rate += errors.angle_random_walk / np.sqrt(dt) * random.standard_normal((n, 3))
    if errors.gyro_quantum:
        counts = np.round(np.cumsum(rate, axis=0) * (dt / errors.gyro_quantum))
        rate = np.diff(counts, axis=0, prepend=0.0) * (errors.gyro_quantum / dt)
    return rate


def _encoder(
    table: _Table, setup: HseRigSetup, errors: HseRigErrors
) -> tuple[FloatArray, FloatArray]:
    """Times and readings of the encoder."""
    m = int(np.floor(table.profile.duration * setup.encoder_rate + 1e-9)) + 1
    at = np.arange(m, dtype=np.float64) / setup.encoder_rate
    angle, _, _ = table.angle(at - errors.encoder_delay)
    reading = errors.encoder_sign * (angle - errors.encoder_offset)
    ideal = reading
    for order, amplitude, phase in errors.encoder_harmonics:
        reading = reading + amplitude * np.sin(order * ideal + phase)
    if errors.encoder_lsb:
        reading = errors.encoder_lsb * np.round(reading / errors.encoder_lsb)
    if errors.encoder_wrap == "turn":
        reading = np.mod(reading, 2.0 * np.pi)
    elif errors.encoder_wrap == "half-turn":
        reading = np.mod(reading + np.pi, 2.0 * np.pi) - np.pi
    return at, np.degrees(reading) if errors.encoder_degrees else reading


def _stamps(
    t: FloatArray,
    jitter: float,
    setup: HseRigSetup,
    errors: HseRigErrors,
    random: np.random.Generator,
) -> IntArray:
    """Stamps in ns; sorted, as jitter may exceed the interval."""
    late = t * (1.0 + errors.clock)
    if jitter:
        late = np.sort(late + jitter * random.standard_normal(len(t)))
    return np.int64(setup.epoch_ns) + np.round(late * 1e9).astype(np.int64)


def _axis_matrix(axis: Sequence[float]) -> FloatArray:
    """C_s^b of section 1.1 of the paper: rows x, y and z of ``b`` in ``s``."""
    z = np.asarray(axis, dtype=np.float64)
    if z.shape != (3,) or abs(float(np.linalg.norm(z)) - 1.0) > 1e-9:
        raise ValueError(f"Expected `axis` to be a unit vector, got {axis!r}.")
    y = np.cross(z, [1.0, 0.0, 0.0])
    y /= np.linalg.norm(y)
    return np.stack([np.cross(y, z), y, z])


def _lambda(epsilon: Sequence[float], kappa: Sequence[float]) -> FloatArray:
    (e1, e2, e3), (k1, k2, k3) = epsilon, kappa
    return np.array([[k1, 0.0, 0.0], [e1, k2, 0.0], [e2, e3, k3]])
