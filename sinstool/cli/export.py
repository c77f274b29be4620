"""`sinstool export`: a result as a table, a trajectory or a track on a map; one or many."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from sinstool.campaign.inputs import are_many, find_logs, output_paths
from sinstool.cli import many
from sinstool.cli.batch import EXIT_HELP, BatchOptions, batch_options, show_result, workers_options
from sinstool.cli.console import PathName, progress_bar
from sinstool.cli.help import Command
from sinstool.cli.options import config_options, effective_config, path_option, print_config
from sinstool.config import EXPORT_OPTIONS, ProcessConfig
from sinstool.report.text.export import summary_rows

MAIN = ("output", "export__rate", "input__start", "input__end", "output__overwrite")
HEADER = ("frame", "rows", "of")


@click.command("export", cls=Command, first=MAIN, epilog=EXIT_HELP)
@click.argument("results", nargs=-1, type=PathName(), metavar="RESULT...")
@path_option("-o", "--output", text="file to write (.csv, .parquet, .tum, .kml, .gpx, .geojson); a"
             " folder for many results")  # fmt: skip
@workers_options("one for each core")
@config_options(*EXPORT_OPTIONS)
@batch_options("the names of the columns", json_of=", or one line for each result")
def command(
    results: tuple[Path, ...],
    output: Path | None,
    config_file: Path | None,
    show: bool,
    batch: BatchOptions,
    **flags: Any,
) -> int:
    """Write a RESULT of sinstool process as a table, a trajectory or a track on a map.

    The suffix of OUTPUT is the format: .csv and .parquet hold every number of the result under a
    name with its unit, .tum is what evo reads, and .kml, .gpx and .geojson are for maps.

    \b
      sinstool export drive.result.mcap -o drive.csv
      sinstool export drive.result.mcap -o drive.kml --rate 1
      sinstool export results/ -o tables/ --format parquet
    """
    config = effective_config(config_file, flags)
    if show:
        print_config(config, *EXPORT_OPTIONS)
        return 0
    if not results:
        raise click.UsageError("give a RESULT to export: an MCAP of sinstool process")
    if output is None:
        raise click.UsageError("give the output with -o FILE")
    if are_many(results):
        return export_many(results, output, config, batch)
    if batch.scheduler is not None:
        raise click.UsageError("--scheduler is for many results")
    from sinstool.pipelines.export.run import export, format_of

    suffix = output.suffix.lower().removeprefix(".")
    if config.export.format not in (None, suffix):
        raise click.UsageError(
            f"--format {config.export.format} and -o {output} contradict each other"
        )
    format_of(output, config)
    with progress_bar(results[0].name, batch.quiet) as progress:
        result = export(results[0], output, config, progress)
    return show_result(result, batch, summary_rows)


def export_many(
    inputs: Sequence[Path], folder: Path, config: ProcessConfig, batch: BatchOptions
) -> int:
    """Export results, each to a file of its own.

    Parameters
    ----------
    inputs : sequence of Path
        Files, folders, patterns.
    folder : Path
        Folder for the outputs.

    Returns
    -------
    int
        Exit status.
    """
    from sinstool.pipelines.export.run import export

    if folder.suffix and not folder.is_dir():
        raise click.UsageError(
            f"-o {folder}: with many results give a folder, which gets a file for each"
        )
    if config.export.format is None:
        raise click.UsageError(f"-o {folder} is a folder: give the format with --format")
    results = find_logs(inputs, without=folder)
    outputs = output_paths(results, folder, f".{config.export.format}")
    written = [(path.absolute(),) for path in outputs]
    rows = many.work_on_logs(results, export, written, (config,), [], batch, named=True)
    names = [str(result.path) for result in results]
    return many.finish(
        names, rows, batch, lambda: many.log_table(HEADER, results, rows, _cells), f", in {folder}"
    )


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    if "rate_hz" not in row:
        return ("-",) * len(HEADER)
    return (row["input"]["frame"] or "-", str(row["output"]["rows"]), str(row["input"]["rows"]))
