"""Findings about what a smoothed attitude leaves open: tilt, biases of gyros, kinds of motion."""

from __future__ import annotations

from sinstool.core.english import in_seconds
from sinstool.core.finding import Finding, Severity
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.attitude_smoother.even_turn import EvenTurn
from sinstool.methods.attitude_smoother.missed_turn import MissedTurn
from sinstool.pipelines.process.summary import AttitudeSmoothing
from sinstool.survey.rest import REST_S

# Share of the time at the stops of a gyro beyond which the result is not to be trusted.
LOST_SHARE = 0.03
# Margin of a vehicle over a hand, nat per moving epoch, beyond that of any recorded hand or drone.
DENIED_MARGIN = 2.0


def diverged_finding() -> Finding:
    """Gravity and the gyros contradict each other."""
    return Finding(
        "diverged",
        "gravity and the gyros contradict each other in all of the log, so roll and pitch"
        " are those of the gyros alone: do not trust them",
        severity=Severity.LOST,
        answer="see what info says about units, axes and ranges",
    )


def missed_finding(missed: list[MissedTurn], first_ns: int, compassed: bool) -> Finding:
    """That gyros missed turns between rests: the largest, and how many there are.

    Parameters
    ----------
    missed : list of MissedTurn
        At least one.
    first_ns : int
        From which seconds of the log count.
    compassed : bool
        A magnetometer corrects heading.
    """
    worst = max(missed, key=lambda one: one.angle)
    begin, end = ((t - first_ns) / SECOND for t in (worst.start_ns, worst.end_ns))
    angle = worst.angle / DEGREE
    more = f" (the worst of {len(missed)} times)" if len(missed) > 1 else ""
    return Finding(
        "missed-turn",
        f"between the rests at {begin:.1f} and {end:.1f} s the gyros missed a turn of {angle:.0f}"
        f" deg or more, as gravity shows{more}: do not trust "
        + (
            "the attitude meanwhile"
            if compassed
            else "roll and pitch meanwhile, nor heading from then on"
        ),
        start_ns=worst.start_ns,
        end_ns=worst.end_ns,
        severity=Severity.LOST,
        answer="look for a gyro that hangs or saturates, a wrong scale or sign of an axis, or lost"
        " samples",
        numbers={"angle_deg": angle, "times": len(missed)},
    )


def uncertain_tilt_finding(smoothing: AttitudeSmoothing, worst_ns: int, first_ns: int) -> Finding:
    """A large sigma of tilt.

    Parameters
    ----------
    worst_ns, first_ns : int
        Time of the largest sigma, and of the first sample.
    """
    at = max(0.0, (worst_ns - first_ns) / SECOND)
    usual = f"{smoothing.tilt_sigma_deg:.2g} deg"
    most = f"{smoothing.tilt_sigma_largest_deg:.2g} deg"
    known = f"roll and pitch are known to {usual}"
    text = f"{known} only (1 sigma)"
    if most != usual:
        text = f"{known} (1 sigma, median), but only to {most} at {at:.1f} s"
    return Finding(
        "uncertain-tilt",
        text,
        start_ns=worst_ns,
        end_ns=worst_ns,
        numbers={"tilt_sigma_deg": smoothing.tilt_sigma_largest_deg},
    )


def long_turns_finding(share: float) -> Finding:
    """Long turns make up a share of a log without rest."""
    return Finding(
        "long-turns",
        f"{share:.0%} of the log are turns of half a minute and more, and"
        " no rest shows the gyro bias: such turns look like a bias, so roll and pitch may"
        " be off by several of their sigmas",
        answer="record some seconds at rest, or give --gyro-bias X,Y,Z",
        numbers={"share": share},
    )


def gyro_at_stop_finding(seconds: float, share: float) -> Finding:
    """A gyro is at the end of its range for some seconds, a share of the time."""
    lost = share > LOST_SHARE
    return Finding(
        "gyro-at-stop",
        f"a gyro is saturated for {in_seconds(seconds, 3)},"
        f" {100.0 * share:.2g} % of the time; the rotation beyond its"
        " range is lost" + (": do not trust the attitude" if lost else ""),
        severity=Severity.LOST if lost else Severity.WARNING,
        answer="use a gyro of a larger range",
        numbers={"gyro_at_stop_s": seconds, "share": share},
    )


def denied_motion_finding(margin_nat: float) -> Finding:
    """The motion of a vehicle that `--motion` calls that of a hand."""
    lost = margin_nat > DENIED_MARGIN
    off = "roll and pitch may be off by several of their sigmas"
    return Finding(
        "motion-denied",
        "the motion was taken for that of a hand, as --motion says, but a vehicle explains"
        f" it better, by {margin_nat:.2g} nat per moving epoch (0.4 is decisive): "
        + ("do not trust roll and pitch" if lost else off),
        severity=Severity.LOST if lost else Severity.WARNING,
        answer="leave --motion out",
        numbers={"margin_nat": margin_nat},
    )


def no_rest_finding(quiet_s: float, drift: str, heading_sigma_deg: float) -> Finding:
    """A log without a rest.

    Parameters
    ----------
    quiet_s : float
        Duration of the quietest part.
    drift : str
        By which heading may have drifted at the end.
    heading_sigma_deg : float
        The same as a number.
    """
    what = "the log has no rest of 2 s"
    if quiet_s >= REST_S:
        what = f"the quietest {quiet_s:.0f} s of the log are no sure rest"
    return Finding(
        "no-rest",
        f"{what}, so the gyro"
        " bias about the vertical is not observable: by the end heading may have"
        f" drifted by {drift}",
        answer="record some seconds at rest, or give --gyro-bias X,Y,Z",
        numbers={"heading_sigma_deg": heading_sigma_deg},
    )


def steady_rate_finding(rate: float) -> Finding:
    """A rate, rad/s, that a log shows nearly all the time."""
    return Finding(
        "steady-rate",
        f"the IMU shows a steady {rate / DEGREE:.2g} deg/s nearly all the time: either the"
        " gyro bias at rest, which is assumed, or a steady turn, and then roll and pitch"
        " are wrong by the angle between the specific force and the vertical",
        answer="give --gyro-bias X,Y,Z, or record other motion too",
        numbers={"rate_deg_s": rate / DEGREE},
    )


def even_turn_finding(turn: EvenTurn, first_ns: int, heading_sigma_deg: float) -> Finding:
    """A rest that may be an even turn.

    Parameters
    ----------
    first_ns : int
        Time of the first sample.
    heading_sigma_deg : float
        At the end of the log.
    """
    begin, end = ((time - first_ns) / SECOND for time in (turn.start_ns, turn.end_ns))
    rate = abs(turn.rate) / DEGREE
    return Finding(
        "steady-rate",
        f"from {max(begin, 0.0):.1f} to {end:.1f} s the IMU shows a steady {rate:.2g} deg/s about"
        " the vertical and hardly any rate across it: either a gyro bias at rest, or an even turn,"
        " which looks the same; by the end heading may have drifted by"
        f" {heading_sigma_deg:.2g} deg (1 sigma)",
        start_ns=turn.start_ns,
        end_ns=turn.end_ns,
        answer="give --gyro-bias X,Y,Z, or record some seconds at rest for sure",
        numbers={"rate_deg_s": rate, "heading_sigma_deg": heading_sigma_deg},
    )


def unsure_motion_finding(motion: str, margin_nat: float) -> Finding:
    """The motion of a hand or of a vehicle, where it could be the other one's."""
    other = "vehicle" if motion == "hand" else "hand"
    return Finding(
        "unsure-motion",
        f"the motion was taken for that of a {motion}, but might be that of a {other}:"
        " with the wrong choice roll and pitch can be degrees off",
        answer=f"choose with --motion {motion} or {other}",
        numbers={"margin_nat": margin_nat},
    )
