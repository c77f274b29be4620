"""Latency of fixes and lever arm, estimated together from innovations.

The one looks like the other: at constant speed a latency moves every fix along the track as an
arm further back does. What tells them apart is speed that changes, and a body that does not turn as
its course does. So both are estimated at once, each about what is usual or was given for it, and
what the data leave open stays in their covariance.

A constant error of the measurements changes the innovations of a filter linearly: the estimate
of an ordinary filter goes astray by ``V b`` where ``b`` are latency and arm less those it assumes.
``V`` follows from the filter's own transitions and gains [1]_, its innovations are ``(H V + D) b``
and white noise of the covariance that it expects, so that one pass gives the information on b and
all that the filter estimates beside is accounted for: attitude, biases, lasting errors of fixes.

White innovations are what the filter believes. Beside the covariance of that belief stands the one
by how the scores of stretches really scatter [2]_; of each sigma the larger counts.

References
----------
.. [1] B. Friedland, "Treatment of bias in recursive filtering", IEEE Trans. Automatic Control
   14(4), 1969, 359-367.
.. [2] H. White, "Maximum likelihood estimation of misspecified models", Econometrica 50(1), 1982,
   1-25.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sinstool.core.arrays import ArrayLike, FloatArray
from sinstool.core.streams import GnssEpochs
from sinstool.methods.ins_gnss.clock_rate import STEADY, ClockRate, clock_rate
from sinstool.methods.ins_gnss.latency import Latency, LatencyStatus
from sinstool.methods.ins_gnss.offset_scores import OffsetScores, offset_scores
from sinstool.methods.ins_gnss.settings import Settings, Start
from sinstool.methods.strapdown.velocity import Increments

LATENCY_S = 0.2
"""Latencies of receivers are 0 give or take this, 1 sigma."""

ARM_SURE_M, ARM_UNKNOWN_M = 0.1, 2.0
"""A lever arm is measured to a decimetre; one that is not given is within a couple of metres."""

ARM_USUAL_M = 1.0
"""So far is an antenna usually from the IMU, 1 sigma, where the log leaves open where it is."""

MAX_SIGMA_S = 0.05
"""A latency that is not known to this is as good as not known."""

BEYOND, LATENCY_BEYOND, LEAST_LATENCY_S = 4.0, 3.0, 0.01
"""Sigmas beyond which an estimate contradicts what was assumed, of an arm and of a latency, which
has one axis; and seconds below which no other latency is spoken of."""

# Of an arm, whatever the noise: rates are means between samples, and a body bends, m. One nearer
# than the second is where it was said to be.
_LEAST_SIGMA_M, LEAST_ARM_M = 0.03, 0.3
_LEAST_SIGMA_S = 3e-4  # stamps and samples are no better
_LEAST = 20  # epochs
# The latency used and its estimate are brought this near, s, or to so much of a sigma; they agree
# where they are within a sigma or so many seconds.
_AGREE_S, _AGREE, _APART_S = 1e-3, 0.2, 0.01
_ROUNDS = 8
_NEAR_S = 0.02
_MOST_SLOPE = 0.5  # of the estimate by the latency used
# A latency is not as likely as another if -2 log likelihood is so much more; others are looked for
# in steps of so many seconds.
_WORSE, _STEP_S = 9.0, 0.05
# For the spread of an estimate that follows the latency used: at most so much of it, shown by
# latencies at least so many sigmas apart, which are tried where sigma is beyond so many seconds.
_MOST_FOLLOWED, _WIDE, _TRIED_S = 0.9, 1.0, 5e-3


@dataclass(frozen=True)
class ReceiverOffsets:
    """A latency and an antenna's place, and how well they are known together.

    Attributes
    ----------
    latency_s : float
        A fix is valid this long before its stamp.
    arm_b : ndarray, shape (3,)
        From the IMU to the antenna, FRD, m.
    covariance : ndarray, shape (4, 4)
        Of latency and arm, s and m.
    arm_off_b, arm_off_sigma_b : ndarray, shape (3,)
        How much further on than it was assumed the antenna seems to be, by the data: whatever was
        given, it may be a couple of metres elsewhere.
    turned : ndarray, shape (3, 4, 4)
        Mean of the products of what each axis of attitude, NED, of a filter with wrong ones is off
        by for each of them, rad.
    misfit : float
        Innovations squared that are left, over what the filter expects, of the fixes used.
    square, rows : float
        The same of the innovations as they are, and how many numbers they are.
    given : bool
        Whether somebody said where the antenna is.
    spread : float
        By how much less certain the latency is than its covariance says, see :func:`settle`.
    clock : ClockRate
        By how much the latency changes meanwhile.
    """

    latency_s: float
    arm_b: FloatArray
    covariance: FloatArray
    arm_off_b: FloatArray
    arm_off_sigma_b: FloatArray
    turned: FloatArray
    misfit: float = 1.0
    square: float = 1.0
    rows: float = 1.0
    given: bool = True
    spread: float = 1.0
    clock: ClockRate = STEADY

    @property
    def sigma_s(self) -> float:
        """Of the latency: no more than that of any receiver."""
        return min(self.spread * float(np.sqrt(self.covariance[0, 0])), LATENCY_S)

    @property
    def observable(self) -> bool:
        """Whether the log shows the latency."""
        return float(np.sqrt(self.covariance[0, 0])) <= MAX_SIGMA_S

    @property
    def arm_contradicts(self) -> bool:
        """Whether the log shows that the antenna is not where it was assumed to be.

        An axis known no better than before tells nothing, however far off it seems.
        """
        off, sigma = self.arm_off_b, self.arm_off_sigma_b
        shown = (np.abs(off) > BEYOND * sigma) & (sigma < 0.5 * ARM_UNKNOWN_M)
        return float(np.linalg.norm(off[shown])) > LEAST_ARM_M

    @property
    def arm_shown(self) -> bool:
        """Whether the log shows where an antenna is of which nobody said that."""
        sigma = self.arm_off_sigma_b
        far = np.abs(self.arm_off_b) > BEYOND * sigma
        return not self.given and bool(np.any(far & (sigma < 0.5 * ARM_UNKNOWN_M)))

    @property
    def arm_elsewhere_b(self) -> FloatArray | None:
        """The arm to look for more about, where the log shows that it is not the one assumed."""
        return self.arm_b if self.arm_contradicts or self.arm_shown else None

    def used_at(self, arm_b: ArrayLike) -> ReceiverOffsets:
        """The same beside an arm in use, which, along axes that the log hardly shows, is usual.

        Parameters
        ----------
        arm_b : array_like, shape (3,)
            In use, m; nobody gave it.
        """
        information = np.linalg.inv(self.covariance)
        more = 1.0 / ARM_USUAL_M**2 - 1.0 / ARM_UNKNOWN_M**2
        covariance = np.linalg.inv(information + np.diag([0.0, more, more, more]))
        both = covariance @ information @ [self.latency_s, *self.arm_b]
        return replace(
            self,
            latency_s=float(both[0]),
            arm_b=both[1:],
            covariance=covariance,
            arm_off_b=both[1:] - np.asarray(arm_b),
            arm_off_sigma_b=np.sqrt(np.diag(covariance)[1:]),
        )

    def latency_contradicts(self, latency_s: float) -> bool:
        """Whether the log shows that a latency, s, which was given for certain is wrong."""
        return self.latency.differs_from(latency_s, LEAST_LATENCY_S, LATENCY_BEYOND)

    def error_of(self, latency_s: float, configured: bool) -> FloatArray:
        """Second moments of the errors of the latency and arm used, of s and m, shape (4, 4).

        An arm or a latency that was given is right unless the log contradicts it.

        Parameters
        ----------
        latency_s : float
            Used.
        configured : bool
            For certain, by the user.
        """
        doubted = np.full(4, not self.given or self.arm_contradicts)
        doubted[0] = not configured or self.latency_contradicts(latency_s)
        off = np.array([self.latency_s - latency_s, *self.arm_off_b])
        scale = np.array([self.sigma_s / np.sqrt(self.covariance[0, 0]), 1.0, 1.0, 1.0])
        covariance = self.covariance * np.outer(scale, scale)
        return np.asarray((covariance + np.outer(off, off)) * np.outer(doubted, doubted))

    @property
    def latency(self) -> Latency:
        """The latency by itself."""
        status: LatencyStatus = "found" if self.observable else "not observable"
        return Latency(self.latency_s, self.sigma_s, status)

    def __str__(self) -> str:
        return f"{1e3 * self.latency_s:.0f} ms +- {1e3 * self.sigma_s:.1f} ms"


def estimate_offsets(
    start: Start,
    settings: Settings,
    parts: Iterable[Increments],
    gnss: GnssEpochs,
    assumed_b: ArrayLike | None = None,
    given: bool = True,
) -> ReceiverOffsets | None:
    """Latency and lever arm near those of the settings.

    Far from them the answer is a step in the right direction: the filter's own errors are not
    linear in a latency that moves fixes by metres.

    Parameters
    ----------
    start : Start
        At the start of the first IMU update.
    settings : Settings
        Latency and arm about which the innovations are taken.
    parts : iterable of Increments
        Without a long gap.
    gnss : GnssEpochs
        In order of their stamps.
    assumed_b : array_like, shape (3,), optional
        The arm assumed, where it is not that of the settings.
    given : bool, optional
        Whether somebody said that it is there.

    Returns
    -------
    ReceiverOffsets or None
        None where too few fixes lie within the updates, or the filter diverges.
    """
    scores = offset_scores(start, settings, parts, gnss)
    if scores is None or len(scores) < _LEAST:
        return None
    assumed = np.asarray(settings.lever_arm_b if assumed_b is None else assumed_b, np.float64)
    here = np.array([settings.gnss_latency, *settings.lever_arm_b])
    usual = np.array([0.0, *assumed])
    free, covariance, misfit = _solved(scores, here, usual, ARM_UNKNOWN_M)
    off, sigma = free[1:] - assumed, np.sqrt(np.diag(covariance)[1:])
    turned = scores.turned.mean(axis=0)
    rows = float(scores.rows.sum())
    square = float(scores.nis.sum()) / rows
    answer = ReceiverOffsets(
        float(free[0]), free[1:], covariance, off, sigma, turned, misfit, square, rows, given
    )
    answer = replace(answer, clock=clock_rate(scores))
    if not given or answer.arm_contradicts:
        return answer
    near, covariance, _ = _solved(scores, here, usual, ARM_SURE_M)
    return replace(answer, latency_s=float(near[0]), arm_b=near[1:], covariance=covariance)


def settle(
    evaluate: Callable[[float, FloatArray | None, bool], ReceiverOffsets | None], first_s: float
) -> tuple[float, ReceiverOffsets | None, bool]:
    """The latency that is its own estimate.

    Parameters
    ----------
    evaluate : callable
        Takes a latency, s, an arm (None: the one assumed), and whether fixes far off are to be left
        out, and returns :func:`estimate_offsets` about them; None where that cannot be had.
    first_s : float

    Returns
    -------
    used_s : float
        The last one that could be tried.
    offsets : ReceiverOffsets or None
        About it.
    agrees : bool
        Whether the two are as near as the estimate is known.

    Notes
    -----
    What innovations are held against has noise of its own, that of the filter's velocity. Where a
    log shows little more than this, an estimate stays near the latency it was made about, however
    certain it claims to be. One that follows by a share c takes in 1 - c of what it is shown, and
    what is its own answer scatters by 1 / (1 - c) of its sigma.
    """
    used, gated, gates = first_s, False, True
    offsets = evaluate(used, None, gated)
    seen: list[tuple[float, float]] = []
    before: tuple[float, float] | None = None
    for _ in range(_ROUNDS):
        if offsets is None or not offsets.observable:
            return used, offsets, False
        step = offsets.latency_s - used
        seen.append((used, offsets.latency_s))
        if gated >= gates and abs(step) <= max(_AGREE_S, _AGREE * offsets.sigma_s):
            break
        # Until then fixes are far off for no fault of theirs
        gated |= gates and abs(step) <= max(_NEAR_S, offsets.sigma_s)
        slope = 0.0
        if before is not None and before[0] != used:
            slope = (offsets.latency_s - before[1]) / (used - before[0])
        before = used, offsets.latency_s
        following = used + step / (1.0 - min(max(slope, 0.0), _MOST_SLOPE))
        arm_b = offsets.arm_elsewhere_b
        result = evaluate(following, arm_b, gated)
        if gated and (result is None or not result.observable):
            # From a bad start nearly all are left out, of which none is bad
            gated = gates = False
            result = evaluate(following, arm_b, gated)
        if result is None:
            break
        used, offsets = following, result
    assert offsets is not None
    agrees = abs(offsets.latency_s - used) <= max(_APART_S, offsets.sigma_s)
    if agrees and offsets.sigma_s > _TRIED_S:
        wide = _WIDE * offsets.sigma_s
        if max(abs(used - latency) for latency, _ in seen) < wide:
            other = evaluate(used + 2.0 * wide, offsets.arm_elsewhere_b, gated)
            if other is not None:
                seen.append((used + 2.0 * wide, other.latency_s))
        latency, estimate = max(seen, key=lambda pair: abs(used - pair[0]))
        if abs(used - latency) >= wide:
            followed = (offsets.latency_s - estimate) / (used - latency)
            followed = min(max(followed, 0.0), _MOST_FOLLOWED)
            offsets = replace(offsets, spread=1.0 / (1.0 - followed))
    if not agrees:
        # What is no answer to itself may be any of those tried
        tried = np.array([*seen, (used, offsets.latency_s)])
        half = 0.5 * float(np.ptp(tried))
        offsets = replace(offsets, spread=max(half / offsets.sigma_s, 1.0))
    return used, offsets, agrees


def likeliest(
    evaluate: Callable[[float, FloatArray | None], ReceiverOffsets | None],
    tried: Sequence[float],
    arm_b: FloatArray | None,
) -> tuple[float, ReceiverOffsets] | None:
    """The latency with which innovations are least, where estimates lead away from it.

    Parameters
    ----------
    evaluate : callable
        Takes a latency, s, and an arm (None: the one assumed), and returns
        :func:`estimate_offsets` about them, all else being equal.
    tried : sequence of float
        Latencies, s, the last of which is the answer of :func:`settle`.
    arm_b : ndarray, shape (3,), optional
        The arm with which to try them.

    Returns
    -------
    used_s : float
        None instead of both where the last one is as likely as the others.
    offsets : ReceiverOffsets
        With that latency, and how well its likelihood alone shows it.

    Notes
    -----
    Scores are without bias if innovations are white. Those of a filter that takes its sensors for
    too noisy follow each other, and go with the noise of the velocity that they are held against.
    What they are as a whole shows a latency however that may be, if less sharply.
    """
    cost: dict[float, float] = {}
    found: dict[float, ReceiverOffsets] = {}

    def judge(latency: float) -> bool:
        """Whether that can be had."""
        shown = evaluate(latency, arm_b)
        if shown is not None:
            cost[latency], found[latency] = shown.square * shown.rows, shown
        return shown is not None

    if not all(judge(latency) for latency in tried):
        return None
    best = min(cost, key=cost.__getitem__)
    if cost[tried[-1]] - cost[best] < _WORSE:
        return None
    sharp = 0.0
    for _ in range(_ROUNDS):
        below = max((x for x in cost if x < best), default=best - _STEP_S)
        above = min((x for x in cost if x > best), default=best + _STEP_S)
        following = below if below not in cost else above
        if below in cost and above in cost:
            bend, following = _parabola([(x, cost[x]) for x in (below, best, above)])
            if abs(following - best) < _AGREE * np.sqrt(2.0 / bend):
                # Innovations larger than the filter expects make everything that much less certain
                sharp = float(np.sqrt(2.0 * max(found[best].misfit, 1.0) / bend))
                break
        if not judge(following):
            return None
        best = min(cost, key=cost.__getitem__)
    else:
        # Single epochs make squares rough: it is known to where they are no less likely
        following = best
        sharp = max(abs(x - best) for x in cost if cost[x] - cost[best] < _WORSE)
    shown = found[best]
    sigma = max(sharp, shown.sigma_s)
    scale = np.array([sigma / np.sqrt(shown.covariance[0, 0]), 1.0, 1.0, 1.0])
    covariance = shown.covariance * np.outer(scale, scale)
    return best, replace(shown, latency_s=following, covariance=covariance)


def _parabola(points: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Second derivative of the parabola through three points, and where it is least."""
    (a, fa), (b, fb), (c, fc) = points
    left, right = (fb - fa) / (b - a), (fc - fb) / (c - b)
    bend = max(2.0 * (right - left) / (c - a), 1e-9)
    return bend, 0.5 * (a + b) - left / bend


def _solved(
    scores: OffsetScores, here: FloatArray, usual: FloatArray, arm_m: float
) -> tuple[FloatArray, FloatArray, float]:
    """Latency and arm, their covariance, and the misfit that is left.

    From scores about `here` and a prior about `usual`.
    """
    scores = scores.robust
    prior = np.diag(1.0 / np.square([LATENCY_S, arm_m, arm_m, arm_m]))
    pull = prior @ (usual - here)
    information, score = scores.information.sum(axis=0), scores.score.sum(axis=0)
    many = float(scores.rows.sum())
    # Innovations larger than the filter expects make everything that much less certain
    excess = 1.0
    for _ in range(2):
        covariance = np.linalg.inv(information / excess + prior)
        b = covariance @ (score / excess + pull)
        left = scores.nis.sum() - 2.0 * score @ b + b @ information @ b
        misfit = float(left) / many
        excess = max(misfit, 1.0)
    covariance = np.linalg.inv(information / excess + prior)
    b = covariance @ (score / excess + pull)
    spread = scores.scatter(scores.score - scores.information @ b) / excess**2
    scattered = covariance @ (spread + prior) @ covariance
    more = np.sqrt(np.maximum(np.diag(scattered) / np.diag(covariance), 1.0))
    least = np.diag(np.square([_LEAST_SIGMA_S, *[_LEAST_SIGMA_M] * 3]))
    return here + b, covariance * np.outer(more, more) + least, misfit
