"""Temporary files of killed runs go; those of running ones, and of others, stay."""

import os
import signal
import subprocess
import sys
import time

import pytest

from sinstool.core import temporary
from sinstool.core.temporary import TemporaryFolder, new_file, remove_file, sweep

HOLD = """
import sys, time
from pathlib import Path
from sinstool.core.temporary import TemporaryFolder, new_file
if sys.argv[1] == "file":
    print(new_file(Path(sys.argv[2]), "out.mcap")[1], flush=True)
else:
    folder = TemporaryFolder()
    (folder.path / "unpacked").write_bytes(b"x")
    print(folder.path, flush=True)
time.sleep(60)
"""


def held(kind, folder):
    """A process that holds one, and its path."""
    run = subprocess.Popen(
        [sys.executable, "-c", HOLD, kind, folder],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "TMPDIR": str(folder)},
    )
    return run, type(folder)(run.stdout.readline().strip())


def kill(run):
    run.send_signal(signal.SIGKILL)
    run.communicate()


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder that is the system's place for temporary files too."""
    monkeypatch.setattr(temporary.tempfile, "gettempdir", lambda: str(tmp_path))
    return tmp_path


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_a_running_one_stays_and_a_killed_one_goes(place, kind):
    run, path = held(kind, place)
    try:
        assert path.parent == place
        handle, own = new_file(place, "a.mcap")
        folder = TemporaryFolder()
        assert path.exists() and own.exists() and folder.path.exists()
    finally:
        kill(run)
    assert path.exists()
    sweep(place)
    # ours are still open
    assert sorted(place.iterdir()) == sorted([own, folder.path, folder._lock])
    os.close(handle)
    remove_file(own)
    folder.cleanup()
    assert list(place.iterdir()) == []


def test_the_next_one_that_is_made_sweeps(place):
    run, path = held("file", place)
    kill(run)
    handle, own = new_file(place, "out.mcap")
    assert list(place.iterdir()) == [own]
    os.close(handle)
    remove_file(own)
    run, path = held("folder", place)
    kill(run)
    TemporaryFolder().cleanup()
    assert list(place.iterdir()) == []
    assert not path.exists()


def other_host(path):
    """The same file as another host would have named it."""
    return path.rename(path.with_name(path.name.replace(temporary._host(), "0123abcd")))


def aged(path):
    os.utime(path, (time.time() - 90_000.0,) * 2)
    return path


def no_locks(*_):
    raise OSError(95, "Operation not supported")


@pytest.mark.parametrize("why", ["another host", "no locks"])
def test_what_no_lock_can_tell_stays_for_a_day(place, monkeypatch, why):
    run, path = held("file", place)
    kill(run)
    if why == "another host":
        path = other_host(path)
    else:
        monkeypatch.setattr(temporary.fcntl, "flock", no_locks)
    sweep(place)
    assert path.exists()
    aged(path)
    sweep(place)
    assert not path.exists()


def test_a_locked_one_stays_however_old(place):
    run, path = held("file", place)
    try:
        aged(path)
        assert sweep(place) == 1
        assert path.exists()
    finally:
        kill(run)
    assert sweep(place) == 0 and not path.exists()


def test_files_can_be_made_where_there_are_no_locks(place, monkeypatch):
    monkeypatch.setattr(temporary.fcntl, "flock", no_locks)
    handle, path = new_file(place, "out.mcap")
    os.write(handle, b"x")
    os.close(handle)
    assert path.read_bytes() == b"x"
    remove_file(path)


OTHERS = (".out.mcap.part", ".x.sinstool-part", "out.mcap.0123abcd-0123456789abcdef.sinstool-part")


@pytest.mark.parametrize("name", OTHERS)
def test_what_has_another_name_is_not_ours(place, name):
    path = aged_file(place / name)
    sweep(place)
    assert path.exists()


def aged_file(path):
    path.write_bytes(b"x")
    return aged(path)


def test_links_are_not_followed(place):
    precious = aged_file(place / "precious")
    link = place / f".out.mcap.{temporary._host()}-{16 * '0'}.sinstool-part"
    link.symlink_to(precious)
    sweep(place)
    assert precious.read_bytes() == b"x"


def test_a_sweep_that_comes_between_making_and_locking(place, monkeypatch):
    """Another run's sweep takes the new file before we lock it: we make another."""
    locked, calls = temporary._locked_for_good, []

    def late(handle):
        if not calls:
            calls.append(1)
            for path in place.iterdir():
                path.unlink()
        return locked(handle)

    monkeypatch.setattr(temporary, "_locked_for_good", late)
    handle, path = new_file(place, "out.mcap")
    assert path.exists()
    os.close(handle)
    remove_file(path)
    assert list(place.iterdir()) == []


def test_an_unreadable_folder_is_left_alone(tmp_path):
    sweep(tmp_path / "not there")


@pytest.mark.parametrize("name", ["out.mcap", "x" * 250, "\u822a" * 84])
def test_any_name_of_a_file_will_do(place, name):
    handle, path = new_file(place, name)
    os.close(handle)
    assert path.exists()
    remove_file(path)
    assert list(place.iterdir()) == []
