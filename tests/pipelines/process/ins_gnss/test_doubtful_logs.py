"""Logs whose velocity, receiver or gyro is not what it seems: navigated all the same, and said."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.core.finding import exit_status
from sinstool.core.rotation import to_dcm
from sinstool.pipelines.process.run import process
from tests.helpers.filter_logs import Capture
from tests.helpers.imulogs import T0
from tests.helpers.unseen_drives import (
    DEG,
    LEVER,
    RATE,
    drive,
    moved,
    record,
    sensor_errors,
    write,
)
from tests.survey.test_velocity import odometry, radians_as_degrees

CHEAP = sensor_errors(0.3, 30.0, 0.1, 1000.0, 3000.0, 1.0)


def navigated(log, truth, out, **groups):
    """Result, and errors of the solution: seconds, horizontal (m), heading (deg), over sigma."""
    groups.setdefault("input", {})["gyro_kind"] = "mean-rate"
    groups["gnss"] = {"lever_arm": tuple(LEVER.tolist()), **groups.get("gnss", {})}
    groups["output"] = {"only_results": True}
    capture = Capture()
    result = process(log, out, build(ProcessConfig, groups), None, capture)
    solution = capture.solution
    seconds = (solution.time_ns - T0) * 1e-9
    even = np.abs(seconds * RATE - np.round(seconds * RATE)) < 1e-3
    rows = np.flatnonzero(even)[::20]
    s = solution.rows(rows)
    off = truth.errors_of(seconds[rows], *s.position.T, s.velocity_n, to_dcm(s.q_nb))
    return result, seconds[rows], np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 8]) / DEG


def kinds(result):
    return {finding.kind for finding in result.findings}


@pytest.fixture(scope="module")
def town():
    return drive(31, 200.0, rest=30.0)


def by_odometry(data):
    return data, odometry(data.truth)


def by_course(data):
    f = record(data.truth, CHEAP, 1, gnss_rate=5.0, sigma=0.8, sigma_v=0.1).fixes
    return replace(data, fixes=replace(f, velocity_n=radians_as_degrees(f.velocity_n))), ()


def by_fixes_alone(data):
    return data, ()


@pytest.mark.parametrize("spoil", [by_odometry, by_course, by_fixes_alone])
@pytest.mark.slow
def test_fixes_are_navigated_whatever_velocity_is_beside_them(tmp_path, town, spoil):
    data, more = spoil(record(town, CHEAP, 1, gnss_rate=5.0, sigma=0.8))
    log = write(tmp_path / "log.mcap", data, more)
    result, _, off, heading = navigated(log, town, tmp_path / "out.mcap")
    assert result.plan.mode.value == "ins-gnss" and exit_status(result.findings) == 0
    assert ("velocity-left-out" in kinds(result)) == (spoil is by_course)
    assert (result.plan.wheels.value != "none") == (spoil is by_odometry)
    assert np.sqrt(np.mean(off**2)) < 1.0 and off.max() < 5.0
    assert np.sqrt(np.mean(heading**2)) < 3.0


def knocked(data, at):
    """A knock of less than a second, which ends the still beginning."""
    k = (data.seconds > at) & (data.seconds < at + 0.8)
    wave = np.sin(2.0 * np.pi * (data.seconds[k] - at) / 0.4)[:, None] / RATE
    gyro, accel = data.gyro.copy(), data.accel.copy()
    gyro[k] += 0.05 * wave
    accel[k] += 1.5 * wave
    return replace(data, gyro=gyro, accel=accel)


@pytest.mark.parametrize("sigma_v", [0.1, None])
@pytest.mark.slow
def test_a_receiver_that_wanders_at_first_moves_no_parked_car(tmp_path, sigma_v):
    truth = drive(32, 240.0, rest=120.0)
    data = knocked(record(truth, CHEAP, 32, gnss_rate=5.0, sigma=0.8, sigma_v=sigma_v), 12.0)
    f = data.fixes
    away = np.maximum(25.0 - f.seconds, 0.0)[:, None] * [2.0, 0.6, 0.0]
    place = moved(f.latitude, f.longitude, f.height, away)
    velocity = f.velocity_n - (f.seconds < 25.0)[:, None] * [2.0, 0.6, 0.0]
    latitude, longitude, height = place
    fixes = replace(f, latitude=latitude, longitude=longitude, height=height, velocity_n=velocity)
    log = write(tmp_path / "log.mcap", replace(data, fixes=fixes))
    result, seconds, off, heading = navigated(log, truth, tmp_path / "out.mcap")
    assert {"unsettled-fixes"} <= kinds(result)
    assert not kinds(result) & {"moving-rest", "not-trusted", "initial-heading"}
    assert off[seconds > 26.0].max() < 6.0
    assert np.sqrt(np.mean(heading[seconds > 26.0] ** 2)) < 3.0


@pytest.mark.slow
def test_a_rest_before_the_first_fix_is_not_said_to_be_motion(tmp_path):
    """That the car drives when its receiver begins shows nothing for sure of what was before."""
    truth = drive(33, 160.0, rest=30.0)
    data = record(truth, CHEAP, 33, gnss_rate=5.0, sigma=0.8, sigma_v=0.1)
    data = replace(data, fixes=data.fixes.rows(data.fixes.seconds > 40.0))
    log = write(tmp_path / "log.mcap", data)
    result, _, off, _ = navigated(log, truth, tmp_path / "out.mcap")
    (said,) = [finding for finding in result.findings if finding.kind == "moving-rest"]
    assert "may be steady motion" in said.text
    assert off[-1] < 3.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [51, 53])
def test_a_parked_car_whose_gyro_warms_up_shows_no_other_heading(tmp_path, seed):
    truth = drive(seed, 260.0, rest=200.0)
    data = record(truth, CHEAP, seed, gnss_rate=5.0, sigma=0.8, sigma_v=0.03)
    warm = np.random.default_rng(seed).standard_normal(3) * 150.0 * DEG / 3600.0
    gyro = data.gyro + warm * np.exp(-data.seconds[:, None] / 60.0) / RATE
    log = write(tmp_path / "log.mcap", replace(data, gyro=gyro))
    result, _, _, heading = navigated(log, truth, tmp_path / "out.mcap")
    assert "initial-heading" not in kinds(result)
    assert np.sqrt(np.mean(heading**2)) < 5.0


@pytest.fixture(scope="module")
def begun_in_motion():
    """A gyro that nobody calibrated, 4.4 deg/s, in a car that moves when the log begins."""
    out = {}
    for seed in (41, 42):
        truth = drive(seed, 120.0, rest=0.0)
        data = record(truth, CHEAP, seed, gnss_rate=5.0, sigma=0.8, sigma_v=0.1)
        bias = np.random.default_rng(seed).standard_normal(3)
        gyro = data.gyro + bias * (4.4 * DEG / np.linalg.norm(bias)) / RATE
        late = data.seconds >= 15.0
        fixes = data.fixes.rows(data.fixes.seconds >= 15.0)
        cut = replace(
            data, seconds=data.seconds[late], gyro=gyro[late], accel=data.accel[late], fixes=fixes
        )
        attitude = Rotation.from_matrix(truth.c_nb[np.argmax(late)])
        angles = attitude.as_euler("ZYX", degrees=True)[::-1]
        out[seed] = truth, cut, tuple(angles.tolist())
    return out


@pytest.mark.parametrize("given", [False, True])
@pytest.mark.parametrize("velocity", [False, True])
@pytest.mark.parametrize("seed", [41, 42])
@pytest.mark.slow
def test_the_bias_of_a_moving_car_is_found(tmp_path, begun_in_motion, seed, velocity, given):
    truth, data, angles = begun_in_motion[seed]
    if not velocity:
        nothing = np.full_like(data.fixes.velocity_n, np.nan)
        data = replace(data, fixes=replace(data.fixes, velocity_n=nothing))
    log = write(tmp_path / "log.mcap", data)
    align = {"align": "fixed", "initial_attitude": angles} if given else {}
    result, _, off, heading = navigated(log, truth, tmp_path / "out.mcap", align=align)
    assert result.plan.mode.value == "ins-gnss" and exit_status(result.findings) == 0
    assert np.sqrt(np.mean(off**2)) < 1.0
    assert np.sqrt(np.mean(heading**2)) < 5.0


@pytest.mark.slow
@pytest.mark.parametrize("begin", [0.1, 0.9])
def test_one_fix_a_second_is_enough_for_a_start_with_a_given_attitude(tmp_path, begin):
    """Of positions alone the first three seconds have no velocity with fixes on both sides."""
    truth = drive(43, 120.0, rest=0.0)
    data = record(truth, CHEAP, 43, gnss_rate=1.0, sigma=0.3)
    first = 14.0 + begin
    late = data.seconds >= first
    samples = {name: getattr(data, name)[late] for name in ("seconds", "gyro", "accel")}
    data = replace(data, fixes=data.fixes.rows(data.fixes.seconds >= first), **samples)
    log = write(tmp_path / "log.mcap", data)
    attitude = Rotation.from_matrix(truth.c_nb[np.argmax(late)])
    angles = attitude.as_euler("ZYX", degrees=True)[::-1]
    align = {"align": "fixed", "initial_attitude": tuple(angles.tolist())}
    result, _, off, heading = navigated(log, truth, tmp_path / "out.mcap", align=align)
    assert result.plan.mode.value == "ins-gnss" and exit_status(result.findings) == 0
    assert np.sqrt(np.mean(off**2)) < 1.5 and np.sqrt(np.mean(heading**2)) < 5.0


@pytest.mark.slow
def test_motion_shows_the_bias_of_a_car_that_never_rests(tmp_path, begun_in_motion):
    truth, data, angles = begun_in_motion[41]
    early = data.seconds < 55.0
    fixes = data.fixes.rows(data.fixes.seconds < 55.0)
    data = replace(
        data, seconds=data.seconds[early], gyro=data.gyro[early], accel=data.accel[early],
        fixes=fixes,
    )  # fmt: skip
    # shaken, so that no stretch of it passes for a rest
    shaken = 0.3 * np.random.default_rng(3).standard_normal(data.accel.shape)
    log = write(tmp_path / "log.mcap", replace(data, accel=data.accel + shaken / RATE))
    align = {"align": "fixed", "initial_attitude": angles}
    result, _, off, _ = navigated(log, truth, tmp_path / "out.mcap", align=align)
    assert "gyro bias from motion" in result.plan.first_attitude.reason
    assert not any("no gyro bias" in finding.text for finding in result.findings)
    assert np.sqrt(np.mean(off**2)) < 1.5


@pytest.mark.slow
def test_stamps_that_jitter_break_no_alignment(tmp_path, town):
    data = record(town, CHEAP, 7, gnss_rate=5.0, sigma=0.8, sigma_v=0.1)
    random = np.random.default_rng(7)
    ticks = np.cumsum(random.choice([1, 2, 4], len(data.seconds), p=[0.25, 0.65, 0.1]))
    ticks = ticks[ticks < len(data.seconds)]
    steps = np.diff(ticks, prepend=0)[:, None]
    means = [
        np.diff(np.cumsum(values, axis=0)[ticks], axis=0, prepend=0.0) / steps
        for values in (data.gyro, data.accel)
    ]
    uneven = replace(data, seconds=data.seconds[ticks], gyro=means[0], accel=means[1])
    log = write(tmp_path / "log.mcap", uneven)
    result, _, off, heading = navigated(log, town, tmp_path / "out.mcap")
    assert result.plan.mode.value == "ins-gnss" and exit_status(result.findings) == 0
    assert len(result.findings) < 6 and not any("gap" in f.text for f in result.findings)
    assert np.sqrt(np.mean(off**2)) < 1.0 and np.sqrt(np.mean(heading**2)) < 3.0


@pytest.mark.parametrize("north", [True, False])
def test_inertial_navigation_starts_at_the_imu_and_not_at_the_antenna(tmp_path, north):
    standing = drive(5, 12.0, rest=12.0)
    arm = np.array([1.6, -0.9, -2.0])
    data = record(standing, CHEAP, 5, gnss_rate=5.0, sigma=0.01, lever=arm)
    log = write(tmp_path / "log.mcap", data)
    angles = Rotation.from_matrix(standing.c_nb[0]).as_euler("ZYX", degrees=True)[::-1]
    fixed = {"align": "fixed", "initial_attitude": tuple(angles.tolist())}
    settings = {
        "input": {"gyro_kind": "mean-rate"},
        "navigation": {"mode": "ins"},
        "align": fixed if north else {"align": "level"},
        "gnss": {"lever_arm": tuple(arm.tolist())},
    }
    capture = Capture()
    process(log, tmp_path / "out.mcap", build(ProcessConfig, settings), None, capture)
    first = capture.solution.rows(slice(0, 1))
    off = standing.errors_of(standing.seconds[:1], *first.position.T, first.velocity_n,
                             to_dcm(first.q_nb))[0]  # fmt: skip
    # without a heading only the height of the antenna is known to be another
    assert abs(off[2]) < 0.1
    assert (np.hypot(off[0], off[1]) < 0.1) == north
