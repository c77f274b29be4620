"""Units that a log's values contradict, and samples that are of another kind than was said."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sinstool.config import InputOptions
from sinstool.core.finding import Finding, Severity
from sinstool.core.order_statistics import median
from sinstool.core.units import DEGREE, STANDARD_GRAVITY
from sinstool.survey.imu import Survey
from sinstool.survey.unit_evidence import (
    GRAVITY_SIZES,
    LEAST_MISFIT,
    accel_looks_like_g,
    degrees_look_like_radians,
    force_at_rest,
    gyro_looks_like_degrees,
    may_spin_fast,
    rests_under_gravity,
    turns_like_degrees,
)

# A specific force below this, m/s^2, does not contain gravity; increments over their intervals are
# within this share of gravity.
WEIGHTLESS = 0.8
INCREMENT = 0.05
# Rates of a moving vehicle that never exceed this, deg/s, are suspect; and the least variation of
# the mean specific force of half a second in motion, as a share of its size.
SLOW_DEG_S = 3.0
MOVING = 0.01
# Least range of gyros, deg/s; usual ones have 125 and more.
SMALLEST_RANGE_DEG_S = 70.0


def odd_units(s: Survey, options: InputOptions) -> Iterator[Finding]:
    """Units, and kinds of samples, that the values contradict; those given are not questioned."""
    if not s.gyro_max.any() and not s.accel_max.any():
        yield Finding(
            "all-zero",
            f"topic {s.topic} holds nothing but zeros",
            answer="choose another with --imu-topic",
            severity=Severity.FAILED,
        )
        return
    if _looks_like_rates(s, options):
        # What their size says of units is then wrong
        insists = options.accel_unit is not None
        force = s.specific_force_median
        yield Finding(
            "no-increments",
            f"topic {s.topic}: the specific force is {force:.3g} m/s^2 in size, or"
            f" {force / _rate(s, options):.2f} if samples are not increments over their intervals",
            answer="leave out --gyro-kind increment, or give --gyro-kind mean-rate"
            + ("" if insists else " (or --accel-unit m/s^2 if the log is right)"),
            severity=Severity.WARNING if insists else Severity.FAILED,
        )
        if not insists:
            return
    else:
        yield from _gyro_unit(s, options)
    if not rests_under_gravity(s.lead_in, s.spans):
        yield from _accel_unit(s, options)


def _gyro_unit(s: Survey, options: InputOptions) -> Iterator[Finding]:
    if options.gyro_unit == "deg/s":
        yield from _degrees(s)
    elif gyro_looks_like_degrees(s.gyro_unit, s.gyro_max):
        reason = _why_degrees(s)
        if options.gyro_unit is None:
            answer = "add --gyro-unit deg/s (or --gyro-unit rad/s if the log is right)"
            severity = Severity.FAILED
            if _saturates_in_radians(s):
                reason += (
                    f"; they are read as rad/s, as they saturate at {s.gyro_max.max():.3g}, and"
                    " hardly any gyro's range is as small as this in deg/s"
                )
                severity = Severity.WARNING
            elif not s.gyro_unit.surely_degrees:
                reason += "; they are read as rad/s, as rates of this size are usual in rad/s"
                severity = Severity.WARNING
            yield Finding(
                "gyro-unit", f"topic {s.topic}: {reason}", answer=answer, severity=severity
            )
        else:
            yield Finding("gyro-unit", f"topic {s.topic}: {reason}, read as rad/s as specified")
    elif options.gyro_unit is None and may_spin_fast(s.gyro_unit):
        yield Finding(
            "gyro-unit",
            f"topic {s.topic}: rates of {s.gyro_unit.rate:.2g} (RMS of half-second means) are read"
            " as rad/s, but gravity in the body shows as little of such a spin as of one in deg/s",
            answer="add --gyro-unit deg/s or --gyro-unit rad/s, whichever is right",
        )


def _why_degrees(s: Survey) -> str:
    """Why rates that look like deg/s do so."""
    if not turns_like_degrees(s.gyro_unit):
        return f"the rates reach {s.gyro_max.max():.0f}, which is too much for rad/s"
    if s.gyro_unit.misfit_radians > LEAST_MISFIT:
        return (
            "averaged over twenty seconds in axes that do not turn, the specific force"
            f" differs from gravity by {s.gyro_unit.misfit_radians:.0%} if the rates are"
            f" in rad/s, but by {s.gyro_unit.misfit_degrees:.1%} if they are in deg/s"
        )
    return (
        f"gravity turns in the body by {s.gyro_unit.scale:.2f} times the angle that the"
        " rates give if they are in deg/s (1 is right; rates in rad/s would give 57)"
    )


def _accel_unit(s: Survey, options: InputOptions) -> Iterator[Finding]:
    force = s.specific_force_median
    at_rest = force_at_rest(s.lead_in, s.spans)
    if accel_looks_like_g(force) and not at_rest < WEIGHTLESS:
        text = f"topic {s.topic}: the specific force is {force:.3f} in size, as in units of g"
        if options.accel_unit is None:
            yield Finding(
                "accel-unit",
                text,
                answer="add --accel-unit g (or --accel-unit m/s^2 if the log is right)",
                severity=Severity.FAILED,
            )
        elif options.accel_unit == "m/s^2":
            yield Finding("accel-unit", f"{text}, read as m/s^2 as specified")
    elif options.accel_unit is None and accel_looks_like_g(1e-3 * force):
        yield Finding(
            "accel-unit",
            f"topic {s.topic}: the specific force is {force:.0f} in size, as in units of mg or"
            " cm/s^2",
            answer="convert the log to m/s^2 (or add --accel-unit m/s^2 if it is right)",
            severity=Severity.FAILED,
        )
    elif _looks_like_increments(s, options):
        yield Finding(
            "increments",
            f"topic {s.topic}: the specific force is {force:.3g} m/s^2 in size, or"
            f" {force * _rate(s, options):.2f} if samples are increments over their intervals",
            answer="add --gyro-kind increment (or --accel-unit m/s^2 if the log is right)",
            severity=Severity.FAILED,
        )
    elif min(force, at_rest) < WEIGHTLESS and force < GRAVITY_SIZES[0]:
        # Motion alone may be as large as gravity in g is
        size = f"{force:.3f} m/s^2 in size"
        if force >= WEIGHTLESS:
            size = f"{at_rest:.3f} m/s^2 in size at rest"
        yield Finding(
            "no-gravity",
            f"topic {s.topic}: the specific force is only {size}, so the"
            " driver has removed gravity, or the data are empty",
            answer="it does not show the tilt; use --align log or --align fixed",
        )
    elif _odd_size(s):
        yield Finding(
            "gravity-size",
            f"topic {s.topic}: the specific force is mostly {force:.2f} m/s^2 in size, not 9.8",
            answer="check its unit with --accel-unit",
        )


def _saturates_in_radians(s: Survey) -> bool:
    """Whether gyros stop at a range that they have in rad/s, and none has in deg/s."""
    clipped = any(name.startswith("gyro") for name in s.saturated)
    return clipped and float(s.gyro_max.max()) < SMALLEST_RANGE_DEG_S


def usual_force(s: Survey) -> float:
    """Size of the specific force, m/s^2, as half a second shows it: the median."""
    return float(median(np.linalg.norm(s.windows.accel, axis=1)))


def steady_force(s: Survey) -> float:
    """Size of the specific force less what it varies by in half a second, m/s^2: the median."""
    windows = s.windows
    return float(median(np.linalg.norm(windows.accel, axis=1) - windows.accel_std))


def _odd_size(s: Survey) -> bool:
    """Whether the specific force is not of gravity's size.

    Vibration makes single samples larger, so the means of half a second count. What circles for
    minutes feels more than gravity: there the means of twenty seconds in axes that do not turn are
    of gravity's size.
    """
    usual = GRAVITY_SIZES[0] < usual_force(s) < GRAVITY_SIZES[1]
    return not (usual or s.gyro_unit.misfit_radians < LEAST_MISFIT)


def _degrees(s: Survey) -> Iterator[Finding]:
    """Whether rates that are read as deg/s, as the user says, can be that."""
    text = f"topic {s.topic}: rates are read as deg/s as specified, but "
    most = float(s.gyro_max.max()) / DEGREE
    if degrees_look_like_radians(s.gyro_unit):
        times = s.gyro_unit.scale * DEGREE
        answer = "leave out --gyro-unit unless the log is right"
        text += (
            f"gravity turns {times:.3g} times as far in the body as they say, so they seem to be in"
            " rad/s"
        )
        yield Finding("gyro-unit", text, answer=answer)
    elif most < SLOW_DEG_S and _moves(s):
        text += f"they never exceed {most:.2g} deg/s in a log that moves"
        yield Finding("gyro-unit", text, answer="leave out --gyro-unit if they are in rad/s")


def _moves(s: Survey) -> bool:
    """Whether the specific force varies as it does in motion."""
    size = np.linalg.norm(s.windows.accel, axis=1)
    return len(size) > 1 and float(np.std(size)) > MOVING * s.specific_force_median


def _rate(s: Survey, options: InputOptions) -> float:
    return s.rate_hz if options.imu_rate is None else options.imu_rate


def _looks_like_rates(s: Survey, options: InputOptions) -> bool:
    """Whether increments over their intervals must be specific forces, in m/s^2 or in g."""
    low, high = GRAVITY_SIZES
    if options.gyro_kind != "increment" or low < s.specific_force_median < high:
        return False
    force = s.specific_force_median / _rate(s, options)
    return low < force < high or accel_looks_like_g(force)


def _looks_like_increments(s: Survey, options: InputOptions) -> bool:
    """Whether the specific force read as such must be velocity gained from sample to sample."""
    if options.gyro_kind == "increment" or options.accel_unit is not None:
        return False
    if s.specific_force_median >= WEIGHTLESS:
        return False
    return abs(s.specific_force_median * _rate(s, options) / STANDARD_GRAVITY - 1.0) < INCREMENT
