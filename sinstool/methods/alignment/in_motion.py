"""Attitude of a vehicle in motion from the samples and GNSS epochs of a log.

The front end of :mod:`.inflight`: spans of time are tried until one gives a good answer. `align`,
the first attitude of `process` and the start of the INS/GNSS filter all begin here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.errors import AlignmentError
from sinstool.core.order_statistics import median
from sinstool.core.streams import Imu
from sinstool.core.timeline import SECOND
from sinstool.methods.alignment.inflight import align_in_flight
from sinstool.methods.alignment.inflight_answer import INCONSISTENT_CHI2, InFlightAlignment
from sinstool.methods.alignment.inflight_types import AlignmentSettings, GnssFixes, ImuIncrements
from sinstool.methods.alignment.level_bias import MOST_S, MOVING_M_S, LevelBias, level_bias
from sinstool.methods.alignment.measurements import increments
from sinstool.methods.alignment.preparation import MIN_POSITION_SPAN_S, prepare_fixes, walk_of_lost
from sinstool.methods.alignment.solution import carried
from sinstool.methods.alignment.span_reader import NO_SAMPLES, SpanReader
from sinstool.methods.sensor_errors import SensorGrade

# Without a gate, alignment begins BEFORE_S before the vehicle first moves, and uses these spans one
# after the other. For a walker, who is never fast for long, lower speeds count as motion.
SLOW_M_S = (1.0, 0.5)
BEFORE_S = 5.0
SPANS_S = (200.0, 600.0)
# Spans short enough that a gyro bias of 0.5 deg/s leaves the attitude good enough for the
# refinement, which then estimates the bias. The longest is that of `level_bias`.
SHORT_S = (15.0, 25.0, 40.0, 70.0, MOST_S)
# A bias of more sigmas than this is removed and alignment begins anew, at most so many times, as
# the refinement is linear.
SURPRISE = 1.0
ROUNDS = 4
# A log shows a bias if it leaves no more than this share of the sigma that was assumed.
SHOWN = 0.7
# Over a longer span, s, a bias that was not shown, but is far beyond what was assumed, leaves
# residuals that no attitude explains.
UNSEEN_S = 60.0
# Sigmas by which a gyro bias may differ from that with which the vehicle goes where it points.
MOST_OFF = 5.0


@dataclass(frozen=True)
class MotionAlignment:
    """An alignment in motion, and its inputs.

    Attributes
    ----------
    gyro_bias : ndarray, shape (3,)
        Taken off the samples before, rad/s.
    fixes : GnssFixes
        All of the log.
    bias_by_motion : bool
        That gyro bias was not given but found in the motion; before any refinement of its own
        that is as uncertain as the grade of `settings` says.
    bias_assumed : float
        Of a bias so large, rad/s (1 sigma), nothing was seen; allowing for it hides the attitude.
    """

    result: InFlightAlignment
    gyro_bias: FloatArray
    settings: AlignmentSettings
    fixes: GnssFixes
    bias_by_motion: bool = False
    bias_assumed: float = 0.0

    @property
    def good(self) -> bool:
        """Whether it gives a heading."""
        return self.result.status in ("ok", "degraded")

    @property
    def consistent(self) -> bool:
        """Whether its refined residuals are about as large as the assumed noise explains."""
        errors = self.result.errors
        return errors is not None and errors.chi2 <= INCONSISTENT_CHI2

    @property
    def bias_surprises(self) -> bool:
        """Whether there is no heading, or a gyro bias beyond what the grade allows."""
        errors = self.result.errors
        if not self.good or errors is None:
            return True
        return bool(np.max(np.abs(errors.gyro_bias)) > SURPRISE * self.settings.grade.gyro_bias)

    @property
    def fits(self) -> bool:
        """Whether it gives a heading that the fixes agree with, and a gyro bias as of its grade."""
        return self.consistent and not self.bias_surprises

    @property
    def bias_shown(self) -> bool:
        """Whether the fixes, rather than the grade, say what the gyro bias is."""
        errors = self.result.errors
        assumed = self.settings.grade.gyro_bias
        return errors is None or bool(np.max(errors.sigma["gyro_bias"]) <= SHOWN * assumed)

    @property
    def refined_bias(self) -> FloatArray:
        """Gyro bias, the refinement's part included, shape (3,), rad/s."""
        errors = self.result.errors
        return self.gyro_bias if errors is None else self.gyro_bias + errors.gyro_bias

    def carried_back(self, imu: ImuIncrements) -> tuple[FloatArray, FloatArray]:
        """The attitude at the first of some samples that end where it holds.

        Parameters
        ----------
        imu : ImuIncrements
            Without gaps, :attr:`refined_bias` taken off.

        Returns
        -------
        q_nb : ndarray, shape (4,)
        covariance_n : ndarray, shape (3, 3)
            With what noise, bias and scale factors of the gyros do meanwhile, rad^2.
        """
        result, grade = self.result, self.settings.grade
        q_nb, per_bias, per_scale = carried(imu, self.fixes, result.t_ns, result.q_nb)
        seconds = float(imu.time_ns[-1] - imu.time_ns[0]) / SECOND
        bias, scale = grade.gyro_bias, grade.gyro_scale
        if result.errors is not None:
            bias = float(np.max(result.errors.sigma["gyro_bias"]))
            scale = float(np.max(result.errors.sigma["gyro_scale"]))
        walk = grade.angle_random_walk**2 + walk_of_lost(imu) ** 2
        covariance = result.cov + walk * seconds * np.eye(3)
        for gain, sigma in ((per_bias, bias), (per_scale, scale)):
            covariance = covariance + sigma**2 * gain @ gain.T
        return q_nb, covariance


Known = dict[tuple[bytes, AlignmentSettings], tuple[float, InFlightAlignment]]
"""Alignments over spans of samples from one start, by gyro bias and settings without
`refuse_sigma`; the value is the `refuse_sigma` used, with the result."""


def align_in_motion(
    samples: SpanReader,
    gyro_kind: str,
    interval_s: float,
    fixes: GnssFixes,
    settings: AlignmentSettings,
    gyro_bias: FloatArray,
    ends_ns: Sequence[int | None],
    bias_unknown: float | None = None,
    bias_unseen: float | None = None,
    notes: tuple[str, ...] = (),
    known: Known | None = None,
) -> MotionAlignment:
    """Align over one span of time after the other until the answer is good.

    Parameters
    ----------
    samples : SpanReader
        From the alignment's beginning, or from before it.
    gyro_kind : {'rate', 'mean-rate', 'increment'}
        What the samples are: see :func:`increments`.
    interval_s : float
        Of the first sample.
    settings : AlignmentSettings
        Its end is that of the span.
    gyro_bias : ndarray, shape (3,)
        Taken off the samples, rad/s.
    ends_ns : sequence of int or None
        Ends of the spans; None for the last sample.
    bias_unknown : float, optional
        Standard deviation of the gyro bias, rad/s, where the refinement shows that that of the
        sensors is too small.
    bias_unseen : float, optional
        The same where the fixes do not show the bias, so that an answer is only as good as what was
        assumed of it.
    notes : tuple of str, optional
        Warnings that come before those of the alignment.
    known : dict, optional
        What is known of the same samples and fixes; gets what is made now.

    Returns
    -------
    MotionAlignment
        Of the first span whose status is ``ok``, else of the best.

    Raises
    ------
    AlignmentError
        There is nothing to align with.
    """

    def aligned(imu: Imu, bias: FloatArray, span: AlignmentSettings) -> InFlightAlignment:
        key = bias.tobytes(), replace(span, refuse_sigma=np.inf)
        if known is not None and key in known:
            refused, result = known[key]
            if result.is_same(refused, span.refuse_sigma):
                return result
        result = align_in_flight(increments(imu, gyro_kind, interval_s, bias), fixes, span)
        if known is not None:
            known[key] = span.refuse_sigma, result
        return result

    def tried(
        bias: FloatArray,
        errors: SensorGrade,
        ends: Sequence[int | None],
        around: bool = settings.around,
    ) -> MotionAlignment | None:
        best: MotionAlignment | None = None
        refused: AlignmentError | None = None
        for end_ns in ends:
            span = replace(settings, grade=errors, end_ns=end_ns, around=around)
            try:
                # Where the fixes do not do, samples need not be read.
                prepare_fixes(fixes, span)
            except AlignmentError as exc:  # a longer span may have enough of them
                refused = refused or exc
                continue
            imu = samples.until(end_ns)
            if not len(imu):  # all of it lies in a gap
                continue
            result = aligned(imu, bias, span)
            if best is None or _better(result, best.result):
                warnings = (*notes, *result.warnings, *samples.cut_short(end_ns))
                result = replace(result, warnings=warnings)
                best = MotionAlignment(result, bias, span, fixes, bias is not gyro_bias)
            if result.status == "ok":
                break
        if best is not None or refused is None:
            return best
        try:
            raise refused
        finally:
            del refused  # it refers to this frame, which refers to it

    def settled(rough: MotionAlignment) -> MotionAlignment:
        for _ in range(ROUNDS):
            again = tried(rough.refined_bias, settings.grade, ends_ns)
            # Without a refinement nobody knows what that bias is good for
            if again is None or not again.good or again.result.errors is None:
                break
            rough = again
            if not rough.bias_surprises:
                break
        return rough

    def allowing_bias(one: MotionAlignment, level: LevelBias | None) -> MotionAlignment:
        if bias_unseen is None or not one.good or one.bias_shown:
            return one
        if one.result.t_stop_ns - one.result.t_q_ns > UNSEEN_S * SECOND:
            return one
        sigma = bias_unseen if level is None else min(bias_unseen, level.sigma_any)
        errors = replace(settings.grade, gyro_bias=max(settings.grade.gyro_bias, sigma))
        # A solver, which estimates no bias, may not know the heading that a refinement finds
        for around in (settings.around, True):
            # About the answer found, where the refinement is linear
            again = tried(one.refined_bias, errors, ends_ns, around)
            if again is not None and again.good:
                return again
        return replace(one, bias_assumed=sigma)

    best = tried(gyro_bias, settings.grade, ends_ns)
    if best is None:
        raise AlignmentError(NO_SAMPLES, "widen start and end")
    shown = bias_unseen is None or best.bias_shown
    if shown and (bias_unknown is None or not best.bias_surprises):
        return best
    begin = samples.first_ns if settings.start_ns is None else settings.start_ns
    short = [begin + round(s * SECOND) for s in SHORT_S]
    beyond = short[-1] + SECOND
    last = ends_ns[-1]
    imu = samples.until(beyond if last is None else min(beyond, last))
    level = level_bias(imu, fixes, begin)
    if bias_unknown is None:
        return allowing_bias(best, level)
    ends = [end for end in short if end < imu.time_ns[-1]]
    rough = tried(gyro_bias, replace(settings.grade, gyro_bias=bias_unknown), ends)
    if (rough is None or not rough.good) and level is not None:
        errors = replace(settings.grade, gyro_bias=level.sigma_any)
        rough = tried(level.bias, errors, [*ends, *ends_ns])
    if (rough is None or not rough.good) and not best.good:
        # With an ordinary bias, which spoils long spans all the same where little changes
        rough = tried(gyro_bias, settings.grade, ends)
    # A bias a little beyond the ordinary may be what it is, and a large one an illusion
    found = [settled(one) for one in (best, rough) if one is not None and one.good]
    # Residuals of a short span say nothing against an ordinary bias that fits all of a long one
    sure = [one for one in found if one.settings.end_ns in ends_ns and one.fits]
    likeliest = min(sure or found, key=lambda one: one.result.chi2, default=best)
    if level is not None and _turns_away(likeliest, level):
        goes = tried(level.bias, settings.grade, ends_ns)
        likeliest = likeliest if goes is None or not goes.good else settled(goes)
    return allowing_bias(likeliest, level)


def _turns_away(moving: MotionAlignment, level: LevelBias) -> bool:
    """Whether the gyro bias of an alignment has a vehicle turn away from its course all the time.

    Without acceleration no residual shows a bias about the vertical. One that is wrong, with a
    heading that is as wrong, may fit the few turns of the first minutes as well as the right one.
    """
    if not moving.good:
        return False
    errors = moving.result.errors
    sigma = moving.settings.grade.gyro_bias if errors is None else errors.sigma["gyro_bias"].max()
    off = float((moving.refined_bias - level.bias) @ level.up)
    return abs(off) > MOST_OFF * float(np.hypot(sigma, level.sigma))


def _better(new: InFlightAlignment, old: InFlightAlignment) -> bool:
    return old.status == "failed" or new.sigma_worst < old.sigma_worst


def spans(
    gate: str, start_ns: int | None, end_ns: int | None, first_ns: int, last_ns: int
) -> list[int | None]:
    """Ends of the spans of time to align over, one after the other; None for the last sample.

    Parameters
    ----------
    gate : {'paper', 'mask', 'off'}
    start_ns, end_ns : int or None
        Of alignment, where they are fixed.
    first_ns : int
        Time of the first sample.
    last_ns : int
        Time of the last fix.
    """
    if end_ns is not None:
        return [end_ns]
    if gate == "paper":
        return [None]  # it stops by itself
    begin = first_ns if start_ns is None else start_ns
    ends = [begin + round(s * SECOND) for s in SPANS_S]
    # a span that holds all of the log is tried once
    inside = [e for e in ends if e < last_ns]
    return [*inside, None] if len(inside) < len(ends) else [*inside]


def first_motion(fixes: GnssFixes, first_ns: int, rest_ns: int) -> int | None:
    """When alignment without a gate begins: shortly before GNSS first moves, ns.

    Or where it first moves slowly, if what follows a faster motion is too short to align by.

    Parameters
    ----------
    first_ns : int
        Time of the first sample.
    rest_ns : int
        Until then the vehicle rests, whatever GNSS says.
    """
    speed = np.linalg.norm(fixes.velocity_n[:, :2], axis=1)
    left_s = (fixes.time_ns[-1] - fixes.time_ns) / SECOND
    begin: int | None = None
    for least in (MOVING_M_S, *SLOW_M_S):
        moving = np.flatnonzero((speed > least) & (fixes.time_ns >= rest_ns))
        if not len(moving) or (begin is not None and median(speed) < least):
            break  # what is usually slower stands, and its fixes are noisy
        enough = left_s[moving[0]] >= MIN_POSITION_SPAN_S
        if enough or begin is None:
            begin = max(first_ns, int(fixes.time_ns[moving[0]]) - round(BEFORE_S * SECOND))
        if enough:
            break
    return begin
