"""Topics of a motion measured by perfect sensors."""

from sinstool.simulation.log import Axes, imu_topic, truth_topics


def motion_topics(truth, gyro_kind, body_axes):
    """The IMU topic of perfect sensors and the truth beside it."""
    axes = Axes(body_axes)
    return [imu_topic(truth, gyro_kind, axes), *truth_topics(truth, axes)]
