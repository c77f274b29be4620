"""Findings about measured noise: which parts are missing, and which may not be noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import sqrt

import numpy as np

from sinstool.core.english import in_seconds
from sinstool.core.finding import Finding, Severity
from sinstool.core.units import DEGREE, DEGREE_PER_ROOT_HOUR, STANDARD_GRAVITY
from sinstool.methods.allan.fit import NoiseData
from sinstool.methods.allan.likelihood import NoiseFit
from sinstool.pipelines.allan.collect import Collected
from sinstool.pipelines.allan.result import Axis, Rest
from sinstool.survey.odd_units import WEIGHTLESS
from sinstool.survey.unit_evidence import GRAVITY_SIZES

# Gyros have less angular random walk than this, rad/sqrt(s).
NOISIEST_GYRO = 5.0 * DEGREE_PER_ROOT_HOUR
# Time constants with which a rate may settle, as shares of the longest rest, and after how many of
# them it has; how much deviance that has to explain, of which noise alone explains 25 hardly ever.
SETTLING = (0.01, 0.03, 0.1)
SETTLED = 4.0
WARMING = 25.0
BEYOND_WHITE = 4.0
LEAST_BLOCKS = 64
# Noise of less than this share of a step is mostly rounding, unless single samples deviate by more
# than this many times it: they are counts of an angle.
COARSE, ANGLE = 0.5, 2.0
# Shaking that is more than this share of the rest is worth a word.
SHAKEN = 0.01


def findings(
    axes: Sequence[Axis],
    fits: Sequence[NoiseFit | None],
    data: NoiseData,
    rest: Rest,
    at_rest: Collected,
    force: float,
) -> list[Finding]:
    """All findings about the noise of the axes.

    Parameters
    ----------
    force : float
        Size of the specific force at rest, m/s^2.
    """
    return [
        *_unusable(axes),
        *_units(axes),
        *_gravity(axes, force),
        *_hidden(axes, rest),
        *_drift(axes),
        *_warming(axes, fits, data, at_rest),
        *_coarse(axes, at_rest),
        *_misfits(axes, rest),
        *_shaken(rest),
        *_swaying(rest),
    ]


def _names(axes: Sequence[Axis]) -> str:
    """Axes in words, the letters of a sensor together."""
    words = {"gyro": "gyro", "accel": "accelerometer"}
    parts = []
    for sensor, word in words.items():
        letters = [axis.axis for axis in axes if axis.sensor == sensor]
        if letters:
            parts.append(f"{word} {', '.join(letters)}")
    return " and ".join(parts)


def _unusable(axes: Sequence[Axis]) -> Iterator[Finding]:
    said = {
        "dead": "never changes: dead, or not connected, and its noise is not measured",
        "clipped": "stays at one end of its range, where it is cut off; its noise is not measured",
        "too-short": "has too few samples at rest for its noise",
    }
    answers = {
        "dead": "what is written is of the other axes",
        "clipped": "let the IMU lie on another side, or choose a larger range",
        "too-short": "record it lying still for longer",
    }
    for status, text in said.items():
        which = [axis for axis in axes if axis.status == status]
        if which:
            yield Finding(
                f"{status}-axis", f"{_names(which)} {text}", Severity.LOST, answers[status]
            )


def _units(axes: Sequence[Axis]) -> Iterator[Finding]:
    """A gyro at rest does not show its unit by turning; its noise may."""
    walks = [
        white.value
        for axis in axes
        if axis.sensor == "gyro" and (white := axis.coefficients.get("white")) and white.value
    ]
    if walks and min(walks) > NOISIEST_GYRO:
        shown = min(walks) / DEGREE_PER_ROOT_HOUR
        text = f"the gyro's noise is at least {shown:.3g} deg/sqrt(h), more than any gyro has"
        answer = "if its rates are in deg/s, give --gyro-unit deg/s"
        yield Finding("gyro-noise", text, answer=answer, numbers={"arw_deg_sqrt_h": shown})


def _gravity(axes: Sequence[Axis], force: float) -> Iterator[Finding]:
    """An accelerometer at rest feels gravity alone: another size is another unit, of its noise too.

    Where there is none a driver has removed it, and noise is still noise.
    """
    measured = [a for a in axes if a.sensor == "accel" and a.status == "measured"]
    low, high = GRAVITY_SIZES
    if len(measured) == 3 and force > WEIGHTLESS and not low < force < high:
        text = (
            f"the specific force at rest is {force:.3g} m/s^2, not {STANDARD_GRAVITY:.2f}: do not"
            " trust the accelerometer's noise, which is wrong by the same factor"
        )
        answer = "check --accel-unit"
        yield Finding("gravity-size", text, Severity.LOST, answer, numbers={"force_m_s2": force})


def _hidden(axes: Sequence[Axis], rest: Rest) -> Iterator[Finding]:
    """Sensors whose rest was too short to show how the bias wanders."""
    without = []
    for sensor, word in (("gyro", "gyro"), ("accel", "accelerometer")):
        measured = [a for a in axes if a.sensor == sensor and a.status == "measured"]
        slow = [
            a for a in measured if any(a.coefficients[t].value for t in ("flicker", "random_walk"))
        ]
        if measured and not slow:
            without.append(word)
    if without:
        text = (
            f"{' and '.join(without)}: neither bias instability nor random walk is visible in"
            f" {in_seconds(rest.longest_s)} of rest without a gap; the file holds bounds for them"
        )
        answer = "record for longer at rest if a filter needs more than bounds"
        yield Finding("short-rest", text, answer=answer, numbers={"longest_s": rest.longest_s})


def _drift(axes: Sequence[Axis]) -> Iterator[Finding]:
    which = [a for a in axes if "ramp" in a.coefficients and a.coefficients["ramp"].value]
    if which:
        text = f"{_names(which)} drift steadily over the rest, as in a changing temperature"
        answer = "let the IMU warm up and record again, or leave its beginning out with --start"
        yield Finding("drift", text, answer=answer)


def _warming(
    axes: Sequence[Axis], fits: Sequence[NoiseFit | None], data: NoiseData, at_rest: Collected
) -> Iterator[Finding]:
    """Axes whose rate settles over the longest rest as no noise does."""
    longest = int(np.argmax([len(phases) for phases in at_rest.phases]))
    blocks = len(at_rest.phases[longest]) - 1
    if blocks < LEAST_BLOCKS:
        return
    which, slowest = [], 0.0
    for column, (axis, fit) in enumerate(zip(axes, fits, strict=True)):
        if fit is None or not _apart(at_rest.phases[longest][:, column]):
            continue
        gains = []
        for share in SETTLING:
            curve = [np.zeros(len(phases)) for phases in at_rest.phases]
            curve[longest] = -np.expm1(-np.arange(blocks + 1) / (share * blocks))
            gains.append(data.gain(column, curve))
        if max(gains) > WARMING:
            which.append(axis)
            slowest = max(slowest, SETTLING[int(np.argmax(gains))])
    if which:
        seconds = SETTLED * slowest * blocks * at_rest.block * at_rest.interval
        text = f"{_names(which)} settle at first: the IMU was warming up"
        answer = f"leave about {seconds:.2g} s of that rest out with --start"
        yield Finding("warm-up", text, answer=answer)


def _apart(phase: np.ndarray) -> bool:
    """Whether the beginning lies beyond white noise: only then a closer look is worth its time."""
    count = len(phase) - 1
    first, half = max(count // 10, 1), count // 2
    contrast = (phase[first] - phase[0]) / first - (phase[-1] - phase[half]) / (count - half)
    white = float(np.mean(np.diff(phase[half:], 2) ** 2)) / 2.0
    return abs(contrast) > BEYOND_WHITE * sqrt(white * (1.0 / first + 1.0 / (count - half)))


def _coarse(axes: Sequence[Axis], at_rest: Collected) -> Iterator[Finding]:
    """Axes whose values seldom change, as rounding hides most of the noise.

    Counts of an angle do not: they change with its mean rate, and their sum is the angle.
    """
    which, least = [], np.inf
    for axis, step in zip(axes, at_rest.step, strict=True):
        white = axis.coefficients.get("white")
        if white is None or white.value is None:
            continue
        sigma = white.value / sqrt(at_rest.interval)
        if sigma < COARSE * step and float(axis.deviation[0]) < ANGLE * sigma:
            which.append(axis)
            least = min(least, sigma / float(step))
    if which:
        text = (
            f"{_names(which)}: values are rounded to steps of up to {1.0 / least:.2g} times the"
            " noise that is left in them; that of the sensor itself, which rounding hides or"
            " enlarges, may be several times as large or as small"
        )
        answer = "choose a smaller range, or take the data sheet's noise"
        yield Finding("coarse", text, answer=answer, numbers={"noise_in_steps": least})


def _misfits(axes: Sequence[Axis], rest: Rest) -> Iterator[Finding]:
    which = [a for a in axes if a.misfit > 1.0]
    if which:
        worst = max(a.misfit for a in which)
        text = (
            f"{_names(which)}: the curve has more than these terms in it (it scatters by"
            f" {np.sqrt(worst):.2g} times what they allow); the intervals are widened accordingly"
        )
        answer = "something shook or turned the IMU, or its temperature changed"
        yield Finding("misfit", text, answer=answer, numbers={"misfit": worst})
    late = [a for a in axes if a.status == "measured" and a.from_s > 1.5 * rest.interval_s]
    if late:
        longest = max(a.from_s for a in late)
        text = (
            f"{_names(late)}: averaging times below {in_seconds(longest, 3)} are left out of"
            " the fit: the sensor filters or counts its output, repeats samples, or hums"
        )
        yield Finding("filtered", text, Severity.NOTE, numbers={"from_s": longest})


def _shaken(rest: Rest) -> Iterator[Finding]:
    if rest.shaken_s > SHAKEN * rest.total_s:
        text = f"{rest.shaken_s:.1f} s of rest are left out, as they are louder than the others"
        yield Finding("shaken", text, Severity.NOTE, numbers={"shaken_s": rest.shaken_s})


def _swaying(rest: Rest) -> Iterator[Finding]:
    if rest.sway_rad_s > 0.0:
        shown = rest.sway_rad_s / DEGREE
        text = (
            f"the IMU sways at rest, by {shown:.2g} deg/s rms: gravity turns with the gyro's"
            " readings, so slow terms may come from that motion, not from the sensor"
        )
        answer = "let it lie on firm ground"
        yield Finding("sway", text, answer=answer, numbers={"sway_deg_s": shown})
