"""What a calibration leaves beside its JSON file: a rig without the error, a table, a summary."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import tomli_w

from sinstool.calibrate import Calibration
from sinstool.errors import OutputError
from sinstool.hse.calibration_file import to_dict
from sinstool.hse.table import Column, ValidationTable
from sinstool.writers.whole import WholeFile, check_output


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


def write_rig(path: Path, found: Calibration, overwrite: bool) -> None:
    """Write the rig as a configuration in which the error along the axis is taken out of K_g."""
    check_output(path, [], overwrite)
    rig = found.rig.scaled(found.fit.axial.c)
    text = (
        "# The rig of which heading-sensitive error was calibrated, with its relative rate error\n"
        f"# along the axis, {found.fit.axial.c:.6e}, taken out of K_g. A calibration that belongs\n"
        "# to the rig as it was does not belong to this one.\n\n"
    )
    _write(path, text + tomli_w.dumps({"rig": rig.to_table()}))


def write_csv(path: Path, found: Calibration, overwrite: bool) -> None:
    """Write the runs as a table, angles in rad and rates in rad/s."""
    check_output(path, [], overwrite)
    rows = [asdict(record) for record in found.kept.runs]
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    _write(path, buffer.getvalue())


def _write(path: Path, text: str) -> None:
    with WholeFile(path) as whole:
        whole.stream.write(text.encode())


def summary(found: Calibration) -> dict[str, Any]:
    """The calibration as it was written, the table of headings, and what was not used."""
    return {
        "calibration": to_dict(found.kept),
        "validation": None if found.table is None else _table(found.table, found.azimuths_given),
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


def _table(table: ValidationTable, given: bool) -> dict[str, Any]:
    return {
        "azimuths": "given" if given else "found",
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
