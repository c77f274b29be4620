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
    st.lists(st.integers(0, 40), min_size=1, max_size=12),
    st.integers(0, 8000),
    st.sampled_from([(), (3,), (4, 4)]),
    st.sampled_from(["f8", "i8", "?"]),
)
def test_rows_come_back_wherever_they_lie(lengths, limit, shape, dtype):
    random = np.random.default_rng(3)
    blocks = [random.integers(0, 2**62, (n, *shape)).astype(dtype) for n in lengths]
    with Storage(limit) as storage:
        for block in blocks:
            storage.append("column", block)
            storage.append("other", np.ones((1, 2)))
        rows = storage.array("column")
        expected = np.concatenate(blocks)
        assert rows.dtype == expected.dtype
        np.testing.assert_array_equal(rows, expected)
        assert bool(storage._files) == (expected.nbytes + 16 * len(blocks) > limit)
        assert len(storage.array("other")) == len(blocks)


def test_rows_may_be_added_and_changed_after_a_look():
    for limit in (0, 10**9):
        with Storage(limit) as storage:
            storage.append("column", np.array([[1.0, 2.0]]))
            storage.array("column")[0, 1] = 5.0
            storage.append("column", np.array([[3.0, 4.0]]))
            np.testing.assert_array_equal(storage.array("column"), [[1.0, 5.0], [3.0, 4.0]])


def test_rows_stay_what_they_are_when_their_memory_is_given_back():
    with Storage(0) as storage:
        storage.append("column", np.arange(2048.0).reshape(-1, 2))
        rows = storage.array("column")
        rows[1000] = -1.0
        storage.release()
        assert rows[3, 1] == 7.0
        np.testing.assert_array_equal(rows[1000], -1.0)
        storage.append("later", np.ones(3))
        np.testing.assert_array_equal(storage.array("later"), 1.0)


@pytest.mark.skipif(not os.path.exists("/proc/self/status"), reason="of Linux")
def test_mapped_rows_that_are_given_back_are_not_in_memory():
    def mapped_kb():
        with open("/proc/self/status") as stream:
            sizes = [int(line.split()[1]) for line in stream if line.startswith("RssFile")]
        return sizes[0]

    with Storage(0) as storage:
        storage.append("column", np.ones((1 << 20, 2)))
        rows = storage.array("column")
        before = mapped_kb()
        assert rows.sum() == 2 << 20
        looked = mapped_kb()
        storage.release()
        assert looked - before > 8 << 10
        assert mapped_kb() - before < 4 << 10


def test_the_file_lies_in_the_system_s_folder_and_is_gone_afterwards(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    descriptors = len(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else None
    with Storage(100) as storage:
        storage.append("column", np.zeros((1, 10)))
        assert not storage._files
        storage.append("column", np.zeros((1, 10)))
        assert storage._files
    assert list(tmp_path.iterdir()) == []
    if descriptors is not None:
        assert len(os.listdir("/proc/self/fd")) == descriptors


def test_memory_is_bounded():
    import tracemalloc

    tracemalloc.start()
    try:
        with Storage(1 << 20) as storage:
            for _ in range(64):
                storage.append("column", np.ones((512, 128)))  # half a megabyte each
            assert storage.array("column").shape == (64 * 512, 128)
            assert tracemalloc.get_traced_memory()[1] < 5 << 20
    finally:
        tracemalloc.stop()


def filled():
    with Storage(0) as storage:
        storage.append("column", np.ones((1, 2)))


def test_the_system_s_folder_is_named_with_what_chooses_it(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))
    with pytest.raises(OutputError) as caught:
        filled()
    assert f"in {tmp_path / 'gone'} cannot be written: No such file" in caught.value.message
    assert "TMPDIR" in caught.value.hint


def test_no_usable_folder_is_reported(monkeypatch):
    """As where all disks are full: Python then finds no place for temporary files at all."""
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setattr(tempfile, "_candidate_tempdir_list", lambda: ["/nowhere/at/all"])
    with pytest.raises(OutputError) as caught:
        filled()
    assert "cannot be written: No usable temporary directory found" in caught.value.message
    assert "TMPDIR" in caught.value.hint


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs the file that is always full")
def test_a_full_folder_is_reported(tmp_path, monkeypatch):
    with open("/dev/full", "w+b", 0) as full:
        monkeypatch.setattr(tempfile, "TemporaryFile", lambda **_: full)
        monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
        with pytest.raises(OutputError) as caught:
            filled()
    assert f"in {tmp_path} cannot be written: No space left on device" in caught.value.message
