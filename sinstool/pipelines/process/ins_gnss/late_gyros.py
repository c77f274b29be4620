"""The delay of gyros behind the accelerometers beside them, where a log shows one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.finding import Finding, Severity
from sinstool.core.units import DEGREE
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.ins_gnss.gyro_delay import GyroDelay, in_time
from sinstool.methods.ins_gnss.receiver_offsets import ReceiverOffsets, estimate_offsets
from sinstool.methods.sensor_errors import IMU_GRADES
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.timing import motion_from
from sinstool.survey.source import Source

# Turn by late gyros, which one fix of twenty exceeds, over its sigma, beyond which nothing is to be
# trusted.
MOST_LAGGING = 2.0
# An estimate is repeated with gyros that are in time by it until it changes by less than this share
# of its sigma, and the latency of fixes, which stood in for it, by less than its own sigma or so
# many seconds; in so many rounds at most. No delay is longer than this, s.
AGREES, AGREE_S, ROUNDS, LONGEST_S = 0.5, 0.01, 12, 1.0
# Where a body sways faster than the delay is long, an estimate about no delay says nothing, but
# gyros seem to be as noisy as those of chips. Then these are tried, s, and count if they lower
# squared innovations by so much.
TRIED_S, LEAST_GAIN = (-0.3, -0.15, 0.15, 0.3), 100.0


def settled_delay(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> FilterStart:
    """A start whose delay of gyros is its own estimate, with its noise as it was found.

    Errors by a long delay are not linear in it, so that the first estimate is too small.
    """
    shown, stated_b = start.offsets, config.gnss.lever_arm
    if shown is None or shown.gyros is None or shown.gyros.denied:
        return start
    motion = motion_from(source, config, algorithm, start.time_ns)
    if motion is None:
        return start

    def about(delay: float, latency: float) -> ReceiverOffsets | None:
        return estimate_offsets(
            start.start,
            replace(start.settings.ungated, gnss_latency=latency),
            [in_time(motion, delay)],
            start.believable,
            stated_b or np.zeros(3),
            stated_b is not None,
        )

    def settled(found: ReceiverOffsets, delay: float) -> GyroDelay | None:
        """The delay that is its own estimate, from one about a first delay on."""
        latency = used
        for _ in range(ROUNDS):
            gyros = found.gyros
            if gyros is None or abs(delay + gyros.delay_s) > LONGEST_S:
                return None
            delay += gyros.delay_s
            moved = abs(found.latency_s - latency)
            if abs(gyros.delay_s) < AGREES * gyros.sigma_s and moved < max(found.sigma_s, AGREE_S):
                return replace(gyros, delay_s=delay)
            latency = found.latency_s
            following = about(delay, latency)
            if following is None:
                return None
            found = following
        return None

    used = start.settings.gnss_latency
    first = about(0.0, used)
    if first is None or first.gyros is None:
        return start
    best = settled(first, 0.0) if first.gyros.shown else None
    chips = start.settings.imu.angle_random_walk >= IMU_GRADES["mems"].angle_random_walk
    if best is None and (first.gyros.shown or chips):
        tried = [(one, delay) for delay in TRIED_S if (one := about(delay, used)) is not None]
        likeliest, delay = min(tried, key=lambda pair: _square(pair[0]), default=(first, 0.0))
        if _square(likeliest) < _square(first) - LEAST_GAIN:
            best = settled(likeliest, delay)
    return replace(start, offsets=replace(shown, gyros=best or first.gyros))


def _square(shown: ReceiverOffsets) -> float:
    """Sum of the squares of the innovations, over their expected covariance."""
    return shown.square * shown.rows


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
