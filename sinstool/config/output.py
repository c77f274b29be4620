"""What is written, and how."""

from __future__ import annotations

from typing import Literal

from pydantic import field_validator

from sinstool.core.options import Group, option
from sinstool.core.suggest import nearest

EMITS = ("imu", "attitude", "euler", "odometry", "pose", "fix", "tf", "height", "diagnostics")


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
