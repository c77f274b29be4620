"""The parts of a result of `process`: input, methods and results."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from sinstool.core.finding import Finding
from sinstool.core.result import compass
from sinstool.core.rotation import to_euler
from sinstool.core.streams import Solution
from sinstool.core.units import DEGREE
from sinstool.methods.alignment.initial import Alignment
from sinstool.methods.coning.algorithm import ConingAlgorithm, of_rates
from sinstool.methods.ins_gnss.withheld import WithheldScore
from sinstool.pipelines.process.travel import Outages
from sinstool.survey.grade import ImuGrade

if TYPE_CHECKING:
    from sinstool.methods.ins_gnss.results import FilterEvent, GnssDiagnostics
    from sinstool.pipelines.process.vehicle_used import VehicleUsed


@dataclass(frozen=True)
class FilterCourse:
    """Innovations, biases and events of a filter over time, for figures.

    Attributes
    ----------
    first_ns : int
        Time of the log's first sample.
    gnss : GnssDiagnostics
        At every epoch.
    bias_ns : ndarray of int64, shape (n,)
        Ends of the blocks after which the biases were noted.
    gyro_bias, accel_bias : ndarray, shape (n, 3)
        rad/s and m/s^2.
    """

    first_ns: int
    gnss: GnssDiagnostics
    bias_ns: np.ndarray
    gyro_bias: np.ndarray
    accel_bias: np.ndarray
    events: list[FilterEvent]


class Sink(Protocol):
    """Receives a run's solutions and references, for figures and statistics."""

    def push(self, solution: Solution) -> None:
        """Take the next solutions, in the order of time."""

    def refer_height(self, name: str, time_ns: np.ndarray, height: np.ndarray) -> None:
        """Take the heights (m) that the run is held to."""

    def refer_track(self, latitude: np.ndarray, longitude: np.ndarray) -> None:
        """Take the fixes (rad); NaN where one has no position."""

    def free_heading(self) -> None:
        """Take note that nothing refers headings to north."""

    def refer_filter(self, course: FilterCourse) -> None:
        """Take a filter's innovations and biases, at its end."""


@dataclass(frozen=True)
class InputFile:
    """The log that was read."""

    path: str
    size: int
    sha256: str


@dataclass(frozen=True)
class Place:
    """A place on the Earth; its height is above the ellipsoid."""

    latitude_deg: float
    longitude_deg: float
    height_m: float

    @classmethod
    def of(cls, position: tuple[float, float, float]) -> Place:
        """From latitude and longitude in rad, and height in m."""
        return cls(position[0] / DEGREE, position[1] / DEGREE, position[2])


@dataclass(frozen=True)
class OutputFile:
    """The MCAP that was written, if any: its result topics, and the frame of their attitudes.

    Positions in that frame count from ``origin``; None where there are none.
    """

    path: str | None
    topics: tuple[str, ...]
    attitudes: int
    frame: str
    origin: Place | None


@dataclass(frozen=True)
class FirstAttitude:
    """The attitude that a run starts from, and the gyro bias; sigmas are None where unknown."""

    method: str
    how: str
    time_ns: int
    roll_deg: float
    pitch_deg: float
    heading_deg: float
    sigma_deg: tuple[float | None, ...]
    status: str
    north_referenced: bool
    gyro_bias_rad_s: tuple[float, ...]
    gyro_bias_source: str

    @classmethod
    def of(cls, a: Alignment, how: str) -> FirstAttitude:
        """From an alignment."""
        roll, pitch, heading = to_euler(a.q_nb) / DEGREE
        return cls(
            method=a.method,
            how=how,
            time_ns=a.time_ns,
            roll_deg=float(roll),
            pitch_deg=float(pitch),
            heading_deg=compass(float(heading)),
            sigma_deg=tuple(None if s is None else s / DEGREE for s in a.sigma_rad),
            status=a.status,
            north_referenced=a.north_referenced,
            gyro_bias_rad_s=tuple(a.gyro_bias.tolist()),
            gyro_bias_source=a.bias_source,
        )


@dataclass(frozen=True)
class ConingUsed:
    """The coning algorithm, in the form for the kind of sample that the log has."""

    algorithm: str
    summary: str
    samples_per_update: int
    gyro_kind: str
    takes: str
    updates: int
    source: str

    @classmethod
    def of(cls, algorithm: ConingAlgorithm, gyro_kind: str, updates: int) -> ConingUsed:
        """From an algorithm and the kind of its samples."""
        form = algorithm.for_kind(of_rates(gyro_kind))
        return cls(
            algorithm=form.name,
            summary=form.summary,
            samples_per_update=form.samples,
            gyro_kind=gyro_kind,
            takes=form.takes,
            updates=updates,
            source=form.source,
        )


# The sigma of a heading that may be any is 104 deg.
UNKNOWN_HEADING_DEG = 100.0


@dataclass(frozen=True)
class MagnetometerUsed:
    """How a magnetometer was used, and the field it measured.

    Attributes
    ----------
    refused : str
        Why it is not used; '' where it is.
    north : str
        What heading counts from: ``true``, ``magnetic``, or ``none`` where it is refused or the
        log cannot show what iron in the body adds to the field.
    declination_deg : float or None
        East of north; None where it is not known.
    declination_source : str
        ``given``, ``model`` or '' where it is not known.
    field_T, dip_deg : float
        Of what was taken for the Earth's field; downwards is positive.
    trusted : float
        Share of the time with a field in which it was the Earth's.
    scatter_deg : float
        Of headings against the gyros'.
    hard_iron_T : tuple of float or None
        FRD; None where nothing could be found.
    hard_iron_sigma_T : float or None
        Of its part that turns headings.
    heading_sigma_deg : float or None
        Median; None where it is refused.
    """

    topic: str
    refused: str
    north: str
    declination_deg: float | None
    declination_source: str
    field_T: float
    dip_deg: float
    trusted: float
    scatter_deg: float
    hard_iron_T: tuple[float, ...] | None
    hard_iron_removed: bool
    hard_iron_sigma_T: float | None
    heading_sigma_deg: float | None


@dataclass(frozen=True)
class AttitudeSmoothing:
    """How an attitude was smoothed, and its sigmas.

    Attributes
    ----------
    motion : {'hand', 'vehicle'}
        What was assumed to be bounded.
    motion_margin_nat : float or None
        By how much an epoch a vehicle was more likely than a hand; None where it was configured.
    tilt_sigma_deg, tilt_sigma_largest_deg : float
        Of roll and pitch: the median over the log and the largest.
    heading_sigma_end_deg : float
        Of the last heading: since the start, unless heading is referenced to north.
    accel_bias_m_s2 : tuple of float or None
        Of the accelerometers, FRD; None where the motion does not show it.
    accel_bias_sigma_m_s2 : float
        Biases of the accelerometers that the sigmas of tilt allow for: those left of a vehicle's.
    gyro_bias_rad_s, gyro_bias_sigma_rad_s : tuple of float
        At the end, FRD.
    """

    motion: str
    motion_margin_nat: float | None
    acceleration_density_m_s2_sqrt_hz: float
    rest_s: float
    gyro_at_stop_s: float
    tilt_sigma_deg: float
    tilt_sigma_largest_deg: float
    heading_sigma_end_deg: float
    accel_bias_m_s2: tuple[float, ...] | None
    accel_bias_sigma_m_s2: float
    gyro_bias_rad_s: tuple[float, ...]
    gyro_bias_sigma_rad_s: tuple[float, ...]
    magnetometer: MagnetometerUsed | None = None

    @property
    def heading_lost(self) -> bool:
        """Whether the last heading may be any."""
        return self.heading_sigma_end_deg > UNKNOWN_HEADING_DEG


@dataclass(frozen=True)
class BarometerSetting:
    """Reference of the barometer."""

    mode: str
    offset_m: float
    scale: float


@dataclass(frozen=True)
class HeightEvent:
    """Something that happened to the vertical channel; the size's unit depends on the kind."""

    kind: str
    time_ns: int
    size: float
    duration_s: float


@dataclass(frozen=True)
class FinalHeight:
    """The vertical channel at the end."""

    height_m: float
    velocity_up_m_s: float
    accelerometer_correction_m_s2: float


@dataclass(frozen=True)
class HeightDamping:
    """Damping of the height: its source, its settings, and its events."""

    damping: str
    topic: str
    tau_s: float
    k4_s: float
    gains: tuple[float, ...]
    reference: BarometerSetting | None
    samples: dict[str, int]
    seconds: dict[str, float]
    phase: str
    difference_rms_m: float
    offset_m: float
    final: FinalHeight
    events: tuple[HeightEvent, ...]
    imu_grade: ImuGrade


@dataclass(frozen=True)
class FilterStartTime:
    """Time and method of a filter's start."""

    time_ns: int
    how: str


@dataclass(frozen=True)
class LatencyUsed:
    """Latency of the fixes, in the middle of the log if it changes, and how it was determined."""

    status: str
    sigma_s: float | None
    estimate_s: float | None
    position_s: float
    velocity_s: float
    clock_ppm: float = 0.0


@dataclass(frozen=True)
class WithheldScores(WithheldScore):
    """Errors of a solution at withheld fixes; beside a smoother's those of its filter."""

    filter: WithheldScore | None = None


@dataclass(frozen=True)
class FilterUsed:
    """An INS/GNSS filter: its kind, its inputs, and its last estimates."""

    filter: str
    requested: str
    states: int
    smoothed: bool
    feedback: str
    start: FilterStartTime
    imu_grade: ImuGrade
    gnss_noise: str
    gnss_latency_s: float
    gnss_latency: LatencyUsed
    lever_arm_m: tuple[float, ...]
    updates: int
    epochs_used: int
    epochs_gated: int
    epochs_before_start: int
    restarts: int
    mean_nis: float
    gyro_bias_rad_s: tuple[float, ...]
    accel_bias_m_s2: tuple[float, ...]
    accel_scale: np.ndarray
    gyro_scale: np.ndarray
    gyro_misalignment: np.ndarray | None
    accel_misalignment: np.ndarray | None
    baro_bias_m: float
    vehicle: VehicleUsed
    events: dict[str, int]
    outages: Outages
    withheld: WithheldScores | None


@dataclass(frozen=True)
class TurntableStretch:
    """A stretch at constant rate: its heading as aligned, the correction, and the result."""

    start_ns: int
    duration_s: float
    turns: int
    rate_deg_s: float
    C23_rad: float
    heading_raw_deg: float
    correction_arcsec: float
    sigma_correction_arcsec: float | None
    heading_deg: float
    sigma_heading_arcsec: float | None
    outside_rate: bool
    outside_C23: bool


@dataclass(frozen=True)
class UnusedStretch:
    """A stretch that could not be aligned on, and why."""

    start_s: float
    duration_s: float
    rate_deg_s: float
    reason: str


@dataclass(frozen=True)
class HseCorrection:
    """The heading-sensitive error that was removed, stretch by stretch."""

    file: str | None
    status: str
    lambda2_arcsec: float | None
    sigma_lambda2_arcsec: float | None
    segments: tuple[TurntableStretch, ...]
    not_used: tuple[UnusedStretch, ...]


@dataclass(frozen=True)
class GnssDifference:
    """Position less that of the last fix; up is None where the fix has no height."""

    time_ns: int
    north_m: float
    east_m: float
    up_m: float | None


@dataclass(frozen=True)
class FinalState:
    """The last attitude, and the last position where there is one."""

    time_ns: int
    q_wxyz_ned_frd: tuple[float, ...]
    roll_deg: float
    pitch_deg: float
    heading_deg: float
    lat_deg: float | None
    lon_deg: float | None
    height_m: float | None

    @classmethod
    def of(
        cls, last: Solution, position: tuple[float | None, float | None, float | None]
    ) -> FinalState:
        """From the last block of a run; without positions there, with another position (deg, m)."""
        roll, pitch, heading = to_euler(last.q_nb[-1]) / DEGREE
        latitude, longitude, height = position
        if last.position is not None:
            latitude, longitude = (float(v) for v in last.position[-1, :2] / DEGREE)
            height = float(last.position[-1, 2])
        return cls(
            time_ns=int(last.time_ns[-1]),
            q_wxyz_ned_frd=tuple(last.q_nb[-1].tolist()),
            roll_deg=float(roll),
            pitch_deg=float(pitch),
            heading_deg=compass(float(heading)),
            lat_deg=latitude,
            lon_deg=longitude,
            height_m=height,
        )


@dataclass(frozen=True)
class ModeResult:
    """Part of a result that depends on the mode, by the names of its fields."""

    alignment: FirstAttitude
    coning: ConingUsed
    findings: tuple[Finding, ...]
    smoothing: AttitudeSmoothing | None = None
    height: HeightDamping | None = None
    filter: FilterUsed | None = None
    gnss_difference: GnssDifference | None = None
