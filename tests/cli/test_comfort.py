"""What is chosen is explained with -v, and what was nearly right is suggested."""

from __future__ import annotations

import re

import pytest

from sinstool.cli.conventions import sections
from sinstool.core import conventions
from sinstool.core.errors import NotALogError
from sinstool.core.suggest import nearest
from tests.helpers.paths import ROOT

SAMPLES = ROOT / "sample_data"


@pytest.fixture
def run(sinstool, monkeypatch):
    """Runs the command line, in a folder."""

    def call(*words, cwd=ROOT):
        monkeypatch.chdir(cwd)
        return sinstool(*words)

    return call


def choices(err):
    """What was said of each choice, by its name."""
    printed = {}
    for line in err.splitlines():
        if line.startswith("- "):
            what, _, why = line[2:].partition(": ")
            printed.setdefault(what, []).append(why)
    return printed


def test_process_explains_attitude(run, tmp_path):
    log = SAMPLES / "coning.mcap"
    status, out, err = run(
        "process", log, "-o", tmp_path / "a.mcap", "--gyro-kind", "mean-rate", "-v"
    )
    chosen = choices(err)
    assert status == 0
    assert chosen["mode"][0].startswith("attitude, as the log has no GNSS fixes")
    assert chosen["IMU topic"] == ["/imu/data_raw, the only one with an IMU (--imu-topic)"]
    assert chosen["time"][0].startswith("header stamps, a sample each 10 ms")
    assert chosen["first attitude"] == [
        "level, as the first 2.5 s are at rest and nothing shows north (--align)"
    ]
    assert chosen["coning"][0].startswith("previous-3, the default")
    assert chosen["coning"][0].endswith(
        "gyro samples are mean-rate, taken as increments (--coning)"
    )
    assert chosen["latitude"] == ["not known: the Earth's rate stays in"]
    # on stderr alone, and only when asked for
    assert "- mode" not in out
    _, _, err = run("process", log, "-o", tmp_path / "b.mcap", "--gyro-kind", "mean-rate")
    assert choices(err) == {}


@pytest.mark.slow
def test_process_explains_the_filter(run, tmp_path):
    made = run("simulate", "drive", "-o", "drive.mcap", "--duration", 120, "-v", cwd=tmp_path)
    assert made[0] == 0 and choices(made[2])["scenario"][0].startswith("drive")
    status, _, err = run(
        "process", "drive.mcap", "-o", "o.mcap", "-v", "--coning", "lookahead-12", cwd=tmp_path
    )
    chosen = choices(err)
    assert status == 0
    assert chosen["mode"][0].startswith("ins-gnss, as the log has GNSS fixes, and they show")
    assert chosen["gnss topic"] == ["/gnss/fix, the only one of its type"]
    assert chosen["velocity topic"] == ["/gnss/velocity, the only one of its type"]
    assert chosen["IMU grade"][0].startswith("navigation, by its gyro noise at rest")
    assert chosen["filter"][0].startswith("network-29a: 481 epochs")
    assert "found in the log" in chosen["GNSS latency"][0]
    assert chosen["coning"][0].startswith("lookahead-12, as configured")
    status, _, err = run("align", "drive.mcap", "-v", cwd=tmp_path)
    assert choices(err)["first attitude"][0].startswith("svd, from velocity changes")


def test_others_explain_too(run, tmp_path):
    log = SAMPLES / "coning.mcap"
    _, _, err = run("compare-coning", log, "-v", "--decimate", 1)
    assert choices(err)["reference"][0].startswith("quatfiter-4, as there is no --truth")
    hse = SAMPLES / "hse"
    _, _, err = run("calibrate-hse", hse / "a-020.mcap", hse / "a-110.mcap", "--config",
                    hse / "rig-a.toml", "-o", tmp_path / "h.json", "-v")  # fmt: skip
    chosen = choices(err)
    assert chosen["runs"] == ["6 stretches have whole turns, in 2 logs"]
    assert chosen["method"] == ["joint, over 6 runs"]
    _, _, err = run("info", log, "-v")
    assert choices(err)["IMU topic"] == ["/imu/data_raw, the only one with an IMU (--imu-topic)"]


def test_an_error_stays_a_line_with_v(run, tmp_path):
    status, _, err = run("process", "no.mcap", "-o", tmp_path / "o.mcap", "-v")
    assert status == 1
    assert err == "sinstool: no.mcap: there is no such file or folder\n"
    for words in (["-vv"], ["-v", "--verbose"]):
        with pytest.raises(NotALogError):  # with its traceback
            run("process", "no.mcap", "-o", tmp_path / "o.mcap", *words)


@pytest.mark.parametrize(
    ("words", "meant", "status"),
    [
        (["proces"], "process", 2),
        (["simulate", "drvie", "-o", "x"], "drive", 2),
        (["process", "x", "-o", "y", "--align", "levl"], "level", 2),
        (["process", "x", "-o", "y", "--coning", "previus-3"], "previous-3", 2),
        (["process", "x", "-o", "y", "--emit", "imu,atitude"], "attitude", 2),
        (["process", "x", "-o", "y", "--gyrokind", "rate"], "--gyro-kind", 2),
        (["simulate", "static", "-o", "y", "--grade", "tacticle"], "tactical", 2),
        (["process", SAMPLES / "coning.mcap", "-o", "y", "--imu-topic", "/imu/dataraw"],
         "/imu/data_raw", 1),
        (["process", SAMPLES / "static.mcap", "-o", "y", "--gnss-topic", "/gnss"],
         "/gnss/fix", 1),
    ],
)  # fmt: skip
def test_the_nearest_is_suggested(run, words, meant, status, tmp_path):
    code, _, err = run(*words, cwd=tmp_path)
    assert code == status
    assert re.search(rf"[Dd]id you mean[^?]*{re.escape(meant)}", err), err
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("toml", "meant"),
    [("[coning]\nconing_ = 'x'", "coning"), ("[inputs]\ngyro_kind = 'rate'", "input"),
     ("[align]\ninital_attitude = [0, 0, 0]", "initial_attitude")],
)  # fmt: skip
def test_the_nearest_key_is_suggested(run, toml, meant, tmp_path):
    (tmp_path / "c.toml").write_text(toml)
    code, _, err = run("process", "x", "-o", "y", "--config", "c.toml", cwd=tmp_path)
    assert code == 2 and f"did you mean {meant}?" in err


def test_nothing_near_is_not_guessed():
    assert nearest("xyzzy", ["level", "log"]) == ""
    assert nearest("/imu", ["/gnss/fix", "/sensors/imu/data"]) == "did you mean /sensors/imu/data?"


def test_conventions_are_those_of_the_core(run):
    status, out, _ = run("conventions")
    assert status == 0
    titles = [title for title, _ in sections()]
    assert {"Frames", "Quaternions", "Angles", "Gravity", "Units", "Height", "Time",
            "Samples"} <= set(titles)  # fmt: skip
    plain = " ".join((conventions.__doc__ or "").replace("``", "").split())
    for title, text in sections():
        assert title in out.splitlines()
        assert " ".join(text.replace("``", "").split()) in plain
        assert " ".join(text.replace("``", "").split()) in " ".join(out.split())
