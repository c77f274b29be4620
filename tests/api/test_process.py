"""`sinstool.process` and the commands that judge a log: the numbers of the command line."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

import sinstool
from tests.helpers.imulogs import angles_between, in_log_axes, read_attitude, read_topic
from tests.helpers.paths import ROOT

STATIC = ROOT / "sample_data" / "static.mcap"
CONING = ROOT / "sample_data" / "coning.mcap"
HSE = ROOT / "sample_data" / "hse"


@pytest.fixture
def command(monkeypatch, capsys):
    """Runs the command line in this process; its JSON."""
    from sinstool.cli import main

    def call(*arguments):
        monkeypatch.setattr("sys.argv", ["sinstool", *map(str, arguments), "--json"])
        with pytest.raises(SystemExit):
            main.main()
        return json.loads(capsys.readouterr().out)

    return call


def plain(result):
    """Its JSON as the command prints it."""
    return json.loads(json.dumps(result.to_json()))


def test_a_solution_in_memory_is_the_one_that_is_written(tmp_path, command, drive, navigated):
    _, path = drive
    out = tmp_path / "out.mcap"
    printed = command("process", path, "-o", out, "--imu-grade", "tactical", "--emit", "imu,fix")
    solution = navigated.solution
    times, q_xyzw = read_attitude(out, "/sinstool/imu")
    assert np.array_equal(times, solution.time_ns)
    assert angles_between(q_xyzw, in_log_axes(solution.q_nb)).max() < 1e-12
    fixes = [m for _, m in read_topic(out, "/sinstool/fix")]
    assert [m.latitude for m in fixes] == pytest.approx(
        np.degrees(solution.position[:, 0]).tolist(), rel=1e-14
    )
    own = plain(navigated)
    output, written = own.pop("output"), printed.pop("output")
    assert output.pop("origin") == written["origin"]
    assert output == {"path": None, "topics": [], "attitudes": 9001, "frame": "map"}
    # sums over other parts of the log
    for name in ("distance_m", "mean_speed_m_s"):
        mine = own["travel"].pop(name)
        assert mine == pytest.approx(printed["travel"].pop(name), rel=1e-12)
    assert own == printed


def test_a_written_output_is_that_of_the_command(tmp_path, command):
    one, other = tmp_path / "one.mcap", tmp_path / "other.mcap"
    printed = command("process", STATIC, "-o", one, "--mode", "attitude", "--align", "level")
    result = sinstool.process(str(STATIC), str(other), mode="attitude", align="level")
    assert one.read_bytes() == other.read_bytes()
    printed["output"]["path"] = str(other)
    assert plain(result) == printed


def test_options_are_those_of_the_command(tmp_path):
    file = tmp_path / "run.toml"
    file.write_text('[navigation]\nmode = "attitude"\n[coning]\nconing = "previous-1"\n')
    result = sinstool.process(CONING, config=file, gyro_kind="mean-rate", attitude="inertial")
    assert result.plan.coning.value == "previous-1"
    assert result.plan.mode.value == "attitude"
    # a keyword is stronger than the file
    again = sinstool.process(
        CONING, config=str(file), gyro_kind="mean-rate", coning="lookahead-12", start=1, end="5.5"
    )
    assert again.plan.coning.value == "lookahead-12" and len(again.solution) == 451


def test_arrays_numbers_and_none_do_as_options():
    options = {"latitude": np.float64(45), "lever_arm": np.array([1, 0, 0]), "imu_grade": None}
    result = sinstool.process(STATIC, mode="attitude", start=np.int64(2), **options)
    assert len(result.solution) == 1801


def test_a_log_that_is_open_brings_its_options(tmp_path):
    path = sinstool.simulate("static", tmp_path / "f.mcap", duration=5.0, body_axes="frd")
    assert "Simulated: scenario static" in repr(path)
    with sinstool.open_log(tmp_path / "f.mcap", body_axes="frd") as log:
        roll = sinstool.process(log, mode="attitude").solution.to_pandas().roll_deg
        assert abs(roll).max() < 0.01
        assert not [f for f in sinstool.survey(log).findings if "upside" in f.text]


def test_a_report_and_a_truth_without_an_output(tmp_path):
    page = tmp_path / "page.html"
    result = sinstool.process(
        STATIC, mode="attitude", align="level", report=page, truth="/truth/imu"
    )
    assert "</html>" in page.read_text()
    assert result.summary.truth.attitude_deg.instants == 2001
    with pytest.raises(sinstool.SinstoolError, match="exists already"):
        sinstool.process(STATIC, mode="attitude", report=page)
    assert list(tmp_path.iterdir()) == [page]


def test_progress_comes_to_its_end():
    seen = []
    sinstool.process(STATIC, mode="attitude", progress=seen.append)
    assert seen == sorted(seen) and seen[-1] == 1.0 and len(seen) > 2


def test_nothing_is_printed(capsys, drive, navigated):
    sinstool.process(drive[1], mode="attitude")
    assert capsys.readouterr() == ("", "")
    assert repr(navigated) == "<Result: ins-gnss, done, 9001 rows over 90.000 s>"
    assert navigated.status == "done"
    assert {f.kind for f in navigated.findings} >= {"velocity-left-out"} or navigated.warnings == ()


def test_a_turntable_in_memory(tmp_path):
    calibration = sinstool.calibrate_hse(
        str(HSE / "a-*.mcap"), HSE / "rig-a.toml", tmp_path / "hse.json"
    )
    result = sinstool.process(
        HSE / "b-200.mcap", config=HSE / "rig-b.toml", hse=tmp_path / "hse.json"
    )
    assert result.plan.mode.value == "turntable" and len(result.solution) > 1000
    assert json.loads((tmp_path / "hse.json").read_text())["status"] == calibration.file.status


def test_a_rig_may_be_a_table(tmp_path):
    import tomllib

    table = tomllib.loads((HSE / "rig-a.toml").read_text())
    logs = sorted(HSE.glob("a-*.mcap"))
    by_file = sinstool.calibrate_hse(logs, HSE / "rig-a.toml")
    by_table = sinstool.calibrate_hse(logs, table["rig"], **table["calibration"])
    assert by_table.file.lambda2_rad == by_file.file.lambda2_rad is not None
    with pytest.raises(sinstool.SinstoolError, match=r"rig\.K_gg is not known"):
        sinstool.calibrate_hse(logs, {"K_gg": 1})
    with pytest.raises(sinstool.SinstoolError, match="no log is given"):
        sinstool.calibrate_hse([], HSE / "rig-a.toml")


# The other commands


def test_survey_is_info(command):
    found = sinstool.survey(STATIC)
    assert plain(found) == command("info", STATIC)
    assert found.plan.mode.value == "attitude" and "reason" in vars(found.plan.mode)


def test_align_is_align(command):
    found = sinstool.align(STATIC, align="level", latitude=45, truth="/truth/imu")
    options = ("--align", "level", "--latitude", "45", "--truth", "/truth/imu")
    assert plain(found) == command("align", STATIC, *options)


def test_compare_coning_is_compare_coning(command):
    names = ["uncompensated", "previous-3"]
    found = plain(sinstool.compare_coning(CONING, algorithms=names, decimate=[1], window=2.0))
    printed = command(
        "compare-coning",
        CONING,
        "--algorithms",
        ",".join(names),
        "--decimate",
        "1",
        "--window",
        "2",
    )
    for one in (*found["algs"], *printed["algs"]):  # what was measured with a clock
        for key in [key for key in one if re.search("cost|ns_per|time", key)]:
            del one[key]
    assert found == printed


# Mistakes


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"moed": "ins"}, "process has no option moed: did you mean mode"),
        ({"zzzzzz": 1}, "process has no option zzzzzz: `sinstool process --help-all` lists them"),
        ({"mode": "ins-gps"}, "--mode 'ins-gps': must be 'auto', 'attitude', 'ins' or 'ins-gnss'"),
        ({"latitude": "north"}, "--latitude 'north': must be a valid number"),
        ({"latitude": 91}, "--latitude 91: must be less than or equal to 90"),
        ({"lever_arm": (1, 2)}, "--lever-arm"),
        ({"smooth": "yes"}, "--smooth 'yes': must be a valid boolean"),
        ({"emit": ["attitud"], "output": "x"}, "did you mean attitude"),
        ({"coning": "previous-33"}, "unknown coning algorithm 'previous-33'"),
        ({"config": "no.toml"}, "no.toml: cannot be read"),
        ({"output": STATIC}, "is the input itself"),
        ({"output": 3}, "the output is of type int"),
        ({"emit": ["imu"]}, "emit concerns the output, and none is written: give an output"),
        ({"start": 30.0}, "no usable Imu message"),
        ({"align": "fixed"}, "needs an attitude"),
        ({"mode": "ins-gnss", "align": "svd"}, "static.mcap"),
    ],
)
def test_a_mistake_is_one_line_that_helps(options, said):
    with pytest.raises(sinstool.SinstoolError) as info:
        sinstool.process(STATIC, **options)
    text = str(info.value)
    assert said in text and "\n" not in text and "pydantic" not in text


def test_options_of_other_commands_are_refused():
    with pytest.raises(sinstool.SinstoolError, match="survey has no option smooth"):
        sinstool.survey(STATIC, smooth=True)
    with pytest.raises(sinstool.SinstoolError, match="compare_coning has no option mode"):
        sinstool.compare_coning(STATIC, mode="ins")
    with pytest.raises(sinstool.SinstoolError, match="leave gnss out"):
        sinstool.align(STATIC, gnss=sinstool.simulate("static", duration=2.0).gnss())


def test_a_run_that_fails_leaves_no_output(tmp_path):
    with pytest.raises(sinstool.SinstoolError):
        sinstool.process(STATIC, tmp_path / "out.mcap", start=30.0)
    assert list(tmp_path.iterdir()) == []
