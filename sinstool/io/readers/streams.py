"""Streams from a log: columns of each message type, in sinstool's frames and units."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count, islice, takewhile
from types import MappingProxyType
from typing import TypeVar

import numpy as np

from sinstool.core.errors import UnsupportedLogError
from sinstool.core.streams import (
    Baro,
    BaroHeight,
    Encoder,
    Gnss,
    Imu,
    Magnetometer,
    Readings,
    Velocity,
)
from sinstool.io.messages.decode import Decoder
from sinstool.io.messages.layout import Layout, LayoutError, walk
from sinstool.io.readers.frames import enu_to_ned, enu_to_ned_covariance, q_nb_from_log, turn_body
from sinstool.io.readers.log import Channel, Log
from sinstool.io.readers.message_types import GPS_FIX_TYPES, HEIGHT_TYPES, VELOCITY_TYPES

Made = TypeVar("Made")
# Log times and values of messages
Columns = tuple[np.ndarray, dict[str, np.ndarray]]

# Limit of rad/s and m/s^2: beyond the range of any sensor in any unit, so only damage exceeds it
LARGEST = 1e9
XYZ = ("x", "y", "z")
XYZW = ("x", "y", "z", "w")
# Column of what stamps are moved by where a clock was set.
MOVED = "moved"


@dataclass(frozen=True)
class ImuUnits:
    """Units and axes in which a log's IMU topic is read.

    Attributes
    ----------
    body_axes : {'flu', 'frd'}
    gyro_scale, accel_scale : float
        Factors to rad/s and m/s^2 (or to rad and m/s for increments).
    """

    body_axes: str = "flu"
    gyro_scale: float = 1.0
    accel_scale: float = 1.0


@dataclass
class Losses:
    """Messages left out while a stream was read.

    Attributes
    ----------
    malformed : int
        Messages that did not fit their definition.
    nonfinite : int
        Messages with NaN, infinity or numbers beyond any sensor's range.
    problem : str
        What was wrong with the first malformed message.
    """

    malformed: int = 0
    nonfinite: int = 0
    problem: str = ""


def _vector(path: str) -> list[str]:
    return [f"{path}.{axis}" for axis in XYZ]


# Fields that a message of any type must have to be read as an IMU
IMU_FIELDS = ("header.stamp", *_vector("angular_velocity"), *_vector("linear_acceleration"))


def stamp(columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Times of headers, ns."""
    time_ns = columns["sec"].astype(np.int64) * 1_000_000_000 + columns["nanosec"].astype(np.int64)
    return time_ns + columns[MOVED] if MOVED in columns else time_ns


def header(prefix: str = "") -> dict[str, list[str]]:
    """Columns of the stamp in the header of a message at a path, for :func:`stamp`."""
    return {"sec": [f"{prefix}header.stamp.sec"], "nanosec": [f"{prefix}header.stamp.nanosec"]}


def read_columns(
    log: Log,
    channels: Sequence[Channel],
    columns: Mapping[str, Sequence[str]],
    losses: Losses,
    progress: Callable[[int], None] | None = None,
    widths: Mapping[str, int] = MappingProxyType({}),
) -> Iterator[Columns]:
    """Decoded columns of one topic, batch by batch, in file order, without steps of clocks.

    Parameters
    ----------
    channels : sequence of Channel
        All channels that carry the topic (a topic may have several).
    columns : mapping
        As for `Decoder`.
    losses : Losses
        Counts the messages left out.
    progress : callable, optional
        Called with the bytes of the log read so far.
    widths : mapping of str to int
        Number of elements of columns whose paths are arrays; other columns have one for each path.

    Yields
    ------
    log_time_ns : ndarray of int64, shape (n,)
    values : dict of str to ndarray
        Valid rows only.

    Raises
    ------
    UnsupportedLogError
        A column does not have the expected number of elements by the log's own definition.
    """
    topics = {c.id: c.topic for c in channels}

    def checked(number: int, work: Callable[[], Made]) -> Made:
        try:
            return work()
        except LayoutError as exc:
            raise UnsupportedLogError(log.path, f"topic {topics[number]}: {exc}") from exc

    decoders = {
        c.id: checked(c.id, partial(Decoder, c.definition(log.path), columns)) for c in channels
    }
    met = dict.fromkeys(decoders, 0)
    for batch in log.batches(list(decoders)):
        if progress is not None:
            progress(batch.position)
        present = list(decoders) if len(decoders) == 1 else np.unique(batch.channel).tolist()
        parts: list[Columns] = []
        places: list[np.ndarray] = []
        for number in present:
            one = batch if len(decoders) == 1 else batch.select([number])
            decode = partial(decoders[number].decode, one.buffer, one.offset, one.length)
            decoded = checked(number, decode)
            log_time_ns, clocks = one.log_time, log.clocks.get(number)
            if clocks is not None:
                rows = np.arange(met[number], met[number] + len(one))
                decoded.values[MOVED] = clocks.stamp.moves(rows)
                log_time_ns = log_time_ns + clocks.log.moves(rows)
                met[number] += len(one)
            for name, paths in columns.items():
                width = decoded.values[name].size // len(one)
                if width != widths.get(name, len(paths)) and decoded.valid.any():
                    raise UnsupportedLogError(
                        log.path, f"topic {topics[number]}: {paths[0]} has {width} elements"
                    )
            bad = len(one) - int(np.count_nonzero(decoded.valid))
            if bad:
                losses.malformed += bad
                losses.problem = losses.problem or decoders[number].problem
            whole = log_time_ns, decoded.values
            if bad == len(one):
                continue
            keep = decoded.valid
            parts.append(_rows(whole, keep) if bad else whole)
            if len(present) > 1:
                places.append(np.flatnonzero(batch.channel == number)[keep])
        if len(parts) > 1:
            # Channels may take turns
            yield _rows(_joined(parts), np.argsort(np.concatenate(places)))
        else:
            yield from parts


def _rows(columns: Columns, which: np.ndarray) -> Columns:
    """Log times and values of some messages."""
    log_time_ns, values = columns
    return log_time_ns[which], {name: column[which] for name, column in values.items()}


def _joined(parts: Sequence[Columns]) -> Columns:
    """Log times and values of several channels, one after the other."""
    for log_time_ns, values in parts:
        values.setdefault(MOVED, np.zeros_like(log_time_ns))
    return np.concatenate([log_time_ns for log_time_ns, _ in parts]), {
        name: np.concatenate([values[name] for _, values in parts]) for name in parts[0][1]
    }


def read_imu(
    log: Log,
    channels: Sequence[Channel],
    units: ImuUnits,
    losses: Losses,
    *,
    path: str = "",
    log_time: bool = False,
    orientation: bool | Callable[[], bool] = False,
    progress: Callable[[int], None] | None = None,
) -> Iterator[Imu]:
    """IMU samples of a topic, in file order, in FRD and SI units.

    Parameters
    ----------
    path : str
        Where the IMU lies inside the message, for types that nest one ('' for plain IMU).
    log_time : bool
        Use the recorder's time instead of the header stamp.
    orientation : bool or callable
        Read the orientation too. A callable is asked before each batch; while it returns False
        the rows are NaN, which saves converting orientations that are no longer needed.
    progress : callable, optional
        Called with the bytes of the log read so far.

    Yields
    ------
    Imu
        Never empty; samples that are not finite, or beyond any sensor's range, are left out.
    """
    prefix = f"{path}." if path else ""
    columns: dict[str, Sequence[str]] = {
        **header(prefix),
        "gyro": _vector(f"{prefix}angular_velocity"),
        "accel": _vector(f"{prefix}linear_acceleration"),
    }
    definitions = [channel.definition(log.path) for channel in channels]
    oriented = all(one.has(f"{prefix}orientation.w") for one in definitions)
    covered = all(one.has(f"{prefix}orientation_covariance") for one in definitions)
    if orientation and oriented:
        columns["q"] = [f"{prefix}orientation.{axis}" for axis in XYZW]
        if covered:
            columns["q_covariance"] = [f"{prefix}orientation_covariance"]
    axes = turn_body(np.ones(3), units.body_axes)
    gyro_scale, accel_scale = units.gyro_scale * axes, units.accel_scale * axes
    widths = {"q_covariance": 9}
    for log_time_ns, values in read_columns(log, channels, columns, losses, progress, widths):
        # Damaged values, which are left out below, may overflow or be signalling NaN.
        with np.errstate(over="ignore", invalid="ignore"):
            gyro: np.ndarray = values["gyro"] * gyro_scale
            accel: np.ndarray = values["accel"] * accel_scale
        q = None
        if orientation:
            if oriented and (orientation is True or orientation()):
                # All zeros: not known
                covariance = values["q_covariance"] if covered else np.zeros((len(gyro), 9))
                q = _orientation(values["q"], covariance, units.body_axes)
            else:
                q = np.broadcast_to(np.nan, (len(gyro), 4))
        block = Imu(log_time_ns if log_time else stamp(values), log_time_ns, gyro, accel, q)
        # False for NaN as well
        small = np.abs(gyro) < LARGEST, np.abs(accel) < LARGEST
        if not (small[0].all() and small[1].all()):
            usable = (small[0] & small[1]).all(axis=1)
            losses.nonfinite += int(len(usable) - np.count_nonzero(usable))
            block = block.rows(usable)
        if len(block):
            yield block


def _orientation(q_xyzw: np.ndarray, covariance: np.ndarray, axes: str) -> np.ndarray:
    """q_nb of Imu messages; NaN where the message declares none or its norm is not 1."""
    norm = np.sqrt(np.einsum("ij,ij->i", q_xyzw, q_xyzw))
    good = (covariance[:, 0] != -1.0) & (np.abs(norm - 1.0) < 0.05)
    q = np.full((len(q_xyzw), 4), np.nan)
    wxyz = q_xyzw[good][:, [3, 0, 1, 2]] / norm[good, None]
    q[good] = q_nb_from_log(wxyz, axes)
    return q


def read_fixes(log: Log, channels: Sequence[Channel], losses: Losses) -> Iterator[Gnss]:
    """NavSatFix messages, or GPSFix, covariance turned from ENU to NED."""
    columns = {
        **header(),
        "latitude": ["latitude"],
        "longitude": ["longitude"],
        "altitude": ["altitude"],
        "covariance": ["position_covariance"],
        "covariance_type": ["position_covariance_type"],
        "status": ["status.status"],
    }
    widths = {"covariance": 9}
    for log_time_ns, v in read_columns(log, channels, columns, losses, widths=widths):
        enu = v["covariance"].reshape(-1, 3, 3)
        yield Gnss(
            stamp(v),
            log_time_ns,
            np.radians(v["latitude"]),
            np.radians(v["longitude"]),
            v["altitude"],
            enu_to_ned_covariance(enu),
            v["covariance_type"].astype(np.int64),
            v["status"].astype(np.int64),
        )


def read_velocity(log: Log, channels: Sequence[Channel], losses: Losses) -> Iterator[Velocity]:
    """Velocity over ground (TwistStamped, TwistWithCovarianceStamped, Odometry in ENU; GPSFix)."""
    if channels[0].type in GPS_FIX_TYPES:
        yield from _velocity_of_fixes(log, channels, losses)
        return
    plain = channels[0].type == VELOCITY_TYPES[0]
    columns = {**header(), "linear": _linear(channels)}
    if not plain:
        columns["covariance"] = ["twist.covariance"]
    widths = {"covariance": 36}
    for log_time_ns, v in read_columns(log, channels, columns, losses, widths=widths):
        enu = np.zeros((len(log_time_ns), 3, 3))
        if not plain:
            enu = v["covariance"].reshape(-1, 6, 6)[:, :3, :3]
        ned = enu_to_ned_covariance(enu)
        yield Velocity(stamp(v), log_time_ns, enu_to_ned(v["linear"]), ned)


def _velocity_of_fixes(log: Log, channels: Sequence[Channel], losses: Losses) -> Iterator[Velocity]:
    """Velocity from speed, course and climb of GPSFix messages.

    Its sigmas are not used, as few receivers fill them in.
    """
    columns = {**header(), "speed": ["speed"], "track": ["track"], "climb": ["climb"]}
    for log_time_ns, v in read_columns(log, channels, columns, losses):
        # At rest the course is undefined
        course = np.where(v["speed"] == 0.0, 0.0, np.radians(v["track"]))
        north, east = v["speed"] * np.cos(course), v["speed"] * np.sin(course)
        unknown = np.zeros((len(log_time_ns), 3, 3))
        yield Velocity(stamp(v), log_time_ns, np.stack([north, east, -v["climb"]], 1), unknown)


def _linear(channels: Sequence[Channel]) -> list[str]:
    """Field paths of the velocity in the types that hold one."""
    return _vector(
        "twist.linear" if channels[0].type == VELOCITY_TYPES[0] else "twist.twist.linear"
    )


def read_twist(log: Log, channels: Sequence[Channel], losses: Losses) -> Iterator[Readings]:
    """Linear velocity of the types of :func:`read_velocity`, in the axes of the log."""
    for log_time_ns, v in read_columns(log, channels, {**header(), "v": _linear(channels)}, losses):
        yield Readings(stamp(v), log_time_ns, v["v"])


def read_pressure(log: Log, channels: Sequence[Channel], losses: Losses) -> Iterator[Baro]:
    """FluidPressure messages."""
    columns = {**header(), "pressure": ["fluid_pressure"], "variance": ["variance"]}
    for log_time_ns, v in read_columns(log, channels, columns, losses):
        yield Baro(stamp(v), log_time_ns, v["pressure"], v["variance"])


def read_field(
    log: Log, channels: Sequence[Channel], axes: str, losses: Losses
) -> Iterator[Magnetometer]:
    """MagneticField messages in FRD, T; values that are zero or not finite are left out."""
    columns = {**header(), "field": _vector("magnetic_field")}
    for log_time_ns, v in read_columns(log, channels, columns, losses):
        block = Magnetometer(stamp(v), log_time_ns, turn_body(v["field"], axes))
        with np.errstate(invalid="ignore"):
            usable = (np.abs(block.field) < LARGEST).all(axis=1) & block.field.any(axis=1)
        losses.nonfinite += int(len(usable) - np.count_nonzero(usable))
        if usable.any():
            yield block.rows(usable)


def read_height(log: Log, channels: Sequence[Channel], losses: Losses) -> Iterator[BaroHeight]:
    """Height, m, as the z of a PointStamped, or as a bare Float64 stamped with the log time."""
    bare = channels[0].type == HEIGHT_TYPES[1]
    columns = {"height": ["data"]} if bare else {**header(), "height": ["point.z"]}
    for log_time_ns, v in read_columns(log, channels, columns, losses):
        yield BaroHeight(log_time_ns if bare else stamp(v), log_time_ns, v["height"])


def read_joint(
    log: Log, channels: Sequence[Channel], joint: str, losses: Losses
) -> Iterator[Encoder]:
    """Position of one joint of JointState messages; those that lack it are left out."""
    columns = {**header(), "position": [f"position[name={joint}]"]}
    for log_time_ns, v in read_columns(log, channels, columns, losses):
        yield Encoder(stamp(v), log_time_ns, v["position"])


def read_joint_rates(
    log: Log, channels: Sequence[Channel], joints: Sequence[str], losses: Losses
) -> Iterator[Readings]:
    """Velocities of some joints of JointState messages; those that lack one are left out."""
    columns = {**header(), "rates": [f"velocity[name={joint}]" for joint in joints]}
    for log_time_ns, v in read_columns(log, channels, columns, losses):
        yield Readings(stamp(v), log_time_ns, v["rates"].reshape(-1, len(joints)))


def joint_names(log: Log, channels: Sequence[Channel], messages: int = 1) -> list[str]:
    """Names of the joints in a topic's first messages."""
    names: dict[str, None] = {}
    for layout, payload in islice(layouts(log, channels), messages):
        paths = takewhile(layout.leaves.__contains__, (f"name[{k}]" for k in count()))
        names |= dict.fromkeys(layout.text(path, payload) for path in paths)
    return list(names)


def first_fix(log: Log, channels: Sequence[Channel]) -> Gnss | None:
    """The first valid fix of a log, as a stream of one row; None where there is none."""
    for block in read_fixes(log, channels, Losses()):
        good = block.has_fix & block.on_earth
        if good.any():
            return block.rows(np.flatnonzero(good)[:1])
    return None


def frame_id(
    log: Log, channels: Sequence[Channel], path: str = "", field: str = "header.frame_id"
) -> str:
    """frame_id, or another text field, of a topic's first message ('' without one)."""
    field = f"{path}.{field}" if path else field
    for layout, payload in layouts(log, channels):
        return layout.text(field, payload) if field in layout.leaves else ""
    return ""


def layouts(log: Log, channels: Sequence[Channel]) -> Iterator[tuple[Layout, bytes]]:
    """Messages of a topic one by one, each with where its fields lie."""
    definitions = {c.id: c.definition(log.path) for c in channels}
    for batch in log.batches(list(definitions)):
        for i in range(len(batch)):
            start, length = int(batch.offset[i]), int(batch.length[i])
            payload = batch.buffer[start : start + length].tobytes()
            try:
                yield walk(definitions[int(batch.channel[i])], payload), payload
            except LayoutError:
                continue
