"""One comparison, from the options of the command line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from sinstool.cli.options import effective_config
from sinstool.config import ProcessConfig
from sinstool.core.errors import ConfigurationError
from sinstool.pipelines.compare_coning.compare import Settings
from sinstool.report.text.coning import write_csv


def told(options: dict[str, Any]) -> tuple[ProcessConfig, Settings]:
    """Configuration and settings of a comparison, from the options of the command line.

    Raises
    ------
    UsageError, ConfigurationError
        They do not fit each other, or there is no such algorithm.
    """
    given = {k: v for k, v in options.items() if "__" in k}
    config = effective_config(options["config_file"], given)
    if not options["window"] > 0.0 or not options["tolerance"] >= 0.0:
        raise click.UsageError("--window is positive and --tolerance not negative")
    from sinstool.methods.coning.registry import algorithm
    from sinstool.pipelines.compare_coning.compare import DEFAULT_ALGORITHMS, Settings
    from sinstool.pipelines.compare_coning.divergence import DEG_H

    if options["truth"] is not None and options["reference"] != "auto":
        raise click.UsageError("give --truth or --reference, not both")
    names = options["algorithms"] or DEFAULT_ALGORITHMS
    for name in (*names, *({options["reference"]} - {"auto", "none"})):
        algorithm(name)
    if options["sp_preset"] == "auto" and options["passband"] is None:
        raise ConfigurationError(
            "--sp-preset auto tunes to the coning in a passband", "give --passband HZ"
        )
    settings = Settings(
        tuple(dict.fromkeys(names)),
        options["reference"],
        options["decimate"],
        options["window"],
        options["tolerance"] / DEG_H,
    )
    return config, settings


def compare_one(
    log: Path,
    config: ProcessConfig,
    settings: Settings,
    options: dict[str, Any],
    progress: Callable[[float], None] | None,
) -> dict[str, Any]:
    """Compare on a log, and write what is asked for beside.

    Parameters
    ----------
    options : dict
        Of the command line.
    progress : callable, optional
        Called with the fraction done.

    Returns
    -------
    dict
        The comparison as plain values.

    Raises
    ------
    SinstoolError
    """
    from sinstool.core.whole_file import commit_together
    from sinstool.pipelines.compare_coning.log import compare_log
    from sinstool.pipelines.compare_coning.summary import as_object
    from sinstool.report.figures.coning import figures

    taken = ("passband", "stopband", "gyro_response", "sp_preset", "truth")
    found = compare_log(
        log, config, settings, progress=progress, **{name: options[name] for name in taken}
    )
    result = as_object(found)
    with commit_together():
        if options["csv_dir"] is not None:
            write_csv(options["csv_dir"], result)
        if options["report"] is not None:
            from sinstool.cli.compare_coning import command
            from sinstool.report.pages.compare_coning import write_comparison

            write_comparison(
                command, options, log.name, figures(found), config, settings.algorithms, result
            )
    return result
