"""One log of `sinstool process`: the run and its page, alone or among many."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sinstool.config import ProcessConfig

if TYPE_CHECKING:
    from sinstool.core.progress import Progress
    from sinstool.pipelines.process.result import ProcessResult
    from sinstool.report.recorder import Recorder


def process_one(
    log: Path,
    output: Path,
    report: Path | None,
    config: ProcessConfig,
    progress: Progress | None,
) -> ProcessResult:
    """Process a log, and write its page where one is asked for.

    Parameters
    ----------
    report : Path or None
        The page.
    progress : callable, optional
        Called with the fraction done.

    Raises
    ------
    SinstoolError
    """
    from sinstool.core.whole_file import commit_together
    from sinstool.pipelines.process.run import process

    recorder = _recorder(log, report, config)
    with commit_together():
        result = process(log, output, config, progress, recorder)
        if recorder is not None and config.output.truth:
            result = replace(result, truth=recorder.errors())
        if report is not None and recorder is not None:
            from sinstool.report.pages.process import write_page

            write_page(report, recorder, result, config)
    return result


def process_unless_done(
    log: Path,
    output: Path,
    report: Path | None,
    config: ProcessConfig,
    progress: Progress | None,
) -> dict[str, Any]:
    """One of many: as :func:`process_one`, unless its output is there and would be the same.

    Returns
    -------
    dict
        The values of ``--json`` with ``status`` and ``exit``; of an output that is there already
        only ``input`` and ``output``.

    Raises
    ------
    SinstoolError
        Also where another file has the output's name.
    """
    if output.exists() and not config.output.overwrite:
        from sinstool.pipelines.provenance import require_same

        record = require_same(output, log, config)
        if report is None or report.exists():
            size, digest = int(record["input_size"]), record["input_sha256"]
            return {
                "input": {"path": str(log), "size": size, "sha256": digest},
                "output": {"path": str(output)},
                "status": "complete",
                "exit": 3 if record.get("status") == "lost" else 0,
            }
        # Only the page is missing: the output is made again with it, as it was.
        again = config.output.model_copy(update={"overwrite": True})
        config = config.model_copy(update={"output": again})
    if report is not None:
        from sinstool.report.page import check_report

        check_report(report, inputs=[log], overwrite=config.output.overwrite)
    result = process_one(log, output, report, config, progress)
    status = result.exit_status
    return {**result.to_json(), "status": "lost" if status else "done", "exit": status}


def _recorder(log: Path, report: Path | None, config: ProcessConfig) -> Recorder | None:
    """What collects figures and errors, where either is asked for."""
    if report is None and not config.output.truth:
        return None
    from sinstool.io.readers import open_log
    from sinstool.pipelines.process.errors_against_truth import read_references
    from sinstool.report.recorder import Recorder

    if not config.output.truth:
        return Recorder()
    with open_log(log, config.input.salvage) as opened:
        return Recorder(read_references(opened, config.output.truth, config.input.body_axes))
