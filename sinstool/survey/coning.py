"""The coning algorithm of a run, with the data that its options need from the log."""

from __future__ import annotations

from typing import Any

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.choices import log_choice
from sinstool.core.errors import DataError
from sinstool.core.timeline import SECOND, segments
from sinstool.io.readers.frames import turn_body
from sinstool.methods.coning.algorithm import ConingAlgorithm, of_rates
from sinstool.methods.coning.registry import algorithm
from sinstool.survey.source import Source, nominal_interval, rate_blocks

# Singular perturbation is tuned to the coning of the log's first part, of this length at most.
TUNING_S = 600.0


def choose_algorithm(source: Source, config: ProcessConfig) -> ConingAlgorithm:
    """The coning algorithm, with the data that its options need from the log."""
    settings, nominal_ns = config.coning, nominal_interval(source, config)
    options = settings.algorithm_options()
    if settings.coning == "gyro-tuned":
        options["interval"] = nominal_ns / SECOND
    if settings.sp_preset == "auto":
        options = _tuned(source, config, nominal_ns)
    if "beta" in options:
        options["beta"] = tuple(turn_body(np.array(options["beta"]), config.input.body_axes))
    chosen = algorithm(settings.coning, **options)
    if options:
        log_choice("coning", ", ".join(f"{name} {value}" for name, value in options.items()))
    return chosen


def coning_reason(chosen: ConingAlgorithm, config: ProcessConfig) -> str:
    """The reason for an algorithm, and its treatment of the samples."""
    kind = config.input.sample_kind
    default = type(config.coning).model_fields["coning"].default
    why = "the default" if config.coning.coning == default else "as configured"
    way = "made increments by a polynomial through six of them"
    if kind != "rate":
        way = "taken as increments"
    elif chosen.for_kind(of_rates(kind)).takes == "rates":
        way = "used as they are"
    return f"{why}: {chosen.summary}; gyro samples are {kind}, {way}"


def _tuned(source: Source, config: ProcessConfig, nominal_ns: float) -> dict[str, Any]:
    """Options of singular perturbation that null the drift of the log's own coning."""
    # scipy.signal takes longer to import than most logs to process
    from sinstool.methods.coning.sp_tuning import tune

    survey = source.survey
    blocks = rate_blocks(source, config, survey.first_ns)
    longest: list[np.ndarray] = []
    current: list[np.ndarray] = []
    for piece in segments(blocks, survey.max_gap_ns):
        current = [piece.imu.gyro] if piece.starts else [*current, piece.imu.gyro]
        if sum(map(len, current)) > sum(map(len, longest)):
            longest = current
        if piece.imu.time_ns[-1] - survey.first_ns > TUNING_S * SECOND:
            break
    try:
        chosen = tune(
            np.concatenate(longest),
            nominal_ns / SECOND,
            of_rates(config.input.sample_kind),
            passband=config.coning.passband,
        )
    except ValueError as exc:
        raise DataError(source.log.path, f"--sp-preset auto: {exc}") from exc
    return dict(chosen.options())
