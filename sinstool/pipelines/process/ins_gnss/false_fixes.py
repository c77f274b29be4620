"""Stretches of fixes that are off by far more than their receiver states: found and reported.

They are not left out, as their error may change after the jump that shows it: they get the size of
the jump as sigma, as if the receiver had stated it. Only the first fixes of a log or after an
outage are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.choices import log_choice
from sinstool.core.errors import AlignmentError
from sinstool.core.finding import Finding
from sinstool.core.order_statistics import median
from sinstool.core.streams import GnssEpochs, concatenate
from sinstool.core.timeline import SECOND
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.fix_jumps import (
    MOST_S,
    PRECISE_M,
    FalseStretch,
    false_stretches,
    unsettled,
)
from sinstool.methods.ins_gnss.fix_velocity import message_times, worse_than_usual
from sinstool.methods.ins_gnss.scattered_fixes import ScatteredStretch, scattered_stretches
from sinstool.methods.ins_gnss.settings import GnssModel, Settings
from sinstool.pipelines.process.ins_gnss.filter_settings import receiver_stated
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.first_fixes import (
    false_firsts,
    left_out,
    without_false_start,
)
from sinstool.pipelines.process.ins_gnss.first_start import first_start
from sinstool.pipelines.process.ins_gnss.receiver import WORSE_S
from sinstool.pipelines.process.ins_gnss.start import timed
from sinstool.survey.increments import SegmentIncrements
from sinstool.survey.source import Source

# Noise of fixes, m and m/s, for a filter that hardly follows false ones.
POSITION, VELOCITY = (1.0, 1.0, 1.6), (0.3, 0.3, 0.5)
# A filter hardly knows its heading after a gap of the IMU in which it may change by this, rad.
TURNED = 0.1
MOST_NAMED = 5
KIND = "false-fixes"


@dataclass(frozen=True)
class _WrongFixes:
    """Fixes off by more than their receiver states, by stamp, ns, and by how much, m."""

    begin_ns: int
    end_ns: int
    off_m: float
    how: str


def find_false_fixes(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, first: FilterStart
) -> tuple[Source, FilterStart, list[Finding]]:
    """A log without false first fixes, and with larger sigmas where other fixes are false.

    Parameters
    ----------
    first : FilterStart
        By :func:`~sinstool.pipelines.process.ins_gnss.first_start.first_start`.

    Returns
    -------
    source, first : Source, FilterStart
        Unchanged if there are none.
    findings : list of Finding
        One for each stretch.
    """
    source, first, findings = _without_false_firsts(source, config, algorithm, first)
    gnss = source.aiding.gnss
    if gnss is None or receiver_stated(config) or not _precise(gnss):
        return source, first, findings
    if not _stretches(source, config, algorithm, first):
        return source, first, findings
    # A wrong lever arm or latency may look like jumps
    begun = timed(source, config, algorithm, first).by_the_fixes
    stretches = _stretches(source, config, algorithm, begun)
    if not stretches:
        return source, first, findings
    sigma = gnss.sigma_position_n.copy()
    for one in stretches:
        inside = gnss.has_position & (gnss.time_ns >= one.begin_ns) & (gnss.time_ns <= one.end_ns)
        # All of them have the same error, which counts once however long it lasts
        lasts = max((one.end_ns - one.begin_ns) / SECOND / WORSE_S, 1.0)
        sigma[inside] = np.maximum(sigma[inside], np.sqrt(lasts) * one.off_m)
    source, first, begun_anew = _with_fixes(
        source, config, first, replace(gnss, sigma_position_n=sigma)
    )
    if not begun_anew:
        return source, first, findings
    log_choice("false fixes", f"{len(stretches)} stretches")
    return source, first, [*findings, *_findings(stretches, source.survey.first_ns)]


def _without_false_firsts(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, first: FilterStart
) -> tuple[Source, FilterStart, list[Finding]]:
    """A log without false fixes at its start or right after outages, and findings about them."""
    anew, shown = without_false_start(source, config, algorithm, first), []
    if anew is not None:
        source, first = anew.source, anew.start
        shown.append(anew.false.finding(KIND, source.survey.first_ns))
        log_choice("false fixes", "the first")
    gnss = source.aiding.gnss
    false = [] if gnss is None else false_firsts(source, config, algorithm, first)
    if gnss is None or not false:
        return source, first, shown
    good = gnss.rows(~left_out(gnss.time_ns, false))
    source, first, begun_anew = _with_fixes(source, config, first, good)
    if not begun_anew:
        return source, first, shown
    log_choice("false fixes", f"after {len(false)} outages")
    shown += [one.finding(KIND, source.survey.first_ns) for one in false[:MOST_NAMED]]
    if len(false) > MOST_NAMED:
        last = (false[-1].first_ns - source.survey.first_ns) / SECOND
        text = f"after {len(false) - MOST_NAMED} more outages the first fixes are as false"
        shown.append(Finding(KIND, f"{text}, the last time at {last:.1f} s"))
    return source, first, shown


def _with_fixes(
    source: Source, config: ProcessConfig, first: FilterStart, gnss: GnssEpochs
) -> tuple[Source, FilterStart, bool]:
    """A log with other fixes, and a first start by them; the same if they show none (False)."""
    changed = replace(source, aiding=replace(source.aiding, gnss=gnss))
    try:
        return changed, first_start(changed, config), True
    except AlignmentError:
        return source, first, False


def _precise(gnss: GnssEpochs) -> bool:
    """Whether the receiver states sigmas of much less than a metre."""
    sigma = gnss.sigma_position_n[np.isfinite(gnss.sigma_position_n).all(axis=1)]
    return bool(len(sigma)) and float(median(sigma[:, :2].max(axis=1))) < PRECISE_M


def _stretches(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> list[_WrongFixes]:
    """Stretches of fixes that are off together, and of those that scatter."""
    settings = replace(
        start.settings.ungated,
        filter="plain-15",
        gnss=GnssModel(position_white=POSITION, velocity_white=VELOCITY),
    )
    # An outlier would part the fixes before it from those after it
    gnss, used = source.aiding.gnss, start.believable
    assert gnss is not None
    nothing = np.full_like(used.sigma_position_n, np.nan)
    unsized = replace(used, sigma_position_n=nothing, sigma_velocity_n=nothing)
    run = InsGnssFilter(start.start, settings, with_baro=False, output=False)
    waiting: GnssEpochs | None = unsized
    parts = []
    for increments, _, _ in SegmentIncrements(source, config, algorithm).from_time(start.time_ns):
        parts.append(run.push(increments, waiting).gnss)
        waiting = None
    if not parts:
        return []
    epochs = concatenate(parts)
    valid_ns = used.time_ns - round(settings.gnss_latency * SECOND)
    row = np.searchsorted(valid_ns, epochs.time_ns - 1000)
    good = np.isfinite(epochs.innovation[:, :3]).all(axis=1)
    good &= ~worse_than_usual(used)[row] & ~_repeated(used)[row]
    row, innovation = row[good], epochs.innovation[good, :3]
    left = np.square(epochs.measurement_sigma / epochs.innovation_sigma)[good, :3]
    known = ~unsettled(epochs.time_ns[good], innovation, left, _attitude_lost(source, settings))
    row, innovation, left = row[known], innovation[known], left[known]
    stamps = message_times(used, start.lag)[row]
    # As the receiver states it, without the changes made for a start
    stated = gnss.sigma_position_n[np.searchsorted(gnss.time_ns, stamps)]
    scattered = scattered_stretches(stamps, innovation, left, stated)
    found: list[FalseStretch | ScatteredStretch] = [*scattered]
    for one in false_stretches(stamps, innovation, left, stated):
        if not any(wide.first <= one.first and one.last <= wide.last for wide in scattered):
            found.append(one)
    found.sort(key=lambda one: one.first)
    return [_WrongFixes(*_stamps(one, stamps), one.off_m, _how(one)) for one in found]


def _attitude_lost(source: Source, settings: Settings) -> np.ndarray:
    """Ends, ns, of gaps of the IMU in which the vehicle may have turned."""
    turned = [gap for gap in source.survey.gaps if gap[1] * settings.gap_rate > TURNED]
    return np.array([begin + round(length * SECOND) for begin, length in turned], np.int64)


def _stamps(stretch: FalseStretch | ScatteredStretch, stamps: np.ndarray) -> tuple[int, int]:
    """First and last stamp; among fixes that scatter are some that the filter did not take."""
    first, last = int(stamps[stretch.first]), int(stamps[stretch.last])
    if isinstance(stretch, ScatteredStretch):
        # Beyond an outage is no fix beside them
        if stretch.first and first - stamps[stretch.first - 1] <= MOST_S * SECOND:
            first = int(stamps[stretch.first - 1]) + 1
        if stretch.last + 1 < len(stamps) and stamps[stretch.last + 1] - last <= MOST_S * SECOND:
            last = int(stamps[stretch.last + 1]) - 1
    return first, last


def _how(stretch: FalseStretch | ScatteredStretch) -> str:
    """What is wrong with fixes."""
    if isinstance(stretch, ScatteredStretch):
        scatter = f"scatter by {stretch.scatter_m:.2g} m"
        if stretch.off_m > stretch.scatter_m:
            return f"{scatter} and are {stretch.off_m:.2g} m off from those beside them"
        return scatter
    others = "those beside them" if stretch.sure else "others, and nothing shows which is right"
    return f"are {stretch.off_m:.2g} m off from {others}"


def _repeated(gnss: GnssEpochs) -> np.ndarray:
    """Positions equal to those of the epoch before, to the last digit: of a receiver that hangs."""
    same = (np.diff(gnss.latitude) == 0.0) & (np.diff(gnss.longitude) == 0.0)
    return np.concatenate([[False], same])


def _findings(stretches: Sequence[_WrongFixes], first_ns: int) -> list[Finding]:
    """A finding for each stretch, up to `MOST_NAMED`."""
    findings = []
    for one in stretches[:MOST_NAMED]:
        seconds = [(time - first_ns) / SECOND for time in (one.begin_ns, one.end_ns)]
        findings.append(
            Finding(
                KIND,
                f"fixes from {seconds[0]:.1f} to {seconds[1]:.1f} s {one.how}, far more than the"
                " receiver states: this is used as their sigma",
                start_ns=one.begin_ns,
                end_ns=one.end_ns,
                numbers={"off_m": one.off_m},
            )
        )
    if len(stretches) > MOST_NAMED:
        rest = stretches[MOST_NAMED:]
        last = (rest[-1].begin_ns - first_ns) / SECOND
        findings.append(
            Finding(KIND, f"{len(rest)} more such stretches follow, the last from {last:.1f} s on")
        )
    return findings
