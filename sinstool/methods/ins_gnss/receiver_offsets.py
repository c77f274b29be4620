"""Latency of fixes and lever arm, estimated together from innovations.

They look alike: at constant speed a latency moves every fix along the track as an arm further back
does. Changes of speed tell them apart, and a body that does not turn as its course does. So both
are estimated at once, each with a prior about its usual or given value, and what the data leave
open stays in their covariance.

A constant error of the measurements changes the innovations of a filter linearly: with ``b``, the
latency and arm less those assumed, the filter's estimate is off by ``V b``. ``V`` follows from the
filter's own transitions and gains [1]_. Its innovations are ``(H V + D) b`` plus white noise of the
covariance that it expects, so one pass gives the information on b, with everything that the filter
estimates besides accounted for: attitude, biases, slowly varying errors of fixes.

The filter takes its innovations to be white. Another covariance follows from the scatter of the
scores of stretches [2]_; of both sigmas the larger one is used.

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
from sinstool.methods.ins_gnss.gyro_delay import GYRO_DELAY_S, LEAST_SIGMA_S, GyroDelay
from sinstool.methods.ins_gnss.latency import MAX_SIGMA_S, Latency, LatencyStatus
from sinstool.methods.ins_gnss.offset_scores import OffsetScores, offset_scores
from sinstool.methods.ins_gnss.settings import Settings, Start
from sinstool.methods.receiver_priors import ARM_GIVEN_M, ARM_UNKNOWN_M, ARM_USUAL_M, LATENCY_S
from sinstool.methods.strapdown.velocity import Increments

EVIDENCE = 0.25
"""Part of the difference of -2 log likelihood between two latencies that counts: what innovations
have in common with no model is alike over several of them."""

BEYOND, LATENCY_BEYOND, LEAST_LATENCY_S = 4.0, 3.0, 0.01
"""An estimate contradicts the assumed arm or latency if it differs by more than so many sigmas (the
arm has three axes, the latency one), and a latency also by more than so many seconds."""

# Least sigma of an arm, m: rates are means between samples, and bodies bend. An estimate nearer
# than the second one, m, does not contradict the arm that was given.
LEAST_ARM_SIGMA_M, LEAST_ARM_M = 0.03, 0.3
LEAST_LATENCY_SIGMA_S = 3e-4  # stamps and samples are no better
LEAST_EPOCHS = 20  # epochs
# The iteration ends when the latency used and its estimate are this near, s, or within this share
# of a sigma; they agree if they are within a sigma, or so many seconds.
_AGREE_S, _AGREE, _APART_S = 1e-3, 0.2, 0.01
_ROUNDS = 8
_NEAR_S = 0.02
# False fixes hide a latency; the gate takes them out where it leaves this share of all at least.
_MOST_LEFT = 0.9
_MOST_SLOPE = 0.5  # of the estimate over the latency used
# A latency is less likely than another if its -2 log likelihood is larger by this; latencies are
# tried in steps of so many seconds.
_WORSE, _STEP_S = 9.0, 0.05
# An estimate follows the latency used by at most this share, shown by latencies at least so many
# sigmas apart; these are tried if sigma is more than so many seconds.
_MOST_FOLLOWED, _WIDE, _TRIED_S = 0.9, 1.0, 5e-3


@dataclass(frozen=True)
class ReceiverOffsets:
    """Estimates of latency and lever arm with their covariance.

    Attributes
    ----------
    latency_s : float
        A fix is valid this long before its stamp.
    arm_b : ndarray, shape (3,)
        From the IMU to the antenna, FRD, m.
    covariance : ndarray, shape (4, 4)
        Of latency and arm, s and m.
    arm_off_b, arm_off_sigma_b : ndarray, shape (3,)
        Estimated arm less the assumed one, FRD, m, with the prior of an arm that is not given, and
        its sigma.
    turned : ndarray, shape (3, 4, 4)
        Mean products of the errors of attitude about each axis, NED, that unit errors of latency
        and arm cause, rad^2 per product of s and m.
    misfit : float
        Mean normalised square, by row, of the innovations that these estimates leave.
    square, rows : float
        The same of the innovations themselves, and the number of their rows.
    given : bool
        Whether the user gave the lever arm.
    spread : float
        Factor by which the sigma of the latency exceeds that of the covariance, see :func:`settle`.
    clock : ClockRate
        Rate of change of the latency.
    gyros : GyroDelay or None
        Delay of the gyros, estimated together with latency and arm.
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
    gyros: GyroDelay | None = None

    @property
    def sigma_s(self) -> float:
        """Standard deviation of the latency, s: at most that of the prior."""
        return min(self.spread * float(np.sqrt(self.covariance[0, 0])), LATENCY_S)

    @property
    def observable(self) -> bool:
        """Whether the log shows the latency."""
        return float(np.sqrt(self.covariance[0, 0])) <= MAX_SIGMA_S

    @property
    def arm_contradicts(self) -> bool:
        """Whether the log shows that the antenna is not where it was assumed to be.

        Axes on which the data hardly improve on the prior do not count, however far off they seem.
        """
        off, sigma = self.arm_off_b, self.arm_off_sigma_b
        shown = (np.abs(off) > BEYOND * sigma) & (sigma < 0.5 * ARM_UNKNOWN_M)
        return float(np.linalg.norm(off[shown])) > LEAST_ARM_M

    @property
    def arm_shown(self) -> bool:
        """Whether the log shows a lever arm that was not given."""
        sigma = self.arm_off_sigma_b
        far = np.abs(self.arm_off_b) > BEYOND * sigma
        return not self.given and bool(np.any(far & (sigma < 0.5 * ARM_UNKNOWN_M)))

    @property
    def arm_elsewhere_b(self) -> FloatArray | None:
        """The arm to repeat the estimate about, if the log shows that the assumed one is wrong."""
        return self.arm_b if self.arm_contradicts or self.arm_shown else None

    def used_at(self, arm_b: ArrayLike) -> ReceiverOffsets:
        """The same with the prior `ARM_USUAL_M` for axes that the log hardly shows.

        Parameters
        ----------
        arm_b : array_like, shape (3,)
            The arm in use, FRD, m, which was not given: `arm_off_b` is the difference from it.
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

    def against(self, latency_s: float, square: float) -> ReceiverOffsets:
        """The same, no less certain than the likelihood of a latency allows.

        Parameters
        ----------
        latency_s : float
            That the user gave, s.
        square : float
            With it, the mean normalised square of the innovations.
        """
        gain = EVIDENCE * self.rows * (square / self.square - 1.0)
        if gain <= LATENCY_BEYOND**2:
            return self
        sigma_s = abs(self.latency_s - latency_s) / np.sqrt(gain)
        spread = sigma_s / float(np.sqrt(self.covariance[0, 0]))
        return replace(self, spread=min(self.spread, max(1.0, spread)))

    def latency_contradicts(self, latency_s: float) -> bool:
        """Whether the log shows that a latency, s, which the user gave is wrong."""
        return self.latency.differs_from(latency_s, LEAST_LATENCY_S, LATENCY_BEYOND)

    def error_of(self, latency_s: float, configured: bool) -> FloatArray:
        """Second moments of the errors of the latency and arm in use, of s and m, shape (4, 4).

        An arm or a latency that the user gave counts as exact unless the log contradicts it.

        Parameters
        ----------
        latency_s : float
            The latency in use.
        configured : bool
            Whether the user gave it.
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

    Far from them the result is a step in the right direction only: the errors of the filter are not
    linear in a latency that moves fixes by metres.

    Parameters
    ----------
    start : Start
        At the start of the first IMU update.
    settings : Settings
        With the latency and arm about which the innovations are linearised.
    parts : iterable of Increments
        Without a long gap.
    gnss : GnssEpochs
        In order of their stamps.
    assumed_b : array_like, shape (3,), optional
        Mean of the prior of the arm, FRD, m, if not the arm of the settings.
    given : bool, optional
        Whether the user gave that arm.

    Returns
    -------
    ReceiverOffsets or None
        None if too few fixes lie within the updates, or the filter diverges.
    """
    complete = offset_scores(start, settings, parts, gnss)
    if complete is None or len(complete) < LEAST_EPOCHS:
        return None
    scores = complete.of_receiver
    assumed = np.asarray(settings.lever_arm_b if assumed_b is None else assumed_b, np.float64)
    here = np.array([settings.gnss_latency, *settings.lever_arm_b])
    usual = np.array([0.0, *assumed])
    free, covariance, misfit = solved_offsets(scores, here, usual, ARM_UNKNOWN_M)
    off, sigma = free[1:] - assumed, np.sqrt(np.diag(covariance)[1:])
    turned = scores.turned.mean(axis=0)
    rows = float(scores.rows.sum())
    square = float(scores.nis.sum()) / rows
    answer = ReceiverOffsets(
        float(free[0]), free[1:], covariance, off, sigma, turned, misfit, square, rows, given
    )
    arm_m = ARM_GIVEN_M if given and not answer.arm_contradicts else ARM_UNKNOWN_M
    gyros = _gyro_delay(complete, np.append(here, 0.0), np.append(usual, 0.0), arm_m)
    answer = replace(answer, clock=clock_rate(scores), gyros=gyros)
    if not given or answer.arm_contradicts:
        return answer
    near, covariance, _ = solved_offsets(scores, here, usual, ARM_GIVEN_M)
    return replace(answer, latency_s=float(near[0]), arm_b=near[1:], covariance=covariance)


def settle(
    evaluate: Callable[[float, FloatArray | None, bool], ReceiverOffsets | None], first_s: float
) -> tuple[float, ReceiverOffsets | None, bool]:
    """The latency that is its own estimate.

    Parameters
    ----------
    evaluate : callable
        Takes a latency, s, an arm (None: the one assumed), and whether the gate of the filter
        rejects fixes, and returns :func:`estimate_offsets` about them; None if not possible.
    first_s : float
        Latency to begin with, s.

    Returns
    -------
    used_s : float
        The last latency for which an estimate was possible, s.
    offsets : ReceiverOffsets or None
        The estimate about it.
    agrees : bool
        Whether both latencies agree within the sigma of the estimate.

    Notes
    -----
    The velocity of the filter, by which innovations depend on the latency, has noise of its own. If
    a log shows little beyond this noise, an estimate stays near the latency about which it was
    made, whatever its sigma. If it follows that latency by a share c, it moves by only 1 - c of an
    error, and the latency that is its own estimate has 1 / (1 - c) times its sigma.
    """
    used, gated, gates = first_s, False, True
    offsets = evaluate(used, None, gated)
    if offsets is not None and not offsets.observable and offsets.misfit > 1.0:
        # A wrong latency is not behind it if the gate rejects a few fixes only
        clean = evaluate(used, None, True)
        if clean is not None and clean.observable and clean.rows >= _MOST_LEFT * offsets.rows:
            gated, offsets = True, clean
    seen: list[tuple[float, float]] = []
    before: tuple[float, float] | None = None
    converged = True
    for _ in range(_ROUNDS):
        if offsets is None or not offsets.observable:
            return used, offsets, False
        step = offsets.latency_s - used
        seen.append((used, offsets.latency_s))
        if gated >= gates and abs(step) <= max(_AGREE_S, _AGREE * offsets.sigma_s):
            break
        # While the latency is wrong, the gate would reject good fixes, an arm explain its errors
        near = abs(step) <= max(_NEAR_S, offsets.sigma_s)
        gated |= gates and near
        slope = 0.0
        if before is not None and before[0] != used:
            slope = (offsets.latency_s - before[1]) / (used - before[0])
        before = used, offsets.latency_s
        following = used + step / (1.0 - min(max(slope, 0.0), _MOST_SLOPE))
        arm_b = offsets.arm_elsewhere_b if near else None
        result = evaluate(following, arm_b, gated)
        if gated and (result is None or not result.observable):
            # From a bad start the gate rejects nearly all fixes, although they are good
            gated = gates = False
            result = evaluate(following, arm_b, gated)
        if result is None:
            break
        used, offsets = following, result
    else:
        converged = False
    assert offsets is not None
    agrees = abs(offsets.latency_s - used) <= max(_APART_S, offsets.sigma_s)
    # Estimates that still move by a little each time follow what is used, however small their sigma
    if agrees and (offsets.sigma_s > _TRIED_S or not converged):
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
        # Without convergence the latency may be any of those tried
        tried = np.array([*seen, (used, offsets.latency_s)])
        half = 0.5 * float(np.ptp(tried))
        offsets = replace(offsets, spread=max(half / offsets.sigma_s, 1.0))
    return used, offsets, agrees


def likeliest(
    evaluate: Callable[[float, FloatArray | None], ReceiverOffsets | None],
    tried: Sequence[float],
    arm_b: FloatArray | None,
) -> tuple[float, ReceiverOffsets] | None:
    """The latency with the least squared innovations, where estimates lead away from it.

    Parameters
    ----------
    evaluate : callable
        Takes a latency, s, and an arm (None: the one assumed), and returns
        :func:`estimate_offsets` about them, everything else unchanged.
    tried : sequence of float
        Latencies, s, the last of which is the result of :func:`settle`.
    arm_b : ndarray, shape (3,), optional
        The arm to use with all of them, FRD, m.

    Returns
    -------
    used_s : float
        None instead of both if the last one is as likely as the others.
    offsets : ReceiverOffsets
        With that latency, and the sigma that its likelihood alone gives.

    Notes
    -----
    Estimates by scores are unbiased if innovations are white. A filter that assumes too much noise
    of its sensors has correlated innovations, which are also correlated with the noise of its
    velocity. The sum of their squares shows the latency even then, if less sharply.
    """
    cost: dict[float, float] = {}
    found: dict[float, ReceiverOffsets] = {}

    def judge(latency: float) -> bool:
        """Whether an estimate is possible."""
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
        # Single epochs make the squares rough: sigma reaches as far as they are hardly larger
        following = best
        sharp = max(abs(x - best) for x in cost if cost[x] - cost[best] < _WORSE)
    shown = found[best]
    sigma = max(sharp, shown.sigma_s)
    scale = np.array([sigma / np.sqrt(shown.covariance[0, 0]), 1.0, 1.0, 1.0])
    covariance = shown.covariance * np.outer(scale, scale)
    return best, replace(shown, latency_s=following, covariance=covariance)


def _parabola(points: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Second derivative of the parabola through three points, and the abscissa of its minimum."""
    (a, fa), (b, fb), (c, fc) = points
    left, right = (fb - fa) / (b - a), (fc - fb) / (c - b)
    bend = max(2.0 * (right - left) / (c - a), 1e-9)
    return bend, 0.5 * (a + b) - left / bend


def _gyro_delay(
    scores: OffsetScores, here: FloatArray, usual: FloatArray, arm_m: float
) -> GyroDelay:
    """The delay of the gyros, whatever latency and arm are."""
    found, covariance, _ = solved_offsets(scores, here, usual, arm_m)
    return GyroDelay.of(float(found[4]), float(np.sqrt(covariance[4, 4])), scores.lagging)


def solved_offsets(
    scores: OffsetScores, here: FloatArray, usual: FloatArray, arm_m: float
) -> tuple[FloatArray, FloatArray, float]:
    """Latency and arm, their covariance, and the misfit that is left.

    From scores about `here` and a prior about `usual`. The delay of the gyros is a fifth one where
    the scores have it.
    """
    scores, many = scores.robust, len(here)
    prior = np.diag(1.0 / np.square([LATENCY_S, arm_m, arm_m, arm_m, GYRO_DELAY_S][:many]))
    pull = prior @ (usual - here)
    information, score = scores.information.sum(axis=0), scores.score.sum(axis=0)
    rows = float(scores.rows.sum())
    # Innovations larger than the filter expects make everything that much less certain
    excess = 1.0
    for _ in range(2):
        covariance = np.linalg.inv(information / excess + prior)
        b = covariance @ (score / excess + pull)
        left = scores.nis.sum() - 2.0 * score @ b + b @ information @ b
        misfit = float(left) / rows
        excess = max(misfit, 1.0)
    covariance = np.linalg.inv(information / excess + prior)
    b = covariance @ (score / excess + pull)
    spread = scores.scatter(scores.score - scores.information @ b) / excess**2
    scattered = covariance @ (spread + prior) @ covariance
    more = np.sqrt(np.maximum(np.diag(scattered) / np.diag(covariance), 1.0))
    least = [LEAST_LATENCY_SIGMA_S, *[LEAST_ARM_SIGMA_M] * 3, LEAST_SIGMA_S][:many]
    return here + b, covariance * np.outer(more, more) + np.diag(np.square(least)), misfit
