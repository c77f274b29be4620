"""`--mode ins-gnss`: inertial navigation corrected by GNSS, filtered or smoothed."""

from __future__ import annotations

from typing import Any

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.errors import AlignmentError
from sinstool.core.progress import Progress, share
from sinstool.core.rotation import to_euler
from sinstool.core.units import DEGREE
from sinstool.io.readers.log import Log
from sinstool.io.readers.streams import frame_id
from sinstool.io.writers.topics import Frames
from sinstool.methods.height.layout import ACCEPTED
from sinstool.pipelines import summary
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.run import DIAGNOSTIC_NAMES, FilterRun
from sinstool.pipelines.process.ins_gnss.start import prepare_filter
from sinstool.pipelines.process.output import Result, choose_emits
from sinstool.survey.source import prepare


def run_ins_gnss(
    log: Log, config: ProcessConfig, result: Result, progress: Progress | None
) -> dict[str, Any]:
    """INS/GNSS integration.

    Parameters
    ----------
    progress : callable, optional
        Called with the fraction done.

    Returns
    -------
    dict
        The summary.

    Raises
    ------
    SinstoolError
    """
    source = prepare(log, config, share(progress, log.size, 0.0, 0.4), whole_gnss=True)
    prepared = prepare_filter(source, config)
    body = frame_id(log, source.topic.channels, source.topic.path) or "imu_link"
    known = ["imu", "attitude", "odometry", "fix", "tf", "diagnostics"]
    if prepared.reference is not None:
        known.append("height")
    emits, left_out = choose_emits(log, config, known, body)
    nav = prepared.start.nav
    frames = Frames(
        config.output.world,
        "map",
        body,
        config.input.body_axes,
        (float(nav[0]), float(nav[1]), float(nav[2])),
    )
    result.open(source.topic.channels[0].message_encoding, emits, frames, DIAGNOSTIC_NAMES)
    recorder, r = result.recorder, prepared.reference
    if recorder is not None and r is not None:
        good = r.reason == ACCEPTED
        recorder.refer_height(r.topic, r.time_ns[good], r.height[good])
    gnss = source.aiding.gnss
    if recorder is not None and gnss is not None:
        recorder.refer_track(gnss.latitude, gnss.longitude)
    run = FilterRun(source, config, prepared, detailed=recorder is not None)
    for solution in run.solutions(share(progress, log.size, 0.4, 0.5)):
        result.push(solution)
        for diagnostics in run.new_diagnostics():
            result.note(diagnostics)
    if recorder is not None:
        recorder.refer_filter(run)
    told = result.finish(lambda: summary.incomplete(summary.lost(source)))
    if result.last is None:
        raise AlignmentError(
            f"{log.path}: not one Imu sample lies after the filter's start",
            "check --start and --end, and the clocks of Imu and GNSS",
        )
    if progress is not None:
        progress(1.0)
    return {
        **told,
        "imu": summary.imu(source),
        "alignment": _alignment(prepared),
        "coning": summary.coning(run.algorithm, config.input.gyro_kind, run.updates),
        "hse": None,
        "height": run.height(result.last),
        "filter": run.summary(),
        "final": summary.final(result.last, source),
        "lost": summary.lost(source),
        "warnings": [
            *source.warnings,
            *prepared.warnings,
            *left_out,
            *run.warnings(),
        ],
    }


def _alignment(prepared: FilterStart) -> dict[str, Any]:
    """``alignment`` of the summary: the filter's start."""
    start = prepared.start
    roll, pitch, heading = (float(v) for v in to_euler(start.nav[6:10]) / DEGREE)
    sigma = np.sqrt(np.diag(start.covariance_attitude_n)) / DEGREE
    return {
        "method": "filter-start",
        "how": prepared.how,
        "time_ns": str(prepared.time_ns),
        "roll_deg": roll,
        "pitch_deg": pitch,
        "heading_deg": heading,
        "sigma_deg": sigma.tolist(),
        "status": "ok" if sigma[2] < 5.0 else "degraded",
        "north_referenced": True,
        "gyro_bias_rad_s": start.gyro_bias.tolist(),
        "gyro_bias_source": "start",
    }
