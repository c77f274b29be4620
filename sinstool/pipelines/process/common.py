"""What the kinds of runs share."""

from __future__ import annotations

from sinstool.config import ProcessConfig
from sinstool.core.errors import DataError
from sinstool.io.writers.topics import Frames
from sinstool.methods.alignment.initial import Alignment
from sinstool.survey.oddities import oddities
from sinstool.survey.source import Source

# m/s^2. No vehicle's median; beyond it a specific force is in mg or cm/s^2. (The survey counts
# what is larger than 100 as 100.)
MAX_SPECIFIC_FORCE = 90.0


def require_gravity(source: Source, config: ProcessConfig) -> None:
    """Refuse accelerometers whose integral is no velocity: without gravity, or in a strange unit.

    Raises
    ------
    DataError
    """
    if config.input.accel_unit is not None:
        return  # whoever names the unit has looked at the numbers
    found = source.survey
    if any(o.kind == "no-gravity" for o in oddities(found, config.input)):
        raise DataError(
            source.log.path,
            f"topic {found.topic}: the specific force is only"
            f" {found.specific_force_median:.3f} m/s^2 in size: gravity has been taken out of it,"
            " so that velocity and height cannot be had from it",
            "choose the topic with raw accelerations by --imu-topic, or use --mode attitude"
            " without --height-damping (--accel-unit m/s^2 if the vehicle falls freely)",
        )
    if found.specific_force_median > MAX_SPECIFIC_FORCE:
        raise DataError(
            source.log.path,
            f"topic {found.topic}: the specific force is mostly"
            f" {found.specific_force_median:.3g} m/s^2 in size or more, as in mg or cm/s^2",
            "sensor_msgs/Imu holds m/s^2: convert it, or choose another topic with --imu-topic",
        )


def odometry_frames(
    source: Source, alignment: Alignment, config: ProcessConfig, body: str
) -> Frames:
    """Frames of a run: ``map`` where heading counts from north, else ``odom``."""
    referenced = alignment.north_referenced and source.latitude is not None
    return Frames(
        config.output.world,
        "map" if referenced else "odom",
        body,
        config.input.body_axes,
    )
