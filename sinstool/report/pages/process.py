"""The page of figures of `sinstool process`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import hypot, isfinite
from pathlib import Path

from sinstool.config import PROCESS_OPTIONS, ProcessConfig
from sinstool.core.english import counted, heading_text
from sinstool.core.timeline import SECOND
from sinstool.methods.ins_gnss.withheld import Outage
from sinstool.pipelines.process import filter_used, height_used, hse_used
from sinstool.pipelines.process.errors_against_truth import RunErrors
from sinstool.pipelines.process.result import ProcessResult
from sinstool.pipelines.process.travel import Spread
from sinstool.report.page import write_report
from sinstool.report.pages.settings import config_settings, input_rows
from sinstool.report.recorder import Recorder
from sinstool.report.sections import Cell, Column, Fact, Page, Prose, Rows, Section, Settings, Table
from sinstool.report.text.account import account, distance, duration, squares
from sinstool.report.text.process import summary_rows

# Rows of the table of events; all of them are in --json.
EVENTS = 50
TITLES = {
    "attitude": "Attitude from recorded inertial data",
    "turntable": "Attitude on a turntable from recorded inertial data",
    "ins": "Inertial navigation from recorded data",
    "ins-gnss": "INS/GNSS navigation from recorded data",
}


def write_page(
    report: Path,
    recorder: Recorder,
    result: ProcessResult,
    config: ProcessConfig,
    script: Path | None = None,
) -> None:
    """Write the page, or its first figure, that ``--report`` asks for.

    Parameters
    ----------
    recorder : Recorder
        Through which the run went.
    config : ProcessConfig
        Effective.
    script : Path, optional
        What draws the figures, where many pages share it.
    """
    rows = summary_rows(result, verbose=True)
    read, mode = result.input, result.plan.mode.value
    results, checks = recorder.figures(result)
    sections: tuple[Section | None, ...] = (
        Prose(account(result), "Result", _facts(result)),
        *results,
        _stretches(result),
        _checks(result),
        _truth(result),
        _withheld(result),
        *checks,
        _events(result),
        Rows("Processing", tuple((what, how) for what, how in rows if what != "input sha256")),
        Rows("Choices and their reasons", tuple(result.plan.rows())),
        Settings(config_settings(config, *PROCESS_OPTIONS)),
        input_rows([read]),
    )
    shown = tuple(one for one in sections if one)
    page = Page(TITLES[mode], Path(read.path).name, shown, result.warnings)
    write_report(report, page, overwrite=config.output.overwrite, script=script)


def _facts(result: ProcessResult) -> tuple[Fact, ...]:
    """Duration, distance, speed and accuracy."""
    travel, imu = result.travel, result.imu
    lost = f"{counted(imu.gaps, 'gap')}, {counted(imu.dropped, 'sample')} dropped"
    facts = [Fact("Duration", duration(travel.duration_s), f"IMU at {imu.rate_hz:.4g} Hz; {lost}")]
    if travel.distance_m is not None and travel.largest_speed_m_s is not None:
        speeds = (
            f"{travel.mean_speed_m_s or 0.0:.3g} m/s on average, at most"
            f" {travel.largest_speed_m_s:.3g} m/s"
        )
        facts.append(Fact("Distance", distance(travel.distance_m), speeds))
    if result.hse is not None:
        facts += _hse_facts(result.hse)
    facts += _error_facts(result.truth) or _accuracy_facts(result)
    facts += [*_filter_facts(result.filter), *_height_facts(result.height)]
    if travel.distance_m is None:
        final = result.final
        tilt = f"roll {final.roll_deg:z.2f}, pitch {final.pitch_deg:z.2f} deg"
        facts.append(Fact("Heading at the end", f"{heading_text(final.heading_deg, 2)} deg", tilt))
    return tuple(facts)


def _accuracy_facts(result: ProcessResult) -> list[Fact]:
    """One sigma of each result."""
    accuracy = result.travel.accuracy
    if accuracy is None:
        return []
    tilt = _accuracy("Roll and pitch", accuracy.tilt_deg, "deg")
    lost = result.smoothing is not None and result.smoothing.heading_lost
    heading = _accuracy("Heading", accuracy.heading_deg, "deg")
    facts = [Fact("Heading", "not known", "at the end") if lost else heading, tilt]
    if accuracy.horizontal_m is not None and accuracy.height_m is not None:
        facts += [
            _accuracy("Position", accuracy.horizontal_m, "m", " north and east"),
            _accuracy("Height", accuracy.height_m, "m"),
        ]
    return facts


def _accuracy(name: str, sigma: Spread, unit: str, of: str = "") -> Fact:
    note = f"1 sigma{of}, median; at most {sigma.largest:.2g} {unit}"
    return Fact(f"{name}, accuracy", f"± {sigma.median:.2g} {unit}", note)


def _checks(result: ProcessResult) -> Prose:
    """How to read the figures below."""
    used = result.filter
    text = "How good the result is, and what it was computed from."
    if used is None or not isfinite(used.mean_nis):
        return Prose((text,), "Checks")
    return Prose((f"{text} {squares(used.mean_nis)}",), "Checks")


def _error_facts(truth: RunErrors | None) -> list[Fact]:
    if truth is None:
        return []
    facts = []
    if truth.position_m is not None:
        north, east, down = truth.position_m.rms
        most = truth.position_m.largest
        facts.append(
            Fact(
                "Position error, rms",
                f"{hypot(north, east):.3g} m",
                f"horizontal; {down:.3g} m in height; at most {max(most):.3g} m on an axis",
            )
        )
    apart = truth.vertical_deg
    if apart is not None:
        aligned = "" if apart.heading_aligned is None else "; aligned at first"
        facts += [
            Fact("Heading error, rms", f"{apart.heading_rms:.3g} deg",
                 f"{apart.heading_drift:+.3g} deg from first to last{aligned}"),
            Fact("Inclination error, rms", f"{apart.inclination_rms:.3g} deg",
                 f"at most {apart.inclination_largest:.3g} deg"),
        ]  # fmt: skip
    return facts


def _filter_facts(used: filter_used.FilterUsed | None) -> list[Fact]:
    if used is None:
        return []
    out = used.outages
    missing = f"longest outage {duration(out.longest_s)}" if out.count else "no outage"
    facts = [
        Fact("GNSS epochs used", f"{used.epochs_used}", f"{used.epochs_gated} rejected; {missing}")
    ]
    if used.withheld is not None:
        count = len(used.withheld.outages)
        drift = used.withheld.rms_of_largest_horizontal_m
        note = f"largest horizontal error, {count} outage{'s' * (count > 1)}"
        facts.append(Fact("Withheld fixes", f"{drift:.3g} m", note))
    return facts


def _height_facts(height: height_used.HeightDamping | None) -> list[Fact]:
    if height is None:
        return []
    value = f"{height.difference_rms_m:.3g} m"
    return [Fact("Difference from reference", value, f"of height, latest rms, {height.topic}")]


def _hse_facts(hse: hse_used.HseCorrection) -> list[Fact]:
    most = max(hse.segments, key=lambda s: abs(s.correction_arcsec), default=None)
    if most is None:
        return []
    value = f"{-most.correction_arcsec:+.2f} arcsec"
    return [Fact("Largest correction", value, f"of heading, at {most.rate_deg_s:+.2f} deg/s")]


def _withheld(result: ProcessResult) -> Table | None:
    """Errors of navigation where fixes were withheld from it."""
    scores = None if result.filter is None else result.filter.withheld
    if scores is None:
        return None
    columns = {
        "duration_s": Column("for", "s", ".1f"),
        "epochs": Column("fixes"),
        "largest_horizontal_m": Column("largest horizontal", "m", ".3g"),
        "largest_vertical_m": Column("largest vertical", "m", ".3g"),
        "largest_in_sigmas": Column("largest on an axis", "sigma", ".2f"),
        "rms_in_sigmas": Column("rms of all axes", "sigma", ".2f"),
    }
    note = (
        "Navigation minus the withheld fixes; includes their own noise. In sigmas: less what is"
        " known of the receiver's slow errors, over the sigma of the rest."
    )
    return _by_start("Withheld fixes", "Outage", result, scores.outages, columns, (note,))


def _by_start(
    title: str,
    kind: str,
    result: ProcessResult,
    spans: Sequence[Outage | hse_used.TurntableStretch],
    columns: Mapping[str, Column],
    notes: tuple[str, ...] = (),
) -> Table:
    """A row for each span of a log: from when, and the values of it that columns name."""
    first = result.imu.first_ns
    rows = tuple(
        (f"from {(s.start_ns - first) / SECOND:.1f} s", *(getattr(s, key) for key in columns))
        for s in spans
    )
    return Table(title, (Column(kind), *columns.values()), rows, notes)


def _truth(result: ProcessResult) -> Table | None:
    truth = result.truth
    if truth is None:
        return None
    rows: list[tuple[Cell, ...]] = []
    for what, unit, errors in truth.kinds():
        for name in ("rms", "largest", "last"):
            rows.append((f"{what}, {name}", unit, *getattr(errors, name)))
    if not rows:
        return None
    axes = (Column("north"), Column("east"), Column("down"))
    note = f"Computed less true, by {', '.join(truth.names)}."
    return Table("Errors", (Column("Error"), Column("unit"), *axes), tuple(rows), (note,))


def _events(result: ProcessResult) -> Table | None:
    height = result.height
    if height is None or not height.events:
        return None
    first = result.imu.first_ns
    rows = tuple(
        (e.kind, (e.time_ns - first) / SECOND, e.size, e.duration_s) for e in height.events[:EVENTS]
    )
    notes = [
        "Size: engaged: offset of the reference, m; coast: s since its last good sample;"
        " re-engaged: m taken out of the height; jump: m by which the reference jumped; returned: m"
        " by which it came back, and the height with it; frozen: m given back; invalid: s of"
        " coasting; imu-gap: s."
    ]
    if len(height.events) > EVENTS:
        notes.append(f"The first {EVENTS} of {len(height.events)}.")
    columns = (
        Column("Event of the height"),
        Column("at", "s", ".3f"),
        Column("size"),
        Column("duration", "s"),
    )
    return Table("Events of the vertical channel", columns, rows, tuple(notes))


def _stretches(result: ProcessResult) -> Table | None:
    hse = result.hse
    if hse is None:
        return None
    columns = {
        "rate_deg_s": Column("rate", "deg/s", "+.3f"),
        "turns": Column("turns"),
        "heading_raw_deg": Column("heading as aligned", "deg", ".6f"),
        "correction_arcsec": Column("its error", "arcsec", "+.3f"),
        "sigma_correction_arcsec": Column("sigma", "arcsec", ".3f"),
        "heading_deg": Column("heading", "deg", ".6f"),
        "sigma_heading_arcsec": Column("sigma", "arcsec", ".3f"),
    }
    return _by_start("Stretches at constant rate", "Stretch", result, hse.segments, columns)
