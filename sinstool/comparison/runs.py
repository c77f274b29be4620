"""Coning algorithms run over the same samples, natively and as a slower log would have them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sinstool.coning.algorithm import ConingAlgorithm
from sinstool.coning.increments import GyroKind
from sinstool.coning.registry import algorithm
from sinstool.coning.stage import ConingStage
from sinstool.strapdown.attitude import AttitudePropagator

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_IDENTITY = (1.0, 0.0, 0.0, 0.0)
_WARM = 64
_BLOCK = 16384


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
    """An algorithm and what it is fed.

    Attributes
    ----------
    name : str
        Of the algorithm.
    algorithm : ConingAlgorithm
    decimate : int
        Only every so many samples are kept.
    thinning : {'none', 'sums', 'points'}
        How: increments summed, as a slower integrating gyro gives them, or rates picked, as a
        slower sampling gyro does.
    """

    name: str
    algorithm: ConingAlgorithm
    decimate: int = 1
    thinning: str = "none"

    @property
    def label(self) -> str:
        """Name with what it is fed."""
        return self.name if self.decimate == 1 else f"{self.name} /{self.decimate} {self.thinning}"

    @property
    def stride(self) -> int:
        """Native samples to an update."""
        return self.algorithm.samples * self.decimate


@dataclass(frozen=True)
class Attitudes:
    """What a candidate made of a segment.

    Attributes
    ----------
    sample : ndarray of int64, shape (k,)
        Native sample at which each attitude holds, increasing; the first is the start.
    q : ndarray, shape (k, 4)
        Body against the attitude at the start.
    seconds : float
        Processor time it took.
    samples : int
        Samples it was fed.
    """

    sample: IntArray
    q: FloatArray
    seconds: float
    samples: int


def run(candidate: Candidate, segment: Segment, kind: GyroKind, nominal_s: float) -> Attitudes:
    """Attitude of one segment by one candidate.

    Parameters
    ----------
    candidate : Candidate
    segment : Segment
    kind : {'rate', 'mean-rate'}
        What the segment's samples are.
    nominal_s : float
        Native sample interval, s.

    Returns
    -------
    Attitudes
        A single row where the segment holds no update.
    """
    gyro, times, rows, fed = _feed(candidate, segment, kind, nominal_s)
    if len(times) < 2:
        return Attitudes(rows[:1], np.tile(_IDENTITY, (len(rows[:1]), 1)), 0.0, len(times))
    interval = nominal_s * candidate.decimate
    # Compiled loops are loaded outside of the time that is reported.
    _integrate(candidate.algorithm, fed, interval, gyro[:_WARM], times[:_WARM])
    begin = time.process_time()
    sample, q = _integrate(candidate.algorithm, fed, interval, gyro, times)
    seconds = time.process_time() - begin
    return Attitudes(rows[sample], q, seconds, len(times))


def _integrate(
    chosen: ConingAlgorithm, kind: GyroKind, interval: float, gyro: FloatArray, times: IntArray
) -> tuple[IntArray, FloatArray]:
    """Attitude at the start and after each update, and the samples at which they hold."""
    stage = ConingStage(chosen, kind, nominal_interval=interval)
    propagator = AttitudePropagator(_IDENTITY)
    sample, q = [np.zeros(1, np.int64)], [np.array([_IDENTITY])]
    # In blocks, as a log is processed: what fits into the cache is what is timed.
    for begin in range(0, len(times), _BLOCK):
        rows = slice(begin, begin + _BLOCK)
        part = stage.push(gyro[rows], times[rows])
        sample.append(part.sample)
        q.append(propagator.push(part.rotation_vector, part.interval))
    part = stage.finish()
    sample.append(part.sample)
    q.append(propagator.push(part.rotation_vector, part.interval))
    return np.concatenate(sample), np.concatenate(q)


def _feed(
    candidate: Candidate, segment: Segment, kind: GyroKind, nominal_s: float
) -> tuple[FloatArray, IntArray, IntArray, GyroKind]:
    """Samples for a candidate, their times, the native samples they stand at, and their kind."""
    m = candidate.decimate
    native = np.arange(len(segment), dtype=np.int64)
    if m == 1:
        return segment.gyro, segment.time_ns, native, kind
    if candidate.thinning == "points":
        return segment.gyro[::m], segment.time_ns[::m], native[::m], kind
    # The first sum is history only. It ends one update into the segment, so that updates stay
    # on multiples of their length and share instants with the reference.
    skip = candidate.stride - m
    increments = increments_of(segment, kind, nominal_s)[skip:]
    blocks = len(increments) // m
    sums = increments[: blocks * m].reshape(blocks, m, 3).sum(axis=1)
    # Interval k of the native samples ends at sample k + 1.
    rows = native[candidate.stride :: m][:blocks]
    return sums, segment.time_ns[rows], rows, "increment"


def increments_of(segment: Segment, kind: GyroKind, nominal_s: float) -> FloatArray:
    """Native increments of a segment.

    Parameters
    ----------
    segment : Segment
    kind : {'rate', 'mean-rate'}
    nominal_s : float

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
    """All that is to be compared.

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

    Returns
    -------
    list of Candidate
    """
    found = []
    for m in decimate:
        ways = ["none"] if m == 1 else ["sums", "points"] if kind == "rate" else ["sums"]
        for thinning in ways:
            for name in names:
                built = algorithm(name, **options.get(name, {}))
                found.append(Candidate(name, built, m, thinning))
    return found
