"""`sinstool compare-coning --paper`: a published experiment, repeated and compared."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import click
import numpy as np

from sinstool.cli.console import print_json
from sinstool.config import ProcessConfig
from sinstool.core.progress import Progress
from sinstool.core.whole_file import WholeFile, commit_together, make_folder
from sinstool.pipelines.compare_coning.paper import Reproduction, reproduce
from sinstool.pipelines.compare_coning.paper_claims import low_level
from sinstool.pipelines.compare_coning.paper_experiment import RESPONSES, noise_rate_deg
from sinstool.pipelines.compare_coning.paper_sweep import Sweep
from sinstool.report.page import check_report, write_report
from sinstool.report.pages.compare_coning import reproduction_page
from sinstool.report.text.table import columns
from sinstool.simulation.coning_paper import FREQUENCY_HZ, RATE_HZ, paper_response, response_name

SCHEMA = "sinstool.compare-coning-paper/1"
CSV_HEADER = (
    "noise_frequency_hz,error_x_deg,error_y_deg,error_z_deg,error_length_deg,largest_error_deg"
)


def run_paper(
    config: ProcessConfig,
    csv: Path | None,
    report: Path | None,
    overwrite: bool,
    as_json: bool,
    progress: Progress | None,
) -> None:
    """Run the published experiment again, write its sweeps and its page, and print it.

    Parameters
    ----------
    csv : Path or None
        Folder for one CSV file a sweep.
    report : Path or None
        Page of figures, or one figure.
    overwrite : bool
        Whether the report may be replaced.
    as_json : bool
        One JSON object on stdout instead of tables.
    progress : callable or None
        Takes the fraction done.

    Raises
    ------
    ConfigurationError
        The gyro's response cannot be understood.
    OutputError
        An output cannot be written.
    """
    check_report(report, overwrite=overwrite)
    comparison = config.comparison
    response = paper_response(config.coning.gyro_response or "cheb:6")
    reproduction = reproduce(comparison.phase, response, comparison.algorithms, progress=progress)
    with commit_together():
        files = [] if csv is None else write_sweeps(reproduction, csv)
        if report is not None:
            write_report(report, reproduction_page(reproduction, config), overwrite=overwrite)
    if as_json:
        print_json(as_object(reproduction) | {"csv": [str(path) for path in files]})
    else:
        _print(reproduction)
        if csv is not None:
            click.echo(f"\n{csv}: {len(files)} sweeps as CSV")


def write_sweeps(reproduction: Reproduction, folder: Path) -> list[Path]:
    """Write every sweep as a CSV file.

    Parameters
    ----------
    folder : Path
        Made if it does not exist.

    Returns
    -------
    list of Path
        Named by reading of eq. 20, gyro and algorithm.

    Raises
    ------
    OutputError
        If the folder cannot be written.
    """
    make_folder(folder)
    files = []
    for (setting, key), sweep in reproduction.experiment.sweeps.items():
        gyro = re.sub(r"[^\w.]+", "-", setting.gyro)
        path = folder / f"{setting.phase}_{gyro}_{key}.csv"
        columns = np.column_stack([sweep.frequency, sweep.end_deg, sweep.norm_deg, sweep.peak_deg])
        with WholeFile(path) as whole:
            np.savetxt(
                whole.stream, columns, fmt="%.10g", delimiter=",", header=CSV_HEADER, comments=""
            )
        files.append(path)
    return files


def as_object(reproduction: Reproduction) -> dict[str, Any]:
    """Everything that is printed, as plain values.

    Returns
    -------
    dict
        With keys ``schema``, ``settings``, ``claims``, ``algorithms``, ``table_1`` and ``gyros``.
    """
    experiment = reproduction.experiment
    return {
        "schema": SCHEMA,
        "settings": {
            "phase": experiment.setting.phase,
            "gyro_response": experiment.setting.gyro,
            "frequencies": len(experiment.frequency),
            "sweeps": len(experiment.sweeps),
        },
        "reproduces": reproduction.agreeing,
        "does_not": len(reproduction.claims) - reproduction.agreeing,
        "claims": [vars(claim) for claim in reproduction.claims],
        "algorithms": _algorithms(reproduction),
        "table_1": _table_1(reproduction),
        "gyros": _gyros(),
    }


def _algorithms(reproduction: Reproduction) -> list[dict[str, Any]]:
    experiment = reproduction.experiment
    rows = []
    for case in experiment.cases:
        sweep = experiment.sweep(case.key)
        cost = experiment.costs[case.key]
        rows.append(
            {
                "key": case.key,
                "label": case.label,
                "feed": case.feed,
                "update_hz": RATE_HZ / case.algorithm.samples,
                "mean_z_deg": sweep.mean_deg,
                "mean_z_without_jumps_deg": experiment.mean_without_jumps(sweep),
                "level_deg": low_level(sweep),
                "error_deg": _at_frequencies(sweep, sweep.norm_deg),
                "largest_error_deg": _at_frequencies(sweep, sweep.peak_deg),
                "z_deg": _at_frequencies(sweep, sweep.z_deg),
                "update_ns": 1e9 * cost.update_s,
                "data_ns_per_s": 1e9 * cost.data_s,
            }
        )
    return rows


_FREQUENCIES = (0.0, 30.0, 100.0, 130.0, 200.0, 230.0, 399.0, 400.0, 401.0, 800.0)


def _at_frequencies(sweep: Sweep, values: np.ndarray) -> dict[str, float]:
    return {f"{f:g}": float(values[sweep.row(f)]) for f in _FREQUENCIES}


_MEANS = {
    "optimal-4": "rect-opt4",
    "SP truncated": "sp-paper-truncated",
    "SP printed": "sp-paper-printed",
    "rectangle": "rect",
    "optimal-4 inc.": "inc-optimal-4",
}


def _table_1(reproduction: Reproduction) -> list[dict[str, Any]]:
    experiment = reproduction.experiment
    return [
        {
            "phase": setting.phase,
            "gyro_response": setting.gyro,
            "mean_z_deg": {
                name: experiment.sweep(key, setting).mean_deg for name, key in _MEANS.items()
            },
            "mean_z_without_jumps_deg": {
                name: experiment.mean_without_jumps(experiment.sweep(key, setting))
                for name, key in _MEANS.items()
            },
        }
        for setting in experiment.settings
    ]


def _gyros() -> list[dict[str, Any]]:
    return [
        {
            "gyro_response": response_name(one),
            "gain_30_hz": float(one(FREQUENCY_HZ)),
            "noise_deg_s": {f"{f:g}": noise_rate_deg(one, f) for f in (RATE_HZ, 2.0 * RATE_HZ)},
        }
        for one in RESPONSES
    ]


def _print(reproduction: Reproduction) -> None:
    experiment = reproduction.experiment
    click.echo(
        "Fu and Luo's experiment: a cone of 0.1 deg and 30 Hz at 400 Hz for ten seconds, noise of"
        f"\n0.01 deg at {len(experiment.frequency)} frequencies from 0 to 1000 Hz;"
        f" {experiment.setting.name}"
    )
    click.echo("\nWhat the paper prints, and ours\n")
    source = ""
    for claim in reproduction.claims:
        if claim.source != source:
            source = claim.source
            click.echo(source)
        ours = f"{claim.ours:.3g} {claim.unit}".strip()
        paper = f"paper {claim.paper}, ours {ours}"
        click.echo(f"  {claim.statement}: {paper}")
        verdict = f"{claim.verdict.upper()} ({claim.tolerance}): {claim.why}"
        click.echo(click.wrap_text(verdict, 100, " " * 6, " " * 8))
    click.echo(f"\n{reproduction.agreeing} of {len(reproduction.claims)} claims reproduce")
    click.echo(
        "\nAlgorithms: mean of signed z error; level: median |z|, 1 to 199 Hz; error after 10 s at"
        "\n400 and 800 Hz; time of one update of the attitude, and of a second of data\n"
    )
    header = ("algorithm", "mean deg", "level deg", "400 Hz", "800 Hz", "ns/update", "us/s")
    rows = [
        (
            row["label"],
            f"{row['mean_z_deg']:.5f}",
            f"{row['level_deg']:.5f}",
            f"{row['error_deg']['400']:.5f}",
            f"{row['error_deg']['800']:.5f}",
            f"{row['update_ns']:.1f}",
            f"{1e-3 * row['data_ns_per_s']:.1f}",
        )
        for row in _algorithms(reproduction)
    ]
    columns(header, rows)
    click.echo("\nTable 1 (paper: optimal-4 -0.0038, SP -0.0024): mean of signed z error, deg\n")
    means = [
        (
            f"{row['phase']}, {row['gyro_response']}",
            *(f"{row['mean_z_deg'][name]:.5f}" for name in _MEANS),
        )
        for row in _table_1(reproduction)
    ]
    columns(("reading, gyro", *_MEANS), means)
    click.echo("\nGyros (paper: below 0.02 and 0.002 deg/s at 400 Hz): noise behind the filter\n")
    gyros = [
        (
            row["gyro_response"],
            f"{row['gain_30_hz']:.5f}",
            *(f"{row['noise_deg_s'][f]:.5f}" for f in ("400", "800")),
        )
        for row in _gyros()
    ]
    columns(("gyro", "gain 30 Hz", "400 Hz deg/s", "800 Hz deg/s"), gyros)
