"""Options of the computation: attitude only, or navigation with filter and height."""

from __future__ import annotations

from typing import Literal

from pydantic import field_validator

from sinstool.core.errors import ConfigurationError
from sinstool.core.options import Group, option, span


class NavigationOptions(Group):
    """Options of the computation and of the sensor models."""

    title = "What to compute"

    mode: Literal["auto", "attitude", "ins", "ins-gnss"] = option(
        "auto",
        "what is computed: attitude only, or attitude, velocity and position from inertial data"
        " alone (ins) or with GNSS (ins-gnss); auto: ins-gnss where the log has fixes, otherwise"
        " attitude",
        brief="attitude, ins, ins-gnss, or auto: what the log allows",
    )
    attitude: Literal["auto", "smoothed", "inertial"] = option(
        "auto",
        "kind of attitude in --mode attitude. smoothed: gravity corrects roll and pitch over the"
        " whole log, with sigmas. inertial: integrated rates only. auto: inertial for a"
        " navigation-grade IMU whose heading is known, or with --coning, otherwise smoothed",
        brief="smoothed (by gravity), inertial, or auto",
    )
    motion: Literal["auto", "hand", "vehicle"] = option(
        "auto",
        "motion assumed by a smoothed attitude. hand: stays within about a metre. vehicle (car,"
        " ship, aircraft): goes anywhere at a bounded speed. auto: whichever fits the"
        " accelerations better",
    )
    magnetometer: str | None = option(
        None,
        "topic with MagneticField messages, which give a smoothed attitude its heading, or none"
        " (default: the only one in the log or the one beside the IMU, unless heading already"
        " refers to north)",
        "TOPIC",
        brief="topic with the magnetic field, or none",
    )
    declination: float | None = option(
        None,
        "magnetic declination in degrees, positive east (default: from the World Magnetic Model"
        " where position and date are known)",
        "DEG",
        ge=-180,
        le=180,
    )
    initial_velocity: tuple[float, float, float] | None = option(
        None,
        "velocity at the start of --mode ins, in m/s (default: GNSS velocity, otherwise zero)",
        "N,E,D",
    )
    imu_grade: Literal["auto", "consumer", "mems", "industrial", "tactical", "navigation"] = option(
        "auto",
        "grade of the sensors, which sets their noise where no figure is given; auto: judged by"
        " the noise of the gyro at rest, or in motion where the log has GNSS and that noise is of a"
        " better grade",
        brief="consumer, mems, industrial, tactical, navigation or auto",
    )
    imu_noise: str | None = option(
        None,
        "noise file of this IMU, as sinstool allan writes it, in place of a grade's noise; the"
        " grade still says what no rest shows, such as scale factors",
        "FILE",
        brief="noise file from sinstool allan, in place of a grade's",
    )
    attitude_order: Literal["exact", "1", "2", "3", "4"] = option(
        "exact", "quaternion update of --mode ins: exact, or Picard's approximation of this order"
    )

    def check(self) -> None:
        """Noise is measured or that of a grade, not both."""
        if self.imu_noise is not None and self.imu_grade != "auto":
            raise ConfigurationError(
                f"--imu-noise and --imu-grade {self.imu_grade} both say how noisy the IMU is",
                "leave one of them out",
            )


class HeightOptions(Group):
    """The vertical channel and its damping."""

    title = "Height"

    height_damping: Literal["off", "baro", "gnss"] = option(
        "off",
        "third-order network that ties inertial height to the barometer or to GNSS heights",
        brief="tie height to baro or gnss, or off",
    )
    height_preset: Literal["recommended", "paper"] = option(
        "recommended",
        "recommended: tau = 5 s (consumer, mems), 10 s (industrial), 30 s (tactical) or 100 s"
        " (navigation) by --imu-grade, K4 = 0; paper: tau = 2.4 s, K4 = 0.5 s",
    )
    tau: float | None = option(
        None, "time constant of the network in s, in place of the preset's", "S", gt=0, le=3000
    )
    k4: float | None = option(
        None, "gain of vertical velocity in s, |K4| < tau, in place of the preset's", "S"
    )
    baro_lag: float = option(0.0, "first-order lag of the barometer in s", "S", ge=0, le=60)
    baro_ref: Literal["auto", "gnss", "init"] = option(
        "auto",
        "height that the barometer is set to: GNSS heights over its first 30 s, or the height at"
        " the start (init); auto: GNSS where there is any",
    )
    qnh: float | None = option(
        None, "altimeter setting in Pa, in place of --baro-ref", "PA", ge=8e4, le=1.1e5
    )
    undulation: float = option(
        0.0,
        "height of mean sea level above the ellipsoid in m, with --qnh",
        "M",
        ge=-120,
        le=100,
    )

    def check(self) -> None:
        """K4 and the lag leave the network stable."""
        if self.tau is not None and self.k4 is not None and not abs(self.k4) < self.tau:
            raise ConfigurationError(
                f"--k4 {self.k4:g} is not below --tau {self.tau:g} in size",
                "the network is stable for -tau < K4 < tau; 0 is recommended",
            )
        if self.height_damping == "off":
            unused = [
                f"--{name}" for name in ("tau", "k4", "qnh") if getattr(self, name) is not None
            ]
            if unused:
                raise ConfigurationError(
                    f"{unused[0]} is given, but --height-damping is off",
                    "add --height-damping baro or leave it out",
                )


class FilterOptions(Group):
    """The INS/GNSS filter and its smoother."""

    title = "INS/GNSS filter"

    filter: Literal["network-29a", "network-26a", "network-26", "baro-24", "plain-15"] = option(
        "network-29a",
        "states of the filter. network-29a: the damping network's states and corrections, and gyro"
        " scale factors. network-26a: the same without scale factors. network-26: the published 26"
        " states. baro-24: undamped, with the barometer as a measurement. plain-15: no barometer"
        " and no correlated GNSS errors",
        "NAME",
    )
    feedback: Literal["closed", "none"] = option(
        "closed", "whether the filter's estimates correct the navigation and the sensors"
    )
    virtual_noise: Literal["auto", "on", "off"] = option(
        "auto",
        "extra process noise that allows for errors of the model; auto: for the grades consumer and"
        " mems, unless their noise was measured or the drift without fixes shows better sensors",
    )
    adaptive: Literal["off", "sage-husa", "innovation"] = option(
        "off", "adapt the measurement noise to the innovations"
    )
    schmidt_epsilon: float = option(
        0.0, "overweighting of the newest measurement (Schmidt)", "X", ge=0, le=1
    )
    restart_after: float = option(
        30.0,
        "restart the filter when it has rejected every fix for this many seconds",
        "S",
        gt=0,
    )
    smooth: bool = option(
        False,
        "smooth the INS/GNSS solution over the whole log (Rauch-Tung-Striebel)",
        brief="smooth the INS/GNSS solution over the whole log",
    )
    withhold_gnss: tuple[str, ...] = option(
        (),
        "do not use the fixes of this span (seconds from the log's start) but compare the result"
        " with them; repeatable",
        "START:END",
        brief="compare with these fixes, do not use them",
    )
    gnss_sigma: float | None = option(
        None,
        "position noise in m per horizontal axis, where the log gives none (default: 5.4; vertical"
        " is 1.6 times that)",
        "M",
        gt=0,
    )
    gnss_noise_scale: float = option(1.0, "factor on the noise that the receiver states", "X", gt=0)
    gnss_lasting: float | None = option(
        None,
        "fraction of the position noise that is correlated over minutes, 0 to 0.99; the rest is"
        " white (default: estimated from the fixes)",
        "SHARE",
        ge=0,
        le=0.99,
    )

    vehicle: Literal["auto", "land", "none"] = option(
        "auto",
        "constraints on the motion. land: a wheeled vehicle, which stays put at rest and whose axle"
        " moves neither sideways nor vertically. none: no constraints. auto: those that the log"
        " confirms",
        brief="constraints: land (on wheels), none or auto",
    )
    mount: tuple[float, float, float] | None = option(
        None,
        "attitude of the IMU in the land vehicle in degrees; pitch and yaw are refined from the"
        " motion (default: by the transforms of /tf_static where the motion agrees with them, else"
        " estimated from the motion)",
        "ROLL,PITCH,YAW",
    )
    sigma_misalignment: float | None = option(
        None,
        "misalignment of the gyros and of the accelerometers in mrad, 1 sigma of each of the six"
        " angles of each triad, in place of the grade's; 0: the axes are exact",
        "MRAD",
        ge=0,
        le=1e3,
    )
    baro_sigma: float | None = option(
        None, "slowly varying error of the barometer in m, 1 sigma (default: 10)", "M", gt=0
    )
    gnss_velocity_lag: float | None = option(
        None,
        "delay of the receiver's velocities against its positions in s (default: estimated from"
        " the fixes); --gnss-latency is then the mean of both",
        "S",
        ge=-1,
        le=1,
    )

    def check(self) -> None:
        """Constraints of a vehicle need a filter that corrects what it navigates by."""
        if self.vehicle == "land" and self.feedback == "none":
            raise ConfigurationError(
                "--vehicle land with --feedback none: a vehicle can only be held not to slide by"
                " a filter that corrects its attitude",
                "leave one of them out",
            )
        if self.vehicle == "none" and self.mount is not None:
            raise ConfigurationError(
                "--mount is given, but --vehicle is none",
                "add --vehicle land, or leave --mount out",
            )

    @field_validator("withhold_gnss")
    @classmethod
    def _spans(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for text in value:
            span(text)
        return value
