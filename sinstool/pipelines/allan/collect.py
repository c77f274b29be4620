"""Accumulate Allan variances, phases and extremes of the samples at rest, block by block.

Of each axis is kept: variances, phases a block apart, extremes. Nothing but the phases that long
averaging times need grows with the log, and they are bounded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.arrays import ROUNDING, FloatArray
from sinstool.core.parts import njit
from sinstool.core.timeline import SECOND
from sinstool.methods.allan.deviation import (
    Variances,
    VarianceStage,
    averaging_lags,
    stride_for,
)
from sinstool.methods.allan.model import block_length
from sinstool.survey.quiet import Stretch
from sinstool.survey.source import Source, rate_blocks

# Steps of two intervals are lost samples up to this share; more are stamps too coarse for the rate.
MOST_LOST = 0.05
# Columns of the state of `_extremes`
_LOW, _HIGH, _AT_LOW, _AT_HIGH, _STEP, _LAST, WIDTH = 0, 1, 2, 3, 4, 5, 6


@dataclass(frozen=True)
class Collected:
    """Variances, phases and extremes of the samples at rest.

    Attributes
    ----------
    interval : float
        Mean interval between samples where none is lost, s.
    variances : Variances
        Columns are the gyro's axes, rad/s, then the accelerometer's, m/s^2.
    lengths : tuple of int
        Samples of each stretch.
    phases : list of ndarray
        See :class:`~sinstool.methods.allan.deviation.VarianceStage`.
    block : int
        Samples between two phases.
    starts_ns : tuple of int
        First sample of each stretch.
    range : ndarray, shape (6, 2)
        Smallest and largest value.
    at_ends : ndarray, shape (6, 2)
        Share of the samples that have just these values.
    step : ndarray, shape (6,)
        The least difference between two samples in a row that differ; infinite where none do.
    """

    interval: float
    samples: int
    variances: Variances
    lengths: tuple[int, ...]
    phases: list[FloatArray]
    block: int
    starts_ns: tuple[int, ...]
    range: FloatArray
    at_ends: FloatArray
    step: FloatArray


def collect(
    source: Source,
    config: ProcessConfig,
    stretches: tuple[Stretch, ...],
    progress: Callable[[int], None] | None = None,
) -> Collected:
    """Read the samples of the stretches once.

    Parameters
    ----------
    stretches : tuple of Stretch
        In order of time; one at least.
    progress : callable, optional
        Called with the bytes read so far.
    """
    stage, block = _stage(source, stretches)
    longest = source.survey.max_gap_ns
    # Edges alternate: the start and the end of each stretch
    edges = np.array([[s.start_ns, s.end_ns] for s in stretches], np.int64).reshape(-1)
    origins = [np.concatenate([s.gyro, s.accel]) for s in stretches]
    extremes = _no_extremes()
    spans: list[tuple[int, int]] = []
    nominal, missing = source.survey.interval_ns, 0
    for imu in rate_blocks(source, config, int(edges[0]), progress, last=True):
        time_ns = imu.time_ns
        place = np.searchsorted(edges, time_ns, side="right")
        cut = np.flatnonzero((np.diff(place) != 0) | (np.diff(time_ns) > longest)) + 1
        bounds = [0, *cut.tolist(), len(time_ns)]
        for first, last in pairwise(bounds):
            number = int(place[first])
            if number % 2 == 0:
                continue
            stretch = number // 2
            begun, ended = int(time_ns[first]), int(time_ns[last - 1])
            missing += _missing(time_ns[first:last], nominal)
            goes_on = spans and spans[-1][0] >= edges[2 * stretch]
            if goes_on and begun - spans[-1][1] <= longest:
                missing += _missing(np.array([spans[-1][1], begun]), nominal)
                spans[-1] = spans[-1][0], ended
            else:
                stage.begin()
                spans.append((begun, ended))
            values = np.hstack([imu.gyro[first:last], imu.accel[first:last]])
            _extremes(values, extremes)
            values -= origins[stretch]
            stage.push(values)
        if time_ns[-1] >= edges[-1]:
            break
    variances = stage.finish()
    samples = sum(stage.lengths)
    steps = samples - len(stage.lengths)
    seconds = sum(end - start for start, end in spans) / SECOND
    # White noise is that of a sample by its interval, however many others were lost
    lost = missing if 0 < missing < MOST_LOST * steps else 0
    interval = seconds / max(steps + lost, 1)
    if config.input.imu_rate is not None:
        interval = 1.0 / config.input.imu_rate
    return Collected(
        interval=interval,
        samples=samples,
        variances=variances,
        lengths=tuple(stage.lengths),
        phases=stage.phases,
        block=block,
        starts_ns=tuple(start for start, _ in spans),
        range=extremes[:, [_LOW, _HIGH]],
        at_ends=extremes[:, [_AT_LOW, _AT_HIGH]] / max(samples, 1),
        step=extremes[:, _STEP],
    )


def _missing(time_ns: np.ndarray, nominal: float) -> int:
    """Samples that are lost between others; those of a burst make up for the time before it."""
    if not nominal:
        return 0
    return int(np.sum(np.rint(np.diff(time_ns) / nominal) - 1.0))


def _stage(source: Source, stretches: tuple[Stretch, ...]) -> tuple[VarianceStage, int]:
    """Accumulator of variances for stretches of about these lengths, and its block."""
    interval = source.survey.interval_ns or SECOND
    lengths = [max(1, round((s.end_ns - s.start_ns) / interval)) for s in stretches]
    stride = stride_for(max(lengths))
    block = max(block_length(lengths), stride)
    return VarianceStage(averaging_lags(max(lengths)), stride, 6, block), block


def _no_extremes() -> FloatArray:
    state = np.zeros((6, WIDTH))
    state[:, _LOW], state[:, _HIGH] = np.inf, -np.inf
    state[:, _STEP], state[:, _LAST] = np.inf, np.nan
    return state


@njit(cache=True, nogil=True)
def _extremes(values, state):  # type: ignore[no-untyped-def]
    """Smallest and largest value by column, how often they occur, and the least step."""
    for i in range(values.shape[0]):
        for a in range(values.shape[1]):
            value = values[i, a]
            if value == state[a, _LOW]:
                state[a, _AT_LOW] += 1.0
            elif value < state[a, _LOW]:
                state[a, _LOW] = value
                state[a, _AT_LOW] = 1.0
            if value == state[a, _HIGH]:
                state[a, _AT_HIGH] += 1.0
            elif value > state[a, _HIGH]:
                state[a, _HIGH] = value
                state[a, _AT_HIGH] = 1.0
            step = abs(value - state[a, _LAST])
            if step > ROUNDING * abs(value) and step < state[a, _STEP]:
                state[a, _STEP] = step
            state[a, _LAST] = value
