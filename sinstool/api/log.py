"""A log opened by a program: its contents, and its sensors as columns."""

from __future__ import annotations

import weakref
from collections.abc import Iterable
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from sinstool.api.options import PathLike, configured, path_of
from sinstool.core.errors import DataError, LogError, TopicError
from sinstool.core.streams import (
    Baro,
    BaroHeight,
    GnssEpochs,
    Imu,
    Magnetometer,
    Stream,
    concatenate,
)

if TYPE_CHECKING:
    from sinstool.config import ProcessConfig
    from sinstool.io.readers.log import Log as Reader
    from sinstool.survey.source import Source

S = TypeVar("S", bound=Stream)
# Topics that log.imu() and its neighbours choose, in place of those of open_log
INPUT = ("input",)


@dataclass(frozen=True)
class Topic:
    """A topic of a log.

    Attributes
    ----------
    topic : str
        Its name.
    type : str
        Of its messages, such as ``sensor_msgs/msg/Imu``.
    messages : int or None
        How many, where the log itself says so.
    """

    topic: str
    type: str
    messages: int | None


class Log:
    """A log, opened; made by `open_log`.

    Arrays that it gives are in body axes Forward-Right-Down and navigation axes North-East-Down,
    in SI units and radians, by time and without repeated stamps. They cannot be written to.

    Attributes
    ----------
    path : pathlib.Path
    format : str
        ``mcap``, ``rosbag1`` or ``rosbag2``, or what a plug-in reads.
    options : dict
        What `open_log` was given.
    """

    def __init__(self, reader: Reader, options: dict[str, Any]) -> None:
        self._opened = reader
        # Of a log that nobody closes, the file is closed when the log is forgotten.
        self._closing = weakref.finalize(self, reader.close)
        self.path: Path = reader.path
        self.format = reader.format
        self.options = options
        self._sources: dict[str | None, Source] = {}

    @property
    def topics(self) -> tuple[Topic, ...]:
        """The topics of the log, by name.

        Examples
        --------
        >>> import sinstool
        >>> with sinstool.open_log("sample_data/static.mcap") as log:
        ...     print(log.topics[0].topic, log.topics[0].type)
        /gnss/fix sensor_msgs/msg/NavSatFix
        """
        by_name: dict[str, Topic] = {}
        for number, channel in self._opened.channels.items():
            count = self._opened.counts.get(number)
            before = by_name.get(channel.topic)
            if before is not None:
                both = before.messages is not None and count is not None
                count = before.messages + count if both else None  # type: ignore[operator]
            by_name[channel.topic] = Topic(channel.topic, channel.type, count)
        return tuple(by_name[name] for name in sorted(by_name))

    def imu(self, topic: str | None = None) -> Imu:
        """Samples of an IMU topic.

        Parameters
        ----------
        topic : str, optional
            By default the one that ``process`` takes.

        Returns
        -------
        Imu
            ``time_ns`` (n,), ``gyro`` (n, 3) in rad/s, ``accel`` (n, 3) in m/s^2. Of a log opened
            with ``gyro_kind="increment"`` they are mean rates over the sample intervals.

        Raises
        ------
        TopicError
            There is no such topic, or several and none is obvious.
        DataError
            It has no usable sample, or its unit is another than configured.

        Examples
        --------
        >>> import sinstool
        >>> imu = sinstool.open_log("sample_data/static.mcap").imu()
        >>> imu.gyro.shape, round(float(imu.accel[:, 2].mean()), 2)
        ((2001, 3), -9.78)
        """
        from sinstool.survey.source import rate_blocks

        config = self._config(imu_topic=topic)
        source = self._source(topic, config)
        return frozen(_joined(rate_blocks(source, config, source.survey.first_ns)))

    def gnss(self, topic: str | None = None, velocity_topic: str | None = None) -> GnssEpochs:
        """Positions and velocities of a receiver, by epoch.

        Parameters
        ----------
        topic : str, optional
            With NavSatFix messages; by default the best one.
        velocity_topic : str, optional
            By default one that agrees with the fixes.

        Returns
        -------
        GnssEpochs
            ``time_ns`` (n,), ``latitude`` and ``longitude`` (n,) in rad, ``height`` (n,) in m above
            the ellipsoid, ``velocity_n`` (n, 3) in m/s, ``sigma_position_n`` and
            ``sigma_velocity_n`` (n, 3); NaN where an epoch has none.

        Raises
        ------
        TopicError
            The log holds neither fixes nor velocities.
        DataError
            They are in another unit than configured.

        Examples
        --------
        >>> import sinstool
        >>> gnss = sinstool.open_log("sample_data/static.mcap").gnss()
        >>> round(float(gnss.latitude[0]) * 180 / 3.141592653589793, 3)
        45.0
        """
        from sinstool.survey.gnss import read_gnss

        config = self._config(gnss_topic=topic, velocity_topic=velocity_topic)
        aiding = read_gnss(self._reader, config.input, self._log_time())
        if aiding.gnss is None:
            raise self._absent("fixes or velocities", "NavSatFix")
        return frozen(aiding.gnss)

    def barometer(self, topic: str | None = None) -> Baro | BaroHeight:
        """Static pressure, or height, if the log was opened with ``baro_kind="height"``.

        Parameters
        ----------
        topic : str, optional
            By default the only one.

        Returns
        -------
        Baro or BaroHeight
            ``time_ns`` (n,) and ``pressure`` (n,) in Pa, or ``height`` (n,) in m.

        Raises
        ------
        TopicError
            There is no such topic, or there are several.
        DataError
            Pressures are in another unit than configured.

        Examples
        --------
        >>> import sinstool
        >>> drive = sinstool.simulate("drive", duration=30.0)
        >>> print(round(drive.barometer().pressure.mean(), -3))
        95000.0
        """
        from sinstool.survey.aiding import read_barometer

        config = self._config(baro_topic=topic)
        read = read_barometer(self._reader, config.input, self._log_time())
        if read.problem is not None:
            raise read.problem
        if read.stream is None and read.findings:
            raise DataError(self.path, read.findings[0].text)
        if read.stream is None:
            raise self._absent("a barometer", "FluidPressure")
        return frozen(read.stream)

    def magnetometer(self, topic: str | None = None) -> Magnetometer:
        """The magnetic field, in means over 0.02 s where samples are closer together.

        Parameters
        ----------
        topic : str, optional
            By default the one that belongs to the IMU.

        Returns
        -------
        Magnetometer
            ``time_ns`` (n,) and ``field`` (n, 3) in T.

        Raises
        ------
        TopicError
            There is no such topic, or the log does not show which one is meant.
        DataError
            It has no usable sample.

        Examples
        --------
        >>> import sinstool
        >>> sinstool.open_log("sample_data/static.mcap").magnetometer()
        Traceback (most recent call last):
            ...
        sinstool.core.errors.TopicError: sample_data/static.mcap: it holds no magnetic field ...
        """
        from sinstool.survey.magnetometer import choose_magnetometer, read_magnetometer

        config = self._config()
        source = self._source(None, config)
        chosen = choose_magnetometer(self._reader, topic, source.imu_topic, source.body_frame)
        if not chosen.topic:
            if chosen.doubtful:
                raise TopicError(self.path, f"no magnetometer is chosen, {chosen.reason}")
            raise self._absent("a magnetic field", "MagneticField")
        log_time = self._log_time()
        field, findings = read_magnetometer(self._reader, chosen, config.input.body_axes, log_time)
        if field is None:
            raise DataError(self.path, str(findings[0]))
        return frozen(field)

    def close(self) -> None:
        """Close the file. A ``with`` block does it too."""
        self._closing()

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Log: {self.path}, {self.format}, {len(self.topics)} topics>"

    @property
    def _reader(self) -> Reader:
        if not self._closing.alive:
            raise LogError(self.path, "the log is closed", "open it again with open_log")
        return self._opened

    def _config(self, **topics: str | None) -> ProcessConfig:
        chosen = {name: topic for name, topic in topics.items() if topic is not None}
        return configured("open_log", INPUT, {**self.options, **chosen})

    def _source(self, topic: str | None, config: ProcessConfig) -> Source:
        """The survey of an IMU topic, made once."""
        from sinstool.survey.source import prepare

        reader = self._reader
        if topic not in self._sources:
            self._sources[topic] = prepare(reader, config, gyro_only=True)
        return self._sources[topic]

    def _log_time(self) -> bool:
        """Whether the recorder's times are used in place of stamps, as the IMU shows."""
        try:
            source = self._source(None, self._config())
        except (TopicError, DataError):
            return False
        return source.survey.time_source == "log"

    def _absent(self, what: str, kind: str) -> LogError:
        from sinstool.io.readers.message_types import SENSOR_TYPES
        from sinstool.io.readers.topics import unread_clause

        topics = ", ".join(one.topic for one in self.topics) or "none"
        types = [name for name in SENSOR_TYPES if name.endswith(f"/{kind}")]
        unread = unread_clause(self._reader, *types)
        return TopicError(
            self.path,
            f"it holds no {what.removeprefix('a ')} (no {kind} topic{unread})",
            f"its topics are {topics}",
        )


def open_log(path: PathLike, **options: Any) -> Log:
    """Open a recorded log: MCAP, a ROS 1 bag or a ROS 2 bag.

    Parameters
    ----------
    path : path-like
        A file, or the folder of a ROS 2 bag. Formats are detected from content.
    **options
        What to read and how, as the command line's options in the group "Input" are named:
        ``salvage``, ``imu_topic``, ``body_axes``, ``gyro_unit``, ``gyro_kind``, ``start``, ``end``
        and the others of the table ``[input]``.

    Returns
    -------
    Log

    Raises
    ------
    NotALogError
        There is no such file, or it is none of these.
    DamagedLogError
        The log is damaged, and ``salvage`` is not set.
    ConfigurationError
        An option is unknown or impossible.

    Examples
    --------
    >>> import sinstool
    >>> with sinstool.open_log("sample_data/static.mcap") as log:
    ...     imu = log.imu()
    >>> imu
    <Imu: 2001 rows over 20.000 s; time_ns, log_time_ns, gyro, accel>
    """
    from sinstool.io.readers import open_log as open_reader

    config = configured("open_log", INPUT, options)
    return Log(open_reader(path_of(path), config.input.salvage), dict(options))


def log_path(log: PathLike | Log, options: dict[str, Any]) -> tuple[Path, dict[str, Any]]:
    """The path of a log, and options with those that it was opened with."""
    if isinstance(log, Log):
        return log.path, {**log.options, **options}
    return path_of(log), options


def frozen(stream: S) -> S:
    """The same stream in arrays that are contiguous and cannot be written to."""
    columns = {}
    for one in fields(stream):
        value = getattr(stream, one.name)
        if isinstance(value, np.ndarray):
            value = np.ascontiguousarray(value).view()
            value.flags.writeable = False
        elif is_dataclass(value) and isinstance(value, Stream):
            value = frozen(value)
        columns[one.name] = value
    return replace(stream, **columns)


def _joined(blocks: Iterable[S]) -> S:
    return concatenate(list(blocks))
