"""Velocities whose errors last for several epochs, as those of a receiver that smooths them.

A filter that takes them for white believes each epoch anew, and its sigmas of attitude become too
small. How long they last shows in its innovations: sums of them over some seconds are then larger
than those of white noise. White noise of velocities that has the same sums is assumed instead.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sinstool.config import GnssOptions, ProcessConfig
from sinstool.core.timeline import SECOND
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.results import GnssDiagnostics
from sinstool.pipelines.process.ins_gnss.filter_settings import receiver_stated
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.timing import motion_from
from sinstool.survey.source import Source

# Innovations are summed over this time, s: smoothing is shorter, errors of satellites are longer.
TOGETHER_S = 4.0
# Fewest such times that show it, of so many epochs each at least.
LEAST_TIMES, LEAST_EPOCHS = 20, 3
# Normalised innovations count up to this: larger ones are bad fixes.
LIMIT = 4.0
# Squared sums over their expectation are certain to so many of their sigmas; they count from this.
CERTAIN, COUNTS = 3.0, 2.0


def with_lasting_velocity(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> FilterStart:
    """A start with white noise of velocities as large as their errors are that last for seconds.

    Not if options give the noise of the fixes. Its attitude, by those velocities, is as much less
    certain.
    """
    if receiver_stated(config) or config.gnss.gnss_sigma_v != GnssOptions().gnss_sigma_v:
        return start
    motion = motion_from(source, config, algorithm, start.time_ns)
    if motion is None or not start.used.has_velocity.any():
        return start
    shown = start.by_the_fixes
    settings = replace(shown.settings, network=None)
    run = InsGnssFilter(shown.start, settings, with_baro=False, output=False)
    epochs = run.push(motion, shown.used).gnss
    level = noise_factor(epochs, slice(3, 5))
    if level < COUNTS:
        return start
    factor = np.array([level, level, max(noise_factor(epochs, slice(5, 6)), 1.0)])
    model, begun = start.settings.gnss, start.start
    before = np.square(model.velocity_white)
    north, east, down = np.sqrt(factor * before).tolist()
    sigma = np.sqrt(np.square(start.gnss.sigma_velocity_n) + (factor - 1.0) * before)
    why = f"their errors last, so they count as {np.sqrt(level):.2g} times as noisy"
    return replace(
        start,
        settings=replace(start.settings, gnss=replace(model, velocity_white=(north, east, down))),
        gnss=replace(start.gnss, sigma_velocity_n=sigma),
        start=replace(begun, covariance_attitude_n=level * begun.covariance_attitude_n),
        gnss_why=f"{start.gnss_why}; {why}",
    )


def noise_factor(epochs: GnssDiagnostics, columns: slice) -> float:
    """Squared sums of innovations over their expectation, at the least; 1 if too few show it."""
    values = epochs.innovation[:, columns] / epochs.innovation_sigma[:, columns]
    good = np.isfinite(values).all(axis=1)
    values, time_ns = np.clip(values[good], -LIMIT, LIMIT), epochs.time_ns[good]
    part = (time_ns - epochs.time_ns[:1]) // round(TOGETHER_S * SECOND)
    _, first, count = np.unique(part, return_index=True, return_counts=True)
    many = count >= LEAST_EPOCHS
    if np.count_nonzero(many) < LEAST_TIMES:
        return 1.0
    sums = np.add.reduceat(values, first, axis=0)[many]
    squares = np.square(sums).mean(axis=1) / count[many]
    spread = float(squares.std()) / np.sqrt(len(squares))
    return float(squares.mean()) - CERTAIN * spread
