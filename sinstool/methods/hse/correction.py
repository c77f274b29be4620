"""Headings corrected by a calibration of heading-sensitive error.

Yu et al., J. NUDT 35(4), 2013, 161-165, eq. (14), and its variance by the linear propagation
of those of the coefficient and of the lean of the axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sinstool.core.earth import EARTH_RATE
from sinstool.core.errors import ConfigurationError
from sinstool.methods.hse.calibration import HseCalibration
from sinstool.methods.hse.status import APPLICABLE, MAX_LATITUDE

FloatArray = NDArray[np.float64]


def require_applicable(cal: HseCalibration, force: bool = False) -> str | None:
    """Refuse a calibration that may make headings worse.

    Parameters
    ----------
    force : bool
        Accept one whose coefficient is doubtful; one without a coefficient never is.

    Returns
    -------
    str or None
        A warning when it was forced.

    Raises
    ------
    ConfigurationError
        If its status forbids it and it is not forced, or it has no coefficient.
    """
    if cal.lambda2_rad is None:
        raise ConfigurationError(
            f"the calibration has no coefficient: its status is {cal.status}",
            "calibrate again; its warnings say what was missing",
        )
    if cal.status in APPLICABLE:
        return None
    message = f"the calibration of heading-sensitive error has the status {cal.status}"
    if force:
        return message
    raise ConfigurationError(message, "calibrate again, or apply it with --force")


def correction(
    cal: HseCalibration,
    rate: ArrayLike,
    C23: ArrayLike,
    latitude: ArrayLike,
    sigma_C23: ArrayLike = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Heading-sensitive error, to be taken from the heading.

    Parameters
    ----------
    rate : array_like, shape (...)
        Of the table about its (down) axis, rad/s.
    C23 : array_like, shape (...)
        Lean of the axis to the east.
    latitude : array_like, shape (...)
        rad; may be another than that of the calibration.
    sigma_C23 : array_like, shape (...), optional
        Of the lean.

    Returns
    -------
    dpsi : ndarray, shape (...)
        rad; ``psi = psi_hat - dpsi``.
    sigma : ndarray, shape (...)
        rad; NaN if the calibration does not know that of its coefficient.

    Raises
    ------
    ConfigurationError
        If the calibration has no coefficient or a latitude is beyond 85 deg.
    """
    if cal.lambda2_rad is None:
        require_applicable(cal)
    lat = np.asarray(latitude, dtype=np.float64)
    if np.any(np.abs(lat) > MAX_LATITUDE):
        raise ConfigurationError(
            f"heading-sensitive error cannot be corrected at latitude"
            f" {np.degrees(np.max(np.abs(lat))):.1f} deg",
            "the Earth's rate has next to no horizontal part beyond 85 deg",
        )
    lean = np.asarray(C23, dtype=np.float64)
    lambda1 = np.asarray(rate, dtype=np.float64) - EARTH_RATE * np.sin(lat)
    slope = lambda1 / (3.0 * EARTH_RATE * np.cos(lat))
    lambda2 = cal.lambda2_rad or 0.0
    sigma_lambda2 = np.nan if cal.sigma_lambda2_rad is None else cal.sigma_lambda2_rad
    by_lean = slope * lambda2 * np.asarray(sigma_C23, dtype=np.float64)
    return np.asarray(slope * lambda2 * lean), np.asarray(
        np.hypot(slope * lean * sigma_lambda2, by_lean)
    )


@dataclass(frozen=True)
class CorrectedHeading:
    """Heading of ``b0`` before and after correction.

    Attributes
    ----------
    heading : ndarray, shape (...)
        Corrected, rad, in [0, 2 pi).
    sigma : ndarray, shape (...)
        Of it, rad.
    dpsi, sigma_dpsi : ndarray, shape (...)
        What was taken away, rad.
    outside_rate, outside_C23 : ndarray of bool, shape (...)
        The rate, or the lean of the axis, is outside what the calibration has seen; a
        direction of rotation that it has not seen is outside.
    """

    heading: FloatArray
    sigma: FloatArray
    dpsi: FloatArray
    sigma_dpsi: FloatArray
    outside_rate: NDArray[np.bool_]
    outside_C23: NDArray[np.bool_]


# Beyond the calibrated range by less than this share is within it.
RANGE_TOLERANCE = 0.02


def correct_heading(
    cal: HseCalibration,
    heading: ArrayLike,
    sigma_heading: ArrayLike,
    rate: ArrayLike,
    C23: ArrayLike,
    latitude: ArrayLike,
    sigma_C23: ArrayLike = 0.0,
) -> CorrectedHeading:
    """Correct headings of a rotating system at rest.

    Parameters
    ----------
    heading, sigma_heading : array_like, shape (...)
        Estimated, rad.
    rate, C23, latitude, sigma_C23 : array_like, shape (...)
        See :func:`correction`.

    Returns
    -------
    CorrectedHeading

    Raises
    ------
    ConfigurationError
        As :func:`correction`.
    """
    dpsi, sigma_dpsi = correction(cal, rate, C23, latitude, sigma_C23)
    low, high = cal.rate_range
    margin = RANGE_TOLERANCE * max(abs(low), abs(high))
    turning = np.asarray(rate, dtype=np.float64)
    return CorrectedHeading(
        heading=np.asarray((np.asarray(heading, dtype=np.float64) - dpsi) % (2.0 * np.pi)),
        sigma=np.asarray(np.hypot(np.asarray(sigma_heading, dtype=np.float64), sigma_dpsi)),
        dpsi=dpsi,
        sigma_dpsi=sigma_dpsi,
        outside_rate=np.asarray((turning < low - margin) | (turning > high + margin)),
        outside_C23=np.asarray(
            np.abs(np.asarray(C23, dtype=np.float64)) > (1.0 + RANGE_TOLERANCE) * cal.max_C23
        ),
    )
