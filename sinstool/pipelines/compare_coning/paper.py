"""Fu and Luo's experiment beside what their paper prints: claims, verdicts and figures.

References
----------
.. [1] L. Fu, Z. Luo, "A singular perturbation-based algorithm for compensation of
   pseudo-coning error for strapdown inertial navigation" (in Chinese), 2011, section 4.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from sinstool.methods.coning.gyro_response import GyroResponse
from sinstool.pipelines.compare_coning import paper_claims_figures, paper_claims_table
from sinstool.pipelines.compare_coning.paper_claims import Claim, Judge
from sinstool.pipelines.compare_coning.paper_experiment import Experiment, run_experiment
from sinstool.simulation.coning_paper import DEFAULT_RESPONSE, Phase


@dataclass(frozen=True)
class Reproduction:
    """The experiment and what it says about the paper.

    Attributes
    ----------
    claims : tuple of Claim
        In the order of the paper.
    """

    experiment: Experiment
    claims: tuple[Claim, ...]

    @property
    def agreeing(self) -> int:
        """How many claims reproduce."""
        return sum(claim.reproduces for claim in self.claims)


def reproduce(
    phase: Phase = "consistent",
    response: GyroResponse = DEFAULT_RESPONSE,
    algorithms: Sequence[str] = (),
    *,
    progress: Callable[[float], None] | None = None,
) -> Reproduction:
    """Run the experiment and hold every claim of the paper against it.

    Parameters
    ----------
    phase, response, algorithms, progress
        See :func:`~sinstool.pipelines.compare_coning.paper_experiment.run_experiment`.

    Returns
    -------
    Reproduction
    """
    experiment = run_experiment(phase, response, algorithms, progress=progress)
    return Reproduction(experiment, judge(experiment))


def judge(experiment: Experiment) -> tuple[Claim, ...]:
    """Hold every claim of the paper against an experiment.

    Returns
    -------
    tuple of Claim
        In the order of the paper.
    """
    case = Judge(experiment)
    paper_claims_figures.figure_1(case)
    paper_claims_figures.figure_4(case)
    paper_claims_figures.figure_6(case)
    paper_claims_figures.figure_8(case)
    paper_claims_figures.figures_7_and_9(case)
    paper_claims_table.table_1(case)
    paper_claims_table.cost(case)
    paper_claims_table.conclusion(case)
    return tuple(case.claims)
