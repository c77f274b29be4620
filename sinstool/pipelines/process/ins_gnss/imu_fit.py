"""Whether the IMU is as good as its grade, judged by innovations.

From fix to fix even a poor IMU drifts by less than the errors of the fixes; its drift in an outage
shows only where fixes are left out: see :mod:`~sinstool.pipelines.process.ins_gnss.imu_drift`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from sinstool.config import ProcessConfig
from sinstool.core.timeline import SECOND
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.imu_drift import shaking
from sinstool.pipelines.process.ins_gnss.innovation_cost import (
    LEAST_EPOCHS,
    innovation_cost,
    innovations,
    mean_square,
)
from sinstool.survey.increments import first_increments
from sinstool.survey.source import Source

# The first part of a log, which is used.
SHOWN_NS = 300 * SECOND
# Squared innovations over their expectation beyond which a grade is doubted.
DOUBTED = 1.5
# By how much another model must lower -2 log likelihood, over all epochs, to be clearly likelier.
LEAST_GAIN = 10.0


@dataclass(frozen=True)
class Fit:
    """How well innovations agree with what a filter expects of them.

    Attributes
    ----------
    square : float
        Their squares over their expectation.
    cost : float
        -2 log likelihood per epoch.
    epochs : int
    """

    square: float
    cost: float
    epochs: int

    @property
    def doubted(self) -> bool:
        """Whether innovations are too large for the model."""
        return self.square > DOUBTED

    def worse_than(self, other: Fit) -> bool:
        """Whether another model is clearly more likely than this."""
        return self.cost > other.cost + LEAST_GAIN / self.epochs


def fit(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> Fit | None:
    """Fit of a filter's settings in a log's first minutes; None where too few fixes show it."""
    control = replace(start.settings.control, adaptive="off")
    shaken = shaking(source, config, algorithm, start)
    settings = replace(start.settings, network=None, control=control)
    stands = None if shaken is None else shaken.constraints(start.settings.imu)
    gap_ns = round(start.settings.max_gap * SECOND)
    shown = first_increments(source, config, algorithm, start.time_ns, SHOWN_NS, gap_ns)
    if shown is None:
        return None
    epochs = innovations(start.start, settings, shown, start.used, stands)
    if len(epochs) < LEAST_EPOCHS:
        return None
    return Fit(mean_square(epochs), innovation_cost(epochs) / len(epochs), len(epochs))
