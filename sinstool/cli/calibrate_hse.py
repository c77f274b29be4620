"""`sinstool calibrate-hse`: heading-sensitive error of a rate-biased system, from its logs."""

from __future__ import annotations

from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sinstool.campaign.inputs import expand
from sinstool.cli.console import print_json, progress_bar, warn
from sinstool.cli.many import BatchOptions, batch_options, workers_of, workers_options
from sinstool.cli.options import Words, config_options, effective_config, path_option, print_config
from sinstool.config import ProcessConfig
from sinstool.core.errors import ConfigurationError
from sinstool.core.units import ARCSEC, DEGREE
from sinstool.report.text.table import table

if TYPE_CHECKING:
    from sinstool.pipelines.calibrate_hse.result import Calibration


@click.command("calibrate-hse")
@click.argument("logs", nargs=-1, type=click.Path(path_type=Path), metavar="LOG...")
@path_option("-o", "--output", text="calibration to write (JSON)")
@workers_options("1")
@config_options("input", "calibration")
@click.option("--overwrite", "output__overwrite", is_flag=True, default=None,
              help="replace an existing output")  # fmt: skip
@path_option(
    "--emit-config",
    metavar="FILE.toml",
    text="also write the rig with K_g scaled so that the error does not arise, by the axial value",
)
@path_option("--csv", "csv_file", metavar="FILE.csv", text="also write the runs as a table")
@path_option(
    "--report",
    metavar="FILE.html",
    text="also write a page of figures (.html), or the main one (.png, .pdf)",
)
@click.option("--plan", is_flag=True, help="print what a design would give; needs no log")
@click.option("--rates", type=Words(), default="20,40,60", show_default=True, metavar="DEG/S,...",
              help="with --plan: rates of the table, signed")  # fmt: skip
@click.option("--repeats", type=int, default=3, show_default=True, help="with --plan: at each rate")
@click.option("--lean", type=Words(), default="8e-4", show_default=True, metavar="RAD,...",
              help="with --plan: lean of the axis to the east at each position")  # fmt: skip
@click.option("--arw", type=float, default=5e-4, show_default=True, metavar="DEG/SQRT(H)",
              help="with --plan: angular random walk of the gyros")  # fmt: skip
@click.option("--latitude", type=float, metavar="DEG",
              help="with --plan: of the site [default: the rig's]")  # fmt: skip
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

    LOGs are recordings on the turntable at several constant rates, at one azimuth of its base or
    more: raw gyros and accelerometers (Imu) and the table's angle (JointState). A LOG may be a
    folder of logs, or a pattern in quotes. The rig is described by the table [rig] of --config.

    \b
    Example:
      sinstool calibrate-hse north.mcap south.mcap --config rig.toml -o hse.json
    """
    config = effective_config(config_file, flags)
    if show:
        print_config(config, "input", "calibration", "output", "rig")
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
    with commit_together(), progress_bar(f"{len(paths)} logs", batch.quiet) as progress:
        calibration = calibrate(paths, output, config, progress, workers)
        if emit_config is not None:
            write_rig(emit_config, calibration, config)
        if csv_file is not None:
            write_csv(csv_file, calibration, config.output.overwrite)
        if report is not None:
            from sinstool.report.pages.calibrate_hse import write_page

            write_page(report, calibration, config, paths)
    for text in calibration.warnings:
        warn(text)
    if batch.as_json:
        print_json({**calibration.to_json(), "output": str(output)})
    elif not batch.quiet:
        _print(calibration, output, batch.verbose > 0)
    return calibration.exit_status


def _arcsec(value: float | None, sigma: float | None = None, digits: int = 3) -> str:
    if value is None:
        return "not determined"
    text = f'{value / ARCSEC:.{digits}f}"'
    return text + (f' +- {sigma / ARCSEC:.{digits}f}"' if sigma is not None else "")


def _print(calibration: Calibration, output: Path, verbose: bool) -> None:
    file, fit = calibration.file, calibration.fit
    used = [r for r in file.runs if r.used]
    rates = sorted({round(r.rate_rad_s / DEGREE, 2) for r in used})
    slope = "not determined"
    if file.K_HSE_s is not None:
        sigma = "" if file.sigma_K_HSE_s is None else f" +- {file.sigma_K_HSE_s / ARCSEC:.3f}"
        slope = f'{file.K_HSE_s / ARCSEC:.3f}{sigma} "/(rad/s) where the axis leans as most'
    rows = [
        ("runs", f"{len(used)} of {len(file.runs)} in use, from {len(calibration.logs)} logs, at"
                 f" {', '.join(f'{r:g}' for r in rates)} deg/s"),
        ("lambda2", f"{_arcsec(file.lambda2_rad, file.sigma_lambda2_rad)} by {file.method}"
                    + (f", 95 % {_arcsec(file.ci95_lambda2_rad[0])} to"
                       f" {_arcsec(file.ci95_lambda2_rad[1])}" if file.ci95_lambda2_rad else "")),
        ("axial", f"{_arcsec(file.axial.lambda2_rad, file.axial.sigma_rad, 4)} by gyro rate along"
                  " the axis"),
        ("slope K", slope),
        ("lean C23", f"{file.C23_rad:.3e} +- {file.sigma_C23_rad:.1e} rad, latitude"
                     f" {file.latitude_rad / DEGREE:.4f} deg"),
    ]  # fmt: skip
    if file.delay_s is not None:
        sigma = "" if file.sigma_delay_s is None else f" +- {file.sigma_delay_s * 1e6:.3f}"
        rows.append(("encoder delay", f"{file.delay_s * 1e6:.3f}{sigma} us"))
    if fit.s is not None:
        chi2 = "" if fit.chi2 is None or not fit.dof else f", chi2/dof {fit.chi2 / fit.dof:.2f}"
        lack = "" if fit.p_lof is None else f", lack of fit p = {fit.p_lof:.3f}"
        rows.append(
            ("fit", f"scatter {_arcsec(fit.s)} a run, {fit.dof} degrees of freedom{chi2}{lack}")
        )
    rows += _headings(calibration)
    if verbose:
        for record in file.runs:
            note = record.reason or f"residual {_arcsec(record.resid_rad, digits=2)}"
            rows.append(
                (
                    record.id,
                    f"{record.rate_rad_s / DEGREE:+8.3f} deg/s, {record.n_turns} turns, heading"
                    f" {record.psi_rad / DEGREE:.5f} deg, {note}",
                )
            )
    rows.append(("status", file.status))
    rows.append(("written", str(output)))
    table(rows)


def _headings(calibration: Calibration) -> list[tuple[str, str]]:
    """How far headings lie apart before and after correction."""
    if calibration.table is not None and len(calibration.table.position_azimuth) > 1:
        before, after = calibration.table.before.scatter, calibration.table.after.scatter
        text = (
            f"{before.n} at {len(before.means)} azimuths, less azimuth: peak to peak"
            f" {_arcsec(before.peak_to_peak, digits=2)} before,"
            f" {_arcsec(after.peak_to_peak, digits=2)} after"
        )
    elif (largest := calibration.largest_spread) is not None:
        text = (
            f"within a position peak to peak {_arcsec(largest[0], digits=2)} before,"
            f" {_arcsec(largest[1], digits=2)} after"
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
    """What a design of runs would give."""
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
    sigma = ", ".join(_arcsec(s, digits=1) for s in plan.sigma_run)
    rows = [
        ("runs", f"{plan.n_runs} of {design.duration_s:g} s, {plan.total_s / 3600.0:.2f} h in all"),
        ("sigma of a heading", f"{sigma} at {', '.join(rates)} deg/s"),
        ("sigma of K", f'{plan.sigma_K / ARCSEC:.2f} "/(rad/s)'),
        ("sigma of lambda2", f"{_arcsec(plan.sigma_lambda2_heading)} by heading"),
        ("", f"{_arcsec(plan.sigma_lambda2_joint)} by joint"),
        ("", f"{_arcsec(plan.sigma_lambda2_axial, digits=4)} by the axial rate"),
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
