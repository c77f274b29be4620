"""`sinstool compare-coning`: coning algorithms side by side."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sinstool.cli.console import print_json, progress_bar, warn
from sinstool.cli.options import Words, config_options, effective_config
from sinstool.errors import ConfigurationError, OutputError

if TYPE_CHECKING:
    from sinstool.compare_log import LogComparison
    from sinstool.figures import Figure


class Whole(click.ParamType):
    """Whole numbers with commas between."""

    name = "whole numbers"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, ...]:
        """Parse the text of an option."""
        if not isinstance(value, str):
            return tuple(value)
        try:
            numbers = tuple(int(part) for part in value.split(","))
        except ValueError:
            numbers = ()
        if not numbers or min(numbers) < 1:
            self.fail(f"'{value}' is not a list of whole numbers from 1 on", param)
        return tuple(dict.fromkeys((1, *numbers)))


@click.command("compare-coning")
@click.argument("log", type=click.Path(path_type=Path), required=False)
@click.option("--paper", is_flag=True, help="re-run the published experiment instead of a log")
@click.option("--algorithms", type=Words(), metavar="A,B,...", help="which [default: ten]")
@click.option(
    "--reference",
    default="auto",
    show_default=True,
    metavar="NAME",
    help="an algorithm, auto (quatfiter-4), or none",
)
@click.option(
    "--decimate",
    type=Whole(),
    default="1,2,4",
    show_default=True,
    metavar="M,...",
    help="lower rates to try: one sample of so many",
)
@click.option("--passband", type=float, metavar="HZ", help="coning up to here is motion")
@click.option("--stopband", type=float, metavar="HZ", help="coning from here on is noise")
@click.option(
    "--gyro-response",
    metavar="none|cheb:N,DB,HZ|butter:N,HZ|FILE",
    help="of the gyro; for gyro-tuned, and for --paper",
)
@click.option("--window", type=float, default=10.0, show_default=True, metavar="S", help="seconds")
@click.option(
    "--tolerance",
    type=float,
    default=0.01,
    show_default=True,
    metavar="DEG/H",
    help="drift that does not matter",
)
@click.option(
    "--sp-preset",
    type=click.Choice(["best", "paper", "auto"]),
    default="best",
    show_default=True,
    help="of singular-perturbation; auto tunes it to the passband",
)
@click.option("--truth", metavar="TOPIC|FILE", help="true attitude, to be the reference")
@click.option(
    "--phase",
    type=click.Choice(["consistent", "literal"]),
    default="consistent",
    show_default=True,
    help="with --paper: how eq. (20) is read",
)
@config_options("input")
@click.option("--csv", "csv_dir", type=click.Path(path_type=Path), help="folder for tables")
@click.option("--report", type=click.Path(path_type=Path), help="page (.html) or figure to write")
@click.option("--overwrite", is_flag=True, help="replace an existing report")
@click.option("--json", "as_json", is_flag=True, help="one JSON object on stdout")
@click.option("-q", "--quiet", is_flag=True, help="no progress")
@click.option("-v", "--verbose", is_flag=True, help="tracebacks for errors")
def command(log: Path | None, paper: bool, **options: Any) -> int:
    """Which coning algorithm, on LOG, and by how much.

    Runs the algorithms side by side on LOG, natively and as if it had been taken at lower rates,
    against the sharpest of them or --truth. With --paper it re-runs the published experiment
    instead, each printed figure beside ours.
    """
    if paper == (log is not None):
        raise click.UsageError("give a LOG to compare on, or --paper")
    if options["report"] is not None:
        from sinstool.report.page import check_report

        check_report(options["report"], inputs=[log] if log else [], overwrite=options["overwrite"])
    return _paper(options) if log is None else _log(log, options)


def _paper(options: dict[str, Any]) -> int:
    from sinstool.cli.compare_paper import run_paper

    def report(figures: Any) -> None:
        _write_report(
            options,
            "The published coning experiment, re-run",
            "",
            figures,
            {"phase": options["phase"], "gyro_response": options["gyro_response"] or "cheb:6"},
            [],
        )

    with progress_bar("the paper's experiment", options["quiet"]) as progress:
        run_paper(
            options["phase"],
            options["gyro_response"] or "cheb:6",
            options["algorithms"] or (),
            options["csv_dir"],
            options["as_json"],
            report if options["report"] is not None else None,
            progress,
        )
    return 0


def _log(log: Path, options: dict[str, Any]) -> int:
    given = {k: v for k, v in options.items() if "__" in k}
    config = effective_config(options["config_file"], given)
    if not options["window"] > 0.0 or not options["tolerance"] >= 0.0:
        raise click.UsageError("--window is positive and --tolerance not negative")
    from sinstool.compare_log import compare_log
    from sinstool.comparison.compare import DEFAULT_ALGORITHMS, Settings
    from sinstool.comparison.divergence import DEG_H
    from sinstool.comparison.summary import as_object, figures
    from sinstool.coning.registry import algorithm

    names = options["algorithms"] or DEFAULT_ALGORITHMS
    for name in (*names, *({options["reference"]} - {"auto", "none"})):
        algorithm(name)
    settings = Settings(
        tuple(dict.fromkeys(names)),
        options["reference"],
        options["decimate"],
        options["window"],
        options["tolerance"] / DEG_H,
    )
    folder = options["csv_dir"]
    if folder is not None and folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise OutputError(f"{folder} exists and is not an empty folder", "give another --csv")
    if options["sp_preset"] == "auto" and options["passband"] is None:
        raise ConfigurationError(
            "--sp-preset auto tunes to the coning in a passband", "give --passband HZ"
        )
    with progress_bar(log.name, options["quiet"]) as progress:
        found = compare_log(
            log,
            config,
            settings,
            passband=options["passband"],
            stopband=options["stopband"],
            gyro_response=options["gyro_response"],
            sp_preset=options["sp_preset"],
            truth=options["truth"],
            progress=progress,
        )
    result = as_object(found)
    for text in found.warnings:
        warn(text)
    if folder is not None:
        _write_csv(folder, result)
    if options["report"] is not None:
        settings_shown = result["meta"] | {"algorithms": ", ".join(settings.algorithms)}
        _write_report(
            options,
            "Coning algorithms compared",
            log.name,
            figures(found),
            settings_shown,
            list(found.warnings),
            result,
        )
    if options["as_json"]:
        print_json(result)
    else:
        _print(found, result)
    return 3 if found.lost else 0


COLUMNS: tuple[tuple[str, str, Callable[[dict[str, Any]], Any]], ...] = (
    ("algorithm", "", lambda a: a["name"]),
    ("kept", "", lambda a: "all" if a["decimate"] == 1 else f"1/{a['decimate']} {a['input']}"),
    ("updates", "Hz", lambda a: a["update_hz"]),
    ("drift rms", "deg/h", lambda a: a["drift_dph"] and a["drift_dph"]["norm_rms"]),
    *(
        (f"mean {axis}", "deg/h", lambda a, k=k: a["drift_dph"] and a["drift_dph"]["mean"][k])
        for k, axis in enumerate("xyz")
    ),
    (
        "2 sigma",
        "deg/h",
        lambda a: a["drift_dph"] and max(a["drift_dph"]["confidence"]),
    ),
    *(
        (f"predicted {axis}", "deg/h", lambda a, k=k: a["pred_dph"] and a["pred_dph"][k])
        for k, axis in enumerate("xyz")
    ),
    ("pseudo", "deg/h", lambda a: a["pseudo_dph"] and max(a["pseudo_dph"], key=abs)),
    ("largest", "deg", lambda a: a["largest_deg"]),
    ("cost", "ns/sample", lambda a: a["ns_per_sample"]),
)


def _size(vector: Any) -> float | None:
    """Length of a vector that may be missing."""
    return None if not vector else float(sum(v * v for v in vector) ** 0.5)


# The terminal has room for sizes; components are in --json, --csv and --report.
TERMINAL: tuple[tuple[str, str, Callable[[dict[str, Any]], Any]], ...] = (
    *COLUMNS[:4],
    ("mean", "deg/h", lambda a: _size(a["drift_dph"] and a["drift_dph"]["mean"])),
    ("2 sigma", "deg/h", lambda a: a["drift_dph"] and max(a["drift_dph"]["confidence"])),
    ("predicted", "deg/h", lambda a: _size(a["pred_dph"])),
    *COLUMNS[-3:],
)


def _cells(result: dict[str, Any]) -> list[tuple[Any, ...]]:
    return [tuple(get(a) for _, _, get in COLUMNS) for a in result["algs"]]


def _shown(value: Any) -> str:
    if isinstance(value, str):
        return value
    if value is None or value != value:
        return "-"
    return f"{value:.3g}"


def _print(found: LogComparison, result: dict[str, Any]) -> None:
    meta, reference = result["meta"], result["reference"]
    click.echo(
        f"{meta['imu_topic']}: {meta['samples']} samples in {meta['duration_s']:.1f} s at"
        f" {result['checks']['rate_hz']:.3f} Hz, {result['checks']['segments']} stretches,"
        f" read as {meta['gyro_kind']}"
    )
    resolution = reference["resolution_dph"]
    known = "" if resolution is None else f", good to about {resolution:.3g} deg/h"
    click.echo(f"reference: {reference['name']}{known}; axes are front, right, down\n")
    rows = [[f"{n} {u}".strip() for n, u, _ in TERMINAL]]
    rows += [[_shown(get(a)) for _, _, get in TERMINAL] for a in result["algs"]]
    for row, alg in zip(rows[1:], result["algs"], strict=True):
        if alg["drift_dph"] is not None and not alg["resolved"]:
            row[0] += " *"
    widths = [max(len(row[k]) for row in rows) for k in range(len(TERMINAL))]
    for row in rows:
        first = f"{row[0]:<{widths[0]}}  {row[1]:<{widths[1]}}"
        rest = "  ".join(f"{v:>{w}}" for v, w in zip(row[2:], widths[2:], strict=True))
        click.echo(f"{first}  {rest}")
    if reference["below_resolution"]:
        click.echo(
            "\n* below reference resolution: its divergence is less than ten times what the"
            " reference is good to"
        )
    for exception in dict.fromkeys(a["pred_exception"] for a in result["algs"]):
        if exception:
            names = {a["name"] for a in result["algs"] if a["pred_exception"] == exception}
            click.echo(f"prediction does not hold for {', '.join(sorted(names))}: {exception}")
    for alg in result["algs"]:
        if alg["caveat"] and alg["decimate"] == 1:
            click.echo(alg["caveat"])
    _print_sp(result["sp"])
    for alias in result["alias"]:
        lines = ", ".join(f"{f:.4g} Hz" for f in alias["lines_hz"])
        found_lines = f"; lines that would fold to rest: {lines}" if lines else ""
        click.echo(
            f"logged at {alias['rate_hz']:.4g} Hz by {alias['input']}: noise about its multiples"
            f" adds {alias['dc_alias_deg']:.3g} deg rms in {meta['window_s']:g} s{found_lines}"
        )
    click.echo(f"\n{found.comparison.verdict.text}")


def _print_sp(sp: dict[str, Any] | None) -> None:
    if sp is None:
        return
    tuning, limits = sp["tuning"], sp["bounds"]
    low, high = limits["epsilon_upper_s"][1:]
    click.echo(
        f"\nsingular perturbation, equivalent to {sp['equivalent']}: bound (13) on epsilon"
        f" {limits['epsilon_upper_s'][0]:.3g} s ({low:.3g} to {high:.3g}), bound (15) on n"
        f" {limits['gain_lower'][0]:.3g} ({limits['status']})"
    )
    if tuning["status"] == "tuned":
        before = max(map(abs, tuning["drift_best_dph"]))
        after = max(map(abs, tuning["drift_tuned_dph"]))
        click.echo(
            f"tuned to the passband: epsilon {tuning['epsilon_s']:.4g} s, n"
            f" {tuning['beta_gain']:.4f}; predicted drift {after:.3g} deg/h instead of"
            f" {before:.3g}"
        )
    else:
        click.echo(f"not tuned ({tuning['status']}): best is epsilon = T/2, n = 2")


def _write_csv(folder: Path, result: dict[str, Any]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "algorithms.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow([f"{n} [{u}]" if u else n for n, u, _ in COLUMNS])
        writer.writerows(_cells(result))
    with (folder / "pairs.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(["first", "second", "largest angle [deg]"])
        writer.writerows([p["first"], p["second"], p["largest_deg"]] for p in result["pairs"])


def _write_report(
    options: dict[str, Any],
    title: str,
    subtitle: str,
    figures: tuple[Figure, ...],
    settings: dict[str, Any],
    warnings: list[str],
    result: dict[str, Any] | None = None,
) -> None:
    from sinstool.report.page import write_report
    from sinstool.report.sections import Column, Page, Prose, Settings, Table, Warnings

    sections: list[Any] = [Warnings(tuple(warnings))]
    if result is not None:
        sections.append(Prose((result["verdict"]["text"],), "Verdict"))
        columns = tuple(Column(n, u, ".3g") for n, u, _ in COLUMNS)
        sections.append(Table("Algorithms", columns, tuple(_cells(result))))
    sections += [*figures, Settings(settings)]
    page = Page(title, subtitle, tuple(sections))
    write_report(options["report"], page, overwrite=options["overwrite"])
