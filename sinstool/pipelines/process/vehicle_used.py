"""Motion constraints that an INS/GNSS filter used, and their results."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class WheelSpeedUsed:
    """Wheels whose speed a filter used.

    Attributes
    ----------
    unit : str
        Of the readings, m/s or rad/s.
    metres_per_unit, scale_sigma : float
        A factor near 1, or the radius, as the filter has it in the end; its sigma as a fraction.
    latency_s, latency_sigma_s : float
        By which stamps are late.
    sigma_m_s : float
        What the speed was taken to be off by, as a mean over a second.
    used, slipped : int
        How often it was used, and how often it did not fit and was left out.
    one_slips : float
        Share of the readings in which one wheel turned otherwise than the other, left out too.
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
    """A vehicle whose axle does not slide, as a filter estimated it in the end.

    Attributes
    ----------
    mount_deg : tuple of float
        Attitude of the IMU in the vehicle: roll, pitch, yaw.
    mount_sigma_deg : tuple of float
        Of pitch and yaw.
    axle_m, axle_sigma_m : float
        How far the IMU is ahead of the axle.
    sideslip_rad_s2_m, squat_rad_s2_m : float
        Of the axle per lateral, of the body per forward acceleration, rad/(m/s^2).
    lateral_m_s, vertical_m_s : float
        What the axle's velocity was taken to be off 0 by, as a mean over a second.
    used, slid : int
        How often it was held not to slide, and how often that did not hold.
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
        By what it was known to rest.
    """

    kind: str
    reason: str
    rest_s: float
    rest_reason: str
    land: LandVehicleUsed | None
