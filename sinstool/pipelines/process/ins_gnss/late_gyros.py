"""The delay of gyros behind the accelerometers beside them, where a log shows one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.finding import Finding, Severity
from sinstool.core.units import DEGREE
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.ins_gnss.gyro_delay import in_time
from sinstool.methods.ins_gnss.receiver_offsets import estimate_offsets
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.timing import motion_from
from sinstool.survey.source import Source

# Turn by late gyros, which one fix of twenty exceeds, over its sigma, beyond which nothing is to be
# trusted.
MOST_LAGGING = 2.0
# An estimate is repeated with gyros that are in time by it until it changes by less than this share
# of its sigma, in so many rounds at most; no delay is longer than this, s.
AGREES, ROUNDS, LONGEST_S = 0.5, 6, 1.0


def settled_delay(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> FilterStart:
    """A start whose delay of gyros is its own estimate, if the log shows one.

    Errors by a long delay are not linear in it, so that the first estimate is too small.
    """
    shown = start.offsets
    if shown is None or shown.gyros is None or not shown.gyros.shown:
        return start
    motion = motion_from(source, config, algorithm, start.time_ns)
    if motion is None:
        return start
    delay, latency = shown.gyros.delay_s, start.settings.gnss_latency
    stated_b = config.gnss.lever_arm
    for _ in range(ROUNDS):
        settings = replace(start.settings.ungated, gnss_latency=latency)
        about = estimate_offsets(
            start.start,
            settings,
            [in_time(motion, delay)],
            start.believable,
            stated_b or np.zeros(3),
            stated_b is not None,
        )
        if about is None or about.gyros is None:
            return start
        step, sigma = about.gyros.delay_s, about.gyros.sigma_s
        delay, latency = delay + step, about.latency_s
        if abs(delay) > LONGEST_S:
            return start
        if abs(step) < AGREES * sigma:
            gyros = shown.gyros.settled(delay, sigma)
            return replace(start, offsets=replace(shown, gyros=gyros))
    return start


def late_gyros(start: FilterStart) -> list[Finding]:
    """A finding of gyros that are stamped later or earlier than the accelerometers beside them.

    The attitude is that of another time than the specific force, which a filter cannot correct.
    """
    gyros = None if start.offsets is None else start.offsets.gyros
    if gyros is None or not gyros.shown:
        return []
    severe = gyros.sigmas > MOST_LAGGING
    late = "later" if gyros.delay_s > 0.0 else "earlier"
    return [
        Finding(
            "gyro-delay",
            f"as the log shows, gyros are stamped {abs(gyros.delay_s):.3f} s {late} (sigma"
            f" {gyros.sigma_s:.3f}) than the accelerometers beside them, so that the attitude is"
            f" off by {gyros.turn / DEGREE:.2g} deg ({gyros.sigmas:.1f} sigmas) and more in turns,"
            " which the sigmas do not include" + (": do not trust the solution" if severe else ""),
            Severity.LOST if severe else Severity.WARNING,
            "have both stamped when they measure, and both filtered alike",
            numbers={"delay_s": gyros.delay_s, "sigma_s": gyros.sigma_s},
        )
    ]
