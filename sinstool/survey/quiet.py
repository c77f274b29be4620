"""Stretches of a log that show only the noise of its sensors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.methods.alignment.still import WINDOW_NS, StillSpan, Windows
from sinstool.survey.imu import Survey
from sinstool.survey.noisy_rest import noisy_rests
from sinstool.survey.rest import moving_at

# A window is louder than the quiet ones by this factor, beyond the scatter of so few samples.
LOUD = 1.6
SCATTER = 6.0
# Three axes that go one count up and down have this scatter at most, in counts.
ONE_COUNT = np.sqrt(0.75)
# The quantile of all still windows that defines the noise of a quiet one.
QUIET_SHARE = 0.25
# Shorter stretches show little, and their ends are the end of one motion and the start of another.
SHORTEST_S = 5.0
# Sway: gravity follows the gyro by at least this share of its turn, and by so many sigmas.
SWAY_SHARE, SWAY_SIGMAS = 0.2, 6.0
# Only the longest stretches are used: a hundred show the noise.
MOST = 100


@dataclass(frozen=True)
class Stretch:
    """A stretch of samples without motion; its end is exclusive.

    Attributes
    ----------
    samples : int
        Largest possible number of samples in it.
    gyro, accel : ndarray, shape (3,)
        Approximate means.
    """

    start_ns: int
    end_ns: int
    samples: int
    gyro: np.ndarray
    accel: np.ndarray

    @property
    def duration_s(self) -> float:
        """Length in seconds."""
        return (self.end_ns - self.start_ns) / SECOND


@dataclass(frozen=True)
class QuietStretches:
    """The stretches of a log that can count as noise.

    Attributes
    ----------
    stretches : tuple of Stretch
        In order of time.
    shaken_s : float
        Left out of still spans since it is louder than the rest of them.
    moving_s : float
        Left out since GNSS moves there.
    """

    stretches: tuple[Stretch, ...]
    shaken_s: float
    moving_s: float


def quiet_stretches(survey: Survey, gnss: GnssEpochs | None) -> QuietStretches:
    """Find where a log shows nothing but noise.

    Still spans, which may hold knocks, an engine that idles or hands, without their louder windows,
    the first window after a motion, and gaps. Where there are none, spans that hold only noise,
    however loud.
    """
    resting: list[StillSpan] = []
    moving = 0.0
    for span in survey.spans or noisy_rests(survey.windows):
        if moving_at(gnss, span.start_ns, span.end_ns) is None:
            resting.append(span)
        else:
            moving += span.duration_s
    windows = survey.windows
    inside = np.zeros(len(windows), np.bool_)
    for span in resting:
        first, last = np.searchsorted(windows.start_ns, [span.start_ns, span.end_ns])
        inside[first:last] = True
    quiet = inside & ~_loud(windows, inside, (survey.gyro_resolution, survey.accel_resolution))
    shaken = np.count_nonzero(inside & ~quiet) * WINDOW_NS / SECOND
    for span in resting:
        if span.start_ns > survey.first_ns:
            quiet[np.searchsorted(windows.start_ns, span.start_ns)] = False
    gaps = np.array([start for start, _ in survey.gaps], np.int64)
    candidates = [
        stretch
        for first, last in _runs(windows, quiet, {span.start_ns for span in resting})
        for stretch in _without_gaps(windows, first, last, np.sort(gaps))
        if stretch.duration_s >= SHORTEST_S
    ]
    longest = sorted(candidates, key=lambda one: -one.samples)[:MOST]
    stretches = tuple(sorted(longest, key=lambda one: one.start_ns))
    return QuietStretches(stretches, float(shaken), moving)


def _loud(windows: Windows, inside: np.ndarray, steps: tuple[float, float]) -> np.ndarray:
    """Windows that are louder than most of the still ones, and than one count up and down.

    Parameters
    ----------
    inside : ndarray of bool
        Windows of still spans.
    steps : tuple of float
        Resolution of the gyro and of the accelerometer.
    """
    loud = np.zeros(len(windows), np.bool_)
    if not inside.any():
        return loud
    freedom = 6.0 * np.maximum(windows.count - 1.0, 1.0)
    for size, step in zip((windows.gyro_std, windows.accel_std), steps, strict=True):
        level = float(np.quantile(size[inside], QUIET_SHARE))
        # Of samples that hardly ever change, most windows have no scatter at all
        usual = level or float(np.max(size[inside]))
        least = ONE_COUNT * step
        loud |= size > np.maximum(LOUD * usual * (1.0 + SCATTER / np.sqrt(freedom)), least)
    return loud


def _runs(windows: Windows, quiet: np.ndarray, begins: set[int]) -> Iterator[tuple[int, int]]:
    """First and last window (exclusive) of runs of neighbours; no run goes on in another span."""
    rows = np.flatnonzero(quiet)
    if not len(rows):
        return
    start = windows.start_ns[rows]
    apart = (np.diff(rows) != 1) | (np.diff(start) != WINDOW_NS) | np.isin(start[1:], [*begins])
    cuts = np.flatnonzero(apart) + 1
    for part in np.split(rows, cuts):
        yield int(part[0]), int(part[-1]) + 1


def _without_gaps(windows: Windows, first: int, last: int, gaps: np.ndarray) -> Iterator[Stretch]:
    """A run of windows, cut at the gaps in it; a gap is named by the sample before it."""
    count = windows.count[first:last].astype(np.float64)
    samples = int(count.sum())
    gyro = count @ windows.gyro[first:last] / samples
    accel = count @ windows.accel[first:last] / samples
    start, end = int(windows.start_ns[first]), int(windows.start_ns[last - 1]) + WINDOW_NS
    inside = gaps[(gaps >= start) & (gaps < end)]
    edges = [start, *(int(gap) + 1 for gap in inside), end]
    for a, b in pairwise(edges):
        yield Stretch(a, b, samples, gyro, accel)


def sway(survey: Survey, stretches: tuple[Stretch, ...]) -> float:
    """RMS rate, rad/s, at which a sensor that seems at rest turns.

    Noise of a gyro and of an accelerometer are independent. If the direction of gravity changes as
    the gyro measures, the sensor turns: on a mooring, in the wind, on a soft suspension.

    Returns
    -------
    float
        0 if both seem independent.
    """
    windows = survey.windows
    said, done = [], []
    for stretch in stretches:
        first, last = np.searchsorted(windows.start_ns, [stretch.start_ns, stretch.end_ns])
        rows = slice(first, last)
        size = float(np.linalg.norm(stretch.accel))
        if last - first < 3 or size == 0.0:
            continue
        direction = windows.accel[rows] / size
        rate = windows.gyro[rows] - stretch.gyro
        turn = 0.5 * (rate[:-1] + rate[1:]) * (WINDOW_NS / SECOND)
        said.append(np.cross(direction[:-1], turn))
        done.append(np.diff(direction, axis=0))
    if not said:
        return 0.0
    x, y = np.concatenate(said), np.concatenate(done)
    power = float(np.sum(x * x))
    if power == 0.0:
        return 0.0
    slope = float(np.sum(x * y)) / power
    # Directions move in two dimensions
    sigma = float(np.sqrt(np.sum((y - slope * x) ** 2) / (2 * len(x)) / power))
    if slope < SWAY_SIGMAS * sigma or slope < SWAY_SHARE:
        return 0.0
    return float(np.sqrt(slope * power / len(x))) / (WINDOW_NS / SECOND)
