"""The calibration of heading-sensitive error as a JSON text.

Quantities are in SI and radians and say so in their names; figures in arc seconds stand beside
some for the reader and must agree with them. The sign convention is part of the text.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from typing import Any

from pydantic import ConfigDict, TypeAdapter, ValidationError

from sinstool.core.earth import EARTH_RATE
from sinstool.core.errors import ConfigurationError
from sinstool.core.units import ARCSEC
from sinstool.methods.hse.calibration import HseCalibration
from sinstool.methods.hse.fit_result import METHODS
from sinstool.methods.hse.status import STATUSES

SCHEMA = "sinstool.hse/1"
SIGN = {
    "dpsi": "psi_hat-psi_true",
    "C23": "C_b0^n[1][2], NED, z_b0 down",
    "apply": "psi=psi_hat-dpsi",
}
_REMAKE = "write the file again with calibrate-hse"
_OTHER_FILE = "give a file that calibrate-hse wrote"

# In a list of one, since pydantic takes a configuration for no plain dataclass by itself.
_READER = TypeAdapter(
    list[HseCalibration], config=ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)
)


def _derived(cal: HseCalibration) -> dict[str, Any]:
    """Figures written beside the quantities, which must agree with them."""
    lambda2, k = cal.lambda2_rad, cal.K_HSE_s
    return {
        "lambda2_arcsec": None if lambda2 is None else lambda2 / ARCSEC,
        "eps_sum_rad": None if lambda2 is None else -lambda2,
        "K_HSE_arcsec_per_rad_s": None if k is None else k / ARCSEC,
    }


def to_dict(cal: HseCalibration) -> dict[str, Any]:
    """Calibration as a dictionary for JSON."""
    return {"schema": SCHEMA, "sign": dict(SIGN), **asdict(cal), **_derived(cal)}


def from_dict(data: Mapping[str, Any]) -> HseCalibration:
    """Calibration from a dictionary of :func:`to_dict`.

    Raises
    ------
    ConfigurationError
        If the schema is another, a key is missing, unknown or of the wrong type, or the
        quantities contradict each other.
    """
    if not isinstance(data, Mapping) or "schema" not in data:
        raise ConfigurationError(
            "this is no calibration of heading-sensitive error: it has no schema", _OTHER_FILE
        )
    if data["schema"] != SCHEMA:
        raise ConfigurationError(
            f"the calibration's schema is {data['schema']!r}, this program reads {SCHEMA!r}",
            _REMAKE,
        )
    if data.get("sign") != SIGN:
        raise ConfigurationError("the calibration's sign convention is missing or another", _REMAKE)
    figures = ("lambda2_arcsec", "eps_sum_rad", "K_HSE_arcsec_per_rad_s")
    for key in figures:
        if key not in data:
            raise ConfigurationError(f"the calibration lacks {key}", _REMAKE)
    quantities = {k: v for k, v in data.items() if k not in ("schema", "sign", *figures)}
    try:
        (cal,) = _READER.validate_json(json.dumps([quantities]))
    except ValidationError as error:
        raise ConfigurationError(_explained(error.errors()[0]), _REMAKE) from error
    _check(cal, data)
    return cal


def _explained(error: Any) -> str:
    """What is wrong, and where: the first error that pydantic found."""
    path = ".".join(str(key) for key in error["loc"][1:])
    if error["type"] == "missing":
        return f"the calibration lacks {path}"
    if error["type"] == "unexpected_keyword_argument":
        return f"the calibration has an unknown key {path}"
    shown = json.dumps(error["input"], default=str)[:40]
    return (
        f"the calibration's {path} is {shown}: {error['msg'].replace('Input should', 'it should')}"
    )


def dumps(cal: HseCalibration) -> str:
    """Calibration as text."""
    return json.dumps(to_dict(cal), indent=2, allow_nan=False) + "\n"


def loads(text: str) -> HseCalibration:
    """Calibration from a text of :func:`dumps`.

    Raises
    ------
    ConfigurationError
        If the text is no JSON, or as for :func:`from_dict`.
    """
    try:
        data = json.loads(text, parse_constant=_no_constant)
        return from_dict(data)
    except RecursionError:
        reason = "lists in lists, too deep"
    except ValueError as error:
        reason = str(error)
    raise ConfigurationError(
        f"this is no calibration of heading-sensitive error: {reason}", _OTHER_FILE
    )


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is no JSON number")


def _check(cal: HseCalibration, data: Mapping[str, Any]) -> None:
    """Refuse quantities that contradict each other."""
    for key, value in _derived(cal).items():
        written = data[key]
        if value is None or not isinstance(written, int | float):
            same = written is value
        else:
            same = False
            with suppress(OverflowError):  # a whole number beyond all floats
                same = math.isclose(written, value, rel_tol=1e-9, abs_tol=1e-300)
        if not same:
            raise ConfigurationError(
                f"the calibration's {key} ({written}) contradicts its radians ({value})",
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
