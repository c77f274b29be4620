"""Alignments on a rotating table, which calibrate heading-sensitive error: azimuths and rates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class HseRun:
    """Heading and axial rate error of one stretch at constant rate, over whole turns.

    The frame ``b0`` is the base of the turntable: z down along its axis, x at the zero mark
    of its encoder; ``C_b0n`` takes a vector from it to NED. Angles in rad, rates in rad/s.

    Attributes
    ----------
    id : str
        Name of the run, unique in a calibration, as ``--exclude`` takes it.
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
        ``C_b0n[1, 2]``: east component of the (down) rotation axis.
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


MAX_LATITUDE = np.radians(85.0)
"""Beyond it the Earth's rate has too small a horizontal part for heading, rad."""

# Gaps between headings that no error of an alignment explains: the system was turned. With an
# error of 1e-3 in the gyro's matrix and a lean of 1e-2 headings at 20 and 60 deg/s are 2 deg apart.
HEADING_GAP = np.radians(5.0)
# Gaps between azimuths that a stand shows.
AZIMUTH_GAP = np.radians(0.5)
# Gaps between tilts that no settling of a stand explains: the system was tilted.
TILT_GAP = 1e-4
# Rates that differ by less than this share are one rate.
RATE_GAP = 0.01


def _groups(values: FloatArray, gaps: FloatArray | float) -> IntArray:
    """Number the groups that gaps larger than ``gaps`` separate, by value."""
    order = np.argsort(values, kind="stable")
    number = np.empty(len(values), dtype=np.int64)
    number[order] = np.concatenate([[0], np.cumsum(np.diff(values[order]) > gaps)])
    return number


def by_angle(heading: FloatArray, gap: float = AZIMUTH_GAP) -> IntArray:
    """Number the groups of angles (rad, at least one) that gaps wider than ``gap`` separate."""
    ordered = np.sort(heading % (2.0 * np.pi))
    gaps = np.diff(ordered, append=ordered[0] + 2.0 * np.pi)
    # counted from the end of the widest gap, so that no group lies across 0
    start = ordered[(int(np.argmax(gaps)) + 1) % len(ordered)]
    return _groups((heading - start) % (2.0 * np.pi), gap)


def positions(runs: Sequence[HseRun]) -> IntArray:
    """Number the positions of the system.

    Returns
    -------
    ndarray of int, shape (n,)
        Runs of one number have one heading (to 5 deg) and one eastward lean of the axis
        (to 1e-4 rad, or five of its standard deviations). Numbers count from 0 in the order
        of the runs.
    """
    if not runs:
        return np.zeros(0, dtype=np.int64)
    first = by_angle(np.array([r.heading for r in runs]), HEADING_GAP)
    lean = np.array([r.C23 for r in runs])
    noise = np.array([r.sigma_C23 for r in runs])
    noise = noise[np.isfinite(noise)]
    gap = max(TILT_GAP, 5.0 * float(np.median(noise)) if len(noise) else 0.0)
    second = np.zeros_like(first)
    for one in np.unique(first):
        here = first == one
        second[here] = _groups(lean[here], gap)
    seen: dict[tuple[int, int], int] = {}
    return np.array(
        [seen.setdefault((int(a), int(b)), len(seen)) for a, b in zip(first, second, strict=True)],
        dtype=np.int64,
    )


def rate_groups(rates: FloatArray) -> IntArray:
    """Number the distinct rates in ascending order; directions are distinct.

    Parameters
    ----------
    rates : ndarray, shape (n,)
        rad/s.

    Returns
    -------
    ndarray of int, shape (n,)
    """
    if len(rates) == 0:
        return np.zeros(0, dtype=np.int64)
    ordered = np.sort(rates)
    return _groups(rates, RATE_GAP * np.abs(ordered[1:]))
