"""Correction of the heading-sensitive error of a run, stretch by stretch."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TurntableStretch:
    """A stretch at constant rate: its heading as aligned, the correction, and the result.

    Attributes
    ----------
    start_ns : int
        Of the stretch.
    duration_s : float
        Of its whole turns.
    turns : int
        Whole turns.
    rate_deg_s : float
        Of the table.
    C23_rad : float
        Lean of the axis to the east.
    heading_raw_deg : float
        As aligned.
    correction_arcsec : float
        Heading-sensitive error, subtracted from it.
    sigma_correction_arcsec : float or None
        None if the calibration gives no sigma.
    heading_deg : float
        After correction.
    sigma_heading_arcsec : float or None
        None if unknown.
    outside_rate, outside_C23 : bool
        Whether rate and lean are outside those of the calibration.
    """

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
    """A stretch that could not be aligned on.

    Attributes
    ----------
    start_s, duration_s : float
        From the first sample, and its length.
    rate_deg_s : float
        Of the table.
    reason : str
        In words.
    """

    start_s: float
    duration_s: float
    rate_deg_s: float
    reason: str


@dataclass(frozen=True)
class HseCorrection:
    """The heading-sensitive error that was removed, stretch by stretch.

    Attributes
    ----------
    file : str or None
        The calibration, of ``--hse``.
    status : str
        Of the calibration.
    lambda2_arcsec, sigma_lambda2_arcsec : float or None
        Coefficient, and its sigma; None if unknown.
    segments : tuple of TurntableStretch
        Those used.
    not_used : tuple of UnusedStretch
        The others.
    """

    file: str | None
    status: str
    lambda2_arcsec: float | None
    sigma_lambda2_arcsec: float | None
    segments: tuple[TurntableStretch, ...]
    not_used: tuple[UnusedStretch, ...]
