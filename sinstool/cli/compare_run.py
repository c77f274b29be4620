"""Comparisons of coning algorithms carried out, with the tables and pages beside them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sinstool.config import ProcessConfig
from sinstool.core.whole_file import commit_together
from sinstool.pipelines.compare_coning.log import compare_log
from sinstool.pipelines.compare_coning.summary import ComparisonResult, summarise
from sinstool.report.figures.coning import figures
from sinstool.report.page import check_report, write_report
from sinstool.report.pages.compare_coning import comparison_page
from sinstool.report.text.coning import write_csv

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Outputs:
    """What is written of a comparison.

    Attributes
    ----------
    csv : Path or None
        Folder of tables.
    page : Path or None
        Page of figures, or one figure.
    overwrite : bool
        Whether a page may be replaced.
    """

    csv: Path | None = None
    page: Path | None = None
    overwrite: bool = False

    def check_page(self, *logs: Path) -> None:
        """Refuse a page that could not be written, before anything is computed."""
        if self.page is not None:
            check_report(self.page, inputs=logs, overwrite=self.overwrite)


def compare_one(
    log: Path, config: ProcessConfig, outputs: Outputs, progress: Progress | None
) -> ComparisonResult:
    """Compare on a log, and write what belongs to it, all or nothing.

    Raises
    ------
    SinstoolError
    """
    outputs.check_page(log)
    comparison = compare_log(log, config, progress)
    result = summarise(comparison)
    with commit_together():
        if outputs.csv is not None:
            write_csv(outputs.csv, result)
        if outputs.page is not None:
            page = comparison_page(log, figures(comparison), config, result)
            write_report(outputs.page, page, overwrite=outputs.overwrite)
    return result


def compare_one_of_many(
    log: Path, config: ProcessConfig, outputs: Outputs, progress: Progress
) -> dict[str, Any]:
    """One of many: the values of ``--json`` with ``status`` and ``exit``.

    Raises
    ------
    SinstoolError
    """
    result = compare_one(log, config, outputs, progress)
    status = {"status": "lost", "exit": 3} if result.lost else {"status": "done", "exit": 0}
    return {**result.to_json(), **status}
