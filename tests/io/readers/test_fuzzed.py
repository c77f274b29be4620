"""Damaged logs are read or refused, by errors of our own and in one line.

`python benchmarks/fuzz_readers.py` reads far more of them, with limits of time and memory.
"""

import lzma
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks import fuzz_inputs, fuzz_readers
from sinstool.core.errors import SinstoolError
from sinstool.io.readers import open_log

# Damaged logs that were once read wrong, each named after what led astray
WRONG_ONCE = sorted(Path(__file__).with_name("read_wrong_once").iterdir())


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz") / "logs"
    fuzz_inputs.make_logs(folder)
    fuzz_inputs.make_files(folder)
    return folder


def tried(logs, kind, number, folder):
    folder.mkdir()
    made = fuzz_inputs.make_input(logs, kind, 1, number, folder)
    outcome, details = fuzz_readers.try_input(made.path, kind, made.salvage, number % 10 == 0)
    assert outcome in fuzz_readers.FINE, f"{made}: {details}"
    return outcome


@pytest.mark.slow
@pytest.mark.parametrize("kind", [*fuzz_inputs.FORMATS, *fuzz_inputs.TEXTS])
def test_damaged_logs_and_files_are_read_or_refused(logs, tmp_path, kind):
    outcomes = [tried(logs, kind, n, tmp_path / str(n)) for n in range(150)]
    # neither a reader that refuses all, nor damage that harms none
    assert {"read", "refused"} == set(outcomes)


@pytest.mark.parametrize("salvage", [False, True])
@pytest.mark.parametrize("packed", WRONG_ONCE, ids=lambda path: path.stem)
def test_what_was_read_wrong_once_is_not_again(tmp_path, packed, salvage):
    path = tmp_path / packed.stem
    path.write_bytes(lzma.decompress(packed.read_bytes()))
    outcome, details = fuzz_readers.try_input(path, path.suffix[1:], salvage)
    assert outcome in fuzz_readers.FINE, details


def test_whole_logs_and_files_are_read(logs):
    for path in logs.glob("*/*"):
        assert fuzz_readers.try_input(path, path.parent.name, False) == ("read", ""), path


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
