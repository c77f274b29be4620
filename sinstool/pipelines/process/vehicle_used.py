"""Motion constraints that an INS/GNSS filter used, and their results."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class WheelSpeedUsed:
    """Wheels whose speed a filter used.

    Attributes
    ----------
    topic : str
        Of the readings.
    unit : str
        Of the readings, ``m/s`` or ``rad/s``.
    metres_per_unit, scale_sigma : float
        Last estimate of the factor near 1, or of the radius, and its sigma as a fraction.
    latency_s, latency_sigma_s : float
        Delay of the stamps.
    sigma_m_s : float
        Assumed error of the speed, as a mean over a second.
    used, slipped : int
        How often a reading was used, and how often it was left out as it did not fit.
    one_slips : float
        Share of the readings that are left out as one wheel turned differently from the other.
    """

    topic: str
    unit: str
    metres_per_unit: float
    scale_sigma: float
    latency_s: float
    latency_sigma_s: float
    sigma_m_s: float
    used: int
    slipped: int
    one_slips: float


@dataclass(frozen=True)
class LandVehicleUsed:
    """A vehicle whose axle does not slide, as a filter estimated it last.

    Attributes
    ----------
    mount_deg : tuple of float
        Attitude of the IMU in the vehicle: roll, pitch, yaw.
    mount_sigma_deg : tuple of float
        Of pitch and yaw.
    axle_m, axle_sigma_m : float
        Distance of the IMU ahead of the axle.
    sideslip_rad_s2_m, squat_rad_s2_m : float
        Sideslip of the axle per lateral acceleration, and pitch of the body per forward
        acceleration, rad/(m/s^2).
    lateral_m_s, vertical_m_s : float
        Assumed sigma of the axle's velocity sideways and up, as a mean over a second.
    used, slid : int
        How often the constraint was used, and how often it did not hold.
    wheels : WheelSpeedUsed or None
        None without wheel speeds.
    """

    mount_deg: tuple[float, ...]
    mount_sigma_deg: tuple[float, ...]
    axle_m: float
    axle_sigma_m: float
    sideslip_rad_s2_m: float
    squat_rad_s2_m: float
    lateral_m_s: float
    vertical_m_s: float
    used: int
    slid: int
    wheels: WheelSpeedUsed | None


@dataclass(frozen=True)
class VehicleUsed:
    """Constraints of a vehicle that a run used.

    Attributes
    ----------
    kind : str
        ``land`` or ``none``.
    reason : str
        Why, as the end of a sentence.
    rest_s : float
        How long it was held at rest.
    rest_reason : str
        Evidence for the rest, as the end of a sentence.
    land : LandVehicleUsed or None
        None if the axle may slide.
    """

    kind: str
    reason: str
    rest_s: float
    rest_reason: str
    land: LandVehicleUsed | None
