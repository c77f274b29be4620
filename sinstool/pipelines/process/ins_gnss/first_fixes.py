"""First fixes of a log, or after an outage, that are far off those that follow: left out.

Receivers that see satellites again may be off by many metres and state a few centimetres. After an
outage a filter cannot tell: its own position is less certain than any such fix. It uses the false
one, and then rejects the good ones, or takes the way to them for speed. At the start of a log it
has no other position, and the false fixes have shown it a speed and an attitude. What tells them
apart is what follows: without the first fixes, those after them agree with one another.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.earth import horizontal_metres
from sinstool.core.errors import AlignmentError
from sinstool.core.finding import Finding, Severity
from sinstool.core.rotation import to_dcm, wrapped
from sinstool.core.streams import GnssEpochs, concatenate
from sinstool.core.timeline import SECOND
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.fix_velocity import message_times
from sinstool.methods.ins_gnss.returning_fixes import OUTAGE_S
from sinstool.methods.receiver_priors import ARM_USUAL_M, LATENCY_S
from sinstool.methods.strapdown.joined_updates import JOINED_S, joined_blocks
from sinstool.methods.strapdown.velocity import Increments
from sinstool.pipelines.process.ins_gnss.before_start import before_start
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.first_start import first_start
from sinstool.survey.increments import SegmentIncrements
from sinstool.survey.source import Source

# So many first fixes are tried as false, the fewest first, and judged by so many that follow.
TRIED, JUDGES = (1, 2, 4, 8, 16), 5
# They are false if the squared innovations of those that follow are this many times as large as
# expected, and this many times as large as without them.
DISAGREE, LESS = 5.0, 4.0
# They are off by so many sigmas at least. A start without the first fixes of a log is at most so
# much later, s.
FAR, LATER_S = 5.0, 30.0


@dataclass(frozen=True)
class FalseFirst:
    """False fixes at the start of a log or after an outage.

    Attributes
    ----------
    first_ns, last_ns : int
        Stamps of the first and the last message.
    off_m : float
        Largest distance from those that follow, m.
    outage_s : float
        Length of the outage, s; infinite at the start.
    """

    first_ns: int
    last_ns: int
    off_m: float
    outage_s: float

    def finding(self, kind: str, log_ns: int) -> Finding:
        """A finding that tells the user; `log_ns` is when the log begins."""
        begin, end = ((time - log_ns) / SECOND for time in (self.first_ns, self.last_ns))
        one = self.first_ns == self.last_ns
        which = f"the fix at {begin:.1f} s" if one else f"fixes from {begin:.1f} to {end:.1f} s"
        after = f" after {self.outage_s:.0f} s" if np.isfinite(self.outage_s) else ""
        text = (
            f"{which}, the first{after}, {'is' if one else 'are up to'} about"
            f" {float(f'{self.off_m:.1g}'):g} m off those that follow: left out"
        )
        return Finding(
            kind,
            text,
            Severity.WARNING,
            start_ns=self.first_ns,
            end_ns=self.last_ns,
            numbers={"off_m": self.off_m},
        )


def false_firsts(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> list[FalseFirst]:
    """First fixes after outages that those after them contradict.

    Parameters
    ----------
    start : FilterStart
        Before any other fix was left out.
    """
    used = start.used
    rows = np.flatnonzero(used.has_position)
    waited = np.diff(used.time_ns[rows]) / SECOND
    outages = np.flatnonzero(waited > OUTAGE_S) + 1
    if not len(outages):
        return []
    parts = _from(source, config, algorithm, start, whole=True)
    squares, off = _innovations(parts, start, rows)
    stamps = message_times(used, start.lag)[rows]
    found: list[FalseFirst] = []
    for many in TRIED:
        before = _judged(squares, outages + many)
        doubted = outages[before > DISAGREE]
        if not len(doubted):
            continue
        out = np.zeros(len(used), dtype=np.bool_)
        out[rows[(doubted[:, None] + np.arange(many)).ravel()]] = True
        without, _ = _innovations(parts, start, rows, out)
        after = _judged(without, doubted + many)
        far = off[doubted + many] > FAR * np.hypot(start.fix_sigma_m, _unknown_arm(start))
        false = doubted[far & (after > 0.0) & (after < before[before > DISAGREE] / LESS)]
        for k in false.tolist():
            ends = int(stamps[k]), int(stamps[k + many - 1])
            found.append(FalseFirst(*ends, float(off[k + many]), float(waited[k - 1])))
        outages = np.setdiff1d(outages, false)
    return sorted(found, key=lambda one: one.first_ns)


@dataclass(frozen=True)
class WithoutFirst:
    """A log without its first fixes, the start that it shows, and what was left out."""

    source: Source
    start: FilterStart
    false: FalseFirst


def without_false_start(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> WithoutFirst | None:
    """A log without its first fixes, if those that follow contradict them.

    Parameters
    ----------
    start : FilterStart
        With all fixes.

    Returns
    -------
    WithoutFirst or None
        None if they fit, or if a start without them does not fit any better.
    """
    used, gnss = start.used, source.aiding.gnss
    rows = np.flatnonzero(used.has_position)
    if gnss is None or not len(rows):
        return None
    stamps = message_times(used, start.lag)[rows]
    first = max(int(np.searchsorted(stamps, start.time_ns + start.late_ns, "right")) - 1, 0)
    squares, _ = _innovations(_from(source, config, algorithm, start), start, rows)
    for many in TRIED:
        before = _judged(squares, np.array([first + many]))[0]
        if not before > DISAGREE:
            continue
        last_ns = int(stamps[first + many - 1])
        good = replace(source.aiding, gnss=gnss.rows(gnss.time_ns > last_ns))
        changed = replace(source, aiding=good)
        try:
            other = first_start(changed, config)
        except AlignmentError:
            continue
        if other.time_ns > start.time_ns + LATER_S * SECOND:
            continue
        own = np.flatnonzero(other.used.has_position)
        without, _ = _innovations(_from(changed, config, algorithm, other), other, own)
        # At the fix that it starts from a filter has none, whatever the fix
        begin = int(np.argmax(np.isfinite(without))) + 1
        after = _judged(without, np.array([begin]))[0]
        if not 0.0 < after < before / LESS:
            continue
        there = slice(first, first + many)
        off_m = _carried_back(changed, config, algorithm, other, used.rows(rows[there]))
        if off_m > 0.0:
            # Those before the start have shown it the attitude
            false = FalseFirst(int(stamps[0]), last_ns, off_m, np.inf)
            return WithoutFirst(changed, other, false)
    return None


def _carried_back(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    start: FilterStart,
    fixes: GnssEpochs,
) -> float:
    """How far fixes before a start are off its navigation back to them, m; 0 if not clearly."""
    back = before_start(source, config, algorithm, start, start.start, False)
    if back is None or back.position is None or back.covariance_position_n is None:
        return 0.0
    assert back.velocity_n is not None
    at = np.searchsorted(back.time_ns, fixes.time_ns - start.late_ns)
    at = np.minimum(at, len(back.time_ns) - 1)
    lat, lon, height = back.position[at].T
    north, east = horizontal_metres(
        fixes.latitude - lat, wrapped(fixes.longitude - lon), lat, height
    )
    arm_n = to_dcm(back.q_nb[at]) @ np.asarray(start.settings.lever_arm_b)
    off = np.stack([north, east, height - fixes.height], axis=1) - arm_n
    variance = np.einsum("nii->ni", back.covariance_position_n[at])
    variance = variance + np.square(np.nan_to_num(fixes.sigma_position_n))
    # At a constant speed a wrong latency moves all fixes alike
    change = np.linalg.norm(back.velocity_n[at] - back.velocity_n[-1], axis=1, keepdims=True)
    late = 0.0 if config.gnss.gnss_latency is not None else LATENCY_S
    variance = variance + np.square(late * change) + _unknown_arm(start) ** 2
    # A fix may have no height
    far = np.sqrt(np.nansum(off**2 / variance, axis=1)) > FAR
    distance = np.sqrt(np.nansum(off**2, axis=1))
    return float(distance[far].max()) if far.any() else 0.0


def left_out(times_ns: IntArray, false: list[FalseFirst]) -> BoolArray:
    """Which messages of these stamps, ns, are false, shape (n,)."""
    out = np.zeros(len(times_ns), dtype=np.bool_)
    for one in false:
        out |= (times_ns >= one.first_ns) & (times_ns <= one.last_ns)
    return out


def _judged(squares: FloatArray, first: IntArray) -> FloatArray:
    """Mean normalised squares of the epochs from these on, shape (k,); 0 where one is missing."""
    padded = np.append(squares, np.full(max(TRIED) + JUDGES, np.nan))
    return np.nan_to_num(np.mean(padded[first[:, None] + np.arange(JUDGES)], axis=1))


def _unknown_arm(start: FilterStart) -> float:
    """By how much fixes may move as the vehicle turns, m: 0 with a given lever arm."""
    return 0.0 if any(start.settings.lever_arm_b) else ARM_USUAL_M


def _from(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    start: FilterStart,
    whole: bool = False,
) -> list[Increments]:
    """Joined increments from a start on: of the whole log, or of its next fixes."""
    rows = np.flatnonzero(start.used.has_position)
    valid_ns = start.valid_ns[rows]
    first = int(np.searchsorted(valid_ns, start.time_ns, "right"))
    last = min(first + 1 + max(TRIED) + JUDGES, len(rows) - 1)
    end_ns = None if whole else max(int(valid_ns[last]), start.time_ns) + SECOND
    steps = SegmentIncrements(source, config, algorithm).from_time(start.time_ns, end_ns)
    blocks = (increments for increments, _, _ in steps)
    return list(joined_blocks(blocks, JOINED_S, start.valid_ns))


def _innovations(
    parts: list[Increments], start: FilterStart, rows: IntArray, out: BoolArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Normalised squares by row, and lengths, m, of the innovations of positions, shape (n,).

    Without a gate, so that what a false fix does to those that follow shows.

    Parameters
    ----------
    rows : ndarray of int64, shape (n,)
        Epochs with a position.
    out : ndarray of bool, optional
        Epochs that are left out.
    """
    run = InsGnssFilter(start.start, start.settings.ungated, with_baro=False, output=False)
    waiting: GnssEpochs | None = start.used if out is None else start.used.rows(~out)
    made = []
    for increments in parts:
        made.append(run.push(increments, waiting).gnss)
        waiting = None
    valid_ns = start.valid_ns
    squares, off = np.full(len(valid_ns), np.nan), np.full(len(valid_ns), np.nan)
    if not made:
        return squares[rows], off[rows]
    epochs = concatenate(made)
    row = np.searchsorted(valid_ns, epochs.time_ns - 1000)
    squares[row] = epochs.nis / np.maximum(epochs.rows, 1)
    # A fix may have no height
    off[row] = np.sqrt(np.nansum(np.square(epochs.innovation[:, :3]), axis=1))
    return squares[rows], off[rows]
