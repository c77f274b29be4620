"""Messages far larger than what recorders usually write: read whole where there is memory."""

import os

import pytest
import zstandard

from sinstool.core.errors import DamagedLogError
from sinstool.io.readers import compression, open_log
from sinstool.io.readers.compression import CompressionError, decompress, too_large
from sinstool.io.readers.limits import MAX_BLOCK
from tests.helpers.logs import read_back, rows, write_bag1, write_bag2, write_mcap

LARGE = 200_000
WRITERS = {
    "MCAP": lambda p, r: write_mcap(p / "a.mcap", r, compression="none"),
    "MCAP, zstd": lambda p, r: write_mcap(p / "a.mcap", r),
    "MCAP without chunks": lambda p, r: write_mcap(p / "a.mcap", r, use_chunking=False),
    "bag": lambda p, r: write_bag1(p / "a.bag", r),
    "bag, bz2": lambda p, r: write_bag1(p / "a.bag", r, compression="bz2"),
    "db3": lambda p, r: write_bag2(p / "bag", r),
    "db3, zstd": lambda p, r: write_bag2(p / "bag", r, mode="message"),
}


def with_large(size):
    content = rows(9)
    content[4] = content[4]._replace(payload=content[4].payload[:4] + os.urandom(size))
    return content


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
def test_a_large_message_is_read_where_there_is_memory(tmp_path, monkeypatch, write):
    monkeypatch.setattr(compression, "ORDINARY_BLOCK", LARGE // 2)
    content = with_large(LARGE)
    path = write(tmp_path, content)
    with open_log(path) as log:
        assert [row.payload for row in read_back(log)] == [row.payload for row in content]
        assert not log.lost


# SQLite has its own limit, and outside chunks messages are read many at a time.
@pytest.mark.parametrize("name", ["MCAP", "MCAP, zstd", "bag", "bag, bz2"])
def test_one_without_room_is_refused_and_says_what_it_takes(tmp_path, monkeypatch, name):
    monkeypatch.setattr(compression, "ORDINARY_BLOCK", LARGE // 2)
    monkeypatch.setattr(compression, "available", lambda: 3 * LARGE)
    path = WRITERS[name](tmp_path, with_large(LARGE))
    with (
        pytest.raises(DamagedLogError, match="which takes 0 MiB of memory, where 0 MiB are avail"),
        open_log(path) as log,
    ):
        read_back(log)


def test_what_swells_like_no_measurement_is_refused_from_its_declared_size_on():
    size = 300 * 2**20
    packer = zstandard.ZstdCompressor(write_content_size=True)
    bomb = packer.compress(bytes(size))
    assert len(bomb) * compression.MOST_SWELLING < size
    with pytest.raises(CompressionError, match=f"declares {size} bytes, more than the 256 MiB"):
        decompress("zstd", bomb, size)


def test_sizes_beyond_any_message_are_refused_whatever_memory_there_is(monkeypatch):
    monkeypatch.setattr(compression, "available", lambda: None)
    assert too_large(MAX_BLOCK, MAX_BLOCK) == ""
    assert "2047 MiB that are accepted" in too_large(MAX_BLOCK + 1, MAX_BLOCK + 1)
