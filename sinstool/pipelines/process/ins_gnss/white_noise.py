"""White noise of the fixes of a log, beside their slow errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.chi_square import MEDIAN_SQUARE
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.fix_velocity import (
    outlying_innovations,
    stated_sigma,
    worse_than_usual,
)
from sinstool.methods.ins_gnss.settings import GnssModel, Settings
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart, WhiteNoise
from sinstool.pipelines.process.ins_gnss.timing import motion_from
from sinstool.survey.source import Source

# Noise of fixes, m and m/s, with which positions at wrong times hardly change the biases.
LOOSE_POSITION = (5.0, 5.0, 8.0)
LOOSE_VELOCITY = (0.3, 0.3, 0.5)
# Fewest epochs that show the white noise of fixes.
LEAST_EPOCHS = 40


def white_noise(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> WhiteNoise | None:
    """White noise of positions and velocities; None where too few fixes show that of either.

    From second differences of the innovations of a filter that hardly follows the fixes: slow
    errors, of the fixes and of the navigation alike, are nearly straight over three epochs and
    cancel. Medians ignore single bad fixes. Fixes that the receiver itself states to be worse than
    usual are left out, as they say nothing about the others.
    """
    settings, usual = loose(start.settings), ~worse_than_usual(start.used)
    if start.white is not None and start.white.is_of(start.start, settings, usual):
        return start.white
    gnss = start.used.rows(usual)
    motion = motion_from(source, config, algorithm, start.time_ns)
    if motion is None or len(gnss) < LEAST_EPOCHS:
        return None
    run = InsGnssFilter(start.start, settings, with_baro=False, output=False)
    epochs = run.push(motion, unsized(gnss)).gnss
    position = _scatter(epochs.time_ns, epochs.innovation[:, :3])
    velocity = _scatter(epochs.time_ns, epochs.innovation[:, 3:])
    shown = outlying_innovations(epochs.time_ns, epochs.innovation[:, :3], stated_sigma(gnss))
    far = np.zeros(len(usual), dtype=np.bool_)
    valid_ns = gnss.time_ns - round(settings.gnss_latency * SECOND)
    first = int(np.searchsorted(valid_ns, epochs.time_ns[0])) if len(epochs) else 0
    far[np.flatnonzero(usual)[first : first + len(epochs)]] = shown
    return WhiteNoise(position, velocity, start.start, settings, usual, far)


def _scatter(time_ns: IntArray, innovation: FloatArray) -> tuple[float, float]:
    """White noise of innovations, shape (n, 3): of one horizontal axis, and of the vertical one."""
    there = np.isfinite(innovation[:, :2]).all(axis=1)
    time_ns, innovation = time_ns[there], innovation[there]
    steps = np.diff(time_ns)
    even = np.abs(np.diff(steps)) < 0.5 * np.median(steps) if len(steps) > 1 else np.zeros(0, bool)
    bend = np.diff(innovation, 2, axis=0)[even]
    if len(bend) < LEAST_EPOCHS:
        return np.nan, np.nan
    # Second differences of white noise have 1 + 4 + 1 times its variance
    axes = np.sqrt([_median(column**2) / (MEDIAN_SQUARE * 6.0) for column in bend.T])
    return float(np.hypot(axes[0], axes[1]) / np.sqrt(2.0)), float(axes[2])


def _median(values: FloatArray) -> float:
    """Median of the finite values; NaN if there are too few."""
    good = values[np.isfinite(values)]
    return float(np.median(good)) if len(good) >= LEAST_EPOCHS else np.nan


def loose(settings: Settings) -> Settings:
    """Settings of a filter that hardly follows the fixes."""
    return replace(
        settings.ungated,
        filter="plain-15",
        gnss=GnssModel(position_white=LOOSE_POSITION, velocity_white=LOOSE_VELOCITY),
    )


def unsized(gnss: GnssEpochs) -> GnssEpochs:
    """Fixes without the sigmas that the receiver states."""
    return replace(
        gnss,
        sigma_position_n=np.full_like(gnss.sigma_position_n, np.nan),
        sigma_velocity_n=np.full_like(gnss.sigma_velocity_n, np.nan),
    )
