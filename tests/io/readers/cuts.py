"""Logs of about 20 kB in every format, to be cut anywhere, and what is in them."""

import sqlite3
from pathlib import Path

from tests.helpers.logs import content, rows, write_bag1, write_db3, write_mcap

CHUNK = 3000


def small_pages(path: Path) -> Path:
    """A database in pages of 512 bytes, of which 20 kB has many."""
    write_db3(path, content(32))
    database = sqlite3.connect(path, isolation_level=None)
    database.execute("PRAGMA page_size=512")
    database.execute("VACUUM")
    database.close()
    return path


LOGS = {
    "MCAP, zstd": lambda p: write_mcap(p / "a.mcap", rows(60), chunk_size=CHUNK),
    "MCAP, lz4": lambda p: write_mcap(p / "a.mcap", rows(50), compression="lz4", chunk_size=CHUNK),
    "MCAP, none": lambda p: write_mcap(
        p / "a.mcap", rows(42), compression="none", chunk_size=CHUNK
    ),
    "MCAP, unchunked": lambda p: write_mcap(p / "a.mcap", rows(42), use_chunking=False),
    "bag, none": lambda p: write_bag1(p / "a.bag", content(20, 1), None, CHUNK),
    "bag, lz4": lambda p: write_bag1(p / "a.bag", content(24, 1), "lz4", CHUNK),
    "bag, bz2": lambda p: write_bag1(p / "a.bag", content(24, 1), "bz2", CHUNK),
    "db3, 4096": lambda p: write_db3(p / "a.db3", content(20)),
    "db3, 512": lambda p: small_pages(p / "a.db3"),
}


def expected(name: str) -> list:
    """Everything that any of the logs holds, in order."""
    if name.startswith("bag"):
        return content(60, 1)
    return rows(60) if name.startswith("MCAP") else content(60)
