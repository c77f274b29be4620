"""`sinstool process`: recorded IMU to corrected attitude."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from sinstool.cli.console import print_json, progress_bar, table, warn
from sinstool.cli.options import config_options, effective_config, print_config


@click.command("process")
@click.argument("log", type=click.Path(path_type=Path), required=False)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="MCAP file to write")
@config_options(
    "input",
    "coning",
    "align",
    "gnss",
    "in_flight",
    "navigation",
    "filter",
    "vertical",
    "hse",
    "output",
)
@click.option("--print-config", "show", is_flag=True, help="print the configuration and stop")
@click.option("--json", "as_json", is_flag=True, help="one JSON object on stdout")
@click.option("-q", "--quiet", is_flag=True, help="no progress and no summary")
@click.option("-v", "--verbose", is_flag=True, help="explain choices; tracebacks for errors")
def command(
    log: Path | None,
    output: Path | None,
    config_file: Path | None,
    show: bool,
    as_json: bool,
    quiet: bool,
    verbose: bool,
    **given: Any,
) -> int:
    """Recorded IMU of LOG to corrected attitude, written to OUTPUT as MCAP.

    LOG is an MCAP file, a ROS 1 bag, a ROS 2 bag directory or a single .db3. Its own messages
    are copied byte for byte; /sinstool/imu and /sinstool/attitude are added.

    \b
    Example:
      sinstool process flight.mcap -o flight.attitude.mcap --align level
    """
    config = effective_config(config_file, given)
    if show:
        print_config(config, "calibration")
        return 0
    if log is None:
        raise click.UsageError("give a LOG to process")
    if output is None:
        raise click.UsageError("give the output with -o FILE")
    from sinstool.pipeline import process
    from sinstool.summary import something_lost

    with progress_bar(log.name, quiet) as progress:
        summary = process(log, output, config, progress)
    for text in summary["warnings"]:
        warn(text)
    if as_json:
        print_json(summary)
    elif not quiet:
        _print(summary, verbose)
    return 3 if something_lost(summary) else 0


def _print(summary: dict[str, Any], verbose: bool) -> None:
    imu, align, final = summary["imu"], summary["alignment"], summary["final"]
    coning, out = summary["coning"], summary["output"]
    sigma = align["sigma_deg"][0]
    tilt = f", sigma {sigma:.2g} deg" if sigma is not None else ""
    bias = ", ".join(f"{b:.3e}" for b in align["gyro_bias_rad_s"])
    rows = [
        ("log", f"{summary['input']['path']} ({summary['input']['size'] / 1e6:.1f} MB)"),
        (
            "IMU",
            f"{imu['topic']}: {imu['n']} samples at {imu['rate_hz']:.3f} Hz,"
            f" {imu['gaps']} gaps, {imu['dropped']} dropped",
        ),
        (
            "alignment",
            f"{align['method']} ({align['status']}): roll {align['roll_deg']:.3f}, pitch"
            f" {align['pitch_deg']:.3f}, heading {align['heading_deg']:.3f} deg{tilt}"
            + ("" if align["north_referenced"] else "; heading is not referenced to north"),
        ),
        ("gyro bias", f"{align['gyro_bias_source']}: {bias} rad/s (FRD)"),
    ]
    if coning is not None:
        rows.append(
            (
                "coning",
                f"{coning['algorithm']}, {coning['samples_per_update']} sample(s) an update, gyro"
                f" read as {coning['gyro_kind']}",
            )
        )
    if summary["hse"] is not None:
        rows += _hse(summary["hse"])
    rows += [
        (
            "final",
            f"roll {final['roll_deg']:.3f}, pitch {final['pitch_deg']:.3f},"
            f" heading {final['heading_deg']:.3f} deg",
        ),
        (
            "written",
            f"{out['path']}: {out['attitudes']} attitudes in frame {out['frame']},"
            f" topics {', '.join(out['topics'])}",
        ),
    ]
    if verbose:
        if coning is not None:
            rows.append(("coning source", coning["source"]))
        rows.append(("input sha256", summary["input"]["sha256"]))
    table(rows)


def _hse(hse: dict[str, Any]) -> list[tuple[str, str]]:
    """Heading before and after, stretch by stretch."""
    return [
        (
            "heading" if k == 0 else "",
            f"at {s['rate_deg_s']:+.3f} deg/s, {s['turns']} turns: {s['heading_raw_deg']:.6f} deg,"
            f" corrected by {-s['correction_arcsec']:+.3f}"
            f"{_sigma(s['sigma_correction_arcsec'])} arcsec: {s['heading_deg']:.6f} deg"
            f"{_sigma(s['sigma_heading_arcsec'])} arcsec",
        )
        for k, s in enumerate(hse["segments"])
    ]


def _sigma(value: float | None) -> str:
    return "" if value is None else f" +- {value:.3f}"
