"""Settings that a filter took from the log, and options that its run contradicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.arrays import FloatArray
from sinstool.core.finding import Finding, Severity
from sinstool.core.units import DEGREE
from sinstool.methods.ins_gnss.filter import FilterSummary
from sinstool.methods.ins_gnss.offsets_error import OffsetsError
from sinstool.methods.receiver_priors import ARM_USUAL_M
from sinstool.pipelines.process.filter_used import LatencyUsed
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.receiver import USUAL_SIGMA_V

# An uncertainty of positions over the noise of a fix that is worth a warning.
WORSE_THAN_FIXES = 5.0
# Heading is worth a note if what is not known of the receiver adds more than this, rad, and more
# than all else. An option helps that leaves at most this part of its variance.
LEAST_HEADING, HALVED = 0.1 * DEGREE, 0.25
RECEIVER = {"--lever-arm": "the antenna's place", "--gnss-latency": "the latency of the fixes"}


def latency_used(start: FilterStart) -> LatencyUsed:
    """Latency of the fixes that was assumed, and its source."""
    offsets = start.offsets if start.offsets is not None and start.offsets.observable else None
    half = 0.5 * start.lag
    return LatencyUsed(
        status=start.latency_status,
        sigma_s=None if offsets is None else offsets.sigma_s,
        estimate_s=None if offsets is None else offsets.latency_s,
        position_s=start.settings.gnss_latency - half,
        velocity_s=start.settings.gnss_latency + half,
        clock_ppm=1e6 * start.clock.rate,
    )


def notes(
    start: FilterStart, summary: FilterSummary, config: ProcessConfig, added: OffsetsError
) -> list[Finding]:
    """Findings about settings that the filter took from the log, and about options not applied.

    Parameters
    ----------
    added : OffsetsError
        After it has added the errors of latency and lever arm to the whole solution.
    """
    findings: list[Finding] = []

    def note(kind: str, text: str, severity: Severity = Severity.WARNING) -> None:
        findings.append(Finding(kind, text, severity))

    settings = start.settings
    if summary.fell_back:
        note(
            "no-barometer",
            f"the log has no barometer, so {config.filter.filter} runs without its"
            f" damping network, as {summary.filter}",
            Severity.NOTE,
        )
    if (
        start.offsets is not None
        and start.latency_status == "found"
        and settings.gnss_latency != 0.0
    ):
        when = "" if start.clock.rate == 0.0 else " in the middle of the log"
        early, late_imu = -settings.gnss_latency, ""
        if early > 0.0:  # though receivers measure before they stamp
            late_imu = (
                ". If it is the IMU that is late (by a low-pass filter or buffering), the solution"
                f" shows the motion of {early:.3f} s before its own stamps"
            )
        note(
            "latency-used",
            f"fixes are used as valid {_shift(settings.gnss_latency, 'before', 'after')} their"
            f" stamps{when} (sigma {start.offsets.sigma_s:.4f} s), as the log shows; --gnss-latency"
            f" overrides this{late_imu}",
        )
    if start.clock.rate != 0.0:
        rate, sigma, span = 1e6 * start.clock.rate, 1e6 * start.clock.sigma, start.clock.span_s
        note(
            "clock-rate",
            f"the receiver's clock runs {'faster' if rate > 0.0 else 'slower'} than the IMU's by"
            f" {abs(rate):.1f} ppm (sigma {sigma:.1f}), {1e-3 * abs(rate) * span:.0f} ms in"
            f" {span:.0f} s, as the log shows: the stamps of fixes are corrected accordingly"
            " (--gnss-latency overrides this)",
        )
    moment = start.offsets_error
    if start.latency_status != "given":
        sigma = float(np.sqrt(moment[0, 0]))
        findings += late_or_early(added.largest_m, sigma, start.fix_sigma_m)
    arm_sigma = np.sqrt(np.diag(moment)[1:])
    if start.arm_status == "found":
        findings.append(_arm_used(settings.lever_arm_b, arm_sigma))
    elif start.arm_status == "open":
        uncertain = arm_sigma.max() > WORSE_THAN_FIXES * start.fix_sigma_m
        findings.append(_arm_open(arm_sigma) if uncertain else _arm_assumed())
    if start.offsets is not None:
        sigma, before = added.heading_added, added.heading_before
        findings += heading_open(moment, start.offsets.turned[2], sigma, before)
    if start.lag != 0.0 and config.filter.gnss_velocity_lag is None:
        note(
            "velocity-lag-used",
            f"the receiver's velocities are stamped {_shift(start.lag, 'later', 'earlier')}"
            " than its positions; each is used at its own time (--gnss-velocity-lag overrides"
            " this)",
        )
    if config.filter.filter == "plain-15":
        note(
            "white-fixes",
            "plain-15 treats errors of fixes as white noise and follows those that vary slowly,"
            " which another filter estimates: the sigmas of its positions allow for them, those of"
            " its velocities and attitude do not",
        )
    return findings


def late_or_early(largest_m: float, sigma_s: float, fix_sigma_m: float) -> list[Finding]:
    """A finding if an uncertain latency makes positions much less certain than the fixes.

    Parameters
    ----------
    largest_m, sigma_s : float
        Uncertainty of positions by the sigma of the latency, at the highest speed, m; that sigma,
        s.
    fix_sigma_m : float
        Of a fix, m.
    """
    if largest_m <= WORSE_THAN_FIXES * fix_sigma_m:
        return []
    return [
        Finding(
            "latency-uncertain",
            f"the log shows the latency of GNSS to {1e3 * sigma_s:.0f} ms only, which makes"
            f" positions uncertain by up to {largest_m:.2g} m (1 sigma) along the track, however"
            " good the fixes are",
            answer="give --gnss-latency",
            numbers={"sigma_s": sigma_s, "position_m": largest_m},
        )
    ]


def _arm_used(arm_b: tuple[float, float, float], sigma: np.ndarray) -> Finding:
    """A lever arm that was not given, but found in the log."""
    x, right, down = arm_b
    known = ", ".join(f"{value:.2f}" for value in sigma)
    return Finding(
        "lever-arm-used",
        f"the antenna is taken to be {x:.2f} m forward, {right:.2f} m right and {down:.2f} m down"
        f" of the IMU (+- {known}), as fixes move with the vehicle's turns; the sigmas of the"
        " solution include this uncertainty",
        answer="give --lever-arm if you know it",
        numbers={"forward_m": x, "right_m": right, "down_m": down},
    )


def _arm_open(sigma: np.ndarray) -> Finding:
    """A lever arm that is neither given nor found, with fixes that are better than it is known."""
    known = ", ".join(f"{value:.2g}" for value in sigma)
    return Finding(
        "lever-arm-uncertain",
        f"the log shows the antenna's place to {known} m only (forward, right, down; 1 sigma), and"
        " positions are uncertain by as much, however good the fixes are",
        answer="give --lever-arm (0,0,0 if the antenna is at the IMU)",
        numbers={
            "forward_m": float(sigma[0]),
            "right_m": float(sigma[1]),
            "down_m": float(sigma[2]),
        },
    )


def _arm_assumed() -> Finding:
    """A lever arm that is neither given nor found, beside fixes that are not much better."""
    return Finding(
        "lever-arm-assumed",
        "no lever arm is given, and the log does not show it: the antenna is taken to be within"
        f" about {ARM_USUAL_M:.0f} m of the IMU, and the position of the IMU is off by as much more"
        " as it is further away, on the mast of a ship, say",
        Severity.NOTE,
        "give --lever-arm",
    )


def heading_open(
    moment: FloatArray, turns: FloatArray, sigma: float, before: float
) -> list[Finding]:
    """A finding if heading would be known much better with the arm or the latency given.

    In turns, an antenna ahead of the IMU, late fixes and an error of heading look alike.

    Parameters
    ----------
    moment : ndarray, shape (4, 4)
        Second moments of the errors of latency and arm, of s and m.
    turns : ndarray, shape (4, 4)
        Mean products of the errors of heading by unit errors of these, rad^2 per product.
    sigma, before : float
        Sigma of heading, rad, by these errors and by all others.
    """
    if sigma <= max(before, LEAST_HEADING):
        return []
    latency, both, arm = moment[:1, :1], moment[:1, 1:], moment[1:, 1:]
    # What remains by the other one if one is exact
    left = {}
    if arm.any():
        late = latency - both @ np.linalg.pinv(arm) @ both.T
        left["--lever-arm"] = float(np.sum(turns[:1, :1] * late))
    if latency.any():
        away = arm - both.T @ both / latency
        left["--gnss-latency"] = float(np.sum(turns[1:, 1:] * away))
    enough = [option for option, square in left.items() if square <= HALVED * sigma**2]
    word, options = (" or ", enough) if enough else (" and ", [*left])
    unknown = word.join(RECEIVER[option] for option in options)
    return [
        Finding(
            "heading-by-receiver",
            f"heading is uncertain by {sigma / DEGREE:.2g} deg (1 sigma) for want of {unknown},"
            f" and by {before / DEGREE:.2g} deg for all other reasons",
            answer=f"give {word.join(options)}",
            numbers={"sigma_deg": sigma / DEGREE, "otherwise_deg": before / DEGREE},
        )
    ]


def about_options(
    findings: Sequence[Finding], start: FilterStart, config: ProcessConfig
) -> list[Finding]:
    """Findings of a diagnosis that concern an option, which the user can correct."""
    return [_completed(f, config) for f in findings if _matters(f, start, config)]


def _completed(finding: Finding, config: ProcessConfig) -> Finding:
    """A finding about IMU noise, with its other possible cause: too little noise of the fixes."""
    if finding.kind != "imu-noise" or config.filter.gnss_noise_scale >= 1.0:
        return finding
    more = "; or --gnss-noise-scale is too small"
    return replace(finding, answer=finding.answer + more)


def _matters(finding: Finding, start: FilterStart, config: ProcessConfig) -> bool:
    gnss, options = config.gnss, config.filter
    if finding.kind == "latency":
        return start.latency_status == "given"
    if finding.kind == "gnss-noise" and finding.numbers["sigma_ratio"] < 1.0:
        # Receivers that filter their fixes state more than the remaining noise
        stated = options.gnss_sigma is not None or gnss.gnss_sigma_v != USUAL_SIGMA_V
        return stated or options.gnss_noise_scale > 1.0
    return True


def _shift(seconds: float, positive: str, negative: str) -> str:
    """A time difference in words: its size, and a word for its sign."""
    return f"{abs(seconds):.3f} s {positive if seconds > 0.0 else negative}"
