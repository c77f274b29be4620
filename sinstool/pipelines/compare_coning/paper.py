"""Fu and Luo's experiment compared with their paper: claims, verdicts and figures.

References
----------
.. [1] L. Fu, Z. Luo, "A singular perturbation-based algorithm for compensation of
   pseudo-coning error for strapdown inertial navigation" (in Chinese), 2011, section 4.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from sinstool.methods.coning.gyro_response import GyroResponse, none
from sinstool.pipelines.compare_coning import paper_claims_figures
from sinstool.pipelines.compare_coning.paper_claims import (
    CLOSE,
    LEVEL_FACTOR,
    MEAN_FACTOR,
    SP_PAPER,
    Claim,
    Judge,
    above,
    near,
    within,
)
from sinstool.pipelines.compare_coning.paper_experiment import Experiment, run_experiment
from sinstool.pipelines.compare_coning.paper_sweep import Setting
from sinstool.simulation.coning_paper import DEFAULT_RESPONSE, RATE_HZ, Phase

# Table 1: name, printed mean in degrees, and the cases that may be meant.
OPT4_MEAN = ("optimal-4", -0.0038, ("rect-opt4",))
SP_MEAN = ("SP", -0.0024, (SP_PAPER, "sp-paper-truncated"))


def settings_with_means(experiment: Experiment) -> tuple[set[Setting], set[Setting]]:
    """Gyros and readings of eq. 20 that give a printed mean.

    Returns
    -------
    opt4, sp : set of Setting
    """
    opt4, sp = (
        {
            one
            for one in experiment.settings
            for key in keys
            if within(printed, MEAN_FACTOR).holds(experiment.sweep(key, one).mean_deg)
        }
        for _, printed, keys in (OPT4_MEAN, SP_MEAN)
    )
    return opt4, sp


def table_1(judge: Judge) -> None:
    """Means over all frequencies."""
    claim = partial(judge.add, "Table 1")
    for name, value, keys in (OPT4_MEAN, SP_MEAN):
        test = within(value, MEAN_FACTOR)
        claim(
            f"{name}-mean",
            f"{name}: mean error",
            f"{value} deg",
            judge.e.sweep(keys[0]).mean_deg,
            test,
            "mean of the signed z component, with this gyro and reading of eq. 20",
            "the mean follows the gyro's gain at 30 Hz and the reading of eq. 20 more than"
            " the algorithm",
            "as printed" if name == "SP" else "rate x T",
        )
        all_of = [judge.e.sweep(key, s) for s in judge.e.settings for key in keys]
        nearest = min(all_of, key=lambda s: abs(s.mean_deg - value))
        claim(
            f"{name}-mean-any",
            f"{name}: mean error, nearest of all settings",
            f"{value} deg",
            nearest.mean_deg,
            test,
            f"with {nearest.setting.name} ({nearest.case.label})",
            "no gyro and no reading of eq. 20 gives it",
            f"all of {len(judge.e.settings)} settings",
        )
    opt4, sp = settings_with_means(judge.e)
    both = opt4 & sp
    claim(
        "both-means",
        "settings that give both means, at least",
        "1",
        float(len(both)),
        above(1.0),
        ", ".join(sorted(s.name for s in both)),
        f"{len(opt4)} settings give the one and {len(sp)} the other, none both",
        f"all of {len(judge.e.settings)} settings",
    )


def cost(judge: Judge) -> None:
    """Update rates and times."""
    claim = partial(judge.add, "Table 1")
    for key, name, printed in (("rect-opt4", "optimal-4", 100.0), (SP_PAPER, "SP", 400.0)):
        samples = judge.e.sweep(key).case.algorithm.samples
        claim(
            f"{key}-update-rate",
            f"{name}: update rate",
            f"{printed:g} Hz",
            RATE_HZ / samples,
            near(printed, CLOSE),
            f"{samples} sample{'s' if samples > 1 else ''} an update",
            "another number of samples an update",
        )
    opt4, sp = judge.e.costs["rect-opt4"], judge.e.costs[SP_PAPER]
    for one, name, printed in ((opt4, "optimal-4", 0.013), (sp, "SP", 0.000249)):
        claim(
            f"{name}-time",
            f"{name}: time of an update",
            f"{printed} s",
            one.update_s,
            within(printed, LEVEL_FACTOR),
            "on this machine",
            "the time is the machine's and the language's, not the algorithm's",
            "measured here, compiled",
        )
    claim(
        "cost-ratio",
        "one update of optimal-4 costs as many of SP",
        "52",
        opt4.update_s / sp.update_s,
        within(52.0, LEVEL_FACTOR),
        "on this machine",
        f"an update of optimal-4 answers for four samples; over a second of data SP costs"
        f" {sp.data_s / opt4.data_s:.1f} times as much as optimal-4",
        "measured here, compiled",
    )


def conclusion(judge: Judge) -> None:
    """Conclusion of section 5 on coning itself."""
    claim = partial(judge.add, "Section 5")
    flat = Setting(judge.e.setting.phase, none())
    left = {}
    for key in ("rect", SP_PAPER, "sp-paper-truncated", "inc-optimal-4"):
        sweep = judge.e.sweep(key, flat)
        left[key] = float(abs(sweep.z_deg[sweep.row(0.0)]))
    removed = 1.0 - left[SP_PAPER] / left["rect"]
    truncated = 1.0 - left["sp-paper-truncated"] / left["rect"]
    others = f"optimal-4 on true increments {1.0 - left['inc-optimal-4'] / left['rect']:.4f}"
    claim(
        "compensates",
        "SP compensates coning well: part of the error removed above",
        "0.5",
        removed,
        above(0.5),
        f"with the equations as printed; {others}",
        f"with epsilon 2e-4 s and n = 0.001 it is the rectangle rule but for"
        f" {100 * abs(removed):.0f} % (printed) or {100 * abs(truncated):.0f} % (corrected);"
        f" {others}",
        f"{flat.name}, no noise",
    )


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
        """Number of claims that are reproduced."""
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
    table_1(case)
    cost(case)
    conclusion(case)
    return tuple(case.claims)
