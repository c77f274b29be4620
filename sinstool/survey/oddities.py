"""Anomalies of a log, in words, each with the option that deals with it.

`info` lists all of them; `process` refuses a log with one that would make its result wrong, and
repeats the others as warnings.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain

import numpy as np

from sinstool.config import InputOptions
from sinstool.core.english import counted, counted_clause, in_seconds
from sinstool.core.finding import Finding, Severity
from sinstool.core.timeline import SECOND
from sinstool.core.units import STANDARD_GRAVITY
from sinstool.io.readers.frames import turn_body
from sinstool.io.readers.streams import LARGEST
from sinstool.survey.imu import CONFLICTING, Survey
from sinstool.survey.no_measurements import LeftOut
from sinstool.survey.odd_units import odd_units
from sinstool.survey.stuck_axes import longest
from sinstool.survey.two_sensors import finding as of_two_sensors

MIN_RATE_HZ = 10.0
CLOCK_OFFSET_S = 1.0
CLOCK_WANDER_S = 0.5
HELD_SHARE = 0.05
SATURATION = "saturation"  # of findings
# Least mean specific force of a log in motion that shows the direction of gravity, g.
LEAST_GRAVITY = 0.7
# Relative difference of --imu-rate from the rate of the stamps that is reported.
OTHER_RATE = 0.05
# Share of the samples of a rate that a log holds at least, and at most; and of its length by which
# stamps and times of recording may differ.
FEWEST_TAKEN, MOST_TAKEN = 0.25, 1.5
OTHER_CLOCK = 0.2


def oddities(survey: Survey, options: InputOptions) -> list[Finding]:
    """All anomalies of a survey, the fatal ones first.

    Parameters
    ----------
    options : InputOptions
        Units and axes; those that the user gave are not questioned.
    """
    odd = chain(
        odd_units(survey, options),
        _rate(survey, options),
        _stamps(survey),
        _order(survey),
        _gaps(survey, options),
        _clocks(survey),
        _values(survey, options),
    )
    findings = (replace(one, topic=survey.topic) for one in odd)
    return sorted(findings, key=lambda one: one.severity != Severity.FAILED)


def _rate(s: Survey, options: InputOptions) -> Iterator[Finding]:
    """Samples that are too few, or at another rate than the user says."""
    if s.count > 1 and s.rate_hz < MIN_RATE_HZ and options.imu_rate is None:
        yield Finding(
            "slow-imu",
            f"topic {s.topic} has {s.rate_hz:.3g} samples a second, too few to integrate"
            f" (at least {MIN_RATE_HZ:.0f} are needed)",
            answer="record it faster, or choose a faster topic with --imu-topic; if the stamps are"
            " wrong, give the true rate with --imu-rate",
            severity=Severity.FAILED,
        )
    given = options.imu_rate
    if given is not None and s.count > 1 and abs(given / s.rate_hz - 1.0) > OTHER_RATE:
        denied = _deny(s, given)
        yield Finding(
            "other-rate",
            f"--imu-rate is {given:.6g} Hz, but the stamps of topic {s.topic} show"
            f" {s.rate_hz:.6g} Hz: if they are right, rotations come out"
            f" {s.rate_hz / given:.3g} times as large as they are"
            + (", and times of recording say so too: do not trust the result" * denied),
            severity=Severity.LOST if denied else Severity.WARNING,
            answer="leave --imu-rate out, unless the stamps are wrong",
            numbers={"rate_hz": s.rate_hz},
        )
    if s.count == 1:
        yield Finding("one-sample", f"topic {s.topic} has only one usable sample")


def _deny(s: Survey, rate_hz: float) -> bool:
    """Whether so many samples cannot be those of a sensor with this rate, by two clocks.

    A log may lack samples, but not hold more than there were.
    """
    seconds, (low, high) = (s.last_ns - s.first_ns) / SECOND, s.clock_offset_s
    if high - low > OTHER_CLOCK * seconds:
        return False
    taken = s.count / (rate_hz * max(seconds, s.interval_ns / SECOND))
    return not FEWEST_TAKEN < taken < MOST_TAKEN


def _stamps(s: Survey) -> Iterator[Finding]:
    """Clocks that were set, and stamps that are no times of the samples."""
    yield from s.clock_steps
    if s.time_source == "log":
        yield Finding("time-source", f"{s.time_note}, so the recorder's log times are used instead")
    if s.bursty:
        yield Finding(
            "bursts",
            "stamps come in bursts (intervals from"
            f" {s.interval_range_ns[0] / 1e6:.3g} to {s.interval_range_ns[1] / 1e6:.3g} ms)",
            answer="if the sensor samples evenly, give its rate with --imu-rate",
        )
    if s.even is not None:
        yield Finding(
            "uneven-stamps",
            f"stamps differ by {s.even.jitter_ns / 1e6:.2g} ms (1 sigma) from even times, like"
            " stamps set on receipt: the samples are taken as evenly spaced,"
            f" {s.even.usual_ns / 1e6:.6g} ms apart",
            answer="if they were taken at their stamps, use --imu-stamps kept",
        )


def _order(s: Survey) -> Iterator[Finding]:
    """Samples that were not recorded once each, one after another."""
    o = s.order
    if o.backward:
        yield Finding(
            "backward-stamps",
            f"{counted(o.backward, 'sample')} stamped earlier than the one before, by up to"
            f" {in_seconds(o.lateness_ns / 1e9, 3)}: put in order",
        )
    if o.duplicates:
        lost = o.differing_duplicates > CONFLICTING * (s.count + o.duplicates)
        yield Finding(
            "duplicate-stamps",
            f"{counted_clause(o.duplicates, 'sample', 'repeats', 'repeat')} a stamp"
            f" ({o.differing_duplicates} with other values); left out",
            severity=Severity.LOST if lost else Severity.WARNING,
            answer="give --imu-rate if stamps are too coarse for the rate, and check whether two"
            " IMUs publish on this topic"
            if lost
            else "",
        )
    if o.late:
        yield Finding(
            "late-samples",
            f"{counted(o.late, 'sample')} came too late in the file to be sorted; left out",
            Severity.LOST,
        )


def _gaps(s: Survey, options: InputOptions) -> Iterator[Finding]:
    """Intervals without samples."""
    if options.max_gap is not None and 2 * s.gap_count > s.count:
        yield Finding(
            "short-max-gap",
            f"topic {s.topic}: with --max-gap {options.max_gap:g} most of the log would be gaps, as"
            f" samples are {s.interval_ns / 1e6:.4g} ms apart",
            answer="give the longest interval to integrate across, in seconds, or leave it out",
            severity=Severity.FAILED,
        )
    elif s.gap_count:
        yield found_gaps(s, s.max_gap_ns)
    if s.missed:
        yield Finding(
            "missed-samples",
            f"samples are missing at {counted(s.missed, 'place')}; they are integrated across",
        )


def _clocks(s: Survey) -> Iterator[Finding]:
    """The recorder's clock beside that of the stamps."""
    low, high = s.clock_offset_s
    if max(abs(low), abs(high)) > CLOCK_OFFSET_S:
        ends = list(dict.fromkeys(f"{end:+.3f}" for end in (low, high)))
        yield Finding(
            "clock-offset",
            f"log time is {' to '.join(ends)} s from the header stamps: two clocks;"
            " stamps are used",
        )
    elif high - low > CLOCK_WANDER_S:
        yield Finding(
            "clock-wander", f"log time less header stamp varies from {low:+.3f} to {high:+.3f} s"
        )


def found_gaps(s: Survey, across_ns: int | None = None) -> Finding:
    """The gaps of an IMU.

    Parameters
    ----------
    across_ns : int, optional
        Gaps up to this long are integrated across; by default nothing is said of that, as it is
        for a run to decide.
    """
    longest = max(length for _, length in s.gaps)
    limit = f"longer than {s.max_gap_ns / 1e6:.4g} ms"
    text, them = f"a gap of {in_seconds(longest)} ({limit})", "it"
    if s.gap_count > 1:
        text = f"{s.gap_count} gaps {limit}, {in_seconds(s.gap_total_s)} in all, the longest"
        text, them = f"{text} {in_seconds(longest)}", "them"
    if across_ns is None:
        return Finding("gaps", text)
    # At most the longest gaps are listed
    short = s.gap_count - sum(1 for _, length in s.gaps if SECOND * length > across_ns)
    if short == s.gap_count:
        return Finding("gaps", f"{text}; short enough to be integrated across")
    if short:
        them = f"those longer than {across_ns / 1e6:.4g} ms"
    return Finding("gaps", f"{text}; nothing is integrated across {them}")


def no_measurements(out: LeftOut | None) -> Iterator[Finding]:
    """Findings about samples that were left out, as they are no measurements."""
    if out is None:
        return
    if out.hung:
        yield Finding(
            "imu-hangs",
            f"{counted(out.hung, 'sample')} left out: all zero, or the same six values several"
            " times before a leap, as the sensor or its driver hung",
            numbers={"samples": out.hung},
        )
    if out.wrong:
        yield Finding(
            "wrong-values",
            f"in {counted(out.wrong, 'sample')} a value leaps far off those before and after, as no"
            " motion does, but an error of transmission; left out",
            numbers={"samples": out.wrong},
        )
    if out.stuck:
        yield Finding(
            "axis-hangs",
            f"axes repeat one value while others measure on: {longest(out.stuck)};"
            " all samples meanwhile were left out",
            numbers={"samples": sum({one.last_ns: one.count for one in out.stuck}.values())},
        )


def _values(s: Survey, options: InputOptions) -> Iterator[Finding]:
    if s.losses.malformed:
        yield Finding(
            "malformed",
            f"{counted_clause(s.losses.malformed, 'message', 'does', 'do')} not fit the definition"
            f" ({s.losses.problem}); left out",
            severity=Severity.LOST,
        )
    if s.losses.nonfinite:
        yield Finding(
            "not-finite",
            f"{counted_clause(s.losses.nonfinite, 'sample', 'holds', 'hold')} NaN, infinity or more"
            f" than {LARGEST:.0e}; left out",
            severity=Severity.LOST,
        )
    yield from no_measurements(s.left_out)
    if s.two_sensors:
        yield of_two_sensors(s.topic, s.two_sensors)
    if s.dead_axes:
        yield Finding(
            "axis-dead",
            f"{' and '.join(s.dead_axes)}: the same value in every sample, while all other axes"
            " show noise: do not trust what is computed without this axis",
            severity=Severity.LOST,
            answer="choose another topic with --imu-topic, or mend the driver",
        )
    held = s.held - _without_noise(s)
    if held > HELD_SHARE * s.count:
        yield Finding(
            "held",
            f"{held / s.count:.0%} of the samples repeat the values of the one before:"
            " the topic is published faster than the sensor measures",
        )
    if s.saturated:
        yield Finding(
            SATURATION,
            f"{', '.join(s.saturated)} stays at its largest value for several samples:"
            " the motion exceeds the sensor's range",
        )
    yield from _orientation(s)
    yield from _axes(s, options)


def _axes(s: Survey, options: InputOptions) -> Iterator[Finding]:
    """Axes that gravity, or the name of the frame, denies."""
    usual, other = ("+z", "frd") if options.body_axes == "flu" else ("-z", "flu")
    if s.lead_in is not None:
        when, accel = "at rest", s.lead_in.accel
    else:
        when, accel = "in the mean of the log", s.windows.count @ s.windows.accel / s.count
        if np.linalg.norm(accel) < LEAST_GRAVITY * STANDARD_GRAVITY:
            return
    axis = gravity_axis(accel, options.body_axes)
    named = s.frame_id.lower().endswith(other)
    if axis not in ("", usual):
        turned = axis[1] == "z" or named
        yield Finding(
            "gravity-axis",
            f"{when} the accelerometer reads gravity on {axis} of the sensor, not on {usual}"
            + (f", and its frame_id is {s.frame_id}" if named else ""),
            answer=f"add --body-axes {other} unless the sensor is mounted that way"
            if turned
            else "fine if the sensor is mounted that way: the attitude is the sensor's own",
        )
    elif named:
        yield Finding(
            "frame-axes",
            f"the frame_id of topic {s.topic} is {s.frame_id}, but its axes are read as"
            f" {options.body_axes}",
            answer=f"add --body-axes {other} if the name is right about the axes",
        )


def _without_noise(s: Survey) -> int:
    """Samples at rest of a sensor that has no noise at all: simulated, not held."""
    still = s.lead_in
    if still is None or still.gyro_std > 0.0 or still.accel_std > 0.0:
        return 0
    return min(still.samples, s.held)


def _orientation(s: Survey) -> Iterator[Finding]:
    if s.orientation_constant:
        placeholder = ": the identity, a placeholder" if s.orientation is None else ""
        yield Finding(
            "constant-orientation",
            f"the orientation in topic {s.topic} is the same in every message{placeholder}",
        )
    fault = s.orientation_fault
    if fault is not None:
        yield Finding(
            "orientation-turns" if fault.tilt_deg is None else "orientation-tilt",
            f"the orientation in topic {s.topic} {fault.text}; it is not used",
        )


def gravity_axis(accel_frd: np.ndarray, body_axes: str) -> str:
    """Axis of the log's sensor that reads gravity at rest, as '+z'; '' when it is oblique.

    Parameters
    ----------
    accel_frd : ndarray, shape (3,)
    body_axes : {'flu', 'frd'}
    """
    accel = turn_body(accel_frd, body_axes)
    size = float(np.linalg.norm(accel))
    k = int(np.argmax(np.abs(accel)))
    if size == 0.0 or abs(accel[k]) < 0.9 * size:
        return ""
    return f"{'+' if accel[k] > 0 else '-'}{'xyz'[k]}"
