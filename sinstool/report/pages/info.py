"""The page of figures of `sinstool info`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from sinstool.config import ProcessConfig
from sinstool.core.english import counted, in_seconds
from sinstool.core.timeline import SECOND
from sinstool.pipelines.info.result import InspectedImu, Inspection, Topic, UnusableImu
from sinstool.pipelines.info.run import Shown
from sinstool.report.figures.inspection import figures
from sinstool.report.page import write_report
from sinstool.report.pages.settings import config_settings, input_rows, read_file
from sinstool.report.sections import (
    Cell,
    Column,
    Fact,
    Page,
    Prose,
    Rows,
    Section,
    Settings,
    Table,
    table_of,
)

# Rows of the table of gaps; --json has a thousand.
GAPS = 30


def write_page(
    report: Path,
    inspection: Inspection,
    shown: Shown,
    config: ProcessConfig,
    overwrite: bool,
    script: Path | None = None,
) -> None:
    """Write the page, or its first figure, that ``--report`` asks for.

    Parameters
    ----------
    config : ProcessConfig
        Effective.
    script : Path, optional
        What draws the figures, where many pages share it.
    """
    source = inspection.input
    good = inspection.usable
    verdict = str(inspection.process)
    sections: list[Section] = [
        Prose((f"{verdict[:1].upper()}{verdict[1:]}.",), "Result", _facts(inspection, good)),
        *figures(inspection, shown.samplings, shown.traffic),
        _topics(inspection),
    ]
    if good:
        sections.append(_sensors(good))
    if inspection.process.plan is not None:
        sections.append(Rows("What process would do", tuple(inspection.process.plan.rows())))
    sections += [table for imu in good for table in (_still(imu), _gaps(imu)) if table.rows]
    read = [read_file(Path(source.path))]
    sections += [Settings(config_settings(config, "input")), input_rows(read)]
    name = Path(source.path).name
    page = Page("What is in a log", name, tuple(sections), _warnings(inspection))
    write_report(report, page, inputs=[Path(source.path)], overwrite=overwrite, script=script)


def _warnings(inspection: Inspection) -> tuple[str, ...]:
    """Damage, then the findings of each IMU topic with their answers."""
    texts = [f"lost: {part}" for part in inspection.lost.parts]
    lost = inspection.lost
    if lost.messages_declared is not None:
        read = f"{lost.messages_read} of {lost.messages_declared} messages"
        texts.append(f"{read} were recovered; {lost.chunks} chunks are damaged")
    for imu in inspection.imu:
        if isinstance(imu, UnusableImu):
            texts.append(f"{imu.topic}: {imu.problem}")
        else:
            texts += [f"{imu.topic}: {finding}" for finding in imu.findings]
    return (*texts, *map(str, inspection.process.findings))


def _facts(inspection: Inspection, good: Sequence[InspectedImu]) -> tuple[Fact, ...]:
    source = inspection.input
    span = (source.end_ns - source.start_ns) / SECOND
    profile = source.profile or "none"
    facts = [
        Fact("Length", f"{span:.6g} s", counted(source.messages, "message")),
        Fact("Format", source.format, f"profile {profile}, {source.size / 1e6:.1f} MB"),
    ]
    for imu in good[:2]:
        of = f", {imu.topic}" if len(good) > 1 else ""
        still = sum(span.duration_s for span in imu.still)
        facts += [
            Fact(f"IMU rate{of}", f"{imu.rate_hz:.5g} Hz", counted(imu.n, "sample")),
            Fact(f"Gaps{of}", str(imu.gaps), f"{imu.covered_s:.6g} s covered"),
            Fact(f"Stamps{of}", f"{imu.backward} back, {imu.duplicates} twice",
                 "used" if imu.time_source == "stamp" else "not used: log times instead"),
            Fact(f"Steady{of}", in_seconds(still), f"in {counted(len(imu.still), 'stretch')}"),
        ]  # fmt: skip
    return tuple(facts)


def _topics(inspection: Inspection) -> Table:
    columns: list[tuple[Column, Callable[[Topic], Cell]]] = [
        (Column("Topic"), lambda t: t.topic),
        (Column("messages"), lambda t: t.n),
        (Column("rate", "Hz", ".5g"), lambda t: t.rate_hz),
        (Column("longest interval", "s", ".3g"), lambda t: t.longest_interval_s),
        (Column("out of order"), lambda t: t.out_of_order),
        (Column("size", "MB", ".2f"), lambda t: t.bytes / 1e6),
        (Column("type"), lambda t: t.type),
    ]
    note = "Rates, intervals and order are those of log time."
    return table_of("Topics", inspection.topics, columns, (note,))


def _sensors(good: Sequence[InspectedImu]) -> Table:
    """One column for each IMU topic."""
    rows: list[tuple[Cell, ...]] = []

    def row(name: str, unit: str, *texts: str) -> None:
        rows.append((name, unit, *texts))

    def all_of(form: str, key: str) -> list[str]:
        return [_listed(getattr(imu, key), form) for imu in good]

    row("samples", "", *(str(imu.n) for imu in good))
    row("interval: shortest, median, longest", "ms", *all_of(".4g", "interval_ms"))
    row("log time less stamp, from and to", "s", *all_of("+.4f", "log_less_stamp_s"))
    row("largest rate on x, y, z", "rad/s", *all_of(".4g", "gyro_max_rad_s"))
    row("largest specific force on x, y, z", "m/s²", *all_of(".4g", "accel_max_m_s2"))
    row("specific force, median norm", "m/s²", *(f"{i.specific_force_m_s2:.3f}" for i in good))
    row("orientation", "", *("given" if imu.orientation else "none" for imu in good))
    columns = (Column("Quantity"), Column("unit"), *(Column(imu.topic) for imu in good))
    return Table("Inertial sensors", columns, tuple(rows))


def _listed(values: Sequence[float], form: str) -> str:
    return ", ".join(format(value, form) for value in values)


def _still(imu: InspectedImu) -> Table:
    columns = (
        Column("Stretch"),
        Column("for", "s", ".1f"),
        *(Column(f"mean rate {axis}", "rad/s", ".3e") for axis in "xyz"),
        Column("gravity on"),
        Column("gyro noise", "rad/s", ".2e"),
    )
    rows: tuple[tuple[Cell, ...], ...] = tuple(
        (
            f"from {span.start_s:.1f} s",
            span.duration_s,
            *span.gyro_bias_rad_s,
            span.gravity_axis,
            span.gyro_noise_rad_s,
        )
        for span in imu.still
    )
    note = (
        "The longest first. Where the vehicle is at rest the mean rate is the gyros' bias and the"
        " Earth's rate; a turn at a constant rate is steady too."
    )
    return Table(f"Steady stretches, {imu.topic}", columns, rows, (note,))


def _gaps(imu: InspectedImu) -> Table:
    first = imu.first_ns
    listed = imu.gap_list[:GAPS]
    rows = tuple(
        (f"at {(int(gap.start_ns) - first) / SECOND:.3f} s", gap.length_s) for gap in listed
    )
    notes: tuple[str, ...] = ()
    if len(rows) < imu.gaps:
        notes = (f"{len(rows)} of {imu.gaps}.",)
    columns = (Column("Gap"), Column("length", "s", ".4g"))
    return Table(f"Gaps, {imu.topic}", columns, rows, notes)
