"""`sinstool simulate SCENARIO --monte-carlo N`: the same motion with other errors, many times."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from sinstool.cli.console import print_json
from sinstool.cli.many import (
    Asked,
    finish,
    row_of,
    work_through,
    workers_of,
    workers_options,
)
from sinstool.core.errors import ConfigurationError
from sinstool.report.text.table import columns

# Digits of the seed in a name, so that names are in the order of seeds
DIGITS = 4


def with_monte_carlo(command: click.Command) -> None:
    """Let a scenario be made many times, and print what it makes.

    Parameters
    ----------
    command : click.Command
        Its function makes one log and returns what is said of it.
    """
    make = command.callback
    assert make is not None

    def run(monte_carlo: int | None, jobs: int | None, scheduler: str | None, **told: Any) -> int:
        if monte_carlo is not None and told["report"] is not None:
            raise click.UsageError("--report is about one log, --monte-carlo makes many")
        if monte_carlo is not None:
            asked = Asked(jobs, scheduler, told["as_json"], verbose=told["verbose"])
            return _many(str(command.name), told, monte_carlo, asked)
        if jobs is not None or scheduler is not None:
            raise click.UsageError("--jobs and --scheduler go with --monte-carlo")
        made = make(**told)
        if told["as_json"]:
            print_json(made)
        else:
            click.echo(f"{made['output']}: {_topics(made)}")
        return 0

    run = click.option(
        "--monte-carlo",
        type=click.IntRange(min=1),
        metavar="N",
        help="write N logs into the folder OUTPUT, with the seeds from --seed on",
    )(workers_options("one for each core")(run))
    # what click keeps of options until a command is made of a function
    command.params += reversed(run.__click_params__)  # type: ignore[attr-defined]
    command.callback = run
    _makers[str(command.name)] = make


_makers: dict[str, Any] = {}


def simulate_one(scenario: str, told: dict[str, Any], progress: Any) -> dict[str, Any]:
    """One of many logs.

    Parameters
    ----------
    told : dict
        Options of the command line.
    progress : callable
        Not called: a log is made at once.

    Raises
    ------
    SinstoolError
    """
    # A worker has imported no more than it was told to.
    import sinstool.cli.simulate  # noqa: F401

    del progress
    try:
        made: dict[str, Any] = _makers[scenario](**told)
    except click.ClickException as exc:
        raise ConfigurationError(exc.format_message()) from exc
    return {**made, "seed": told["seed"], "status": "done", "exit": 0}


def _many(scenario: str, told: dict[str, Any], count: int, asked: Asked) -> int:
    from sinstool.campaign.jobs import Job, Outcome
    from sinstool.core.whole_file import make_folder

    folder: Path = told["output"].absolute()
    seeds = range(told["seed"], told["seed"] + count)
    width = max(DIGITS, len(str(seeds[-1])))
    outputs = [folder / f"{scenario}-{seed:0{width}d}.mcap" for seed in seeds]
    workers = workers_of(asked, (), count)
    make_folder(folder)
    tasks = []
    for seed, output in zip(seeds, outputs, strict=True):
        own = {**told, "seed": seed, "output": output}
        if own.get("rig_out") is not None:
            # the same for all seeds
            own["rig_out"] = own["rig_out"].absolute() if seed == seeds[0] else None
        tasks.append(Job(output.name, simulate_one, (scenario, own), folders=(folder,)))

    def row(number: int, outcome: Outcome) -> dict[str, Any]:
        made = row_of(outcome, outputs[number])
        if outcome.error:
            return {"output": made.pop("input")["path"], "seed": seeds[number], **made}
        return made

    rows = work_through(tasks, workers, row, asked)
    cells = [
        (row["status"], str(row["seed"]), output.name, _topics(row))
        for row, output in zip(rows, outputs, strict=True)
    ]
    header = ("status", "seed", "log", "topics")
    return finish(rows, asked, lambda: columns(header, cells), f", in {told['output']}")


def _topics(made: dict[str, Any]) -> str:
    return ", ".join(f"{topic} ({count})" for topic, count in made.get("topics", {}).items())
