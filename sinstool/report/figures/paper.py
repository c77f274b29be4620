"""The paper's figures as data for the report."""

from __future__ import annotations

from typing import Any

import numpy as np

from sinstool.pipelines.compare_coning.paper import settings_with_means
from sinstool.pipelines.compare_coning.paper_cases import LARGE_EPSILON, paper_cases
from sinstool.pipelines.compare_coning.paper_claims import SP_PAPER
from sinstool.pipelines.compare_coning.paper_experiment import RESPONSES, Experiment
from sinstool.report.figure import Figure, FloatArray, Series
from sinstool.report.figures.parts import positive
from sinstool.simulation.coning_paper import RATE_HZ, response_name

SWITCH_HZ = 10.0  # how near to a multiple of the sampling rate counts as "near"

_NOISE = "frequency of the noise, Hz"


def figures(experiment: Experiment) -> tuple[Figure, ...]:
    """Figures 1, 4, 6, 7, 8, 9 and table 1 of the paper, ours with the printed levels."""
    return (
        _responses(experiment),
        _figure_4(experiment),
        _figure_6(experiment),
        _figure_7(experiment),
        _figure_8(experiment),
        _figure_9(experiment),
        _table_1(experiment),
    )


def as_the_paper_switches(experiment: Experiment) -> FloatArray:
    """Error of the SP algorithm as printed, with epsilon 0.032 s near the sampling rate.

    Returns
    -------
    ndarray, shape (m,)
        Length of the error at the end, deg. The paper does not say how near; here
        :data:`SWITCH_HZ`.
    """
    off = np.abs(np.mod(experiment.frequency + 0.5 * RATE_HZ, RATE_HZ) - 0.5 * RATE_HZ)
    near = (off <= SWITCH_HZ) & (experiment.frequency > 0.5 * RATE_HZ)
    usual, large = experiment.sweep(SP_PAPER), experiment.sweep("sp-0.032-printed")
    return np.where(near, large.norm_deg, usual.norm_deg)


def _swept(
    experiment: Experiment, number: int, title: str, series: tuple[Series, ...], **options: Any
) -> Figure:
    """Error at the end against the frequency of the noise."""
    return Figure(
        f"paper-figure-{number}",
        f"{title} (Fig. {number})",
        experiment.frequency,
        series,
        _NOISE,
        "error after 10 s, deg",
        log_y=True,
        marks=(("400 Hz", RATE_HZ), ("800 Hz", 2.0 * RATE_HZ)),
        **options,
    )


def _length(experiment: Experiment, key: str, shown: bool = True) -> Series:
    sweep = experiment.sweep(key)
    return Series(sweep.case.label, positive(sweep.norm_deg), shown=shown)


def _others(experiment: Experiment) -> list[Series]:
    """The algorithms of ``--algorithms`` that are not the paper's."""
    paper_keys = {case.key for case in paper_cases()}
    return [
        _length(experiment, case.key) for case in experiment.cases if case.key not in paper_keys
    ]


def _responses(experiment: Experiment) -> Figure:
    f = np.linspace(0.0, 1000.0, 2001)
    chosen = experiment.setting.gyro
    responses = {response_name(one): one for one in (experiment.setting.response, *RESPONSES)}
    series = tuple(
        Series(name, 20.0 * np.log10(one(f)), shown=name in (chosen, "cheb:7", "butter:9"))
        for name, one in responses.items()
    )
    return Figure(
        "paper-figure-1",
        "Gain of the gyro (Fig. 1)",
        f,
        series,
        "frequency, Hz",
        "gain, dB",
        y_range=(-80.0, 3.0),
        notes=(f"The figures below are for {chosen}.",),
    )


def _figure_4(experiment: Experiment) -> Figure:
    keys = ("rect-opt4", "inc-optimal-4")
    return _swept(
        experiment,
        4,
        "optimal-4 against the frequency of the noise",
        (*(_length(experiment, key) for key in keys), *_others(experiment)),
        notes=(
            "At 400 and 800 Hz sampled noise is a constant rate. With true increments, from an"
            " integrating gyro or from faster sampling, the error disappears.",
        ),
        levels=(("printed at 400 Hz: 0.35 deg", 0.35),),
    )


def _figure_6(experiment: Experiment) -> Figure:
    keys = ("rect", "rect-100", "sp-0.032-alpha")
    return _swept(
        experiment,
        6,
        "No compensation",
        tuple(_length(experiment, key) for key in keys),
        notes=(
            f"With epsilon = {LARGE_EPSILON} s the first part of the SP rotation vector alone"
            " gives the printed 5.5 deg, at any frequency of noise.",
        ),
        levels=(("printed: 2.2 deg", 2.2), ("printed at 400 and 800 Hz: 5.5 deg", 5.5)),
    )


def _figure_7(experiment: Experiment) -> Figure:
    switched = positive(as_the_paper_switches(experiment))
    return _swept(
        experiment,
        7,
        "optimal-4 and SP",
        (
            _length(experiment, "rect-opt4"),
            Series("SP as printed, epsilon switched", switched),
            _length(experiment, SP_PAPER),
            _length(experiment, "sp-best", shown=False),
            _length(experiment, "inc-previous-3", shown=False),
        ),
        notes=(
            f"Switched: epsilon = {LARGE_EPSILON} s within {SWITCH_HZ:g} Hz of the sampling rate"
            " and twice that; the paper does not say how near.",
        ),
        levels=(("printed for optimal-4: 0.4 deg", 0.4), ("printed for SP: 0.2 deg", 0.2)),
    )


def _figure_8(experiment: Experiment) -> Figure:
    hidden = ("rect", "sp-best", "inc-optimal-4", "inc-previous-3", "int-previous-3")
    series = [
        Series(experiment.sweep(key).case.label, experiment.sweep(key).z_deg, shown=shown)
        for keys, shown in ((("rect-opt4", SP_PAPER, "sp-paper-truncated"), True), (hidden, False))
        for key in keys
    ]
    return Figure(
        "paper-figure-8",
        "Low frequencies (Fig. 8)",
        experiment.frequency,
        tuple(series),
        _NOISE,
        "signed z error after 10 s, deg",
        x_range=(0.0, 250.0),
        y_range=(-0.05, 0.02),
        levels=(("printed level, optimal-4", -0.01), ("printed level, SP", -0.005)),
        marks=(("motion", 30.0), ("bandwidth", 200.0)),
        notes=(
            "Noise of the motion's own frequency adds to the cone. optimal-4 updates at 100 Hz,"
            " so noise at 130 and 230 Hz aliases onto the motion as well; algorithms"
            " with an update per sample have no such jumps.",
        ),
    )


def _figure_9(experiment: Experiment) -> Figure:
    keys = ("rect-opt4", SP_PAPER, "sp-0.032-printed", "sp-0.032-exact", "sp-best")
    return _swept(
        experiment,
        9,
        "About the sampling rate",
        (
            *(_length(experiment, key) for key in keys),
            _length(experiment, "inc-optimal-4"),
            _length(experiment, "inc-previous-3", shown=False),
            *_others(experiment),
        ),
        x_range=(380.0, 420.0),
        levels=(("printed for optimal-4: 0.4 deg", 0.4), ("printed for SP: 0.2 deg", 0.2)),
        notes=("The peak is one step of frequency wide: 1 Hz off, the constant rate turns.",),
    )


def _table_1(experiment: Experiment) -> Figure:
    settings = experiment.settings
    keys = ("rect-opt4", SP_PAPER, "sp-paper-truncated", "inc-optimal-4")
    series = tuple(
        Series(
            experiment.sweep(key).case.label,
            np.array([experiment.sweep(key, one).mean_deg for one in settings]),
            style="bars",
        )
        for key in keys
    )
    return Figure(
        "paper-table-1",
        "Mean error over all frequencies (table 1)",
        tuple(one.name for one in settings),
        series,
        "reading of eq. 20, gyro",
        "mean of the signed z error, deg",
        y_range=(-0.015, 0.015),
        levels=(("printed for optimal-4", -0.0038), ("printed for SP", -0.0024)),
        notes=("No setting gives both printed means.",) if _none_gives_both(experiment) else (),
    )


def _none_gives_both(experiment: Experiment) -> bool:
    opt4, sp = settings_with_means(experiment)
    return not opt4 & sp
