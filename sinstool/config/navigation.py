"""What is computed: attitude alone, or navigation with its vertical channel and its filter."""

from __future__ import annotations

from typing import Literal

from pydantic import field_validator

from sinstool.core.errors import ConfigurationError
from sinstool.core.options import Group, option, span


class NavigationOptions(Group):
    """What is computed, and from where it starts."""

    mode: Literal["auto", "attitude", "ins", "ins-gnss"] = option(
        "auto",
        "what is computed: attitude; or attitude, velocity and position, from inertial"
        " data alone (ins) or with GNSS (ins-gnss); auto is ins-gnss where the log has fixes and"
        " velocity, else attitude",
    )
    attitude: Literal["auto", "smoothed", "inertial"] = option(
        "auto",
        "of --mode attitude: smoothed, its roll and pitch held to gravity over the whole log, with"
        " sigmas; or inertial, the integrated rates alone; auto is inertial for a navigation-grade"
        " IMU and where --coning chooses an algorithm, else smoothed",
    )
    motion: Literal["auto", "hand", "vehicle"] = option(
        "auto",
        "what a smoothed attitude takes the motion for: hand, which stays within about a metre, or"
        " vehicle (car, ship, aircraft), which goes anywhere at a bounded speed; auto takes what"
        " fits the accelerations better",
    )
    magnetometer: str | None = option(
        None,
        "topic with MagneticField messages that show a smoothed attitude its heading, or none"
        " (default: the log's only one, or that beside the Imu, unless heading counts from north"
        " already)",
        "TOPIC",
    )
    declination: float | None = option(
        None,
        "of the magnetic field, degrees east of true north (default: by the World Magnetic Model"
        " where position and date are known)",
        "DEG",
        ge=-180,
        le=180,
    )
    initial_velocity: tuple[float, float, float] | None = option(
        None,
        "north, east, down in m/s at the start (default: GNSS velocity, else at rest)",
        "N,E,D",
    )
    imu_grade: Literal["auto", "mems", "industrial", "tactical", "navigation"] = option(
        "auto",
        "of the sensors, where the configuration gives no noise; auto judges by the"
        " gyro's noise at rest",
    )
    attitude_order: Literal["exact", "1", "2", "3", "4"] = option(
        "exact", "quaternion of an update in ins: exact, or Picard's approximation of an order"
    )


class HeightOptions(Group):
    """The vertical channel and what damps it."""

    height_damping: Literal["off", "baro", "gnss"] = option(
        "off", "third-order network that holds height to the barometer or to GNSS heights"
    )
    height_preset: Literal["recommended", "paper"] = option(
        "recommended",
        "recommended: tau 5, 30 or 100 s by --imu-grade, K4 = 0; paper: tau 2.4 s, K4 = 0.5",
    )
    tau: float | None = option(
        None, "time constant in seconds, instead of the preset's", "S", gt=0, le=3000
    )
    k4: float | None = option(
        None, "gain of vertical velocity in s, |K4| < tau, instead of the preset's", "S"
    )
    baro_lag: float = option(
        0.0, "known first-order lag of the barometer in seconds", "S", ge=0, le=60
    )
    baro_ref: Literal["auto", "gnss", "init"] = option(
        "auto",
        "what the barometer is set by: GNSS heights of its first 30 s, or the height at"
        " the start; auto takes GNSS where there is any",
    )
    qnh: float | None = option(
        None, "altimeter setting in Pa, instead of --baro-ref", "PA", ge=8e4, le=1.1e5
    )
    undulation: float = option(
        0.0,
        "height of mean sea level above the ellipsoid in metres, with --qnh",
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

    filter: Literal["network-29a", "network-26a", "network-26", "baro-24", "plain-15"] = option(
        "network-29a",
        "network-29a: damped height, its network's states and what it corrects in the"
        " filter, and the gyros' scale factors; network-26a: without these; network-26: the"
        " published 26 states; baro-24: undamped, the barometer a measurement; plain-15: no"
        " states for correlated GNSS errors",
    )
    feedback: Literal["closed", "none"] = option(
        "closed", "whether the filter corrects the navigation and the sensors"
    )
    virtual_noise: Literal["auto", "on", "off"] = option(
        "auto",
        "fictitious process noise, against errors of the model; auto: for a MEMS IMU, whose"
        " errors no model describes, and not where biases stay as the grade says",
    )
    adaptive: Literal["off", "sage-husa", "innovation"] = option(
        "off", "measurement noise from the innovations"
    )
    schmidt_epsilon: float = option(
        0.0, "weight of the newest measurement beyond its due", "X", ge=0, le=1
    )
    restart_after: float = option(
        30.0,
        "seconds of fixes that the gate rejects, one after the other, before the filter begins"
        " anew",
        gt=0,
    )
    smooth: bool = option(False, "smooth over the whole log (Rauch, Tung, Striebel)")
    withhold_gnss: tuple[str, ...] = option(
        (),
        "START:END in seconds from the log's start: fixes there are scored, not used; repeatable",
        "START:END",
    )
    gnss_sigma: float | None = option(
        None,
        "position noise in m per horizontal axis where the log gives none (default:"
        " 5; vertical is 1.6 times that)",
        "M",
        gt=0,
    )
    gnss_noise_scale: float = option(
        1.0, "factor on what receivers say of their own noise", "X", gt=0
    )
    gnss_lasting: float | None = option(
        None,
        "share of the positions' sigma that lasts for minutes, 0 to 0.99, the rest being white"
        " (default: found from how the fixes change)",
        "SHARE",
        ge=0,
        le=0.99,
    )

    vehicle: Literal["auto", "land", "none"] = option(
        "auto",
        "what the vehicle cannot do: land: it rests where it stands, and its axle slides neither"
        " sideways nor up; none: nothing is assumed; auto: as far as the log shows it",
    )
    mount: tuple[float, float, float] | None = option(
        None,
        "attitude of the IMU in the land vehicle in degrees, about which its pitch and yaw are"
        " estimated (default: found from the motion)",
        "ROLL,PITCH,YAW",
    )
    baro_sigma: float | None = option(
        None, "what the barometer is off by for minutes, in m (default: 10)", gt=0
    )
    gnss_velocity_lag: float | None = option(
        None,
        "seconds by which a receiver stamps velocities later than positions (default:"
        " found from the fixes); --gnss-latency is then the mean of both",
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
