"""One alignment on a rotating table: what the calibration of heading-sensitive error is fed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class HseRun:
    """Heading and axial rate error of one stretch at constant rate, over whole turns.

    The frame ``b0`` is the base of the turntable: z down along its axis, x at the zero mark
    of its encoder; ``C_b0n`` takes a vector from it to NED. Angles in rad, rates in rad/s.

    Attributes
    ----------
    id : str
        Names the run, unique in a calibration; what ``--exclude`` takes.
    source : str
        The log it comes from.
    t_start_s : float
        Start of the first whole turn, s since the start of the log.
    duration_s : float
        Of the whole turns, s.
    n_turns : int
        Number of whole turns.
    rate : float
        Mean rate ``Omega`` of the table about its z axis, rad/s; the sign is its direction.
    heading : float
        Estimated heading ``psi_hat`` of ``b0``, rad, in [0, 2 pi).
    sigma_heading : float
        Of the heading, rad, from the scatter of the turns; NaN when there were too few.
    theta, gamma : float
        Pitch and roll of ``b0``, rad.
    C23 : float
        ``C_b0n[1, 2]``: how far the (down) rotation axis leans to the east.
    sigma_C23 : float
        Of ``C23``.
    c_axial : float
        Relative error of the rate along the axis, X33:
        (gyro - encoder - Earth rate along the axis) / (Omega + Earth rate along the axis).
    sigma_c_axial : float
        Of ``c_axial``.
    latitude : float
        Geodetic latitude, rad.
    per_turn_heading : ndarray, shape (n_turns,), optional
        Heading of each turn, rad.
    quality : dict of str to float
        Figures for the quality of the run by name, such as ``tilt_drift``.
    log_start_ns : int, optional
        Stamp at the start of the log; relates runs of several logs in time.
    """

    id: str
    source: str
    t_start_s: float
    duration_s: float
    n_turns: int
    rate: float
    heading: float
    sigma_heading: float
    theta: float
    gamma: float
    C23: float
    sigma_C23: float
    c_axial: float
    sigma_c_axial: float
    latitude: float
    per_turn_heading: FloatArray | None = None
    quality: dict[str, float] = field(default_factory=dict)
    log_start_ns: int | None = None
