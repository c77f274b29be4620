"""The turntable rig of a rate-biased laser-gyro system: the tables `[rig]` and `[rig.encoder]`."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from sinstool.config.group import Group

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]


class EncoderOptions(Group):
    """The table's angle, from a joint of JointState messages."""

    joint: str = Field(description="name of the joint")
    sign: Literal[1, -1] = Field(
        1, description="1 where the reading grows as the table turns clockwise seen from above"
    )
    offset_rad: float = Field(0.0, description="reading at the zero mark, rad")
    delay_s: float = Field(0.0, description="by which a reading is older than its stamp, s")
    unit: Literal["rad", "deg"] = Field("rad", description="of the reading")
    harmonics: tuple[Vector, ...] = Field(
        (), description="known errors: order, cosine and sine amplitude in rad"
    )


class RigOptions(Group):
    """Calibration matrices and conventions of the rig."""

    K_g: Matrix = Field(description="gyro triad to orthogonal axes s, lower triangular")
    C_s_to_b: Matrix | None = Field(None, description="from s to the body b that the table turns")
    e: Vector | None = Field(None, description="the rotation axis (z of b) in s, instead")
    K_a: Matrix = Field(
        ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        description="from the accelerometers to s",
    )
    gyro_frame: Literal["g", "s"] = Field("g", description="axes of the log's gyro: triad or s")
    accel_frame: Literal["s", "g"] = Field(
        "s", description="axes of the log's accelerometer: s, or its own triad (K_a applies)"
    )
    gyro_bias: Vector = Field((0.0, 0.0, 0.0), description="rad/s, of the log's gyro")
    accel_bias: Vector = Field((0.0, 0.0, 0.0), description="m/s^2, of the log's accelerometer")
    latitude_deg: float = Field(ge=-90, le=90, description="of the site")
    imu_stamp: Literal["end", "mid", "start"] = Field(
        "end", description="where in the interval that a gyro sample averages its stamp lies"
    )
    encoder: EncoderOptions
