"""First fixes after an outage that are far off those that follow: found and left out.

Receivers that see satellites again may be off by many metres and state a few centimetres. After an
outage a filter cannot tell: its own position is less certain than any such fix. It uses the false
one, and then rejects the good ones, or takes the way to them for speed. What tells them apart is
what follows: without the first fixes, those after them agree with one another.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.finding import Finding, Severity
from sinstool.core.streams import GnssEpochs, concatenate
from sinstool.core.timeline import SECOND
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.fix_velocity import message_times
from sinstool.methods.strapdown.joined_updates import JOINED_S, joined_updates
from sinstool.methods.strapdown.velocity import Increments
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.survey.increments import SegmentIncrements
from sinstool.survey.source import Source

# After so long without positions, s, a filter is less certain than a fix.
OUTAGE_S = 5.0
# So many first fixes are tried as false, the fewest first, and judged by so many that follow.
TRIED, JUDGES = (1, 2, 4), 5
# They are false if the squared innovations of those that follow are this many times as large as
# expected, and this many times as large as without them.
DISAGREE, LESS = 5.0, 4.0


@dataclass(frozen=True)
class FalseFirst:
    """False fixes that end an outage.

    Attributes
    ----------
    first_ns, last_ns : int
        Stamps of the first and the last message.
    off_m : float
        Distance from those that follow, m.
    outage_s : float
        Length of the outage, s.
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
        text = (
            f"{which}, the first after {self.outage_s:.0f} s, {'is' if one else 'are'} about"
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
    # Of those that follow as soon as usual, as in an outage of a second the receiver is still in it
    outages = np.flatnonzero(waited > OUTAGE_S) + 1
    outages = outages[outages + max(TRIED) + JUDGES <= len(rows)]
    if not len(outages):
        return []
    steps = SegmentIncrements(source, config, algorithm).from_time(start.time_ns)
    parts = [joined_updates(increments, JOINED_S) for increments, _, _ in steps]
    if not parts:
        return []
    squares, off = _innovations(parts, start, rows, np.zeros(len(used), dtype=np.bool_))
    open_, found = outages, []
    for many in TRIED:
        before = _judged(squares, open_ + many)
        open_, before = open_[before > DISAGREE], before[before > DISAGREE]
        if not len(open_):
            break
        out = np.zeros(len(used), dtype=np.bool_)
        out[rows[(open_[:, None] + np.arange(many)).ravel()]] = True
        without, _ = _innovations(parts, start, rows, out)
        false = _judged(without, open_ + many) < before / LESS
        stamps = message_times(used, start.lag)[rows]
        for k in open_[false].tolist():
            ends = int(stamps[k]), int(stamps[k + many - 1])
            found.append(FalseFirst(*ends, float(off[k + many]), float(waited[k - 1])))
        open_ = open_[~false]
    return sorted(found, key=lambda one: one.first_ns)


def left_out(times_ns: IntArray, false: list[FalseFirst]) -> BoolArray:
    """Which messages of these stamps, ns, are false, shape (n,)."""
    out = np.zeros(len(times_ns), dtype=np.bool_)
    for one in false:
        out |= (times_ns >= one.first_ns) & (times_ns <= one.last_ns)
    return out


def _judged(squares: FloatArray, first: IntArray) -> FloatArray:
    """Mean normalised squares of the epochs from these on, shape (k,); 0 where one is missing."""
    return np.nan_to_num(np.mean(squares[first[:, None] + np.arange(JUDGES)], axis=1))


def _innovations(
    parts: list[Increments], start: FilterStart, rows: IntArray, out: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Normalised squares by row, and lengths, m, of the innovations of positions, shape (n,).

    Without a gate, so that what a false fix does to those that follow shows.

    Parameters
    ----------
    rows : ndarray of int64, shape (n,)
        Epochs with a position.
    out : ndarray of bool
        Epochs that are left out.
    """
    control = replace(start.settings.control, gate_probability=1.0, adaptive="off")
    settings = replace(start.settings, network=None, control=control)
    run = InsGnssFilter(start.start, settings, with_baro=False, output=False)
    waiting: GnssEpochs | None = start.used.rows(~out)
    made = []
    for increments in parts:
        made.append(run.push(increments, waiting).gnss)
        waiting = None
    epochs = concatenate(made)
    valid_ns = start.used.time_ns - round(settings.gnss_latency * SECOND)
    squares, off = np.full(len(valid_ns), np.nan), np.full(len(valid_ns), np.nan)
    row = np.searchsorted(valid_ns, epochs.time_ns - 1000)
    squares[row] = epochs.nis / np.maximum(epochs.rows, 1)
    off[row] = np.linalg.norm(epochs.innovation[:, :3], axis=1)
    return squares[rows], off[rows]
