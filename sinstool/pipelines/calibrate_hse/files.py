"""What a calibration leaves beside its JSON file: a rig without the error, and a table."""

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
from sinstool.pipelines.calibrate_hse.result import Calibration


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
    """Write the rig as a configuration in which the error along the axis is taken out of K_g.

    Parameters
    ----------
    config : ProcessConfig
        That of the calibration: what it says of reading and of stretches goes along, but for
        what concerns the single logs.
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
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_whole(path, buffer.getvalue())
