"""Claims of the paper, results of this experiment, and their agreement.

Every verdict is computed: from our number, the printed one and a tolerance that is stated.
A printed figure was read off a curve and the gyro is known from a curve alone, so agreement
is meant to a factor where the figure depends on that gyro, and closely where it does not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import BoolArray
from sinstool.pipelines.compare_coning.paper_experiment import Experiment
from sinstool.pipelines.compare_coning.paper_sweep import Sweep

LEVEL_FACTOR = 1.5  # figures that were read off a curve
MEAN_FACTOR = 1.25  # table 1, which is printed with two digits
CLOSE = 0.05  # figures that the gyro hardly matters for
JUMP_DEG = 0.0025  # half of the smaller level of figure 8
SEVERE_DEG = 0.1  # the paper calls an error within this very good
LOW_BAND = (1.0, 199.0)
SP_PAPER = "sp-paper-printed"  # the paper's own equations and parameters


@dataclass(frozen=True)
class Claim:
    """One printed claim beside our number.

    Attributes
    ----------
    source : str
        Figure, table or section of the paper.
    statement : str
        What is claimed, in a few words.
    paper : str
        The printed figure, with unit.
    setting : str
        What our number was computed with.
    tolerance : str
        What counts as agreement.
    verdict : {'reproduces', 'does not'}
    why : str
        In one sentence.
    """

    key: str
    source: str
    statement: str
    paper: str
    ours: float
    unit: str
    setting: str
    tolerance: str
    verdict: str
    why: str

    @property
    def reproduces(self) -> bool:
        """Whether the printed figure comes out again."""
        return self.verdict == "reproduces"


@dataclass(frozen=True)
class Tolerance:
    """Tolerance within which two numbers agree."""

    text: str
    holds: Callable[[float], bool]


def within(printed: float, factor: float) -> Tolerance:
    """Same sign, and equal up to a factor."""
    sign = "same sign, " if printed < 0.0 else ""
    return Tolerance(
        f"{sign}within a factor of {factor:g}",
        lambda ours: bool(1.0 / factor <= ours / printed <= factor),
    )


def near(printed: float, relative: float) -> Tolerance:
    """Equal up to a part."""
    return Tolerance(
        f"within {100 * relative:g} %",
        lambda ours: bool(abs(ours - printed) <= relative * abs(printed)),
    )


def below(limit: float) -> Tolerance:
    """Not more than a limit."""
    return Tolerance(f"at most {limit:g}", lambda ours: bool(ours <= limit))


def above(limit: float) -> Tolerance:
    """Not less than a limit."""
    return Tolerance(f"at least {limit:g}", lambda ours: bool(ours >= limit))


def low_level(sweep: Sweep) -> float:
    """Level about which the error varies below the bandwidth.

    Returns
    -------
    float
        Median of the absolute z component from 1 to 199 Hz, degrees.
    """
    return float(np.median(np.abs(sweep.z_deg[low_band(sweep)])))


def jump(sweep: Sweep, frequency: float) -> float:
    """Height of a spike of one frequency above its neighbours.

    Parameters
    ----------
    frequency : float
        Hz.

    Returns
    -------
    float
        Degrees; of the z component at the end or of the largest error, where it is higher.
    """
    row = sweep.row(frequency)
    return max(
        abs(float(v[row] - 0.5 * (v[row - 1] + v[row + 1]))) for v in (sweep.z_deg, sweep.peak_deg)
    )


def low_band(sweep: Sweep) -> BoolArray:
    """Rows of a sweep below the bandwidth."""
    return (sweep.frequency >= LOW_BAND[0]) & (sweep.frequency <= LOW_BAND[1])


class Judge:
    """Collects claims about one experiment.

    Attributes
    ----------
    gyro : GyroResponse
        That the figures are for.
    """

    def __init__(self, experiment: Experiment) -> None:
        self.e = experiment
        self.claims: list[Claim] = []
        self.gyro = experiment.setting.response

    def add(
        self,
        source: str,
        key: str,
        statement: str,
        paper: str,
        ours: float,
        test: Tolerance,
        yes: str,
        no: str,
        setting: str = "",
        unit: str | None = None,
    ) -> None:
        """Hold a number against a printed one; `yes` and `no` are the reasons for either.

        The unit is the printed one unless another is given.
        """
        unit = paper.partition(" ")[2] if unit is None else unit
        where = self.e.setting.name + (f"; {setting}" if setting else "")
        verdict, why = ("reproduces", yes) if test.holds(ours) else ("does not", no)
        self.claims.append(
            Claim(key, source, statement, paper, ours, unit, where, test.text, verdict, why)
        )

    def norm(self, key: str, frequency: float) -> float:
        """Length of the error of a case at one frequency of noise, degrees."""
        sweep = self.e.sweep(key)
        return float(sweep.norm_deg[sweep.row(frequency)])
