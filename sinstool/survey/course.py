"""The gyro compared with the course over ground: unit and sign of its rates.

A vehicle that follows its nose turns as its course does. A car hardly tilts, so gravity, which
:mod:`~sinstool.survey.unit_evidence` uses, does not show the unit of its rates; its turns do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sinstool.config import InputOptions
from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.earth import horizontal_metres
from sinstool.core.finding import Finding, Severity
from sinstool.core.rotation import wrapped
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.alignment.still import WINDOW_NS, Windows

# Turns of the course are compared over intervals of about the first length, s, and at most the
# second.
STEP_S, LONGEST_S = 2.0, 5.0
# The least speed with a course, m/s, and in sigmas of the velocity.
SLOWEST, SIGMAS = 3.0, 5.0
# With positions alone: shortest step between two of them, m.
SHORTEST_M = 8.0
# The course is used if it turned by this much in total, rad, in so many intervals, if the gyro
# explains this share of the squares of its turns, and if the ratio of both differs from that of an
# explanation by at most this factor.
LEAST_TURNED, LEAST_STEPS, LEAST_EXPLAINED, NEAR = 1.5, 10, 0.8, 1.4
# A ratio below this is a wrong scale factor; late fixes shorten turns too, but by less. A large one
# may be that of an aircraft, which in a steep bank turns less about its own axis.
LEAST_RATIO = 0.65
# Turns that explain this share show a scale factor that is slightly wrong.
CLEAR = 0.9


@dataclass(frozen=True)
class CourseEvidence:
    """Turns of the course over ground compared with those of the gyro about the vertical.

    Attributes
    ----------
    ratio : float or None
        Turn of the course over that of the gyro, by least squares: 1 if everything is right, 0.017
        for rates in deg/s read as rad/s, negative if the axes do not belong together. None if the
        course does not follow the gyro.
    turned_rad : float
        Sum of the turns of the course.
    explained : float
        Share of their squares that the turns of the gyro explain.
    """

    ratio: float | None = None
    turned_rad: float = 0.0
    explained: float = 0.0


def course_evidence(windows: Windows, gnss: GnssEpochs | None) -> CourseEvidence:
    """Compare turns of the course with the gyro.

    Parameters
    ----------
    windows : Windows
        In Forward-Right-Down axes; the mean specific force shows which way is up in them.
    """
    if gnss is None or len(windows) < LEAST_STEPS:
        return CourseEvidence()
    turns = Turns.of(windows)
    times, course = _courses(gnss)
    return CourseEvidence() if turns is None else _compared(turns, times, course)


@dataclass(frozen=True)
class Turns:
    """Angle that the gyro turned about the vertical, at the ends of windows.

    Attributes
    ----------
    gaps : ndarray, shape (n,)
        How many gaps there were before.
    """

    ends_ns: IntArray
    angle: FloatArray
    gaps: IntArray

    @classmethod
    def of(cls, windows: Windows) -> Turns | None:
        """Of windows in Forward-Right-Down axes; None without specific force."""
        up = windows.count @ windows.accel
        size = float(np.linalg.norm(up))
        if not size > 0.0:
            return None
        angle = np.cumsum(windows.gyro @ (-up / size)) * (WINDOW_NS / SECOND)
        gaps = np.concatenate([[0], np.cumsum(np.diff(windows.start_ns) != WINDOW_NS)])
        return cls(windows.start_ns + WINDOW_NS, angle, gaps)

    def spans(self, time_ns: IntArray) -> BoolArray:
        """Whether times are within those of the windows."""
        return (time_ns > self.ends_ns[0]) & (time_ns < self.ends_ns[-1])

    def at(self, time_ns: IntArray) -> FloatArray:
        """Angle at any times, rad."""
        return np.interp((time_ns - self.ends_ns[0]) / SECOND, self._ends_s, self.angle)

    @cached_property
    def _ends_s(self) -> FloatArray:
        return (self.ends_ns - self.ends_ns[0]) / SECOND


def _compared(turns: Turns, times: IntArray, course: FloatArray) -> CourseEvidence:
    """Turns of a course against those of the gyro over the same intervals."""
    if len(times) <= LEAST_STEPS:
        return CourseEvidence()
    ends = turns.ends_ns
    seconds = np.diff(times) / SECOND
    place = np.searchsorted(ends, times)
    inside = (place > 0) & (place < len(ends))
    gap = turns.gaps[np.clip(place, 0, len(ends) - 1)]
    usable = inside[1:] & inside[:-1] & (seconds <= LONGEST_S) & (gap[1:] == gap[:-1])
    turn = wrapped(np.diff(course))[usable]
    said = np.diff(turns.at(times))[usable]
    turned = float(np.sum(np.abs(turn)))
    if len(turn) < LEAST_STEPS or turned < LEAST_TURNED:
        return CourseEvidence(turned_rad=turned)
    # But for a bias of the gyro, which adds the same to each second
    length = seconds[usable]
    columns = np.stack([said, length], axis=1)
    fit, *_ = np.linalg.lstsq(columns, turn, rcond=None)
    left = turn - columns @ fit
    still = turn - length * float(length @ turn) / float(length @ length)
    explained = 1.0 - float(left @ left) / max(float(still @ still), 1e-12)
    if explained < LEAST_EXPLAINED:
        return CourseEvidence(None, turned, explained)
    return CourseEvidence(float(fit[0]), turned, explained)


def _courses(gnss: GnssEpochs) -> tuple[IntArray, FloatArray]:
    """Times and courses over ground, some seconds apart, where the vehicle moves."""
    if gnss.has_velocity.any():
        rows = gnss.rows(_apart(gnss.time_ns, gnss.has_velocity))
        v = rows.velocity_n[:, :2]
        speed = np.hypot(v[:, 0], v[:, 1])
        sigma = np.nan_to_num(rows.sigma_velocity_n[:, :2]).max(axis=1)
        moves = speed > np.maximum(SLOWEST, SIGMAS * sigma)
        return rows.time_ns[moves], np.arctan2(v[moves, 1], v[moves, 0])
    rows = gnss.rows(_apart(gnss.time_ns, gnss.has_position))
    if len(rows) < 2:
        return np.zeros(0, np.int64), np.zeros(0)
    north, east = horizontal_metres(
        np.diff(rows.latitude), wrapped(np.diff(rows.longitude)), rows.latitude[1:]
    )
    seconds = np.diff(rows.time_ns) / SECOND
    moves = np.hypot(north, east) > np.maximum(SHORTEST_M, SLOWEST * seconds)
    middle = rows.time_ns[:-1] + np.diff(rows.time_ns) // 2
    return middle[moves], np.arctan2(east, north)[moves]


def _apart(time_ns: IntArray, good: np.ndarray) -> IntArray:
    """Rows of the good ones, the first of every so many seconds."""
    rows = np.flatnonzero(good)
    first = np.unique(time_ns[rows] // round(STEP_S * SECOND), return_index=True)[1]
    return np.asarray(rows[first])


def course_findings(
    windows: Windows, gnss: GnssEpochs | None, options: InputOptions, topic: str
) -> Iterator[Finding]:
    """Find rates whose unit or sign the course over ground contradicts.

    Parameters
    ----------
    options : InputOptions
        A unit that the user gave is not questioned.
    topic : str
        Of the IMU.
    """
    evidence = course_evidence(windows, gnss)
    ratio = evidence.ratio
    if ratio is None:
        return
    numbers = {"ratio": ratio, "explained": evidence.explained}
    turned = f"the course over ground turned by {evidence.turned_rad / DEGREE:.0f} deg in all, "
    if _near(abs(ratio), DEGREE):
        answer = "add --gyro-unit deg/s (or --gyro-unit rad/s if the log is right)"
        if options.gyro_kind == "increment":
            answer = f"leave out --gyro-kind increment, or {answer}"
        yield Finding(
            "course-gyro-unit",
            f"topic {topic}: {turned}{1.0 / abs(ratio):.0f} times less than the gyro about the"
            " vertical: its rates are in deg/s",
            severity=Severity.FAILED if options.gyro_unit is None else Severity.WARNING,
            answer=answer,
            topic=topic,
            numbers=numbers,
        )
    elif _near(abs(ratio), 1.0 / DEGREE):
        yield Finding(
            "course-gyro-unit",
            f"topic {topic}: {turned}{abs(ratio):.0f} times more than the gyro about the vertical:"
            " its rates are in rad/s",
            answer="leave out --gyro-unit",
            topic=topic,
            numbers=numbers,
        )
    elif evidence.explained > CLEAR and abs(ratio) < LEAST_RATIO:
        yield Finding(
            "course-gyro-scale",
            f"topic {topic}: {turned}{abs(ratio):.2f} times as far as the gyro about the vertical:"
            " rates are off by this factor",
            answer="compare the scale of the rates, and the sampling rate that info shows, with the"
            " data sheet",
            topic=topic,
            numbers=numbers,
        )
    if ratio < 0.0:
        yield Finding(
            "course-gyro-sense",
            f"topic {topic}: {turned}the other way than the gyro about the vertical that the"
            " accelerometer shows: the signs of one of the two are inverted, so do not trust what"
            " is computed from both",
            severity=Severity.LOST,
            answer="correct the driver or convert the log, unless the fixes have latitude and"
            " longitude exchanged: at rest an accelerometer reads +9.8 m/s^2 along the axis that"
            " points up, and a gyro's turns to the left about that axis are positive",
            topic=topic,
            numbers=numbers,
        )


def _near(value: float, expected: float) -> bool:
    return expected / NEAR < value < expected * NEAR
