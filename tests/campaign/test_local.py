"""Jobs in processes of this machine: what comes back, and what is left when one dies."""

import contextlib
import os
import threading
import time
import warnings

import pytest

from sinstool.campaign.jobs import Job, Workers
from sinstool.campaign.run import results, run_jobs
from sinstool.core.errors import SinstoolError, UncachedWarning
from tests.campaign import work


def job(function, *arguments, size=0, folders=()):
    return Job(function.__name__, function, arguments, size, folders)


def outcomes(jobs, processes=2):
    events = list(run_jobs(jobs, Workers(processes)))
    ended = [e.number for e in events if e.outcome is not None]
    assert sorted(ended) == list(range(len(jobs)))
    return {e.number: e.outcome for e in events if e.outcome is not None}, events


def left(folder):
    return [p.name for p in folder.iterdir() if p.name.startswith(".")]


def test_jobs_run_in_so_many_processes():
    values = results([job(work.square, n) for n in range(12)], Workers(2))
    assert [value for value, _ in values] == [n * n for n in range(12)]
    pids = {pid for _, pid in values}
    assert 1 <= len(pids) <= 2
    assert os.getpid() not in pids


def test_the_largest_are_begun_first():
    _, events = outcomes([job(work.square, n, size=n) for n in range(6)], processes=1)
    assert [e.number for e in events if e.outcome is not None] == [5, 4, 3, 2, 1, 0]


def test_one_that_fails_does_not_stop_the_others():
    jobs = [job(work.square, 3), job(work.fails, "user"), job(work.fails, "bug")]
    values, _ = outcomes(jobs)
    assert values[0].value[0] == 9
    assert values[1].error == "rocks: it does not rest: wait" and values[1].exit_code == 3
    assert values[2].error == "fails: ZeroDivisionError: half of nothing"
    assert values[2].exit_code == 1 and "ZeroDivisionError" in values[2].trace
    with pytest.raises(SinstoolError, match="it does not rest") as info:
        results(jobs, Workers(2))
    assert info.value.exit_code == 3


def test_what_all_workers_warn_of_is_warned_of_once():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default", UncachedWarning)
        values, _ = outcomes([job(work.warns, n) for n in range(4)])
    assert [values[n].value for n in range(4)] == [0, 1, 2, 3]
    assert [(w.category, str(w.message)) for w in caught] == [
        (UncachedWarning, "compiled code cannot be cached")
    ]


def test_a_job_whose_worker_is_killed_is_done_again(tmp_path):
    values, events = outcomes([job(work.dies, tmp_path, 1, folders=(tmp_path,))])
    assert values[0].value == 1
    # given back in between
    assert any(e.fraction is None and e.outcome is None for e in events)
    assert (tmp_path / "out").read_bytes() == b"first half, second half"
    assert left(tmp_path) == []


def test_a_job_that_kills_every_worker_is_missing(tmp_path):
    jobs = [job(work.dies, tmp_path, 99, folders=(tmp_path,)), job(work.square, 2)]
    values, _ = outcomes(jobs)
    assert values[0].died and values[0].exit_code == 1
    assert "killed by SIGKILL, 2 times" in values[0].error
    assert values[1].value[0] == 4
    assert not (tmp_path / "out").exists()
    assert left(tmp_path) == []


def test_a_worker_that_is_ended_while_it_cleans_up_leaves_nothing(tmp_path):
    # no folders: nobody else removes what it leaves, as where the main process was killed
    values, _ = outcomes([job(work.ended_while_cleaning_up, tmp_path)])
    assert values[0].died and "ended with status 1, 2 times" in values[0].error
    assert left(tmp_path) == []


def gone(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    with contextlib.suppress(OSError), open(f"/proc/{pid}/stat") as stream:
        return stream.read().rpartition(")")[2].split()[0] == "Z"
    return False


def test_who_gives_up_ends_the_workers(tmp_path):
    jobs = [job(work.waits, tmp_path, n, folders=(tmp_path,)) for n in range(4)]
    with contextlib.closing(run_jobs(jobs, Workers(2))) as events:
        while len(list(tmp_path.glob("pid-*"))) < 2:
            next(events)
    pids = [int(p.read_text()) for p in tmp_path.glob("pid-*")]
    assert len(pids) == 2
    until = time.monotonic() + 10.0
    while not all(map(gone, pids)) and time.monotonic() < until:
        time.sleep(0.01)
    assert all(map(gone, pids))
    assert left(tmp_path) == []
    assert not list(tmp_path.glob("out-*"))


def test_workers_keep_to_one_core(tmp_path):
    """They start no thread of their own to read, to compress or to hash."""
    [names] = results([job(threads_while_writing, tmp_path)], Workers(1))
    assert not [name for name in names if name.startswith("sinstool-") and "sync" not in name]


def threads_while_writing(folder, progress):
    from sinstool.io.readers.file import ahead
    from sinstool.io.writers.mcap import McapWriter

    seen = []
    for _ in ahead(lambda n: n, range(3)):
        seen += [t.name for t in threading.enumerate()]
    with (folder / "x").open("wb") as stream:
        writer = McapWriter(stream, "ros2", "test")
        writer.add_metadata("a", {"b": "c"})
        seen += [t.name for t in threading.enumerate()]
        writer.finish()
    return seen
