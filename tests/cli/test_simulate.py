"""`simulate` as a command."""

import json
import tomllib

import pytest

from tests.helpers.imulogs import (
    read_topic,
)
from tests.helpers.one_line import one_line


@pytest.mark.parametrize(
    ("scenario", "options", "expected"),
    [
        ("coning", ("--rate", "0"), "--rate 0.0: must be greater than 0"),
        ("coning", ("--rate", "nan"), "--rate nan: must be"),
        ("coning", ("--rate", "inf"), "--rate inf: must be"),
        ("coning", ("--duration", "-1"), "--duration -1.0: must be greater than 0"),
        ("coning", ("--duration", "inf"), "--duration inf: must be"),
        ("coning", ("--duration", "1e-4"), "shorter than one sample interval"),
        ("coning", ("--seed", "-1"), "--seed -1: must be greater than or equal to 0"),
        ("coning", ("--frequency", "nan"), "--frequency nan: must be"),
        ("coning", ("--lead-in", "-1"), "--lead-in -1.0: must be greater than or equal to 0"),
        ("coning", ("--lead-in", "nan"), "--lead-in nan: must be"),
        ("coning", ("--half-angle-deg", "90"), "--half-angle-deg 90.0: must be less than 90"),
        ("coning", ("--half-angle-deg", "nan"), "--half-angle-deg nan: must be"),
        ("coning", ("--grade", "best"), "'best' is not one of"),
        ("static", ("--latitude", "91"), "--latitude 91.0: must be less than or equal to 90"),
        ("static", ("--longitude", "nan"), "--longitude nan: must be"),
        ("static", ("--height", "inf"), "--height inf: must be a finite number"),
        ("static", ("--attitude", "1,2"), "'1,2' is not 3 numbers"),
        ("static", ("--attitude", "1,2,nan"), "must be a finite number"),
        ("static", ("--duration", "0"), "--duration 0.0: must be greater than 0"),
    ],
)
def test_simulate_refuses_bad_values(sinstool, tmp_path, scenario, options, expected):
    status, out, err = sinstool("simulate", scenario, "-o", tmp_path / "o.mcap", *options)
    assert status == 2 and out == "" and expected in err.strip().split("\n")[-1]
    assert list(tmp_path.iterdir()) == []


def test_simulate_takes_a_file_and_prints_it(sinstool, tmp_path):
    file = tmp_path / "drive.toml"
    file.write_text("[simulate]\nrate = 20.0\nduration = 5.0\ngnss_outage = ['1:2']\n")
    made = ("simulate", "drive", "--config", file, "--duration", "4")
    _, out, _ = sinstool(*made, "--print-config")
    options = tomllib.loads(out)["simulate"]
    assert (options["rate"], options["duration"], options["gnss_outage"]) == (20.0, 4.0, ["1:2"])
    status, out, err = sinstool(*made, "-o", tmp_path / "d.mcap", "-q")
    assert (status, out, err) == (0, "", "")
    file.write_text("[simulate]\nrte = 20.0\n")
    status, _, err = sinstool(*made, "-o", tmp_path / "e.mcap")
    assert status == 2 and "unknown key simulate.rte: did you mean rate?" in one_line(err)


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["coning", "static"])
def test_simulate_and_process(sinstool, tmp_path, scenario):
    path, out_path = tmp_path / "in.mcap", tmp_path / "out.mcap"
    options = ("--duration", "3", "--grade", "mems", "--seed", "5")
    status, out, _ = sinstool("simulate", scenario, "-o", path, *options, "--json")
    counts = json.loads(out)["topics"]
    assert status == 0 and counts["/imu/data_raw"] == counts["/truth/odometry"] == 1201
    status, _, err = sinstool("simulate", scenario, "-o", path, *options)
    assert status == 1 and "exists already" in one_line(err)
    before = path.read_bytes()
    assert sinstool("simulate", scenario, "-o", path, *options, "--overwrite")[0] == 0
    assert path.read_bytes() == before  # the same seed, the same file
    assert (
        sinstool(
            "process", path, "-o", out_path, "--align", "level" if scenario == "static" else "auto"
        )[0]
        == 0
    )
    assert len(read_topic(out_path, "/sinstool/attitude")) == 1201
