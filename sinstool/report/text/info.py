"""The text of `sinstool info`."""

from __future__ import annotations

from collections.abc import Sequence

import click

from sinstool.core.english import counted, in_seconds
from sinstool.core.finding import Finding, Severity
from sinstool.core.timeline import clock_time
from sinstool.io.readers.lost import LogLosses
from sinstool.pipelines.info.result import InspectedImu, Inspection, UnusableImu
from sinstool.report.text.table import table


def print_inspection(inspection: Inspection, verbose: bool) -> None:
    """Print the contents of a log."""
    source = inspection.input
    span = (source.end_ns - source.start_ns) / 1e9
    table(
        [
            ("log", f"{source.path} ({source.size / 1e6:.1f} MB)"),
            ("format", f"{source.format}, profile {source.profile or 'none'}"),
            ("messages", f"{source.messages} in {span:.3f} s"),
            ("from", clock_time(source.start_ns)),
            ("to", clock_time(source.end_ns)),
        ]
    )
    click.echo("\ntopics")
    names = [t.topic for t in inspection.topics]
    width = max((len(n) for n in names), default=0)
    for t in inspection.topics:
        rate = f"{t.rate_hz:.2f} Hz" if t.rate_hz else "-"
        odd = f", {t.out_of_order} out of order" if t.out_of_order else ""
        click.echo(
            f"  {t.topic:<{width}}  {t.n:>9}  {rate:>11}  {t.type}"
            f"  (longest interval {in_seconds(t.longest_interval_s, 3)}{odd})"
        )
    for imu in inspection.imu:
        _print_imu(imu, verbose)
    _print_lost(inspection.lost)
    click.echo(f"\n{inspection.process}")
    plan = inspection.process.plan
    if plan is not None and plan.wheels.value != "none":
        click.echo(f"wheels {plan.wheels}")
    _print_findings(inspection.process.findings)


def _print_lost(lost: LogLosses) -> None:
    if not lost.parts:
        return
    click.echo("")
    for part in lost.parts:
        click.echo(f"lost: {part}")
    if lost.messages_declared is not None:
        click.echo(
            f"recovered: {lost.messages_read} of {counted(lost.messages_declared, 'message')};"
            f" {counted(lost.chunks, 'chunk')} damaged"
        )


def _print_imu(imu: InspectedImu | UnusableImu, verbose: bool) -> None:
    click.echo(f"\nIMU {imu.topic}")
    if isinstance(imu, UnusableImu):
        click.echo(f"  {imu.problem}")
        return
    low, median, high = imu.interval_ms
    gyro = ", ".join(f"{v:.3g}" for v in imu.gyro_max_rad_s)
    rows = [
        ("  samples", f"{imu.n} at {imu.rate_hz:.3f} Hz, {imu.covered_s:.3f} s covered"),
        ("  interval", f"{low:.4g} / {median:.4g} / {high:.4g} ms (shortest, median, longest)"),
        (
            "  time",
            f"{'header stamps' if imu.time_source == 'stamp' else 'log times'};"
            f" {counted(imu.duplicates, 'duplicate')}, {imu.backward} backward,"
            f" {counted(imu.gaps, 'gap')}",
        ),
        ("  clocks", "log time less stamp {:+.4f} to {:+.4f} s".format(*imu.log_less_stamp_s)),
        ("  gyro", f"largest {gyro} rad/s on x, y, z"),
        ("  gravity", f"specific force mostly {imu.specific_force_m_s2:.3f} m/s^2"),
        ("  orientation", "given" if imu.orientation else "none"),
    ]
    spans = imu.still if verbose else imu.still[:3]
    for span in spans:
        bias = ", ".join(f"{b:.3e}" for b in span.gyro_bias_rad_s)
        axis = f", gravity on {span.gravity_axis}" if span.gravity_axis else ""
        turns = "; it turns at this rate, or the gyro's bias is large" if span.turning else ""
        rows.append(
            (
                "  steady" if span.turning else "  still",
                f"{span.duration_s:.1f} s from {span.start_s:.1f} s: mean rate {bias} rad/s{axis}"
                + turns,
            )
        )
    if not imu.still:
        rows.append(("  still", "never for a second"))
    table(rows)
    _print_findings(imu.findings)


def _print_findings(findings: Sequence[Finding]) -> None:
    for finding in findings:
        answer = f" -> {finding.answer}" if finding.answer else ""
        mark = "!" if finding.severity == Severity.FAILED else "*"
        click.echo(f"  {mark} {finding.text}{answer}")
