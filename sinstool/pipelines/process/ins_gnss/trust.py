"""Stretches of a filter's run that are not reliable, whatever their sigmas."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sinstool.core.finding import Finding, Severity
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.ins_gnss.receiver_offsets import MAX_SIGMA_S
from sinstool.methods.ins_gnss.results import FilterEvent, GnssDiagnostics, UpdateColumns
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.likeliest_attitude import denied_attitude
from sinstool.survey.course import RECEIVER_CLOCK

# What a latency may be off by, over the fixes' own noise, that is worth a warning.
WORSE_THAN_FIXES = 5.0
TOGETHER_NS = 60 * SECOND  # stretches nearer to each other than this are one
MOST_NAMED = 5
# Fixes that the gate may turn down before the filter, and not they, must be taken for wrong.
MOST_REJECTED = 0.2
LEAST_FIXES = 20
# Drift without fixes over its sigma: beyond this, options make the Imu better than it is.
MOST_DRIFT = 2.0
# An attitude is elsewhere with another latency or arm by more than so many sigmas, and this, rad.
# Sigmas hold what a wrong arm turns a filter by, not what it turns its start by.
MOST_TURNED, LEAST_TURNED, LEAST_BY_ARM = 4.0, 2.0 * DEGREE, 5.0 * DEGREE
# Velocities are so many times as noisy beside the Imu as beside the receiver's own positions.
MOST_UNEXPLAINED = 1.3
# Innovations squared over what was expected: beyond these the sigmas say nothing.
LEAST_NIS, MOST_NIS = 0.05, 5.0


def shift(seconds: float, positive: str, negative: str) -> str:
    """A time difference in words: its size, and a word for its sign."""
    return f"{abs(seconds):.3f} s {positive if seconds > 0.0 else negative}"


def untrusted(
    gnss: GnssDiagnostics, events: Sequence[FilterEvent], mean_nis: float, first_ns: int
) -> list[Finding]:
    """Stretches in which filter and fixes did not agree, and sigmas that mean little.

    Parameters
    ----------
    gnss : GnssDiagnostics
        Of the whole run.
    mean_nis : float
        Normalised innovation squared over its expectation, of the epochs used.
    first_ns : int
        Of the log: findings count seconds from there.

    Returns
    -------
    list of Finding
        Lost, where filter and fixes disagreed: the user has to look there before the solution is
        used. After a gap of the Imu sigmas say how little is known, which is a warning.
    """
    stretches = _stretches(gnss, events)
    findings = [_stretch(*span, first_ns) for span in stretches[:MOST_NAMED]]
    if len(stretches) > MOST_NAMED:
        rest = stretches[MOST_NAMED:]
        text = f"{len(rest)} more such stretches follow, the last"
        findings.append(_stretch(*rest[-1], first_ns, text))
    far = next((event for event in events if event.kind == "far-from-gnss"), None)
    if far is not None:
        findings.append(
            Finding(
                "too-far-uncorrected",
                f"from {(far.time_ns - first_ns) / SECOND:.1f} s on the uncorrected navigation is"
                " too far off for a linear filter (more than 1 km, or 1 deg): the solution is not"
                " to be trusted from there",
                Severity.LOST,
                "leave --feedback none out",
                start_ns=far.time_ns,
            )
        )
    compared = ~gnss.withheld & (gnss.rows > 0)
    number = int(np.count_nonzero(compared))
    rejected = int(np.count_nonzero(gnss.gated[compared]))
    if number >= LEAST_FIXES and rejected > MOST_REJECTED * number:
        findings.append(
            Finding(
                "fixes-disbelieved",
                f"{rejected} of {number} fixes were too far off for the sigmas"
                " of filter and receiver: do not trust the solution",
                Severity.LOST,
                "look at the first warnings; set --imu-grade, --gnss-noise-scale or --lever-arm",
                numbers={"rejected_share": rejected / number},
            )
        )
    if number >= LEAST_FIXES and np.isfinite(mean_nis) and not LEAST_NIS < mean_nis < MOST_NIS:
        large = "small" if mean_nis > 1.0 else "large"
        findings.append(
            Finding(
                "sigmas-off",
                f"squared innovations are {mean_nis:.2g} times as large as expected: the sigmas of"
                f" the solution are too {large}",
                answer="--gnss-noise-scale makes the fixes' sigmas "
                + ("larger" if mean_nis > 1.0 else "smaller"),
                numbers={"mean_nis": mean_nis},
            )
        )
    return findings


def late_or_early(largest_m: float, sigma_s: float, fix_sigma_m: float) -> list[Finding]:
    """Positions that an uncertain latency makes much less certain than the fixes are.

    Parameters
    ----------
    largest_m, sigma_s : float
        What the latency's sigma is worth at the highest speed, and that sigma.
    fix_sigma_m : float
        Of a fix.
    """
    if largest_m <= WORSE_THAN_FIXES * fix_sigma_m:
        return []
    return [
        Finding(
            "latency-uncertain",
            f"the log shows the latency of GNSS to {1e3 * sigma_s:.0f} ms only, by which positions"
            f" are up to {largest_m:.2g} m early or late (1 sigma), however good the fixes are",
            answer="give --gnss-latency",
            numbers={"sigma_s": sigma_s, "position_m": largest_m},
        )
    ]


def doubted_start(start: FilterStart, survey: Sequence[Finding]) -> list[Finding]:
    """What a log says against the start of a filter, its settings and its fixes.

    Parameters
    ----------
    survey : sequence of Finding
        About the log.
    """
    return [
        *drifts_too_far(start.drifts),
        *turned_by_offsets(start),
        *denied_attitude(start),
        *unexplained_velocities(start),
        *of_another_clock(survey, start),
    ]


def drifts_too_far(ratio: float) -> list[Finding]:
    """A drift without fixes that is far beyond what options say of the Imu.

    Parameters
    ----------
    ratio : float
        Drift over its sigma.
    """
    if ratio <= MOST_DRIFT:
        return []
    return [
        Finding(
            "imu-options",
            f"where fixes are left out the navigation drifts {ratio:.1f} times as far as the"
            " options about the Imu explain: attitude and its sigmas are not to be trusted",
            Severity.LOST,
            "leave --imu-grade, --imu-noise, --arw and --vrw out, or correct them",
            numbers={"drift_over_sigma": ratio},
        )
    ]


def turned_by_offsets(start: FilterStart) -> list[Finding]:
    """An attitude that fixes at a wrong time or place, by an option, have led elsewhere."""
    sigmas, angle = start.turned
    shown, settings = start.offsets, start.settings
    if shown is None or sigmas <= MOST_TURNED:
        return []
    if angle <= (LEAST_BY_ARM if shown.arm_contradicts else LEAST_TURNED):
        return []
    if shown.arm_contradicts:
        kind, option, value = "stated-lever-arm", "--lever-arm", "antenna's place"
        one = ",".join(f"{x:.2f}" for x in shown.arm_b.tolist()) + " m"
        other = ",".join(f"{x:.2f}" for x in settings.lever_arm_b) + " m"
    else:
        kind, option, value = "stated-latency", "--gnss-latency", "latency"
        one, other = (f"{1e3 * x:.0f} ms" for x in (shown.latency_s, settings.gnss_latency))
    return [
        Finding(
            kind,
            f"the {value} that the log shows, {one}, gives an attitude that is"
            f" {angle / DEGREE:.0f} deg ({sigmas:.0f} sigmas) from that by the {other} in use:"
            " attitude and its sigmas are not to be trusted",
            Severity.LOST,
            f"correct {option}",
            numbers={"attitude_deg": angle / DEGREE, "attitude_over_sigma": sigmas},
        )
    ]


def unexplained_velocities(start: FilterStart) -> list[Finding]:
    """Velocities that fit the receiver's own positions, and not the Imu."""
    if start.unexplained <= MOST_UNEXPLAINED:
        return []
    return [
        Finding(
            "velocities-do-not-fit",
            "beside the IMU the receiver's velocities are"
            f" {start.unexplained:.1f} times as noisy as its own positions allow, and neither a"
            " latency nor a lever arm that was tried explains it: attitude and its sigmas are not"
            " to be trusted",
            Severity.LOST,
            "check the clocks (--gnss-clock-offset, --gnss-latency), the axes and units of the IMU",
            numbers={"noise_ratio": start.unexplained},
        )
    ]


def of_another_clock(survey: Sequence[Finding], start: FilterStart) -> list[Finding]:
    """Fixes that another clock than the Imu's has stamped, where the motion does not say otherwise.

    Parameters
    ----------
    survey : sequence of Finding
        About the log.
    """
    clock = next((f for f in survey if f.kind == RECEIVER_CLOCK), None)
    shown = start.offsets
    if clock is None or (
        shown is not None
        and start.latency_status in ("found", "given")
        and shown.sigma_s <= MAX_SIGMA_S
        and not shown.latency_contradicts(start.settings.gnss_latency)
    ):
        return []
    return [
        Finding(
            "fixes-at-wrong-times",
            f"the fixes are used about {abs(clock.numbers['ahead_s']):.1f} s from when they were"
            " valid, if their clock is another than the Imu's: do not trust the solution",
            Severity.LOST,
            clock.answer,
        )
    ]


def doubts(
    gnss: GnssDiagnostics, events: Sequence[FilterEvent]
) -> list[tuple[int, int, np.ndarray]]:
    """Begin and end of the stretches that are lost, and how far filter and fixes were apart there.

    Returns
    -------
    list of (int, int, ndarray)
        The last of shape (6,): the largest innovations of position and velocity, NED, m and m/s.
    """
    out = []
    for begin, end, gap in _stretches(gnss, events):
        inside = (gnss.time_ns >= begin) & (gnss.time_ns <= end) & (gnss.gated | gnss.restarted)
        if not gap and inside.any():
            far = np.nan_to_num(np.abs(gnss.innovation[inside])).max(axis=0)
            out.append((begin, end, far))
    return out


def marked(
    updates: UpdateColumns, doubtful: Sequence[tuple[int, int, np.ndarray]]
) -> UpdateColumns:
    """Smoothed answers with sigmas enlarged for the doubts of :func:`doubts`."""
    position = updates.covariance_position_n.copy()
    velocity = updates.covariance_velocity_n.copy()
    axis = np.arange(3)
    for begin, end, far in doubtful:
        inside = np.flatnonzero((updates.time_ns >= begin) & (updates.time_ns <= end))[:, None]
        position[inside, axis, axis] += far[:3] ** 2
        # Without velocities of the receiver: what drifts so far within the stretch
        speed = np.maximum(far[3:], far[:3] / max((end - begin) / SECOND, 1.0))
        velocity[inside, axis, axis] += speed**2
    return replace(updates, covariance_position_n=position, covariance_velocity_n=velocity)


def _stretches(gnss: GnssDiagnostics, events: Sequence[FilterEvent]) -> list[tuple[int, int, bool]]:
    """Begin and end of the stretch before each restart, and whether an Imu gap caused it."""
    spans: list[tuple[int, int, bool]] = []
    for event in events:
        gap = event.kind in ("imu-gap-restart", "imu-gap-new-start")
        if gap:
            begin, end = event.time_ns, event.time_ns + round(event.size * SECOND)
        elif event.kind in ("restart", "covariance-lost"):
            used = gnss.time_ns[gnss.used & (gnss.time_ns < event.time_ns)]
            begin = int(used[-1]) if len(used) else int(gnss.time_ns[0])
            end = event.time_ns
        else:
            continue
        if spans and begin - spans[-1][1] < TOGETHER_NS:
            spans[-1] = (spans[-1][0], max(end, spans[-1][1]), spans[-1][2] and gap)
        else:
            spans.append((begin, end, gap))
    return spans


def _stretch(
    begin: int, end: int, gap: bool, first_ns: int, text: str = "the solution is not to be trusted"
) -> Finding:
    why = (
        "the Imu is silent, and the filter began anew"
        if gap
        else "fixes were rejected until the filter began anew"
    )
    seconds = [(time - first_ns) / SECOND for time in (begin, end)]
    return Finding(
        "not-trusted",
        f"{text} from {seconds[0]:.1f} to {seconds[1]:.1f} s: {why}",
        Severity.WARNING if gap else Severity.LOST,
        start_ns=begin,
        end_ns=end,
    )
