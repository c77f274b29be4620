"""Stretches of a filter's run that are not reliable, whatever their sigmas."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sinstool.core.finding import Finding, Severity
from sinstool.core.timeline import SECOND
from sinstool.methods.ins_gnss.results import FilterEvent, GnssDiagnostics, UpdateColumns

TOGETHER_NS = 60 * SECOND  # stretches nearer to each other than this are merged
MOST_NAMED = 5
# Share of rejected fixes beyond which the filter is wrong, not the fixes.
MOST_REJECTED = 0.2
LEAST_FIXES = 20
# Squared innovations over their expectation, outside of which the sigmas are wrong.
LEAST_NIS, MOST_NIS = 0.05, 5.0
TOO_MANY_REJECTED = "fixes-disbelieved"
# A filter that has diverged between two fixes moves away from those that follow, and the changes of
# its innovations look like noise of so many times the receiver's variance. Of noise successive
# innovations are on both sides; so many in a row whose mean is this many times their scatter are
# not noise.
FAR_NOISIER, LEAST_RUN, ONE_SIDED = 100.0, 5, 3.0
# After many rejected fixes in a row one is used. If it was the fixes that were wrong, it is near.
# One so many sigmas away (squared, for each number of the fix), and by this share as far as the
# last that was rejected, did not come back to the filter: the filter's sigmas grew. Within a few
# seconds, those of a first turn, say, they grow as they should.
STILL_SIGMAS, STILL_SHARE, STILL_S = 3.0, 0.5, 5.0


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
        used. After a gap of the IMU sigmas say how little is known, which is a warning.
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
                f"from {(far.time_ns - first_ns) / SECOND:.1f} s on, the uncorrected navigation is"
                " too far off for a linear filter (more than 1 km or 1 deg): do not trust the"
                " solution from there on",
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
                TOO_MANY_REJECTED,
                f"{rejected} of {number} fixes were rejected, as they are further off than the"
                " sigmas of filter and receiver allow: do not trust the solution",
                Severity.LOST,
                "look at the other warnings; set --imu-grade, --gnss-noise-scale or --lever-arm",
                numbers={"rejected_share": rejected / number},
            )
        )
    if number >= LEAST_FIXES and np.isfinite(mean_nis) and not LEAST_NIS < mean_nis < MOST_NIS:
        small = mean_nis > 1.0
        findings.append(
            Finding(
                "sigmas-off",
                f"squared innovations are {mean_nis:.2g} times as large as expected: the sigmas of"
                " the solution are too " + ("small: do not trust them" if small else "large"),
                Severity.LOST if small else Severity.WARNING,
                "--gnss-noise-scale makes the fixes' sigmas " + ("larger" if small else "smaller"),
                numbers={"mean_nis": mean_nis},
            )
        )
    return findings


def doubts(
    gnss: GnssDiagnostics, events: Sequence[FilterEvent]
) -> list[tuple[int, int, np.ndarray]]:
    """Begin and end of the stretches that are lost, and the differences of filter and fixes there.

    Returns
    -------
    list of (int, int, ndarray)
        The last of shape (6,): the largest innovations of position and velocity, NED, m and m/s.
    """
    out = []
    for begin, end, gap in _stretches(gnss, events):
        far = gnss.gated | gnss.restarted | (gnss.noise_ratio[:, :2] > FAR_NOISIER).any(axis=1)
        inside = (gnss.time_ns >= begin) & (gnss.time_ns <= end) & far
        if not gap and inside.any():
            most = np.nan_to_num(np.abs(gnss.innovation[inside])).max(axis=0)
            out.append((begin, end, most))
    return out


def marked(
    updates: UpdateColumns, doubtful: Sequence[tuple[int, int, np.ndarray]]
) -> UpdateColumns:
    """Smoothed solutions with sigmas enlarged in the stretches of :func:`doubts`."""
    position = updates.covariance_position_n.copy()
    velocity = updates.covariance_velocity_n.copy()
    axis = np.arange(3)
    for begin, end, far in doubtful:
        inside = np.flatnonzero((updates.time_ns >= begin) & (updates.time_ns <= end))[:, None]
        position[inside, axis, axis] += far[:3] ** 2
        # Without velocities of the receiver: the drift of position over the stretch
        speed = np.maximum(far[3:], far[:3] / max((end - begin) / SECOND, 1.0))
        velocity[inside, axis, axis] += speed**2
    return replace(updates, covariance_position_n=position, covariance_velocity_n=velocity)


def _stretches(gnss: GnssDiagnostics, events: Sequence[FilterEvent]) -> list[tuple[int, int, bool]]:
    """Begin and end of the stretch before each restart, and whether an IMU gap caused it."""
    spans: list[tuple[int, int, bool]] = []
    for event in events:
        gap = event.kind in ("imu-gap-restart", "imu-gap-new-start")
        if gap:
            begin, end = event.time_ns, event.time_ns + round(event.size * SECOND)
        elif event.kind in ("restart", "covariance-lost"):
            begin = _last_accepted(gnss, event)
            end = event.time_ns
        else:
            continue
        spans.append((begin, end, gap))
    spans += [(begin, end, False) for begin, end in _to_one_side(gnss)]
    spans += [(begin, end, False) for begin, end in _still_far(gnss)]
    return _merged(sorted(spans))


def _merged(spans: Sequence[tuple[int, int, bool]]) -> list[tuple[int, int, bool]]:
    """The same, without overlaps, those near to each other as one."""
    merged: list[tuple[int, int, bool]] = []
    for begin, end, gap in spans:
        if merged and begin - merged[-1][1] < TOGETHER_NS:
            before = merged[-1]
            merged[-1] = (before[0], max(end, before[1]), before[2] and gap)
        else:
            merged.append((begin, end, gap))
    return merged


def _to_one_side(gnss: GnssDiagnostics) -> list[tuple[int, int]]:
    """Begin and end of stretches in which used fixes have far larger noise, all to one side."""
    rows = np.flatnonzero(np.isfinite(gnss.innovation[:, :2]).all(axis=1) & ~gnss.withheld)
    noisy = gnss.used[rows] & (gnss.noise_ratio[rows, :2] > FAR_NOISIER).any(axis=1)
    doubted = noisy | gnss.gated[rows]
    edges = np.flatnonzero(np.diff(doubted, prepend=False, append=False))
    spans = []
    for first, last in zip(edges[::2], edges[1::2] - 1, strict=True):
        run = rows[first : last + 1][noisy[first : last + 1]]
        if len(run) < LEAST_RUN:
            continue
        nu = gnss.innovation[run, :2]
        scatter = np.sqrt(0.5 * np.mean(np.square(np.diff(nu, axis=0)), axis=0))
        if np.any(np.abs(nu.mean(axis=0)) > ONE_SIDED * scatter):
            spans.append((int(gnss.time_ns[rows[first]]), int(gnss.time_ns[rows[last]])))
    return spans


def _still_far(gnss: GnssDiagnostics) -> list[tuple[int, int]]:
    """Begin and end of rejections that ended as sigmas grew, with a fix as far off as the others.

    They begin with the fix that was used last before.
    """
    rows = np.flatnonzero(np.isfinite(gnss.innovation[:, :2]).all(axis=1) & ~gnss.withheld)
    edges = np.flatnonzero(np.diff(gnss.gated[rows], prepend=False, append=False))
    spans = []
    for first, after in zip(edges[::2], edges[1::2], strict=True):
        if after - first < LEAST_RUN or after == len(rows):
            continue
        last, now = rows[after - 1], rows[after]
        if gnss.time_ns[now] - gnss.time_ns[rows[first]] < STILL_S * SECOND:
            continue
        far, still = np.linalg.norm(gnss.innovation[[last, now], :2], axis=1)
        if gnss.restarted[now] or gnss.nis[now] < STILL_SIGMAS * gnss.rows[now]:
            continue
        if still > STILL_SHARE * far:
            spans.append((int(gnss.time_ns[rows[max(first - 1, 0)]]), int(gnss.time_ns[now])))
    return spans


def _last_accepted(gnss: GnssDiagnostics, event: FilterEvent) -> int:
    """Time at which a fix was used last before a filter restarted.

    The fix with which it restarts counts as used too, and is valid a little before the time of the
    event. Only fixes of its kind count: separate velocities may be accepted all the while.
    """
    kind = np.asarray(np.isfinite(gnss.innovation[:, :3]).any(axis=1))
    anew = np.flatnonzero(gnss.restarted & (gnss.time_ns <= event.time_ns))
    accepted = gnss.used & ~gnss.restarted & (gnss.time_ns < event.time_ns)
    if len(anew) and event.kind == "restart":
        accepted &= kind == kind[anew[-1]]
    used = gnss.time_ns[accepted]
    return int(used[-1]) if len(used) else int(gnss.time_ns[0])


def _stretch(
    begin: int, end: int, gap: bool, first_ns: int, text: str = "the solution is not to be trusted"
) -> Finding:
    why = (
        "the IMU has a gap, after which the filter restarted"
        if gap
        else "fixes were far off, until the filter restarted or agreed with them again; if"
        " the fixes are right, the solution was already going wrong before"
    )
    seconds = [(time - first_ns) / SECOND for time in (begin, end)]
    return Finding(
        "not-trusted",
        f"{text} from {seconds[0]:.1f} to {seconds[1]:.1f} s: {why}",
        Severity.WARNING if gap else Severity.LOST,
        start_ns=begin,
        end_ns=end,
    )
