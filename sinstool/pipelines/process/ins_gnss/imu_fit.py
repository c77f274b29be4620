"""Whether the Imu is as good as its grade, judged by innovations.

From fix to fix even a poor Imu errs by less than the fixes do; what it is worth in an outage shows
only where fixes are left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
from scipy.special import chdtri

from sinstool.config import ProcessConfig
from sinstool.core.streams import GnssEpochs, concatenate, take_rows
from sinstool.core.timeline import SECOND
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.results import GnssDiagnostics
from sinstool.methods.sensor_errors import Grade
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.survey.increments import SegmentIncrements
from sinstool.survey.source import Source

# So much of a log shows it.
SHOWN_NS = 300 * SECOND
LEAST_EPOCHS = 40
# Squares beyond this are those of bad fixes, and count as this.
GATE = float(chdtri(6, 1e-4))
# Innovations squared over what was expected: beyond this a grade is doubted.
DOUBTED = 1.5
# Fixes are left out for so long, s, and used as long, from when the filter has settled, s, on.
LEFT_OUT_S, SETTLED_S = 10.0, 60.0
DRIFT_NS = 660 * SECOND
LONGEST_STEP_S = 1.5
LEAST_OUTAGES = 8
# Two squares of unit normals are less than this, nearly always; and what chance makes of their sum.
MOST_SQUARE = 50.0
# The median of the sum of two squares of unit normals, over its mean.
MEDIAN_OF_MEAN = float(np.log(2.0))
CHANCE = 0.01
# By how much the likelihood of all epochs must rise for a worse grade, natural units.
LEAST_GAIN = 10.0


@dataclass(frozen=True)
class Fit:
    """How well innovations agree with what a filter expects of them.

    Attributes
    ----------
    square : float
        Their squares over what was expected.
    cost : float
        -2 log likelihood, of an epoch.
    epochs : int
    """

    square: float
    cost: float
    epochs: int

    @property
    def doubted(self) -> bool:
        """Whether the model is worth a doubt."""
        return self.square > DOUBTED

    def worse_than(self, other: Fit) -> bool:
        """Whether another model is clearly more likely."""
        return self.cost > other.cost + LEAST_GAIN / self.epochs


def fit(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> Fit | None:
    """Fit of a filter's settings in a log's first minutes; None where too few fixes show it."""
    control = replace(start.settings.control, gate_probability=1.0, adaptive="off")
    run = InsGnssFilter(
        start.start,
        replace(start.settings, network=None, control=control),
        with_baro=False,
        output=False,
    )
    gnss: GnssEpochs | None = start.used
    steps = SegmentIncrements(source, config, algorithm)
    parts, last_ns = [], start.time_ns
    for increments, _, _ in steps.from_time(start.time_ns, start.time_ns + SHOWN_NS):
        if int(increments.time_ns[0]) - last_ns > round(start.settings.max_gap * SECOND):
            break
        last_ns = int(increments.time_ns[-1])
        parts.append(run.push(increments, gnss).gnss)
        gnss = None
    if not parts:
        return None
    epochs = concatenate(parts)
    epochs = take_rows(epochs, epochs.used & np.isfinite(epochs.nis))
    if len(epochs) < LEAST_EPOCHS:
        return None
    square = np.minimum(epochs.nis, GATE)
    spread = 2.0 * np.nansum(np.log(epochs.innovation_sigma), axis=1)
    return Fit(
        float(square.sum() / epochs.rows.sum()), float(np.mean(square + spread)), len(epochs)
    )


def drift_ratio(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> float:
    """By how much more the navigation drifts without fixes than a filter says that it does.

    Fixes are left out for ten seconds at a time, by turns with ten of fixes and then the other way
    round, and the last of each such outage is compared.

    Returns
    -------
    float
        Error over sigma, RMS of north and east; 1 where it is not more than chance makes of 1, or
        too few fixes show it. Where the filter began anew, bad fixes may have been the cause: what
        counts then is the median, to which these add little.
    """
    gnss = start.used
    step = np.diff(gnss.time_ns, prepend=start.time_ns) / SECOND
    # Time with fixes: an outage of the log itself is none of ours
    used = np.cumsum(np.minimum(step, LONGEST_STEP_S))
    squares, restarts = [], 0
    for phase in (0.0, LEFT_OUT_S):
        left_out = (used > SETTLED_S) & ((used + phase) % (2.0 * LEFT_OUT_S) >= LEFT_OUT_S)
        run = InsGnssFilter(
            start.start, replace(start.settings, network=None), with_baro=False, output=False
        )
        epochs = _compared(source, config, algorithm, start, run, left_out)
        if epochs is None:
            return 1.0
        restarts += run.summary.restarts
        ends = np.flatnonzero(epochs.withheld[:-1] & ~epochs.withheld[1:])
        ratio = (epochs.innovation / epochs.innovation_sigma)[ends, :2]
        squares.append(np.sum(ratio**2, axis=1))
    square = np.minimum(np.concatenate(squares), MOST_SQUARE)
    if len(square) < LEAST_OUTAGES:
        return 1.0
    if restarts:
        mean = float(np.median(square)) / MEDIAN_OF_MEAN
    else:
        mean = float(np.mean(square))
    chance = float(chdtri(2 * len(square), CHANCE)) / len(square)
    return float(np.sqrt(0.5 * mean)) if mean > chance else 1.0


def _compared(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    start: FilterStart,
    run: InsGnssFilter,
    left_out: np.ndarray,
) -> GnssDiagnostics | None:
    """Epochs with a position, some of them compared only, of a log's first part."""
    fixes: GnssEpochs | None = start.used
    parts, last_ns = [], start.time_ns
    steps = SegmentIncrements(source, config, algorithm)
    for increments, _, _ in steps.from_time(start.time_ns, start.time_ns + DRIFT_NS):
        if int(increments.time_ns[0]) - last_ns > round(start.settings.max_gap * SECOND):
            break
        last_ns = int(increments.time_ns[-1])
        parts.append(run.push(increments, fixes, None if fixes is None else left_out).gnss)
        fixes = None
    if not parts:
        return None
    epochs = concatenate(parts)
    return take_rows(epochs, np.isfinite(epochs.innovation[:, 1]))


def next_worse(grade: Grade) -> Grade | None:
    """The grade below one."""
    order: tuple[Grade, ...] = get_args(Grade)  # from the worst on
    at = order.index(grade)
    return order[at - 1] if at else None
