"""Which data of the log, and what it means."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from pydantic import Field, field_validator

from sinstool.config.group import Group
from sinstool.config.times import parse_time


class InputOptions(Group):
    """Which data of the log, and what it means."""

    imu_topic: str | None = Field(None, description="topic with the Imu messages")
    gnss_topic: str | None = Field(None, description="topic with NavSatFix messages")
    velocity_topic: str | None = Field(
        None,
        description="topic with velocity over ground (TwistStamped,"
        " TwistWithCovarianceStamped or Odometry; world ENU)",
    )
    baro_topic: str | None = Field(None, description="topic with FluidPressure messages")
    baro_kind: Literal["pressure", "height"] = Field(
        "pressure", description="what the barometer's topic holds; height: PointStamped or Float64"
    )
    baro_unit: Literal["Pa", "hPa", "kPa", "inHg"] | None = Field(
        None, description="unit of the pressure (default: Pa, refused where the data denies it)"
    )
    gnss_unit: Literal["deg", "rad"] | None = Field(
        None,
        description="unit of latitude and longitude (default: deg, refused where the data denies"
        " it)",
    )
    encoder_topic: str | None = Field(None, description="topic with JointState messages")
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
