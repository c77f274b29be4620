"""`--mode attitude`: recorded IMU to corrected attitude."""

from __future__ import annotations

from typing import Any

from sinstool.config import ProcessConfig
from sinstool.core.progress import Progress, share
from sinstool.io.readers.log import Log
from sinstool.io.readers.streams import frame_id
from sinstool.methods.alignment.initial import Alignment
from sinstool.methods.strapdown.attitude_run import AttitudeRun, AttitudeSettings
from sinstool.pipelines import summary
from sinstool.pipelines.align.first_attitude import align, earth_rate, needs_gnss
from sinstool.pipelines.process.common import odometry_frames, require_gravity
from sinstool.pipelines.process.output import Result, choose_emits
from sinstool.survey.coning import choose_algorithm
from sinstool.survey.interval import nominal_interval
from sinstool.survey.source import Source, imu_blocks, prepare


def run_attitude(
    log: Log, config: ProcessConfig, result: Result, progress: Progress | None
) -> dict[str, Any]:
    """Attitude alone, and height where it is damped.

    Parameters
    ----------
    progress : callable, optional
        Called with the fraction done.

    Returns
    -------
    dict
        The summary.
    """
    damped = config.vertical.height_damping != "off"
    source = prepare(log, config, share(progress, log.size, 0.0), damped or needs_gnss(log, config))
    if damped:
        require_gravity(source, config)
    body = frame_id(log, source.topic.channels, source.topic.path) or "imu_link"
    alignment = align(source, config)
    vertical = None
    if damped:
        from sinstool.pipelines.process.vertical_channel import Vertical

        vertical = Vertical(source, config)
    if vertical is not None and result.recorder is not None:
        vertical.show(result.recorder)
    known = ("imu", "attitude") if vertical is None else ("imu", "attitude", "height")
    emits, warnings = choose_emits(log, config, known, body)
    settings = _settings(source, alignment, config)
    run = AttitudeRun(alignment.q_nb, settings)
    frames = odometry_frames(source, alignment, config, body)
    result.open(source.topic.channels[0].message_encoding, emits, frames)
    blocks = imu_blocks(source, config, alignment.time_ns, share(progress, log.size, 0.5))
    for solution in run.run(blocks):
        result.push(solution if vertical is None else vertical.push(solution))
    told = result.finish(lambda: summary.incomplete(summary.lost(source)))
    assert result.last is not None
    return {
        **told,
        "imu": summary.imu(source),
        "alignment": summary.alignment(alignment),
        "coning": summary.coning(settings.algorithm, settings.gyro_kind, run.updates),
        "hse": None,
        "height": None if vertical is None else vertical.summary(),
        "filter": None,
        "final": summary.final(result.last, source),
        "lost": summary.lost(source),
        "warnings": [
            *source.warnings,
            *alignment.warnings,
            *warnings,
            *(vertical.warnings() if vertical is not None else ()),
            *summary.run_warnings(source, run),
        ],
    }


def _settings(source: Source, alignment: Alignment, config: ProcessConfig) -> AttitudeSettings:
    nominal = nominal_interval(source, config)
    still = source.survey.lead_in if alignment.bias_source == "still" else None
    return AttitudeSettings(
        algorithm=choose_algorithm(source, config, nominal),
        gyro_kind=config.input.gyro_kind,
        nominal_ns=nominal,
        max_gap_ns=source.survey.max_gap_ns,
        gyro_bias=alignment.gyro_bias,
        sample_rate=config.input.imu_rate,
        still_until_ns=None if still is None else still.end_ns,
        omega_ie_n=earth_rate(source),
    )
