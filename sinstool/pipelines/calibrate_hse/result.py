"""Result of a calibration of heading-sensitive error: ``--json``, terminal and page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from sinstool.config import ProcessConfig
from sinstool.core.arrays import FloatArray
from sinstool.core.errors import OutputError
from sinstool.core.finding import Finding, exit_status
from sinstool.core.result import as_json
from sinstool.core.units import DEGREE
from sinstool.core.whole_file import check_output, write_table, write_whole
from sinstool.methods.hse.calibration import HseCalibration
from sinstool.methods.hse.fit_result import HseFit
from sinstool.methods.hse.rig import Rig
from sinstool.methods.hse.run import HseRun
from sinstool.methods.hse.statistics import Column, ValidationTable
from sinstool.pipelines.calibrate_hse.calibration_file import to_dict
from sinstool.survey.rig import RigTurns

SCHEMA = "sinstool.calibrate-hse/1"


@dataclass(frozen=True)
class PositionSpread:
    """Headings of the runs in use at one position, less the mean corrected one.

    This needs no azimuth from outside, and cannot show what is wrong with the position as a
    whole.

    Attributes
    ----------
    position : int
        Number in the fit.
    heading : float
        Mean corrected heading, rad, in [0, 2 pi).
    before, after : ndarray, shape (n,)
        rad.
    """

    position: int
    heading: float
    ids: tuple[str, ...]
    before: FloatArray
    after: FloatArray

    @property
    def peak_to_peak(self) -> tuple[float, float]:
        """Before and after correction, rad."""
        return float(np.ptp(self.before)), float(np.ptp(self.after))


@dataclass(frozen=True)
class Calibration:
    """A calibration of one rig.

    Attributes
    ----------
    logs : tuple of RigTurns
        Of each log that could be used.
    file : HseCalibration
        As written.
    table : ValidationTable or None
        Headings before and after correction against azimuths of the stand; None without azimuths
        or without a coefficient.
    spread : tuple of PositionSpread
        Headings before and after correction within each position; empty without a coefficient.
    findings : tuple of Finding
        Of the rig, of the logs and of the fit.
    """

    rig: Rig
    logs: tuple[RigTurns, ...]
    runs: tuple[HseRun, ...]
    fit: HseFit
    file: HseCalibration
    table: ValidationTable | None
    spread: tuple[PositionSpread, ...]
    findings: tuple[Finding, ...]

    @property
    def exit_status(self) -> int:
        """0 done; 3 done, but something was lost, or the coefficient is not to be applied."""
        return exit_status(self.findings)

    @property
    def largest_spread(self) -> tuple[float, float] | None:
        """Largest peak to peak at one position, before and after, rad; None without repeats."""
        repeats = [one.peak_to_peak for one in self.spread if len(one.ids) > 1]
        if not repeats:
            return None
        before, after = zip(*repeats, strict=True)
        return max(before), max(after)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings in words."""
        return tuple(str(finding) for finding in self.findings)

    def to_json(self) -> dict[str, Any]:
        """The calibration as written, the table of headings, and the stretches not used."""
        values = {
            "validation": None if self.table is None else _table(self.table),
            "positions": [_position(one) for one in self.spread],
            "not_used": [
                {
                    "source": log.source,
                    "start_s": segment.start_s,
                    "duration_s": segment.duration_s,
                    "rate_deg_s": segment.rate / DEGREE,
                    "reason": segment.reason,
                }
                for log in self.logs
                for segment in log.segmentation.rejected
            ],
            "status": self.file.status,
            "findings": self.findings,
            "warnings": self.warnings,
        }
        return {"schema": SCHEMA, "calibration": to_dict(self.file), **as_json(values)}


def _position(spread: PositionSpread) -> dict[str, Any]:
    before, after = spread.peak_to_peak
    return {
        "position": spread.position,
        "heading_rad": spread.heading,
        "runs": spread.ids,
        "peak_to_peak_before_rad": before,
        "peak_to_peak_after_rad": after,
    }


def _table(table: ValidationTable) -> dict[str, Any]:
    columns = (table.ids, table.azimuth, table.before.values, table.after.values)
    names = ("id", "azimuth_rad", "before_rad", "after_rad")
    return {
        "position_azimuth_rad": table.position_azimuth,
        "rows": [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)],
        "before": _column(table.before),
        "after": _column(table.after),
    }


def _column(column: Column) -> dict[str, Any]:
    return {**as_json(column.scatter), "sinusoid": column.sinusoid}


def check_files(outputs: Sequence[Path | None], others: list[Path], overwrite: bool) -> None:
    """Refuse outputs that exist or are named twice, before anything is computed.

    Raises
    ------
    OutputError
    """
    taken = [p.resolve() for p in others]
    for path in outputs:
        if path is None:
            continue
        if path.resolve() in taken:
            raise OutputError(f"{path} is named twice", "choose another name")
        check_output(path, [], overwrite)
        taken.append(path.resolve())


def write_rig(path: Path, calibration: Calibration, config: ProcessConfig) -> None:
    """Write the rig as a configuration with the error along the axis removed from K_g.

    Parameters
    ----------
    config : ProcessConfig
        That of the calibration: its options for reading and for stretches are written, too,
        except those of the single logs.
    """
    check_output(path, [], config.output.overwrite)
    axial = calibration.fit.axial.c
    rig = calibration.rig.scaled(axial)
    options = config.model_dump(mode="json", exclude_defaults=True, exclude_none=True)
    general = {
        "input": _without(options.get("input", {}), "start", "end"),
        "calibration": _without(options.get("calibration", {}), "exclude", "azimuth"),
    }
    text = (
        "# The rig of which heading-sensitive error was calibrated, with its relative rate error\n"
        f"# along the axis, {axial:.6e}, taken out of K_g. A calibration that belongs\n"
        "# to the rig as it was does not belong to this one.\n\n"
    )
    tables = {name: table for name, table in general.items() if table}
    write_whole(path, text + tomli_w.dumps({**tables, "rig": rig.to_table()}))


def _without(table: dict[str, Any], *keys: str) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key not in keys}


def write_csv(path: Path, calibration: Calibration, overwrite: bool) -> None:
    """Write the runs as a table, angles in rad and rates in rad/s."""
    check_output(path, [], overwrite)
    rows = [asdict(record) for record in calibration.file.runs]
    write_table(path, list(rows[0]), [list(row.values()) for row in rows])
