"""Starts of a filter that a log denies."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.trusted_navigation import process
from sinstool.core.finding import Finding, Severity, exit_status
from sinstool.pipelines.process.ins_gnss.contradictions import impossible_gyros, of_another_clock
from sinstool.survey.oddities import SATURATION
from tests.helpers.filter_logs import run, simulated
from tests.helpers.unseen_drives import GRADES, drive, record, write
from tests.helpers.unseen_errors import shaken


@pytest.mark.parametrize(
    ("status", "sigma_s", "contradicts", "trusted"),
    [
        ("found", 0.01, False, True),
        ("found", 0.2, False, False),  # whose estimates follow what they are made about
        ("given", 0.01, False, True),
        ("given", 0.01, True, False),
        ("not settled", 0.01, False, False),
        ("not observable", 0.2, False, False),
    ],
)
def test_only_motion_makes_up_for_another_clock(status, sigma_s, contradicts, trusted):
    shown = SimpleNamespace(sigma_s=sigma_s, latency_contradicts=lambda _: contradicts)
    settings = SimpleNamespace(gnss_latency=0.0)
    start = SimpleNamespace(
        offsets=shown, latency_status=status, settings=settings, slow_errors=(1.0, 1.0)
    )
    clock = Finding("receiver-clock", "two", answer="give it", numbers={"ahead_s": 2.0})
    findings = of_another_clock([clock], start)
    assert exit_status(findings) == (0 if trusted else 3)
    assert trusted or findings[0].answer == "give it"
    assert trusted or findings[0].text.startswith("two, so every fix is used")
    assert not of_another_clock([Finding("other", "else")], start)
    # With a wrong attitude a latency may seem to be shown by fixes that wander
    start.slow_errors = (10.0, 1.0)
    assert exit_status(of_another_clock([clock], start)) == 3


def test_a_wrong_clock_is_reported_once(tmp_path):
    """The survey reported it, and the run that it spoils reported it again."""
    log = simulated(
        tmp_path / "log.mcap", "drive", "--duration", "60", "--still", "55", "--grade", "mems",
        "--rate", "50", "--seed", "3", "--baro-rate", "0",
    )  # fmt: skip
    given = {"align": "fixed", "initial_attitude": (0.0, 0.0, 40.0)}
    result, _ = run(log, input={"gnss_clock_offset": -2.0}, align=given)
    told = [f for f in result["findings"] if "clock" in f["text"] + f["answer"]]
    assert [f["kind"] for f in told] == ["receiver-clock"]
    assert told[0]["severity"] == Severity.LOST.name.lower()
    assert "2.0 s ahead of" in told[0]["text"] and "do not trust" in told[0]["text"]
    assert "leave --gnss-clock-offset out" in told[0]["answer"]


def test_a_saturated_sensor_is_a_cause_of_gyros_that_do_not_fit():
    start = SimpleNamespace(noisier_gyros=5.0)
    (axes,) = impossible_gyros(start, [])
    (saturated,) = impossible_gyros(start, [Finding(SATURATION, "gyro z stays at its largest")])
    assert axes.severity == saturated.severity == Severity.LOST
    assert "axes" in axes.answer and "range" in saturated.answer
    assert "saturated" in saturated.text and "belong together" not in saturated.text
    assert not impossible_gyros(SimpleNamespace(noisier_gyros=1.0), [])


@pytest.mark.parametrize("seed", [1, 3])
@pytest.mark.slow
def test_gyros_that_no_noise_explains_are_said_to_be_wrong(tmp_path, seed):
    """An axis turned round: as a gyro of much noise it fits all innovations, and is off by much."""
    data = record(drive(seed, 200.0, 10.0), GRADES["industrial"], seed)
    right, _ = run(write(tmp_path / "right.mcap", data))
    assert not [f for f in right["findings"] if f["severity"] == Severity.LOST.name.lower()]
    turned = replace(data, gyro=data.gyro * [1.0, -1.0, 1.0])
    wrong, _ = run(write(tmp_path / "wrong.mcap", turned))
    (told,) = [f for f in wrong["findings"] if f["severity"] == Severity.LOST.name.lower()]
    assert told["kind"] == "gyros-do-not-fit" and told["numbers"]["gyro_noise"] > 3.5


@pytest.mark.parametrize("seed", [2, 4])
@pytest.mark.slow
def test_a_pitch_gyro_turned_round_does_no_harm_on_a_level_road(tmp_path, seed):
    """Where it hardly turns, its errors are those of a bare chip, and the sigmas say so."""
    truth = drive(seed, 200.0, 10.0)
    data = record(truth, GRADES["industrial"], seed)
    turned = replace(data, gyro=data.gyro * [1.0, -1.0, 1.0])
    answer, _, _ = process(write(tmp_path / "log.mcap", turned), truth, [])
    assert answer is not None
    late = answer.seconds > 40.0
    assert np.all(np.sqrt(np.mean(np.square(answer.error / answer.sigma)[late], axis=0)) < 2.5)


@pytest.mark.slow
def test_rejected_fixes_are_reported_once(tmp_path):
    """Where most fixes are rejected, one finding says so."""
    log = simulated(
        tmp_path / "log.mcap", "drive", "--duration", "120", "--still", "20", "--grade", "mems",
        "--rate", "50", "--seed", "3", "--baro-rate", "0",
    )  # fmt: skip
    wrong = {"align": "fixed", "initial_attitude": (0.0, 0.0, 220.0)}
    result, _ = run(log, navigation={"imu_grade": "navigation"}, align=wrong)
    kinds = [f["kind"] for f in result["findings"]]
    assert kinds.count("fixes-disbelieved") == 1 and "rejected-fixes" not in kinds


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "rad_s"), [(1, 0.25), (4, 0.1)])
def test_an_engine_that_shakes_the_gyros_is_no_noise_of_velocities(tmp_path, seed, rad_s):
    """Times an arm of 2 m it was: status 3, as `velocities-do-not-fit`, without any fault."""
    arm = np.array([1.5, 0.3, -1.5])
    noise = {"gnss_rate": 5.0, "sigma": 0.02, "sigma_v": 0.03, "lever": arm}
    data = record(drive(seed, 160.0), GRADES["tactical"], seed, **noise)
    log = write(tmp_path / "log.mcap", shaken(data, seed, 0.5, rad_s))
    given = {"gnss_latency": 0.0, "lever_arm": tuple(arm.tolist())}
    result, _ = run(log, input={"gyro_kind": "mean-rate"}, gnss=given)
    assert not [f["kind"] for f in result["findings"] if f["severity"] == "lost"]
    assert result["filter"]["epochs_gated"] == 0
