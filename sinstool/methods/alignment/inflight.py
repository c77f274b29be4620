"""Attitude in flight from inertial increments and GNSS velocity.

What callers use::

    imu = ImuIncrements(time_ns, delta_theta, delta_velocity)
    gnss = GnssFixes(time_ns, latitude, longitude, height, velocity_n, sigma_v=None)
    answer = align_in_flight(imu, gnss, AlignmentSettings(...))
    answer.status, answer.q_nb, answer.t_ns, answer.cov, answer.warnings
    answer.series.q_nb, answer.series.sigma_worst       # one row per fix used
    answer.attitude_at(time_ns)                          # any times of the unbroken stretch

The way: :mod:`.preparation` splits the log where the chain of attitude breaks;
:mod:`.accumulation` and :mod:`.reference` integrate both sides; :mod:`.segments` leaves out bad
fixes; :mod:`.gate` finds start and stop; :mod:`.pairs`, :mod:`.wahba` and
:mod:`.covariance` solve, at the end and at every fix; :mod:`.refine` sharpens; :mod:`.solution`
carries the attitude to any time; :mod:`.inflight_answer` puts the answer together.

References
----------
.. [1] Qu X., Li S., Zhu G., Wang Q., Institute of Electronic Engineering, China Academy of
   Engineering Physics: alignment of SINS/GPS in flight by SVD with a gate on large dynamics
   (in Chinese). Its equations are cited by number as "Qu et al.".
.. [2] M. Wu, Y. Wu, X. Hu, D. Hu, "Optimization-based alignment for inertial navigation
   systems: Theory and algorithm", Aerospace Science and Technology 15(1), 2011.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sinstool.methods.alignment.gate import dynamics, lift_off, looks_clipped
from sinstool.methods.alignment.inflight_answer import (
    REFINE_SIGMA,
    InFlightAlignment,
    answer,
    failed,
)
from sinstool.methods.alignment.inflight_types import (
    AlignmentSettings,
    GnssFixes,
    ImuIncrements,
)
from sinstool.methods.alignment.preparation import (
    BRIDGED_NS,
    prepare_fixes,
    stretches,
    walk_of_lost,
)
from sinstool.methods.alignment.segments import Candidate, candidates

# Stretches whose failures are named.
REASONS = 3


def align_in_flight(
    imu: ImuIncrements, gnss: GnssFixes, settings: AlignmentSettings | None = None
) -> InFlightAlignment:
    """Align in flight.

    Returns
    -------
    InFlightAlignment
        Status ``failed`` where no segment could be used; its warnings say why.

    Raises
    ------
    AlignmentError
        If the log cannot be aligned at all: no GNSS velocity, no samples in the time given; or
        if the attitude is wanted at a time to which it cannot be carried.
    """
    settings = settings or AlignmentSettings()
    fixes, settings, warnings = prepare_fixes(gnss, settings)
    clipped = looks_clipped(imu)
    if clipped and settings.gyro_limit is None and settings.accel_limit is None:
        warnings.append(
            f"{clipped} seems to be clipped: its largest value is repeated many times in a row;"
            " give the ranges of the sensors, so that alignment starts after it"
        )
    lift_off_ns = _lift_off(imu, settings, warnings)

    def solved(bridged_ns: int) -> tuple[int, list[str], list[Candidate], list[str]]:
        reasons: list[str] = []
        parts, notes = stretches(imu, settings, bridged_ns)
        answers = [
            candidate
            for part in parts
            for candidate in candidates(
                part, fixes, _with_lost(settings, part.imu), lift_off_ns, reasons
            )
        ]
        return len(parts), notes, answers, reasons

    count, notes, answers, reasons = solved(0)
    if count > 1 and (not answers or min(c.sigma_worst for c in answers) > REFINE_SIGMA):
        # How it turned in short gaps is known better than its attitude
        joined = solved(BRIDGED_NS)
        if joined[0] < count and joined[2]:
            _, notes, answers, reasons = joined
    warnings += notes
    if not answers:
        if len(reasons) > REASONS:
            more = f"{len(reasons) - REASONS} more stretches of the IMU could not be used either"
            reasons = [*reasons[:REASONS], more]
        return failed(
            settings, imu, [*warnings, *(reasons or ["no stretch of the IMU can be aligned"])]
        )
    best = min(answers, key=lambda c: c.sigma_worst)
    if len(answers) > 1:
        warnings.append(f"{len(answers)} segments could be aligned; the best is used")
    return answer(best, _with_lost(settings, best.stretch.imu), warnings + best.warnings)


def _with_lost(settings: AlignmentSettings, imu: ImuIncrements) -> AlignmentSettings:
    """Settings with the angle random walk of attitudes integrated across lost samples."""
    lost = walk_of_lost(imu)
    if lost == 0.0:
        return settings
    walk = float(np.hypot(settings.grade.angle_random_walk, lost))
    return replace(settings, grade=replace(settings.grade, angle_random_walk=walk))


def _lift_off(imu: ImuIncrements, settings: AlignmentSettings, warnings: list[str]) -> int:
    if settings.t0_ns is not None:
        return settings.t0_ns
    index = lift_off(dynamics(imu))
    if index is None:
        if settings.gate != "off" and settings.start_ns is None:
            warnings.append("no lift-off found (2 g for 0.1 s): counted from the first sample")
        index = 0
    return int(imu.time_ns[index])
