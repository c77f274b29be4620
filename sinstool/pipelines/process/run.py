"""The whole way from a log to a solution, readable from top to bottom.

`process` opens the log, has it processed by the kind of run that is asked for, and returns what
a summary needs. The output appears when all of it is written.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from sinstool.config import ProcessConfig
from sinstool.core.choices import log_choice
from sinstool.core.errors import AlignmentError, TopicError
from sinstool.core.progress import Progress, share
from sinstool.io.readers import open_log
from sinstool.io.readers.log import Log
from sinstool.pipelines.process.attitude import run_attitude
from sinstool.pipelines.process.output import Result
from sinstool.survey.source import has_gnss

if TYPE_CHECKING:
    from sinstool.pipelines.process.sink import Sink


def process(
    path: Path,
    output: Path,
    config: ProcessConfig,
    progress: Progress | None = None,
    recorder: Sink | None = None,
) -> dict[str, Any]:
    """Recorded IMU to corrected attitude.

    Parameters
    ----------
    path : Path
        The log.
    output : Path
        MCAP to write; appears when complete.
    progress : callable, optional
        Called with the fraction done.
    recorder : Sink, optional
        Collects what the page of figures shows.

    Returns
    -------
    dict
        The summary: the keys of ``--json``.

    Raises
    ------
    SinstoolError
        With one line that says what was wrong and what to do; no output is left behind.
    """
    # What a kind of run needs is imported when it runs: together it takes longer to import than
    # most logs to process.
    with (
        open_log(path, config.input.salvage) as log,
        Result(log, output, config, recorder) as result,
    ):
        log_choice("log", f"{path}, {log.format}, {log.size / 1e6:.1f} MB")
        if config.hse.hse is not None:
            log_choice("mode", "turntable, as --hse is given: whole turns are aligned on")
            from sinstool.pipelines.process.turntable import rig_run

            told = rig_run(log, config, result, share(progress, log.size, 0.0, 1.0))
        elif config.navigation.mode == "ins-gnss":
            log_choice("mode", "ins-gnss, as told")
            from sinstool.pipelines.process.ins_gnss.mode import run_ins_gnss

            told = run_ins_gnss(log, config, result, progress)
        elif config.navigation.mode == "auto" and has_gnss(log, config.input):
            log_choice("mode", "auto, and the log has fixes and GNSS velocity: ins-gnss is tried")
            told = _best(log, config, result, progress)
        elif config.navigation.mode == "ins":
            log_choice("mode", "ins, as told")
            from sinstool.pipelines.process.ins import run_ins

            told = run_ins(log, config, result, progress)
        else:
            told_so = config.navigation.mode == "attitude"
            log_choice(
                "mode",
                "attitude, as told"
                if told_so
                else "attitude, as the log has not both fixes and GNSS velocity on one topic each",
            )
            told = run_attitude(log, config, result, progress)
    if progress:
        progress(1.0)
    return told


def _best(
    log: Log, config: ProcessConfig, result: Result, progress: Progress | None
) -> dict[str, Any]:
    """INS/GNSS where a start can be found; attitude alone, and why, where it cannot."""
    from sinstool.pipelines.process.ins_gnss.mode import run_ins_gnss

    why: Exception | str = "only stamps tell which fix belongs to which sample, not --imu-rate"
    if config.input.imu_rate is None:
        try:
            return run_ins_gnss(log, config, result, progress)
        except (AlignmentError, TopicError) as exc:
            if result.opened:
                raise
            why = exc
    log_choice("mode", f"attitude after all: {why}")
    told = run_attitude(log, config, result, progress)
    told["warnings"].append(f"attitude alone, as no INS/GNSS solution can be started: {why}")
    return told
