"""`sinstool calibrate-hse`: heading-sensitive error of a rate-biased system, from its logs."""

from __future__ import annotations

from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sinstool.campaign.inputs import expand
from sinstool.cli.batch import BatchOptions, batch_options, workers_of, workers_options
from sinstool.cli.console import PathName, print_json, progress_bar, warn
from sinstool.cli.help import Command, Option
from sinstool.cli.options import Words, config_options, effective_config, path_option, print_config
from sinstool.config import ProcessConfig
from sinstool.config.rig import CALIBRATION_OPTIONS
from sinstool.core.english import counted
from sinstool.core.errors import ConfigurationError
from sinstool.core.units import ARCSEC, DEGREE
from sinstool.report.text.numbers import measured, places_of
from sinstool.report.text.table import table

if TYPE_CHECKING:
    from sinstool.pipelines.calibrate_hse.result import Calibration

MAIN = ("output", "config_file", "report", "csv_file", "emit_config", "output__overwrite", "plan")
PLAN = "With --plan"


@click.command("calibrate-hse", cls=Command, first=MAIN)
@click.argument("logs", nargs=-1, type=PathName(), metavar="LOG...")
@path_option("-o", "--output", text="calibration to write (JSON)")
@workers_options("1")
@config_options(*CALIBRATION_OPTIONS)
@path_option(
    "--emit-config",
    metavar="FILE.toml",
    text="also write a rig file whose K_g removes the error",
)
@path_option("--csv", "csv_file", metavar="FILE.csv", text="also write the runs as a table")
@path_option(
    "--report",
    metavar="FILE.html",
    text="also write a page of figures (.html), or a figure",
)
@click.option("--plan", is_flag=True, help="predict what a design would give; needs no log")
@click.option("--rates", type=Words(), default="20,40,60", show_default=True, metavar="DEG/S,...",
              cls=Option, section=PLAN, help="rates of the table, signed")  # fmt: skip
@click.option("--repeats", type=int, default=3, show_default=True, metavar="N",
              cls=Option, section=PLAN, help="repeats at each rate")  # fmt: skip
@click.option("--lean", type=Words(), default="8e-4", show_default=True, metavar="RAD,...",
              cls=Option, section=PLAN,
              help="lean of the axis to the east, for each position of the base")  # fmt: skip
@click.option("--arw", type=float, default=5e-4, show_default=True, metavar="DEG/SQRT(H)",
              cls=Option, section=PLAN, help="angular random walk of the gyros")  # fmt: skip
@click.option("--latitude", type=float, metavar="DEG", cls=Option, section=PLAN,
              help="latitude of the site [default: the rig's]")  # fmt: skip
@batch_options("every run in the summary", json_of="")
def command(
    logs: tuple[Path, ...],
    output: Path | None,
    config_file: Path | None,
    emit_config: Path | None,
    csv_file: Path | None,
    report: Path | None,
    plan: bool,
    rates: Any,
    repeats: int,
    lean: Any,
    arw: float,
    latitude: float | None,
    show: bool,
    batch: BatchOptions,
    **flags: Any,
) -> int:
    """Calibrate the heading-sensitive error of a rate-biased laser-gyro system.

    LOGs are recordings on a turntable at several constant rates, with its base at one azimuth or
    more: raw gyros and accelerometers (Imu) and the table's angle (JointState). A LOG may also be
    a folder or a quoted pattern. The table [rig] of the --config file describes the rig.

    \b
      sinstool calibrate-hse north.mcap south.mcap --config rig.toml -o hse.json
    """
    config = effective_config(config_file, flags)
    if show:
        print_config(config, *CALIBRATION_OPTIONS, "rig")
        return 0
    if plan:
        return _plan(config, rates, repeats, lean, arw, latitude, batch.as_json)
    if not logs:
        raise click.UsageError("give at least one LOG, or --plan")
    if output is None:
        raise click.UsageError("give the output with -o FILE.json")
    if config.rig is None:
        raise ConfigurationError("no rig is described", "give a table [rig] with --config RIG.toml")
    from sinstool.core.whole_file import commit_together
    from sinstool.pipelines.calibrate_hse.result import check_files, write_csv, write_rig
    from sinstool.pipelines.calibrate_hse.run import calibrate
    from sinstool.report.page import check_report

    paths = expand(logs)
    check_files([emit_config, csv_file, report], [output, *paths], config.output.overwrite)
    check_report(report, overwrite=config.output.overwrite)
    workers = None
    if batch.scheduler is not None or (batch.jobs or 1) > 1:
        workers = workers_of(batch, [path.absolute() for path in paths], len(paths))
    with commit_together(), progress_bar(counted(len(paths), "log"), batch.quiet) as progress:
        calibration = calibrate(paths, output, config, progress, workers)
        if emit_config is not None:
            write_rig(emit_config, calibration, config)
        if csv_file is not None:
            write_csv(csv_file, calibration, config.output.overwrite)
        if report is not None:
            from sinstool.report.pages.calibrate_hse import write_page

            write_page(report, calibration, config, paths)
    if batch.as_json:
        print_json({**calibration.to_json(), "output": str(output)})
    elif not batch.quiet:
        _print(calibration, output, batch.verbose > 0)
    for text in calibration.warnings:
        warn(text)
    return calibration.exit_status


def _arcsec(value: float | None, sigma: float | None = None) -> str:
    if value is None:
        return "not determined"
    return measured(value / ARCSEC, None if sigma is None else sigma / ARCSEC, "arcsec")


def _print(calibration: Calibration, output: Path, verbose: bool) -> None:
    file, fit = calibration.file, calibration.fit
    used = [r for r in file.runs if r.used]
    rates = sorted({round(r.rate_rad_s / DEGREE, 2) for r in used})
    slope = "not determined"
    if file.K_HSE_s is not None:
        sigma = None if file.sigma_K_HSE_s is None else file.sigma_K_HSE_s / ARCSEC
        shown = measured(file.K_HSE_s / ARCSEC, sigma, "arcsec/(rad/s)")
        slope = f"{shown}, at the base position where the axis leans most"
    lambda2 = _arcsec(file.lambda2_rad, file.sigma_lambda2_rad)
    axial = _arcsec(file.axial.lambda2_rad, file.axial.sigma_rad)
    interval = ""
    if file.ci95_lambda2_rad and file.sigma_lambda2_rad:
        places = places_of(file.sigma_lambda2_rad / ARCSEC)
        low, high = (f"{limit / ARCSEC:.{places}f}" for limit in file.ci95_lambda2_rad)
        interval = f", 95 % {low} to {high} arcsec"
    count = counted(len(calibration.logs), "log")
    rows = [
        ("runs", f"{len(used)} of {len(file.runs)} in use, from {count}, at"
                 f" {', '.join(f'{r:g}' for r in rates)} deg/s"),
        ("misalignment lambda2", f"{lambda2} by {file.method}{interval}"),
        ("axial misalignment", f"{axial} by the gyro rate along the axis"),
        ("slope K of heading over rate", slope),
        ("lean of the axis to the east, C23",
                    f"{measured(file.C23_rad * 1e6, file.sigma_C23_rad * 1e6, 'urad')}, latitude"
                     f" {file.latitude_rad / DEGREE:.4f} deg"),
    ]  # fmt: skip
    if file.delay_s is not None:
        sigma = None if file.sigma_delay_s is None else file.sigma_delay_s * 1e6
        rows.append(("encoder delay", measured(file.delay_s * 1e6, sigma, "us")))
    if fit.s is not None:
        chi2 = "" if fit.chi2 is None or not fit.dof else f", chi2/dof {fit.chi2 / fit.dof:.2f}"
        lack = "" if fit.p_lof is None else f", lack of fit p = {fit.p_lof:.3f}"
        rows.append(
            ("fit", f"scatter {_arcsec(fit.s)} a run, {fit.dof} degrees of freedom{chi2}{lack}")
        )
    rows += _headings(calibration)
    if verbose:
        for record in file.runs:
            note = record.reason or f"residual {_arcsec(record.resid_rad)}"
            rows.append(
                (
                    record.id,
                    f"{record.rate_rad_s / DEGREE:+8.3f} deg/s, {counted(record.n_turns, 'turn')},"
                    f" heading {record.psi_rad / DEGREE:.5f} deg, {note}",
                )
            )
    rows.append(("status", file.status))
    rows.append(("written", str(output)))
    table(rows)


def _headings(calibration: Calibration) -> list[tuple[str, str]]:
    """Scatter of headings before and after correction."""
    if calibration.table is not None and len(calibration.table.position_azimuth) > 1:
        before, after = calibration.table.before.scatter, calibration.table.after.scatter
        text = (
            f"{before.n} at {len(before.means)} azimuths, less azimuth: peak to peak"
            f" {_arcsec(before.peak_to_peak)} before, {_arcsec(after.peak_to_peak)} after"
        )
    elif (largest := calibration.largest_spread) is not None:
        text = (
            f"within a position peak to peak {_arcsec(largest[0])} before,"
            f" {_arcsec(largest[1])} after"
            + (" (with --azimuth also between them)" if len(calibration.spread) > 1 else "")
        )
    else:
        return []
    return [("headings", text)]


def _plan(
    config: ProcessConfig,
    rates: Any,
    repeats: int,
    lean: Any,
    arw: float,
    latitude: float | None,
    as_json: bool,
) -> int:
    """Print what a design of runs would give."""
    from dataclasses import asdict

    from sinstool.methods.hse.design import Design, predict
    from sinstool.methods.hse.rig import from_table

    for flag, value in (("--latitude", latitude), ("--arw", arw)):
        if value is not None and not isfinite(value):
            raise click.UsageError(f"{flag} is {value}, not a number")
    if latitude is None:
        if config.rig is None:
            raise click.UsageError("give --latitude, or a rig with --config")
        radians = from_table(config.rig).require_latitude()
    else:
        radians = latitude * DEGREE
    design = Design(
        rates=tuple(v * DEGREE for v in _numbers("--rates", rates)),
        repeats=repeats,
        duration_s=config.calibration.align_duration,
        C23=_numbers("--lean", lean),
        angle_random_walk=arw * DEGREE / 60.0,
        latitude=radians,
    )
    plan = predict(design)
    if as_json:
        print_json({"plan": asdict(plan)})
        return 0
    sigma = ", ".join(_arcsec(s) for s in plan.sigma_run)
    rows = [
        ("runs", f"{plan.n_runs} of {design.duration_s:g} s, {plan.total_s / 3600.0:.2f} h in all"),
        ("sigma of a heading", f"{sigma} at {', '.join(rates)} deg/s"),
        ("sigma of K", f"{plan.sigma_K / ARCSEC:.3g} arcsec/(rad/s)"),
        ("sigma of lambda2", f"{_arcsec(plan.sigma_lambda2_heading)} by heading"),
        ("", f"{_arcsec(plan.sigma_lambda2_joint)} by joint"),
        ("", f"{_arcsec(plan.sigma_lambda2_axial)} by the axial rate"),
    ]
    if plan.sigma_delay is not None:
        rows.append(("sigma of a delay", f"{plan.sigma_delay * 1e6:.2f} us"))
    rows.append(("order", ", ".join(f"{r / DEGREE:g}" for r in plan.order) + " deg/s"))
    rows += [("advice" if k == 0 else "", text) for k, text in enumerate(plan.advice)]
    table(rows)
    return 0


def _numbers(flag: str, words: Any) -> tuple[float, ...]:
    try:
        numbers = tuple(float(word) for word in words)
    except ValueError:
        numbers = (float("nan"),)
    if not all(map(isfinite, numbers)):
        raise click.UsageError(f"{flag}: {','.join(words)} are not numbers")
    return numbers
