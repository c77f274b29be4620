"""Validity time of the fixes of a log, estimated unless the user gives it.

An epoch is valid ``latency`` before its stamp. Position and velocity of one message need not be
of one instant: some receivers difference positions, or average over the interval that ends at
the fix. The lag is the time by which velocities are stamped later than positions. The latency is
then the mean of both: positions are valid at ``stamp - latency + lag/2`` and velocities at
``stamp - latency - lag/2``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.arrays import FloatArray
from sinstool.core.errors import AlignmentError
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.ins_gnss.fix_velocity import (
    velocity_lag,
)
from sinstool.methods.ins_gnss.receiver_offsets import (
    ReceiverOffsets,
    estimate_offsets,
    likeliest,
    settle,
)
from sinstool.methods.strapdown.velocity import Increments
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.survey.increments import first_increments
from sinstool.survey.rest import rest_end
from sinstool.survey.rough_latency import rough_latency
from sinstool.survey.source import Source

# The first part of a log, from which latency and lever arm are estimated, up to a gap.
FIRST_NS = 400 * SECOND
# A rest at its beginning shows neither, and lengthens it, up to this.
LONGEST_REST_NS = 600 * SECOND
GAP_NS = 5 * SECOND
# A latency is used if it is more than this, s, and more than so many of its sigmas: stamps of most
# receivers are right, and 10 ms with a sigma of 7 ms are then more likely chance.
LEAST_S = 0.01
USED = 2.5
# An antenna that shakes can fit several latencies about as well. The estimate may be a wrong one of
# them if squared innovations stay MISFIT times as large as expected, if successive estimates differ
# by more than JUMPED sigmas without converging (slope of the estimate over the latency used outside
# BACK to FURTHER), if over all rounds the estimate follows the latency used by the share ALONG, or
# if it contradicts a given lever arm.
MISFIT = 4.0
BACK, FURTHER, JUMPED = -0.5, 1.0, 5.0
ALONG = 0.9
# Then these are tried, s, and those about the best of them: with an antenna that shakes at 10 Hz
# and more, only latencies within a few ms of the right one explain the fixes.
LATENCIES = np.arange(-0.1, 0.26, 0.02)
NEARER = 0.005 * np.arange(-3, 4)
# A lag is used if it is more than this, s, and more than so many of its sigmas.
LEAST_LAG_S = 0.02
LAG_SIGMAS = 6.0
# The estimate begins with a rough latency that explains the fixes better and differs from the one
# assumed by more than this, s; nearer ones it finds by itself.
FAR_S = 0.4
# An arm that was not given is used if an estimate repeated about it agrees within so many sigmas,
# after at most so many rounds, and if it lowers -2 log likelihood by so much.
ARM_AGREES, ARM_ROUNDS, ARM_GAIN = 1.0, 4, 16.0

Begin = Callable[[float, FloatArray | None], FilterStart]


@dataclass(frozen=True)
class Estimates:
    """Latencies, s, and the estimates about them, in the order in which they were made.

    Attributes
    ----------
    made, tried : list
        All, and those without a gate, which rejects the fixes that contradict a latency.
    """

    made: list[tuple[float, ReceiverOffsets]] = field(default_factory=list)
    tried: list[tuple[float, ReceiverOffsets]] = field(default_factory=list)

    @property
    def misfit(self) -> float:
        """That which the last one without a gate leaves; infinite without any."""
        return self.tried[-1][1].misfit if self.tried else np.inf

    @property
    def doubtful(self) -> bool:
        """Whether the estimates may have led to a wrong latency."""
        if not self.tried:
            return False
        last = self.tried[-1][1]
        if last.misfit > MISFIT or (last.given and last.arm_contradicts):
            return True
        for (before, shown), (latency, follows) in pairwise(self.tried):
            change = follows.latency_s - shown.latency_s
            slope = change / (latency - before) if latency != before else 0.0
            jumped = abs(change) > JUMPED * max(shown.sigma_s, follows.sigma_s)
            if jumped and not BACK < slope < FURTHER:
                return True
        return False

    @property
    def followed_assumption(self) -> bool:
        """Whether estimates followed the latencies about which they were made.

        A gate that rejects the fixes that contradict a wrong latency confirms any latency: each
        estimate is near the latency used, and no two successive ones differ by much.
        """
        if len(self.made) < 2:
            return False
        (first, shown), (last, follows) = self.made[0], self.made[-1]
        change, way = follows.latency_s - shown.latency_s, last - first
        far = abs(change) > JUMPED * max(shown.sigma_s, follows.sigma_s)
        return far and change * way > ALONG * way**2


@dataclass(frozen=True)
class _Settled:
    """What :func:`settle` returns, and the estimates that led there."""

    used: float
    offsets: ReceiverOffsets | None
    agrees: bool
    found: Estimates


def significant_lag(gnss: GnssEpochs) -> float:
    """Delay of velocities relative to positions, s; 0 where none is significant."""
    lag = velocity_lag(gnss.rows(gnss.time_ns <= gnss.time_ns[0] + FIRST_NS))
    stands_out = lag.status == "found" and lag.differs_from(0.0, LEAST_LAG_S, LAG_SIGMAS)
    return lag.latency_s if stands_out else 0.0


class _Trials:
    """Starts with other latencies and lever arms, and the estimates made about them.

    Parameters
    ----------
    first : FilterStart
        With the latency assumed first.
    begin : callable
        See :func:`with_offsets`.
    """

    def __init__(
        self,
        source: Source,
        config: ProcessConfig,
        algorithm: ConingAlgorithm,
        first: FilterStart,
        begin: Begin,
    ) -> None:
        self._source, self._config, self._algorithm = source, config, algorithm
        self._first, self._begin = first, begin
        self._begun = {first.settings.gnss_latency: first}
        self._found = Estimates()

    def start(self, latency: float) -> FilterStart:
        """A start with the assumed arm, made once for each latency.

        Raises
        ------
        AlignmentError
            With this latency there is none.
        """
        if latency not in self._begun:
            self._begun[latency] = self._begin(latency, None)
        return self._begun[latency]

    def estimate(
        self, latency: float, arm_b: FloatArray | None, gated: bool
    ) -> ReceiverOffsets | None:
        """Estimate about a latency, s, and an arm (None: the assumed one), with their own start."""
        try:
            start = self.start(latency) if arm_b is None else self._begin(latency, arm_b)
        except AlignmentError:  # a wrong latency may leave no start
            return None
        motion = motion_from(self._source, self._config, self._algorithm, start.time_ns)
        if motion is None:
            return None
        settings, fixes = start.settings, start.used
        if not gated:
            settings, fixes = settings.ungated, start.believable
        stated_b = self._config.gnss.lever_arm
        assumed_b, given = stated_b or np.zeros(3), stated_b is not None
        shown = estimate_offsets(start.start, settings, [motion], fixes, assumed_b, given)
        if shown is not None:
            self._found.made.append((latency, shown))
            if not gated:
                self._found.tried.append((latency, shown))
        return shown

    def square(self, latency: float) -> float:
        """How well a latency explains the fixes, with its own start: mean normalised square.

        A start with a wrong latency may have an attitude that makes any other latency less likely,
        so each has its own start. Fixes at a wrong time look noisy, so all have the noise of the
        first. Infinite without a start.
        """
        try:
            start = self.start(latency)
        except AlignmentError:
            return np.inf
        settings = replace(start.settings, gnss=self._first.settings.gnss)
        start = replace(start, gnss=self._first.gnss, settings=settings)
        same = with_same_start(self._source, self._config, self._algorithm, start)
        shown = same(latency, None)
        return np.inf if shown is None else shown.square

    def _settled(self, latency: float) -> _Settled:
        self._found = Estimates()
        return _Settled(*settle(self.estimate, latency), self._found)

    def best(self) -> tuple[_Settled, float]:
        """The latency on which estimates settle, and how well the assumed one explains fixes."""
        assumed, at_first = self._first.settings.gnss_latency, None
        begins = assumed
        rough = rough_latency(self._source.survey.windows, self._source.aiding.gnss)
        if rough is not None and abs(rough - assumed) > FAR_S:
            at_first = self.square(assumed)
            begins = rough if self.square(rough) < at_first else assumed
        best = self._settled(begins)
        if at_first is None:
            at_first = best.found.tried[0][1].square if best.found.tried else 0.0
        if best.found.doubtful or best.found.followed_assumption:
            likeliest_s = _likeliest_latency(
                self._source, self._config, self._algorithm, self._first
            )
            other = self._settled(likeliest_s)
            if other.found.misfit < best.found.misfit:
                best = other
        return best, at_first


def with_offsets(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    first: FilterStart,
    begin: Begin,
) -> FilterStart:
    """A start with the receiver's latency, configured or estimated, and with the lever arm.

    A given latency is used, but still estimated, as the log may contradict it. Otherwise the
    estimate is used if the log shows it and it differs from the one assumed first.

    Parameters
    ----------
    begin : callable
        Makes a start with another latency, s, and with the assumed arm (None) or another, FRD, m.
    """
    trials = _Trials(source, config, algorithm, first, begin)
    assumed = first.settings.gnss_latency
    best, at_first = trials.best()
    used, offsets, agrees = best.used, best.offsets, best.agrees
    if offsets is not None and abs(used - assumed) > LEAST_S:
        worse = best.found.tried and best.found.tried[-1][1].square > at_first
        # The latency settled on may explain the fixes no better than the one assumed
        if worse and trials.square(used) > at_first:
            same = with_same_start(source, config, algorithm, first)
            likelier = likeliest(same, (assumed, used), offsets.arm_elsewhere_b)
            if likelier is not None:
                used, offsets = likelier
                agrees = offsets.observable
    start, status = first, "not observable"
    if config.gnss.gnss_latency is not None:
        status = "given"
        if offsets is not None and agrees:
            offsets = offsets.against(assumed, at_first)
    elif offsets is not None and offsets.observable:
        status = "found" if agrees else "not settled"
        if used != assumed and not (
            agrees and not offsets.latency.differs_from(assumed, LEAST_S, USED)
        ):
            try:
                start = trials.start(used)
            except AlignmentError:  # a start with a contradicted latency is better than none
                status = "not settled"
    start = replace(start, offsets=offsets, latency_status=status)
    if config.gnss.lever_arm is not None:
        return start
    return _with_arm(source, config, algorithm, start, trials.estimate, begin)


def _with_arm(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    start: FilterStart,
    evaluate: Callable[[float, FloatArray | None, bool], ReceiverOffsets | None],
    begin: Begin,
) -> FilterStart:
    """A start with the lever arm that the log shows, if it does; none was given."""
    latency, shown = start.settings.gnss_latency, start.offsets
    start = replace(start, arm_status="open")
    if shown is None:
        return start
    start = replace(start, offsets=shown.used_at(np.zeros(3)))
    if not shown.arm_shown:
        return start
    arm_b = shown.used_at(np.zeros(3)).arm_b
    for _ in range(ARM_ROUNDS):
        about = evaluate(latency, arm_b, False)
        if about is None or not about.arm_shown:
            return start
        offsets = about.used_at(arm_b)
        if np.all(np.abs(offsets.arm_off_b) < ARM_AGREES * offsets.arm_off_sigma_b):
            break
        arm_b = offsets.arm_b
    else:
        return start
    try:
        begun = begin(latency, arm_b)
    except AlignmentError:
        return start
    same = with_same_start(source, config, algorithm, begun)
    before, after = same(latency, np.zeros(3)), same(latency, arm_b)
    if before is None or after is None:
        return start
    gain = before.square * before.rows - after.square * after.rows
    if gain < ARM_GAIN * max(after.misfit, 1.0):
        return start
    return replace(
        begun,
        offsets=replace(offsets, spread=shown.spread),
        latency_status=start.latency_status,
        arm_status="found",
    )


def with_same_start(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, first: FilterStart
) -> Callable[[float, FloatArray | None], ReceiverOffsets | None]:
    """Estimates about a latency, s, and an arm (None: the one in use), from one and the same start.

    Likelihoods from different starts, with different noise and errors, cannot be compared.
    """
    motion = motion_from(source, config, algorithm, first.time_ns)
    fixes = first.believable
    ungated, stated_b = first.settings.ungated, config.gnss.lever_arm

    def about(latency: float, arm_b: FloatArray | None) -> ReceiverOffsets | None:
        if motion is None:
            return None
        x, y, z = np.asarray(first.settings.lever_arm_b if arm_b is None else arm_b).tolist()
        settings = replace(ungated, gnss_latency=latency, lever_arm_b=(x, y, z))
        assumed_b, given = stated_b or np.zeros(3), stated_b is not None
        return estimate_offsets(first.start, settings, [motion], fixes, assumed_b, given)

    return about


def _likeliest_latency(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, first: FilterStart
) -> float:
    """Latency, s, with the least misfit, of `LATENCIES` and those near the best of them."""
    about = with_same_start(source, config, algorithm, first)

    @cache
    def misfit(latency: float) -> float:
        shown = about(latency, None)
        return np.inf if shown is None else shown.misfit

    if about(first.settings.gnss_latency, None) is None:
        return first.settings.gnss_latency
    best = min(LATENCIES.tolist(), key=misfit)
    return min((best + NEARER).tolist(), key=misfit)


def motion_from(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start_ns: int
) -> Increments | None:
    """Increments of the log's first part from a start on, up to a gap; None without any.

    Across a gap a filter's errors depend on how the gap is bridged, not on latency or lever arm.
    """
    span_ns = FIRST_NS + _rest_from(source, start_ns)
    return first_increments(source, config, algorithm, start_ns, span_ns, GAP_NS)


def _rest_from(source: Source, start_ns: int) -> int:
    """For how long the vehicle still rests, of the rest at the log's beginning, ns."""
    survey = source.survey
    if survey.lead_in is None:
        return 0
    end_ns = rest_end(survey.lead_in, survey.spans, survey.windows)
    return min(max(0, end_ns - start_ns), LONGEST_REST_NS)
