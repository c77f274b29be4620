"""Where the table turns steadily: plateaus of its rate, cut into stretches to align on.

Rates are those of the encoder over blocks of a quarter of a second. A plateau grows block by
block as long as the next one agrees with its mean. What is not used is given back as well, with
the reason, since an operator who sees only that a run is missing cannot do anything about it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sinstool.methods.hse.encoder import TableAngle

FloatArray = NDArray[np.float64]

BLOCK_S = 0.25
RELATIVE_TOLERANCE = 1e-3
SMALLEST_TOLERANCE = 2e-4
"""rad/s; a block belongs to a plateau within this or the relative tolerance of its mean."""

SLOWEST = np.radians(1.0)
"""Rate below which the table counts as at rest, rad/s."""

SHORTEST_S = 60.0
# Plateaus of fewer blocks are parts of a change of rate.
_FEWEST_BLOCKS = 8


@dataclass(frozen=True)
class SegmentRules:
    """What makes a stretch good enough.

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
        """How often the table turned round."""
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
    rules : SegmentRules, optional

    Returns
    -------
    Segmentation
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
    """Plateaus, and what lies between them with a reason."""
    spans: list[tuple[int, int]] = []
    begin, total = 0, 0.0
    for k, r in enumerate(rate.tolist()):
        if k > begin:
            mean = total / (k - begin)
            if abs(r - mean) > max(RELATIVE_TOLERANCE * abs(mean), SMALLEST_TOLERANCE):
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


def _judged(segment: Segment, piece: TableAngle, rules: SegmentRules) -> list[Segment]:
    """A plateau trimmed and split into repeats, each with a reason if it will not do."""
    if segment.reason:
        return [segment]
    if abs(segment.rate) < rules.min_rate:
        return [
            replace(
                segment,
                reason=f"the table turns at {np.degrees(segment.rate):.2f} deg/s: "
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
        return f"the encoder goes backwards or stands still {back} times"
    return ""


def _too_short(duration_s: float, rules: SegmentRules) -> str:
    return f"lasts {duration_s:.1f} s after settling: {rules.min_duration_s:g} s needed"


def _changing(piece: TableAngle, number: int, first: int, stop: int) -> Segment:
    return replace(_segment(piece, number, first, stop), reason="the rate changes")


def _segment(piece: TableAngle, number: int, first: int, stop: int) -> Segment:
    duration = (stop - first) * piece.interval_s
    turned = float(piece.alpha[stop] - piece.alpha[first])
    return Segment(
        number, first, stop, piece.start_s + first * piece.interval_s, duration, turned / duration
    )
