"""Motions richer than coning, written as logs whose truth the algorithms meet."""

import json

import pytest
from click.testing import CliRunner

from sinstool.cli.main import cli

SCENARIOS = {
    "two-frequency": ["--frequencies", "5,12", "--half-angles-deg", "0.5,0.2"],
    "broadband": ["--band", "5,20", "--angle-deg", "0.2"],
    "manoeuvre": ["--rate-rms-deg-s", "40"],
}


def run(*arguments):
    return CliRunner().invoke(cli, [str(a) for a in arguments])


@pytest.mark.parametrize("kind", ["rate", "mean-rate", "increment"])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_the_truth_is_met(tmp_path, scenario, kind):
    log = tmp_path / "log.mcap"
    made = run(
        "simulate", scenario, "-o", log, "--duration", 20, "--rate", 200, "--gyro-kind", kind,
        *SCENARIOS[scenario],
    )  # fmt: skip
    assert made.exit_code == 0, made.output
    compared = run(
        "compare-coning", log, "--gyro-kind", kind, "--truth", "/truth/imu", "--decimate", 1,
        "--algorithms", "uncompensated,lookahead-12", "--json", "-q",
    )  # fmt: skip
    comparison = json.loads(compared.stdout)
    drift = {a["name"]: a["drift_dph"]["norm_rms"] for a in comparison["algs"]}
    assert drift["lookahead-12"] < 1e-4 * drift["uncompensated"]
    assert drift["uncompensated"] > 0.1


@pytest.mark.parametrize(
    ("scenario", "options"),
    [
        ("two-frequency", ["--frequencies", "0,5"]),
        ("two-frequency", ["--half-angles-deg", "nan,1"]),
        ("broadband", ["--angle-deg", "nan"]),
        ("broadband", ["--band", "50,10"]),
        ("manoeuvre", ["--rate-rms-deg-s", "inf"]),
        ("manoeuvre", ["--band", "-1,1"]),
    ],
)
def test_impossible_motions_are_refused(sinstool, tmp_path, scenario, options):
    log = tmp_path / "log.mcap"
    status, _, err = sinstool("simulate", scenario, "-o", log, *options)
    assert status == 2
    assert options[0] in err or "band" in err
    assert list(tmp_path.iterdir()) == []
