"""Which data of the log, and what it means; what is written, and how."""

from __future__ import annotations

from datetime import UTC, datetime
from decimal import Decimal, InvalidOperation
from typing import Any, Literal

from pydantic import field_validator

from sinstool.core.options import Group, option
from sinstool.core.suggest import nearest

EMITS = (
    "imu", "attitude", "euler", "odometry", "pose", "fix", "tf", "height", "vehicle", "diagnostics"
)  # fmt: skip


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


class InputOptions(Group):
    """Which data of the log, and what it means."""

    imu_topic: str | None = option(None, "topic with the Imu messages", "TOPIC")
    gnss_topic: str | None = option(
        None,
        "topic with NavSatFix messages, or none (default: the best, where there are several)",
        "TOPIC",
    )
    velocity_topic: str | None = option(
        None,
        "topic with velocity over ground (TwistStamped,"
        " TwistWithCovarianceStamped or Odometry; world ENU), or none (default: one that the"
        " fixes do not contradict)",
        "TOPIC",
    )
    wheels: str | None = option(
        None,
        "topic with the speed of wheels (JointState with velocities, Odometry, TwistStamped or"
        " TwistWithCovarianceStamped), or none (default: one that holds forward speed alone and"
        " follows the speed of the fixes)",
        "TOPIC",
    )
    baro_topic: str | None = option(None, "topic with FluidPressure messages, or none", "TOPIC")
    baro_kind: Literal["pressure", "height"] = option(
        "pressure", "what the barometer's topic holds; height: PointStamped or Float64"
    )
    baro_unit: Literal["Pa", "hPa", "kPa", "inHg"] | None = option(
        None, "unit of the pressure (default: Pa, refused where the data denies it)"
    )
    gnss_unit: Literal["deg", "rad"] | None = option(
        None, "unit of latitude and longitude (default: deg, refused where the data denies it)"
    )
    encoder_topic: str | None = option(None, "topic with JointState messages", "TOPIC")
    start: str | None = option(
        None,
        "leave out samples before this: seconds from the first sample, RFC 3339, or ns",
        "TIME",
    )
    end: str | None = option(None, "leave out samples after this, as --start", "TIME")
    body_axes: Literal["flu", "frd"] = option(
        "flu", "axes of the sensor: Forward-Left-Up or Forward-Right-Down"
    )
    gyro_kind: Literal["auto", "rate", "mean-rate", "increment"] = option(
        "auto",
        "what a gyro sample is: the rate at its stamp, the mean over the interval that"
        " ends there, or the angle turned in it; auto is mean-rate for a smoothed attitude, else"
        " rate",
    )
    gyro_unit: Literal["rad/s", "deg/s"] | None = option(
        None, "unit of the gyro (default: rad/s, refused where the data denies it)"
    )
    accel_unit: Literal["m/s^2", "g"] | None = option(
        None, "unit of the accelerometer (default: m/s^2, refused where the data denies it)"
    )
    imu_rate: float | None = option(
        None, "sampling rate in Hz, instead of the intervals between stamps", "HZ", ge=1e-3, le=1e6
    )
    max_gap: float | None = option(
        None,
        "longest interval in seconds that is integrated across (default: three nominal intervals)",
        "S",
        gt=0,
        le=1e9,
    )
    salvage: bool = option(False, "go on past damaged parts of a log and say what was lost")

    @property
    def sample_kind(self) -> Literal["rate", "mean-rate", "increment"]:
        """What a gyro sample is; where nobody said, the rate at its stamp."""
        return "rate" if self.gyro_kind == "auto" else self.gyro_kind

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


class OutputOptions(Group):
    """What is written, and how."""

    world: Literal["enu", "ned"] = option("enu", "frame of the written orientation")
    emit: tuple[str, ...] | None = option(
        None,
        "topics to write, any of "
        + ",".join(EMITS)
        + " (default: imu,attitude and what the mode knows besides)",
        "TOPIC,...",
    )
    only_results: bool = option(False, "leave the input's own messages out of the output")
    compression: Literal["zstd", "lz4", "none"] = option("zstd", "of the output")
    overwrite: bool = option(False, "replace an existing output")
    report: str | None = option(
        None, "page of figures to write too (.html), or its first figure (.png, .pdf, .svg)"
    )
    truth: tuple[str, ...] = option(
        (),
        "what the result is held against: a topic with orientations, NavSatFix or"
        " TwistStamped of the log, or a CSV file with time_s or time_ns and qw,qx,qy,qz",
    )

    @field_validator("emit")
    @classmethod
    def _emits(cls, value: tuple[str, ...] | None) -> tuple[str, ...] | None:
        if value is None:
            return None
        unknown = [v for v in value if v not in EMITS]
        if unknown:
            near = nearest(unknown[0], EMITS)
            raise ValueError(
                f"'{unknown[0]}' is not one of {', '.join(EMITS)}" + (f"; {near}" if near else "")
            )
        if not value:
            raise ValueError("nothing is left to write")
        return tuple(dict.fromkeys(value))
