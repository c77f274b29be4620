"""The page of figures of `sinstool align`."""

from __future__ import annotations

from pathlib import Path

from sinstool.config import ALIGN_OPTIONS, ProcessConfig
from sinstool.core.english import counted_clause
from sinstool.pipelines.align.log import LogAlignment
from sinstool.pipelines.align.result import AlignResult, Vector
from sinstool.report.figures.alignment import figures
from sinstool.report.figures.parts import AXES
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
)

# What each status means for the use of this attitude.
VERDICTS = {
    "ok": "Attitude is known about every axis to a degree or better.",
    "degraded": "The attitude is known only to the sigma below about its"
    " worst axis, or the data contradict each other: see the warnings.",
    "level-only": "Roll and pitch are known, heading is"
    " not: nothing in the log shows north. Heading needs horizontal acceleration or turns with"
    " GNSS, or gyros that can measure the Earth's rotation.",
    "unobservable": "Not even roll and pitch are known. The warnings give the reason.",
    "failed": "Alignment was not possible. The warnings give the reason.",
}


def write_page(report: Path, alignment: LogAlignment, config: ProcessConfig, log: Path) -> None:
    """Write the page, or its first figure, that ``--report`` asks for.

    Parameters
    ----------
    config : ProcessConfig
        Effective.
    """
    result = alignment.result
    sections: list[Section] = [Prose(_verdict(result), "Result", _facts(result))]
    if result.roll_deg is not None:
        sections.append(_result(result))
    sections += figures(alignment, config)
    if result.assumed is not None:
        sections += _sensors(result)
    sections += [
        Settings(config_settings(config, *ALIGN_OPTIONS)),
        input_rows([read_file(log)]),
    ]
    subtitle = f"{result.input.path}, {result.imu.topic}"
    page = Page(
        "Alignment: the first attitude of the IMU", subtitle, tuple(sections), result.warnings
    )
    write_report(report, page, overwrite=config.output.overwrite)


def _verdict(result: AlignResult) -> tuple[str, ...]:
    paragraphs = [f"Status {result.status}, by {result.method_text}. {VERDICTS[result.status]}"]
    if result.n_pairs:
        used = (
            f"{result.n_pairs} pairs of vectors from {result.start_s:.1f} to"
            f" {result.stop_s:.1f} s were used;"
            f" {counted_clause(result.n_rejected or 0, 'fix', 'was', 'were')} rejected as"
            f" outliers. Residuals of the pairs are {result.chi2:.2f} times what the noise of GNSS"
            " alone explains"
        )
        if result.refined_chi2 is not None:
            used += f", those of the refinement {result.refined_chi2:.2f} times what it assumes"
        paragraphs.append(used + ".")
        if result.time_to_align_s is not None:
            paragraphs.append(
                f"The solver alone was within 1 deg about every axis {result.time_to_align_s:.1f}"
                " s after the start."
            )
    truth = result.truth
    if truth is not None and truth.error_deg is not None:
        shown = ", ".join("–" if e is None else f"{e:.3g}" for e in truth.error_deg)
        paragraphs.append(
            f"Against {truth.name} the answer is wrong by {shown} deg about north, east, down."
        )
    return tuple(paragraphs)


def _facts(result: AlignResult) -> tuple[Fact, ...]:
    """Each angle with the sigma about the axis that matters most to it, and its error."""
    if result.roll_deg is None:
        return ()
    facts = []
    for name, angle in _angles(result).items():
        value = "not known" if angle is None else f"{angle:.3f} deg"
        facts.append(Fact(name.capitalize(), value))
    named = ", ".join("–" if one is None else f"{one:.2g}" for one in result.sigma_deg)
    facts.append(Fact("Sigma", f"{named} deg", "about north, east, down"))
    truth = result.truth
    if truth is not None and truth.error_deg is not None:
        named = ", ".join("–" if one is None else f"{one:.2g}" for one in truth.error_deg)
        facts.append(Fact("Error", f"{named} deg", f"about these, by {truth.name}"))
    return tuple(facts)


def _angles(result: AlignResult) -> dict[str, float | None]:
    return {"roll": result.roll_deg, "pitch": result.pitch_deg, "heading": result.heading_deg}


def _result(result: AlignResult) -> Table:
    """Sigmas and quality of the attitude, whose angles stand above."""
    error = None if result.truth is None else result.truth.error_deg
    wrong = error or (None, None, None)
    rows = tuple(
        (f"about {axis}", sigma, off)
        for axis, sigma, off in zip(AXES, result.sigma_deg, wrong, strict=True)
    )
    columns = (
        Column("Rotation"),
        Column("sigma", "deg", ".3g"),
        Column("error", "deg", ".3g"),
    )
    notes = (
        f"Of the attitude at {result.time_s:.3f} s after the log's start: the Forward-Right-Down"
        " axes of the IMU in North-East-Down.",
    )
    return Table("Accuracy", columns, rows, notes)


def _sensors(result: AlignResult) -> list[Section]:
    """Biases, and the errors assumed of the IMU."""
    assumed = result.assumed
    assert assumed is not None
    removed, estimate = result.gyro_bias_removed_deg_h, result.gyro_bias_deg_h
    accel = result.accel_bias_m_s2
    rows = (
        _row("gyros, removed before", "deg/h", removed, None),
        _row("gyros, estimated", "deg/h", estimate, assumed.gyro_bias_deg_h),
        _row("accelerometers, estimated", "m/s²", accel, assumed.accel_bias_m_s2),
    )
    columns = (
        Column("Bias"),
        Column("unit"),
        *(Column(axis, "", ".4g") for axis in "xyz"),
        Column("assumed sigma", "", ".3g"),
    )
    notes = (
        "Forward-Right-Down axes. Biases wander with a correlation time of"
        f" {assumed.bias_time_s:g} s.",
    )
    errors = (
        ("grade", f"{result.imu_grade.grade}, {result.imu_grade.why}"),
        ("scale of gyros, accelerometers", f"{assumed.gyro_scale:.3g}, {assumed.accel_scale:.3g}"),
        ("angular random walk", f"{assumed.angle_random_walk_deg_sqrt_h:.3g} deg/√h"),
        ("velocity random walk", f"{assumed.velocity_random_walk_m_s_sqrt_s:.3g} m/s/√s"),
    )
    shown = tuple(row for row in rows if any(cell is not None for cell in row[2:]))
    tables: list[Section] = [Table("Biases of the sensors", columns, shown, notes)] if shown else []
    return [*tables, Rows("What was assumed of the IMU (one sigma)", errors)]


def _row(name: str, unit: str, values: Vector | None, sigma: float | None) -> tuple[Cell, ...]:
    return (name, unit, *(values if values is not None else (None,) * 3), sigma)
