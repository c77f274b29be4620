"""The whole way from a log to a solution, readable from top to bottom.

`process` opens the log, surveys it, refuses what would go wrong, aligns, streams attitude into
the output beside the input's own messages, and returns what a summary needs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sinstool import summary
from sinstool.alignment import initial
from sinstool.alignment.initial import Alignment
from sinstool.attitude import AttitudeRun, AttitudeSettings
from sinstool.config import ProcessConfig
from sinstool.coning.algorithm import ConingAlgorithm
from sinstool.coning.registry import algorithm
from sinstool.earth import earth_rate_n
from sinstool.errors import AlignmentError, DataError
from sinstool.readers import open_log
from sinstool.readers.frames import turn_body
from sinstool.readers.log import Log
from sinstool.readers.streams import frame_id
from sinstool.result import Result, choose_emits
from sinstool.rig_run import rig_run
from sinstool.source import Source, imu_blocks, prepare
from sinstool.timeline import SECOND, mean_rates, segments
from sinstool.units import DEGREE
from sinstool.writers.topics import Frames

# Singular perturbation is tuned to the coning of the log's first part, of this length at most.
TUNING_S = 600.0
Progress = Callable[[float], None]


def process(
    path: Path, output: Path, config: ProcessConfig, progress: Progress | None = None
) -> dict[str, Any]:
    """Recorded IMU to corrected attitude.

    Parameters
    ----------
    path : Path
        The log.
    output : Path
        MCAP to write; appears when complete.
    config : ProcessConfig
    progress : callable, optional
        Called with the fraction done.

    Returns
    -------
    dict
        The summary: the keys of ``--json``.

    Raises
    ------
    SinstoolError
        With one line that says what was wrong and what to do; no output is left behind.
    """
    with open_log(path, config.input.salvage) as log, Result(log, output, config) as result:
        if config.hse.hse is not None:
            told = rig_run(log, config, result, _share(progress, log.size, 0.0, 1.0))
        else:
            told = _attitude(log, config, result, progress)
    if progress:
        progress(1.0)
    return told


def _attitude(
    log: Log, config: ProcessConfig, result: Result, progress: Progress | None
) -> dict[str, Any]:
    """Attitude alone."""
    source = prepare(log, config, _share(progress, log.size, 0.0))
    body = frame_id(log, source.topic.channels, source.topic.path) or "imu_link"
    emits, warnings = choose_emits(log, config, ("imu", "attitude"), body)
    alignment = align(source, config)
    settings = _settings(source, alignment, config)
    run = AttitudeRun(alignment.q_nb, settings)
    frames = _frames(source, alignment, config, body)
    result.open(source.topic.channels[0].message_encoding, emits, frames)
    blocks = imu_blocks(source, config, alignment.time_ns, _share(progress, log.size, 0.5))
    for solution in run.run(blocks):
        result.push(solution)
    told = result.finish()
    assert result.last is not None
    return {
        **told,
        "imu": summary.imu(source),
        "alignment": summary.alignment(alignment),
        "coning": summary.coning(settings, run),
        "hse": None,
        "height": None,
        "filter": None,
        "final": summary.final(result.last, source),
        "lost": summary.lost(source),
        "warnings": [
            *source.warnings,
            *alignment.warnings,
            *warnings,
            *summary.run_warnings(source, run),
        ],
    }


def align(source: Source, config: ProcessConfig) -> Alignment:
    """First attitude and gyro bias.

    Raises
    ------
    AlignmentError
        What was asked for cannot be had from this log.
    """
    options, found = config.align, source.survey
    path = source.log.path
    if options.align == "fixed":
        assert options.initial_attitude is not None
        roll, pitch, heading = (v * DEGREE for v in options.initial_attitude)
        alignment = initial.from_given((roll, pitch, heading), found.first_ns)
    elif options.align == "log":
        if found.orientation is None:
            raise AlignmentError(
                f"{path}: topic {found.topic} holds no orientation",
                "use --align level or --align fixed",
            )
        alignment = initial.from_log(found.orientation, found.orientation_ns)
    elif found.lead_in is not None:
        alignment = initial.from_still(found.lead_in, found.first_ns)
    elif options.align == "level":
        raise AlignmentError(
            f"{path}: the log does not begin still, so its tilt cannot be levelled",
            "choose a still beginning with --start, or use --align log, fixed or auto",
        )
    elif found.orientation is not None and not found.orientation_constant:
        alignment = initial.from_log(found.orientation, found.orientation_ns)
    else:
        alignment = initial.from_motion(found.windows, found.first_ns)
    return _with_bias(alignment, source, config)


def _with_bias(alignment: Alignment, source: Source, config: ProcessConfig) -> Alignment:
    wanted = config.align.gyro_bias
    if wanted == "none":
        return alignment
    if not isinstance(wanted, str):
        bias = turn_body(np.array(wanted), config.input.body_axes)
        return replace(alignment, gyro_bias=bias, bias_source="given")
    still = source.survey.lead_in
    if still is None:
        note = "the log does not begin still, so no gyro bias is removed"
        return replace(alignment, warnings=(*alignment.warnings, note))
    bias = initial.still_bias(still, alignment.q_nb, _earth_rate(source))
    return replace(alignment, gyro_bias=bias, bias_source="still")


def _earth_rate(source: Source) -> np.ndarray | None:
    if source.latitude is None:
        return None
    return np.asarray(earth_rate_n(source.latitude))


def _settings(source: Source, alignment: Alignment, config: ProcessConfig) -> AttitudeSettings:
    rate = config.input.imu_rate
    nominal = (source.survey.interval_ns if rate is None else SECOND / rate) or SECOND
    still = source.survey.lead_in if alignment.bias_source == "still" else None
    return AttitudeSettings(
        _algorithm(source, config, nominal),
        config.input.gyro_kind,
        nominal,
        source.survey.max_gap_ns,
        alignment.gyro_bias,
        _earth_rate(source),
        rate,
        None if still is None else still.end_ns,
    )


def _algorithm(source: Source, config: ProcessConfig, nominal_ns: float) -> ConingAlgorithm:
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
    blocks = imu_blocks(source, config, found.first_ns)
    if config.input.gyro_kind == "increment":
        blocks = mean_rates(blocks, nominal_ns, found.max_gap_ns)
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


def _frames(source: Source, alignment: Alignment, config: ProcessConfig, body: str) -> Frames:
    referenced = alignment.north_referenced and source.latitude is not None
    return Frames(
        config.output.world,
        "map" if referenced else "odom",
        body,
        config.input.body_axes,
    )


def _share(
    progress: Progress | None, size: int, begin: float, part: float = 0.5
) -> Callable[[int], None] | None:
    """Progress of one pass over the log, in bytes of it."""
    if progress is None:
        return None
    return lambda position: progress(begin + part * min(1.0, position / max(size, 1)))
