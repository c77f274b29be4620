"""The calibration of heading-sensitive error, and whether it fits a rig.

It includes a hash of the configuration (the matrices, the encoder) with which the coefficient was
found: the coefficient sums up all errors along the axis, and holds for that configuration only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import ArrayLike, BoolArray, FloatArray
from sinstool.core.earth import EARTH_RATE
from sinstool.core.errors import ConfigurationError
from sinstool.core.result import fields_in
from sinstool.methods.hse.fit_result import HseFit
from sinstool.methods.hse.run import MAX_LATITUDE
from sinstool.methods.hse.status import APPLICABLE, Judgement


@dataclass(frozen=True)
class AxialRecord:
    """Result from the rate along the axis."""

    c: float
    lambda2_rad: float
    sigma_rad: float | None
    bias_rad_s: float | None
    z_consistency: float | None


@dataclass(frozen=True)
class FitRecord:
    """Quality of the fit of headings; ``s_rad`` is the scatter of a run about it."""

    n_runs: int
    n_rates: int
    dof: int
    chi2: float | None
    s_rad: float | None
    r2: float | None
    F_lof: float | None
    p_lof: float | None
    cond: float | None
    distribution: str
    rates_rad_s: tuple[float, ...]


@dataclass(frozen=True)
class RunRecord:
    """One run of the calibration, used or not."""

    id: str
    source: str
    t_start_s: float
    duration_s: float
    n_turns: int
    rate_rad_s: float
    psi_rad: float
    sigma_psi_rad: float | None
    theta: float
    gamma: float
    C23: float
    sigma_C23: float | None
    c_axial: float
    sigma_c_axial: float | None
    position: int
    resid_rad: float | None
    leverage: float | None
    studentised: float | None
    used: bool
    reason: str


@dataclass(frozen=True)
class HseCalibration:
    """A calibration as it is written to a file.

    The names and units are those of the file; see :class:`sinstool.methods.hse.fit_result.HseFit`
    for their meaning. ``cov`` belongs to ``parameters``; both are empty where the scatter is
    unknown. ``created`` is a time by RFC 3339, ``tool`` the version that wrote it.
    """

    created: str
    tool: str
    method: str
    form: str
    status: str
    warnings: tuple[str, ...]
    lambda2_rad: float | None
    sigma_lambda2_rad: float | None
    ci95_lambda2_rad: tuple[float, float] | None
    K_HSE_s: float | None
    sigma_K_HSE_s: float | None
    ci95_K_HSE_s: tuple[float, float] | None
    psi0_rad: tuple[float, ...]
    parameters: tuple[str, ...]
    cov: tuple[tuple[float, ...], ...]
    C23_rad: float
    sigma_C23_rad: float
    C23_spread: float
    axial: AxialRecord
    delay_s: float | None
    sigma_delay_s: float | None
    latitude_rad: float
    omega_ie: float
    fit: FitRecord
    runs: tuple[RunRecord, ...]
    config_sha256: str

    @property
    def rate_range(self) -> tuple[float, float]:
        """Least and largest rate of the runs in use, rad/s."""
        rates = [r.rate_rad_s for r in self.runs if r.used]
        return min(rates), max(rates)

    @property
    def max_C23(self) -> float:
        """Largest lean of the axis to the east, either way, of the runs in use."""
        return max(abs(r.C23) for r in self.runs if r.used)


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def from_fit(
    result: HseFit, judged: Judgement, created: str, tool: str, config_sha256: str
) -> HseCalibration:
    """Calibration of a fit and its judgement.

    Parameters
    ----------
    created : str
        Time by RFC 3339.
    tool : str
        Name and version of the program.
    config_sha256 : str
        Hash of the configuration of the rig, 64 hexadecimal digits.

    Returns
    -------
    HseCalibration
        Without ``lambda2`` where the status is ``error``, or ``unobservable``.
    """
    refused = judged.status in ("error", "unobservable")
    finite = bool(np.all(np.isfinite(result.covariance)))
    return HseCalibration(
        created=created,
        tool=tool,
        method=result.method,
        form=result.form,
        status=judged.status,
        warnings=judged.warnings,
        lambda2_rad=None if refused else result.lambda2,
        sigma_lambda2_rad=None if refused else result.sigma_lambda2,
        ci95_lambda2_rad=None if refused else result.ci95_lambda2,
        K_HSE_s=result.K,
        sigma_K_HSE_s=result.sigma_K,
        ci95_K_HSE_s=result.ci95_K,
        psi0_rad=result.psi0,
        parameters=result.parameters if finite else (),
        cov=tuple(tuple(float(v) for v in row) for row in result.covariance) if finite else (),
        C23_rad=result.C23,
        sigma_C23_rad=result.sigma_C23,
        C23_spread=result.C23_spread,
        axial=AxialRecord(
            c=result.axial.c,
            lambda2_rad=result.axial.lambda2,
            sigma_rad=_finite(result.axial.sigma_lambda2),
            bias_rad_s=result.axial.bias,
            z_consistency=result.z_consistency,
        ),
        delay_s=result.delay,
        sigma_delay_s=result.sigma_delay,
        latitude_rad=result.latitude,
        omega_ie=EARTH_RATE,
        fit=FitRecord(
            **fields_in(result, FitRecord),
            n_runs=result.n_used,
            n_rates=len(result.rates),
            s_rad=result.s,
            cond=result.condition,
            rates_rad_s=result.rates,
        ),
        runs=tuple(_run_record(result, i) for i in range(len(result.runs))),
        config_sha256=config_sha256,
    )


def _run_record(result: HseFit, i: int) -> RunRecord:
    run, fitted = result.runs[i], dict(vars(result.run_fits[i]))
    own = {
        "rate_rad_s": run.rate,
        "psi_rad": run.heading,
        "sigma_psi_rad": _finite(run.sigma_heading),
        "sigma_C23": _finite(run.sigma_C23),
        "sigma_c_axial": _finite(run.sigma_c_axial),
        "resid_rad": fitted.pop("residual"),
    }
    return RunRecord(**{**fields_in(run, RunRecord), **own, **fitted})


def require_config(cal: HseCalibration, config_sha256: str, force: bool = False) -> str | None:
    """Refuse a calibration that was made with another configuration.

    Parameters
    ----------
    config_sha256 : str
        Hash of the configuration in use.
    force : bool
        Accept it all the same.

    Returns
    -------
    str or None
        A warning when it was forced.

    Raises
    ------
    ConfigurationError
        If the configurations differ and it is not forced.
    """
    if cal.config_sha256 == config_sha256:
        return None
    return _unless_forced(
        force,
        "the calibration of heading-sensitive error was made with another configuration of the"
        f" rig ({cal.config_sha256[:12]}, not {config_sha256[:12]})",
        "calibrate again with this configuration, or apply it with --force",
    )


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
    return _unless_forced(force, message, "calibrate again, or apply it with --force")


def _unless_forced(force: bool, message: str, hint: str) -> str:
    """A message as a warning where a user insists, an error otherwise."""
    if force:
        return message
    raise ConfigurationError(message, hint)


def correction(
    cal: HseCalibration,
    rate: ArrayLike,
    C23: ArrayLike,
    latitude: ArrayLike,
    sigma_C23: ArrayLike = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Heading-sensitive error, to be subtracted from the heading.

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
            "beyond 85 deg the Earth's rate has almost no horizontal part",
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
    outside_rate: BoolArray
    outside_C23: BoolArray


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
