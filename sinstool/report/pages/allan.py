"""The page of figures of `sinstool allan`."""

from __future__ import annotations

from pathlib import Path

from sinstool.config import ALLAN_OPTIONS, ProcessConfig
from sinstool.core.english import in_seconds
from sinstool.core.units import DEGREE_PER_HOUR, DEGREE_PER_ROOT_HOUR, MICRO_G
from sinstool.methods.allan.coefficients import SENSORS, Sensor, over_axes
from sinstool.pipelines.allan.formats import SUFFIXES, entries
from sinstool.pipelines.allan.result import AllanResult
from sinstool.pipelines.allan.run import LogNoise
from sinstool.report.figures.allan import figures
from sinstool.report.page import write_report
from sinstool.report.pages.settings import config_settings, input_rows, read_file
from sinstool.report.sections import Cell, Column, Fact, Page, Prose, Section, Settings, Table
from sinstool.report.text.allan import SHOWN, TITLES, shown

# Rows of the table of stretches; --json has all.
STRETCHES = 30


def write_page(
    report: Path,
    noise: LogNoise,
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
    result = noise.result
    source = Path(result.input.path)
    rest = result.rest
    text = (
        f"{in_seconds(rest.total_s)} at rest, the longest stretch {in_seconds(rest.longest_s)},"
        f" show averaging times up to {in_seconds(result.averaging_s[-1])}."
    )
    sections: list[Section] = [
        Prose((text,), "Result", _facts(result)),
        *figures(noise),
        *(_coefficients(result, sensor) for sensor in SENSORS),
        _where(result),
        _stretches(result),
        Settings(config_settings(config, *ALLAN_OPTIONS)),
        input_rows([read_file(source)]),
    ]
    warnings = tuple(map(str, result.findings))
    page = Page("Noise of an IMU at rest", source.name, tuple(sections), warnings)
    write_report(report, page, inputs=[source], overwrite=overwrite, script=script)


def _facts(result: AllanResult) -> tuple[Fact, ...]:
    """White noise and bias instability of both sensors."""
    rows: tuple[tuple[Sensor, str, str, float, str], ...] = (
        ("gyro", "white", "deg/√h", DEGREE_PER_ROOT_HOUR, "Angle random walk"),
        ("gyro", "flicker", "deg/h", DEGREE_PER_HOUR, "Gyro bias instability"),
        ("accel", "white", "µg/√Hz", MICRO_G, "Velocity random walk"),
        ("accel", "flicker", "µg", MICRO_G, "Accelerometer bias instability"),
    )
    facts = []
    for sensor, term, unit, size, name in rows:
        coefficient = over_axes(result.noise.of(sensor), term)
        if coefficient is None:
            facts.append(Fact(name, "not measured"))
        elif coefficient.value is None:
            facts.append(Fact(name, f"below {coefficient.high / size:.3g} {unit}", "not visible"))
        else:
            interval = f"95 %: {coefficient.low / size:.4g} to {coefficient.high / size:.4g}"
            facts.append(Fact(name, f"{coefficient.value / size:.4g} {unit}", interval))
    return tuple(facts)


def _coefficients(result: AllanResult, sensor: Sensor) -> Table:
    axes = result.of(sensor)
    rows: list[tuple[Cell, ...]] = [
        (
            name,
            unit,
            *(
                shown(axis.coefficients[term], size) if axis.coefficients else axis.status
                for axis in axes
            ),
        )
        for term, (name, unit, size) in SHOWN[sensor].items()
    ]
    columns = (Column(TITLES[sensor].capitalize()), Column("unit"), *(Column(a.axis) for a in axes))
    note = "With 95 % intervals. What is below a bound is not visible in this log."
    return Table(f"Noise of the {TITLES[sensor]}", columns, tuple(rows), (note,))


def _where(result: AllanResult) -> Table:
    """Values for other programs: each key of each file."""
    rows: list[tuple[Cell, ...]] = []
    for kind in SUFFIXES:
        for entry in entries(result, kind):
            value = "not measured" if entry.value is None else f"{entry.value:.4g}"
            bound = "" if entry.visible else "a bound: not visible"
            rows.append((kind, entry.key, value, entry.unit, entry.what, bound))
    columns = tuple(map(Column, ("For", "key", "value", "unit", "what it is", "note")))
    note = "--format writes them as files, sinstool's own and covariances of messages among them."
    return Table("What to put where", columns, tuple(rows), (note,))


def _stretches(result: AllanResult) -> Table:
    listed = sorted(result.rest.stretches, key=lambda one: -one.duration_s)[:STRETCHES]
    rows: tuple[tuple[Cell, ...], ...] = tuple(
        (f"from {one.start_s:.1f} s", one.duration_s) for one in listed
    )
    columns = (Column("Stretch"), Column("length", "s", ".1f"))
    count = len(result.rest.stretches)
    notes = ("The longest first.",) if count > 1 else ()
    return Table("At rest", columns, rows, notes, folded=count > 1)
