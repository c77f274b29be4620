"""Result of `allan`: the values of ``--json``, the terminal, the page and the files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from sinstool.config.noise import KEYS, key_of
from sinstool.core.finding import Finding
from sinstool.core.result import Result, as_json
from sinstool.methods.allan.coefficients import (
    SENSORS,
    Coefficient,
    ImuNoise,
    Sensor,
    over_axes,
)
from sinstool.pipelines.log_used import ImuTime, LogFile

Status = Literal["measured", "dead", "clipped", "too-short"]


@dataclass(frozen=True)
class RestStretch:
    """A stretch of rest whose samples were used.

    Attributes
    ----------
    start_s, duration_s : float
        From the first sample, and its length.
    """

    start_s: float
    duration_s: float


@dataclass(frozen=True)
class Rest:
    """The rest in which noise was measured.

    Attributes
    ----------
    samples : int
        Number of samples used.
    interval_s : float
        Between samples.
    total_s, longest_s : float
        Of all stretches, and of the longest one without a gap.
    shaken_s, moving_s : float
        Time left out of still spans, as it is louder than the rest of them, or as GNSS moves.
    sway_rad_s : float
        RMS rate at which the sensor turns at rest, as gravity shows; 0 if it shows none.
    stretches : tuple of RestStretch
        In order of time.
    """

    samples: int
    interval_s: float
    total_s: float
    longest_s: float
    shaken_s: float
    moving_s: float
    sway_rad_s: float
    stretches: tuple[RestStretch, ...]


@dataclass(frozen=True)
class Axis:
    """One axis of one sensor.

    Attributes
    ----------
    status : {'measured', 'dead', 'clipped', 'too-short'}
        Only of the first are there coefficients.
    coefficients : mapping of str to Coefficient
        By the names of the terms, in SI units.
    from_s : float
        The shortest averaging time that the terms describe.
    misfit : float
        By how much the data scatters more than the terms allow, as a variance; 1: not more.
    deviation, hadamard : ndarray, shape (k,)
        Allan and Hadamard deviation at the averaging times, rad/s or m/s^2; NaN where there is
        none.
    """

    sensor: Sensor
    axis: str
    status: Status
    coefficients: Mapping[str, Coefficient]
    from_s: float
    misfit: float
    deviation: np.ndarray
    hadamard: np.ndarray

    @property
    def name(self) -> str:
        """Sensor and axis in words."""
        return f"{'gyro' if self.sensor == 'gyro' else 'accelerometer'} {self.axis}"

    def to_json(self) -> dict[str, Any]:
        """Its values, each coefficient with its unit in the key."""
        coefficients = {
            key_of(self.sensor, term): as_json(value) for term, value in self.coefficients.items()
        }
        return {
            "status": self.status,
            **coefficients,
            "from_s": as_json(self.from_s),
            "misfit": as_json(self.misfit),
            "deviation": as_json(self.deviation),
            "hadamard": as_json(self.hadamard),
        }


@dataclass(frozen=True)
class AllanResult(Result):
    """Noise of an IMU at rest.

    Attributes
    ----------
    input : LogFile
        The log.
    imu : ImuTime
        Samples of the IMU.
    rest : Rest
        The time at rest.
    averaging_s : ndarray, shape (k,)
        Averaging times of the deviations.
    terms : ndarray of int64, shape (k,)
        Number of differences in each Allan deviation.
    axes : tuple of Axis
        Of gyros and accelerometers.
    findings : tuple of Finding
        About the log and its noise.
    output : str or None
        The file that was written.
    """

    SCHEMA: ClassVar[str] = "sinstool.allan/1"
    input: LogFile
    imu: ImuTime
    rest: Rest
    averaging_s: np.ndarray
    terms: np.ndarray
    axes: tuple[Axis, ...]
    findings: tuple[Finding, ...]
    output: str | None = None

    def of(self, sensor: Sensor) -> tuple[Axis, ...]:
        """The axes of a sensor."""
        return tuple(axis for axis in self.axes if axis.sensor == sensor)

    @property
    def noise(self) -> ImuNoise:
        """The measured noise, as stored in files."""
        of = {
            sensor: {a.axis: a.coefficients for a in self.of(sensor) if a.status == "measured"}
            for sensor in SENSORS
        }
        return ImuNoise(of["gyro"], of["accel"], 1.0 / self.rest.interval_s)

    def to_json(self) -> dict[str, Any]:
        """The values of ``--json``."""
        values = as_json({k: v for k, v in vars(self).items() if k != "axes"})
        sensors: dict[Sensor, dict[str, Any]] = {
            sensor: {axis.axis: axis.to_json() for axis in self.of(sensor)} for sensor in SENSORS
        }
        for sensor in SENSORS:
            sensors[sensor]["over_axes"] = self._over_axes(sensor)
        return {"schema": self.SCHEMA, **values, **sensors, "warnings": list(self.warnings)}

    def _over_axes(self, sensor: Sensor) -> dict[str, Any] | None:
        """One figure for all axes of each term, by its key."""
        figures = {
            key_of(sensor, term): over_axes(self.noise.of(sensor), term) for term in KEYS[sensor]
        }
        return as_json(figures) if any(figures.values()) else None
