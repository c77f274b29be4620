"""Whether a calibration of heading-sensitive error may be used, and what to do if not.

The status of a calibration is that of its gravest finding. The guards follow from the model of
Yu et al., J. NUDT 35(4), 2013, 161-165, eqs. (14) to (16): the slope of heading against rate has
to be significant against its scatter, the lean of the axis to the east against its own sigma, and
heading has to be linear in the rate.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy import special

from sinstool.core.earth import EARTH_RATE
from sinstool.core.finding import Finding, Severity
from sinstool.core.units import ARCSEC
from sinstool.methods.hse.fit import MIN_RATE_SPAN
from sinstool.methods.hse.fit_result import HseFit
from sinstool.methods.hse.model import MIN_C23, MIN_C23_SIGMAS
from sinstool.methods.hse.run import MAX_LATITUDE
from sinstool.methods.hse.site import wrong_latitude

STATUSES = ("error", "unobservable", "inconsistent_axial", "not_significant", "nonlinear", "ok")
"""From the gravest to the best."""

APPLICABLE = ("nonlinear", "ok")
"""Statuses whose coefficient may be applied without being forced."""

WARN_LATITUDE = np.radians(75.0)
SIGNIFICANT = 2.0
CONSISTENT = 3.0
P_LACK_OF_FIT = 0.01
SECOND_ORDER = 1e-2
C23_SPREAD = 0.05
# Scatter of the runs over what that of their turns explains, from so many degrees of freedom on.
SCATTER, LEAST_DOF = 3.0, 4


@dataclass(frozen=True)
class Judgement:
    """How far a calibration may be used.

    Attributes
    ----------
    findings : tuple of Finding
        The gravest first.
    """

    findings: tuple[Finding, ...] = ()

    @property
    def status(self) -> str:
        """One of :data:`STATUSES`."""
        return _status(self.findings[0]) if self.findings else "ok"

    @property
    def warnings(self) -> tuple[str, ...]:
        """Every finding as a line."""
        return tuple(str(one) for one in self.findings)


def judgement(findings: Iterable[Finding]) -> Judgement:
    """Order findings, the gravest first."""
    return Judgement(tuple(sorted(findings, key=lambda one: STATUSES.index(_status(one)))))


def _status(finding: Finding) -> str:
    return finding.kind if finding.kind in STATUSES else "ok"


def _finding(status: str, text: str, answer: str = "") -> Finding:
    """A finding by the status it gives a calibration; ``ok`` for a remark that changes nothing."""
    severity = Severity.WARNING if status in APPLICABLE else Severity.LOST
    return Finding("remark" if status == "ok" else status, text, severity, answer)


def _extent(result: HseFit) -> Iterator[Finding]:
    """Findings on rates and latitude that do not allow a slope to be measured."""
    if abs(result.latitude) > MAX_LATITUDE:
        yield _finding(
            "error",
            f"at latitude {np.degrees(result.latitude):.1f} deg the Earth's rate has next to"
            " no horizontal part: heading cannot be measured",
            "calibrate below 85 deg, or take lambda2 from the rate along the axis"
            f" ({_lambda2(result.axial.lambda2, result.axial.sigma_lambda2)})",
        )
    elif abs(result.latitude) > WARN_LATITUDE:
        yield _finding(
            "ok",
            f"at latitude {np.degrees(result.latitude):.1f} deg every error of heading is"
            f" {1.0 / np.cos(result.latitude):.1f} times that at the equator",
        )
    if len(result.rates) < 2 or result.rate_span < MIN_RATE_SPAN:
        rates = ", ".join(f"{np.degrees(r):.2f}" for r in result.rates)
        yield _finding(
            "error",
            f"the rates ({rates} deg/s) do not differ enough to determine a slope",
            "record at two rates or more, 10 deg/s apart at least; 20, 40 and 60 deg/s in"
            " both directions are good",
        )
    elif result.K is None:
        yield _finding(
            "error",
            "the runs do not determine the parameters of the fit",
            "add runs, or leave out the drift",
        )


def _lambda2(value: float, sigma: float | None) -> str:
    if sigma is None or not np.isfinite(sigma):
        return f"{value / ARCSEC:.3f} arcsec"
    return f"{value / ARCSEC:.3f} +- {sigma / ARCSEC:.3f} arcsec"


def _slope(result: HseFit) -> str:
    sigma = f" +- {result.sigma_K / ARCSEC:.1f}" if result.sigma_K is not None else ""
    return f"{(result.K or 0.0) / ARCSEC:.1f}{sigma} arcsec/(rad/s)"


def _unobservable(result: HseFit) -> Iterator[Finding]:
    if result.observable or result.K is None or result.method == "axial":
        return
    yield _finding(
        "unobservable",
        f"the axis leans to the east by {result.C23:.1e} rad only, less than"
        f" {max(MIN_C23, MIN_C23_SIGMAS * result.sigma_C23):.1e}: lambda2 does not show in"
        f" heading (slope {_slope(result)})",
        "tilt the base to the east or west by 5e-3 rad or more and repeat; by the rate along"
        f" the axis it is {_lambda2(result.axial.lambda2, result.axial.sigma_lambda2)}",
    )


def implied_delay(result: HseFit) -> float | None:
    """Delay of the encoder that would explain the slope beside the axial lambda2, s.

    Parameters
    ----------
    result : HseFit
        At one position, or with positions fitted without a delay.

    Returns
    -------
    float or None
        ``K - lambda2_axial C23 / (3 w cos L)``; None without a slope from headings and where a
        delay was fitted.
    """
    if result.delay is not None or result.lambda2_heading is None:
        return None
    gain = result.C23 / (3.0 * EARTH_RATE * np.cos(result.latitude))
    return float((result.lambda2_heading - result.axial.lambda2) * gain)


def _inconsistent(result: HseFit) -> Iterator[Finding]:
    z = result.z_consistency
    if z is None or not abs(z) > CONSISTENT or result.lambda2_heading is None:
        return
    # what the linear model leaves out is in headings only, and has a warning of its own
    difference = abs(result.lambda2_heading - result.axial.lambda2)
    if difference * (1.0 - CONSISTENT / abs(z)) < (second_order(result) or 0.0) * abs(
        result.axial.lambda2
    ):
        return
    message = (
        "lambda2 from headings,"
        f" {_lambda2(result.lambda2_heading, result.sigma_lambda2_heading)}, is not that from the"
        f" rate along the axis, {_lambda2(result.axial.lambda2, result.axial.sigma_lambda2)}"
        f" ({abs(z):.1f} sigma)"
    )
    delay = implied_delay(result)
    if delay is None:
        hint = (
            "a delay of the encoder is accounted for already; check that the base did not move,"
            " and encoder errors once a turn"
        )
    else:
        hint = (
            f"an encoder that is stale by {delay * 1e6:.1f} us would explain it: check"
            " [rig.encoder] delay_s and imu_stamp, or repeat with the base turned by 180 deg"
        )
    # A delay does not affect the axial value itself
    yield _finding("ok" if result.method == "axial" else "inconsistent_axial", message, hint)


def _insignificant(result: HseFit) -> Iterator[Finding]:
    if result.lambda2 is None or result.K is None:
        return
    if result.sigma_K is None:
        yield _finding(
            "not_significant",
            "there are too few runs to show their scatter, so the accuracy of lambda2 is unknown",
            "add repeats; applying it needs --force",
        )
        return
    if abs(result.K) >= SIGNIFICANT * result.sigma_K:
        return
    interval = ""
    if result.ci95_lambda2 is not None:
        low, high = (v / ARCSEC for v in result.ci95_lambda2)
        interval = f", 95 % interval {low:.3f} to {high:.3f} arcsec"
    yield _finding(
        "not_significant",
        f"lambda2 {_lambda2(result.lambda2, result.sigma_lambda2)}{interval} is not significant"
        " against its scatter: correcting with it may make headings worse",
        "add repeats, both directions of rotation, or more tilt, or use --method axial;"
        " applying it needs --force",
    )


def second_order(result: HseFit) -> float | None:
    """Relative error of the linear model from its neglected term: c Omega tilt / (2 w cos L)."""
    if result.lambda2 is None:
        return None
    c = abs(result.lambda2) / 3.0
    return float(0.5 * c * result.max_rate * result.tilt / (EARTH_RATE * np.cos(result.latitude)))


def _nonlinear(result: HseFit) -> Iterator[Finding]:
    if result.p_lof is not None and result.p_lof < P_LACK_OF_FIT:
        yield _finding(
            "nonlinear",
            f"heading is not linear in the rate (lack of fit: F = {result.F_lof:.1f},"
            f" p = {result.p_lof:.4f})",
            "look at the residuals for warming up or an outlying rate; interleave the"
            " rates in time",
        )
    beyond = second_order(result)
    if beyond is not None and beyond > SECOND_ORDER:
        yield _finding(
            "nonlinear",
            f"with this lambda2, rate and tilt the linear model errs by {100 * beyond:.1f} %",
            "calibrate the gyro's matrix again, or level the base better",
        )


def base_moves(result: HseFit) -> bool:
    """Whether the leans at one position differ by more than their own uncertainty."""
    pairs = zip(result.runs, result.run_fits, strict=True)
    used = [(fitted.position, run.C23, run.sigma_C23) for run, fitted in pairs if fitted.used]
    for position in {place for place, *_ in used}:
        here = np.array([row[1:] for row in used if row[0] == position])
        lean, sigma = here.T
        if not np.all(sigma > 0.0):
            return True
        weight = sigma**-2
        chi2 = float(weight @ (lean - np.average(lean, weights=weight)) ** 2)
        if len(lean) > 1 and special.chdtrc(len(lean) - 1, chi2) < P_LACK_OF_FIT:
            return True
    return False


def _remarks(result: HseFit) -> Iterator[Finding]:
    if result.C23_spread > C23_SPREAD and result.observable and base_moves(result):
        yield _finding(
            "ok",
            f"at one position the lean of the axis varies by {100 * result.C23_spread:.0f} %",
            "the base moves; each run is fitted with its own lean"
            if result.form == "regressor"
            else "the base moves; use the form that fits each run with its own lean",
        )
    tau, sigma = result.delay, result.sigma_delay
    if tau is not None and sigma is not None and abs(tau) > CONSISTENT * sigma:
        yield _finding(
            "ok",
            f"the encoder is stale by {tau * 1e6:.1f} +- {sigma * 1e6:.1f} us",
            "lambda2 is free of it, headings are not: add it to [rig.encoder] delay_s",
        )
    pairs = zip(result.runs, result.run_fits, strict=True)
    elsewhere = wrong_latitude([run for run, fitted in pairs if fitted.used])
    if elsewhere:
        yield _finding("ok", elsewhere, "check latitude_deg, and the units and axes of the rig")
    axial = result.axial
    if axial.drift:
        yield _finding(
            "ok",
            "the rate along the axis drifts, as gyros that warm up do, by"
            f" {axial.drift / ARCSEC:.2g} deg/h within a log; lambda2 from it, known to"
            f" {axial.sigma_lambda2 / ARCSEC:.2g} arcsec, allows for that, and the sigmas from"
            " headings include what it may have added",
            "let the gyros warm up, or take the rates in another order in each log",
        )
    if result.chi2 is not None and result.dof >= LEAST_DOF:
        times = float(np.sqrt(result.chi2 / result.dof))
        if times > SCATTER:
            yield _finding(
                "ok",
                f"the runs scatter {times:.1f} times as much as their own turns explain; the sigmas"
                " include it",
                "check that all logs are of one rig at one site: latitude_deg, the matrices and"
                " imu_stamp must hold for each of them",
            )
    if result.distribution == "turns":
        yield _finding(
            "ok",
            "as many runs as parameters: the deviations are from the scatter of turns alone",
            "add repeats",
        )


def judge(result: HseFit) -> Judgement:
    """Judge a calibration.

    Returns
    -------
    Judgement
        Remarks of the fit itself are among its findings as ``ok``.
    """
    findings = list(_extent(result))
    if result.method == "axial":
        # the rate along the axis needs neither slope nor horizontal Earth rate
        answer = "this concerns the headings, not the axial value"
        findings = [_finding("ok", one.text, answer) for one in findings]
    if not any(one.kind == "error" for one in findings):
        for judged in (_unobservable, _inconsistent, _insignificant, _nonlinear):
            findings += judged(result)
    findings += _remarks(result)
    findings += [_finding("ok", text) for text in result.warnings]
    return judgement(findings)
