"""The scenarios of `simulate` as options; `make` produces the logs."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from sinstool.core.errors import ConfigurationError
from sinstool.core.options import Group, option, span

MAX_RATE_HZ = 1e6
MAX_DURATION_S = 1e6
LARGEST_LEAN = 0.5
SHORTEST_FERRY_S = 30.0
# Errors that the sensors of a grade may have besides noise and constant biases
SCALE = "the scale factors of their grade"
MISALIGNMENT = "axes that are off by the misalignments of their grade"
DRIFT = "biases that wander as those of their grade"
Positive = Annotated[float, Field(gt=0)]


def _duration(seconds: float, what: str = "length of the log in s") -> Any:
    return option(seconds, what, "S", gt=0, le=MAX_DURATION_S)


def _rate(hertz: float) -> Any:
    return option(hertz, "samples per second", "HZ", gt=0, le=MAX_RATE_HZ)


def _latitude(degrees: float) -> Any:
    return option(degrees, "latitude in degrees", "DEG", ge=-90, le=90)


def _longitude(degrees: float) -> Any:
    return option(degrees, "longitude in degrees", "DEG", ge=-180, le=180)


class Scenario(Group):
    """A log that can be simulated."""

    title = "Scenario"

    rate: float = _rate(400.0)
    seed: int = option(0, "seed of the random errors", "N", ge=0)
    truth: bool = option(True, "write the truth to /truth/... (default: yes)")


def _part(on: bool, what: str) -> Any:
    return option(on, f"give the sensors {what} (default: {'yes' if on else 'no'})")


class MotionScenario(Scenario):
    """A log of an IMU that moves or rests.

    Sensors of a grade always have white noise and constant biases. The other errors of the grade
    are on by default for a vehicle. They are off for a rotation about a point, which is there to
    show the error of an algorithm, as scale factors would hide it.
    """

    duration: float = _duration(60.0)
    gyro_kind: Literal["rate", "mean-rate", "increment"] = option(
        "rate", "what a gyro sample of the IMU topic is"
    )
    body_axes: Literal["flu", "frd"] = option(
        "flu", "axes of the IMU topic; the truth's world is ENU for flu, NED for frd"
    )
    grade: Literal["perfect", "navigation", "tactical", "industrial", "mems", "consumer"] = option(
        "perfect", "grade of the sensors, which sets their errors"
    )
    scale_errors: bool = _part(False, SCALE)
    misalignment: bool = _part(False, MISALIGNMENT)
    bias_drift: bool = _part(False, DRIFT)

    def check(self) -> None:
        """Require at least one interval between samples."""
        if self.duration * self.rate < 1.0:
            raise ConfigurationError("--duration is shorter than one sample interval")


class Coning(MotionScenario):
    """Classical coning, exact for any angle, after an optional rest; the Earth does not turn."""

    duration: float = _duration(60.0, "length of the coning in s, after --lead-in")
    half_angle_deg: float = option(1.0, "half angle of the cone in degrees", "DEG", gt=0, lt=90)
    frequency: float = option(
        10.0, "turns of the cone per second", "HZ", ge=-MAX_RATE_HZ, le=MAX_RATE_HZ
    )
    lead_in: float = option(0.0, "rest before the coning in s", "S", ge=0, le=MAX_DURATION_S)


class ConingPaper(MotionScenario):
    """Fu and Luo's experiment: a cone, and noise of one frequency through the gyro's filter.

    The truth is the cone. The gyro has the noise; further errors come with --grade.
    """

    noise_frequency: float = option(400.0, "frequency of the noise", "HZ", ge=0, le=MAX_RATE_HZ)
    noise_deg: float = option(
        0.01,
        "amplitude of the noise as an angle in degrees, before the gyro's filter",
        "DEG",
        ge=0,
        lt=90,
    )
    phase: Literal["consistent", "literal"] = option(
        "consistent",
        "eq. (20) of the paper as its motion requires (consistent), or as printed (literal)",
    )
    gyro_response: str = option(
        "cheb:6",
        "low-pass filter of the gyro: none, cheb:ORDER[,RIPPLE_DB,HZ], butter:ORDER[,HZ], or a file"
        " with lines of frequency and gain",
        "RESPONSE",
    )
    half_angle_deg: float = option(0.1, "half angle of the cone in degrees", "DEG", gt=0, lt=90)
    frequency: float = option(
        30.0, "turns of the cone per second", "HZ", ge=-MAX_RATE_HZ, le=MAX_RATE_HZ
    )


class Static(MotionScenario):
    """A body at rest on the turning Earth, with fixes of where it is."""

    latitude: float = _latitude(45.0)
    longitude: float = _longitude(0.0)
    height: float = option(0.0, "height above the ellipsoid in m", "M")
    attitude: tuple[float, float, float] = option(
        (0.0, 0.0, 0.0), "attitude in degrees, FRD axes in NED", "ROLL,PITCH,HEADING"
    )


class TwoFrequency(MotionScenario):
    """Two conings at once, which alias where their frequencies differ by the update rate."""

    half_angles_deg: tuple[Positive, Positive] = option(
        (0.1, 0.1), "half angles of the cones in degrees", "A,B"
    )
    frequencies: tuple[Positive, Positive] = option(
        (30.0, 130.0), "frequencies of the cones", "HZ,HZ"
    )


class Broadband(MotionScenario):
    """Vibration with coning at every frequency of a band, also beyond half the sampling rate."""

    angle_deg: float = option(0.05, "angle on x and on y, rms in degrees", "DEG", gt=0)
    band: tuple[Positive, Positive] = option(
        (20.0, 150.0), "lowest and highest frequency of the vibration", "HZ,HZ"
    )


class Manoeuvre(MotionScenario):
    """Random rotation about all three axes."""

    rate_rms_deg_s: float = option(60.0, "rms of the angular rate", "DEG/S", gt=0)
    band: tuple[Positive, Positive] = option(
        (0.1, 1.0), "lowest and highest frequency of the motion", "HZ,HZ"
    )


def _receiver(model: str) -> Any:
    return option(
        model,
        "errors of the fixes. launch: 0.1 m/s and 1 m white, 4.9 m Markov of 60 s. coloured: Markov"
        " in position (5/5/8 m, 200 s) and velocity (0.1/0.1/0.15 m/s, 60 s) beside white noise",
    )


def _per_second(rate: float, what: str) -> Any:
    return option(rate, f"{what} per second; 0: none", "HZ", ge=0)


class Vehicle(MotionScenario):
    """A vehicle over the Earth, with a receiver and a barometer."""

    scale_errors: bool = _part(True, SCALE)
    misalignment: bool = _part(True, MISALIGNMENT)
    bias_drift: bool = _part(True, DRIFT)
    latitude: float = _latitude(34.25)
    longitude: float = _longitude(108.9)
    height: float = option(400.0, "height above the ellipsoid in m", "M")
    heading: float = option(0.0, "heading at the start in degrees", "DEG")
    gnss_rate: float = _per_second(1.0, "fixes")
    gnss_model: Literal["perfect", "launch", "coloured"] = _receiver("coloured")
    gnss_latency: float = option(0.0, "age of a fix at its time stamp, in s", "S")
    gnss_offset: float = option(0.0, "time from the first IMU sample to the first fix, in s", "S")
    lever_arm: tuple[float, float, float] = option(
        (0.0, 0.0, 0.0), "from the IMU to the antenna, in m, FRD", "X,Y,Z"
    )
    gnss_outage: tuple[str, ...] = option(
        (), "span without fixes, in s from the start; repeatable", "START:END"
    )
    outages: tuple[Positive, Positive] | None = option(
        None, "an outage of LENGTH s every EVERY s, the first after EVERY s", "LENGTH,EVERY"
    )
    gnss_flat: tuple[str, ...] = option(
        (), "span in which fixes have no height; repeatable", "START:END"
    )
    gnss_outliers: float = option(
        0.0, "fraction of the fixes that are off by 100 m and 20 m/s", "X", ge=0, le=1
    )
    gnss_jump: tuple[str, ...] = option(
        (), "span in which positions are off by 100 m to the north; repeatable", "START:END"
    )
    velocity: bool = option(True, "write the receiver's velocity too (default: yes)")
    baro_rate: float = _per_second(10.0, "pressures")
    baro_sigma: float = option(
        10.0, "error of the barometer in m, 1 sigma, first-order Markov", "M", ge=0
    )
    baro_time: float = option(500.0, "correlation time of the barometer's error in s", "S", gt=0)
    baro_white: float = option(0.0, "white noise of the barometer in m, 1 sigma", "M", ge=0)

    @field_validator("gnss_outage", "gnss_flat", "gnss_jump")
    @classmethod
    def _spans(cls, texts: tuple[str, ...]) -> tuple[str, ...]:
        for text in texts:
            span(text)
        return texts


class SpiralClimb(Vehicle):
    """The flight of the height-damping paper: wide circles at 2 degrees of bank, 20 m a turn."""

    duration: float = _duration(3600.0)
    rate: float = _rate(128.0)
    baro_rate: float = _per_second(50.0, "pressures")


class ManoeuvringFlight(Vehicle):
    """Turns of 35 degrees of bank to either side, climbs and dives, in turbulence."""

    duration: float = _duration(1800.0)
    rate: float = _rate(100.0)
    height: float = option(1500.0, "height above the ellipsoid in m", "M")
    turbulence: float = option(1.0, "factor on the angles of the turbulence", "X", ge=0)


class Car(Group):
    """Slip of a car, place of the IMU in it, and its wheels; ideal by default."""

    mount: tuple[float, float, float] = option(
        (0.0, 0.0, 0.0),
        "attitude of the IMU in the vehicle, in degrees: FRD axes, turned by yaw, pitch, roll",
        "ROLL,PITCH,YAW",
    )
    axle_lever: float = option(
        0.0, "distance of the IMU ahead of the rear axle, which follows the road, in m", "M"
    )
    sideslip: float = option(
        0.0, "angle of slip outward for each m/s^2 of centripetal acceleration", "RAD/(M/S^2)"
    )
    slip: float = option(0.0, "slow random slip of the axle in m/s, 1 sigma", "M/S", ge=0)
    slip_time: float = option(3.0, "correlation time of the slip in s", "S", gt=0)
    suspension: float = option(
        1.0, "factor on the body's motion on its springs; 0: body and axle are one", "X", ge=0
    )
    idle: tuple[float, float] = option(
        (0.0, 0.0),
        "vibration of the engine while the car stands, rms of three axes, m/s^2 and rad/s",
        "ACCEL,GYRO",
    )
    ferry: tuple[float, float] | None = option(
        None,
        "the car stands on a ferry that goes sideways at 3 m/s in waves; in s from the start",
        "START,DURATION",
    )
    wheels: Literal["none", "odometry", "twist", "joint"] = option(
        "none",
        "write wheel speeds: Odometry, TwistStamped, or JointState of two rear wheels, rad/s",
    )
    wheel_rate: float = option(
        20.0, "readings of the wheels per second", "HZ", gt=0, le=MAX_RATE_HZ
    )
    wheel_radius: float = option(0.31, "radius of the wheels of --wheels joint, in m", "M", gt=0)
    wheel_scale: float = option(0.0, "excess of the wheel speeds in per cent", "PERCENT", gt=-100)
    wheel_latency: float = option(
        0.0, "age of the readings of the wheels at their time stamps, in s", "S", ge=0, le=10
    )
    wheel_slip: float = option(
        0.0,
        "slip of the wheels, in per cent of speed for each m/s^2 beyond 1.2 m/s^2",
        "PERCENT",
        ge=0,
    )
    wheel_slipping: Literal["both", "left"] = option("both", "which wheels slip by --wheel-slip")
    wheel_noise: float = option(0.0, "white noise of a turning wheel in m/s, 1 sigma", "M/S", ge=0)

    @field_validator("idle")
    @classmethod
    def _sizes(cls, sizes: tuple[float, float]) -> tuple[float, float]:
        if min(sizes) < 0.0:
            raise ValueError("the size of a vibration must be 0 or more")
        return sizes

    @field_validator("ferry")
    @classmethod
    def _crossing(cls, ferry: tuple[float, float] | None) -> tuple[float, float] | None:
        if ferry is not None and not (ferry[0] >= 0.0 and ferry[1] >= SHORTEST_FERRY_S):
            raise ValueError(
                f"a ferry leaves at 0 s or later and takes at least {SHORTEST_FERRY_S:g} s"
            )
        return ferry


class Drive(Car, Vehicle):
    """A car that stands, then drives through a hilly town, with stops and turns."""

    duration: float = _duration(600.0)
    rate: float = _rate(100.0)
    latitude: float = _latitude(48.1)
    longitude: float = _longitude(11.6)
    height: float = option(560.0, "height above the ellipsoid in m", "M")
    heading: float = option(40.0, "heading at the start in degrees", "DEG")
    gnss_rate: float = _per_second(4.0, "fixes")
    still: float = option(60.0, "rest before the drive in s", "S", ge=0)


class Launch(Vehicle):
    """The flight of the alignment paper: boost, calm, glide with turns; 260 s."""

    duration: float = _duration(260.0, "length of the flight in s, after --pad")
    rate: float = _rate(200.0)
    latitude: float = _latitude(41.25)
    longitude: float = _longitude(100.3)
    height: float = option(1000.0, "height above the ellipsoid in m", "M")
    heading: float = option(63.0, "heading at the start in degrees", "DEG")
    gyro_kind: Literal["rate", "mean-rate", "increment"] = option(
        "increment", "what a gyro sample of the IMU topic is"
    )
    gnss_rate: float = _per_second(10.0, "fixes")
    gnss_model: Literal["perfect", "launch", "coloured"] = _receiver("launch")
    baro_rate: float = _per_second(0.0, "pressures")
    dynamics: float = option(1.0, "factor on the manoeuvres after the boost", "X", ge=0)
    straight: bool = option(False, "fly straight and level after the boost")
    pad: float = option(0.0, "rest before lift-off in s", "S", ge=0)
    launch_grade: Literal["0.01", "1", "10"] | None = option(
        None, "gyro bias of the alignment paper's sensors, in place of --grade", "DEG/H"
    )
    accel_unit_reading: Literal["m/s^2", "g"] = option(
        "g", "unit in which the paper's accelerometer biases are read"
    )
    gyro_range: float | None = option(None, "rate at which the gyro saturates", "DEG/S", gt=0)


class HseRig(Scenario):
    """Raw gyros, accelerometers and encoder of a skewed triad that turns at constant rates.

    The IMU topic holds the raw triad (mean rates over the interval that ends at the stamp), the
    JointState topic the table's angle, /truth/imu the true attitude of the turning body.
    """

    rate: float = _rate(500.0)
    rates: tuple[float, ...] = option(
        (20.0, 40.0, 60.0), "rates of the table, one after the other", "DEG/S,..."
    )
    plateau: float = option(604.0, "time at each rate in s", "S", gt=0, le=1e6)
    encoder_rate: float = option(500.0, "readings of the encoder per second", "HZ", gt=0, le=1e6)
    latitude: float = _latitude(28.07)
    heading: float = option(40.0, "heading of the base in degrees", "DEG")
    tilt_east: float = option(8e-4, "lean of the axis to the east in rad", "RAD")
    tilt_north: float = option(0.0, "lean of the axis to the north in rad", "RAD")
    epsilon: tuple[float, float, float] = option(
        (2.2, 0.8, 1.2), "misalignments in the user's K_g, arcsec", "E1,E2,E3"
    )
    kappa: tuple[float, float, float] = option(
        (0.0, 0.0, 0.0), "scale errors in the user's K_g, ppm", "K1,K2,K3"
    )
    xi: tuple[float, float, float] = option(
        (0.0, 0.0, 0.0), "errors of the user's C_s_to_b, arcsec", "X,Y,Z"
    )
    arw: float = option(0.0, "angular random walk, deg/sqrt(h)", "DEG/SQRT(H)", ge=0)
    gyro_bias: float = option(0.0, "standard deviation of each gyro's bias, deg/h", "DEG/H", ge=0)
    gyro_drift: float = option(
        0.0, "standard deviation of the wandering part of the bias, deg/h", "DEG/H", ge=0
    )
    gyro_quantum: float = option(0.0, "angle of one count of the gyros, arcsec", "ARCSEC", ge=0)
    accel_bias: float = option(
        0.0, "standard deviation of each accelerometer's bias, micro-g", "UG", ge=0
    )
    vrw: float = option(0.0, "noise of the accelerometers, micro-g/sqrt(Hz)", "UG/SQRT(HZ)", ge=0)
    encoder_lsb: float = option(0.0, "angle of one count of the encoder, arcsec", "ARCSEC", ge=0)
    encoder_delay: float = option(
        0.0, "age of the encoder's readings at their time stamps, microseconds", "US"
    )
    encoder_sign: Literal["1", "-1"] = option("1", "sign of the encoder's angle")
    ripple: float = option(0.0, "relative variation of the table's rate, once a turn", "X")
    base_drift: tuple[float, float, float] = option(
        (0.0, 0.0, 0.0), "rotation of the base over the whole log, arcsec", "N,E,D"
    )

    def check(self) -> None:
        """Require an axis that is nearly vertical."""
        if not math.hypot(self.tilt_north, self.tilt_east) < LARGEST_LEAN:
            raise ConfigurationError(
                f"the axis leans by {LARGEST_LEAN} rad or more",
                "reduce --tilt-north and --tilt-east",
            )


SCENARIOS: dict[str, type[Scenario]] = {
    "coning": Coning,
    "coning-paper": ConingPaper,
    "static": Static,
    "two-frequency": TwoFrequency,
    "broadband": Broadband,
    "manoeuvre": Manoeuvre,
    "spiral-climb": SpiralClimb,
    "manoeuvring-flight": ManoeuvringFlight,
    "drive": Drive,
    "launch": Launch,
    "hse-rig": HseRig,
}
