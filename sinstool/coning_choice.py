"""The coning algorithm of a run, with what its options need to know of the log."""

from __future__ import annotations

from typing import Any

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.coning.algorithm import ConingAlgorithm
from sinstool.coning.registry import algorithm
from sinstool.errors import DataError
from sinstool.readers.frames import turn_body
from sinstool.source import Source, rate_blocks
from sinstool.timeline import SECOND, segments

# Singular perturbation is tuned to the coning of the log's first part, of this length at most.
TUNING_S = 600.0


def choose_algorithm(source: Source, config: ProcessConfig, nominal_ns: float) -> ConingAlgorithm:
    """The coning algorithm, with what its options need to know of the log."""
    told = config.coning
    options = told.algorithm_options()
    if told.coning == "gyro-tuned":
        options["interval"] = nominal_ns / SECOND
    if told.sp_preset == "auto":
        options = _tuned(source, config, nominal_ns)
    if "beta" in options:
        options["beta"] = tuple(turn_body(np.array(options["beta"]), config.input.body_axes))
    return algorithm(told.coning, **options)


def _tuned(source: Source, config: ProcessConfig, nominal_ns: float) -> dict[str, Any]:
    """Options of singular perturbation that null the drift of the log's own coning."""
    # scipy.signal takes longer to import than most logs to process
    from sinstool.coning.sp_tuning import tune

    found = source.survey
    blocks = rate_blocks(source, config, found.first_ns, nominal_ns)
    longest: list[np.ndarray] = []
    current: list[np.ndarray] = []
    for piece in segments(blocks, found.max_gap_ns):
        current = [piece.imu.gyro] if piece.starts else [*current, piece.imu.gyro]
        if sum(map(len, current)) > sum(map(len, longest)):
            longest = current
        if piece.imu.time_ns[-1] - found.first_ns > TUNING_S * SECOND:
            break
    kind = "rate" if config.input.gyro_kind == "rate" else "mean-rate"
    try:
        chosen = tune(
            np.concatenate(longest),
            nominal_ns / SECOND,
            kind,  # type: ignore[arg-type]
            passband=config.coning.passband,
        )
    except ValueError as exc:
        raise DataError(source.log.path, f"--sp-preset auto: {exc}") from exc
    return dict(chosen.options())
