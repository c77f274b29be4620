"""The page of figures of `sinstool process`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sinstool.cli.process_rows import summary_rows
from sinstool.config import ProcessConfig
from sinstool.process_figures import Recorder
from sinstool.report.page import write_report
from sinstool.report.sections import Cell, Column, Page, Section, Settings, Table, Warnings
from sinstool.timeline import SECOND

# Rows of the table of events; all of them are in --json.
EVENTS = 50
WITHOUT = ("calibration", "rig")


def write_page(
    report: Path, recorder: Recorder, summary: dict[str, Any], config: ProcessConfig
) -> None:
    """Write the page, or its first figure, that ``--report`` asks for.

    Parameters
    ----------
    report : Path
    recorder : Recorder
        Through which the run went.
    summary : dict
        The values of ``--json``.
    config : ProcessConfig
        Effective.
    """
    rows = tuple((what or "", how) for what, how in summary_rows(summary, verbose=True))
    done = Table("What was done", (Column(""), Column("")), rows)
    tables = [t for t in (_truth(summary), _events(summary), _stretches(summary)) if t is not None]
    settings = Settings(config.model_dump(mode="json", exclude_none=True, exclude=set(WITHOUT)))
    sections: tuple[Section, ...] = (
        Warnings(tuple(summary["warnings"])),
        done,
        *recorder.figures(summary),
        *tables,
        settings,
    )
    source = Path(summary["input"]["path"]).name
    page = Page("Attitude from recorded inertial data", source, sections)
    write_report(report, page, overwrite=config.output.overwrite)


def _truth(summary: dict[str, Any]) -> Table | None:
    truth = summary.get("truth")
    if not truth:
        return None
    rows: list[tuple[Cell, ...]] = []
    for key, unit in (("attitude_deg", "deg"), ("position_m", "m"), ("velocity_m_s", "m/s")):
        if key not in truth:
            continue
        for name in ("rms", "largest", "last"):
            rows.append((f"{key.partition('_')[0]}, {name}", unit, *truth[key][name]))
    if not rows:
        return None
    axes = (Column("north"), Column("east"), Column("down"))
    note = f"Computed less true, by {', '.join(truth['names'])}."
    return Table("Errors", (Column("Error"), Column("unit"), *axes), tuple(rows), (note,))


def _events(summary: dict[str, Any]) -> Table | None:
    height = summary["height"]
    if not height or not height.get("events"):
        return None
    first = int(summary["imu"]["first_ns"])
    rows = tuple(
        (e["kind"], (int(e["time_ns"]) - first) / SECOND, e["size"], e["duration_s"])
        for e in height["events"][:EVENTS]
    )
    notes = [
        "Size: engaged: offset of the reference, m; coast: s since its last good sample;"
        " re-engaged: m taken out of the height; jump: m by which the reference jumped; frozen: m"
        " given back; invalid: s of coasting; imu-gap: s."
    ]
    if len(height["events"]) > EVENTS:
        notes.append(f"The first {EVENTS} of {len(height['events'])}.")
    columns = (
        Column("Event of the height"),
        Column("at", "s", ".3f"),
        Column("size"),
        Column("duration", "s"),
    )
    return Table("Events of the vertical channel", columns, rows, tuple(notes))


def _stretches(summary: dict[str, Any]) -> Table | None:
    hse = summary["hse"]
    if not hse:
        return None
    first = int(summary["imu"]["first_ns"])
    names = ("rate_deg_s", "turns", "heading_raw_deg", "correction_arcsec",
             "sigma_correction_arcsec", "heading_deg", "sigma_heading_arcsec")  # fmt: skip
    rows = tuple(
        (f"from {(int(s['start_ns']) - first) / SECOND:.1f} s", *(s[name] for name in names))
        for s in hse["segments"]
    )
    columns = (
        Column("Stretch"),
        Column("rate", "deg/s", "+.3f"),
        Column("turns"),
        Column("heading as aligned", "deg", ".6f"),
        Column("its error", "arcsec", "+.3f"),
        Column("sigma", "arcsec", ".3f"),
        Column("heading", "deg", ".6f"),
        Column("sigma", "arcsec", ".3f"),
    )
    return Table("Stretches at constant rate", columns, rows)
