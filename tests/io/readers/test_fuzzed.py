"""Damaged logs are read or refused, by errors of our own and in one line.

`python benchmarks/fuzz_readers.py` reads far more of them, with limits of time and memory.
"""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks import fuzz_inputs, fuzz_readers
from sinstool.core.errors import SinstoolError
from sinstool.io.readers import open_log

# Inputs of seed 1 that were read wrong once: an index that points beyond any file, pages of a
# database that lead in a circle, a row longer than memory
CASES = [("mcap", 519), ("db3", 50856), ("db3", 9436)]


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz") / "logs"
    fuzz_inputs.make_logs(folder)
    return folder


def tried(logs, kind, number, folder):
    folder.mkdir()
    made = fuzz_inputs.make_input(logs, kind, 1, number, folder)
    outcome, details = fuzz_readers.try_input(made.path, made.salvage, number % 10 == 0)
    assert outcome in fuzz_readers.FINE, f"{made}: {details}"
    return outcome


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mcap", "bag", "db3"])
def test_damaged_logs_are_read_or_refused(logs, tmp_path, kind):
    outcomes = [tried(logs, kind, n, tmp_path / str(n)) for n in range(150)]
    # neither a reader that refuses all, nor damage that harms none
    assert {"read", "refused"} == set(outcomes)


@pytest.mark.parametrize(("kind", "number"), CASES)
def test_what_was_found_stays_mended(logs, tmp_path, kind, number):
    tried(logs, kind, number, tmp_path / "input")


def test_whole_logs_are_read(logs):
    for path in logs.glob("*/*"):
        assert fuzz_readers.try_input(path, False) == ("read", ""), path


HEADS = [b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n", b"SQLite format 3\0", b""]


@settings(max_examples=200)
@given(head=st.sampled_from(HEADS), body=st.binary(max_size=600), salvage=st.booleans())
def test_any_bytes_behind_a_magic(tmp_path_factory, head, body, salvage):
    path = tmp_path_factory.mktemp("bytes") / "log"
    path.write_bytes(head + body)
    try:
        with open_log(path, salvage) as log:
            for batch in log.batches():
                assert (batch.offset + batch.length <= len(batch.buffer)).all()
    except SinstoolError as exc:
        assert "\n" not in str(exc)
