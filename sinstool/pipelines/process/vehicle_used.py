"""What an INS/GNSS filter took a vehicle not to do, and what it made of it."""

from __future__ import annotations

from dataclasses import dataclass


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


@dataclass(frozen=True)
class VehicleUsed:
    """What a vehicle was taken not to do.

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
    land : LandVehicleUsed or None
    """

    kind: str
    reason: str
    rest_s: float
    rest_reason: str
    land: LandVehicleUsed | None
