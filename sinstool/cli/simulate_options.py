"""Options that all scenarios of `sinstool simulate` share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import click

from sinstool.cli.choice import Choice
from sinstool.cli.verbose import verbose_option

F = TypeVar("F", bound=Callable[..., Any])
START_NS = 1_700_000_000_000_000_000
MAX_RATE_HZ = 1e6
MAX_DURATION_S = 1e6


def common(duration: float = 60.0, rate: float = 400.0, kind: str = "rate") -> Callable[[F], F]:
    """Options of every scenario, with its own defaults.

    Parameters
    ----------
    duration : float
        s.
    rate : float
        Hz.
    kind : str
        Of the gyro's samples.
    """
    options = [
        click.option(
            "-o", "--output", type=click.Path(path_type=Path), required=True, help="MCAP to write"
        ),
        click.option("--duration", type=float, default=duration, show_default=True, help="seconds"),
        click.option("--rate", type=float, default=rate, show_default=True, help="samples/s, Hz"),
        click.option(
            "--gyro-kind",
            type=Choice(["rate", "mean-rate", "increment"]),
            default=kind,
            show_default=True,
            help="what the Imu topic carries",
        ),
        click.option(
            "--body-axes",
            type=Choice(["flu", "frd"]),
            default="flu",
            show_default=True,
            help="axes of the Imu topic; the truth's world is ENU for flu, NED for frd",
        ),
        click.option(
            "--grade",
            type=Choice(["perfect", "navigation", "tactical", "mems"]),
            default="perfect",
            show_default=True,
            help="sensor errors",
        ),
        click.option("--seed", type=int, default=0, show_default=True, help="of the errors"),
        click.option(
            "--truth/--no-truth",
            default=True,
            show_default=True,
            help="write /truth/... beside the sensors",
        ),
        click.option(
            "--report",
            type=click.Path(path_type=Path),
            metavar="FILE.html",
            help="also write a page of figures, or its first one (.png, .pdf, .svg)",
        ),
        click.option("--overwrite", is_flag=True, help="replace existing outputs"),
        click.option("--json", "as_json", is_flag=True, help="one JSON object on stdout"),
        verbose_option(),
    ]

    def decorate(function: F) -> F:
        for option in reversed(options):
            function = option(function)
        return function

    return decorate


def check_outputs(told: Mapping[str, Any]) -> None:
    """Refuse a log or a report that could not be written, before anything is computed.

    Parameters
    ----------
    told : mapping
        Options ``output``, ``report`` and ``overwrite``.
    """
    from sinstool.core.whole_file import check_output

    check_output(told["output"], [], told["overwrite"])
    if told["report"] is not None:
        from sinstool.report.page import check_report

        check_report(told["report"], inputs=[told["output"]], overwrite=told["overwrite"])


def write_log(
    told: Mapping[str, Any],
    topics: Sequence[Any],
    settings: dict[str, str],
    write_page: Callable[[Mapping[str, Any]], None],
    beside: Callable[[], None] | None = None,
) -> dict[str, Any]:
    """Write a log, its page and what else there is beside it, all or nothing.

    Parameters
    ----------
    told : mapping
        Options ``output`` and ``report``.
    settings : dict
        How the log was made.
    write_page : callable
        Takes all options of the command; called where a page is wanted.
    beside : callable, optional
        Writes another file.

    Returns
    -------
    dict
        What was written, as ``--json`` says it.
    """
    from sinstool.core.whole_file import commit_together
    from sinstool.simulation.log import write_simulated

    output = told["output"]
    with commit_together():
        counts = write_simulated(output, topics, settings)
        if beside is not None:
            beside()
        if told["report"] is not None:
            write_page(click.get_current_context().params)
    return {"output": str(output), "topics": counts, "settings": settings}


def check(duration: float, rate: float, seed: int) -> None:
    """Refuse what no log can be made of."""
    if not 0.0 < rate <= MAX_RATE_HZ:
        raise click.UsageError(f"--rate is {rate}, not above 0 and at most {MAX_RATE_HZ:g}")
    if not 0.0 < duration <= MAX_DURATION_S:
        raise click.UsageError(
            f"--duration is {duration}, not above 0 and at most {MAX_DURATION_S:g}"
        )
    if duration * rate < 1.0:
        raise click.UsageError("--duration holds no sample interval")
    if seed < 0:
        raise click.UsageError(f"--seed is {seed}, not zero or more")
