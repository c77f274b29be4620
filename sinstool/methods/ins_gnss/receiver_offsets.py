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

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from sinstool.core.arrays import ArrayLike, BoolArray, FloatArray, IntArray
from sinstool.core.rotation import exp, multiply, normalise, skew, to_dcm
from sinstool.core.streams import GnssEpochs, concatenate, take_rows
from sinstool.methods.ins_gnss import states
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.latency import Latency, LatencyStatus, inertial_velocity
from sinstool.methods.ins_gnss.results import FilterBlock, UpdateColumns
from sinstool.methods.ins_gnss.settings import Settings, Start
from sinstool.methods.strapdown.velocity import Increments

LATENCY_S = 0.2
"""Latencies of receivers are 0 give or take this, 1 sigma."""

ARM_SURE_M, ARM_UNKNOWN_M = 0.1, 2.0
"""A lever arm is measured to a decimetre; one that is not given is within a couple of metres."""

MAX_SIGMA_S = 0.05
"""A latency that is not known to this is as good as not known."""

BEYOND, LATENCY_BEYOND, LEAST_LATENCY_S = 4.0, 3.0, 0.01
"""Sigmas beyond which an estimate contradicts what was assumed, of an arm and of a latency, which
has one axis; and seconds below which no other latency is spoken of."""

# Of an arm, whatever the noise: rates are means between samples, and a body bends, m. One nearer
# than the second is where it was said to be.
_LEAST_SIGMA_M, LEAST_ARM_M = 0.03, 0.3
_LEAST_SIGMA_S = 3e-4  # stamps and samples are no better
_UPDATES = 4096  # at a time, for what a filter stores of them
_HALF_S = 0.06  # velocity changes are taken over so much to either side
_SETTLED_S = 20.0  # a filter's first innovations hold what is not linear in its start
_STRETCH_S = 15.0  # scores of such stretches are independent of each other
_LEAST = 20  # epochs
_MOST_OFF = 1e6  # an estimate astray by more for each s or m, in SI units, is of a filter gone wild
_FAR = 3.0  # innovations over what is usual in the log: beyond, they count the less
_TOLERANCE_NS = 200
# The latency used and its estimate are brought this near, s, or to so much of a sigma; they agree
# where they are within a sigma or so many seconds.
_AGREE_S, _AGREE, _APART_S = 1e-3, 0.2, 0.01
_ROUNDS = 8
_NEAR_S = 0.02
_MOST_SLOPE = 0.5  # of the estimate by the latency used
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
    spread : float
        By how much less certain the latency is than its covariance says, see :func:`settle`.
    """

    latency_s: float
    arm_b: FloatArray
    covariance: FloatArray
    arm_off_b: FloatArray
    arm_off_sigma_b: FloatArray
    turned: FloatArray
    misfit: float = 1.0
    spread: float = 1.0

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
        sigma = self.arm_off_sigma_b
        limit = np.maximum(BEYOND * sigma, LEAST_ARM_M)
        return bool(np.any((np.abs(self.arm_off_b) > limit) & (sigma < 0.5 * ARM_UNKNOWN_M)))

    def latency_contradicts(self, latency_s: float) -> bool:
        """Whether the log shows that a latency, s, which was given for certain is wrong."""
        return self.latency.differs_from(latency_s, LEAST_LATENCY_S, LATENCY_BEYOND)

    def error_of(self, latency_s: float, configured: bool) -> FloatArray:
        """Second moments of the errors of the latency and arm used, of s and m, shape (4, 4).

        An arm, and a latency that was given, are right unless the log contradicts them.

        Parameters
        ----------
        latency_s : float
            Used.
        configured : bool
            For certain, by the user.
        """
        doubted = np.full(4, self.arm_contradicts)
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
        The arm assumed, where it is not that of the settings; 0, 0, 0 counts as not given.

    Returns
    -------
    ReceiverOffsets or None
        None where too few fixes lie within the updates, or the filter diverges.
    """
    scores = _scores(start, settings, parts, gnss)
    if scores is None or len(scores) < _LEAST:
        return None
    assumed = np.asarray(settings.lever_arm_b if assumed_b is None else assumed_b, np.float64)
    here = np.array([settings.gnss_latency, *settings.lever_arm_b])
    usual = np.array([0.0, *assumed])
    free, covariance, misfit = _solved(scores, here, usual, ARM_UNKNOWN_M)
    off, sigma = free[1:] - assumed, np.sqrt(np.diag(covariance)[1:])
    turned = scores.turned.mean(axis=0)
    answer = ReceiverOffsets(float(free[0]), free[1:], covariance, off, sigma, turned, misfit)
    if not assumed.any() or answer.arm_contradicts:
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
        arm_b = offsets.arm_b if offsets.arm_contradicts else None
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
            arm_b = offsets.arm_b if offsets.arm_contradicts else None
            other = evaluate(used + 2.0 * wide, arm_b, gated)
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


@dataclass(frozen=True)
class _Scores:
    """What each epoch says of latency and arm; arrays of n rows."""

    time_ns: IntArray
    information: FloatArray  # (n, 4, 4)
    score: FloatArray  # (n, 4)
    nis: FloatArray
    rows: FloatArray
    turned: FloatArray  # (n, 3, 4, 4)
    used: BoolArray
    begins: BoolArray  # the filter began anew

    def __len__(self) -> int:
        return len(self.time_ns)


def _solved(
    scores: _Scores, here: FloatArray, usual: FloatArray, arm_m: float
) -> tuple[FloatArray, FloatArray, float]:
    """Latency and arm, their covariance, and the misfit that is left.

    From scores about `here` and a prior about `usual`.
    """
    scores = _robust(scores)
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
    stretch = ((scores.time_ns - scores.time_ns[0]) * 1e-9 / _STRETCH_S).astype(np.int64)
    rest = scores.score - scores.information @ b
    sums = np.stack([np.bincount(stretch, rest[:, i]) for i in range(4)], axis=1)
    sums = sums[np.bincount(stretch) > 0]
    spread = sums.T @ sums / excess**2 * len(sums) / max(len(sums) - 4, 1)
    scattered = covariance @ (spread + prior) @ covariance
    more = np.sqrt(np.maximum(np.diag(scattered) / np.diag(covariance), 1.0))
    least = np.diag(np.square([_LEAST_SIGMA_S, *[_LEAST_SIGMA_M] * 3]))
    return here + b, covariance * np.outer(more, more) + least, misfit


def _robust(scores: _Scores) -> _Scores:
    """Scores of which no single epoch weighs more than usual ones do (after Huber 1964).

    A bad fix may be many thousand sigmas off, and says of a latency as much as all others.
    """
    size = np.sqrt(scores.nis / np.maximum(scores.rows, 1.0))
    far = _FAR * max(float(np.median(size)), 1.0)
    weight = np.minimum(1.0, far / np.maximum(size, far))
    return replace(
        scores,
        information=scores.information * weight[:, None, None],
        score=scores.score * weight[:, None],
        nis=scores.nis * weight,
        rows=scores.rows * weight,
    )


def _scores(
    start: Start, settings: Settings, parts: Iterable[Increments], gnss: GnssEpochs
) -> _Scores | None:
    """Of a filter with all the states that there are without a barometer, None if it diverges."""
    plain = replace(
        settings,
        filter="markov-27",
        network=None,
        feedback="closed",
        control=replace(settings.control, adaptive="off", schmidt_epsilon=0.0),
    )
    run = InsGnssFilter(start, plain, with_baro=False, store=True)
    off: FloatArray | None = None
    rows: list[_Scores] = []
    fixes: GnssEpochs | None = gnss
    for part in parts:
        for first in range(0, len(part.time_ns), _UPDATES):
            piece = take_rows(part, slice(first, first + _UPDATES))
            block = run.push(piece, fixes)
            fixes = None
            if off is None:
                off = _at_start(run, block, piece.interval)
            with np.errstate(over="ignore", invalid="ignore"):
                some, off = _of_block(run, block, piece.interval, off)
            if not np.abs(off).max() < _MOST_OFF:
                return None
            rows.append(some)
    scores = concatenate(rows)
    settled = np.ones(len(scores), dtype=bool)
    for begun in [*scores.time_ns[:1], *scores.time_ns[scores.begins]]:
        after = (scores.time_ns - begun) * 1e-9
        settled &= (after < 0.0) | (after > _SETTLED_S)
    return take_rows(scores, settled & scores.used)


def _at_start(run: InsGnssFilter, block: FilterBlock, interval: FloatArray) -> FloatArray:
    """V at the start, whose position and velocity are those of the fixes: innovations are 0."""
    assert block.updates is not None
    _, d = _rows_of_fixes(run, block.updates, interval, block.updates.time_ns[:1])
    off = np.zeros((run.kind.size, 4))
    off[:6] = -d[0]
    return off


def _of_block(
    run: InsGnssFilter, block: FilterBlock, interval: FloatArray, off: FloatArray
) -> tuple[_Scores, FloatArray]:
    """Scores of a block's epochs, and V at its end from `off` at its start."""
    stored, gnss = block.stored, block.gnss
    assert block.updates is not None and stored is not None
    h, d = _rows_of_fixes(run, block.updates, interval, gnss.time_ns)
    there = np.isfinite(gnss.innovation)
    h, d = h * there[:, :, None], d * there[:, :, None]
    noise = np.where(there, gnss.measurement_sigma**2, 1.0)
    nu = np.where(there, gnss.innovation, 0.0)
    # Epochs of one instant follow each other: the first of each, the second of each, ...
    row = np.searchsorted(stored.time_ns, gnss.time_ns - _TOLERANCE_NS)
    turn = np.arange(len(row)) - np.searchsorted(row, row)
    p = stored.covariance_before[np.minimum(row, len(stored) - 1)]
    gain = np.zeros((len(row), h.shape[2], 6))
    inverse = np.zeros((len(row), 6, 6))
    for k in range(int(turn.max()) + 1 if len(turn) else 0):
        now = turn == k
        hp = h[now] @ p[now]
        s = hp @ np.swapaxes(h[now], 1, 2) + noise[now][:, :, None] * np.eye(6)
        inverse[now] = np.linalg.inv(s)
        gain[now] = np.swapaxes(hp, 1, 2) @ inverse[now] * gnss.used[now][:, None, None]
        after = p[now] - gain[now] @ hp
        following = np.flatnonzero(now) + 1
        more = following < len(row)
        more[more] = turn[following[more]] == k + 1
        p[following[more]] = after[more]
    shown, turned = np.empty((len(row), 6, 4)), np.empty((len(row), 3, 4))
    epoch = 0
    for i, transition in enumerate(stored.transition):
        off = transition @ off
        while epoch < len(row) and row[epoch] <= i:
            shown[epoch] = h[epoch] @ off + d[epoch]
            off = off - gain[epoch] @ shown[epoch]
            turned[epoch] = off[states.ATTITUDE : states.ATTITUDE + 3]
            epoch += 1
    weighed = np.swapaxes(shown, 1, 2) @ inverse
    scores = _Scores(
        gnss.time_ns,
        weighed @ shown,
        np.einsum("kij,kj->ki", weighed, nu),
        np.einsum("ki,kij,kj->k", nu, inverse, nu),
        there.sum(axis=1).astype(np.float64),
        turned[:, :, :, None] * turned[:, :, None, :],
        gnss.used,
        gnss.restarted,
    )
    return scores, off


def _rows_of_fixes(
    run: InsGnssFilter, updates: UpdateColumns, interval: FloatArray, valid_ns: IntArray
) -> tuple[FloatArray, FloatArray]:
    """How innovations depend on the states, (n, 6, states), and on latency and arm, (n, 6, 4)."""
    seconds = (updates.time_ns - updates.time_ns[0]) * 1e-9
    at = (valid_ns - updates.time_ns[0]) * 1e-9
    # What the filter took off would bring its innovations' noise into what they are held against:
    # velocities and attitudes are those before the fix, and change as the IMU says.
    before = np.concatenate([updates.q_nb[:1], updates.q_nb[:-1]])
    sign = np.sign(np.sum(before * updates.q_nb, axis=1, keepdims=True))
    turn = exp(updates.omega_ib_b[1:] * interval[1:, None])
    c_nb = to_dcm(np.concatenate([updates.q_nb[:1], multiply(before[1:], turn)]))
    arm = np.asarray(run.settings.lever_arm_b)
    # The rate times the arm, as a row
    swing = np.einsum("kij,kj->ki", c_nb, updates.omega_ib_b @ skew(arm))
    free = swing + inertial_velocity(
        normalise(before * sign + updates.q_nb),
        updates.specific_force_b * interval[:, None],
        interval,
        updates.latitude,
        updates.height,
        updates.velocity_n,
    )

    def moving(when: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(when, seconds, free[:, i]) for i in range(3)])

    k = np.minimum(np.searchsorted(updates.time_ns, valid_ns - _TOLERANCE_NS), len(seconds) - 1)
    last = np.maximum(k - 1, 0)
    h = np.zeros((len(k), 6, run.kind.size))
    h[:, range(6), range(6)] = 1.0
    h[:, range(3), range(3, 6)] = (at - seconds[k])[:, None]
    h[:, :3, states.ATTITUDE : states.ATTITUDE + 3] = skew(c_nb[k] @ arm)
    h[:, 3:, states.ATTITUDE : states.ATTITUDE + 3] = skew(swing[k])
    gyro, lasting = run.kind.first(states.GYRO_BIAS), run.kind.first(states.GNSS_POSITION)
    h[:, 3:, gyro : gyro + 3] = -c_nb[k] @ skew(arm)
    h[:, range(6), range(lasting, lasting + 6)] = -1.0
    d = np.zeros((len(k), 6, 4))
    d[:, :3, 0] = (updates.velocity_n + swing - free)[last] + moving(at)
    ends = np.clip([at - _HALF_S, at + _HALF_S], seconds[0], seconds[-1])
    d[:, 3:, 0] = (moving(ends[1]) - moving(ends[0])) / np.maximum(ends[1] - ends[0], 1e-3)[:, None]
    d[:, :3, 1:] = -c_nb[k]
    d[:, 3:, 1:] = -c_nb[k] @ skew(updates.omega_ib_b[k])
    return h, d
