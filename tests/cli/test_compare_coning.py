"""`compare-coning` on logs: what is printed, written and refused."""

import csv
import json
import re
import threading
import tomllib
from functools import partial
from html.parser import HTMLParser

import numpy as np
import pytest

from sinstool.methods.coning.registry import algorithm
from sinstool.pipelines.compare_coning import runs
from sinstool.pipelines.compare_coning.compare import DEFAULT_ALGORITHMS
from sinstool.pipelines.compare_coning.divergence import IN_DEG_H
from tests.helpers.coning_response import coning_drift
from tests.helpers.imulogs import even_times, handheld, imu_log, resting
from tests.helpers.logs import real
from tests.helpers.paths import ROOT

SAMPLE = ROOT / "sample_data" / "coning.mcap"
# 1 deg, 5 Hz, mean rates at 100 Hz, moving from 3 s on
CONING = (SAMPLE, "--gyro-kind", "mean-rate", "--start", "3", "--truth", "/truth/imu")


@pytest.fixture
def compare(sinstool):
    """Runs the command in this process: status, stdout, stderr."""
    return partial(sinstool, "compare-coning")


@pytest.fixture
def moving(tmp_path):
    gyro, accel, _ = handheld(3000)
    folder = tmp_path / "logs"
    folder.mkdir()
    return imu_log(folder / "moving.mcap", even_times(3000), gyro, accel)


def closed(name, decimate=1):
    return abs(coning_drift(algorithm(name), np.radians(1.0), 5.0, 0.01 * decimate)) * IN_DEG_H


def row_of(out, name, group=0):
    """Numbers of an algorithm's line in one of the groups."""
    lines = [line for line in out.split("\n") if re.match(rf"{re.escape(name)}( \*)?  ", line)]
    cells = lines[group].replace(" *", "").split()
    return [float(re.sub(r"[()]", "", x)) if x != "-" else None for x in cells[1:]]


def test_table_holds_the_drift_of_the_closed_form(compare):
    status, out, _ = compare(*CONING, "--decimate", "1,2", "-v")
    assert status == 0
    for group, m in ((0, 1), (1, 2)):
        for name in ("uncompensated", "previous-1", "optimal-2", "picard-4"):
            rate, drift, end, mean, _, predicted, expected, _, cost = row_of(out, name, group)
            samples = algorithm(name).samples
            assert rate == pytest.approx(100 / samples / m)
            # as printed: three digits
            assert drift == pytest.approx(closed(name, m), rel=0.01)
            assert mean == pytest.approx(drift, rel=0.04)
            assert end == pytest.approx(drift, rel=0.04)
            assert predicted == expected
            assert expected == pytest.approx(drift, rel=0.01)
            assert cost > 1.0
    # Which of the accurate ones is cheap depends on what else the machine does
    assert "is cheap and within 0.01 deg/h of the truth" in out[out.index("Verdict: ") :]


@pytest.mark.slow
def test_columns_fit_120(compare, moving):
    for extra in ((), ("--stopband", "60", "--passband", "20"), ("--reference", "none")):
        status, out, _ = compare(moving, "--decimate", "1,2,4", "-v", *extra)
        assert status == 0
        assert max(map(len, out.split("\n"))) <= 120
        assert out.count("As if logged at") == 4


@pytest.mark.slow
def test_lower_rates_have_a_line_each_and_tables_with_v(compare, moving):
    out = compare(moving, "--decimate", "1,2")[1]
    assert "As if logged at" not in out and "singular-perturbation is the same as" not in out
    assert out.count("Logged at 100 Hz, ") == 2
    more = compare(moving, "--decimate", "1,2", "-v")[1]
    assert more.count("As if logged at 100 Hz") == 2
    assert "singular-perturbation is the same as" in more


@pytest.mark.slow
def test_json_has_all_keys(compare, moving):
    status, out, _ = compare(moving, "--json", "--stopband", "60", "--passband", "20")
    assert status == 0
    result = json.loads(out)
    assert next(iter(result)) == "schema" and result["schema"] == "sinstool.compare-coning/1"
    assert result["input"] == {"path": str(moving)}
    keys = "meta checks reference algs pairs spectrum sp findings verdict alias lost"
    assert set(keys.split()) <= set(result)
    assert len(result["algs"]) == 50
    first = result["algs"][0]
    assert {"name", "update_hz", "decimate", "input", "end_deg", "ns_per_sample"} <= set(first)
    for key in ("mean", "confidence", "rms", "p95", "max"):
        assert len(first["drift_dph"][key]) == 3
    assert len(first["pred_dph"]) == len(first["pseudo_dph"]) == 3
    native = [a["name"] for a in result["algs"] if a["decimate"] == 1]
    assert native == list(DEFAULT_ALGORITHMS)
    assert len(result["pairs"]) == 45
    assert result["checks"]["rate_hz"] == pytest.approx(200.0)
    assert result["verdict"]["algorithm"] is None
    assert result["verdict"]["limit_dph"] > 0.01
    assert [f["kind"] for f in result["findings"]] == ["sampling-limit"]
    # what a candidate parts by is its prediction less that of the reference
    reference = np.array(result["reference"]["pred_dph"])
    for a in result["algs"]:
        parting = np.array(a["pred_dph"]) - reference
        np.testing.assert_allclose(a["pred_parting_dph"], parting, atol=1e-12)
        beyond = np.array(a["drift_dph"]["mean"]) - parting
        np.testing.assert_allclose(a["beyond_pred_dph"], beyond, atol=1e-9)


def test_every_option_can_stand_in_the_file(compare, moving, tmp_path):
    file = tmp_path / "run.toml"
    file.write_text(
        "[comparison]\nalgorithms = ['previous-3', 'gyro-tuned', 'singular-perturbation']\n"
        "decimate = [1]\nwindow = 4.0\ntolerance = 0.5\n"
        "[coning]\npassband = 20.0\nstopband = 60.0\nsp_preset = 'auto'\n"
        "[input]\nend = 9\n"
    )
    _, out, err = compare(moving, "--json", "--config", file)
    result = json.loads(out)
    meta = result["meta"]
    assert (meta["window_s"], meta["tolerance_dph"]) == (4.0, pytest.approx(0.5))
    assert (meta["passband_hz"], meta["stopband_hz"]) == (20.0, 60.0)
    assert meta["duration_s"] == pytest.approx(9.0, abs=0.01)
    names = ["previous-3", "gyro-tuned", "singular-perturbation"]
    assert [a["name"] for a in result["algs"]] == names
    _, out, _ = compare(moving, "--json", "--config", file, "--passband", "30", "--window", "3")
    flags = json.loads(out)
    assert (flags["meta"]["passband_hz"], flags["meta"]["window_s"]) == (30.0, 3.0)
    # the file's band tunes what it is for
    tuned = [f["sp"]["tuning"]["drift_tuned_dph"] for f in (result, flags)]
    assert tuned[0] != tuned[1]
    status, out, _ = compare("--config", file, "--sp-preset", "paper", "--print-config")
    printed = tomllib.loads(out)
    assert status == 0
    assert printed["coning"]["sp_preset"] == "paper" and printed["comparison"]["window"] == 4.0
    file.write_text("[comparison]\nwindw = 1.0\n")
    status, _, err = compare(moving, "--config", file)
    assert status == 2
    assert "unknown key comparison.windw: did you mean window?" in err


def test_json_of_one_window_has_null_for_its_spread(compare, moving):
    status, out, _ = compare(moving, "--json", "--end", "4", "--decimate", "1")
    assert status == 0
    result = json.loads(out)
    assert result["algs"][0]["drift_dph"]["confidence"] == [None] * 3


def test_csv_holds_what_json_does(compare, moving, tmp_path):
    folder = tmp_path / "tables"
    _, out, _ = compare(moving, "--json", "--csv", folder, "--decimate", "1,2")
    result = json.loads(out)
    with (folder / "algorithms.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(result["algs"]) == 30
    for row, a in zip(rows, result["algs"], strict=True):
        assert row["algorithm"] == a["name"]
        assert row["kept"] == ("all" if a["decimate"] == 1 else f"1/2 {a['input']}")
        assert float(row["drift [deg/h rms]"]) == a["drift_dph"]["slope_rms"]
        assert float(row["window end [deg/h rms]"]) == a["drift_dph"]["norm_rms"]
        for k, axis in enumerate("xyz"):
            assert float(row[f"mean {axis} [deg/h]"]) == a["drift_dph"]["mean"][k]
            assert float(row[f"expected {axis} [deg/h]"]) == a["pred_dph"][k]
        assert row["prediction does not hold"] == a["pred_exception"]
    with (folder / "pairs.csv").open(newline="") as stream:
        pairs = list(csv.reader(stream))[1:]
    assert len(pairs) == 45
    assert float(pairs[0][2]) == result["pairs"][0]["largest_deg"]
    status, _, err = compare(moving, "--csv", folder)
    assert status == 1
    assert "is not an empty folder" in err


class Words(HTMLParser):
    def __init__(self):
        super().__init__()
        self.text = []
        self.skip = 0

    def handle_starttag(self, tag, attrs):
        self.skip += tag in ("script", "style")

    def handle_endtag(self, tag):
        self.skip -= tag in ("script", "style")

    def handle_data(self, data):
        if not self.skip:
            self.text.append(data)


def test_report_page(compare, moving, tmp_path):
    page = tmp_path / "page.html"
    status, out, _ = compare(moving, "--report", page, "--passband", "20", "--stopband", "60")
    assert status == 0
    reader = Words()
    reader.feed(page.read_text())
    text = " ".join(" ".join(reader.text).split())
    verdict = " ".join(out.split("Verdict: ")[1].split())[:-1]
    assert verdict in text
    for title in (
        "Divergence from quatfiter-4",
        "Mean drift by axis",
        "Coning in the log up to each frequency",
        "Fraction of the true coning",
        "Power of the angular rate",
        "Drift if the log had been recorded at a lower rate",
    ):
        assert title in text
    assert "if nothing moves above the stopband" in text
    assert page.stat().st_size < 10_000_000
    status, _, err = compare(moving, "--report", page)
    assert status == 1
    assert "--overwrite" in err


def test_report_figure(compare, moving, tmp_path):
    figure = tmp_path / "figure.png"
    assert compare(moving, "--report", figure, "--decimate", "1,2")[0] == 0
    assert figure.read_bytes().startswith(b"\x89PNG")


def test_report_without_a_reference(compare, moving, tmp_path):
    page = tmp_path / "page.html"
    status, out, _ = compare(moving, "--reference", "none", "--report", page)
    assert status == 0
    assert "No reference; " in out and " differ most, by " in out
    assert "Verdict: Without a reference no algorithm can be chosen." in out
    assert page.stat().st_size > 10_000
    # a column that is not there is not explained
    assert "if nothing moves above the stopband" not in page.read_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--algorithms", "previos-1"), "did you mean previous-1?"),
        (("--algorithms", "previous-1,quatfilter-4"), "did you mean quatfiter-4?"),
        (("--reference", "optimal4"), "did you mean optimal-4?"),
        (("--sp-preset", "auto"), "give --passband"),
    ],
)
def test_wrong_options_are_answered(compare, moving, arguments, message):
    status, out, err = compare(moving, *arguments)
    assert status == 2
    assert out == ""
    assert message in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "give a LOG"),
        ((SAMPLE, "--paper"), "leave it out, or the LOG"),
        ((SAMPLE, "--decimate", "0"), "--decimate 0: must be greater than or equal to 1"),
        ((SAMPLE, "--decimate", "two"), "'two' is not whole numbers separated by commas"),
        ((SAMPLE, "--window", "0"), "--window 0.0: must be greater than 0"),
        ((SAMPLE, "--tolerance", "-1"), "--tolerance -1.0: must be greater than or equal to 0"),
        ((SAMPLE, "--truth", "/truth/imu", "--reference", "optimal-4"), "not both"),
    ],
)
def test_wrong_usage(compare, arguments, message):
    status, _, err = compare(*arguments)
    assert status == 2
    assert message in err.strip().split("\n")[-1]


def test_failures_of_the_log_are_one_line(compare, tmp_path):
    gyro, accel, _ = handheld(400)
    nothing = imu_log(tmp_path / "nan.mcap", even_times(400), gyro * np.nan, accel)
    short = imu_log(tmp_path / "short.mcap", even_times(8), gyro[:8], accel[:8])
    for path, message in (
        (nothing, "400 hold NaN, infinity or more than"),
        (short, "long enough to compare algorithms on: choose a longer span"),
        (tmp_path / "none.mcap", "there is no such file"),
    ):
        status, out, err = compare(path)
        assert status == 1
        assert out == ""
        assert message in err
        assert len(err.strip().split("\n")) == 1


@pytest.mark.slow
def test_two_seconds_a_gap_rest_and_nan(compare, tmp_path):
    gyro, accel, _ = handheld(6000)
    times = even_times(6000)
    path = imu_log(tmp_path / "two.mcap", times[:400], gyro[:400], accel[:400])
    _, out, err = compare(path, "--decimate", "1")
    assert "less than one window of 10 s" in err
    assert "one window only, so the spread is unknown" in " ".join(out.split())

    late = times.copy()
    late[3000:] += 3_000_000_000
    path = imu_log(tmp_path / "gap.mcap", late, gyro, accel)
    _, out, err = compare(path, "--decimate", "1")
    assert "30.0 s in 2 stretches between gaps" in out
    assert "nothing is integrated across it" in err
    assert "The others cannot be told apart" in " ".join(out.split())

    holed = gyro.copy()
    holed[100:103] = np.nan
    holed[3000:3050, 1] = np.inf
    path = imu_log(tmp_path / "nan.mcap", times, holed, accel)
    _, out, err = compare(path, "--decimate", "1")
    assert "53 samples hold NaN, infinity or more than 1e+09; left out" in err
    assert "in 3 stretches" in out
    assert "The others cannot be told apart" in " ".join(out.split())

    still, accel = resting(6000)
    path = imu_log(tmp_path / "still.mcap", times, still, accel)
    _, out, _ = compare(path, "--decimate", "1")
    verdict = " ".join(out.split("Verdict: ")[1].split())
    assert verdict.startswith("All algorithms agree to 0.01 deg/h, so on this log the choice")
    assert verdict.endswith("it is sampled too slowly for any algorithm.")

    path = imu_log(tmp_path / "dead.mcap", times, still * 0.0, accel)
    status, out, _ = compare(path, "--decimate", "1,2")
    assert status == 0
    assert "nan" not in out.lower()
    assert row_of(out, "uncompensated")[1:8] == [0.0] * 7


def _as_costly_as(monkeypatch, text):
    """Time runs as in a guide's table: what is cheap is no matter of how busy this machine is."""
    costs = {}
    for line in text.split("\n"):
        row = line.split()
        if len(row) > 8 and row[0] in DEFAULT_ALGORITHMS and re.fullmatch(r"[\d.]+", row[-1]):
            costs.setdefault(row[0], float(row[-1]) * 1e-9)
    clock, integrate = threading.local(), runs._integrate  # runs of two threads: two clocks

    def timed(chosen, fed, interval, gyro, times):
        clock.now = getattr(clock, "now", 0.0) + costs[chosen.name] * len(times)
        return integrate(chosen, fed, interval, gyro, times)

    monkeypatch.setattr(runs, "_integrate", timed)
    monkeypatch.setattr(runs.time, "thread_time", lambda: getattr(clock, "now", 0.0))


def test_guide_shows_what_is_printed(compare, monkeypatch):
    root = SAMPLE.parents[1]
    monkeypatch.chdir(root)
    guide = (root / "docs" / "compare-coning.md").read_text()
    block = r"```sh\nsinstool compare-coning ([^\n]*)\n```\n\n"
    shown = re.findall(block + r"<!-- output: [^\n]*\n```text\n(.*?)\n```", guide, re.S)
    assert len(shown) == 2
    for command, text in shown:
        _as_costly_as(monkeypatch, text)
        _, out, _ = compare(*command.split())
        documented, printed = (t.rstrip().split("\n") for t in (text, out))
        assert len(documented) == len(printed)
        for line, other in zip(documented, printed, strict=True):
            # the cost is that of the machine; last digits may differ on another
            parts, others = line.split(), other.split()
            assert len(parts) == len(others)
            row = parts and parts[0] in DEFAULT_ALGORITHMS
            for a, b in list(zip(parts, others, strict=True))[: -1 if row else None]:
                numbers = [re.sub(r"[()]", "", x) for x in (a, b)]
                if row and a != b:
                    assert float(numbers[0]) == pytest.approx(float(numbers[1]), rel=0.02, abs=1e-6)
                else:
                    assert a == b
    assert "0.0194 deg/h, and the spectrum says why" in " ".join(guide.split())


def test_reference_tells_what_it_is_worth(compare):
    # at 20 samples a turn quatfiter-4 itself drifts by 0.019 deg/h; the spectrum knows
    _, out, _ = compare(SAMPLE, "--gyro-kind", "mean-rate", "--start", "3", "--decimate", "1")
    text = " ".join(out.split())
    match = re.search(r"confirm to (\S+) deg/h; its own predicted drift is (\S+)", text)
    assert float(match[2]) == pytest.approx(closed("quatfiter-4"), rel=0.02)
    assert float(match[1]) == pytest.approx(closed("quatfiter-4"), rel=0.05)
    assert row_of(out, "quatfiter-4")[1] == 0.0


def test_pseudo_coning_of_a_tuned_algorithm(compare, moving):
    _, out, _ = compare(
        moving,
        "--algorithms",
        "previous-3,gyro-tuned",
        "--passband",
        "30",
        "--stopband",
        "60",
        "--decimate",
        "1",
    )
    assert "pseudo" in out
    caveat = algorithm("gyro-tuned", interval=0.005, passband=30.0, stopband=60.0).caveat
    assert " ".join(caveat.split()) in " ".join(out.split())
    assert row_of(out, "gyro-tuned")[7] < row_of(out, "previous-3")[7]


def test_a_real_log_with_its_odd_rate(compare):
    log = real("broad/broad_06_undisturbed_fast_rotation_A.mcap")
    status, out, _ = compare(log, "--decimate", "1,2", "-v")
    assert status == 0
    assert "285.714 Hz" in out
    text = " ".join(out.split())
    assert "Only larger differences show: uncompensated 5.3, optimal-4 1.7 deg/h." in text
    # a line at 141.5 Hz, and noise: picking every second sample is far worse than any algorithm
    assert "lines aliased to slow motion: 141.5 Hz" in text
    assert row_of(out, "previous-3", 2)[1] > 100 * row_of(out, "previous-3", 1)[1]
