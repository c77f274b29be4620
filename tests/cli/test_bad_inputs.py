"""Inputs and outputs that cannot be, each refused in one line."""

import json
import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

from tests.cli import bad_logs
from tests.helpers.imulogs import read_topic
from tests.helpers.one_line import one_line
from tests.helpers.paths import PROGRAM


@pytest.mark.parametrize("make", bad_logs.ALL, ids=lambda f: f.__name__)
@pytest.mark.parametrize("options", [(), ("--json",), ("-q",)])
def test_bad_inputs_end_in_one_line(sinstool, tmp_path, make, options):
    path, expected = make(tmp_path)
    before = sorted(p.name for p in tmp_path.rglob("*"))
    status, out, err = sinstool("process", path, "-o", tmp_path / "out.mcap", *options)
    line = one_line(err)
    assert status == 1
    if "--json" in options:
        failure = {"schema": "sinstool.error/1", "status": "failed", "exit": 1}
        assert json.loads(out) == {**failure, "error": line.removeprefix("sinstool: ")}
    else:
        assert out == ""
    assert expected in line and str(path) in line
    assert sorted(p.name for p in tmp_path.rglob("*")) == before


def test_output_exists(sinstool, log, tmp_path):
    out = tmp_path / "out.mcap"
    out.write_bytes(b"precious")
    status, _, err = sinstool("process", log, "-o", out)
    assert status == 1 and "exists already" in one_line(err) and "--overwrite" in err
    assert out.read_bytes() == b"precious"
    status, _, err = sinstool("process", log, "-o", out, "--overwrite")
    assert status == 0 and "Traceback" not in err
    assert len(read_topic(out, "/sinstool/attitude")) == 1000
    assert sorted(p.name for p in tmp_path.iterdir()) == ["logs", "out.mcap"]


@pytest.mark.parametrize("options", [(), ("--overwrite",)])
@pytest.mark.parametrize("way", ["itself", "dotted", "symlink", "hardlink"])
def test_output_is_the_input(sinstool, log, options, way):
    out = log
    if way == "dotted":
        out = log.parent / ".." / log.parent.name / log.name
    elif way != "itself":
        out = log.parent / "other.mcap"
        (os.symlink if way == "symlink" else os.link)(log, out)
    before = log.read_bytes()
    status, _, err = sinstool("process", log, "-o", out, *options)
    assert status == 1 and "is the input itself" in one_line(err)
    assert log.read_bytes() == before


@pytest.mark.parametrize("command", ["process", "export"])
def test_an_input_that_is_missing_is_named_though_the_output_exists(sinstool, tmp_path, command):
    out = tmp_path / ("out.csv" if command == "export" else "out.mcap")
    out.write_bytes(b"precious")
    status, _, err = sinstool(command, tmp_path / "no.mcap", "-o", out, "--overwrite")
    assert status == 1 and "no.mcap: there is no such file or folder" in one_line(err)
    assert out.read_bytes() == b"precious"


@pytest.mark.parametrize("address", ["s3://bucket/log.mcap", "https://host/log.mcap"])
def test_an_address_elsewhere_is_told_from_a_missing_file(sinstool, tmp_path, address):
    status, _, err = sinstool("info", address)
    assert status == 1 and "copy it to this machine" in one_line(err)


@pytest.mark.parametrize(
    ("out", "expected"),
    [
        # Not even root writes to these
        (f"{'n' * 300}.mcap", "File name too long"),
        ("nowhere/out.mcap", "does not exist"),
        ("logs", "is a folder"),
        ("-", "standard output"),
        ("logs/good.mcap/out.mcap", "does not exist"),
    ],
)
def test_unwritable_places(sinstool, log, tmp_path, monkeypatch, out, expected):
    monkeypatch.chdir(tmp_path)
    status, _, err = sinstool("process", log, "-o", out)
    assert status == 1 and expected in one_line(err)
    assert [p.name for p in tmp_path.rglob("*")] == ["logs", "good.mcap"]


@pytest.fixture(scope="module")
def large(tmp_path_factory):
    """So large that processing it takes a while."""
    from sinstool.simulation.coning import classical_coning
    from sinstool.simulation.log import write_simulated
    from sinstool.simulation.truth import sample_times
    from tests.helpers.motion_topics import motion_topics

    path = tmp_path_factory.mktemp("large") / "large.mcap"
    truth = classical_coning(sample_times(1000.0, 200.0, 10**18), 0.3, 3.0)
    write_simulated(path, motion_topics(truth, "rate", "flu"), {})
    return path


def has_open(process, path):
    """Whether a process has a file open; True also where the system does not say."""
    files = Path(f"/proc/{process.pid}/fd")
    if not files.is_dir():
        return True
    try:
        return any(os.path.realpath(f) == str(path) for f in files.iterdir())
    except OSError:  # one was closed meanwhile
        return False


@pytest.mark.slow
@pytest.mark.parametrize("when", ["while it reads", "while it writes"])
def test_ctrl_c(large, tmp_path, when):
    run = subprocess.Popen(
        [*PROGRAM, "process", large, "-o", tmp_path / "out.mcap"],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline and run.poll() is None:
        if when == "while it reads" and has_open(run, large):
            break
        if any(p.stat().st_size for p in tmp_path.iterdir()):
            break
    assert run.poll() is None
    run.send_signal(signal.SIGINT)
    stdout, stderr = run.communicate(timeout=30)
    assert run.returncode == 130, stderr.decode()
    assert one_line(stderr.decode()) == "sinstool: interrupted; nothing was written"
    assert stdout == b""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["info", "process", "align", "allan", "compare-coning", "export"])
def test_an_empty_name_is_not_the_current_folder(sinstool, log, monkeypatch, name):
    """Where a variable of a shell is not set."""
    monkeypatch.chdir(log.parent)
    status, out, err = sinstool(
        name, "", "-o" if name in ("process", "export") else "--report", "o"
    )
    assert (status, out) == (2, "") and "the name is empty" in one_line(err)
    option = "-o" if name in ("process", "export") else "--report"
    status, out, err = sinstool(name, log, option, "")
    assert (status, out) == (2, "") and "the name is empty" in one_line(err)
