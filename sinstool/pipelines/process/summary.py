"""The parts of a result of `process` that all modes have, and how an attitude was smoothed."""

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

if TYPE_CHECKING:
    from sinstool.methods.ins_gnss.results import FilterEvent, GnssDiagnostics
    from sinstool.pipelines.process.filter_used import FilterUsed
    from sinstool.pipelines.process.height_used import HeightDamping


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
    """The log that was read.

    Attributes
    ----------
    path : str
        Of the log, as given.
    size : int
        Of the file or bag, bytes.
    sha256 : str
        Of the file; of a bag that of its list of files, see the page on formats.
    """

    path: str
    size: int
    sha256: str


@dataclass(frozen=True)
class Place:
    """A place on the Earth.

    Attributes
    ----------
    latitude_deg, longitude_deg : float
        WGS 84.
    height_m : float
        Above the ellipsoid.
    """

    latitude_deg: float
    longitude_deg: float
    height_m: float

    @classmethod
    def of(cls, position: tuple[float, float, float]) -> Place:
        """From latitude and longitude in rad, and height in m."""
        return cls(position[0] / DEGREE, position[1] / DEGREE, position[2])


@dataclass(frozen=True)
class OutputFile:
    """The MCAP that was written, if any.

    Attributes
    ----------
    path : str or None
        None if nothing was written.
    topics : tuple of str
        The topics with results.
    attitudes : int
        Number of attitudes written.
    frame : str
        World frame of the attitudes: ``map`` or ``odom``, with ``_ned`` for NED.
    origin : Place or None
        Origin of positions in that frame; None if the mode computes none.
    """

    path: str | None
    topics: tuple[str, ...]
    attitudes: int
    frame: str
    origin: Place | None


@dataclass(frozen=True)
class FirstAttitude:
    """The attitude that a run starts from, and the gyro bias.

    Attributes
    ----------
    method : str
        As in ``plan.first_attitude``, or ``filter-start``.
    how : str
        Source of the attitude, in words.
    time_ns : int
        When it holds.
    roll_deg, pitch_deg, heading_deg : float
        Forward-Right-Down axes of the IMU in North-East-Down.
    sigma_deg : tuple of float or None
        Of small rotations about north, east, down; None if unknown.
    status : str
        ``ok``, ``degraded`` or ``level-only``.
    north_referenced : bool
        Whether heading counts from true north.
    gyro_bias_rad_s : tuple of float
        Gyro bias at the start, removed from the rates, FRD.
    gyro_bias_source : str
        ``start`` (of a filter), ``alignment``, ``rest`` (the longest one), ``still`` (the rest at
        the beginning), ``given``, ``rig`` or ``none``.
    """

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
    """The coning algorithm, in the form for the kind of sample that the log has.

    Attributes
    ----------
    algorithm : str
        Its name, with the number of samples if it has one.
    summary : str
        What it does, in words.
    samples_per_update : int
        Gyro samples in one update of the attitude.
    gyro_kind : str
        What a sample was taken to be: ``rate``, ``mean-rate`` or ``increment``.
    takes : str
        ``increments`` or ``rates``.
    updates : int
        Updates of the attitude.
    source : str
        Publication of the algorithm.
    """

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
    topic : str
        Its topic.
    refused : str
        Reason why it is not used; '' if it is.
    north : str
        What heading counts from: ``true``, ``magnetic``, or ``none`` if it is refused or the log
        cannot show what iron in the body adds to the field.
    declination_deg : float or None
        Positive east; None if it is not known.
    declination_source : str
        ``given``, ``model``, or '' if it is not known.
    field_T, dip_deg : float
        Strength and dip, positive down, of what was taken for the Earth's field.
    trusted : float
        Share of the time in which the field was the Earth's.
    scatter_deg : float
        Scatter of its headings about those of the gyros.
    hard_iron_T : tuple of float or None
        Field of iron in the body, FRD; None if it is not observable.
    hard_iron_removed : bool
        Whether it was subtracted.
    hard_iron_sigma_T : float or None
        Of its part that turns headings.
    heading_sigma_deg : float or None
        Median sigma of heading; None if the magnetometer is refused.
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
        The assumed motion.
    motion_margin_nat : float or None
        By how many nat per epoch a vehicle was likelier than a hand; None if it was not compared.
    acceleration_density_m_s2_sqrt_hz : float
        Density of the accelerations of the motion, as fitted to the log.
    rest_s : float
        Time at rest.
    gyro_at_stop_s : float
        Time in which a gyro is saturated.
    tilt_sigma_deg, tilt_sigma_largest_deg : float
        Sigma of roll and pitch: median over the log, and largest.
    heading_sigma_end_deg : float
        Of the last heading: since the start, unless heading is referenced to north.
    accel_bias_m_s2 : tuple of float or None
        Estimated bias of the accelerometers, FRD; None if it is not observable.
    accel_bias_sigma_m_s2 : float
        Bias of the accelerometers that the sigmas of tilt allow for: for a vehicle, what is left
        after the estimate.
    gyro_bias_rad_s, gyro_bias_sigma_rad_s : tuple of float
        Gyro bias at the end, FRD, and its sigma.
    magnetometer : MagnetometerUsed or None
        None without one.
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
class GnssDifference:
    """Position less that of the last fix, which is of the antenna, and as late as it is stated.

    Attributes
    ----------
    time_ns : int
        Stamp of the fix.
    north_m, east_m : float
        Horizontal difference.
    up_m : float or None
        None if the fix has no height.
    """

    time_ns: int
    north_m: float
    east_m: float
    up_m: float | None


@dataclass(frozen=True)
class FinalState:
    """The last attitude, and the last position if there is one.

    Attributes
    ----------
    time_ns : int
        Of the attitude.
    q_wxyz_ned_frd : tuple of float
        Unit quaternion, scalar first, from Forward-Right-Down to North-East-Down.
    roll_deg, pitch_deg, heading_deg : float
        The same as angles.
    lat_deg, lon_deg, height_m : float or None
        Where the solution ends; None in a mode that computes no positions.
    """

    time_ns: int
    q_wxyz_ned_frd: tuple[float, ...]
    roll_deg: float
    pitch_deg: float
    heading_deg: float
    lat_deg: float | None
    lon_deg: float | None
    height_m: float | None

    @classmethod
    def of(cls, last: Solution, navigates: bool) -> FinalState:
        """From the last block of a run; if it does not navigate, its position is that of a fix."""
        roll, pitch, heading = to_euler(last.q_nb[-1]) / DEGREE
        latitude = longitude = height = None
        if navigates and last.position is not None:
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
