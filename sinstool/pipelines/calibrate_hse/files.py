"""What a calibration leaves beside its JSON file: a rig without the error, a table, a summary."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import tomli_w

from sinstool.config import ProcessConfig
from sinstool.core.errors import OutputError
from sinstool.core.whole_file import check_output, write_whole
from sinstool.methods.hse.table import Column, ValidationTable
from sinstool.pipelines.calibrate_hse.calibration_file import to_dict
from sinstool.pipelines.calibrate_hse.run import Calibration


def check_files(wanted: Sequence[Path | None], taken: list[Path], overwrite: bool) -> None:
    """Refuse outputs that exist or are named twice, before anything is computed.

    Raises
    ------
    OutputError
    """
    known = [p.resolve() for p in taken]
    for path in wanted:
        if path is None:
            continue
        if path.resolve() in known:
            raise OutputError(f"{path} is named twice", "choose another name")
        check_output(path, [], overwrite)
        known.append(path.resolve())


def write_rig(path: Path, found: Calibration, config: ProcessConfig) -> None:
    """Write the rig as a configuration in which the error along the axis is taken out of K_g.

    Parameters
    ----------
    config : ProcessConfig
        That of the calibration: what it says of reading and of stretches goes along, but for
        what concerns the single logs.
    """
    check_output(path, [], config.output.overwrite)
    rig = found.rig.scaled(found.fit.axial.c)
    told = config.model_dump(mode="json", exclude_defaults=True, exclude_none=True)
    kept = {
        "input": _without(told.get("input", {}), "start", "end"),
        "calibration": _without(told.get("calibration", {}), "exclude", "azimuth"),
    }
    text = (
        "# The rig of which heading-sensitive error was calibrated, with its relative rate error\n"
        f"# along the axis, {found.fit.axial.c:.6e}, taken out of K_g. A calibration that belongs\n"
        "# to the rig as it was does not belong to this one.\n\n"
    )
    tables = {name: table for name, table in kept.items() if table}
    write_whole(path, text + tomli_w.dumps({**tables, "rig": rig.to_table()}))


def _without(table: dict[str, Any], *keys: str) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key not in keys}


def write_csv(path: Path, found: Calibration, overwrite: bool) -> None:
    """Write the runs as a table, angles in rad and rates in rad/s."""
    check_output(path, [], overwrite)
    rows = [asdict(record) for record in found.kept.runs]
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_whole(path, buffer.getvalue())


def summary(found: Calibration) -> dict[str, Any]:
    """The calibration as it was written, the table of headings, and what was not used."""
    return {
        "calibration": to_dict(found.kept),
        "validation": None if found.table is None else _table(found.table),
        "positions": [
            {
                "position": one.position,
                "heading_rad": one.heading,
                "runs": list(one.ids),
                "peak_to_peak_before_rad": one.peak_to_peak[0],
                "peak_to_peak_after_rad": one.peak_to_peak[1],
            }
            for one in found.spread
        ],
        "not_used": [
            {
                "source": log.source,
                "start_s": segment.start_s,
                "duration_s": segment.duration_s,
                "rate_rad_s": segment.rate,
                "reason": segment.reason,
            }
            for log in found.logs
            for segment in log.segmentation.rejected
        ],
        "status": found.kept.status,
        "warnings": [*found.warnings, *found.judgement.warnings],
    }


def _table(table: ValidationTable) -> dict[str, Any]:
    return {
        "position_azimuth_rad": table.position_azimuth.tolist(),
        "rows": [
            {"id": name, "azimuth_rad": a, "before_rad": b, "after_rad": c}
            for name, a, b, c in zip(
                table.ids,
                table.azimuth.tolist(),
                table.before.values.tolist(),
                table.after.values.tolist(),
                strict=True,
            )
        ],
        "before": _column(table.before),
        "after": _column(table.after),
    }


def _column(column: Column) -> dict[str, Any]:
    scatter = asdict(column.scatter)
    scatter["means"] = column.scatter.means.tolist()
    return {
        **scatter,
        "sinusoid": None if column.sinusoid is None else asdict(column.sinusoid),
    }
