"""The format of a log from its first bytes: one table, without numpy."""

from __future__ import annotations

from typing import BinaryIO

MCAP_MAGIC = b"\x89MCAP0\r\n"
# Bags of every version begin so; only version 2.0 is read.
ROSBAG1_MAGIC = b"#ROSBAG V"
ULOG_MAGIC = b"ULog\x01\x125"
MAGICS = {
    "mcap": MCAP_MAGIC,
    "rosbag1": ROSBAG1_MAGIC,
    "sqlite": b"SQLite format 3",
    "ulog": ULOG_MAGIC,
}
# Files that people may take for logs, by their first bytes
OTHERS = {
    b"PK\x03\x04": "a zip archive: unpack it",
    b"\x1f\x8b": "compressed with gzip: unpack it with gunzip",
    b"\x28\xb5\x2f\xfd": "compressed with zstd: unpack it with zstd -d",
    b"\x04\x22\x4d\x18": "compressed with lz4: unpack it with lz4 -d",
    b"BZh": "compressed with bzip2: unpack it with bunzip2",
    b"\xfd7zXZ\x00": "compressed with xz: unpack it with unxz",
    b"PAR1": "a Parquet file, not a recorded log",
    b"\x89HDF": "an HDF5 file, or one of MATLAB, not a recorded log",
    b"\xa3\x95": "a DataFlash log of ArduPilot, which sinstool does not read",
}
# File that marks a folder as one log: a ROS 2 bag
METADATA = "metadata.yaml"
_HEAD = 16


def kind_of(stream: BinaryIO) -> tuple[str, bytes]:
    """The kind of a file, by its first bytes.

    Parameters
    ----------
    stream : binary file
        At its beginning; it is read on from there.

    Returns
    -------
    kind : {'mcap', 'rosbag1', 'sqlite', 'ulog', ''}
        '' for what is no log.
    head : bytes
        Its first 16 bytes, fewer where it has no more.
    """
    head = stream.read(_HEAD)
    return next((kind for kind, magic in MAGICS.items() if head.startswith(magic)), ""), head


def described(head: bytes) -> str:
    """Describe a file that is no log by its first bytes.

    Parameters
    ----------
    head : bytes
        Not empty.
    """
    for magic, what in OTHERS.items():
        if head.startswith(magic):
            return f"not a log: it is {what}"
    try:
        text = head.decode("ascii")
    except UnicodeDecodeError:
        text = "\0"
    if text.replace("\n", " ").replace("\r", " ").replace("\t", " ").isprintable():
        begins = " ".join(text.split())
        return f'not a log: it is text that begins with "{begins}"'
    return f"not a log: it begins with the bytes {head[:8].hex(' ')}"
