"""The experiment of Fu and Luo's paper, repeated with many gyros and algorithms.

A cone of 0.1 deg and 30 Hz is sampled at 400 Hz for ten seconds, with noise of 0.01 deg at one
frequency, which goes from 0 to 1000 Hz in steps of 1 Hz. For each, the attitude that an
algorithm arrives at is compared with the truth: the signed z component of
``log(q_true^-1 q)`` at the end is what the paper's signed means can be means of.

References
----------
.. [1] L. Fu, Z. Luo, "A singular perturbation-based algorithm for compensation of
   pseudo-coning error for strapdown inertial navigation" (in Chinese), 2011, section 4.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.coning.gyro_response import GyroResponse, butterworth, chebyshev, none
from sinstool.methods.strapdown.attitude import AttitudePropagator
from sinstool.pipelines.compare_coning.paper_cases import Case, extra_cases, paper_cases
from sinstool.pipelines.compare_coning.paper_sweep import Setting, Sweep, run_sweeps
from sinstool.simulation.coning_paper import (
    BANDWIDTH_HZ,
    DEFAULT_RESPONSE,
    FREQUENCY_HZ,
    NOISE_ANGLE,
    PHASES,
    RATE_HZ,
    RIPPLE_DB,
    Phase,
)

RESPONSES = (
    *(chebyshev(order, RIPPLE_DB, BANDWIDTH_HZ) for order in range(5, 10)),
    *(butterworth(order, BANDWIDTH_HZ) for order in (8, 9, 10)),
    none(),
)

# What table 1 is looked for in, with every gyro.
_TABLE_CASES = ("rect", "rect-opt4", "sp-paper-truncated", "sp-paper-printed", "inc-optimal-4")

_COST_ROWS = 40_000
_COST_REPEATS = 9


@dataclass(frozen=True)
class Cost:
    """Time that an algorithm takes, with the attitude that its rotation vectors update.

    Attributes
    ----------
    update_s : float
        For one update of the attitude, s.
    data_s : float
        For one second of data, s.
    """

    update_s: float
    data_s: float


@dataclass(frozen=True)
class Experiment:
    """All runs of the experiment.

    Attributes
    ----------
    setting : Setting
        The gyro that the figures are for.
    cases : tuple of Case
        What was run with it.
    frequency : ndarray, shape (m,)
        Of the noise, Hz.
    sweeps : dict
        A :class:`Sweep` for each setting and key of a case.
    costs : dict
        A :class:`Cost` for each key of a case.
    """

    setting: Setting
    cases: tuple[Case, ...]
    frequency: FloatArray
    sweeps: dict[tuple[Setting, str], Sweep]
    costs: dict[str, Cost]

    def sweep(self, key: str, setting: Setting | None = None) -> Sweep:
        """The sweep of a case, by default in the experiment's own setting."""
        return self.sweeps[setting or self.setting, key]

    @property
    def settings(self) -> tuple[Setting, ...]:
        """All gyro settings tried for table 1."""
        return tuple(dict.fromkeys(setting for setting, _ in self.sweeps))

    def mean_without_jumps(self, sweep: Sweep) -> float:
        """Mean of the signed z component without the frequencies that beat with the motion.

        Returns
        -------
        float
            Degrees. Left out are the motion's own frequency and those that differ from it by
            a multiple of the update rate.
        """
        rate = RATE_HZ / sweep.case.algorithm.samples
        apart = np.mod(sweep.frequency - FREQUENCY_HZ + 0.5 * rate, rate) - 0.5 * rate
        return float(np.mean(sweep.z_deg[np.abs(apart) > 1e-6]))


def noise_rate_deg(response: GyroResponse, frequency: float) -> float:
    """Amplitude of the noise behind the gyro's filter.

    Parameters
    ----------
    frequency : float
        Hz.

    Returns
    -------
    float
        deg/s. Times ten seconds it is the error that noise at a multiple of the sampling rate
        ends in, with any algorithm that takes point rates.
    """
    turn = 2.0 * np.pi * frequency
    return float(np.degrees(NOISE_ANGLE * turn * response(frequency)))


def run_experiment(
    phase: Phase = "consistent",
    response: GyroResponse = DEFAULT_RESPONSE,
    algorithms: Sequence[str] = (),
    *,
    progress: Callable[[float], None] | None = None,
) -> Experiment:
    """Run the paper's experiment.

    Parameters
    ----------
    phase : {"consistent", "literal"}, optional
        Reading of eq. 20 that the figures are for, see :mod:`sinstool.simulation.coning_paper`.
        The other one is run as well.
    response : GyroResponse, optional
        Gyro that the figures are for. Table 1 is looked for with all of :data:`RESPONSES`.
    algorithms : sequence of str, optional
        More algorithms of the registry to run beside those the paper needs.
    progress : callable, optional
        Takes the fraction done.

    Raises
    ------
    ConfigurationError
        If an algorithm is unknown.
    """
    main = Setting(phase, response)
    cases = (*paper_cases(), *extra_cases(algorithms, response))
    few = tuple(case for case in cases if case.key in _TABLE_CASES)
    plan: dict[Setting, tuple[Case, ...]] = {main: cases}
    for other in PHASES:
        plan.setdefault(Setting(other, response), cases)
        for gyro in RESPONSES:
            plan.setdefault(Setting(other, gyro), few)
    frequency = np.arange(0.0, 1001.0)
    sweeps = run_sweeps(plan, frequency, progress=progress)
    costs = {case.key: measure_cost(case.algorithm) for case in cases}
    return Experiment(main, cases, frequency, sweeps, costs)


def measure_cost(algorithm: ConingAlgorithm) -> Cost:
    """Time an algorithm on this machine.

    Returns
    -------
    Cost
        The shortest of several runs: the others were disturbed.
    """
    random = np.random.default_rng(0)
    x = 1e-3 * random.standard_normal((_COST_ROWS + 1, 3))
    dt = np.full(len(x), 1.0 / RATE_HZ)
    count = _COST_ROWS // algorithm.samples
    times = []
    for _ in range(_COST_REPEATS):
        attitude = AttitudePropagator((1.0, 0.0, 0.0, 0.0))
        start = time.perf_counter()
        phi = algorithm.rotation_vectors(x, dt, 1, count)
        attitude.push(phi, dt[:count])
        times.append(time.perf_counter() - start)
    update = min(times) / count
    return Cost(update, update * RATE_HZ / algorithm.samples)
