"""Velocities that a receiver smooths: found beside the IMU, and undone before they are used."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.choices import log_choice
from sinstool.core.errors import AlignmentError
from sinstool.core.finding import Finding
from sinstool.core.rotation import rotate
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.fix_velocity import worse_than_usual
from sinstool.methods.ins_gnss.smoothed_velocity import Smoothing, delay, smoothing, unsmoothed
from sinstool.methods.strapdown.joined_updates import JOINED_S, joined_updates
from sinstool.methods.strapdown.velocity import Increments
from sinstool.pipelines.process.ins_gnss.filter_settings import receiver_stated
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.first_start import first_start
from sinstool.pipelines.process.ins_gnss.timing import motion_from
from sinstool.pipelines.process.ins_gnss.white_noise import loose, unsized
from sinstool.survey.source import Source

KIND = "smoothed-velocity"
# Runs of a filter, each over velocities as the one before shows them, until the time constant
# changes by less than this share.
ROUNDS, SETTLED = 5, 0.03
# Velocities stay smoothed if the filter would otherwise start by more than this later.
LATER_NS = 30 * SECOND


def with_unsmoothed_velocity(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, first: FilterStart
) -> tuple[Source, ProcessConfig, FilterStart, list[Finding]]:
    """A log with velocities as they were before its receiver smoothed them.

    Parameters
    ----------
    first : FilterStart
        By :func:`~sinstool.pipelines.process.ins_gnss.first_start.first_start`.

    Returns
    -------
    source, config, first : Source, ProcessConfig, FilterStart
        Unchanged if the receiver does not clearly smooth them, or if options give their noise or
        their lag. The configuration has the lag that is left.
    findings : list of Finding
        One if velocities are changed.
    """
    gnss, same = source.aiding.gnss, (source, config, first, list[Finding]())
    if gnss is None or config.filter.gnss_velocity_lag is not None or receiver_stated(config):
        return same
    shown = _smoothing(source, config, algorithm, first)
    time_s = shown.time_s
    if time_s == 0.0:
        return same
    undone = (
        unsmoothed(gnss, time_s)
        if shown.undoable
        else replace(gnss, velocity_n=np.full_like(gnss.velocity_n, np.nan))
    )
    lag = delay(gnss, time_s) if shown.undoable else 0.0
    changed = replace(source, aiding=replace(source.aiding, gnss=undone))
    options = config.filter.model_copy(update={"gnss_velocity_lag": lag})
    late = config.model_copy(update={"filter": options})
    begun: FilterStart | None = None
    with suppress(AlignmentError):
        begun = first_start(changed, late)
    topic = source.aiding.velocity_topic or source.aiding.fix_topic
    text = (
        f"topic {topic}: the receiver smooths its velocities over {time_s:.2g} s: beside the IMU,"
        " their changes are late and too small"
    )
    log_choice("velocities of the receiver", f"smoothed over {time_s:.2g} s")
    answer = "turn this off in the receiver"
    # They are noisier without it, and may then show no attitude
    if begun is None or begun.time_ns > first.time_ns + LATER_NS:
        text += "; this is left as it is, as the filter would start much later without it"
        changed, late, begun = source, config, first
    elif shown.undoable:
        text += "; this is undone, as far as a low-pass of first order explains it"
        answer += "; --gnss-velocity-lag 0 leaves the velocities as they are"
    else:
        text += ", and the vehicle moves too quickly to undo this: they are not used"
        answer += "; --gnss-velocity-lag 0 uses them as they are"
    finding = Finding(KIND, text, answer=answer, topic=topic, numbers={"time_s": time_s})
    return changed, late, begun, [finding]


def _smoothing(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, first: FilterStart
) -> Smoothing:
    """How the receiver smooths, beside a filter that hardly follows the fixes of the first minutes.

    It follows them a little. So it runs again over velocities that are not smoothed.
    """
    gnss = first.used.rows(~worse_than_usual(first.used))
    shown = gnss.rows(gnss.has_velocity)
    motion = motion_from(source, config, algorithm, first.time_ns) if len(shown) else None
    if motion is None:
        return Smoothing()
    latency_ns = round(first.settings.gnss_latency * SECOND)
    joined = joined_updates(motion, JOINED_S, gnss.time_ns - latency_ns)
    best, fixes = Smoothing(), gnss
    for _ in range(ROUNDS):
        times, velocity_n = _navigated(first, joined, fixes)
        found = smoothing(times, velocity_n, shown.time_ns, shown.velocity_n)
        settled = abs(found.time_s - best.time_s) <= SETTLED * found.time_s
        best = found
        if settled or best.time_s == 0.0:
            break
        fixes = unsmoothed(gnss, best.time_s)
    return best


def _navigated(
    first: FilterStart, motion: Increments, fixes: GnssEpochs
) -> tuple[IntArray, FloatArray]:
    """Times, and velocities of the antenna, (n, 3), m/s."""
    run = InsGnssFilter(first.start, loose(first.settings), with_baro=False)
    updates = run.push(motion, unsized(fixes)).updates
    assert updates is not None
    arm_n = rotate(updates.q_nb, np.broadcast_to(first.settings.lever_arm_b, (len(updates), 3)))
    seconds = (updates.time_ns - updates.time_ns[0]) / SECOND
    return updates.time_ns, updates.velocity_n + np.gradient(arm_n, seconds, axis=0)
