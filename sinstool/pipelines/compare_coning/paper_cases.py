"""Cases of the published pseudo-coning experiment: an algorithm and its input."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.methods.coning.algorithm import ConingAlgorithm, MultiSampleAlgorithm
from sinstool.methods.coning.gyro_response import GyroResponse
from sinstool.methods.coning.registry import algorithm
from sinstool.methods.coning.singular_perturbation import VARIANTS, SingularPerturbation
from sinstool.simulation.coning_paper import RATE_HZ

Feed = Literal["rates", "rate x T", "interpolated", "increments"]

# Fu and Luo: "in the neighbourhood of the sampling frequency epsilon is 0.032, beta unchanged".
LARGE_EPSILON = 0.032
PAPER_GAIN = 0.001


@dataclass(frozen=True)
class Case:
    """An algorithm and its input.

    Attributes
    ----------
    key : str
        Short name, for tables and files.
    label : str
        Long name, for people.
    feed : {"rates", "rate x T", "interpolated", "increments"}
        Point rates as they are; point rates times the interval in place of increments, as
        the paper has it; point rates integrated through a polynomial of neighbours, as
        ``sinstool process`` has it; true increments.
    """

    key: str
    label: str
    algorithm: ConingAlgorithm
    feed: Feed


class Summed(MultiSampleAlgorithm):
    """Sum of a few increments as the rotation vector: no coning term, at a lower rate.

    Parameters
    ----------
    samples : int
        Increments per update.
    """

    summary = "increments of an update added up, no coning correction"
    source = "Bortz 1971, first term of the rotation vector"

    def __init__(self, samples: int) -> None:
        self.name = f"summed-{samples}"
        self.samples = samples

    def _fill(self, x: FloatArray, dt: FloatArray, first: int, out: FloatArray) -> None:
        end = first + len(out) * self.samples
        out[:] = x[first : end : self.samples]
        for k in range(1, self.samples):
            out += x[first + k : end : self.samples]

    def _of_samples(self, samples: int) -> ConingAlgorithm:
        return Summed(samples)


class WithoutConingTerm(ConingAlgorithm):
    """The first part of the singular-perturbation rotation vector: alpha of eq. 2 alone.

    Parameters
    ----------
    whole : SingularPerturbation
        With a beta gain (eq. 14).
    """

    takes = "rates"
    before = 1
    summary = "two point rates with a boundary layer, without the coning term"
    source = "Fu and Luo 2011, eq. 2 without delta alpha"

    def __init__(self, whole: SingularPerturbation) -> None:
        self.name = f"{whole.name} without coning term"
        self._whole = whole

    def _fill(self, x: FloatArray, dt: FloatArray, first: int, out: FloatArray) -> None:
        count = len(out)
        t = dt[first : first + count]
        values, index = np.unique(t, return_inverse=True)
        p = np.array([self._whole.two_rate_form(float(v))[0] for v in values])[index]
        out[:] = p[:, None] * x[first - 1 : first - 1 + count]
        out += (t - p)[:, None] * x[first : first + count]


def paper_cases() -> tuple[Case, ...]:
    """Build the cases that the paper's figures are compared with.

    Returns
    -------
    tuple of Case
        Point rates first, then true increments.
    """
    cases = [
        Case("rect", "rectangle rule, no compensation", algorithm("uncompensated"), "rate x T"),
        Case("rect-100", "rectangle rule, updates at 100 Hz", Summed(4), "rate x T"),
        Case("rect-opt4", "optimal-4 on rate x T (as printed)", algorithm("optimal-4"), "rate x T"),
    ]
    for variant in reversed(VARIANTS):
        sp = SingularPerturbation(preset="paper", variant=variant)
        cases.append(Case(f"sp-paper-{variant}", f"SP 2e-4 s, {variant}", sp, "rates"))
    for variant in reversed(VARIANTS):
        cases.append(
            Case(f"sp-0.032-{variant}", f"SP 0.032 s, {variant}", _large(variant), "rates")
        )
    alpha = WithoutConingTerm(_large("truncated"))
    best = SingularPerturbation(preset="best")
    cases += [
        Case("sp-0.032-alpha", "SP 0.032 s, without its coning term", alpha, "rates"),
        Case("sp-best", "SP best (T/2, n = 2)", best, "rates"),
    ]
    for name in ("uncompensated", "optimal-4", "previous-3"):
        cases.append(_registered(name, "increments"))
    cases.append(_registered("previous-3", "interpolated"))
    return tuple(cases)


def extra_cases(names: Sequence[str], response: GyroResponse) -> tuple[Case, ...]:
    """Build cases of algorithms named by the user.

    Parameters
    ----------
    names : sequence of str
        As in :mod:`sinstool.methods.coning.registry`.
    response : GyroResponse
        Of the gyro, for an algorithm that wants to know.

    Returns
    -------
    tuple of Case
        Each on true increments and on interpolated rates, or on rates if it takes those;
        none that :func:`paper_cases` has.
    """
    paper_keys = {case.key for case in paper_cases()}
    cases = []
    for name in dict.fromkeys(names):
        options: dict[str, Any] = {}
        if name == "gyro-tuned":
            options = {"gyro_response": response, "interval": 1.0 / RATE_HZ}
        if algorithm(name, **options).takes == "increments":
            cases.append(_registered(name, "increments", options))
        cases.append(_registered(name, "interpolated", options))
    return tuple(case for case in cases if case.key not in paper_keys)


def _large(variant: str) -> SingularPerturbation:
    return SingularPerturbation(epsilon=LARGE_EPSILON, beta_gain=PAPER_GAIN, variant=variant)


def _registered(name: str, feed: Feed, options: Mapping[str, Any] | None = None) -> Case:
    one = algorithm(name, **(options or {}))
    one = one.for_kind("mean-rate" if feed == "increments" else "rate")
    if one.takes == "rates":
        return Case(f"rates-{name}", f"{name} on rates", one, "rates")
    if feed == "increments":
        return Case(f"inc-{name}", f"{name} on true increments", one, feed)
    return Case(f"int-{name}", f"{name} on interpolated rates", one, feed)
