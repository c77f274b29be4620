"""The calibration of heading-sensitive error as a JSON text.

Quantities are in SI and radians and say so in their names; figures in arc seconds stand beside
some for the reader and must agree with them. The sign convention is part of the text, as is a
hash of the configuration (the matrices, the encoder) that the coefficient was found with: it
lumps together every error along the axis and holds for no other configuration.
"""

from __future__ import annotations

import json
import math
import re
import types
import typing
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass
from typing import Any

import numpy as np

from sinstool.core.earth import EARTH_RATE
from sinstool.core.errors import ConfigurationError
from sinstool.core.units import ARCSEC
from sinstool.methods.hse.fit_result import METHODS, HseFit
from sinstool.methods.hse.status import APPLICABLE, STATUSES, Judgement

SCHEMA = "sinstool.hse/1"
SIGN = {
    "dpsi": "psi_hat-psi_true",
    "C23": "C_b0^n[1][2], NED, z_b0 down",
    "apply": "psi=psi_hat-dpsi",
}
_REMAKE = "write the file again with calibrate-hse"


@dataclass(frozen=True)
class AxialRecord:
    """What the rate along the axis gave."""

    c: float
    lambda2_rad: float
    sigma_rad: float | None
    bias_rad_s: float | None
    z_consistency: float | None


@dataclass(frozen=True)
class FitRecord:
    """How good the fit of headings is; ``s_rad`` is the scatter of a run about it."""

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
    """A calibration as it is kept.

    The names and units are those of the text; see :class:`sinstool.methods.hse.fit_result.HseFit`
    for their meaning. ``cov`` belongs to ``parameters``; both are empty where nothing is known of
    the scatter. ``created`` is a time by RFC 3339, ``tool`` the version that wrote it.
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

    @property
    def applicable(self) -> bool:
        """The coefficient may be applied without being forced."""
        return self.lambda2_rad is not None and self.status in APPLICABLE


def _known(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def from_fit(
    result: HseFit, judged: Judgement, created: str, tool: str, config_sha256: str
) -> HseCalibration:
    """Calibration to be kept, of a fit and its judgement.

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
            sigma_rad=_known(result.axial.sigma_lambda2),
            bias_rad_s=result.axial.bias,
            z_consistency=result.z_consistency,
        ),
        delay_s=result.delay,
        sigma_delay_s=result.sigma_delay,
        latitude_rad=result.latitude,
        omega_ie=EARTH_RATE,
        fit=FitRecord(
            n_runs=result.n_used,
            n_rates=len(result.rates),
            dof=result.dof,
            chi2=result.chi2,
            s_rad=result.s,
            r2=result.r2,
            F_lof=result.F_lof,
            p_lof=result.p_lof,
            cond=result.condition,
            distribution=result.distribution,
            rates_rad_s=result.rates,
        ),
        runs=tuple(_run_record(result, i) for i in range(len(result.runs))),
        config_sha256=config_sha256,
    )


def _run_record(result: HseFit, i: int) -> RunRecord:
    run, fitted = result.runs[i], result.run_fits[i]
    return RunRecord(
        id=run.id,
        source=run.source,
        t_start_s=run.t_start_s,
        duration_s=run.duration_s,
        n_turns=run.n_turns,
        rate_rad_s=run.rate,
        psi_rad=run.heading,
        sigma_psi_rad=_known(run.sigma_heading),
        theta=run.theta,
        gamma=run.gamma,
        C23=run.C23,
        sigma_C23=_known(run.sigma_C23),
        c_axial=run.c_axial,
        sigma_c_axial=_known(run.sigma_c_axial),
        position=fitted.position,
        resid_rad=fitted.residual,
        leverage=fitted.leverage,
        studentised=fitted.studentised,
        used=fitted.used,
        reason=fitted.reason,
    )


def _derived(cal: HseCalibration) -> dict[str, Any]:
    """What is written beside the quantities and must agree with them."""
    lambda2, k = cal.lambda2_rad, cal.K_HSE_s
    return {
        "lambda2_arcsec": None if lambda2 is None else lambda2 / ARCSEC,
        "eps_sum_rad": None if lambda2 is None else -lambda2,
        "K_HSE_arcsec_per_rad_s": None if k is None else k / ARCSEC,
    }


def to_dict(cal: HseCalibration) -> dict[str, Any]:
    """Calibration as what JSON can hold."""
    return {"schema": SCHEMA, "sign": dict(SIGN), **asdict(cal), **_derived(cal)}


def from_dict(data: Mapping[str, Any]) -> HseCalibration:
    """Calibration of what :func:`to_dict` gave.

    Returns
    -------
    HseCalibration

    Raises
    ------
    ConfigurationError
        If the schema is another, a key is missing, unknown or of the wrong type, or the
        quantities contradict each other.
    """
    if not isinstance(data, Mapping) or "schema" not in data:
        raise ConfigurationError(
            "this is no calibration of heading-sensitive error: it has no schema",
            "give a file that calibrate-hse wrote",
        )
    if data["schema"] != SCHEMA:
        raise ConfigurationError(
            f"the calibration's schema is {data['schema']!r}, this program reads {SCHEMA!r}",
            _REMAKE,
        )
    if data.get("sign") != SIGN:
        raise ConfigurationError("the calibration's sign convention is missing or another", _REMAKE)
    extra = ("schema", "sign", "lambda2_arcsec", "eps_sum_rad", "K_HSE_arcsec_per_rad_s")
    for key in extra:
        if key not in data:
            raise ConfigurationError(f"the calibration lacks {key}", _REMAKE)
    cal = _build(HseCalibration, {k: v for k, v in data.items() if k not in extra}, "")
    _check(cal, data)
    return typing.cast(HseCalibration, cal)


def dumps(cal: HseCalibration) -> str:
    """Calibration as text."""
    return json.dumps(to_dict(cal), indent=2, allow_nan=False) + "\n"


def loads(text: str) -> HseCalibration:
    """Calibration of the text that :func:`dumps` gave.

    Raises
    ------
    ConfigurationError
        If the text is no JSON, or as for :func:`from_dict`.
    """
    try:
        data = json.loads(text, parse_constant=_no_constant)
    except ValueError as error:
        raise ConfigurationError(
            f"this is no calibration of heading-sensitive error: {error}",
            "give a file that calibrate-hse wrote",
        ) from error
    return from_dict(data)


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is no JSON number")


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
    message = (
        "the calibration of heading-sensitive error was made with another configuration of the"
        f" rig ({cal.config_sha256[:12]}, not {config_sha256[:12]})"
    )
    if force:
        return message
    raise ConfigurationError(
        message, "calibrate again with this configuration, or apply it with --force"
    )


def _build(kind: Any, data: Any, where: str) -> Any:
    """Value of type ``kind`` from what JSON gave."""
    if is_dataclass(kind):
        if not isinstance(data, Mapping):
            raise _wrong(where, "a table", data)
        hints = typing.get_type_hints(kind)
        names = [f.name for f in fields(kind)]
        for name in data:
            if name not in names:
                raise ConfigurationError(
                    f"the calibration has an unknown key {where}{name}", _REMAKE
                )
        for name in names:
            if name not in data:
                raise ConfigurationError(f"the calibration lacks {where}{name}", _REMAKE)
        return kind(**{n: _build(hints[n], data[n], f"{where}{n}.") for n in names})  # type: ignore[operator]
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin is types.UnionType:
        return None if data is None else _build(inner[0], data, where)
    if origin is tuple:
        if not isinstance(data, list | tuple) or (inner[-1] is not ... and len(data) != len(inner)):
            raise _wrong(where, "a list" if inner[-1] is ... else f"{len(inner)} numbers", data)
        return tuple(_build(inner[0], one, where) for one in data)
    if kind is float:
        if isinstance(data, bool) or not isinstance(data, int | float) or not math.isfinite(data):
            raise _wrong(where, "a finite number", data)
        return float(data)
    if kind is int and (isinstance(data, bool) or not isinstance(data, int)):
        raise _wrong(where, "a whole number", data)
    if not isinstance(data, kind):
        raise _wrong(where, {str: "a text", bool: "true or false"}[kind], data)
    return data


def _wrong(where: str, wanted: str, data: Any) -> ConfigurationError:
    name = where.rstrip(".")
    return ConfigurationError(
        f"the calibration's {name} is {json.dumps(data, default=str)[:40]}, not {wanted}", _REMAKE
    )


def _check(cal: HseCalibration, data: Mapping[str, Any]) -> None:
    """Refuse quantities that contradict each other."""
    for key, value in _derived(cal).items():
        given = data[key]
        if value is None or not isinstance(given, int | float):
            same = given is value
        else:
            same = math.isclose(given, value, rel_tol=1e-9, abs_tol=1e-300)
        if not same:
            raise ConfigurationError(
                f"the calibration's {key} ({given}) contradicts its radians ({value})",
                "it was edited; " + _REMAKE,
            )
    deviations = (cal.sigma_lambda2_rad, cal.sigma_K_HSE_s, cal.sigma_C23_rad, cal.sigma_delay_s)
    size = len(cal.parameters)
    checks = {
        "method": cal.method in METHODS,
        "status": cal.status in STATUSES,
        "standard deviations": all(s is None or s >= 0.0 for s in deviations),
        "cov": len(cal.cov) == size and all(len(row) == size for row in cal.cov),
        "latitude_rad": abs(cal.latitude_rad) <= math.pi / 2.0,
        "omega_ie": math.isclose(cal.omega_ie, EARTH_RATE, rel_tol=1e-9),
        "config_sha256": re.fullmatch("[0-9a-f]{64}", cal.config_sha256) is not None,
        "runs": any(r.used for r in cal.runs),
    }
    for name, good in checks.items():
        if not good:
            raise ConfigurationError(f"the calibration's {name} is impossible", _REMAKE)
