"""`sinstool simulate`: logs with exact truth, also many with different errors."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import click
from pydantic import create_model

from sinstool.cli import many
from sinstool.cli.batch import BatchOptions, batch_options, workers_of, workers_options
from sinstool.cli.console import Group, PathName, print_json
from sinstool.cli.help import Command
from sinstool.cli.options import config_options, effective, path_option, print_config
from sinstool.core.options import Group as Options
from sinstool.simulation.scenarios import SCENARIOS, HseRig, Scenario

# A line of the list of scenarios, which has no room for a whole sentence
BRIEF = {
    "coning": "Classical coning, exact for any angle.",
    "coning-paper": "The published coning experiment.",
    "two-frequency": "Two conings at once, which alias.",
    "broadband": "Coning at all frequencies of a band.",
    "manoeuvre": "Random rotation about all three axes.",
    "static": "At rest on the rotating Earth.",
    "spiral-climb": "The published flight with baro and GNSS.",
    "manoeuvring-flight": "A turbulent flight with baro and GNSS.",
    "drive": "A car with stops, turns, GNSS and wheels.",
    "launch": "A launched vehicle with GNSS.",
    "hse-rig": "A rate-biased system on its turntable.",
}
# Digits of the seed in a name, so that names are in the order of seeds
DIGITS = 4


class Scenarios(Group):
    """The kinds of log."""

    what = "scenario"


@click.group("simulate", cls=Scenarios)
def command() -> None:
    """Simulate a log with exact truth: /imu/data_raw with /truth/imu and /truth/odometry.

    \b
      sinstool simulate drive -o drive.mcap --grade mems
      sinstool simulate drive --help    its options
    """


def _scenario_command(name: str, kind: type[Scenario]) -> click.Command:
    # A file has the options of a scenario in its table [simulate].
    model = create_model("Simulation", __base__=Options, simulate=(kind, kind()))

    @click.command(
        name,
        cls=Command,
        first=("output",),
        help=inspect.getdoc(kind),
        short_help=BRIEF[name],
    )
    @path_option("-o", "--output", text="MCAP file to write; a folder for many logs")
    @config_options("simulate", model=model)
    @click.option(
        "--monte-carlo",
        type=click.IntRange(min=1),
        metavar="N",
        help="write N logs to the folder OUTPUT, with seeds from --seed on",
    )
    @workers_options("one for each core")
    @path_option("--report", metavar="FILE.html", text="also write a page of figures, or its first"
                 " one (.png, .pdf, .svg)")  # fmt: skip
    @click.option("--overwrite", is_flag=True, help="replace existing outputs")
    @batch_options(json_of="")
    def run(
        output: Path | None,
        config_file: Path | None,
        monte_carlo: int | None,
        report: Path | None,
        overwrite: bool,
        show: bool,
        batch: BatchOptions,
        rig_out: Path | None = None,
        **flags: Any,
    ) -> int:
        config = effective(model, config_file, flags)
        if show:
            print_config(config, "simulate")
            return 0
        scenario: Scenario = config.simulate  # type: ignore[attr-defined]
        scenario.check()
        if output is None:
            raise click.UsageError("give the output with -o FILE")
        if monte_carlo is not None:
            if report is not None:
                raise click.UsageError("--report is for a single log, and --monte-carlo makes many")
            return _many(scenario, monte_carlo, output, rig_out, overwrite, batch)
        if batch.jobs is not None or batch.scheduler is not None:
            raise click.UsageError("--jobs and --scheduler go with --monte-carlo")
        from sinstool.core.whole_file import commit_together
        from sinstool.report.page import check_report, write_report
        from sinstool.simulation import make

        files = make.LogFiles(output, rig_out, overwrite)
        files.check()
        check_report(report, inputs=[output], overwrite=overwrite)
        simulated = make.simulate(scenario)
        with commit_together():
            written = make.write_log(simulated, files)
            if report is not None:
                from sinstool.report.pages.simulate import simulation_page

                page = simulation_page(simulated, config, output)
                write_report(report, page, inputs=[output], overwrite=overwrite)
        if batch.as_json:
            print_json(written)
        elif not batch.quiet:
            click.echo(f"{output}: {_topics(written)}")
        return 0

    return run


def _many(
    scenario: Scenario,
    count: int,
    output: Path,
    rig_out: Path | None,
    overwrite: bool,
    batch: BatchOptions,
) -> int:
    from sinstool.campaign.jobs import Job, Outcome
    from sinstool.core.whole_file import make_folder
    from sinstool.report.text.table import columns
    from sinstool.simulation.make import LogFiles, name_of, simulate_one

    if output.suffix.lower() == ".mcap" and not output.is_dir():
        raise click.UsageError(f"-o {output}: with --monte-carlo give a folder for the logs")
    folder = output.absolute()
    seeds = range(scenario.seed, scenario.seed + count)
    width = max(DIGITS, len(str(seeds[-1])))
    outputs = [folder / f"{name_of(scenario)}-{seed:0{width}d}.mcap" for seed in seeds]
    workers = workers_of(batch, (), count)
    make_folder(folder)
    jobs = []
    for seed, log in zip(seeds, outputs, strict=True):
        # the rig is the same for all seeds
        rig = None if rig_out is None or seed != seeds[0] else rig_out.absolute()
        own = scenario.model_copy(update={"seed": seed})
        arguments = (own, LogFiles(log, rig, overwrite))
        jobs.append(Job(log.name, simulate_one, arguments, folders=(folder,)))

    def row(number: int, outcome: Outcome) -> dict[str, Any]:
        written = many.row_of(outcome, outputs[number])
        if outcome.error:
            return {"output": written.pop("input")["path"], "seed": seeds[number], **written}
        return written

    rows = many.work_through(jobs, workers, row, batch)
    cells = [
        (row["status"], str(row["seed"]), log.name, _topics(row))
        for row, log in zip(rows, outputs, strict=True)
    ]
    header = ("status", "seed", "log", "topics")
    return many.finish(
        [log.name for log in outputs], rows, batch, lambda: columns(header, cells), f", in {output}"
    )


def _topics(written: dict[str, Any]) -> str:
    return ", ".join(f"{topic} ({count})" for topic, count in written.get("topics", {}).items())


_RIG_OUT = click.Option(
    ["--rig-out"],
    type=PathName(),
    metavar="RIG.toml",
    help="also write the rig as its user believes it to be, for --config",
)
for _name, _kind in SCENARIOS.items():
    _command = _scenario_command(_name, _kind)
    if _kind is HseRig:
        _command.params.insert(1, _RIG_OUT)
    command.add_command(_command)
