"""`calibrate-hse` on simulated rigs: what it finds, prints, writes and refuses."""

import csv
import json
import re
import tomllib
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from benchmarks import hse_paper
from sinstool.methods.hse.calibration import HseCalibration
from sinstool.methods.hse.rig import Rig
from sinstool.methods.hse.status import STATUSES
from sinstool.report.text.numbers import measured
from tests.helpers.hse_rigs import (
    ARCSEC,
    SHORT,
    W,
    arcsec,
    calibrate,
    edited,
    simulate,
    sinstool,
)
from tests.helpers.imulogs import even_times, imu_log, read_topic, resting
from tests.helpers.one_line import last_words
from tests.helpers.paths import ROOT

LATITUDE = np.degrees(0.49)


@pytest.fixture(scope="module")
def paper(tmp_path_factory):
    """The paper's design without noise: one azimuth, 20, 40 and 60 deg/s."""
    folder = tmp_path_factory.mktemp("paper")
    return simulate(folder, "paper", latitude=LATITUDE, encoder_rate=20)


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """Two azimuths with an encoder that is 50 us late, no noise."""
    folder = tmp_path_factory.mktemp("both")
    truth = {"latitude": LATITUDE, "encoder_delay": 50}
    (a, rig), (b, _) = (
        simulate(folder, "a", heading=40, tilt_east=8e-4, **truth),
        simulate(folder, "b", heading=220, tilt_east=-8e-4, **truth),
    )
    return a, b, rig


@pytest.fixture(scope="module")
def noisy(tmp_path_factory):
    """Two azimuths, both directions, a plain error and a good gyro."""
    folder = tmp_path_factory.mktemp("noisy")
    truth = {
        "rates": "120,60,-60,-120",
        "plateau": 34,
        "rate": 40,
        "encoder_rate": 20,
        "epsilon": "11,4,6",
        "arw": 1e-4,
        "vrw": 5,
        "gyro_bias": 0.003,
    }
    (a, rig), (b, _) = (
        simulate(folder, "a", heading=30, tilt_east=4e-3, seed=1, **truth),
        simulate(folder, "b", heading=210, tilt_east=-4e-3, seed=2, **truth),
    )
    return a, b, rig


# -- what it finds ---------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["heading", "joint", "axial"])
def test_the_paper_s_coefficient_by_every_method(paper, tmp_path, method):
    log, rig = paper
    status, cal, _, _ = calibrate([log], rig, tmp_path / "hse.json", "--method", method)
    assert status == 0
    # one azimuth does not tell a delay
    assert cal["method"] == ("heading" if method == "joint" else method)
    assert cal["status"] == "ok"
    assert cal["lambda2_arcsec"] == pytest.approx(-4.2, abs=0.002)
    assert cal["eps_sum_rad"] == pytest.approx(4.2 * ARCSEC, abs=0.002 * ARCSEC)
    assert cal["K_HSE_arcsec_per_rad_s"] == pytest.approx(-17.41, abs=0.005)
    assert cal["C23_rad"] == pytest.approx(8e-4, abs=1e-9)
    assert arcsec(cal["axial"]["lambda2_rad"]) == pytest.approx(-4.2, abs=0.002)
    assert [r["n_turns"] for r in cal["runs"]] == [4, 8, 12]


def test_the_paper_s_own_line(paper, tmp_path):
    log, rig = paper
    more = ("--method", "heading", "--form", "paper")
    _, cal, _, _ = calibrate([log], rig, tmp_path / "hse.json", *more)
    assert cal["form"] == "paper"
    assert cal["parameters"] == ["psi0[0]", "K"]
    assert cal["lambda2_arcsec"] == pytest.approx(-4.2, abs=0.002)


def test_delay_of_the_encoder_by_two_azimuths(both, tmp_path):
    a, b, rig = both
    status, cal, _, err = calibrate([a, b], rig, tmp_path / "hse.json")
    assert status == 0
    assert (cal["method"], cal["status"]) == ("joint", "ok")
    assert cal["delay_s"] * 1e6 == pytest.approx(50.0, abs=0.1)
    assert cal["lambda2_arcsec"] == pytest.approx(-4.2, abs=0.002)
    assert "the encoder is stale by 50.0" in err
    # what is told is what removes it
    fixed = edited(rig, "fixed", encoder={"delay_s": cal["delay_s"]})
    _, cal, _, err = calibrate([a, b], fixed, tmp_path / "again.json")
    assert cal["delay_s"] * 1e6 == pytest.approx(0.0, abs=0.1)
    assert "stale" not in err


@pytest.mark.parametrize(("which", "lean"), [(0, 8e-4), (1, -8e-4)])
def test_delay_at_one_azimuth_is_flagged(both, tmp_path, which, lean):
    rig = both[2]
    # heading shifts by Omega tau, which the slope takes for a coefficient
    wrong = -4.2 + 50e-6 * 3.0 * W * np.cos(0.49) / lean / ARCSEC
    status, cal, _, err = calibrate([both[which]], rig, tmp_path / "hse.json")
    assert status == 3
    assert cal["status"] == "inconsistent_axial"
    assert cal["lambda2_arcsec"] == pytest.approx(wrong, abs=0.002)
    assert arcsec(cal["axial"]["lambda2_rad"]) == pytest.approx(-4.2, abs=0.002)
    stated = re.search(r"an encoder that is stale by (\S+) us would explain it", err)
    assert float(stated[1]) == pytest.approx(50.0, abs=0.1)


def test_noise_is_within_what_is_told(noisy, tmp_path):
    a, b, rig = noisy
    truth = -21.0
    status, cal, _, _ = calibrate([a, b], rig, tmp_path / "hse.json")
    assert status == 0
    assert cal["status"] == "ok"
    sigma = arcsec(cal["sigma_lambda2_rad"])
    assert 0.1 < sigma < 1.0
    assert abs(cal["lambda2_arcsec"] - truth) < 3.0 * sigma
    assert abs(arcsec(cal["axial"]["lambda2_rad"]) - truth) < 4.0 * arcsec(
        cal["axial"]["sigma_rad"]
    )
    assert cal["fit"]["n_runs"] == 8
    assert {r["used"] for r in cal["runs"]} == {True}


def test_headings_need_azimuths_to_show_what_differs_between_positions(noisy, tmp_path):
    a, b, rig = noisy
    _, _, result, _ = calibrate([a, b], rig, tmp_path / "hse.json")
    assert result["validation"] is None
    spread = result["positions"]
    assert [len(one["runs"]) for one in spread] == [4, 4]
    for one, heading in zip(spread, (30.0, 210.0), strict=True):
        assert np.degrees(one["heading_rad"]) == pytest.approx(heading, abs=0.02)
        assert arcsec(one["peak_to_peak_before_rad"]) > 1500.0
        assert arcsec(one["peak_to_peak_after_rad"]) < 150.0
    _, out, _ = sinstool("calibrate-hse", a, b, "--config", rig, "-o", tmp_path / "b.json", *SHORT)
    assert re.search(
        r"headings +within a position peak to peak .* arcsec before, .* arcsec after", out
    )
    assert "with --azimuth also between them" in out

    # one stand's mark is wrong by 0.2 deg: only azimuths can show it
    azimuths = ("--azimuth", "a=30", "--azimuth", "b=210.2")
    _, _, result, _ = calibrate([a, b], rig, tmp_path / "c.json", *azimuths)
    means = result["validation"]["after"]["means"]
    assert np.degrees(means[0] - means[1]) == pytest.approx(0.2, abs=0.02)
    assert len(result["validation"]["rows"]) == 8
    assert result["validation"]["before"]["sinusoid"] is None


# -- what it flags ---------------------------------------------------------------------------


def test_one_rate_only(tmp_path):
    log, rig = simulate(tmp_path, "one", rates="60", plateau=40)
    status, cal, _, err = calibrate([log], rig, tmp_path / "hse.json")
    assert status == 3
    assert (cal["status"], cal["lambda2_rad"], cal["K_HSE_s"]) == ("error", None, None)
    assert "the rates (60.00 deg/s) do not differ enough to determine a slope" in err
    # it is kept, and will not be applied
    status, _, err = sinstool(
        "process", log, "-o", tmp_path / "o.mcap", "--config", rig, "--hse", tmp_path / "hse.json",
        "--force",
    )  # fmt: skip
    assert status == 2
    assert "has no coefficient" in last_words(err)
    # the axial rate is enough for its own method
    status, cal, _, _ = calibrate([log], rig, tmp_path / "axial.json", "--method", "axial")
    assert (status, cal["status"]) == (0, "ok")
    assert cal["lambda2_arcsec"] == pytest.approx(-4.2, abs=0.01)


def test_level_base(tmp_path):
    log, rig = simulate(tmp_path, "level", tilt_east=0, arw=1e-4, vrw=5, plateau=40, rates="60,120")
    status, cal, _, err = calibrate([log], rig, tmp_path / "hse.json")
    assert status == 3
    assert (cal["status"], cal["lambda2_rad"]) == ("unobservable", None)
    assert cal["K_HSE_s"] is not None
    assert "tilt the base to the east or west by 5e-3 rad" in err
    assert arcsec(cal["axial"]["lambda2_rad"]) == pytest.approx(-4.2, abs=0.05)


def test_not_significant(tmp_path):
    log, rig = simulate(tmp_path, "weak", rates="60,90,120", plateau=34, arw=1e-3, vrw=5, seed=4)
    rig = edited(rig, "short", calibration={"min_turns": 4, "min_duration": 15.0})
    hse, out = tmp_path / "hse.json", tmp_path / "o.mcap"
    status, cal, _, err = calibrate([log], rig, hse)
    assert cal["status"] == "not_significant"
    assert cal["lambda2_rad"] is not None
    assert status == 3
    assert "is not significant against its scatter" in err
    apply = ("process", log, "-o", out, "--config", rig, "--hse", hse)
    status, _, err = sinstool(*apply)
    assert status == 2
    assert "not_significant" in last_words(err)
    assert not out.exists()
    status, _, err = sinstool(*apply, "--force")
    assert status == 3
    assert "warning: --force: " in err
    assert out.exists()


def test_latitude_of_86(tmp_path):
    log, rig = simulate(tmp_path, "arctic", latitude=86, rates="60,120", plateau=34)
    output = tmp_path / "hse.json"
    status, _, err = sinstool("calibrate-hse", log, "--config", rig, "-o", output, *SHORT)
    assert status == 1
    assert "86.00 degrees" in last_words(err)
    assert not output.exists()


def test_encoder_in_another_unit(paper, tmp_path):
    log, rig = paper
    output = tmp_path / "hse.json"
    changed = edited(rig, "degrees", encoder={"unit": "deg"})
    status, _, err = sinstool("calibrate-hse", log, "--config", changed, "-o", output, *SHORT)
    assert status == 3
    assert "look at rig.encoder.unit" in last_words(err)
    assert not output.exists()


def test_no_whole_turn(paper, tmp_path):
    log, rig = paper
    output = tmp_path / "hse.json"
    status, _, err = sinstool(
        "calibrate-hse", log, "--config", rig, "-o", output, "--min-turns", "20"
    )
    assert status == 3
    assert "20 whole ones are needed" in last_words(err)
    assert "--min-turns" in err
    assert not output.exists()


def test_stretches_that_settle_for_too_long(paper, tmp_path):
    said = refused(tmp_path, paper[0], "--config", paper[1], "--settle", "50", status=3)
    assert "no stretch at constant rate will do (0.0 s: lasts 0.0 s after settling" in said


def test_log_without_whole_turns_is_left_out_and_told(both, tmp_path):
    a, b, rig = both
    short, _ = simulate(tmp_path, "short", rates="20", plateau=12)
    status, cal, _, err = calibrate([a, short, b], rig, tmp_path / "hse.json")
    assert status == 0
    assert {r["source"] for r in cal["runs"]} == {"a", "b"}
    assert "warning: left out: " in err and "short.mcap" in err


# -- what it refuses -------------------------------------------------------------------------


def refused(folder, *arguments, status=2):
    output = folder / "refused.json"
    code, out, err = sinstool("calibrate-hse", "-o", output, *arguments)
    assert code == status, err
    assert out == ""
    assert not output.exists()
    return err.strip().split("\n")[-1] if err.startswith("Usage") else last_words(err)


def test_no_encoder(paper, tmp_path):
    rig = paper[1]
    plain = imu_log(tmp_path / "plain.mcap", even_times(600), *resting(600))
    said = refused(tmp_path, plain, "--config", rig)
    assert "no JointState messages" in said and "--encoder-topic" in said
    said = refused(tmp_path, paper[0], "--config", edited(rig, "j", encoder={"joint": "tabel"}))
    assert "no joint 'tabel'" in said and "it has table" in said
    # the only joint need not be named
    unnamed = edited(rig, "unnamed", encoder={"joint": ""})
    status, cal, _, _ = calibrate([paper[0]], unnamed, tmp_path / "hse.json")
    assert (status, len(cal["runs"])) == (0, 3)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"encoder": {"sign": -1}}, "change the sign of rig.encoder.sign"),
        ({"K_g": [[2.0, 0, 0], [0, 2.0, 0], [0, 0, 2.0]]}, "unit of the gyros"),
        ({"K_g": [[1, 0.1, 0], [0, 1.0, 0], [0, 0, 1.0]]}, "rig.K_g is not lower triangular"),
        ({"latitude_deg": None}, "rig.latitude_deg is missing"),
        ({"latitude_deg": 100.0}, "rig.latitude_deg is 100"),
        ({"k_G": [[1.0]]}, "k_G"),
        ({"C_s_to_b": None}, "both missing"),
    ],
)
def test_rig_that_cannot_be(paper, tmp_path, keys, message):
    log, rig = paper
    changed = edited(rig, "wrong", **keys)
    assert message in refused(tmp_path, log, "--config", changed, *SHORT)


def test_usage(paper, tmp_path):
    log, rig = paper
    config = ("--config", rig)
    assert "give at least one LOG" in refused(tmp_path, *config)
    assert "no rig is described" in refused(tmp_path, log)
    assert "there is no such file" in refused(tmp_path, tmp_path / "no.mcap", *config, status=1)
    assert "there is no such run" in refused(tmp_path, log, *config, *SHORT, "--exclude", "x#1")
    said = refused(tmp_path, log, *config, *SHORT, "--azimuth", "paper=north")
    assert "not NAME=DEGREES" in said
    said = refused(tmp_path, log, *config, *SHORT, "--azimuth", "other=12")
    assert "no log is called other" in said
    said = refused(tmp_path, log, *config, "--report", tmp_path / "page.doc")
    assert ".html" in said
    assert "is_such" not in said
    status, _, err = sinstool("calibrate-hse", log, *config)
    assert status == 2 and "-o FILE.json" in err


def test_outputs_are_not_written_over(paper, tmp_path):
    log, rig = paper
    there = tmp_path / "there"
    there.write_text("precious")
    for option in ("--csv", "--emit-config", "--report"):
        path = there.rename(there.with_suffix(".html")) if option == "--report" else there
        said = refused(tmp_path, log, "--config", rig, *SHORT, option, path, status=1)
        assert "exists already" in said
        assert path.read_text() == "precious"
    twice = tmp_path / "refused.json"
    said = refused(tmp_path, log, "--config", rig, *SHORT, "--csv", twice, status=1)
    assert "named twice" in said
    said = refused(tmp_path, log, "--config", rig, *SHORT, "--csv", log, status=1)
    assert "named twice" in said


def test_exclude_by_id(noisy, tmp_path):
    a, b, rig = noisy
    _, cal, _, _ = calibrate([a, b], rig, tmp_path / "hse.json", "--exclude", "a#2,b#4")
    out = {r["id"]: r["reason"] for r in cal["runs"] if not r["used"]}
    assert out == {"a#2": "excluded", "b#4": "excluded"}
    assert cal["fit"]["n_runs"] == 6


# -- what it leaves --------------------------------------------------------------------------


def test_csv_holds_the_runs(noisy, tmp_path):
    a, b, rig = noisy
    path = tmp_path / "runs.csv"
    _, cal, _, _ = calibrate([a, b], rig, tmp_path / "hse.json", "--csv", path)
    with path.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["id"] for row in rows] == [run["id"] for run in cal["runs"]]
    for row, run in zip(rows, cal["runs"], strict=True):
        assert float(row["psi_rad"]) == run["psi_rad"]
        assert float(row["rate_rad_s"]) == run["rate_rad_s"]


def test_emitted_rig_has_the_error_no_more(noisy, tmp_path):
    a, b, rig = noisy
    fixed = tmp_path / "fixed.toml"
    more = ("--emit-config", fixed, "--exclude", "b#1")
    _, was, _, _ = calibrate([a, b], rig, tmp_path / "hse.json", *more)
    # what was said of stretches goes along, runs of these logs do not
    status, out, _ = sinstool("calibrate-hse", "--config", fixed, "--print-config")
    assert status == 0
    assert "min_duration = 15.0" in out and "b#1" not in out
    output = tmp_path / "again.json"
    sinstool("calibrate-hse", a, b, "--config", fixed, "-o", output)
    now = json.loads(output.read_text())
    assert abs(arcsec(now["axial"]["lambda2_rad"])) < 0.01
    assert now["config_sha256"] != was["config_sha256"]
    # headings at one azimuth agree, which differed by hundreds of arc seconds
    for source in "ab":
        psi = [r["psi_rad"] for r in now["runs"] if r["source"] == source]
        before = [r["psi_rad"] for r in was["runs"] if r["source"] == source]
        assert arcsec(np.ptp(before)) > 1500.0
        assert arcsec(np.ptp(psi)) < 150.0
    # a calibration of the rig as it was is refused for the rig as it is
    status, _, err = sinstool(
        "process", a, "-o", tmp_path / "o.mcap", "--config", fixed, "--hse", tmp_path / "hse.json"
    )
    assert status == 2
    assert "another configuration of the rig" in last_words(err)


def test_emitted_rig_nulls_the_error_at_its_source(both, tmp_path):
    a, b, rig = both
    fixed = tmp_path / "fixed.toml"
    calibrate([a, b], rig, tmp_path / "hse.json", "--emit-config", fixed)
    output = tmp_path / "again.json"
    sinstool("calibrate-hse", a, b, "--config", fixed, "-o", output)
    calibration = json.loads(output.read_text())
    # the error along the axis; a 50 us delay is no such error
    assert abs(calibration["axial"]["lambda2_rad"]) < 1e-3 * ARCSEC
    lambda2 = calibration["lambda2_rad"]
    assert lambda2 is None or abs(lambda2) < 2e-3 * ARCSEC


def test_plan(paper):
    rig = paper[1]
    status, out, err = sinstool("calibrate-hse", "--plan", "--config", rig, "--json")
    assert status == 0 and err == ""
    plan = json.loads(out)["plan"]
    # 20, 40, 60 deg/s, three times each: white noise over the spread of the rates
    spread = np.sqrt(6.0) * np.radians(20.0)
    sigma = np.mean(plan["sigma_run"])
    assert plan["n_runs"] == 9
    assert plan["sigma_K"] == pytest.approx(sigma / spread, rel=0.02)
    gain = 8e-4 / (3.0 * W * np.cos(0.49))
    assert plan["sigma_lambda2_heading"] == pytest.approx(plan["sigma_K"] / gain, rel=1e-3)
    assert plan["sigma_lambda2_joint"] is None
    _, out, _ = sinstool(
        "calibrate-hse",
        "--plan",
        "--latitude",
        "28.07",
        "--rates",
        "-60,60",
        "--lean",
        "8e-3,-8e-3",
    )
    assert "sigma of a delay" in out
    for wrong, message in (
        (("--rates", "fast"), "--rates: fast are not numbers"),
        (("--lean", "much"), "--lean: much are not numbers"),
        (("--lean", "8e-4,nan"), "--lean: 8e-4,nan are not numbers"),
        (("--arw", "inf"), "--arw is inf"),
        (("--rates", "20"), "too little to determine a slope"),
        (("--repeats", "0"), "no repeats"),
        (("--arw", "0"), "random walk of the gyro is not positive"),
        (("--latitude", "88"), "latitude is beyond 85 deg"),
    ):
        status, _, err = sinstool("calibrate-hse", "--plan", "--latitude", "28", *wrong)
        assert status == 2
        assert message in err
    status, _, err = sinstool("calibrate-hse", "--plan")
    assert status == 2 and "give --latitude" in err


def test_print_config_can_be_fed_back(paper, tmp_path):
    rig = paper[1]
    _, out, _ = sinstool("calibrate-hse", "--config", rig, "--print-config", "--method", "axial")
    again = tmp_path / "again.toml"
    again.write_text(out)
    assert sinstool("calibrate-hse", "--config", again, "--print-config")[1] == out
    assert 'method = "axial"' in out
    assert set(tomllib.loads(out)) == {"input", "calibration", "output", "rig"}


def test_summary_says_what_counts(noisy, tmp_path):
    a, b, rig = noisy
    _, out, _ = sinstool(
        "calibrate-hse", a, b, "--config", rig, "-o", tmp_path / "hse.json", *SHORT, "-v"
    )
    for text in ("8 of 8 in use, from 2 logs", "by joint, 95 %", "status", "a#1", "encoder delay"):
        assert text in out
    status, out, _ = sinstool(
        "calibrate-hse", a, b, "--config", rig, "-o", tmp_path / "q.json", *SHORT, "-q"
    )
    assert (status, out) == (0, "")


def test_page(noisy, tmp_path):
    a, b, rig = noisy
    page = tmp_path / "page.html"
    options = ("--azimuth", "a=30,b=210", "--report", page)
    _, cal, _, _ = calibrate([a, b], rig, tmp_path / "hse.json", *options)
    text = page.read_text()
    for key in (
        "heading",
        "residuals",
        "studentised",
        "azimuth",
        "axial",
        "turns",
        "rates",
        "allan",
    ):
        assert f'data-key="{key}"' in text
    assert "Status ok. The calibration may be applied." in text
    sigma = cal["sigma_lambda2_rad"] / ARCSEC
    value = measured(cal["lambda2_arcsec"], sigma, "arcsec")
    assert f"lambda2 is {value.replace('+-', '±')} by the method" in text
    assert not re.search(r'\d"[ <]', re.sub(r"<[^>]*>", "", text.partition("<script")[0]))
    for title in ("Coefficients", "Headings before and after correction", "Runs", "Settings"):
        assert f">{title}<" in text
    assert "the rate changes" in text


def test_page_of_runs_that_tell_nothing(tmp_path):
    log, rig = simulate(tmp_path, "one", rates="60", plateau=40)
    page = tmp_path / "page.html"
    status, _, _ = sinstool(
        "calibrate-hse", log, "--config", rig, "-o", tmp_path / "h.json", *SHORT, "--report", page
    )
    assert status == 3
    text = page.read_text()
    assert "Status error. The runs do not determine the coefficient." in text
    assert 'data-key="heading"' in text and 'data-key="azimuth"' not in text


@pytest.mark.slow
def test_main_figure_alone(noisy, tmp_path):
    a, b, rig = noisy
    for suffix, begins in ((".png", b"\x89PNG"), (".pdf", b"%PDF")):
        figure = tmp_path / f"figure{suffix}"
        calibrate([a, b], rig, tmp_path / f"{suffix}.json", "--report", figure)
        assert figure.read_bytes().startswith(begins)


# -- documents and samples -------------------------------------------------------------------


DOCUMENT = ROOT / "docs" / "heading-sensitive-error.md"


@pytest.fixture
def somewhere(tmp_path, monkeypatch):
    """A folder of its own from which the samples are found as the documents name them."""
    (tmp_path / "sample_data").symlink_to(ROOT / "sample_data")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def expanded(words):
    """Words with their patterns replaced, as a shell does."""
    names = []
    for word in words:
        names += sorted(map(str, Path().glob(word))) if "*" in word else [word]
    return names


def number(word):
    try:
        return float(word.strip('",:()'))
    except ValueError:
        return None


def assert_alike(documented, printed):
    """Words are the same, numbers nearly: last digits may differ on another machine."""
    assert len(documented.split("\n")) == len(printed.split("\n"))
    for a, b in zip(documented.split(), printed.split(), strict=True):
        if number(a) is None or number(b) is None:
            assert a == b
        else:
            assert number(b) == pytest.approx(number(a), rel=0.01, abs=2e-3)


def test_guide_shows_what_is_printed(somewhere):
    text = DOCUMENT.read_text()
    shown = re.findall(r"```sh\nsinstool ([^\n]*)\n```\n\n```text\n(.*?)\n```", text, re.S)
    assert len(shown) == 5
    for command, documented in shown:
        status, out, _ = sinstool(*expanded(command.split()))
        assert status == 0
        assert_alike(documented, out.rstrip())


def test_guide_shows_what_the_paper_s_figures_come_to(capsys):
    hse_paper.main()
    printed = capsys.readouterr().out
    text = DOCUMENT.read_text().split("prints all of this:")[1]
    assert_alike(text.split("```text\n")[1].split("\n```")[0], printed.rstrip())
    for figure in ("1.6 sigma", "40.500 | 28.500", "0.033 | 0.455", "31.6 arcsec"):
        assert figure in printed


def test_guide_knows_every_status_and_key():
    text = DOCUMENT.read_text()
    for status in STATUSES:
        assert f"| `{status}` |" in text
    for key in [f.name for f in fields(HseCalibration)]:
        assert f"`{key}`" in text
    table = Rig(np.eye(3), np.eye(3), latitude=0.5).to_table()
    for key in (*table, *table["encoder"]):
        assert f"`{key}`" in text or f"`[rig.{key}]`" in text


def test_readme_s_command(somewhere):
    text = (ROOT / "README.md").read_text()
    line = text.split("<!-- hse -->\n```\n")[1].split("\n```")[0]
    install, *commands = line.split("&& .venv/bin/sinstool ")
    assert install.startswith("python3 -m venv .venv")
    assert len(commands) == 2
    for command in commands:
        assert sinstool(*expanded(command.split()))[0] == 0
    assert (somewhere / "b-200.attitude.mcap").stat().st_size > 100_000


def test_samples_are_what_their_commands_make(somewhere, tmp_path):
    text = (ROOT / "sample_data" / "README.md").read_text()
    commands = re.findall(r"`sinstool (simulate hse-rig [^`]*)`", text)
    assert len(commands) == 8
    sizes = [p.stat().st_size for p in (ROOT / "sample_data" / "hse").iterdir()]
    assert len(sizes) == 10 and sum(sizes) < 2.5e6
    for command in (commands[1], commands[6]):
        words = command.split()
        sample = ROOT / words[3]
        made, rig = tmp_path / sample.name, tmp_path / "rig.toml"
        words[3] = str(made)
        assert sinstool(*words, "--rig-out", rig)[0] == 0
        for topic in ("/imu/data_raw", "/joint_states"):
            for (t, a), (u, b) in zip(
                read_topic(made, topic)[::50], read_topic(sample, topic)[::50], strict=True
            ):
                assert t == u
                if topic == "/joint_states":
                    assert a.position[0] == pytest.approx(b.position[0], abs=1e-12)
                else:
                    assert a.angular_velocity.y == pytest.approx(b.angular_velocity.y, abs=1e-12)
                    value = b.linear_acceleration.y
                    assert a.linear_acceleration.y == pytest.approx(value, abs=1e-12)
        table = tomllib.loads(sample.with_name(f"rig-{sample.name[0]}.toml").read_text())["rig"]
        assert tomllib.loads(rig.read_text())["rig"] == table
