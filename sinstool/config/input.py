"""Which data of the log, and what it means."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from pydantic import field_validator

from sinstool.config.times import parse_time
from sinstool.core.options import Group, option


class InputOptions(Group):
    """Which data of the log, and what it means."""

    imu_topic: str | None = option(None, "topic with the Imu messages", "TOPIC")
    gnss_topic: str | None = option(None, "topic with NavSatFix messages", "TOPIC")
    velocity_topic: str | None = option(
        None,
        "topic with velocity over ground (TwistStamped,"
        " TwistWithCovarianceStamped or Odometry; world ENU)",
        "TOPIC",
    )
    baro_topic: str | None = option(None, "topic with FluidPressure messages", "TOPIC")
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
    gyro_kind: Literal["rate", "mean-rate", "increment"] = option(
        "rate",
        "what a gyro sample is: the rate at its stamp, the mean over the interval that"
        " ends there, or the angle turned in it",
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
