"""Coning algorithms on the same samples, at the full rate and as in a slower log."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.coning.increments import GyroKind
from sinstool.methods.coning.registry import algorithm
from sinstool.methods.coning.stage import ConingStage
from sinstool.methods.strapdown.attitude import AttitudePropagator

_IDENTITY = (1.0, 0.0, 0.0, 0.0)
_WARM = 64
_BLOCK = 16384
# Of one candidate over all segments
_MOST_RUNS = 5
_ENOUGH_S = 0.02
# Samples over which one is timed at least, of a short log by repeating it: it takes longer to begin
# than to integrate a thousand.
_TIMED = 20_000


@dataclass(frozen=True)
class Segment:
    """Gyro samples of a stretch without gaps.

    Attributes
    ----------
    time_ns : ndarray of int64, shape (n,)
    gyro : ndarray, shape (n, 3)
        Rates or mean rates, rad/s, in body axes.
    """

    time_ns: IntArray
    gyro: FloatArray

    def __len__(self) -> int:
        return len(self.time_ns)


@dataclass(frozen=True)
class Candidate:
    """An algorithm and its input.

    Attributes
    ----------
    name : str
        Of the algorithm.
    decimate : int
        Only every so many samples are kept.
    input : {'none', 'sums', 'points'}
        How they are thinned: increments summed, as a slower integrating gyro gives them, or
        rates picked, as a slower sampling gyro does.
    """

    name: str
    algorithm: ConingAlgorithm
    decimate: int = 1
    input: str = "none"

    @property
    def label(self) -> str:
        """Name with its input."""
        return self.name if self.decimate == 1 else f"{self.name} /{self.decimate} {self.input}"

    @property
    def stride(self) -> int:
        """Native samples to an update."""
        return self.algorithm.samples * self.decimate


@dataclass(frozen=True)
class Attitudes:
    """Attitudes that a candidate computed over a segment.

    Attributes
    ----------
    sample : ndarray of int64, shape (k,)
        Native sample at which each attitude holds, increasing; the first is the start.
    q : ndarray, shape (k, 4)
        Body against the attitude at the start.
    seconds : float
        Processor time it took, the least of a few runs where one is short; of segments that were
        run together, each has its share by samples.
    samples : int
        Samples it was fed.
    """

    sample: IntArray
    q: FloatArray
    seconds: float
    samples: int


def run(
    candidate: Candidate,
    segments: Sequence[Segment],
    kind: GyroKind,
    nominal_s: float,
    increments: Sequence[FloatArray | None] | None = None,
) -> list[Attitudes]:
    """Attitudes of segments by one candidate.

    Parameters
    ----------
    kind : {'rate', 'mean-rate'}
        What the segments' samples are.
    nominal_s : float
        Native sample interval, s.
    increments : sequence of ndarray, shape (n - 1, 3), optional
        What :func:`increments_of` gives for each segment, where it is at hand.

    Returns
    -------
    list of Attitudes
        A single row where a segment holds no update.
    """
    ready = increments or [None] * len(segments)
    feeds = [
        _feed(candidate, segment, kind, nominal_s, own)
        for segment, own in zip(segments, ready, strict=True)
    ]
    usable = [feed for feed in feeds if len(feed[1]) >= 2]
    chosen, interval = candidate.algorithm, nominal_s * candidate.decimate
    # Compiled loops are loaded outside of the time that is reported.
    for gyro, times, _, fed in usable[:1]:
        _integrate(chosen, fed, interval, gyro[:_WARM], times[:_WARM])
    samples = sum(len(times) for _, times, _, _ in usable)
    many = -(-_TIMED // max(samples, 1))
    longer = [(*_repeated(gyro, times, many), fed) for gyro, times, _, fed in usable]
    least, spent = float("inf"), 0.0
    for _ in range(_MOST_RUNS):
        # all of them at once: asking for the time takes as long as a short stretch
        begin = time.thread_time()
        made = [_integrate(chosen, fed, interval, gyro, times) for gyro, times, fed in longer]
        seconds = time.thread_time() - begin
        least, spent = min(least, seconds), spent + seconds
        # A short run is timed again: caches and the scheduler are most of it.
        if spent >= _ENOUGH_S:
            break
    each = least / max(many * samples, 1)
    if many > 1:
        made = [_integrate(chosen, fed, interval, gyro, times) for gyro, times, _, fed in usable]
    results = iter(made)
    attitudes = []
    for _, times, rows, _ in feeds:
        if len(times) < 2:
            q = np.tile(_IDENTITY, (len(rows[:1]), 1))
            attitudes.append(Attitudes(rows[:1], q, 0.0, len(times)))
        else:
            sample, q = next(results)
            attitudes.append(Attitudes(rows[sample], q, each * len(times), len(times)))
    return attitudes


def _repeated(gyro: FloatArray, times: IntArray, many: int) -> tuple[FloatArray, IntArray]:
    """Samples and their times, that many times one after the other."""
    if many == 1:
        return gyro, times
    period = times[-1] - times[0] + np.median(np.diff(times)).astype(np.int64)
    later = times + period * np.arange(many)[:, None]
    return np.tile(gyro, (many, 1)), later.ravel()


def _integrate(
    chosen: ConingAlgorithm, kind: GyroKind, interval: float, gyro: FloatArray, times: IntArray
) -> tuple[IntArray, FloatArray]:
    """Attitude at the start and after each update, and the samples at which they hold."""
    stage = ConingStage(chosen, kind, nominal_interval=interval)
    propagator = AttitudePropagator(_IDENTITY)
    count = 1 - (1 - len(times)) // chosen.samples
    sample, q = np.zeros(count, np.int64), np.empty((count, 4))
    q[0] = _IDENTITY
    done = 1
    # In blocks, as a log is processed: what fits into the cache is what is timed.
    for begin in range(0, len(times) + _BLOCK, _BLOCK):
        rows = slice(begin, begin + _BLOCK)
        last = begin >= len(times)
        part = stage.finish() if last else stage.push(gyro[rows], times[rows])
        end = done + len(part.sample)
        sample[done:end] = part.sample
        q[done:end] = propagator.push(part.rotation_vector, part.interval)
        done = end
    return sample, q


def _feed(
    candidate: Candidate,
    segment: Segment,
    kind: GyroKind,
    nominal_s: float,
    increments: FloatArray | None,
) -> tuple[FloatArray, IntArray, IntArray, GyroKind]:
    """Samples for a candidate, their times, the native samples they stand at, and their kind."""
    m = candidate.decimate
    native = np.arange(len(segment), dtype=np.int64)
    if m == 1:
        return segment.gyro, segment.time_ns, native, kind
    if candidate.input == "points":
        return segment.gyro[::m], segment.time_ns[::m], native[::m], kind
    # The first sum is history only. It ends one update into the segment, so that updates stay
    # on multiples of their length and share instants with the reference.
    skip = candidate.stride - m
    if increments is None:
        increments = increments_of(segment, kind, nominal_s)
    increments = increments[skip:]
    blocks = len(increments) // m
    whole = increments[: blocks * m]
    sums = whole[::m].copy()
    for k in range(1, m):
        sums += whole[k::m]
    # Interval k of the native samples ends at sample k + 1.
    rows = native[candidate.stride :: m][:blocks]
    return sums, segment.time_ns[rows], rows, "increment"


def increments_of(segment: Segment, kind: GyroKind, nominal_s: float) -> FloatArray:
    """Native increments of a segment.

    Parameters
    ----------
    kind : {'rate', 'mean-rate'}

    Returns
    -------
    ndarray, shape (n - 1, 3)
        rad over each interval between samples.
    """
    stage = ConingStage(algorithm("uncompensated"), kind, nominal_interval=nominal_s)
    parts = [stage.push(segment.gyro, segment.time_ns), stage.finish()]
    return np.concatenate([p.rotation_vector for p in parts])


def candidates(
    names: Sequence[str],
    decimate: Sequence[int],
    kind: GyroKind,
    options: dict[str, dict[str, Any]],
) -> list[Candidate]:
    """All candidates to compare.

    Parameters
    ----------
    names : sequence of str
        Algorithms.
    decimate : sequence of int
        1 is the log as it is.
    kind : {'rate', 'mean-rate'}
        Picking points makes sense for point rates only.
    options : dict
        Options of algorithms that take any, by name.
    """
    compared = []
    for m in decimate:
        ways = ["none"] if m == 1 else ["sums", "points"] if kind == "rate" else ["sums"]
        for thinning in ways:
            for name in names:
                built = algorithm(name, **options.get(name, {}))
                compared.append(Candidate(name, built, m, thinning))
    return compared
