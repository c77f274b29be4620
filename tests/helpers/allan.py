"""Rates with noise terms of known size, and variances and fits of segments held as a whole."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.methods.allan.deviation import (
    ROWS,
    Variances,
    VarianceStage,
    averaging_lags,
    stride_for,
)
from sinstool.methods.allan.fit import NoiseData
from sinstool.methods.allan.likelihood import NoiseFit
from sinstool.methods.allan.model import block_length, second_differences


def variances(segments: Sequence[FloatArray], hadamard: bool = True) -> Variances:
    """Overlapping Allan and Hadamard variances of segments that are held as a whole.

    Parameters
    ----------
    segments : sequence of ndarray, shape (n_i, c)
        Samples of rate, evenly spaced within each.
    """
    longest = max(len(segment) for segment in segments)
    stride = stride_for(longest)
    lags = averaging_lags(longest)
    stage = VarianceStage(lags, stride, segments[0].shape[1], stride, hadamard)
    for segment in segments:
        stage.begin()
        mean = segment.mean(axis=0)
        for first in range(0, len(segment), ROWS):
            stage.push(segment[first : first + ROWS] - mean)
    return stage.finish()


def fit_segments(segments: Sequence[FloatArray]) -> list[NoiseFit | None]:
    """Fits of segments that are held as a whole, one for each of their columns.

    Parameters
    ----------
    segments : sequence of ndarray, shape (n_i, c)
        Samples of rate, evenly spaced within each.
    """
    lengths = [len(segment) for segment in segments]
    block, stride = block_length(lengths), stride_for(max(lengths))
    columns = segments[0].shape[1]
    lags = averaging_lags(max(lengths))
    stage = VarianceStage(lags, stride, columns, max(block, stride), hadamard=False)
    for segment in segments:
        stage.begin()
        stage.push(segment - segment.mean(axis=0))
    found = stage.finish()
    data = NoiseData(found, stage.lengths, stage.phases, max(block, stride))
    return [data.fit(column) for column in range(columns)]


def simulate_terms(
    count: int,
    quantisation: float,
    white: float,
    flicker: float,
    random_walk: float,
    ramp: float,
    generator: np.random.Generator,
) -> FloatArray:
    """Samples that are means over their intervals, shape (n,); all in the units of samples.

    Parameters
    ----------
    count : int
    quantisation, white, flicker, random_walk : float
        Roots of the variances of :mod:`sinstool.methods.allan.model`.
    ramp : float
        Change of the rate from sample to sample.
    """
    rate = ramp * np.arange(count, dtype=np.float64)
    rate += white * generator.standard_normal(count)
    if quantisation:
        rate += quantisation * np.diff(generator.standard_normal(count + 1))
    if random_walk:
        # A walk's means over intervals: what it is at their beginning, and what it gains in them
        step = generator.standard_normal(count)
        within = 0.5 * step + generator.standard_normal(count) / np.sqrt(12.0)
        rate += random_walk * (np.cumsum(step) - step + within)
    if flicker:
        rate += flicker * _flicker(count, generator)
    return rate


def _flicker(count: int, generator: np.random.Generator) -> FloatArray:
    """Flicker noise by its first differences, which are stationary (Davies and Harte 1987)."""
    size = 1 << int(count).bit_length()
    covariance = second_differences(size + 1)[2]
    spectrum = np.fft.rfft(np.concatenate((covariance, covariance[-2:0:-1]))).real
    white = generator.standard_normal(2 * size)
    coloured = np.fft.irfft(np.fft.rfft(white) * np.sqrt(np.maximum(spectrum, 0.0)), 2 * size)
    return np.asarray(np.cumsum(coloured[:count]))
