"""ULog files of PX4, read with pyulog: their sensors as ROS 2 messages.

PX4 works in Forward-Right-Down and North-East-Down; the messages are in Forward-Left-Up and
East-North-Up, as REP-103 has it. Stamps count from the start of the autopilot, as in the file.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sinstool.core.errors import DamagedLogError, UnsupportedLogError
from sinstool.io.messages.definitions import schema_text
from sinstool.io.messages.encode import Encoder
from sinstool.io.readers.batch import RawBatch
from sinstool.io.readers.frames import enu_to_ned, turn_body
from sinstool.io.readers.log import Channel, Log
from sinstool.io.readers.message_types import (
    FIX_TYPE,
    IMU_TYPE,
    MAGNETIC_TYPE,
    PRESSURE_TYPE,
    VELOCITY_TYPES,
)

Data = Mapping[str, np.ndarray]
# Relative time stamp of an accelerometer that was not read
_NEVER = 2**31 - 1
_TESLA_PER_GAUSS = 1e-4
# Messages that are encoded at once
ROWS = 2**14
# Logs from before 2020 have hPa; below 25 km no static pressure in Pa is as small as this
_MOST_HPA = 2000.0


@dataclass(frozen=True)
class _Messages:
    """Messages of one topic, still as columns."""

    stamp_ns: np.ndarray
    log_time_ns: np.ndarray
    columns: dict[str, np.ndarray]

    def rows(self, which: np.ndarray | slice) -> _Messages:
        columns = {path: column[which] for path, column in self.columns.items()}
        return _Messages(self.stamp_ns[which], self.log_time_ns[which], columns)


def _nanoseconds(data: Data, name: str = "timestamp") -> np.ndarray:
    return data[name].astype(np.int64) * 1000


def _vector(data: Data, name: str) -> np.ndarray:
    return np.stack([data[f"{name}[{k}]"].astype(np.float64) for k in range(3)], axis=1)


def _sampled(data: Data, columns: dict[str, np.ndarray]) -> _Messages:
    """Messages stamped with the time of the sample, or in old logs with the time of logging."""
    logged = _nanoseconds(data)
    sampled = _nanoseconds(data, "timestamp_sample") if "timestamp_sample" in data else logged
    return _Messages(np.where(sampled > 0, sampled, logged), logged, columns)


def _imu(data: Data) -> _Messages:
    logged = _nanoseconds(data)
    none = np.zeros((len(logged), 9))
    none[:, 0] = -1.0  # marks a message without orientation
    columns = {
        "orientation.w": np.ones(len(logged)),
        "orientation_covariance": none,
        "angular_velocity.x": turn_body(_vector(data, "gyro_rad"), "flu"),
        "linear_acceleration.x": turn_body(_vector(data, "accelerometer_m_s2"), "flu"),
    }
    good = data["accelerometer_timestamp_relative"] != _NEVER
    return _Messages(logged, logged, columns).rows(good)


def _fix(data: Data) -> _Messages:
    logged = _nanoseconds(data)
    if "latitude_deg" in data:  # since PX4 1.15
        latitude, longitude = data["latitude_deg"], data["longitude_deg"]
        height = data["altitude_ellipsoid_m"]
    else:
        latitude, longitude = data["lat"] * 1e-7, data["lon"] * 1e-7
        height = data.get("alt_ellipsoid", data["alt"]) * 1e-3
    covariance = np.zeros((len(logged), 9))
    for place, name in ((0, "eph"), (4, "eph"), (8, "epv")):
        covariance[:, place] = data[name].astype(np.float64) ** 2
    columns = {
        "status.status": np.where(data["fix_type"] >= 3, 0, -1),
        "latitude": latitude,
        "longitude": longitude,
        "altitude": height,
        "position_covariance": covariance,
        "position_covariance_type": np.full(len(logged), 2),
    }
    return _Messages(logged, logged, columns)


def _velocity(data: Data) -> _Messages:
    logged = _nanoseconds(data)
    ned = np.stack([data[f"vel_{axis}_m_s"].astype(np.float64) for axis in "ned"], axis=1)
    covariance = np.zeros((len(logged), 36))
    # Despite its name it is a standard deviation.
    covariance[:, [0, 7, 14]] = data["s_variance_m_s"].astype(np.float64)[:, None] ** 2
    columns = {"twist.twist.linear.x": enu_to_ned(ned), "twist.covariance": covariance}
    good = (data["fix_type"] >= 3) & (data["vel_ned_valid"] != 0)
    return _Messages(logged, logged, columns).rows(good)


def _baro(data: Data) -> _Messages:
    pressure = data["baro_pressure_pa" if "baro_pressure_pa" in data else "pressure"]
    pressure = pressure.astype(np.float64)
    scale = np.where(pressure < _MOST_HPA, 100.0, 1.0)
    return _sampled(data, {"fluid_pressure": pressure * scale})


def _field(data: Data) -> _Messages:
    tesla = _vector(data, "magnetometer_ga") * _TESLA_PER_GAUSS
    return _sampled(data, {"magnetic_field.x": turn_body(tesla, "flu")})


@dataclass(frozen=True)
class _Topic:
    """How PX4 data becomes a topic: from the first of its sources that the file has."""

    topic: str
    type_name: str
    sources: tuple[str, ...]
    make: Callable[[Data], _Messages]
    frame: str = "base_link"


_GPS = ("vehicle_gps_position", "sensor_gps")
TOPICS = (
    _Topic("/px4/imu", IMU_TYPE, ("sensor_combined",), _imu),
    _Topic("/px4/gps/fix", FIX_TYPE, _GPS, _fix),
    _Topic("/px4/gps/velocity", VELOCITY_TYPES[1], _GPS, _velocity, "map"),
    _Topic("/px4/baro", PRESSURE_TYPE, ("vehicle_air_data", "sensor_baro"), _baro),
    _Topic("/px4/mag", MAGNETIC_TYPE, ("vehicle_magnetometer",), _field),
)


class UlogLog(Log):
    """A ULog of PX4: the first IMU, GNSS receiver, barometer and magnetometer of it.

    Raises
    ------
    UnsupportedLogError
        pyulog is not installed.
    DamagedLogError
        pyulog cannot read it; or a part is corrupt and ``salvage`` is off.
    """

    format = "ulog"
    profile = "ros2"

    def __init__(self, path: Path, salvage: bool = False) -> None:
        super().__init__(path, salvage)
        file = _parsed(path)
        data = {one.name: one.data for one in file.data_list if one.multi_id == 0}
        self._messages: dict[int, _Messages] = {}
        self._encoders: dict[int, Encoder] = {}
        for number, topic in enumerate(TOPICS, 1):
            source = next((name for name in topic.sources if name in data), None)
            if source is None:
                continue
            try:
                messages = topic.make(data[source])
            except KeyError as exc:
                self.damage(f"{source} has no field {exc.args[0]}, which sinstool reads")
                continue
            text = schema_text(topic.type_name, "cdr")
            self.channels[number] = Channel(
                number, topic.topic, topic.type_name, "cdr", "ros2msg", text
            )
            self.counts[number] = len(messages.stamp_ns)
            self._messages[number] = messages
            self._encoders[number] = Encoder(
                topic.type_name, "cdr", {"header.frame_id": topic.frame}
            )
        if file.file_corruption:
            self.damage("parts of the file are corrupt, as pyulog reports")

    def _read(self, selection: frozenset[int] | None) -> Iterator[RawBatch]:
        """Messages by log time, encoded on demand."""
        chosen = [n for n in self._messages if selection is None or n in selection]
        if not chosen:
            return
        times = np.concatenate([self._messages[n].log_time_ns for n in chosen])
        channel = np.repeat(chosen, [len(self._messages[n].log_time_ns) for n in chosen])
        order = np.argsort(times, kind="stable")
        within = np.concatenate([np.arange(len(self._messages[n].log_time_ns)) for n in chosen])
        for begin in range(0, len(order), ROWS):
            rows = order[begin : begin + ROWS]
            position = round(self.size * (begin + len(rows)) / len(order))
            yield self._batch(channel[rows], within[rows], position)

    def _batch(self, channel: np.ndarray, row: np.ndarray, position: int) -> RawBatch:
        count, base = len(channel), 0
        offset, length, log_time = (np.empty(count, np.int64) for _ in range(3))
        buffers = []
        for number in np.unique(channel).tolist():
            mine = channel == number
            part = self._messages[number].rows(row[mine])
            seconds = part.stamp_ns // 1_000_000_000
            header = {
                "header.stamp.sec": seconds,
                "header.stamp.nanosec": part.stamp_ns - seconds * 1_000_000_000,
            }
            payload = self._encoders[number].encode({**header, **part.columns}, int(mine.sum()))
            offset[mine] = base + np.arange(len(payload)) * payload.shape[1]
            length[mine], log_time[mine] = payload.shape[1], part.log_time_ns
            base += payload.size
            buffers.append(payload.reshape(-1))
        return RawBatch(
            np.concatenate(buffers), channel, offset, length, log_time, log_time, row, position
        )


def _parsed(path: Path) -> Any:
    try:
        from pyulog import ULog
    except ImportError as exc:
        raise UnsupportedLogError(
            path, "it is a ULog of PX4, which is read with pyulog", "pip install 'sinstool[px4]'"
        ) from exc
    names = sorted({name for topic in TOPICS for name in topic.sources})
    try:
        # It prints what it finds corrupt, and our output may be JSON
        with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere):
            return ULog(str(path), names)
    # It raises exceptions of many classes, TypeErrors included.
    except Exception as exc:
        raise DamagedLogError(path, f"pyulog cannot read this ULog ({exc})") from exc
