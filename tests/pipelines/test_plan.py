"""What `info` says is what `process` does and what `align` starts from, on every kind of log."""

import json
from dataclasses import replace

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.core.errors import SinstoolError
from sinstool.core.finding import Severity
from sinstool.pipelines.align.log import align_log
from sinstool.pipelines.info.run import inspect
from sinstool.pipelines.process.run import plan_of, process
from tests.helpers.filter_logs import simulated
from tests.helpers.imulogs import REAL, even_times, imu_log, resting
from tests.helpers.logs import real
from tests.helpers.unseen_drives import GRADES, PERFECT, boat, drive, record, write
from tests.survey.test_velocity import odometry

SCENARIOS = {
    "static": (["static", "--duration", "40"], ("attitude", "gyrocompass"), {}),
    "static navigation": (
        ["static", "--grade", "navigation", "--duration", "120"],
        ("attitude", "gyrocompass"),
        {},
    ),
    "static mems": (
        ["static", "--grade", "mems", "--duration", "60"],
        ("attitude", "level"),
        {},
    ),
    "standing with GNSS": (
        ["drive", "--grade", "mems", "--duration", "15", "--rate", "100"],
        ("attitude", "level"),
        {},
    ),
    "drive": (
        ["drive", "--grade", "mems", "--duration", "120", "--rate", "100"],
        ("ins-gnss", "svd"),
        {},
    ),
    "spiral-climb": (
        ["spiral-climb", "--grade", "navigation", "--duration", "120", "--rate", "100"],
        ("ins-gnss", "svd"),
        {},
    ),
    "launch": (
        ["launch", "--duration", "90", "--grade", "tactical"],
        ("ins-gnss", "svd"),
        {"gyro_kind": "increment"},
    ),
    "coning": (["coning", "--duration", "10", "--lead-in", "3"], ("attitude", "level"), {}),
}


def choices(plan):
    return {name: (choice.value, choice.reason) for name, choice in plan.choices.items()}


def agree(path, tmp_path, **options):
    """The plan that all of them name, and that the run carried out."""
    config = build(ProcessConfig, {"input": options})
    plan = plan_of(path, config)
    inspected = inspect(path, config).process
    assert inspected.possible and choices(inspected.plan) == choices(plan)
    assert choices(align_log(path, config).result.plan) == choices(plan)
    result = process(path, tmp_path / "out.mcap", config)
    assert choices(result.plan) == choices(plan)
    carried_out = "ins-gnss" if result.filter is not None else "attitude"
    assert carried_out == plan.mode.value
    if carried_out == "attitude":
        assert result.alignment.method == plan.first_attitude.value
    return plan


@pytest.mark.slow
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_one_plan_for_every_scenario(tmp_path, scenario):
    arguments, expected, options = SCENARIOS[scenario]
    log = simulated(tmp_path / "log.mcap", *arguments)
    plan = agree(log, tmp_path, **options)
    assert (plan.mode.value, plan.first_attitude.value) == expected
    for name, choice in plan.choices.items():
        assert choice.reason and choice.option.startswith("--"), name


@pytest.mark.slow
def test_one_plan_for_fixes_beside_wheel_odometry(tmp_path):
    truth = drive(31, 120.0, rest=20.0)
    log = write(tmp_path / "log.mcap", record(truth, PERFECT, 1, sigma=0.5), odometry(truth))
    plan = agree(log, tmp_path, gyro_kind="mean-rate")
    assert (plan.mode.value, plan.first_attitude.value) == ("ins-gnss", "svd")
    config = build(ProcessConfig, {"input": {"gyro_kind": "mean-rate"}})
    # and `align` finds the heading that the plan promises
    assert align_log(log, config).result.status in ("ok", "degraded")
    # nor is it called a velocity left out, as it is wheels
    assert plan.wheels.value == "/wheels/odometry"
    assert "velocity-left-out" not in {f.kind for f in inspect(log, config).findings}
    without = build(ProcessConfig, {"input": {"gyro_kind": "mean-rate", "gnss_topic": "none"}})
    mode = plan_of(log, without).mode
    assert (mode.value, mode.reason) == ("attitude", "as --gnss-topic is none")


@pytest.mark.slow
@pytest.mark.parametrize("path", REAL)
def test_one_plan_for_every_real_log(tmp_path, path):
    agree(real(path), tmp_path, **({"body_axes": "frd"} if path.startswith("px4") else {}))


def test_what_is_refused_is_refused_alike(tmp_path):
    log = simulated(tmp_path / "log.mcap", "static", "--duration", "5")
    config = build(ProcessConfig, {"input": {"imu_topic": "/nothing"}})
    with pytest.raises(SinstoolError) as refused:
        plan_of(log, config)
    verdict = inspect(log, config).process
    assert not verdict.possible and verdict.plan is None
    assert verdict.why in str(refused.value)


def test_the_command_line_prints_the_plan(sinstool, tmp_path):
    log = simulated(tmp_path / "log.mcap", "static", "--duration", "30")
    status, out, _ = sinstool("process", log, "--print-plan", "--json")
    printed = json.loads(out)
    assert status == 0 and printed["schema"] == "sinstool.plan/1"
    assert printed["first_attitude"]["option"] == "--align"
    _, out, _ = sinstool("info", log, "--json")
    report = json.loads(out)["process"]["plan"]
    assert report == {name: printed[name] for name in report}
    _, text, _ = sinstool("process", log, "--print-plan")
    assert all(choice["reason"] in text for choice in report.values())
    assert not list(tmp_path.glob("*.part")) and len(list(tmp_path.iterdir())) == 1


def test_a_finding_about_a_log_does_not_repeat_its_name(tmp_path):
    """Of many logs it is then one and the same finding."""
    log = simulated(tmp_path / "log.mcap", *SCENARIOS["standing with GNSS"][0])
    (finding,) = [f for f in plan_of(log, ProcessConfig()).findings if f.kind == "no-ins-gnss"]
    assert str(log) not in finding.text and "log.mcap" not in finding.text
    assert "--align" in finding.answer and "--align" not in finding.text


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3])
def test_fixes_that_contradict_the_imu_deny_its_attitude_too(tmp_path, seed):
    """Axes of a left-handed frame; with right ones, the motion of some boats shows too little."""
    data = record(boat(seed, 120.0), GRADES["industrial"], seed)
    swapped = replace(data, gyro=data.gyro[:, [1, 0, 2]], accel=data.accel[:, [1, 0, 2]])
    for name, log, denied in (("right", data, False), ("swapped", swapped, True)):
        plan = plan_of(write(tmp_path / f"{name}.mcap", log), ProcessConfig())
        severities = [f.severity for f in plan.findings if f.kind == "no-ins-gnss"]
        assert (severities == [Severity.LOST]) == denied


@pytest.mark.parametrize(
    ("stated", "denied"),
    [("navigation", True), ("tactical", True), ("mems", False), ("auto", False)],
)
def test_a_grade_that_noise_at_rest_denies_is_said_without_a_filter(tmp_path, stated, denied):
    log = imu_log(tmp_path / "log.mcap", even_times(3000, 100.0), *resting(3000, seed=2))
    plan = plan_of(log, build(ProcessConfig, {"navigation": {"imu_grade": stated}}))
    said = [f for f in plan.findings if f.kind == "imu-options"]
    assert bool(said) == denied
    assert not denied or (stated in said[0].text and "--imu-grade" in said[0].answer)


@pytest.mark.parametrize(("share", "denied"), [(0.1, True), (0.6, False), (1.0, False)])
def test_a_noise_file_that_noise_at_rest_denies_is_said_too(tmp_path, share, denied):
    """The file of another IMU, six times as quiet, made tilts of 3 sigmas without a word."""
    log = imu_log(tmp_path / "log.mcap", even_times(3000, 100.0), *resting(3000, seed=2))
    walk = share * 2e-3 / np.sqrt(100.0)
    axes = "".join(
        f"[{sensor}.{axis}]\n{key} = {value}\n"
        for sensor, key, value in (
            ("gyro", "angle_random_walk_rad_per_sqrt_s", walk),
            ("accel", "velocity_random_walk_m_per_s_per_sqrt_s", 2e-3),
        )
        for axis in "xyz"
    )
    noise = tmp_path / "noise.toml"
    source = '[source]\nlog = "a.mcap"\ntopic = "/imu"\nrate_hz = 100.0\nrest_s = 100.0\n'
    source += "longest_rest_s = 100.0\n"
    noise.write_text(f'schema = "sinstool.imu-noise/1"\n{source}{axes}')
    plan = plan_of(log, build(ProcessConfig, {"navigation": {"imu_noise": str(noise)}}))
    said = [f for f in plan.findings if f.kind == "imu-options"]
    assert bool(said) == denied
    assert not denied or ("noise.toml" in said[0].text and "--imu-noise" in said[0].answer)


def test_a_span_without_fixes_withholds_nothing(tmp_path):
    """An outage that a typing error puts outside the log must not pass for one that was tested."""
    log = simulated(tmp_path / "log.mcap", *SCENARIOS["drive"][0])
    config = build(ProcessConfig, {"filter": {"withhold_gnss": ["80:90", "500:600"]}})
    found = [f for f in plan_of(log, config).findings if f.kind == "nothing-withheld"]
    assert [f.text.split(",")[0] for f in found] == ["--withhold-gnss 500:600 withholds nothing"]


@pytest.mark.parametrize(("size", "expected"), [(14.0, "smoothed"), (25.0, "inertial")])
def test_what_may_circle_is_smoothed(tmp_path, size, expected):
    """A glider at 45 degrees of bank feels 14 m/s^2."""
    random = np.random.default_rng(3)
    gyro = 0.05 * random.standard_normal((1500, 3))
    accel = np.array([0.0, 0.0, size]) + random.standard_normal((1500, 3))
    log = imu_log(tmp_path / "log.mcap", even_times(1500, 100.0), gyro, accel)
    assert plan_of(log, ProcessConfig()).attitude.value == expected


@pytest.mark.parametrize(("strides_m_s2", "expected"), [(3.0, "inertial"), (40.0, "smoothed")])
@pytest.mark.parametrize("seed", range(3))
def test_what_swings_may_feel_more_than_gravity(tmp_path, seed, strides_m_s2, expected):
    """A running foot does all the time, in its own axes, and not evenly."""
    random = np.random.default_rng(seed)
    gyro = 0.05 * random.standard_normal((1500, 3))
    stride = np.sin(2.0 * np.pi * random.uniform(1.2, 3.0) * 0.01 * np.arange(1500))
    accel = np.outer(strides_m_s2 * stride, [1.0, 0.0, 0.0]) + np.array([0.0, 0.0, 27.0])
    accel += random.standard_normal((1500, 3))
    log = imu_log(tmp_path / "log.mcap", even_times(1500, 100.0), gyro, accel)
    assert plan_of(log, ProcessConfig()).attitude.value == expected
