"""What a run is told: one model for the command line and the TOML file, validated once.

Each field is an option ``--name`` (underscores become hyphens) and a key of its group's table
in the file; the command line generates its options from these models, so the two cannot part.
"""

from __future__ import annotations

import tomllib
from datetime import UTC, datetime
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any, Literal

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from sinstool.coning.registry import algorithm, names
from sinstool.errors import ConfigurationError

EMITS = ("imu", "attitude", "euler", "pose", "tf")


class _Group(BaseModel):
    """Options that belong together: a table of the configuration file."""

    # strict: a word is no number and a number is no yes or no
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _tuples(cls, data: Any) -> Any:
        """Lists, which TOML has, as the tuples that strict models want."""
        if not isinstance(data, dict):
            return data
        return {k: tuple(v) if isinstance(v, list) else v for k, v in data.items()}


class InputOptions(_Group):
    """Which data of the log, and what it means."""

    imu_topic: str | None = Field(None, description="topic with the Imu messages")
    gnss_topic: str | None = Field(None, description="topic with NavSatFix messages")
    start: str | None = Field(
        None,
        description="leave out samples before this: seconds from the first sample, RFC 3339, or ns",
    )
    end: str | None = Field(None, description="leave out samples after this, as --start")
    body_axes: Literal["flu", "frd"] = Field(
        "flu", description="axes of the sensor: Forward-Left-Up or Forward-Right-Down"
    )
    gyro_kind: Literal["rate", "mean-rate", "increment"] = Field(
        "rate",
        description="what a gyro sample is: the rate at its stamp, the mean over the interval that"
        " ends there, or the angle turned in it",
    )
    gyro_unit: Literal["rad/s", "deg/s"] | None = Field(
        None, description="unit of the gyro (default: rad/s, refused where the data denies it)"
    )
    accel_unit: Literal["m/s^2", "g"] | None = Field(
        None,
        description="unit of the accelerometer (default: m/s^2, refused where the data denies it)",
    )
    imu_rate: float | None = Field(
        None,
        ge=1e-3,
        le=1e6,
        description="sampling rate in Hz, instead of the intervals between stamps",
    )
    max_gap: float | None = Field(
        None,
        gt=0,
        le=1e9,
        description="longest interval in seconds that is integrated across (default: three"
        " nominal intervals)",
    )
    salvage: bool = Field(
        False, description="go on past damaged parts of a log and say what was lost"
    )

    @field_validator("start", "end", mode="before")
    @classmethod
    def _text(cls, value: Any) -> Any:
        """TOML has numbers and dates of its own."""
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            return repr(value)
        return value.isoformat() if isinstance(value, datetime) else value

    @field_validator("start", "end")
    @classmethod
    def _time(cls, value: str | None) -> str | None:
        if value is not None:
            parse_time(value, 0)
        return value


class ConingOptions(_Group):
    """From angular rate to rotation vectors."""

    coning: str = Field("previous-3", description="algorithm: " + ", ".join(names()))
    sp_variant: Literal["exact", "bvp", "truncated", "printed"] | None = Field(
        None,
        description="form of the singular-perturbation solution (default: truncated with a"
        " preset, exact with --epsilon)",
    )
    sp_preset: Literal["best", "paper", "auto"] | None = Field(
        None,
        description="best: epsilon = T/2, n = 2; paper: 2e-4 s, n = 0.001; auto: nulls the drift"
        " of the log's own coning below --passband (default: best)",
    )
    epsilon: float | None = Field(
        None, ge=0, description="boundary layer in seconds, with --beta-gain or --beta"
    )
    beta_gain: float | None = Field(None, description="n of the paper's eq. (14)")
    beta: tuple[float, float, float] | None = Field(
        None, description="a constant beta in rad/s^2, in the log's axes"
    )
    passband: float | None = Field(
        None, gt=0, description="Hz, up to which coning is motion (gyro-tuned, --sp-preset auto)"
    )
    stopband: float | None = Field(
        None, gt=0, description="Hz, from which on coning is noise (gyro-tuned)"
    )
    gyro_response: str | None = Field(
        None,
        description="of the gyro, for gyro-tuned: none, cheb:ORDER,RIPPLE_DB,HZ, butter:ORDER,HZ,"
        " or a file with lines of frequency and gain",
    )

    @field_validator("coning")
    @classmethod
    def _known(cls, value: str) -> str:
        try:
            algorithm(value)
        except ConfigurationError as exc:
            raise ValueError(str(exc)) from exc
        return value

    def algorithm_options(self) -> dict[str, Any]:
        """Options of the algorithm that were given, by its own names."""
        given = {
            "variant": self.sp_variant,
            "preset": self.sp_preset,
            "epsilon": self.epsilon,
            "beta_gain": self.beta_gain,
            "beta": self.beta,
            "passband": self.passband,
            "stopband": self.stopband,
            "gyro_response": self.gyro_response,
        }
        return {k: v for k, v in given.items() if v is not None}


class AlignOptions(_Group):
    """Where the vehicle points when the log begins."""

    mode: Literal["auto", "attitude"] = Field(
        "auto", description="what is computed; auto is attitude"
    )
    align: Literal["auto", "level", "log", "fixed"] = Field(
        "auto",
        description="first attitude: tilt from the still lead-in with heading 0 (level), the"
        " first valid orientation in the Imu topic (log), or --initial-attitude (fixed); auto"
        " takes level, else log, else the mean specific force of the first second",
    )
    initial_attitude: tuple[float, float, float] | None = Field(
        None, description="roll, pitch, heading in degrees of FRD axes in NED, for --align fixed"
    )
    gyro_bias: Literal["still", "none"] | tuple[float, float, float] = Field(
        "still",
        description="still: the mean of the still lead-in is removed; none; or X,Y,Z in rad/s in"
        " the log's axes",
    )
    latitude: float | None = Field(
        None, ge=-90, le=90, description="degrees, where the log has no fix"
    )
    longitude: float | None = Field(None, ge=-180, le=180, description="degrees")
    height: float | None = Field(None, description="metres above the ellipsoid")


class OutputOptions(_Group):
    """What is written, and how."""

    world: Literal["enu", "ned"] = Field("enu", description="frame of the written orientation")
    emit: tuple[str, ...] = Field(
        ("imu", "attitude"), description="topics to write, any of " + ",".join(EMITS)
    )
    only_results: bool = Field(
        False, description="leave the input's own messages out of the output"
    )
    compression: Literal["zstd", "lz4", "none"] = Field("zstd", description="of the output")
    overwrite: bool = Field(False, description="replace an existing output")

    @field_validator("emit")
    @classmethod
    def _emits(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        unknown = [v for v in value if v not in EMITS]
        if unknown:
            raise ValueError(f"'{unknown[0]}' is not one of {', '.join(EMITS)}")
        if not value:
            raise ValueError("nothing is left to write")
        return tuple(dict.fromkeys(value))


class ProcessConfig(_Group):
    """Everything `sinstool process` is told."""

    input: InputOptions = InputOptions()
    coning: ConingOptions = ConingOptions()
    align: AlignOptions = AlignOptions()
    output: OutputOptions = OutputOptions()


def build(model: type[_Group], data: dict[str, Any], source: str = "", check: bool = True) -> Any:
    """Validate plain data into a configuration.

    Parameters
    ----------
    model : type
        ProcessConfig, or a group of it.
    data : dict
    source : str
        Named in errors: a file; empty for the command line, whose options are named instead.
    check : bool
        Check also that options fit each other.

    Returns
    -------
    model

    Raises
    ------
    ConfigurationError
        An unknown key, a wrong type or an impossible value, with the key's path.
    """
    try:
        config = model.model_validate(data)
    except ValidationError as exc:
        raise ConfigurationError(_first_error(exc, source)) from exc
    if check and isinstance(config, ProcessConfig):
        _check(config)
    return config


def _first_error(exc: ValidationError, source: str) -> str:
    """One line about the first thing that is wrong, with the key's path or the option's name."""
    errors = exc.errors()
    key = errors[0]["loc"][:2]
    # All branches of a union complain; the one that got furthest into the value knows best.
    same = [e for e in errors if e["loc"][:2] == key]
    error = max(same, key=lambda e: len(e["loc"]))
    path = ".".join(map(str, key))
    where = f"{source}: " if source else ""
    if error["type"] == "extra_forbidden":
        return f"{where}unknown key {path}"
    if len(same) > 1 and len(error["loc"]) <= 3 and error["type"] != "missing":
        said = " or ".join(dict.fromkeys(_said(e) for e in same))
    else:
        said = _said(error)
    # Branches of unions have names, elements of lists have numbers.
    element = next((p for p in error["loc"][2:] if isinstance(p, int)), None)
    if error["type"] == "missing":
        element = None
    if element is not None:
        path += f"[{element}]"
    if not source and len(key) == 2:
        return f"--{str(key[1]).replace('_', '-')} {_shown(error['input'])}: {said}"
    return f"{where}{path} = {_shown(error['input'])}: {said}"


def _shown(value: Any) -> str:
    """A value as TOML writes it, or nearly."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(_shown(v) for v in value)}]"
    return repr(value)


def _said(error: Any) -> str:
    """What pydantic says, in the words of the file."""
    words = {
        "tuple_type": "must be a list",
        "model_type": "must be a table",
        "missing": "too few values",
        "too_long": "too many values",
    }
    if error["type"] in words:
        return words[error["type"]]
    said = str(error["msg"]).removeprefix("Value error, ").removeprefix("Input ")
    return said.replace("should be", "must be", 1)


def _check(config: ProcessConfig) -> None:
    """What no single option can know."""
    _check_coning(config.coning)
    fixed = config.align.align == "fixed"
    if fixed and config.align.initial_attitude is None:
        raise ConfigurationError(
            "--align fixed needs an attitude", "give --initial-attitude ROLL,PITCH,HEADING"
        )
    if not fixed and config.align.initial_attitude is not None:
        raise ConfigurationError(
            f"--initial-attitude is given, but --align is {config.align.align}",
            "add --align fixed or leave it out",
        )


def _check_coning(told: ConingOptions) -> None:
    """Whether the options given are those of the algorithm chosen, and fit each other."""
    options = told.algorithm_options()
    if told.coning == "gyro-tuned":
        # The interval is the log's; any will do to see whether the rest is possible.
        top = max(told.passband or 0.0, told.stopband or 0.0)
        algorithm(told.coning, **options, interval=0.25 / top if top else 1e-3)
    elif told.coning == "singular-perturbation" and told.sp_preset == "auto":
        strange = sorted(set(options) - {"preset", "passband", "variant"})
        if strange or told.sp_variant not in (None, "truncated"):
            raise ConfigurationError(
                "--sp-preset auto chooses the variant, epsilon and n itself",
                "leave the other options of singular-perturbation out",
            )
        if told.passband is None:
            raise ConfigurationError(
                "--sp-preset auto tunes to the coning in a passband", "give --passband HZ"
            )
    elif options:
        try:
            algorithm(told.coning, **options)
        except ConfigurationError as exc:
            raise ConfigurationError(f"--coning is {told.coning}: {exc.message}", exc.hint) from exc


def load_toml(path: Path) -> dict[str, Any]:
    """Read a configuration file.

    Raises
    ------
    ConfigurationError
        It cannot be read or is no TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as exc:
        raise ConfigurationError(f"{path}: cannot be read ({exc.strerror})") from exc
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as exc:
        raise ConfigurationError(f"{path}: not valid TOML ({exc})") from exc


def dump_toml(config: _Group) -> str:
    """The effective configuration as TOML that `--config` reads back."""
    data = config.model_dump(mode="json", exclude_none=True)
    return tomli_w.dumps({k: v for k, v in data.items() if v not in ({}, None)})


def parse_time(text: str, first_ns: int) -> int:
    """A time as --start and --end take it.

    Parameters
    ----------
    text : str
        Seconds from the first sample (``12.5``), an RFC 3339 date (``2024-05-01T10:00:00Z``), or
        nanoseconds on the log's clock (an integer of more than 12 digits, or with ``ns``).
    first_ns : int
        Time of the first sample.

    Returns
    -------
    int
        Nanoseconds.

    Raises
    ------
    ValueError
        The text is none of these.
    """
    text = text.strip()
    digits = text.removesuffix("ns").strip()
    if digits.lstrip("+-").isdigit() and (text.endswith("ns") or len(digits.lstrip("+-")) > 12):
        return _in_range(int(digits), text)
    try:
        seconds = Decimal(text)
        if seconds.is_finite():
            return _in_range(first_ns + int(seconds * 1_000_000_000), text)
    except InvalidOperation:
        pass
    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        raise ValueError(
            f"'{text}' is not a time: give seconds from the log's start, RFC 3339, or ns"
        ) from None
    if when.tzinfo is None:
        when = when.replace(tzinfo=UTC)
    delta = when - datetime(1970, 1, 1, tzinfo=UTC)
    return (delta.days * 86400 + delta.seconds) * 1_000_000_000 + delta.microseconds * 1000


def _in_range(time_ns: int, text: str) -> int:
    if not -(2**63) <= time_ns < 2**63:
        raise ValueError(f"'{text}' is no time that a log can hold")
    return time_ns
