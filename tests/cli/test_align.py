"""`sinstool align` as a user calls it: what is printed, written and refused."""

import csv
import json
from functools import partial

import numpy as np
import pytest

import sinstool as sinstool_package
from tests.helpers.launch_logs import TACTICAL, launched
from tests.helpers.logs import real

KIND = ("--gyro-kind", "increment")


@pytest.fixture
def align(sinstool):
    """Runs the command in this process: status, stdout, stderr."""
    return partial(sinstool, "align")


def test_json_says_all_and_nothing_else(align):
    code, out, _ = align(launched(*TACTICAL), *KIND, "--json", "--truth", "/truth/imu")
    printed = json.loads(out)
    assert code == 0
    assert printed["status"] == "ok" and printed["method"] == "svd" and printed["vectors"] == "win"
    assert printed["time_ns"].isdigit()
    assert np.linalg.norm(printed["q_nb_wxyz"]) == pytest.approx(1.0)
    assert printed["schema"] == "sinstool.align/1" and printed["input"]["size"] > 0
    assert 0.0 <= printed["heading_deg"] < 360.0
    assert len(printed["sigma_deg"]) == 3
    cov = np.array(printed["cov_deg2"])
    np.testing.assert_allclose(np.sqrt(np.diag(cov)), printed["sigma_deg"])
    assert printed["n_pairs"] > 400 and printed["n_rejected"] == 0
    assert printed["truth"]["total_deg"] < 0.3


@pytest.mark.slow
def test_level_only_ends_with_3_and_without_heading(align):
    pad = launched(*TACTICAL, "--pad", "60", duration=20)
    code, out, err = align(pad, *KIND, "--end", "40", "--json")
    printed = json.loads(out)
    assert code == 3
    assert printed["status"] == "level-only"
    assert printed["q_nb_wxyz"] is None and printed["heading_deg"] is None
    assert "heading is not known" in err
    code, out, _ = align(pad, *KIND, "--end", "40")
    assert code == 3 and "not observable" in out


@pytest.mark.slow
def test_series_and_page_are_written(align, tmp_path):
    table, page = tmp_path / "series.csv", tmp_path / "page.html"
    log = launched(*TACTICAL)
    options = ("--series", table, "--report", page, "--truth", "/truth/imu", *KIND)
    assert align(log, *options)[0] == 0
    rows = list(csv.DictReader(table.open()))
    assert float(rows[-1]["time_s"]) == pytest.approx(90.0, abs=0.2)
    assert float(rows[-1]["sigma_worst_deg"]) < 1.5
    text = page.read_text()
    for words in ("Status ok", "How well attitude is known", "Error against the reference",
                  "Singular values", "Residuals of the vectors", "Angular rate"):  # fmt: skip
        assert words in text
    assert f"{log}, /imu/data_raw" in text  # below the title
    # neither is written over without being told
    assert align(log, *options)[0] == 1
    assert align(log, *options, "--overwrite")[0] == 0


def test_page_of_a_failure_says_so(align, tmp_path):
    page = tmp_path / "page.html"
    code, _, err = align(launched(*TACTICAL), *KIND, "--method", "svd", "--gate", "paper",
                         "--t-set1", "500", "--report", page)  # fmt: skip
    assert code == 3
    assert "the gate waits 500 s" in err
    assert "Status failed" in page.read_text()


def test_what_is_refused(align, tmp_path):
    log = launched(*TACTICAL)
    assert align(log, *KIND, "--method", "svd", "--align", "quest")[0] == 2
    assert align()[0] == 2
    assert align(log, *KIND, "--at", "noon")[0] == 2
    assert align(log, *KIND, "--truth", "/nothing")[0] == 1
    code, _, err = align(log, *KIND, "--method", "gyrocompass")
    assert code == 1 and "begins at rest" in err
    code, _, err = align(log, *KIND, "--report", tmp_path / "page.doc")
    assert code != 0 and "report" in err


def test_six_seconds_of_flight_are_too_few(align):
    log = real("px4/px4_fmuv6c_inflight_6s.mcap")
    code, out, err = align(log, "--body-axes", "frd", "--method", "svd")
    assert code == 1 and not out
    assert "needs GNSS velocity for 10 s" in err and "for 6.0 s" in err


@pytest.fixture(scope="module")
def resting(tmp_path_factory):
    """A navigation-grade IMU at rest for a minute and a half, with fixes of where it is."""
    path = tmp_path_factory.mktemp("rest") / "rest.mcap"
    sinstool_package.simulate(
        "static", path, grade="navigation", duration=90.0, rate=100.0, attitude=(2, -3, 40)
    )
    return path


@pytest.mark.parametrize(("method", "status"), [("gyrocompass", 0), ("level", 3)])
def test_a_time_at_rest_is_that_of_the_answer(align, resting, method, status):
    code, out, _ = align(resting, "--method", method, "--at", "50", "--json")
    assert code == status and json.loads(out)["time_s"] == 50.0
    code, _, err = align(resting, "--method", method, "--at", "500")
    assert code == 2 and f"--at 500: {method} gives the attitude until" in err


@pytest.mark.parametrize("at", ["noon", "nan", "inf"])
def test_a_time_that_is_none(align, resting, at):
    code, _, err = align(resting, "--at", at)
    assert code == 2 and f"--at {at}: not end, start or a number" in err


def test_an_alignment_does_not_speak_of_navigation(align, resting):
    """Fixes that never move show no heading: of no matter where a gyrocompass does."""
    code, out, err = align(resting)
    assert code == 0 and "gyrocompass" in out
    assert "INS/GNSS" not in err and "warning" not in err
    code, _, err = align(resting, "--imu-grade", "mems")
    assert code == 3
    assert "no heading from GNSS: " in err and "INS/GNSS" not in err
    assert "heading is not known: the log shows only roll and pitch" in err


@pytest.mark.parametrize("at", ["500", "-5"])
def test_a_time_outside_the_log_is_told_in_seconds(align, at):
    """It was 1700000500000000000 ns, between two other numbers of nineteen digits."""
    code, _, err = align(launched(*TACTICAL), *KIND, "--at", at)
    assert code == 2 and f"--at {at}: the samples of the IMU span 0 to 90.0 s" in err
