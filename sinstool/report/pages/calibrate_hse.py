"""The page of figures of `sinstool calibrate-hse`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite
from pathlib import Path

from sinstool.config import ProcessConfig
from sinstool.core.english import counted
from sinstool.core.units import DEGREE
from sinstool.methods.hse.calibration import RunRecord
from sinstool.methods.hse.statistics import Column as Headings
from sinstool.pipelines.calibrate_hse.result import Calibration
from sinstool.report.figures.hse import ARCSEC, figures
from sinstool.report.page import write_report
from sinstool.report.pages.settings import config_settings, input_rows, read_file
from sinstool.report.sections import (
    Cell,
    Column,
    Fact,
    Page,
    Prose,
    Section,
    Settings,
    Table,
    table_of,
)
from sinstool.report.text.numbers import measured, places_of

# What each status means for the correction of headings.
VERDICTS = {
    "ok": "The calibration may be applied.",
    "nonlinear": "The calibration may be applied, but heading is not quite linear in the rate: see"
    " the warnings.",
    "not_significant": "The coefficient is not significant against its own scatter. A correction"
    " may make headings worse, so it is applied only with --force.",
    "inconsistent_axial": "Headings and the rate along the axis give different coefficients."
    " Something else than heading-sensitive error is in the headings, so that the calibration is"
    " applied only with --force.",
    "unobservable": "The axis leans too little to the east: heading-sensitive error does not show"
    " in heading, and there is no coefficient to apply.",
    "error": "The runs do not determine the coefficient. There is nothing to apply.",
}


def write_page(
    report: Path, calibration: Calibration, config: ProcessConfig, logs: Sequence[Path]
) -> None:
    """Write the page, or its first figure, that ``--report`` asks for.

    Parameters
    ----------
    config : ProcessConfig
        Effective, with its rig.
    """
    first: tuple[Section, ...] = (
        Prose(_verdict(calibration), "Result", _facts(calibration)),
        _coefficients(calibration),
    )
    tables = [make(calibration) for make in (_headings, _runs, _stretches)]
    settings = Settings(config_settings(config, "calibration", "rig", "input"))
    read = input_rows([read_file(path) for path in logs])
    sections = (*first, *figures(calibration), *filter(None, tables), settings, read)
    logs_read = calibration.logs
    source = f"{len(logs_read)} logs" if len(logs_read) > 1 else logs_read[0].source
    subtitle = f"{source}, {calibration.file.created}"
    title = "Heading-sensitive error of a rate-biased system"
    page = Page(title, subtitle, sections, calibration.warnings)
    write_report(report, page, overwrite=config.output.overwrite)


def _verdict(calibration: Calibration) -> tuple[str, ...]:
    file = calibration.file
    paragraphs = [f"Status {file.status.replace('_', ' ')}. {VERDICTS[file.status]}"]
    if file.lambda2_rad is not None:
        value = _arcsec(file.lambda2_rad, file.sigma_lambda2_rad)
        text = f"lambda2 is {value} by the method {file.method}"
        paragraphs.append(f"{text}; the rate along the axis alone gives {_axial(calibration)}.")
    else:
        paragraphs.append(f"The rate along the axis gives lambda2 as {_axial(calibration)}.")
    if calibration.table is not None:
        before, after = calibration.table.before.scatter, calibration.table.after.scatter
        paragraphs.append(
            f"Headings less azimuth lie within {_size(before.peak_to_peak)} of each other before"
            f" and {_size(after.peak_to_peak)} after correction."
        )
    elif (largest := calibration.largest_spread) is not None:
        paragraphs.append(
            f"At one position headings lie within {_size(largest[0])} of each other before and"
            f" {_size(largest[1])} after correction. No azimuths were given, so differences between"
            " positions are unknown."
        )
    if calibration.spread:
        paragraphs.append(
            "The correction is applied here to the runs it was calibrated with; headings recorded"
            " later are the better test."
        )
    return tuple(paragraphs)


def _facts(calibration: Calibration) -> tuple[Fact, ...]:
    file = calibration.file
    facts = []
    if file.lambda2_rad is not None:
        value = _arcsec(file.lambda2_rad, file.sigma_lambda2_rad)
        facts.append(Fact("Misalignment lambda2", value, f"1 sigma, by the method {file.method}"))
    facts.append(Fact("The same by the axial rate", _axial(calibration), "no heading is in it"))
    runs = f"{counted(file.fit.n_runs, 'run')}, {counted(file.fit.n_rates, 'rate')}"
    facts.append(Fact("Status", file.status.replace("_", " "), runs))
    if calibration.table is not None:
        before, after = calibration.table.before.scatter, calibration.table.after.scatter
        spread = f"{_size(before.peak_to_peak)} → {_size(after.peak_to_peak)}"
        facts.append(Fact("Peak to peak of headings", spread, "before → after correction"))
    return tuple(facts)


def _size(value: float) -> str:
    return (
        f"{value / ARCSEC:.3g} arcsec" if value < 1e3 * ARCSEC else f"{value / ARCSEC:.0f} arcsec"
    )


def _arcsec(value: float, sigma: float | None) -> str:
    over = None if sigma is None else sigma / ARCSEC
    return measured(value / ARCSEC, over, "arcsec").replace("+-", "±")


def _axial(calibration: Calibration) -> str:
    axial = calibration.file.axial
    return _arcsec(axial.lambda2_rad, axial.sigma_rad)


def _coefficients(calibration: Calibration) -> Table:
    file = calibration.file
    rows: list[tuple[Cell, ...]] = [
        _row(f"lambda2, by {file.method}", "arcsec", file.lambda2_rad, file.sigma_lambda2_rad,
             file.ci95_lambda2_rad, ARCSEC),
        _row("lambda2, by the axial rate", "arcsec", file.axial.lambda2_rad, file.axial.sigma_rad,
             None, ARCSEC),
        _row("sum of matrix errors (-lambda2)", "arcsec",
             None if file.lambda2_rad is None else -file.lambda2_rad, file.sigma_lambda2_rad,
             None, ARCSEC),
        _row("K, slope of heading", "arcsec/(rad/s)", file.K_HSE_s, file.sigma_K_HSE_s,
             file.ci95_K_HSE_s, ARCSEC),
        _row("C23, lean of the axis to the east", "rad", file.C23_rad, file.sigma_C23_rad),
        _row("encoder delay", "us", file.delay_s, file.sigma_delay_s, None, 1e-6),
        _row("gyro bias along the axis", "deg/h", file.axial.bias_rad_s, None, None, ARCSEC),
        _row("scatter of a run", "arcsec", file.fit.s_rad, None, None, ARCSEC),
        _row("lack of fit, p", "", file.fit.p_lof, None),
    ]  # fmt: skip
    columns = (
        Column("Quantity"),
        Column("unit"),
        Column("value", "", ".7g"),
        Column("sigma", "", ".2g"),
        Column("95 % from", "", ".7g"),
        Column("to", "", ".7g"),
    )
    notes = (
        f"{counted(file.fit.n_runs, 'run')} at {counted(file.fit.n_rates, 'rate')},"
        f" {file.fit.dof} degrees of freedom,"
        f" latitude {file.latitude_rad / DEGREE:.4f} deg. Heading is corrected by ψ = ψ̂ −"
        " (Ω − ω sin L) λ₂ C₂₃ / (3 ω cos L), with the rate of the table Ω, the Earth's ω, the"
        " latitude L, and λ₂ the coefficient lambda2.",
    )
    estimated = tuple(row for row in rows if row[2] is not None)
    return Table("Coefficients", columns, estimated, notes)


def _row(
    name: str,
    unit: str,
    value: float | None,
    sigma: float | None,
    interval: tuple[float, float] | None = None,
    size: float = 1.0,
) -> tuple[Cell, ...]:
    """A coefficient with as many digits as its sigma has a meaning for."""
    cells = [_over(v, size) for v in (value, sigma, *(interval or (None, None)))]
    if sigma is not None and isfinite(sigma) and sigma > 0.0:
        places = places_of(sigma / size)
        cells = [None if v is None else round(v, places) for v in cells]
    return (name, unit, *cells)


def _over(value: float | None, size: float) -> float | None:
    return None if value is None else value / size


def _headings(calibration: Calibration) -> Table | None:
    """Headings before and after, as table 1 of the paper has them."""
    table = calibration.table
    if table is None:
        return _spread(calibration)
    rows: list[tuple[Cell, ...]] = [
        (name, azimuth / DEGREE, before / ARCSEC, after / ARCSEC)
        for name, azimuth, before, after in zip(
            table.ids,
            table.azimuth.tolist(),
            table.before.values.tolist(),
            table.after.values.tolist(),
            strict=True,
        )
    ]
    both = (_figures_of(table.before), _figures_of(table.after))
    for name, before, after in zip(both[0], both[0].values(), both[1].values(), strict=True):
        rows.append((name, None, before, after))
    columns = (
        Column("Run"),
        Column("azimuth", "deg", ".4f"),
        Column("before", "arcsec", ".3f"),
        Column("after", "arcsec", ".3f"),
    )
    notes = (
        "Heading less azimuth, less its mean. The F test is for a sinusoid over"
        " azimuth: a small p means that there is one.",
    )
    return Table("Headings before and after correction", columns, tuple(rows), notes)


def _figures_of(column: Headings) -> dict[str, Cell]:
    s = column.scatter
    cells: dict[str, Cell] = {
        "peak to peak": s.peak_to_peak / ARCSEC,
        "standard deviation": s.std / ARCSEC,
        "peak to peak of means": s.peak_to_peak_of_means / ARCSEC,
        "within azimuths, pooled": s.within_std / ARCSEC,
    }
    if column.sinusoid is not None:
        cells["amplitude of the sinusoid"] = column.sinusoid.amplitude / ARCSEC
        cells["its sigma"] = column.sinusoid.sigma_amplitude / ARCSEC
        cells["F (no unit)"] = column.sinusoid.F
        cells["p (no unit)"] = column.sinusoid.p
    return cells


def _spread(calibration: Calibration) -> Table | None:
    if not calibration.spread:
        return None
    columns = (
        Column("Mean corrected heading", "deg", ".5f"),
        Column("runs"),
        Column("peak to peak before", "arcsec", ".3f"),
        Column("after", "arcsec", ".3f"),
    )
    rows = tuple(
        (one.heading / DEGREE, len(one.ids), *(v / ARCSEC for v in one.peak_to_peak))
        for one in calibration.spread
    )
    notes = (
        "Within each position. Give the azimuths of the stand"
        " (--azimuth LOG=DEG) to compare positions.",
    )
    return Table("Headings within positions", columns, rows, notes)


def _runs(calibration: Calibration) -> Table:
    columns: list[tuple[Column, Callable[[RunRecord], Cell]]] = [
        (Column("Run"), lambda run: run.id),
        (Column("from", "s", ".1f"), lambda run: run.t_start_s),
        (Column("turns"), lambda run: run.n_turns),
        (Column("rate", "deg/s", "+.4f"), lambda run: run.rate_rad_s / DEGREE),
        (Column("heading", "deg", ".6f"), lambda run: run.psi_rad / DEGREE),
        (Column("sigma", "arcsec", ".3g"), lambda run: _over(run.sigma_psi_rad, ARCSEC)),
        (Column("C23", "rad", ".3e"), lambda run: run.C23),
        (Column("axial lambda2", "arcsec", ".4f"), lambda run: -3.0 * run.c_axial / ARCSEC),
        (Column("residual", "arcsec", ".3f"), lambda run: _over(run.resid_rad, ARCSEC)),
        (Column("used"), lambda run: run.used),
        (Column("why not"), lambda run: run.reason),
    ]
    note = "The axial lambda2 of one run holds the gyros' bias along the axis."
    return table_of("Runs", calibration.file.runs, columns, (note,))


def _stretches(calibration: Calibration) -> Table | None:
    """Stretches of the logs that were not used, and why."""
    columns = (
        Column("Log"),
        Column("from", "s", ".1f"),
        Column("for", "s", ".1f"),
        Column("rate", "deg/s", "+.3f"),
        Column("why"),
    )
    rows = tuple(
        (log.source, s.start_s, s.duration_s, s.rate / DEGREE, s.reason)
        for log in calibration.logs
        for s in log.segmentation.rejected
    )
    return Table("Stretches not used", columns, rows) if rows else None
