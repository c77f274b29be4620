"""What the commands print: summaries, JSON, findings."""

import json
import re
import subprocess

import numpy as np
import pytest

from sinstool.core.english import heading_text
from tests.cli import bad_logs
from tests.helpers.imulogs import (
    REAL,
    even_times,
    imu_messages,
    resting,
    write_log,
)
from tests.helpers.logs import real
from tests.helpers.one_line import one_line
from tests.helpers.paths import PROGRAM


@pytest.mark.parametrize(
    ("heading", "text"),
    [(0.0, "0.000"), (-0.0, "0.000"), (-1e-7, "0.000"), (359.9997, "0.000"), (-107.3944, "252.606"),
     (180.0, "180.000"), (-180.0, "180.000")],
)  # fmt: skip
def test_headings_go_round_the_compass(heading, text):
    assert heading_text(heading, 3) == text


KEYS = {
    "input": {"path", "size", "sha256"},
    "imu": {"topic", "n", "rate_hz", "gaps", "dropped"},
    "alignment": {
        "method", "time_ns", "roll_deg", "pitch_deg", "heading_deg", "sigma_deg", "status"
    },
    "final": {
        "time_ns", "q_wxyz_ned_frd", "roll_deg", "pitch_deg", "heading_deg", "lat_deg", "lon_deg",
        "height_m",
    },
    "coning": {"algorithm"},
    "output": {"path"},
    "lost": {"parts"},
}  # fmt: skip


def test_json_is_one_object_with_the_keys_of_the_contract(sinstool, log, tmp_path):
    status, out, err = sinstool("process", log, "-o", tmp_path / "out.mcap", "--json")
    assert status == 0
    summary = json.loads(out)
    assert summary["schema"] == "sinstool.process/1"
    beside = {"schema", "plan", "hse", "smoothing", "height", "filter", "findings", "warnings"}
    beside |= {"travel"}
    assert set(KEYS) | beside == set(summary)
    for key, inside in KEYS.items():
        assert inside <= set(summary[key]), key
    assert summary["imu"]["n"] == 1000 and summary["imu"]["topic"] == "/imu"
    assert summary["hse"] is summary["height"] is summary["filter"] is None
    # times are strings of nanoseconds: JSON's numbers would lose their end
    times = even_times(1000)
    assert summary["alignment"]["time_ns"] == str(times[0])
    assert summary["final"]["time_ns"] == str(times[-1])
    assert len(summary["alignment"]["sigma_deg"]) == 3
    assert np.linalg.norm(summary["final"]["q_wxyz_ned_frd"]) == pytest.approx(1.0)
    assert summary["output"]["path"] == str(tmp_path / "out.mcap")
    # warnings are in the object, and on stderr for people
    assert summary["warnings"] and all(f"warning: {w}\n" in err for w in summary["warnings"])


def test_summary_and_silence(sinstool, log, tmp_path):
    status, out, _ = sinstool("process", log, "-o", tmp_path / "a.mcap")
    assert status == 0
    assert "1000 samples at 200.000 Hz" in out and "level (ok)" in out and "previous-3" in out
    assert "sha256" not in out
    status, out, _ = sinstool("process", log, "-o", tmp_path / "b.mcap", "-v")
    assert "sha256" in out
    status, out, err = sinstool("process", log, "-o", tmp_path / "c.mcap", "-q")
    assert (status, out) == (0, "")
    assert all(line.startswith("warning: ") for line in err.splitlines())


def test_verbose_errors_have_their_traceback(tmp_path):
    run = subprocess.run(
        [*PROGRAM, "process", "-vv", tmp_path / "no.mcap", "-o", tmp_path / "o.mcap"],
        capture_output=True,
        text=True,
    )
    assert run.returncode == 1 and "Traceback" in run.stderr and "no such file" in run.stderr


def test_a_steady_turn_is_not_called_rest(sinstool, tmp_path):
    """A table that turns at a constant rate: its noise is that of rest, its rate no bias."""
    gyro, accel = resting(1000)
    turning = np.add(gyro, [0.0, 0.0, np.radians(90.0)])
    path = write_log(tmp_path / "a.mcap", imu_messages(even_times(1000), turning, accel))
    _, out, _ = sinstool("info", path)
    assert re.search(r"^  steady .* it turns at this rate, or the gyro's bias is large$", out, re.M)
    assert not re.search(r"^  still", out, re.M)
    _, _, err = sinstool("process", path, "-o", tmp_path / "a.out.mcap")
    assert "90.0 deg/s, is removed as the gyro's bias" in err and "--gyro-bias none" in err
    told = ("--gyro-bias", "none")
    _, _, err = sinstool("process", path, "-o", tmp_path / "b.out.mcap", *told)
    assert "is removed" not in err
    slow = np.add(gyro, [0.0, 0.0, np.radians(4.0)])
    path = write_log(tmp_path / "c.mcap", imu_messages(even_times(1000), slow, accel))
    _, _, err = sinstool("process", path, "-o", tmp_path / "c.out.mcap")
    assert "deg/s, is removed" not in err


def test_something_lost(sinstool, tmp_path):
    """Malformed messages, and parts of a damaged log that were passed over."""
    messages = imu_messages(even_times(1000), *resting(1000))
    messages[500] = messages[500]._replace(message=b"\x00\x01\x00\x00")
    path = write_log(tmp_path / "a.mcap", messages)
    status, out, err = sinstool("process", path, "-o", tmp_path / "a.out.mcap", "--json")
    assert status == 3
    assert json.loads(out)["lost"]["malformed"] == 1
    assert "1 message does not fit" in err
    path, _ = bad_logs.cut(tmp_path)
    status, out, err = sinstool("process", path, "-o", tmp_path / "b.out.mcap")
    assert status == 1 and err.count("\n") == 1
    assert f"`sinstool process {path} -o {tmp_path / 'b.out.mcap'} --salvage`" in err
    status, out, err = sinstool(
        "process", path, "-o", tmp_path / "b.out.mcap", "--salvage", "--json"
    )
    assert status == 3
    lost = json.loads(out)["lost"]
    assert lost["parts"] and all(part in err for part in lost["parts"])
    places = lost["places"]
    assert [place["text"] for place in places] == lost["parts"]
    assert all(place["offset"] > 0 and place["start_ns"].isdigit() for place in places)
    status, out, _ = sinstool("info", path, "--salvage")
    assert status == 3 and "lost: " in out
    status, out, _ = sinstool("info", path, "--salvage", "--json")
    assert status == 3 and json.loads(out)["lost"]["parts"] == lost["parts"]


@pytest.mark.parametrize("path", REAL)
def test_info_on_every_real_log(sinstool, path):
    axes = ("--body-axes", "frd") if path.startswith("px4") else ()
    status, out, err = sinstool("info", real(path), "--json", *axes)
    assert (status, err) == (0, "")
    result = json.loads(out)
    assert result["process"]["possible"] and result["lost"]["parts"] == []
    imu = next(i for i in result["imu"] if i["topic"] == result["process"]["imu_topic"])
    assert imu["n"] > 1000 and imu["first_ns"].isdigit()
    assert [f for f in imu["findings"] if f["severity"] == "failed"] == []
    assert sum(t["n"] for t in result["topics"]) == result["input"]["messages"]
    status, out, err = sinstool("info", real(path), *axes)
    assert (status, err) == (0, "")
    assert f"IMU {imu['topic']}" in out and f"process would use {imu['topic']}" in out
    assert all(f["text"] in out for f in imu["findings"])


def test_info_says_what_process_would_say(sinstool, tmp_path):
    for make in bad_logs.REFUSED:
        path, expected = make(tmp_path)
        status, out, err = sinstool("info", path)
        assert (status, err) == (0, "")
        assert "process would refuse this log" in out and expected in out
        status, out, _ = sinstool("info", path, "--json")
        verdict = json.loads(out)["process"]
        assert status == 0 and not verdict["possible"] and expected in verdict["why"]


@pytest.mark.parametrize("make", bad_logs.UNREADABLE, ids=lambda f: f.__name__)
def test_info_refuses_what_is_no_log(sinstool, tmp_path, make):
    path, expected = make(tmp_path)
    status, out, err = sinstool("info", path)
    assert status == 1 and out == "" and expected in one_line(err)


def test_info_takes_the_input_options(sinstool, log):
    _, out, _ = sinstool("info", log, "--start", "1", "--end", "3", "--json")
    (imu,) = json.loads(out)["imu"]
    assert (imu["n"], imu["covered_s"]) == (401, 2.0)
    assert sinstool("info", log, "--imu-topic", "/x")[0] == 0  # the verdict says it
    _, out, _ = sinstool("info", log, "--imu-topic", "/x", "--json")
    assert json.loads(out)["imu"] == [] and "/x" in json.loads(out)["process"]["why"]
