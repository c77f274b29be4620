"""The damaged logs of `damaged.py`: all that is there is read, nothing else, and at what cost."""

import json
import subprocess
import sys
from collections import Counter

import pytest

from sinstool.core.errors import NotALogError, SinstoolError
from sinstool.io.readers import open_log
from sinstool.io.readers.lost import Lost, LostParts
from tests.helpers.logs import read_back, rows, same_time
from tests.helpers.paths import ROOT
from tests.io.readers.damaged import CASES

BY_NAME = {case.name: case for case in CASES}
# Payloads or times that are other than in the log that was damaged, because they were made so
OTHERWISE = {
    "a payload cut short",
    "an empty payload",
    "a payload in XCDR2",
    "big-endian payloads",
    "bit flip in a payload",
    "bit flip in zstd data",
    "schema encoding jsonschema",
    "schema encoding protobuf",
    "ROS 1 definition, CDR messages",
    "no profile",
    "no schema",
    "empty schema text",
}


def test_there_are_as_many_as_there_were():
    assert BY_NAME.keys() > OTHERWISE
    assert len(BY_NAME) == len(CASES) >= 58


@pytest.mark.parametrize("name", BY_NAME)
def test_all_that_is_there_is_read(tmp_path, name):
    case = BY_NAME[name]
    path = case.make(tmp_path)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir() if p.is_file()}
    strict = ""
    try:
        with open_log(path) as log:
            whole = read_back(log)
    except SinstoolError as exc:
        strict = str(exc)
        assert "\n" not in strict
        assert str(path) in strict
    assert case.strict in strict
    assert bool(case.strict) == bool(strict)
    try:
        with open_log(path, salvage=True) as log:
            result = read_back(log)
            assert bool(log.lost) == (bool(strict) or "unknown channel" in name)
            for part in log.lost:
                assert part.start_ns is None or part.end_ns is None or part.start_ns <= part.end_ns
    except NotALogError:
        result = []
    assert len(result) >= case.at_least(path)
    if not strict:
        assert result == whole
    if path.suffix == ".mcap":
        assert bool(Counter(result) - Counter(rows(1500))) == (name in OTHERWISE)
    if path.suffix == ".db3":
        assert not Counter(result) - Counter(same_time(rows(1500)))
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir() if p.is_file()} == before


READ_ALL = """
import json, sys
from pathlib import Path
from sinstool.core.errors import SinstoolError
from sinstool.io.readers import open_log

def peak():
    for line in open("/proc/self/status"):
        if line.startswith("VmHWM"):
            return int(line.split()[1]) // 1024

said = {}
for path in sys.argv[1:]:
    open("/proc/self/clear_refs", "w").write("5")
    count = 0
    for salvage in (False, True):
        try:
            with open_log(path, salvage) as log:
                for batch in log.batches():
                    count += len(batch)
        except SinstoolError:
            pass
    said[path] = peak()
print(json.dumps(said))
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="peak memory is read from /proc")
def test_none_takes_more_than_500_mb(tmp_path):
    paths = []
    for number, case in enumerate(CASES):
        folder = tmp_path / str(number)
        folder.mkdir()
        paths.append(case.make(folder))
    done = subprocess.run(
        [sys.executable, "-c", READ_ALL, *paths],
        capture_output=True,
        text=True,
        timeout=300,
        cwd=ROOT,
    )
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert len(said) == len(CASES)
    assert {path: peak for path, peak in said.items() if peak >= 500} == {}


def test_the_span_of_a_loss_between_chunks_that_overlap_begins_with_the_earlier_time():
    losses = LostParts()
    lost = losses.note(Lost("a chunk's CRC does not match its content", "chunk", 100, 200))
    losses.between(100, 40, 10)
    assert losses.waiting  # it lies behind what was read
    losses.between(300, 50, 20)
    assert (lost.start_ns, lost.end_ns) == (20, 50) and not losses.waiting
