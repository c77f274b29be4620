"""Whether samples are means until their stamps, where fixes are good enough to show it.

Means and rates at the stamps differ by half a sample in time, and in nothing else. An IMU alone
does not show this time, and fixes show it only together with the latency of the receiver. But the
stamps of most receivers are right: if the log shows no latency, or one of minus half a sample, and
the fixes are clearly likelier with means, samples are read as means.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.choices import log_choice
from sinstool.core.errors import AlignmentError
from sinstool.core.finding import Finding, Severity
from sinstool.core.timeline import SECOND
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.pipelines.plan import Plan
from sinstool.pipelines.planning import as_planned
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.innovation_cost import innovation_cost, innovations
from sinstool.pipelines.process.ins_gnss.start import earliest_start, timed
from sinstool.pipelines.process.ins_gnss.timing import motion_from
from sinstool.survey.source import Source

MEANS = "mean-rate"
# Fixes noisier than this, m, that seem to be valid at their stamps, do not show half a sample.
MOST_NOISE = 0.3
# A latency is minus half a sample if it is so within this many sigmas, or s.
SIGMAS, LEAST_NEAR_S = 3.0, 0.002
# By how much -2 log likelihood must fall: four sigmas of one parameter.
LEAST_GAIN = 16.0


def with_sample_kind(
    source: Source, config: ProcessConfig, plan: Plan, first: FilterStart
) -> tuple[ProcessConfig, FilterStart, FilterStart | None, list[Finding]]:
    """A configuration that reads samples as means, where the fixes show that they are.

    Parameters
    ----------
    first : FilterStart
        By :func:`~sinstool.pipelines.process.ins_gnss.first_start.first_start`.

    Returns
    -------
    config, first : ProcessConfig, FilterStart
        Unchanged if the fixes do not show it, or if options say what samples are.
    start : FilterStart or None
        :func:`~sinstool.pipelines.process.ins_gnss.start.timed` of `first`, if it was made.
    findings : list of Finding
        A note if samples are read as means.
    """
    if plan.gyro_samples.configured or config.input.sample_kind != "rate":
        return config, first, None, []
    start, means = timed(source, config, plan.algorithm, first), as_planned(config, MEANS)
    same = config, first, start, list[Finding]()
    at_stamps = start.latency_status == "given" or start.settings.gnss_latency == 0.0
    if at_stamps:
        if _coarse(start):
            return same
        before = _cost(source, config, plan.algorithm, start)
        after = _cost(source, means, plan.algorithm, start)
        if not (np.isfinite(before) and after < before - LEAST_GAIN):
            return same
    elif not _half_a_sample(source, start):
        return same
    try:
        begun = earliest_start(source, means, plan.algorithm)
        other = timed(source, means, plan.algorithm, begun)
    except AlignmentError:
        return same
    # No fix is valid after its stamp: with means the latency has to vanish
    if other.latency_status != "given" and other.settings.gnss_latency != 0.0:
        return same
    text = "the fixes show that samples of the IMU are means until their stamps"
    log_choice("gyro samples", f"{MEANS}: {text}")
    note = f"{text}, and they are read as such (--gyro-kind overrides this)"
    return means, begun, other, [Finding("gyro-kind-used", note, Severity.NOTE)]


def _coarse(start: FilterStart) -> bool:
    """Whether positions are too noisy to show half a sample."""
    noise = start.settings.gnss
    return bool(np.hypot(noise.position_white[0], noise.position_markov[0]) > MOST_NOISE)


def _half_a_sample(source: Source, start: FilterStart) -> bool:
    """Whether fixes seem to be valid half a sample after their stamps."""
    shown, half = start.offsets, 0.5 * source.survey.interval_ns / SECOND
    near = LEAST_NEAR_S if shown is None else max(SIGMAS * shown.sigma_s, LEAST_NEAR_S)
    return abs(start.settings.gnss_latency + half) <= near


def _cost(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> float:
    """-2 log likelihood of the innovations of the first minutes; infinite with too few."""
    motion, start = motion_from(source, config, algorithm, start.time_ns), start.by_the_fixes
    if motion is None:
        return np.inf
    fixes = start.believable_until(int(motion.time_ns[-1]))
    settings = replace(start.settings, network=None)
    return innovation_cost(innovations(start.start, settings, motion, fixes))
