"""Logs that no command can use; each with what the error says of it."""

import numpy as np

from tests.helpers.imulogs import (
    even_times,
    handheld,
    imu_log,
    imu_messages,
    resting,
    write_log,
)
from tests.helpers.logs import PRESSURE, Row, payload_of, write_mcap


def missing(folder):
    return folder / "nope.mcap", "there is no such file"


def empty(folder):
    path = folder / "empty.mcap"
    path.write_bytes(b"")
    return path, "the file is empty"


def text(folder):
    path = folder / "text.mcap"
    path.write_text("time,gyro\n1,2\n")
    return path, "not a log"


def directory(folder):
    path = folder / "folder"
    path.mkdir()
    return path, "metadata.yaml"


def cut(folder):
    path = imu_log(folder / "cut.mcap", even_times(5000), *resting(5000))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return path, "--salvage"


def no_imu(folder):
    payload = payload_of(PRESSURE, 0)
    return write_mcap(folder / "b.mcap", [Row("/baro", 1, 1, payload)]), "no sensor_msgs/Imu topic"


def ambiguous(folder):
    times = even_times(100)
    messages = [m for t in ("/a", "/b") for m in imu_messages(times, *resting(100), topic=t)]
    return write_log(folder / "two.mcap", messages), "--imu-topic"


def deg_s(folder):
    gyro, accel, _ = handheld(4000)
    return imu_log(
        folder / "deg.mcap", even_times(4000), np.degrees(gyro), accel
    ), "--gyro-unit deg/s"


def in_g(folder):
    gyro, accel, _ = handheld(1000)
    return imu_log(folder / "g.mcap", even_times(1000), gyro, accel / 9.8), "--accel-unit g"


def slow(folder):
    return imu_log(folder / "slow.mcap", even_times(60, 1.0), *resting(60)), "1 samples a second"


def not_a_number(folder):
    return imu_log(folder / "nan.mcap", even_times(9), [np.nan] * 3, [0.0, 0, 9.8]), "hold NaN"


UNREADABLE = [missing, empty, text, cut]
REFUSED = [ambiguous, deg_s, in_g, slow, no_imu, not_a_number]
ALL = [*UNREADABLE, directory, *REFUSED]
