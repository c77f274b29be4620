"""Motions over the Earth as logs: what is in them, and that truth and sensors belong together."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from sinstool.cli.main import cli
from tests.pipelines.process.flights import read

SCENARIOS = {
    "spiral-climb": (["--duration", "60", "--rate", "64"], 3841, 61, 3001),
    "manoeuvring-flight": (["--duration", "60"], 6001, 61, 601),
    "drive": (["--duration", "90", "--still", "30"], 9001, 361, 901),
    "launch": (["--duration", "40"], 8001, 401, 0),
}


def simulate(scenario, out, *options):
    arguments = ["simulate", scenario, "-o", str(out), *map(str, options)]
    return CliRunner().invoke(cli, arguments)


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_truth_and_sensors_belong_together(tmp_path, scenario):
    options, imu, fixes, pressures = SCENARIOS[scenario]
    log = tmp_path / "log.mcap"
    place = ["--latitude", -43.5, "--longitude", 179.9995, "--heading", 80]
    kind = ["--gyro-kind", "mean-rate", "--gnss-model", "perfect", "--baro-sigma", 0]
    made = simulate(scenario, log, *options, *place, *kind, "--json")
    assert made.exit_code == 0, made.output
    counts = json.loads(made.stdout)["topics"]
    assert counts["/imu/data_raw"] == counts["/truth/fix"] == counts["/truth/odometry"] == imu
    assert counts["/gnss/fix"] == counts["/gnss/velocity"] == fixes
    assert counts.get("/baro", 0) == pressures
    # the receiver without errors is at the truth
    at, truth = read(log, "/truth/fix", ["latitude", "longitude", "altitude"])
    when, fix = read(log, "/gnss/fix", ["latitude", "longitude", "altitude"])
    rows = np.searchsorted(at, when)
    np.testing.assert_array_equal(at[rows], when)
    off = fix - truth[rows]
    off[:, 1] = (off[:, 1] + 180.0) % 360.0 - 180.0
    assert np.abs(off[:, :2]).max() < 1e-9 and np.abs(off[:, 2]).max() < 1e-3
    # the topic that a run takes navigates to the truth
    out = tmp_path / "out.mcap"
    aligned = CliRunner().invoke(
        cli, ["process", str(log), "-o", str(out), "--imu-topic", "/truth/imu", "--mode", "ins",
              "--align", "log", "--gyro-unit", "rad/s", "--gyro-bias", "none", "--json", "-q",
              "--truth", "/truth/imu,/truth/fix", "--only-results"],
    )  # fmt: skip
    assert aligned.exit_code == 0, aligned.output
    errors = json.loads(aligned.stdout)["truth"]
    assert errors["position_m"]["instants"] == imu
    assert max(errors["position_m"]["largest"]) < 0.05
    assert max(errors["attitude_deg"]["largest"]) < 1e-3


@pytest.mark.parametrize(
    ("scenario", "options", "words"),
    [
        ("spiral-climb", ["--latitude", "91"], "must be less than or equal to 90"),
        ("spiral-climb", ["--height", "nan"], "must be a finite number"),
        ("drive", ["--gnss-outage", "60"], "not START:END"),
        ("drive", ["--gnss-outage", "60:30"], "not START:END"),
        ("drive", ["--baro-rate", "-1"], "must be greater than or equal to 0"),
        ("manoeuvring-flight", ["--turbulence", "-1"], "turbulence"),
        ("launch", ["--launch-grade", "5"], "launch-grade"),
        ("launch", ["--gyro-range", "0"], "gyro-range"),
    ],
)
def test_what_cannot_be_is_refused(sinstool, tmp_path, scenario, options, words):
    log = tmp_path / "log.mcap"
    status, _, err = sinstool("simulate", scenario, "-o", log, "--duration", 30, *options)
    assert status == 2
    assert words in err
    assert list(tmp_path.iterdir()) == []


def test_outages_and_flat_fixes(tmp_path):
    log = tmp_path / "log.mcap"
    made = simulate(
        "drive", log, "--duration", 60, "--still", 5, "--gnss-outage", "20:30", "--gnss-flat",
        "40:45", "--no-velocity", "--no-truth", "--baro-rate", 0,
    )  # fmt: skip
    assert made.exit_code == 0, made.output
    when, fix = read(log, "/gnss/fix", ["latitude", "altitude"])
    seconds = (when - when[0]) * 1e-9
    assert not np.any((seconds > 20.0) & (seconds < 30.0)) and len(when) > 180
    flat = np.isnan(fix[:, 1])
    assert flat[(seconds > 40.0) & (seconds < 45.0)].all() and not flat[seconds < 40.0].any()
    with pytest.raises(ValueError, match="concatenate"):
        read(log, "/truth/fix", ["latitude"])
