"""The INS/GNSS filter of a run: its inputs, its latency, and its last estimates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sinstool.methods.ins_gnss.withheld import WithheldScore
from sinstool.pipelines.process.travel import Outages
from sinstool.survey.grade import ImuGrade

if TYPE_CHECKING:
    from sinstool.pipelines.process.vehicle_used import VehicleUsed


@dataclass(frozen=True)
class FilterStartTime:
    """Time and method of a filter's start.

    Attributes
    ----------
    time_ns : int
        Of the sample at which the filter starts.
    how : str
        Source of its attitude, in words.
    """

    time_ns: int
    how: str


@dataclass(frozen=True)
class LatencyUsed:
    """Latency of the fixes, in the middle of the log if it changes.

    Attributes
    ----------
    status : str
        ``given``, ``found``, ``not settled`` (the estimate did not converge) or ``not observable``.
    sigma_s, estimate_s : float or None
        Estimate from the log and its sigma, used or not; None if it is not observable.
    position_s, velocity_s : float
        Used for positions and for velocities.
    clock_ppm : float
        Rate of the receiver's clock less that of the IMU's; 0 if the log shows none.
    """

    status: str
    sigma_s: float | None
    estimate_s: float | None
    position_s: float
    velocity_s: float
    clock_ppm: float = 0.0


@dataclass(frozen=True)
class WithheldScores(WithheldScore):
    """Errors of a solution at withheld fixes.

    Attributes
    ----------
    filter : WithheldScore or None
        Of a smoothed solution, the errors of the filter.
    """

    filter: WithheldScore | None = None


@dataclass(frozen=True)
class FilterUsed:
    """An INS/GNSS filter: its kind, its inputs, and its last estimates.

    Attributes
    ----------
    filter, requested : str
        The filter that ran, and the configured one, which may need a barometer.
    states : int
        Number of its states.
    smoothed : bool
        With ``--smooth``.
    feedback : str
        ``closed`` or ``none``.
    start : FilterStartTime
        Where it starts.
    imu_grade : ImuGrade
        With the reason.
    gnss_noise : str
        Noise of the fixes, in words.
    gnss_latency_s : float
        Latency of the fixes that is used, mean of positions and velocities; in the middle of the
        log, if the receiver's clock runs at another rate.
    gnss_latency : LatencyUsed
        Where it comes from.
    lever_arm_m : tuple of float
        From the IMU to the antenna, as used, FRD.
    updates : int
        Steps of the navigation.
    epochs_used, epochs_gated, epochs_before_start : int
        Epochs of GNSS used, rejected by the gate, and left out as they precede the start.
    restarts : int
        Of the filter, after fixes that it rejected.
    mean_nis : float
        Normalised innovation squared over its number of rows, mean of the epochs used: 1 if noise
        is as assumed.
    gyro_bias_rad_s, accel_bias_m_s2 : tuple of float
        Last estimates, FRD.
    accel_scale, gyro_scale : ndarray, shape (3,)
        Errors of the scale factors, last estimates, FRD, as fractions.
    gyro_misalignment, accel_misalignment : ndarray, shape (6,), or None
        Last estimates, rad: what the first axis measures along the second, then along the third,
        then those of the other two; None without states for them.
    baro_bias_m : float
        Error of the barometric height, last estimate.
    vehicle : VehicleUsed
        Constraints on the motion.
    events : dict of str to int
        How often each event of the filter happened.
    outages : Outages
        Times without fixes.
    withheld : WithheldScores or None
        None without ``--withhold-gnss``.
    """

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
