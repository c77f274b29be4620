"""Options made from the configuration models, so that flags and TOML keys are one thing."""

from __future__ import annotations

import types
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin

import click
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from sinstool.cli.choice import Choice
from sinstool.cli.complete import completion
from sinstool.config import ProcessConfig, build, dump_toml, load_toml

F = TypeVar("F", bound=Callable[..., Any])

METAVARS = {
    "start": "TIME",
    "end": "TIME",
    "initial_attitude": "ROLL,PITCH,HEADING",
    "gyro_bias": "X,Y,Z|still|none",
    "beta": "X,Y,Z",
    "emit": "TOPIC,...",
    "epsilon": "S",
    "beta_gain": "N",
    "imu_rate": "HZ",
    "max_gap": "S",
    "latitude": "DEG",
    "longitude": "DEG",
    "height": "M",
    "coning": "NAME",
    "passband": "HZ",
    "stopband": "HZ",
    "gyro_response": "RESPONSE",
    "imu_topic": "TOPIC",
    "gnss_topic": "TOPIC",
    "velocity_topic": "TOPIC",
    "baro_topic": "TOPIC",
    "encoder_topic": "TOPIC",
    "hse": "FILE",
    "initial_velocity": "N,E,D",
    "schmidt_epsilon": "X",
    "restart_after": "N",
    "withhold_gnss": "START:END",
    "gnss_sigma": "M",
    "gnss_noise_scale": "X",
    "lever_arm": "X,Y,Z",
    "gnss_latency": "S",
    "gnss_sigma_v": "M/S",
    "window": "S",
    "fade": "S",
    "align_start": "S",
    "align_end": "S",
    "at": "end|start|S",
    "lift_off": "S",
    "f_set": "M/S^2",
    "df_set": "M/S^3",
    "w_set": "DEG/S",
    "dw_set": "DEG/S^2",
    "t_set1": "S",
    "n_set1": "N",
    "t_set2": "S",
    "n_set2": "N",
    "gate_smooth": "N",
    "sigma_stop": "DEG",
    "sigma_bg": "DEG/H",
    "sigma_ba": "M/S^2",
    "sigma_sf": "X",
    "arw": "DEG/SQRT(H)",
    "vrw": "UG/SQRT(HZ)",
    "kappa": "X",
    "gyro_range": "DEG/S",
    "accel_range": "M/S^2",
    "tau": "S",
    "k4": "S",
    "baro_lag": "S",
    "qnh": "PA",
    "undulation": "M",
    "settle": "S",
    "min_turns": "N",
    "min_duration": "S",
    "align_duration": "S",
    "skip_warmup": "S",
    "exclude": "ID",
    "azimuth": "LOG=DEG",
    "gyro_bias_sigma": "DEG/H",
}


class Numbers(click.ParamType):
    """Comma-separated numbers, or one of a few words."""

    name = "numbers"

    def __init__(self, count: int, words: tuple[str, ...] = ()) -> None:
        self.count = count
        self.words = words

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...] | str:
        """Parse the text of an option."""
        if not isinstance(value, str) or value in self.words:
            return value
        try:
            numbers = tuple(float(part) for part in value.split(","))
        except ValueError:
            numbers = ()
        if len(numbers) != self.count:
            words = f" or one of {', '.join(self.words)}" if self.words else ""
            self.fail(f"'{value}' is not {self.count} numbers with commas between{words}", param)
        return numbers


class Words(click.ParamType):
    """Comma-separated words."""

    name = "words"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        """Split the text of an option."""
        if not isinstance(value, str):
            return tuple(value)
        return tuple(part.strip() for part in value.split(",") if part.strip())


def config_options(*groups: str) -> Callable[[F], F]:
    """Decorator: all options of the named groups of ProcessConfig, and --config.

    Parameters
    ----------
    *groups : str
        Field names of ProcessConfig.
    """

    def decorate(function: F) -> F:
        for group in reversed(groups):
            model = ProcessConfig.model_fields[group].annotation
            assert isinstance(model, type) and issubclass(model, BaseModel)
            for name, field in reversed(list(model.model_fields.items())):
                function = _option(group, name, field)(function)
        return click.option(
            "--config",
            "config_file",
            type=click.Path(path_type=Path),
            metavar="FILE",
            help="TOML file with options; flags win",
        )(function)

    return decorate


def _option(group: str, name: str, field: FieldInfo) -> Callable[[F], F]:
    flag = "--" + name.replace("_", "-")
    help_text = field.description or ""
    if field.annotation is bool:
        return click.option(flag, f"{group}__{name}", is_flag=True, default=None, help=help_text)
    default = field.default
    if default not in (None, ()) and not isinstance(default, bool):
        shown = ",".join(map(str, default)) if isinstance(default, tuple) else str(default)
        help_text += f" [default: {shown}]"
    kind = _click_type(field.annotation)
    return click.option(
        flag,
        f"{group}__{name}",
        type=kind,
        multiple=isinstance(kind, Words),
        default=None,
        metavar=METAVARS.get(name),
        help=help_text,
        shell_complete=completion(name),
    )


def _click_type(annotation: Any) -> click.ParamType:
    options = [annotation]
    if get_origin(annotation) in (Union, types.UnionType):
        options = [a for a in get_args(annotation) if a is not type(None)]
    words = tuple(w for a in options if get_origin(a) is Literal for w in get_args(a))
    tuples = [get_args(a) for a in options if get_origin(a) is tuple]
    if tuples and tuples[0][-1] is Ellipsis:
        return Words()
    if tuples:
        return Numbers(len(tuples[0]), words)
    if words:
        return Choice(words)
    if float in options:
        return click.FLOAT
    return click.INT if int in options else click.STRING


def effective_config(config_file: Path | None, given: dict[str, Any]) -> ProcessConfig:
    """Defaults, overlaid by the file, overlaid by flags.

    Parameters
    ----------
    config_file : Path, optional
    given : dict
        Keyword arguments of a command; those named ``group__name`` are options.

    Returns
    -------
    ProcessConfig

    Raises
    ------
    ConfigurationError
    """
    data: dict[str, Any] = {}
    if config_file is not None:
        data = load_toml(config_file)
        # The file alone first: its errors are then reported with its name.
        build(ProcessConfig, data, str(config_file), check=False)
    for key, value in given.items():
        group, separator, name = key.partition("__")
        if separator and value is not None and value != ():
            data.setdefault(group, {})[name] = _flat(value)
    config: ProcessConfig = build(ProcessConfig, data)
    return config


def _flat(value: Any) -> Any:
    """What was said in several options of one name, as one list."""
    if isinstance(value, tuple) and value and isinstance(value[0], tuple):
        return tuple(word for words in value for word in words)
    return value


def print_config(config: ProcessConfig, *without: str) -> None:
    """The effective configuration, less groups that do not concern a command, on stdout."""
    click.echo(dump_toml(config, *without), nl=False)
