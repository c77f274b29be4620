"""Jobs on a Dask cluster of separate processes, and clusters that are refused."""

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from sinstool.campaign import cluster as cluster_module
from sinstool.campaign.jobs import Job, Tls, Workers
from sinstool.campaign.run import results, run_jobs
from sinstool.campaign.visible import Token, not_seen, sight, tokens, what_differs
from sinstool.core import version
from sinstool.core.errors import ConfigurationError, SinstoolError
from sinstool.core.temporary import sweep
from tests.campaign import work
from tests.campaign.clusters import cluster, free_port
from tests.campaign.test_local import gone, job, left
from tests.core.test_temporary import held, kill
from tests.helpers.imulogs import even_times, handheld, imu_log

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    with cluster(tmp_path_factory.mktemp("cluster")) as running:
        yield running


def outcomes(jobs, address, **options):
    events = list(run_jobs(jobs, Workers(scheduler=address, **options)))
    return {e.number: e.outcome for e in events if e.outcome is not None}


def test_jobs_run_there(address, tmp_path):
    squares = results([job(work.square, n) for n in range(8)], Workers(scheduler=address))
    assert [value for value, _ in squares] == [n * n for n in range(8)]
    assert len({pid for _, pid in squares}) <= 2
    # what fails there is told here, and the others go on
    ended = outcomes(
        [job(work.fails, "user"), job(work.fails, "bug"), job(work.square, 2)], address
    )
    assert ended[0].error == "rocks: it does not rest: wait" and ended[0].exit_code == 3
    assert ended[1].error == "fails: ZeroDivisionError: half of nothing"
    assert ended[2].value[0] == 4


def certificates(folder):
    """An authority, and a certificate of it with its key."""
    names = [folder / name for name in ("ca.pem", "ca.key", "me.pem", "me.key", "me.csr")]
    authority, authority_key, certificate, key, request = map(str, names)
    new = ["openssl", "req", "-newkey", "rsa:2048", "-nodes", "-keyout"]
    sign = ["openssl", "x509", "-req", "-CA", authority, "-CAkey", authority_key]
    for command in (
        [*new, authority_key, "-x509", "-out", authority, "-subj", "/CN=authority"],
        [*new, key, "-out", request, "-subj", "/CN=me"],
        [*sign, "-in", request, "-out", certificate, "-CAcreateserial"],
    ):
        subprocess.run(command, check=True, capture_output=True)
    return Path(authority), Path(certificate), Path(key)


@pytest.mark.skipif(not shutil.which("openssl"), reason="needs openssl for certificates")
def test_jobs_run_on_a_cluster_that_knows_us_by_certificate(tmp_path):
    tls = certificates(tmp_path)
    (tmp_path / "other").mkdir()
    strangers = certificates(tmp_path / "other")
    with cluster(tmp_path, workers=1, tls=tls) as address:
        squares = results(
            [job(work.square, n) for n in range(3)], Workers(scheduler=address, tls=Tls(*tls))
        )
        assert [value for value, _ in squares] == [0, 1, 4]
        with pytest.raises(SinstoolError, match="no Dask scheduler answers"):
            results([job(work.square, 1)], Workers(scheduler=address, tls=Tls(*strangers)))


def test_a_killed_worker(address, tmp_path):
    """Its job is done by another; one that kills every worker is missing."""
    (tmp_path / "once").mkdir()
    (tmp_path / "always").mkdir()
    # One after the other: Dask blames all jobs that were on their way to a worker that dies.
    [once] = outcomes(
        [job(work.dies, tmp_path / "once", 1, folders=(tmp_path / "once",))], address
    ).values()
    assert once.value == 1
    assert (tmp_path / "once" / "out").read_bytes() == b"first half, second half"
    [always] = outcomes(
        [job(work.dies, tmp_path / "always", 99, folders=(tmp_path / "always",))], address
    ).values()
    assert always.died and "dies: its worker died, 2 times" in always.error
    assert outcomes([job(work.square, 5)], address)[0].value[0] == 25
    assert left(tmp_path / "once") == [] and left(tmp_path / "always") == []


def test_what_a_dying_worker_still_holds_goes_too(address, tmp_path):
    """Its connection, by which its death is known, closes before its files."""
    dying, path = held("file", tmp_path)
    for event in run_jobs(
        [job(work.dies, tmp_path, 99, folders=(tmp_path,))], Workers(scheduler=address)
    ):
        if event.outcome is not None:
            assert event.outcome.died and path.exists()
            kill(dying)
    assert left(tmp_path) == []


def test_who_gives_up_leaves_nothing(address, tmp_path):
    jobs = [job(work.waits, tmp_path, n, folders=(tmp_path,)) for n in range(4)]
    events = run_jobs(jobs, Workers(scheduler=address))
    until = time.monotonic() + 60.0
    while len(list(tmp_path.glob("pid-*"))) < 2 and time.monotonic() < until:
        next(events)
    events.close()
    assert left(tmp_path) == [] and not list(tmp_path.glob("out-*"))
    # the workers are not ours to end
    assert not any(gone(int(p.read_text())) for p in tmp_path.glob("pid-*"))


def test_the_command(address, tmp_path, sinstool):
    """The same bytes as by one process and by two, and lines of JSON that differ by folder only."""
    logs = tmp_path / "logs"
    logs.mkdir()
    for seed in range(3):
        gyro, accel, _ = handheld(600, seed=seed, rest_s=1.0)
        imu_log(logs / f"{seed}.mcap", even_times(600), gyro, accel)
    printed, made = [], []
    for name, who in {"one": ["-j", 1], "two": ["-j", 2], "dask": ["--scheduler", address]}.items():
        out = tmp_path / name
        status, lines, _ = sinstool("process", logs, "-o", out, "--json", *who)
        assert status == 0
        printed.append([json.loads(line.replace(str(out), "OUT")) for line in lines.splitlines()])
        # The page of all logs says how long it took
        made.append({p.name: p.read_bytes() for p in out.iterdir() if p.name != "index.html"})
    assert len(printed[0]) == len(made[0]) - 1 == 3  # and the table of all
    assert printed[0] == printed[1] == printed[2]
    assert made[0] == made[1] == made[2]


def test_a_log_that_cannot_be_read_is_its_own_row(address, tmp_path, sinstool):
    """As with workers of this machine."""
    unreadable = Path("/proc/self/mem")  # for root too
    if not unreadable.exists():
        pytest.skip("no /proc here")
    logs = tmp_path / "logs"
    logs.mkdir()
    imu_log(logs / "good.mcap", even_times(600), *handheld(600, rest_s=1.0)[:2])
    (logs / "bad.mcap").symlink_to(unreadable)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    printed = []
    for name, who in {"local": ["-j", 1], "dask": ["--scheduler", address]}.items():
        out = tmp_path / name
        status, lines, _ = sinstool("process", logs, pipe, "-o", out, "--json", *who)
        assert status == 1
        rows = [json.loads(line) for line in lines.splitlines()]
        assert [row["status"] for row in rows] == ["failed", "done", "failed"]
        printed.append([row.get("error") for row in rows])
    assert printed[0] == printed[1]
    assert "bad.mcap: cannot be read" in printed[0][0] and "pipe: is a device" in printed[0][2]


def test_tokens_do_not_stay(tmp_path):
    """Those of a killed run go with the next one; answers to it, which nobody holds, in a day."""
    dies = (
        "import os, pathlib, sys\n"
        "from sinstool.campaign.visible import tokens, what_differs\n"
        "with tokens([pathlib.Path(sys.argv[1])]) as ours:\n"
        "    what_differs([], ours)\n"
        "    os._exit(0)\n"
    )
    subprocess.run([sys.executable, "-c", dies, tmp_path], check=True)
    [_, answer] = sorted(tmp_path.iterdir(), key=lambda p: p.stat().st_mtime_ns)
    with tokens([tmp_path]) as [mine]:
        sweep(tmp_path)
        assert set(tmp_path.iterdir()) == {answer, mine.path}
    assert list(tmp_path.iterdir()) == [answer]
    a_day_ago = answer.stat().st_mtime - 86401.0
    os.utime(answer, (a_day_ago, a_day_ago))
    sweep(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_worker_that_sees_other_files_is_refused(address, tmp_path):
    """What a worker on another machine sees is what this one saw before the file was changed."""
    log = tmp_path / "log"
    log.write_bytes(b"one")
    with cluster_module._client(address, None) as client:
        before = [(log, sight(log))]
        log.write_bytes(b"two")
        with pytest.raises(ConfigurationError, match=r"sees a different .*log"):
            cluster_module._require_same_files(client, before, [])
        log.unlink()
        with pytest.raises(ConfigurationError, match=r"does not see .*log.*\(2 workers in all\)"):
            cluster_module._require_same_files(client, before, [])
        absent = Token(tmp_path / "absent" / "token", "text")
        with pytest.raises(ConfigurationError, match=r"does not see the folder .*absent"):
            cluster_module._require_same_files(client, [], [absent])
        with tokens([tmp_path]) as ours:
            cluster_module._require_same_files(client, [], ours)
    assert list(tmp_path.iterdir()) == []


def test_another_version_is_refused(address, monkeypatch):
    monkeypatch.setattr(version, "VERSION", "99.0")
    with pytest.raises(ConfigurationError, match=r"has sinstool .*this machine 99.0: pip install"):
        outcomes([job(work.square, 2)], address)


def test_a_worker_that_came_later_is_refused_too():
    from sinstool.campaign.jobs import Task, perform

    late = Task(0, Job("rocks.mcap", work.square, (2,)), version="0.0.1")
    assert "the client 0.0.1" in perform(late, lambda fraction: None).error


def test_nobody_there(monkeypatch, tmp_path):
    monkeypatch.setattr(cluster_module, "CONNECT", 0.5)
    with pytest.raises(SinstoolError, match="no Dask scheduler answers at tcp"):
        outcomes([job(work.square, 2)], f"tcp://127.0.0.1:{free_port()}")
    with (
        cluster(tmp_path, workers=0) as lonely,
        pytest.raises(SinstoolError, match="has no worker: start some with: dask worker"),
    ):
        outcomes([job(work.square, 2)], lonely)


def test_without_the_extra(monkeypatch, tmp_path, sinstool):
    """As where distributed is not installed."""
    monkeypatch.setitem(sys.modules, "distributed", None)
    log = imu_log(tmp_path / "a.mcap", even_times(50), *handheld(50)[:2])
    arguments = ["process", log, log, "-o", tmp_path / "out", "--scheduler", "tcp://h:1"]
    status, _, err = sinstool(*arguments)
    assert status == 2
    assert err == (
        "sinstool: --scheduler needs dask.distributed: pip install 'sinstool[cluster]'\n"
    )


def test_what_a_folder_looks_like(tmp_path):
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "bag_0.db3").write_bytes(b"abc")
    before = sight(bag)
    assert before.size == 3
    (bag / "bag_0.db3").rename(bag / "bag_1.db3")
    assert sight(bag) != before
    said, answers = what_differs([(bag, before)], [])
    assert "sees a different" in said and answers == []
    assert not_seen([Token(tmp_path / "never", "x")]) == tmp_path
