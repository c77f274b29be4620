"""Options of a log's data and their meaning, and of the output."""

from __future__ import annotations

from datetime import UTC, date, datetime
from decimal import Decimal, InvalidOperation, Overflow
from typing import Any, Literal

from pydantic import field_validator

from sinstool.core.options import Group, option
from sinstool.core.suggest import nearest

EMITS = (
    "imu", "attitude", "euler", "odometry", "pose", "fix", "tf", "height", "vehicle", "diagnostics"
)  # fmt: skip
# Options of [input] by the data that a command reads: an IMU, GNSS, or a rig on a turntable
IMU_INPUT = (
    "input.imu_topic",
    "input.start",
    "input.end",
    "input.body_axes",
    "input.gyro_kind",
    "input.gyro_unit",
    "input.accel_unit",
    "input.imu_rate",
    "input.imu_stamps",
    "input.max_gap",
    "input.salvage",
)
GNSS_INPUT = (
    "input.gnss_topic",
    "input.velocity_topic",
    "input.gnss_unit",
    "input.gnss_clock_offset",
    "input.gnss_stamps",
)
RIG_INPUT = (
    "input.imu_topic",
    "input.encoder_topic",
    "input.start",
    "input.end",
    "input.gyro_unit",
    "input.accel_unit",
    "input.salvage",
)


def parse_time(text: str, first_ns: int) -> int:
    """A time as --start and --end take it.

    Parameters
    ----------
    text : str
        Seconds from the first sample (``12.5``), an RFC 3339 date (``2024-05-01T10:00:00Z``, UTC
        where it has no offset), or nanoseconds on the log's clock (an integer of more than 12
        digits, or with ``ns``).
    first_ns : int
        Time of the first sample.

    Returns
    -------
    int
        Nanoseconds.

    Raises
    ------
    ValueError
        The text is none of these, or a time that does not fit an int64.
    """
    text = text.strip()
    digits = text.removesuffix("ns").strip()
    if digits.lstrip("+-").isdigit() and (text.endswith("ns") or len(digits.lstrip("+-")) > 12):
        return _in_range(int(digits), text)
    try:
        seconds = Decimal(text)
        if seconds.is_finite():
            return _in_range(first_ns + int(seconds * 1_000_000_000), text)
    except Overflow:
        raise _out_of_range(text) from None
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
        raise _out_of_range(text)
    return time_ns


def _out_of_range(text: str) -> ValueError:
    return ValueError(f"'{text}' is a time that no log can hold")


class InputOptions(Group):
    """Which data of the log is read, and in which units and axes."""

    title = "Input"

    imu_topic: str | None = option(
        None,
        "topic with Imu messages (default: the one in the log; needed where there are several)",
        "TOPIC",
        brief="topic with Imu messages, if several",
    )
    gnss_topic: str | None = option(
        None,
        "topic with NavSatFix or GPSFix messages, or none, which also leaves out the receiver's"
        " velocity unless --velocity-topic names it (default: the best one in the log)",
        "TOPIC",
    )
    velocity_topic: str | None = option(
        None,
        "topic with velocity over ground in ENU (TwistStamped, TwistWithCovarianceStamped or"
        " Odometry), or none (default: one that agrees with the fixes)",
        "TOPIC",
    )
    wheels: str | None = option(
        None,
        "topic with wheel speed (JointState with velocities, Odometry, TwistStamped or"
        " TwistWithCovarianceStamped), or none (default: one that holds forward speed only and"
        " follows the speed of the fixes)",
        "TOPIC",
    )
    baro_topic: str | None = option(
        None,
        "topic with FluidPressure messages, or none (default: the one in the log)",
        "TOPIC",
    )
    baro_kind: Literal["pressure", "height"] = option(
        "pressure", "what the barometer's topic holds; height: PointStamped or Float64, in m"
    )
    baro_unit: Literal["Pa", "hPa", "kPa", "inHg"] | None = option(
        None, "unit of the pressure (default: Pa; refused if the data contradicts it)"
    )
    gnss_unit: Literal["deg", "rad"] | None = option(
        None, "unit of latitude and longitude (default: deg; refused if the data contradicts it)"
    )
    gnss_clock_offset: float = option(
        0.0,
        "how far the receiver's clock is ahead of the IMU's, in s; subtracted from its stamps (GPS"
        " time is 18 s ahead of UTC)",
        "S",
        ge=-1e9,
        le=1e9,
    )
    gnss_stamps: Literal["auto", "even", "kept"] = option(
        "auto",
        "times of the fixes: their stamps (kept), or evenly spaced times fitted to the stamps"
        " (even), for a receiver that is stamped by the computer on receipt; auto: even where"
        " stamps jitter and the vehicle's motion fits even times",
    )
    encoder_topic: str | None = option(
        None, "topic with JointState messages from the turntable's encoder", "TOPIC"
    )
    start: str | None = option(
        None,
        "ignore samples before this time: seconds from the first sample, an RFC 3339 date, or ns",
        "TIME",
        brief="ignore samples before this: s, a date or ns",
    )
    end: str | None = option(
        None,
        "ignore samples after this time; written like --start",
        "TIME",
        brief="ignore samples after this time",
    )
    body_axes: Literal["flu", "frd"] = option(
        "flu",
        "axes of the IMU: Forward-Left-Up or Forward-Right-Down",
        brief="axes of the IMU: flu (default) or frd",
    )
    gyro_kind: Literal["auto", "rate", "mean-rate", "increment"] = option(
        "auto",
        "what a gyro sample is: the rate at its stamp, the mean rate over the interval that ends"
        " there, or the angle turned in that interval; auto: mean-rate for a smoothed attitude,"
        " and for INS/GNSS where the fixes show it, otherwise rate",
        brief="what a gyro sample is: rate, mean-rate, increment or auto",
    )
    gyro_unit: Literal["rad/s", "deg/s"] | None = option(
        None, "unit of the gyro (default: rad/s; refused if the data contradicts it)"
    )
    accel_unit: Literal["m/s^2", "g"] | None = option(
        None, "unit of the accelerometer (default: m/s^2; refused if the data contradicts it)"
    )
    imu_rate: float | None = option(
        None, "sampling rate in Hz, used in place of the time stamps", "HZ", ge=1e-3, le=1e6
    )
    imu_stamps: Literal["auto", "even", "kept"] = option(
        "auto",
        "times of the samples: their stamps (kept), or evenly spaced times fitted to the stamps"
        " (even), for a sensor that samples evenly and is stamped by the computer on receipt; auto:"
        " even where stamps jitter and the rates do not follow them",
    )
    max_gap: float | None = option(
        None,
        "longest interval in seconds that is integrated across; a longer one is a gap (default:"
        " three nominal intervals)",
        "S",
        gt=0,
        le=1e9,
    )
    salvage: bool = option(
        False,
        "skip the damaged parts of a log and report what was lost",
        brief="skip damaged parts, and report what was lost",
    )

    @property
    def sample_kind(self) -> Literal["rate", "mean-rate", "increment"]:
        """The kind of gyro samples; by default the rate at the stamp."""
        return "rate" if self.gyro_kind == "auto" else self.gyro_kind

    @field_validator("start", "end", mode="before")
    @classmethod
    def _text(cls, value: Any) -> Any:
        """TOML has numbers and dates of its own."""
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            return repr(value)
        return value.isoformat() if isinstance(value, date) else value

    @field_validator("start", "end")
    @classmethod
    def _time(cls, value: str | None) -> str | None:
        if value is not None:
            parse_time(value, 0)
        return value


class OutputOptions(Group):
    """Options of the output."""

    title = "Output"

    world: Literal["enu", "ned"] = option(
        "enu", "frame of the written orientation: East-North-Up or North-East-Down"
    )
    emit: tuple[str, ...] | None = option(
        None,
        "topics to write, any of "
        + ", ".join(EMITS)
        + " (default: imu, attitude and what else the mode computes)",
        "TOPIC,...",
    )
    only_results: bool = option(False, "write the results only, without the log's own messages")
    compression: Literal["zstd", "lz4", "none"] = option("zstd", "compression of the output")
    overwrite: bool = option(
        False, "replace an existing output", brief="replace an existing output"
    )
    report: str | None = option(
        None,
        "also write a page of figures (.html), or its first figure (.png, .pdf, .svg)",
        "FILE",
        brief="also write a page of figures",
    )
    truth: tuple[str, ...] = option(
        (),
        "compare the result with this reference: a topic of the log with orientations, NavSatFix"
        " or TwistStamped, or a CSV file with time_s or time_ns and qw,qx,qy,qz; repeatable",
        "TOPIC|FILE",
        brief="compare the result with a reference",
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
