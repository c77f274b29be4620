"""Stretches of steady rotation: plateaus of the table's rate, divided for alignment.

Rates are those of the encoder over blocks of a quarter of a second. A plateau grows block by
block as long as the next one agrees with its mean, to within a tolerance that the noise of the
blocks widens: the stamps of an encoder may jitter by a millisecond. What is not used is given back
as well, with the reason, so that an operator knows what to change.

Sums over whole turns are all of a log that alignment needs, in a few numbers. With
``v_b0 = Rz(alpha) v_b`` the mean of any vector in ``b0`` follows from the time integrals of ``v``,
``v cos alpha`` and ``v sin alpha``. Taken of the samples as they are in the log they hold no
calibration at all, so that another calibration, bias or latitude needs no other pass over the log;
another sign or delay of the encoder does.

Whole turns matter: what is fixed to ``b`` (biases, misalignments times the rate of the table)
drops out of them, and a quarter of a turn too many in ten minutes makes 80 arcsec of heading. A
turn ends inside a sample, which is then shared out by the angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sinstool.core.arrays import ArrayLike, FloatArray
from sinstool.core.english import counted
from sinstool.core.errors import AlignmentError
from sinstool.core.order_statistics import SIGMA_PER_MAD
from sinstool.core.parts import njit
from sinstool.methods.hse.encoder import TableAngle

BLOCK_S = 0.25
RELATIVE_TOLERANCE = 1e-3
SMALLEST_TOLERANCE = 2e-4
"""rad/s; a block belongs to a plateau within this or the relative tolerance of its mean."""

# Standard deviations of a block's rate: rarer than one in 600 s of blocks.
_NOISE_TOLERANCE = 5.0

SLOWEST = np.radians(1.0)
"""Rate below which the table counts as at rest, rad/s."""

CHANGING = "the rate changes"
"""Reason of what lies between plateaus."""

SHORTEST_S = 60.0
# Plateaus of fewer blocks are parts of a change of rate.
_FEWEST_BLOCKS = 8


@dataclass(frozen=True)
class SegmentRules:
    """Requirements on a stretch at constant rate.

    Attributes
    ----------
    settle_s : float
        Cut off at either side of a plateau.
    min_turns : int
        Whole turns.
    min_rate : float
        rad/s.
    align_duration_s : float
        Longer plateaus are split into repeats of this length.
    skip_warmup_s : float
        Nothing is used before this time, in s after the first gyro sample.
    """

    settle_s: float = 2.0
    min_turns: int = 10
    min_duration_s: float = SHORTEST_S
    min_rate: float = float(SLOWEST)
    align_duration_s: float = 600.0
    skip_warmup_s: float = 0.0


@dataclass(frozen=True)
class Segment:
    """A stretch of samples within one :class:`~sinstool.methods.hse.encoder.TableAngle`.

    Attributes
    ----------
    piece : int
        Which one, by number.
    first, stop : int
        Its samples [first, stop), counted from the first of the piece.
    start_s : float
        Where the first interval begins, s after the first gyro stamp of the log.
    rate : float
        Mean, rad/s.
    reason : str
        Why it is not used; empty where it is.
    """

    piece: int
    first: int
    stop: int
    start_s: float
    duration_s: float
    rate: float
    reason: str = ""

    @property
    def turns(self) -> float:
        """Number of turns of the table."""
        return abs(self.rate) * self.duration_s / (2.0 * np.pi)


@dataclass(frozen=True)
class Segmentation:
    """Result of :func:`find_segments`.

    Attributes
    ----------
    used, rejected : list of Segment
        In order of time.
    block_time_s, block_rate : ndarray, shape (k,)
        Middles and rates of all blocks, s and rad/s; to be drawn.
    """

    used: list[Segment]
    rejected: list[Segment]
    block_time_s: FloatArray
    block_rate: FloatArray


def find_segments(pieces: Sequence[TableAngle], rules: SegmentRules | None = None) -> Segmentation:
    """Stretches at constant rate.

    Parameters
    ----------
    pieces : sequence of TableAngle
        From :func:`~sinstool.methods.hse.encoder.table_angle`.
    """
    rules = rules or SegmentRules()
    used: list[Segment] = []
    rejected: list[Segment] = []
    times: list[FloatArray] = [np.empty(0)]
    rates: list[FloatArray] = [np.empty(0)]
    for number, piece in enumerate(pieces):
        size = max(1, round(BLOCK_S / piece.interval_s))
        rate: FloatArray = np.diff(piece.alpha[::size]) / (size * piece.interval_s)
        middles = np.arange(0.5, len(rate)) * (size * piece.interval_s)
        times.append(np.asarray(piece.start_s + middles))
        rates.append(rate)
        for segment in _plateaus(piece, number, rate, size):
            for part in _judged(segment, piece, rules):
                (rejected if part.reason else used).append(part)
    return Segmentation(used, rejected, np.concatenate(times), np.concatenate(rates))


def _plateaus(piece: TableAngle, number: int, rate: FloatArray, size: int) -> list[Segment]:
    """Plateaus of constant rate, and the stretches between them with a reason."""
    spans: list[tuple[int, int]] = []
    begin, total = 0, 0.0
    relative = max(RELATIVE_TOLERANCE, _NOISE_TOLERANCE * relative_noise(rate))
    for k, r in enumerate(rate.tolist()):
        if k > begin:
            mean = total / (k - begin)
            if abs(r - mean) > max(relative * abs(mean), SMALLEST_TOLERANCE):
                spans.append((begin, k))
                begin, total = k, 0.0
        total += r
    if len(rate):
        spans.append((begin, len(rate)))
    segments: list[Segment] = []
    changing: int | None = None
    for begin, end in spans:
        if end - begin < _FEWEST_BLOCKS:
            changing = begin if changing is None else changing
            continue
        if changing is not None:
            segments.append(_changing(piece, number, changing * size, begin * size))
            changing = None
        segments.append(_segment(piece, number, begin * size, end * size))
    # the last samples that fill no block go with what they follow
    if changing is not None:
        segments.append(_changing(piece, number, changing * size, len(piece)))
    elif not len(rate) and len(piece):
        short = _segment(piece, number, 0, len(piece))
        segments.append(replace(short, reason="too short to see a rate"))
    return segments


def relative_noise(rate: FloatArray) -> float:
    """Standard deviation of the rate of a block over the rate itself.

    Relative, as it comes from stamps that jitter. From second differences, which neither a
    plateau nor an even change of rate has. Angles at the ends of blocks are means over a quarter
    of a second to each side, so that a rate is half the difference of the means over the block
    before and the one after; then the variance of its second difference is five times its own.
    """
    turning = np.abs(rate[1:-1]) > SLOWEST
    if not turning.any():
        return 0.0
    bends = np.abs(np.diff(rate, 2)[turning] / rate[1:-1][turning])
    return SIGMA_PER_MAD * float(np.median(bends)) / np.sqrt(5.0)


def _judged(segment: Segment, piece: TableAngle, rules: SegmentRules) -> list[Segment]:
    """A plateau trimmed and split into repeats, each with a reason if it will not do."""
    if segment.reason:
        return [segment]
    if abs(segment.rate) < rules.min_rate:
        return [
            replace(
                segment,
                reason=f"the table turns at {abs(np.degrees(segment.rate)):.2f} deg/s: "
                f"{np.degrees(rules.min_rate):g} deg/s needed",
            )
        ]
    dt = piece.interval_s
    settle = int(np.ceil(rules.settle_s / dt))
    cold = int(np.ceil((rules.skip_warmup_s - piece.start_s) / dt))
    first, stop = segment.first + settle, segment.stop - settle
    parts = []
    if cold > first:
        warmup = _segment(piece, segment.piece, segment.first, min(cold, segment.stop))
        parts.append(replace(warmup, reason=f"within the first {rules.skip_warmup_s:g} s"))
        if cold >= stop:
            return parts
        first = cold
    if stop <= first:
        return [replace(segment, reason=_too_short(0.0, rules))]
    length = max(1, round(rules.align_duration_s / dt))
    for begin in range(first, stop, length):
        part = _segment(piece, segment.piece, begin, min(begin + length, stop))
        rest = begin > first and part.duration_s < rules.min_duration_s
        parts.append(replace(part, reason=_objection(part, piece, rules, rest)))
    return parts


def _objection(part: Segment, piece: TableAngle, rules: SegmentRules, rest: bool) -> str:
    if rest:
        return f"what is left after repeats of {rules.align_duration_s:g} s"
    if part.duration_s < rules.min_duration_s:
        return _too_short(part.duration_s, rules)
    if part.turns < rules.min_turns:
        return f"{part.turns:.1f} turns: {rules.min_turns} whole ones needed"
    steps = np.sign(part.rate) * np.diff(piece.alpha[part.first : part.stop + 1])
    back = int(np.count_nonzero(steps <= 0.0))
    if back:
        return f"the encoder goes backwards or stands still {counted(back, 'time')}"
    return ""


def _too_short(duration_s: float, rules: SegmentRules) -> str:
    needed = f"{rules.min_duration_s:g} s needed (--min-duration)"
    return f"lasts {duration_s:.1f} s after settling: {needed}"


def _changing(piece: TableAngle, number: int, first: int, stop: int) -> Segment:
    return replace(_segment(piece, number, first, stop), reason=CHANGING)


def _segment(piece: TableAngle, number: int, first: int, stop: int) -> Segment:
    duration = (stop - first) * piece.interval_s
    turned = float(piece.alpha[stop] - piece.alpha[first])
    return Segment(
        number, first, stop, piece.start_s + first * piece.interval_s, duration, turned / duration
    )


_TURN = 2.0 * np.pi


@dataclass(frozen=True)
class TurnStatistics:
    """Integrals over N whole turns that follow one another.

    Attributes
    ----------
    S : ndarray, shape (N, 3, 6)
        Integrals over each turn of cos alpha, sin alpha and 1 (rows) times the gyros' and the
        accelerometers' samples (columns): rad and m/s. A vector that is fixed in ``b0`` comes out
        too small by ``(Omega dt)**2 / 12``: half of that because the cosines and sines are means
        over samples, half because the samples are.
    circle : ndarray, shape (N, 2)
        Integrals of cos alpha and sin alpha, s; 0 at a constant rate.
    duration : ndarray, shape (N,)
        s.
    direction : int
        1 where alpha grows, else -1.
    start_s : float
        Start of the first turn, s after the first gyro stamp of the log.
    interval_s : float
        Of the samples, s.
    jitter_s, wander_s : float
        Of the gyro stamps; see :class:`~sinstool.methods.hse.time_grid.TimeGrid`.
    """

    S: FloatArray
    circle: FloatArray
    duration: FloatArray
    direction: int
    start_s: float
    interval_s: float
    jitter_s: float = 0.0
    wander_s: float = 0.0

    def __len__(self) -> int:
        return len(self.duration)

    @property
    def rate(self) -> float:
        """Mean rate of the table over all turns, rad/s, with its sign."""
        return self.direction * _TURN * len(self) / float(self.duration.sum())


def turn_statistics(
    piece: TableAngle, segment: Segment, gyro: ArrayLike, accel: ArrayLike
) -> TurnStatistics:
    """Sums over the whole turns of a segment; an incomplete turn at its end is not used.

    Parameters
    ----------
    piece : TableAngle
        The one that the segment lies in.
    segment : Segment
        From :func:`~sinstool.methods.hse.segments.find_segments`.
    gyro, accel : array_like, shape (n, 3)
        All samples of the log as they are in it, rad/s and m/s^2: rows are those that the
        piece counts in.

    Raises
    ------
    AlignmentError
        If there is no whole turn, the angle does not advance at every sample or does so by
        half a turn and more, or a sample is not finite.
    """
    rows = slice(piece.first + segment.first, piece.first + segment.stop)
    g = np.ascontiguousarray(np.asarray(gyro, dtype=np.float64)[rows])
    a = np.ascontiguousarray(np.asarray(accel, dtype=np.float64)[rows])
    n = segment.stop - segment.first
    if g.shape != (n, 3) or a.shape != (n, 3):
        raise ValueError(f"Expected {n} rows of three, got {g.shape} and {a.shape}.")
    alpha = np.ascontiguousarray(piece.alpha[segment.first : segment.stop + 1])
    where = f"from {segment.start_s:.3f} s for {segment.duration_s:.3f} s"
    turned = float(alpha[-1] - alpha[0])
    # an angle that was read a rounding short of a whole turn is a whole turn
    whole = int(np.floor(abs(turned) / _TURN + 1e-12))
    if whole < 1:
        raise AlignmentError(f"no whole turn of the table {where}", "record for longer")
    direction = 1 if turned > 0.0 else -1
    sums = np.zeros((whole, 21))
    fault = _sum_turns(alpha, float(direction), g, a, sums)
    if fault >= 0:
        raise AlignmentError(
            f"the table's angle does not advance steadily at sample {rows.start + fault} ({where})",
            "check the encoder: readings must grow or fall throughout, and come more than twice in"
            " a turn",
        )
    if not np.isfinite(sums).all():
        raise AlignmentError(f"gyro or accelerometer samples are not finite {where}", "drop them")
    sums *= piece.interval_s
    return TurnStatistics(
        S=sums[:, :18].reshape(whole, 3, 6),
        circle=sums[:, 18:20].copy(),
        duration=sums[:, 20].copy(),
        direction=direction,
        start_s=segment.start_s,
        interval_s=piece.interval_s,
        jitter_s=piece.jitter_s,
        wander_s=piece.wander_s,
    )


@njit(cache=True, nogil=True)
def _sum_turns(alpha, direction, gyro, accel, sums):  # type: ignore[no-untyped-def]
    """One pass; columns of ``sums``: six with cos, six with sin, six alone, cos, sin, 1.

    Returns the sample at which the angle stands still, runs back or leaps, else -1.
    """
    half_turn = np.pi
    turn = 0
    turns = sums.shape[0]
    ends = alpha[0] + direction * 2.0 * np.pi
    for k in range(gyro.shape[0]):
        at, to = alpha[k], alpha[k + 1]
        step = (to - at) * direction
        if not 0.0 < step < half_turn:
            return k
        rest = 1.0
        # at most one turn ends here; then the sample is shared out
        for _ in range(2):
            crosses = (to - ends) * direction >= 0.0
            weight = rest
            middle = 0.5 * (at + to)
            if crosses:
                weight = min(rest, (ends - at) * direction / step)
                middle = 0.5 * (at + ends)
            # mean over the part, not the value in its middle: then what is fixed to the body
            # drops out to rounding, however many samples there are in a turn
            h2 = (0.5 * weight * step) ** 2
            mean = weight * (1.0 - h2 / 6.0 * (1.0 - h2 / 20.0 * (1.0 - h2 / 42.0)))
            c = mean * np.cos(middle)
            s = mean * np.sin(middle)
            for j in range(3):
                g = gyro[k, j]
                a = accel[k, j]
                sums[turn, j] += c * g
                sums[turn, 3 + j] += c * a
                sums[turn, 6 + j] += s * g
                sums[turn, 9 + j] += s * a
                sums[turn, 12 + j] += weight * g
                sums[turn, 15 + j] += weight * a
            sums[turn, 18] += c
            sums[turn, 19] += s
            sums[turn, 20] += weight
            if not crosses:
                break
            turn += 1
            if turn == turns:
                return -1
            at = ends
            rest -= weight
            ends = alpha[0] + direction * 2.0 * np.pi * (turn + 1)
    # the last turn ended with the last sample, but for a rounding
    return -1
