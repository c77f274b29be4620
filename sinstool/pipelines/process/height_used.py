"""Damping of the height of a run: its settings, events and end."""

from __future__ import annotations

from dataclasses import dataclass

from sinstool.survey.grade import ImuGrade


@dataclass(frozen=True)
class BarometerSetting:
    """Setting of a barometer.

    Attributes
    ----------
    mode : str
        What it was set by: ``gnss``, ``init`` (the height at the start) or ``qnh``.
    offset_m : float
        Added to the heights of the standard atmosphere.
    scale : float
        Factor on these heights, on a warm or cold day.
    """

    mode: str
    offset_m: float
    scale: float


@dataclass(frozen=True)
class HeightEvent:
    """An event of the vertical channel.

    Attributes
    ----------
    kind : str
        ``engaged``, ``coast``, ``re-engaged``, ``jump``, ``returned``, ``frozen``, ``invalid`` or
        ``imu-gap``.
    time_ns : int
        When it happened.
    size : float
        In m, or of ``coast``, ``invalid`` and ``imu-gap`` in s.
    duration_s : float
        Of what it ends; else 0.
    """

    kind: str
    time_ns: int
    size: float
    duration_s: float


@dataclass(frozen=True)
class FinalHeight:
    """The vertical channel at the end.

    Attributes
    ----------
    height_m : float
        Above the ellipsoid.
    velocity_up_m_s : float
        Vertical velocity.
    accelerometer_correction_m_s2 : float
        Subtracted from the upward accelerometer.
    """

    height_m: float
    velocity_up_m_s: float
    accelerometer_correction_m_s2: float


@dataclass(frozen=True)
class HeightDamping:
    """Damping of the height: its source, its settings, and its events.

    Attributes
    ----------
    damping : str
        ``baro`` or ``gnss``.
    topic : str
        With the pressures or heights.
    tau_s, k4_s : float
        Time constant and gain K4 of the network.
    gains : tuple of float
        K1, K2 and K3 of the network, 1/s, 1/s^2 and 1/s^3.
    reference : BarometerSetting or None
        None without a barometer.
    samples : dict of str to int
        Samples ``accepted``, ``waiting``, and left out for each reason: ``not_finite``,
        ``out_of_range``, ``stamp``, ``gate`` or ``frozen``.
    seconds : dict of str to float
        Time in each phase.
    phase : str
        The last one: ``init``, ``engaged`` or ``coast``.
    difference_rms_m : float
        Latest differences between height and reference, root mean square.
    offset_m : float
        Jumps of the reference that are taken off.
    final : FinalHeight
        At the end.
    events : tuple of HeightEvent
        In order of time.
    imu_grade : ImuGrade
        Sets the time constant, unless that is given.
    """

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
