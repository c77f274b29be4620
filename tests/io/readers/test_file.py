"""Files under a log: closed once, and read right where they become shorter meanwhile."""

import os

import pytest

from sinstool.core.errors import DamagedLogError, NotALogError
from sinstool.io.readers import open_log
from sinstool.io.readers.mcap import McapLog
from sinstool.io.readers.rosbag1 import Rosbag1Log
from tests.helpers.logs import bag_records, content, mcap_records, read_back, write_bag1, write_mcap

MESSAGE, CHUNK, BAG_CHUNK = 0x05, 0x06, 5
LOGS = {
    "unchunked": lambda p: write_mcap(p / "a.mcap", content(), use_chunking=False),
    "zstd": lambda p: write_mcap(p / "a.mcap", content()),
    "none": lambda p: write_mcap(p / "a.mcap", content(), compression="none"),
    "bag": lambda p: write_bag1(p / "a.bag", content(300, 1)),
    "bag of lz4": lambda p: write_bag1(p / "a.bag", content(300, 1), "lz4"),
}


def places(path):
    """Where messages or chunks lie, and one place inside of one."""
    data = path.read_bytes()
    if path.suffix == ".bag":
        listed = [at for op, at, *_ in bag_records(data) if op == BAG_CHUNK]
    else:
        listed = [at for op, at, _ in mcap_records(data) if op in (MESSAGE, CHUNK)]
    middle = listed[len(listed) // 2]
    return [listed[0], middle, middle + 5, middle + 30, middle + 100]


@pytest.mark.parametrize("salvage", [False, True], ids=["strict", "salvage"])
@pytest.mark.parametrize("place", range(5))
@pytest.mark.parametrize("name", LOGS)
def test_a_file_that_becomes_shorter_is_cut_there(tmp_path, monkeypatch, name, place, salvage):
    path = LOGS[name](tmp_path)
    expected = content(300, 1) if path.suffix == ".bag" else content()
    cut = places(path)[place]
    plain, calls = os.pread, []

    def counted(*arguments):
        calls.append(arguments)
        assert len(calls) < 20_000, "an endless loop"
        return plain(*arguments)

    with open_log(path, salvage) as log:
        monkeypatch.setattr(os, "pread", counted)
        os.truncate(path, cut)
        if not salvage:
            with pytest.raises(DamagedLogError):
                read_back(log)
            return
        actual = read_back(log)
        assert log.lost
    assert actual == expected[: len(actual)]
    share = 0.3 if place else 0.0
    assert share * len(expected) <= len(actual) < len(expected)


@pytest.mark.parametrize("kind", [McapLog, Rosbag1Log])
def test_a_file_that_is_refused_is_closed_once(tmp_path, kind):
    """Its number is another file's soon, which nobody else may close."""
    path = tmp_path / "log"
    path.write_bytes(b"text")
    log = kind.__new__(kind)
    with pytest.raises(NotALogError):
        log.__init__(path)
    with path.open("rb") as other:
        log.close()
        assert other.read() == b"text"


@pytest.mark.parametrize("name", ["zstd", "bag"])
def test_bytes_at_any_place(tmp_path, name):
    path = LOGS[name](tmp_path)
    data = path.read_bytes()
    with open_log(path) as log:
        assert log.read_at(5, 2**70) == data[5:]
        assert log.read_at(0, 7) == data[:7]
        assert log.read_at(len(data) - 3, 9) == data[-3:]
        for beyond in (-1, -(2**70), len(data), 2**63, 2**70):
            assert log.read_at(beyond, 4) == b""


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names here")
def test_a_pipe_or_a_device_is_no_log_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", os.devnull):
        with pytest.raises(NotALogError, match="is a device or a pipe: write what comes"):
            open_log(path)
