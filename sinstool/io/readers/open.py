"""Open a log in whatever format its first bytes indicate."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from sinstool.core import plugins
from sinstool.core.errors import NotALogError, UnsupportedLogError, no_such_log
from sinstool.core.memory import keep_freed_memory
from sinstool.io.readers.formats import described, kind_of

if TYPE_CHECKING:
    from sinstool.io.readers.log import Log

GROUP = "sinstool.readers"
READS = "sinstool reads MCAP, ROS 1 .bag, ROS 2 bags (a directory or a single .db3) and ULog of PX4"


def open_log(path: Path | str, salvage: bool = False) -> Log:
    """Open a recorded log.

    Parameters
    ----------
    path : path-like
        An MCAP file, a ROS 1 bag, a ROS 2 bag directory, a single ``.db3`` or a ULog; recognised by
        content, not by suffix. Other distributions add formats with an entry point of the group
        ``sinstool.readers``, which names a subclass of
        :class:`~sinstool.io.readers.log.Log` with a class method ``recognises(path, head)``,
        where ``head`` is the first 16 bytes.
    salvage : bool
        Skip damaged parts and record them in ``lost``.

    Raises
    ------
    NotALogError
        The path does not exist, cannot be read, is empty or is none of these.
    DamagedLogError
        The log is damaged and `salvage` is off.
    UnsupportedLogError
        It uses an encoding, compression or version that sinstool does not read.
    """
    keep_freed_memory()
    path = Path(path)
    if not path.exists():
        raise no_such_log(path)
    if path.is_dir():
        from sinstool.io.readers.rosbag2 import Rosbag2Log

        return Rosbag2Log(path, salvage)
    if not path.is_file():
        # Reading it could block, and it cannot be read twice.
        raise NotALogError(path, "is a device or a pipe", "write what comes through it to a file")
    try:
        with path.open("rb") as stream:
            kind, head = kind_of(stream)
    except OSError as exc:
        raise NotALogError(path, f"cannot be read ({exc.strerror})") from exc
    if not head:
        raise NotALogError(path, "the file is empty")
    if kind == "mcap":
        from sinstool.io.readers.mcap import McapLog

        return McapLog(path, salvage)
    if kind == "rosbag1":
        from sinstool.io.readers.rosbag1 import Rosbag1Log

        return Rosbag1Log(path, salvage)
    if kind == "sqlite":
        from sinstool.io.readers.sqlite import SqliteLog

        return SqliteLog(path, salvage)
    if kind == "ulog":
        from sinstool.io.readers.ulog import UlogLog

        return UlogLog(path, salvage)
    for name in plugins.plugins(GROUP):
        reader = plugins.load(GROUP, name)
        with plugins.blamed(reader, partial(_failed, path, name)):
            if reader.recognises(path, head):
                foreign: Log = reader(path, salvage)
                return foreign
    raise NotALogError(path, described(head), READS)


def _failed(path: Path, name: str, text: str) -> UnsupportedLogError:
    return UnsupportedLogError(path, f"the plug-in {name} fails on it: {text}")
