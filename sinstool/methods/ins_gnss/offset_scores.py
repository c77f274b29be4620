"""Information on latency, lever arm and late gyros in innovations: see `receiver_offsets`.

``V`` and ``D`` are those of its equations.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.parts import kernel
from sinstool.core.rotation import conjugate, exp, multiply, skew, to_dcm
from sinstool.core.streams import GnssEpochs, concatenate, take_rows
from sinstool.methods.ins_gnss import states
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.gyro_delay import by_late_gyros
from sinstool.methods.ins_gnss.latency import inertial_velocity
from sinstool.methods.ins_gnss.results import FilterBlock, UpdateColumns
from sinstool.methods.ins_gnss.settings import Settings, Start
from sinstool.methods.strapdown.followed_rates import followed_rates
from sinstool.methods.strapdown.velocity import Increments

_UPDATES = 4096  # at a time, as the filter stores its covariances
_HALF_S = 0.06  # accelerations are velocity changes over this time before and after an instant
_SETTLED_S = 20.0  # the first innovations contain errors of the start that are not linear
_MOST_OFF = 1e6  # largest V, in SI units, of a filter that has not diverged
_TOLERANCE_NS = 200
_FAR = 3.0  # innovations beyond this many times the usual one of the log are weighted down
_KEPT_S = 10.0  # over which gyros keep the attitude better than a fix shows it
_STRETCH_S = 15.0  # scores of different stretches of this length are independent


@dataclass(frozen=True)
class OffsetScores:
    """Scores of each epoch for latency, lever arm and delay of the gyros; arrays of n rows.

    Attributes
    ----------
    time_ns : ndarray of int64, shape (n,)
        When the fixes of each epoch are valid.
    information, score : ndarray, shape (n, 5, 5) and (n, 5)
        Of latency, s, arm, FRD, m, and the delay of the gyros, s: ``(H V + D)^T S^-1 (H V + D)``
        and ``(H V + D)^T S^-1 nu``.
    nis, rows : ndarray, shape (n,)
        Normalised innovation squared, and the number of its rows.
    turned : ndarray, shape (n, 3, 4, 4)
        Products of V of each axis of attitude, NED, by latency and arm.
    lagging : ndarray, shape (n, 2)
        Error of attitude by gyros that are 1 s late: rad, and over its sigma, where it is largest.
    used, begins : ndarray of bool, shape (n,)
        Whether the filter used the epoch, and whether it restarted there.
    """

    time_ns: IntArray
    information: FloatArray
    score: FloatArray
    nis: FloatArray
    rows: FloatArray
    turned: FloatArray
    lagging: FloatArray
    used: BoolArray
    begins: BoolArray

    def __len__(self) -> int:
        return len(self.time_ns)

    @property
    def of_receiver(self) -> OffsetScores:
        """The same with latency and arm only, as if gyros were not late."""
        return replace(self, information=self.information[:, :4, :4], score=self.score[:, :4])

    @property
    def robust(self) -> OffsetScores:
        """The same with large innovations weighted down (after Huber 1964).

        A bad fix may be off by many thousand sigmas, and would weigh as much as all others.
        """
        size = np.sqrt(self.nis / np.maximum(self.rows, 1.0))
        far = _FAR * max(float(np.median(size)), 1.0)
        weight = np.minimum(1.0, far / np.maximum(size, far))
        return replace(
            self,
            information=self.information * weight[:, None, None],
            score=self.score * weight[:, None],
            nis=self.nis * weight,
            rows=self.rows * weight,
        )

    def scatter(self, score: FloatArray) -> FloatArray:
        """Covariance, (p, p), of the sum of scores, (n, p), by the scatter of sums of stretches."""
        stretch = ((self.time_ns - self.time_ns[0]) * 1e-9 / _STRETCH_S).astype(np.int64)
        sums = np.stack([np.bincount(stretch, column) for column in score.T], axis=1)
        sums = sums[np.bincount(stretch) > 0]
        return np.asarray(sums.T @ sums * len(sums) / max(len(sums) - score.shape[1], 1))


def offset_scores(
    start: Start, settings: Settings, parts: Iterable[Increments], gnss: GnssEpochs
) -> OffsetScores | None:
    """Scores by a filter with all states that need no barometer; None if it diverges."""
    plain = replace(
        settings,
        filter="markov-27",
        network=None,
        feedback="closed",
        control=replace(settings.control, adaptive="off", schmidt_epsilon=0.0),
    )
    run = InsGnssFilter(start, plain, with_baro=False, store=True)
    off: FloatArray | None = None
    rows: list[OffsetScores] = []
    fixes: GnssEpochs | None = gnss
    for piece in _pieces(parts):
        block = run.push(piece, fixes)
        fixes = None
        if block.updates is None or not np.isfinite(block.updates.q_nb).all():
            return None
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


def _pieces(parts: Iterable[Increments]) -> Iterator[Increments]:
    """The updates, so many at a time that means over seconds hardly end early, wherever parts end.

    Only the last are fewer.
    """
    waiting: Increments | None = None
    for part in parts:
        waiting = part if waiting is None else concatenate([waiting, part])
        while len(waiting.time_ns) >= _UPDATES:
            yield take_rows(waiting, slice(0, _UPDATES))
            waiting = take_rows(waiting, slice(_UPDATES, None))
    if waiting is not None and len(waiting.time_ns):
        yield waiting


def _at_start(run: InsGnssFilter, block: FilterBlock, interval: FloatArray) -> FloatArray:
    """V at the start, whose position and velocity are those of the fixes: innovations are 0."""
    assert block.updates is not None
    _, d = _rows_of_fixes(run, block.updates, interval, block.updates.time_ns[:1])
    off = np.zeros((run.kind.size, 5))
    off[:6, :4] = -d[0]
    return off


def _of_block(
    run: InsGnssFilter, block: FilterBlock, interval: FloatArray, off: FloatArray
) -> tuple[OffsetScores, FloatArray]:
    """Scores of a block's epochs, and V at its end from `off` at its start."""
    stored, gnss = block.stored, block.gnss
    assert block.updates is not None and stored is not None
    h, d = _rows_of_fixes(run, block.updates, interval, gnss.time_ns)
    lagging, grown = by_late_gyros(block.updates, interval, gnss.time_ns, stored.time_ns)
    by_attitude = h[:, :, states.ATTITUDE : states.ATTITUDE + 3] @ lagging[:, :, None]
    d = np.concatenate([d, by_attitude], axis=2)
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
    rounds = int(turn.max()) + 1 if len(turn) else 0
    for k in range(rounds):
        # Mostly there is one epoch for an instant, and no rows have to be selected
        now: BoolArray | slice = turn == k if rounds > 1 else slice(None)
        hp = h[now] @ p[now]
        s = hp @ np.swapaxes(h[now], 1, 2) + noise[now][:, :, None] * np.eye(6)
        inverse[now] = np.linalg.inv(s)
        gain[now] = np.swapaxes(hp, 1, 2) @ inverse[now] * gnss.used[now][:, None, None]
        if k + 1 < rounds:
            after = p[now] - gain[now] @ hp
            following = np.flatnonzero(turn == k) + 1
            more = following < len(row)
            more[more] = turn[following[more]] == k + 1
            p[following[more]] = after[more]
    shown, turned = np.empty((len(row), 6, 5)), np.empty((len(row), 3, 5))
    off = off.copy()
    _carry_sensitivity(
        stored.transition, grown, row, h, d, gain, off, shown, turned, np.empty_like(off)
    )
    off[:6, 4] += grown[-1]
    sigma = np.sqrt(np.diagonal(p, axis1=1, axis2=2)[:, states.ATTITUDE : states.ATTITUDE + 3])
    lagging = np.abs(lagging + turned[:, :, 4])
    turned = turned[:, :, :4]
    weighed = np.swapaxes(shown, 1, 2) @ inverse
    scores = OffsetScores(
        gnss.time_ns,
        weighed @ shown,
        np.einsum("kij,kj->ki", weighed, nu),
        np.einsum("ki,kij,kj->k", nu, inverse, nu),
        there.sum(axis=1).astype(np.float64),
        turned[:, :, :, None] * turned[:, :, None, :],
        np.stack([lagging.max(axis=1), (lagging / sigma).max(axis=1)], axis=1),
        gnss.used,
        gnss.restarted,
    )
    return scores, off


@kernel(vectorizes=False)
def _carry_sensitivity(
    transition: FloatArray,
    grown: FloatArray,
    row: IntArray,
    h: FloatArray,
    d: FloatArray,
    gain: FloatArray,
    off: FloatArray,
    shown: FloatArray,
    turned: FloatArray,
    before: FloatArray,
) -> None:
    """Propagate V over stored rows, and compute its share in the innovations of each epoch.

    Parameters
    ----------
    transition : ndarray, shape (m, n, n)
        To each row.
    grown : ndarray, shape (m + 1, 6)
        See :func:`by_late_gyros`.
    row : ndarray of int64, shape (k,)
        Of each epoch, not decreasing.
    h, d, gain : ndarray, shape (k, 6, n), (k, 6, 5) and (k, n, 6)
    off : ndarray, shape (n, 5)
        V, changed in place.
    shown, turned : ndarray, shape (k, 6, 5) and (k, 3, 5)
        Filled with ``H V + D``, and with V of the attitude after the epoch.
    before : ndarray, shape (n, 5)
        Work space.
    """
    n = len(off)
    epoch = 0
    for i in range(len(transition)):
        for a in range(n):
            for c in range(5):
                before[a, c] = off[a, c]
                off[a, c] = 0.0
        for a in range(n):
            for b in range(n):
                f = transition[i, a, b]
                if f != 0.0:
                    for c in range(5):
                        off[a, c] += f * before[b, c]
        for a in range(6):
            off[a, 4] += grown[i, a]
        while epoch < len(row) and row[epoch] <= i:
            for a in range(6):
                for c in range(5):
                    shown[epoch, a, c] = d[epoch, a, c]
                for b in range(n):
                    f = h[epoch, a, b]
                    if f != 0.0:
                        for c in range(5):
                            shown[epoch, a, c] += f * off[b, c]
            for a in range(n):
                for b in range(6):
                    f = gain[epoch, a, b]
                    for c in range(5):
                        off[a, c] -= f * shown[epoch, b, c]
            for a in range(3):
                for c in range(5):
                    turned[epoch, a, c] = off[states.ATTITUDE + a, c]
            epoch += 1


def _rows_of_fixes(
    run: InsGnssFilter, updates: UpdateColumns, interval: FloatArray, valid_ns: IntArray
) -> tuple[FloatArray, FloatArray]:
    """H and D: innovations by the states, (n, 6, states), and by latency and arm, (n, 6, 4)."""
    seconds = (updates.time_ns - updates.time_ns[0]) * 1e-9
    at = (valid_ns - updates.time_ns[0]) * 1e-9
    # Velocities and attitudes are those before the fix, carried on by the IMU: corrections of the
    # filter would bring the noise of its innovations into H and D.
    turned = updates.omega_ib_b * interval[:, None]
    quiet = _without_noise(updates.q_nb, turned, seconds)
    free = inertial_velocity(
        multiply(quiet, exp(0.5 * turned)),
        updates.specific_force_b * interval[:, None],
        interval,
        updates.latitude,
        updates.height,
        updates.velocity_n,
    )
    k = np.minimum(np.searchsorted(updates.time_ns, valid_ns - _TOLERANCE_NS), len(seconds) - 1)
    last = np.maximum(k - 1, 0)
    ends = np.clip([at - _HALF_S, at + _HALF_S], seconds[0], seconds[-1])
    # With the unfiltered rate, vibration included, the arm would come out too short
    rates = followed_rates(updates.time_ns, interval, turned)
    followed = np.column_stack([np.interp(at, seconds, column) for column in rates.T])
    # Only beside fixes: there are many more updates than these
    after = np.searchsorted(seconds, np.concatenate([at, *ends]), side="right")
    # And the first update, as a block may have no fixes
    beside = np.concatenate([[0], k, last, after - 1, after])
    some = np.unique(beside.clip(0, len(seconds) - 1))
    rate = updates.omega_ib_b[some]
    turn = exp(np.where(some > 0, interval[some], 0.0)[:, None] * rate)
    c_nb = to_dcm(multiply(quiet[some], turn))
    arm = np.asarray(run.settings.lever_arm_b)
    # The rate times the arm, as a row
    swing = np.einsum("kij,kj->ki", c_nb, rates[some] @ skew(arm))
    corrected = _over_seconds(updates.velocity_n - free, seconds)[some]
    seconds, free = seconds[some], free[some] + swing
    k, last = np.searchsorted(some, k), np.searchsorted(some, last)

    def moving(when: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(when, seconds, free[:, i]) for i in range(3)])

    h = np.zeros((len(k), 6, run.kind.size))
    h[:, range(6), range(6)] = 1.0
    h[:, range(3), range(3, 6)] = (at - seconds[k])[:, None]
    h[:, :3, states.ATTITUDE : states.ATTITUDE + 3] = skew(c_nb[k] @ arm)
    h[:, 3:, states.ATTITUDE : states.ATTITUDE + 3] = skew(swing[k])
    gyro, lasting = run.kind.first(states.GYRO_BIAS), run.kind.first(states.GNSS_POSITION)
    h[:, 3:, gyro : gyro + 3] = -c_nb[k] @ skew(arm)
    h[:, range(6), range(lasting, lasting + 6)] = -1.0
    d = np.zeros((len(k), 6, 4))
    d[:, :3, 0] = corrected[last] + moving(at)
    d[:, 3:, 0] = (moving(ends[1]) - moving(ends[0])) / np.maximum(ends[1] - ends[0], 1e-3)[:, None]
    d[:, :3, 1:] = -c_nb[k]
    d[:, 3:, 1:] = -c_nb[k] @ skew(followed)
    return h, d


def _without_noise(q_nb: FloatArray, turned: FloatArray, seconds: FloatArray) -> FloatArray:
    """Attitudes before each update, (n, 4), less the noise that the filter's corrections bring.

    Each correction follows the noise of a fix. An antenna on an arm moves with an attitude that
    jumps about, so that such noise would look like motion that shows the arm, and, where a filter
    takes its sensors for worse than they are, like one that agrees with the innovations. So the sum
    of all corrections is replaced by its mean over some seconds, in which gyros keep the attitude.
    """
    before = np.concatenate([q_nb[:1], q_nb[:-1]])
    carried = multiply(before, exp(turned))
    carried[0] = q_nb[0]
    step = multiply(q_nb, conjugate(carried))
    total = np.cumsum(2.0 * step[:, 1:] * np.sign(step[:, :1]), axis=0)
    there = np.concatenate([np.zeros((1, 3)), total[:-1]])
    return np.asarray(multiply(exp(_over_seconds(total, seconds) - there), before))


def _over_seconds(total: FloatArray, seconds: FloatArray) -> FloatArray:
    """Means of a column of vectors over some seconds about each row."""
    first = np.searchsorted(seconds, seconds - _KEPT_S)
    last = np.searchsorted(seconds, seconds + _KEPT_S, side="right")
    summed = np.concatenate([np.zeros((1, 3)), np.cumsum(total, axis=0)])
    return np.asarray((summed[last] - summed[first]) / (last - first)[:, None])
