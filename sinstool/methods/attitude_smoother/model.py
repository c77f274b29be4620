"""Assumptions of the smoother: sensors by their grade, motion by its class."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import exp, hypot, sqrt
from typing import Literal

from sinstool.core.arrays import FloatArray
from sinstool.core.earth import EARTH_RATE
from sinstool.methods.sensor_errors import (
    IMU_GRADES,
    LOW_COST,
    UNCALIBRATED_BY,
    Grade,
    uncalibrated,
)

MotionName = Literal["hand", "vehicle"]

EPOCH_S = 0.2
GRAVITY = 9.81  # m/s^2; the difference of local gravity from this is a state
# Least standard deviation of a vehicle's velocity at the start of a log, m/s, along each axis: it
# may be on a motorway or in the air, and braking from there looks like a tilt. A rest at the start
# shows it better.
FIRST_VELOCITY = 30.0


@dataclass(frozen=True)
class MotionModel:
    """How the motion is bounded.

    ``acceleration = -c1 velocity - c0 position + white noise``, along each axis; where the velocity
    follows the body, ``acceleration = turn rate x velocity - c1 velocity + white noise``.

    Attributes
    ----------
    name : {'hand', 'vehicle'}
    c1 : float
        1/s.
    c0 : float
        1/s^2; 0 where no position bounds the motion.
    density : float
        Of the white part, m/s^2/sqrt(Hz).
    follows : bool
        The level velocity turns with the body about the vertical.
    finds_bias : bool
        The biases of the accelerometers are states: they turn with the vehicle, a tilt does not. A
        hand's turn with its centripetal accelerations too, which look like them.
    """

    name: MotionName
    c1: float
    c0: float
    density: float
    follows: bool = False
    finds_bias: bool = False

    @property
    def states(self) -> int:
        """How many states the filter has."""
        return 13 if self.c0 or self.finds_bias else 10

    @property
    def velocity_variance(self) -> float:
        """Of a velocity that is stationary, m^2/s^2."""
        return self.density**2 / (2.0 * self.c1)

    @property
    def first_velocity_variance(self) -> float:
        """At the start of a log, m^2/s^2."""
        least = 0.0 if self.c0 else FIRST_VELOCITY**2
        return max(self.velocity_variance, least)

    @property
    def position_variance(self) -> float:
        """Of a position that is stationary, m^2; 0 where it is not bounded."""
        return self.velocity_variance / self.c0 if self.c0 else 0.0

    def with_velocity(self, variance: float) -> MotionModel:
        """A vehicle's model with another variance of a velocity that is stationary, m^2/s^2."""
        return replace(self, c1=self.density**2 / (2.0 * variance))

    def with_density(self, density: float) -> MotionModel:
        """The same bound with another density of acceleration."""
        return replace(self, density=density)


# A hand's position is bounded, with a natural rate of 1.4 rad/s and a damping of 0.7 (with 1 to 2
# rad/s the results for recorded hands agree to 0.003 deg). A vehicle's velocity is bounded, with a
# correlation time of 33 s.
HAND = MotionModel("hand", 2.0, 2.0, 0.5)
VEHICLE = MotionModel("vehicle", 0.03, 0.0, 4.0)
# The velocity of cars, ships and aircraft follows their heading. Turns then show it, so it need not
# be forgotten: its correlation time is five minutes and more.
FOLLOWER = MotionModel("vehicle", 0.003, 0.0, 4.0, follows=True)


@dataclass(frozen=True)
class SensorModel:
    """Errors of the sensors, one sigma of one axis.

    Attributes
    ----------
    angle_random_walk : float
        rad/sqrt(s).
    rate_error : float
        Errors in proportion to the rate (scale factor, misalignment, timing): the variance of
        attitude grows by its square times the integral of the squared rate.
    missed : float
        The same, beyond that, of gyros that rests show to have missed a turn.
    gyro_scale, gyro_misalignment : float
        The part of them that lasts: a heading that turns on and on is off in proportion.
    bias_walk : float
        rad/s/sqrt(s).
    bias : float
        Gyro bias at the start, beyond what was removed, rad/s.
    bias_mean : tuple of float
        About which it is, body axes, rad/s: the negative of what was removed and is no bias.
    zero_rate : float
        How far the mean rate of an epoch of rest may be from the bias beside its noise, rad/s.
    bias_drift : float
        Of the gyros while they warm up, rad/s^2: a rest may show it.
    velocity_walk : float
        Accelerometer errors as noise of the velocity, m/s/sqrt(s).
    accel_bias : float
        m/s^2. A level bias looks like a tilt: of a vehicle it is a state, otherwise it is added to
        the covariance of tilt.
    bias_removed : tuple of float or None
        Gyro bias that was taken off, body axes, rad/s, of sensors that may be uncalibrated: then an
        attitude is less certain, as far as motion has not shown the accelerometers' bias.
    gravity, gravity_walk : float
        Vertical excess of the specific force at the start, m/s^2, and its walk, m/s^2/sqrt(s).
    stop_rate : float
        What a gyro misses at the end of its range, rad/s.
    """

    angle_random_walk: float = 3e-4
    rate_error: float = 3e-3
    missed: float = 0.0
    gyro_scale: float = IMU_GRADES["mems"].gyro_scale
    gyro_misalignment: float = IMU_GRADES["mems"].gyro_misalignment
    bias_walk: float = 1e-5
    bias: float = 0.03
    bias_mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    zero_rate: float = IMU_GRADES["mems"].gyro_instability
    bias_drift: float = 3e-6
    velocity_walk: float = 0.05
    accel_bias: float = 0.03
    bias_removed: tuple[float, float, float] | None = None
    gravity: float = 0.2
    gravity_walk: float = 0.02
    stop_rate: float = 0.0


# Bias of low-cost gyros where no rest has shown it (that of `SensorModel`), and about the mean rate
# of a rest, rad/s.
_MEMS = SensorModel()
_BARE = IMU_GRADES["consumer"]
_MEMS_BIAS_AFTER_REST = 5e-3
_SHORT_REST_S = 5.0
# With a bias as uncertain as this the first pass is linear about a wrong attitude, rad/s.
LARGE_BIAS = 0.01


# One sigma of the bias of an uncalibrated accelerometer axis, m/s^2: data sheets of parts for
# telephones allow 20 to 80 mg.
POOR_ACCEL_BIAS = 0.2
# Telephones and drivers remove the bias of gyros, but not that of accelerometers. With this
# probability accelerometers are uncalibrated though the gyros beside them have hardly a bias.
ONLY_GYROS = 0.1
# Of calibrated accelerometers, the share that time, temperature and stress have moved to the bias
# of their grade; the others have that of a new calibration, with which a filter works.
AGED, AGED_ACCEL_BIAS = 0.5, IMU_GRADES["mems"].accel_bias
# If it is this probable that gyros are uncalibrated, their bias is taken to change as the sensor
# warms up, by 0.03 deg/s for each kelvin as data sheets say: rad/s/sqrt(s) and rad/s^2.
SURE, WARMING_WALK, WARMING_DRIFT = 0.95, 5e-5, 2e-5


def accel_uncalibrated(gyro_bias: FloatArray | None, off: float) -> float:
    """Probability that the accelerometers of a low-cost IMU are not calibrated.

    Parameters
    ----------
    gyro_bias : ndarray, shape (3,), or None
        As estimated, rad/s; None: unknown.
    off : float
        Difference of gravity in the log from that of its place, m/s^2: the bias of about one axis.
    """
    gyros = 0.0 if gyro_bias is None else uncalibrated(gyro_bias)
    before = gyros + (1.0 - gyros) * ONLY_GYROS
    more = 0.5 * off**2 * (1.0 / _MEMS.accel_bias**2 - 1.0 / POOR_ACCEL_BIAS**2)
    odds = before / max(1.0 - before, 1e-12) * exp(min(more, 50.0))
    odds *= _MEMS.accel_bias / POOR_ACCEL_BIAS
    return odds / (1.0 + odds)


def likely_accel_bias(gyro_bias: FloatArray | None, off: float) -> float:
    """Root mean square bias of an axis of low-cost accelerometers, m/s^2.

    Over new calibrations, older ones, and none, by how likely each is with what is known; see
    :func:`accel_uncalibrated` for the parameters.
    """
    fresh, aged = _MEMS.accel_bias, AGED_ACCEL_BIAS
    odds = AGED / (1.0 - AGED) * fresh / aged
    odds *= exp(min(0.5 * off**2 * (fresh**-2 - aged**-2), 50.0))
    calibrated = (fresh**2 + odds * aged**2) / (1.0 + odds)
    poor = accel_uncalibrated(gyro_bias, off)
    return sqrt((1.0 - poor) * calibrated + poor * POOR_ACCEL_BIAS**2)


def as_calibrated(sensors: SensorModel, gyro_bias: FloatArray) -> SensorModel:
    """The sensors, with the scale factors and misalignments that the bias of the gyros suggests.

    They lie between those of a calibrated module and of a bare chip, on a logarithmic scale. Where
    the gyros are surely uncalibrated nothing compensates for temperature.
    """
    share = uncalibrated(gyro_bias)
    scale, axes = _BARE.gyro_scale / _MEMS.gyro_scale, UNCALIBRATED_BY
    bare = hypot(_BARE.gyro_scale, _BARE.gyro_misalignment)
    more = bare / hypot(_MEMS.gyro_scale, _MEMS.gyro_misalignment)
    sensors = replace(
        sensors,
        rate_error=max(sensors.rate_error, _MEMS.rate_error * more**share),
        gyro_scale=max(sensors.gyro_scale, _MEMS.gyro_scale * scale**share),
        gyro_misalignment=max(sensors.gyro_misalignment, _MEMS.gyro_misalignment * axes**share),
    )
    if share < SURE:
        return sensors
    return replace(
        sensors,
        bias_walk=max(sensors.bias_walk, WARMING_WALK),
        bias_drift=max(sensors.bias_drift, WARMING_DRIFT),
    )


def sensor_model(
    grade: Grade, *, walk_at_rest: float | None, bias_known: bool, earth_removed: bool
) -> SensorModel:
    """Errors of a grade of IMU.

    Parameters
    ----------
    grade : {'consumer', 'mems', 'industrial', 'tactical', 'navigation'}
    walk_at_rest : float or None
        Angular random walk that the log shows at rest, rad/sqrt(s).
    bias_known : bool
        A rest, an alignment or the user gave the bias that was taken off.
    earth_removed : bool
        The Earth's rate was taken off; where it was not, it wanders through the body's axes like
        a bias.

    Returns
    -------
    SensorModel
    """
    seen = 0.0 if walk_at_rest is None else 2.0 * walk_at_rest
    turning = 0.0 if earth_removed else EARTH_RATE / 10.0
    if grade in LOW_COST:
        return replace(
            _MEMS,
            angle_random_walk=max(_MEMS.angle_random_walk, seen),
            bias=_MEMS_BIAS_AFTER_REST if bias_known else _MEMS.bias,
            bias_walk=max(_MEMS.bias_walk, turning),
        )
    of = IMU_GRADES[grade]
    walk = max(of.angle_random_walk, seen)
    wander = of.gyro_instability * sqrt(2.0 / of.bias_time_s)
    # A short rest shows less of a good gyro's bias than its data sheet says; without any rest the
    # grade may be a guess.
    bias = hypot(of.gyro_bias, walk / sqrt(_SHORT_REST_S)) if bias_known else 3.0 * of.gyro_bias
    return SensorModel(
        angle_random_walk=walk,
        rate_error=sqrt(of.gyro_scale**2 + of.gyro_misalignment**2),
        gyro_scale=of.gyro_scale,
        gyro_misalignment=of.gyro_misalignment,
        bias_walk=max(wander, turning),
        bias=max(bias, 0.0 if earth_removed else EARTH_RATE),
        zero_rate=of.gyro_instability,
        bias_drift=_MEMS.bias_drift * of.gyro_instability / _MEMS.zero_rate,
        velocity_walk=_MEMS.velocity_walk
        * of.velocity_random_walk
        / IMU_GRADES["mems"].velocity_random_walk,
        accel_bias=of.accel_bias,
        gravity=_MEMS.gravity,
        gravity_walk=_MEMS.gravity_walk,
    )
