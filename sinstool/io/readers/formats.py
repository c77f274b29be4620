"""The format of a log by its first bytes: one table, without numpy."""

from __future__ import annotations

from typing import BinaryIO

MCAP_MAGIC = b"\x89MCAP0\r\n"
# Of every version; only one of them is read.
ROSBAG1_MAGIC = b"#ROSBAG V"
MAGICS = {"mcap": MCAP_MAGIC, "rosbag1": ROSBAG1_MAGIC, "sqlite": b"SQLite format 3"}
# What a folder holds that is one log: a ROS 2 bag
METADATA = "metadata.yaml"
_HEAD = 16


def kind_of(stream: BinaryIO) -> tuple[str, bytes]:
    """What a file is.

    Parameters
    ----------
    stream : binary file
        At its beginning; it is read on from there.

    Returns
    -------
    kind : {'mcap', 'rosbag1', 'sqlite', ''}
        '' for what is no log.
    head : bytes
        Its first 16 bytes, fewer where it has no more.
    """
    head = stream.read(_HEAD)
    return next((kind for kind, magic in MAGICS.items() if head.startswith(magic)), ""), head
