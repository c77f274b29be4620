import os
import tempfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sinstool.core.errors import OutputError
from sinstool.methods.ins_gnss.storage import Storage


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.integers(0, 40), max_size=12),
    st.integers(0, 8000),
    st.sampled_from([(), (3,), (4, 4)]),
    st.sampled_from(["f8", "i8", "?"]),
)
def test_rows_come_back_wherever_they_lie(lengths, limit, shape, dtype):
    random = np.random.default_rng(3)
    blocks = [random.integers(0, 2**62, (n, *shape)).astype(dtype) for n in lengths]
    with Storage(limit) as storage:
        column, other = storage.column(shape, dtype), storage.column((2,))
        for block in blocks:
            column.append(block)
            other.append(np.ones((1, 2)))
        found = column.array()
        wanted = np.concatenate([np.empty((0, *shape), dtype), *blocks])
        assert found.dtype == wanted.dtype
        np.testing.assert_array_equal(found, wanted)
        assert len(column) == len(wanted)
        assert column.nbytes == wanted.nbytes
        assert storage.spilled == (wanted.nbytes + 16 * len(blocks) > limit)
        assert len(other.array()) == len(blocks)


def test_rows_may_be_added_and_changed_after_a_look():
    for limit in (0, 10**9):
        with Storage(limit) as storage:
            column = storage.column((2,))
            column.append([[1.0, 2.0]])
            column.array()[0, 1] = 5.0
            column.append([[3.0, 4.0]])
            np.testing.assert_array_equal(column.array(), [[1.0, 5.0], [3.0, 4.0]])


def test_the_file_lies_in_the_folder_and_is_gone_afterwards(tmp_path):
    descriptors = len(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else None
    with Storage(100, tmp_path) as storage:
        column = storage.column((10,))
        column.append(np.zeros((1, 10)))
        assert not storage.spilled
        column.append(np.zeros((1, 10)))
        assert storage.spilled
        assert column.spilled
    assert list(tmp_path.iterdir()) == []
    if descriptors is not None:
        assert len(os.listdir("/proc/self/fd")) == descriptors


def test_memory_is_bounded(tmp_path):
    import tracemalloc

    tracemalloc.start()
    try:
        with Storage(1 << 20, tmp_path) as storage:
            column = storage.column((128,))
            for _ in range(64):
                column.append(np.ones((512, 128)))  # half a megabyte each
            assert column.array().shape == (64 * 512, 128)
            assert tracemalloc.get_traced_memory()[1] < 5 << 20
    finally:
        tracemalloc.stop()


def test_wrong_rows_and_a_closed_storage_are_refused():
    storage = Storage()
    column = storage.column((3,))
    with pytest.raises(ValueError, match="shape"):
        column.append(np.zeros((2, 4)))
    with pytest.raises(ValueError, match="shape"):
        column.append(np.zeros(3))
    storage.close()
    with pytest.raises(ValueError, match="closed"):
        column.append(np.zeros((2, 3)))
    with pytest.raises(ValueError, match="closed"):
        column.array()


def filled(folder=None, limit=0):
    with Storage(limit, folder) as storage:
        storage.column((2,)).append(np.ones((1, 2)))


def test_a_folder_that_is_not_there_is_named(tmp_path):
    folder = tmp_path / "nowhere"
    with pytest.raises(OutputError) as told:
        filled(folder)
    assert told.value.message == (
        f"a temporary file in {folder} cannot be written: No such file or directory"
    )
    assert "another folder" in told.value.hint and "TMPDIR" not in told.value.hint


def test_the_system_s_folder_is_named_with_what_chooses_it(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))
    with pytest.raises(OutputError) as told:
        filled()
    assert f"in {tmp_path / 'gone'} cannot be written: No such file" in told.value.message
    assert "TMPDIR" in told.value.hint


def test_a_system_without_any_usable_folder_is_told_of(monkeypatch):
    """As where all disks are full: Python then finds no place for temporary files at all."""
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setattr(tempfile, "_candidate_tempdir_list", lambda: ["/nowhere/at/all"])
    with pytest.raises(OutputError) as told:
        filled()
    assert "cannot be written: No usable temporary directory found" in told.value.message
    assert "TMPDIR" in told.value.hint


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs the file that is always full")
def test_a_full_folder_is_told_of(tmp_path, monkeypatch):
    with open("/dev/full", "w+b", 0) as full:
        monkeypatch.setattr(tempfile, "TemporaryFile", lambda **_: full)
        with pytest.raises(OutputError) as told:
            filled(tmp_path)
    assert f"in {tmp_path} cannot be written: No space left on device" in told.value.message
