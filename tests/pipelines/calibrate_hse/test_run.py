"""Calibration from logs: which are used, what they are called, what is left when it fails."""

import json
import shutil
import tomllib

import numpy as np
import pytest

from sinstool.cli.options import effective_config
from sinstool.config import CalibrationOptions
from sinstool.core.errors import ConfigurationError, OutputError
from sinstool.pipelines.calibrate_hse.run import azimuths
from sinstool.pipelines.calibrate_hse.run import calibrate as calibrate_logs
from tests.helpers.hse_rigs import ARCSEC, calibrate, edited, simulate, sinstool, wrapped
from tests.helpers.logs import Row, write_bag2

OPTIONS = {
    "rates": "120,60",
    "plateau": 30,
    "rate": 40,
    "encoder_rate": 20,
    "epsilon": "11,4,6",
    "tilt_east": 4e-3,
}


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path, rig = simulate(tmp_path_factory.mktemp("log"), "log", arw=1e-4, vrw=5, **OPTIONS)
    return path, edited(rig, "rules", calibration={"min_turns": 4, "min_duration": 15.0})


def test_logs_of_one_name_are_told_apart(log, tmp_path):
    path, rig = log
    for folder in ("monday", "tuesday"):
        (tmp_path / folder).mkdir()
        shutil.copy(path, tmp_path / folder / "log.mcap")
    logs = sorted(tmp_path.glob("*/log.mcap"))
    _, cal, _, _ = calibrate(logs, rig, tmp_path / "hse.json")
    assert len({run["id"] for run in cal["runs"]}) == 4
    assert {run["source"] for run in cal["runs"]} == {str(p.with_suffix("")) for p in logs}
    # an excluded one is the one that is meant
    out = f"{logs[1].with_suffix('')}#1"
    _, cal, _, _ = calibrate(logs, rig, tmp_path / "one.json", "--exclude", out)
    assert [run["id"] for run in cal["runs"] if not run["used"]] == [out]


def test_a_log_given_twice_is_refused(log, tmp_path):
    path, rig = log
    output = tmp_path / "hse.json"
    status, _, err = sinstool("calibrate-hse", path, path, "--config", rig, "-o", output)
    assert status == 2
    assert "twice" in err
    assert not output.exists()


def test_cut_log_is_refused_or_salvaged(log, tmp_path):
    path, rig = log
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[: int(0.93 * path.stat().st_size)])
    output = tmp_path / "hse.json"
    status, _, err = sinstool("calibrate-hse", path, cut, "--config", rig, "-o", output)
    assert status == 1 and "--salvage" in err
    assert not output.exists()
    status, _, err = sinstool(
        "calibrate-hse", path, cut, "--config", rig, "-o", output, "--salvage"
    )
    assert status == 3
    assert "warning: " in err and "lost: " in err
    assert output.exists()


def test_span_of_time(log, tmp_path):
    path, rig = log
    status, cal, _, _ = calibrate([path], rig, tmp_path / "hse.json", "--end", "31")
    assert status == 3
    assert [round(np.degrees(run["rate_rad_s"])) for run in cal["runs"]] == [120]


def test_rates_without_a_run_are_named(log, tmp_path):
    """Else it reads as if the table had turned at one rate only."""
    path, rig = log  # ten turns at 120 deg/s, five at 60
    strict = edited(rig, "strict", calibration={"min_turns": 6, "min_duration": 15.0})
    config = effective_config(strict, {})
    result = calibrate_logs([path], None, config)
    (found,) = (f for f in result.findings if f.kind == "rate-left-out")
    assert "turned at 60 deg/s, but no run has this rate" in found.text
    assert "6 whole ones needed" in found.text and "--min-turns" in found.answer
    usual = calibrate_logs([path], None, effective_config(rig, {}))
    assert not any(f.kind == "rate-left-out" for f in usual.findings)


def test_output_appears_whole_or_not_at_all(log, tmp_path, monkeypatch):
    path, rig = log
    output = tmp_path / "hse.json"
    output.write_text("before")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("sinstool.core.whole_file._SyncedFile.write", full)
    config = effective_config(rig, {"output__overwrite": True})
    with pytest.raises(OutputError, match="No space left"):
        calibrate_logs([path], output, config)
    assert output.read_text() == "before"
    assert [p.name for p in tmp_path.iterdir()] == ["hse.json"]


def test_spread_of_a_position_is_about_its_corrected_mean(log):
    path, rig = log
    actual = calibrate_logs([path], None, effective_config(rig, {}))
    (one,) = actual.spread
    assert one.ids == ("log#1", "log#2")
    assert one.after.mean() == pytest.approx(0.0, abs=1e-12)
    heading = np.array([run.heading for run in actual.runs])
    np.testing.assert_allclose(wrapped(one.before + one.heading - heading), 0.0, atol=1e-12)
    # 60 deg/s apart, by eq. (14)
    lambda2, lean = actual.file.lambda2_rad, actual.runs[0].C23
    expected = np.radians(60.0) * lambda2 * lean / 3.0 / 7.292115e-5 / np.cos(np.radians(28.07))
    taken = one.before - one.after
    assert taken[0] - taken[1] == pytest.approx(expected, rel=1e-3)
    assert abs(expected) > 400.0 * ARCSEC


def test_azimuths():
    options = CalibrationOptions(azimuth=("a=12.5", "b=c=-30"))
    result = azimuths(options, ["a", "b=c", "d"])
    assert result == {"a": pytest.approx(np.radians(12.5)), "b=c": pytest.approx(np.radians(-30))}
    for text in ("a", "a=", "=3", "z=1", "a=north", "a=nan", "a=inf"):
        with pytest.raises(ConfigurationError, match="--azimuth"):
            azimuths(CalibrationOptions(azimuth=(text,)), ["a"])


def test_a_ros_2_bag(log, tmp_path):
    """The same messages in a bag directory give the same calibration."""
    from mcap.reader import make_reader

    path, rig = log
    rows, types = [], {}
    with path.open("rb") as stream:
        for schema, channel, m in make_reader(stream).iter_messages():
            types[channel.topic] = schema.name
            rows.append(Row(channel.topic, m.log_time, m.publish_time, m.data))
    bag = write_bag2(tmp_path / "bag", rows, types=types)
    _, there, _, _ = calibrate([bag], rig, tmp_path / "bag.json")
    _, here, _, _ = calibrate([path], rig, tmp_path / "log.json")
    assert there["lambda2_rad"] == here["lambda2_rad"]
    assert [r["id"] for r in there["runs"]] == ["bag#1", "bag#2"]


def test_a_latitude_that_the_gyros_deny_is_told(log, tmp_path):
    """The Earth's rate about north shows where the rig is; nothing else denied a wrong latitude."""
    path, rig = log
    _, _, good, _ = calibrate([path], rig, tmp_path / "good.json")
    assert not any("of the Earth's rotation" in text for text in good["warnings"])
    there = tomllib.loads(rig.read_text())["rig"]["latitude_deg"]
    wrong = edited(rig, "elsewhere", latitude_deg=there + 15.0)
    _, _, summary, _ = calibrate([path], wrong, tmp_path / "wrong.json")
    assert any(f"they would at {abs(there):.1f} deg" in text for text in summary["warnings"])
    status, out, _ = sinstool(
        "process", path, "-o", tmp_path / "out.mcap", "--config", wrong, "--json",
        "--hse", tmp_path / "wrong.json", "--force",
    )  # fmt: skip
    assert status in (0, 3)
    assert any("they would at" in text for text in json.loads(out)["warnings"])
