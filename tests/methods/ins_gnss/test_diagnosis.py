"""Each wrong thing is named; nothing is, where all is well."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.core.finding import exit_status
from sinstool.core.rotation import exp, from_dcm, multiply, normalise
from sinstool.core.streams import GnssEpochs, concatenate
from sinstool.methods.coning.registry import algorithm
from sinstool.methods.coning.stage import ConingStage
from sinstool.methods.ins_gnss.diagnosis import diagnose, intervals_of
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.fix_velocity import split_position_velocity
from sinstool.methods.ins_gnss.receiver_offsets import estimate_offsets, settle
from sinstool.methods.ins_gnss.settings import DivergenceControl, GnssModel, Settings
from sinstool.methods.sensor_errors import SIMULATED_GRADES, SensorGrade
from sinstool.methods.strapdown.velocity import IncrementStage
from sinstool.simulation.drive import road_drive
from sinstool.simulation.flight import manoeuvring_flight
from sinstool.simulation.gnss import GnssErrors, GnssFaults, Jump, Receiver, gnss_samples
from sinstool.simulation.sensors import with_errors
from tests.helpers.filter_start import start
from tests.helpers.gnss import epochs
from tests.helpers.unseen_drives import PERFECT, motion_of, record, running_integral, smoothed

DEGREE = np.pi / 180.0
RATE = 50.0
GRADE = SIMULATED_GRADES["tactical"]
IMU = SensorGrade(
    angle_random_walk=GRADE.angle_random_walk,
    velocity_random_walk=GRADE.velocity_random_walk,
    gyro_bias=GRADE.gyro_bias,
    accel_bias=GRADE.accel_bias,
)
ERRORS = GnssErrors((1.0, 1.0, 1.5), (0.0,) * 3, 100.0, (0.05, 0.05, 0.08))
MODEL = GnssModel((1.0, 1.0, 1.5), (0.05,) * 3, 100.0, (0.05, 0.05, 0.08), (5e-3,) * 3, 100.0)
# As `process` runs the first minutes again where a filter had to begin anew
SETTINGS = Settings(
    filter="markov-21",
    imu=IMU,
    gnss=MODEL,
    grade="tactical",
    control=DivergenceControl(escalate=False),
)
ATTITUDE = np.array([0.2, 0.2, 1.0]) * DEGREE


@cache
def truth(kind, seed):
    if kind == "flight":
        return manoeuvring_flight(200.0, RATE, latitude=-0.7, longitude=2.0, heading=2.5, seed=seed)
    return road_drive(240.0, RATE, heading=-2.0, still_s=10.0, seed=seed)


def increments(imu, gyro, accel):
    stage = IncrementStage(
        lambda: ConingStage(
            algorithm("previous-1"), "mean-rate", nominal_interval=float(imu.interval[1])
        )
    )
    parts = [stage.push(gyro, accel, imu.time_ns), stage.finish()]
    return concatenate(parts)


def start_at(path, velocity_n, q_nb):
    """A start at the beginning of a path, with this velocity and attitude."""
    place = (float(row[0]) for row in (path.latitude, path.longitude, path.height))
    return start(*place, velocity_n, q_nb, 2.0, 0.1, ATTITUDE)


def examined(
    kind="flight",
    seed=1,
    settings=SETTINGS,
    errors=ERRORS,
    grade=GRADE,
    gyro_axes=None,
    accel_axes=None,
    wrong_start=(0.0, 0.0, 0.0),
    lag=0.0,
    **receiver,
):
    """What is said of a run with these sensors, settings and start."""
    path = truth(kind, seed)
    imu = with_errors(path.imu, grade, seed)
    gyro, accel = imu.gyro_mean_rate, imu.mean_specific_force
    if gyro_axes is not None:
        gyro = gyro @ np.asarray(gyro_axes, dtype=float).T
    if accel_axes is not None:
        accel = accel @ np.asarray(accel_axes, dtype=float).T
    receiver = {"rate_hz": 4.0, "offset_s": 0.13, **receiver}
    gnss = epochs(gnss_samples(path, Receiver(errors=errors, **receiver), seed))
    if lag:
        both = split_position_velocity(gnss, -lag)
        both = replace(both, time_ns=both.time_ns + round(0.5e9 * lag))
        place, speed = both.rows(both.has_position), both.rows(both.has_velocity)
        # velocities as the receiver stamps them, in one row with the positions of that stamp
        velocity = np.column_stack(
            [np.interp(place.time_ns, speed.time_ns, speed.velocity_n[:, i]) for i in range(3)]
        )
        gnss = replace(place, velocity_n=velocity)
    random = np.random.default_rng(seed)
    psi = ATTITUDE * random.standard_normal(3) + np.asarray(wrong_start) * DEGREE
    velocity_n = path.velocity_n[0] + 0.05 * random.standard_normal(3)
    began = start_at(path, velocity_n, normalise(multiply(exp(-psi), path.imu.q_nb[0])))
    run = InsGnssFilter(began, settings, with_baro=False)
    steps = increments(imu, gyro, accel)
    block = run.push(steps, gnss)
    restarts = run.summary.restarts

    offsets = offsets_shown(began, settings, steps, gnss)
    return diagnose(began, block.updates, block.gnss, gnss, settings, restarts, offsets)


def offsets_shown(began, settings, steps, gnss):
    """Latency and lever arm, as `process` finds them."""

    def shown(latency, arm_b, gated):
        gate = settings.control.gate_probability if gated else 1.0
        control = replace(settings.control, gate_probability=gate)
        about = replace(settings, gnss_latency=latency, control=control)
        if arm_b is not None:
            about = replace(about, lever_arm_b=tuple(arm_b.tolist()))
        return estimate_offsets(began, about, [steps], gnss, settings.lever_arm_b)

    return settle(shown, settings.gnss_latency)[1]


def causes(findings):
    return [f.kind for f in findings]


def summary(findings):
    return "\n".join(str(f) for f in findings)


SWAPPED = [[0, 1, 0], [1, 0, 0], [0, 0, 1]]
FLIPPED = [[1, 0, 0], [0, 1, 0], [0, 0, -1]]
TURNED = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]  # a rotation, by 90 deg about z
TIPPED = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]  # FLU taken for FRD


@pytest.mark.parametrize("kind", ["flight", "drive"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_of_sound_data_nothing_is_said(kind, seed):
    result = examined(kind, seed)
    assert result == (), summary(result)


def test_nor_of_outages_coarse_sensors_and_coloured_fixes():
    errors = GnssErrors((1.0, 1.0, 1.5), (2.0, 2.0, 3.0), 60.0, (0.05, 0.05, 0.08), (0.05,) * 3)
    model = GnssModel(
        (1.0, 1.0, 1.5), (2.0, 2.0, 3.0), 60.0, (0.05, 0.05, 0.08), (0.05,) * 3, 100.0
    )
    coarse = SIMULATED_GRADES["mems"]
    imu = SensorGrade(
        angle_random_walk=coarse.angle_random_walk,
        velocity_random_walk=coarse.velocity_random_walk,
        gyro_bias=coarse.gyro_bias,
        accel_bias=coarse.accel_bias,
    )
    settings = replace(SETTINGS, gnss=model, imu=imu, grade="mems")
    result = examined("drive", 2, settings, errors, coarse)
    assert result == (), summary(result)


@pytest.mark.parametrize("latency", [0.06, 0.15])
@pytest.mark.parametrize("kind", ["flight", "drive"])
def test_a_latency(kind, latency):
    result = examined(kind, latency_s=latency)
    assert causes(result)[0] == "latency", summary(result)
    assert result[0].numbers["latency_s"] == pytest.approx(latency, abs=0.01)
    chosen = replace(SETTINGS, gnss_latency=latency)
    assert examined(kind, settings=chosen, latency_s=latency) == ()


def test_an_imu_that_is_late():
    chosen = replace(SETTINGS, gnss_latency=0.1)
    result = examined(settings=chosen)
    assert causes(result)[0] == "latency"
    assert result[0].numbers["latency_s"] == pytest.approx(0.0, abs=0.015)


def test_velocities_that_lag_behind_positions():
    quiet = GnssErrors((0.05,) * 3, (0.0,) * 3, 100.0, (0.03,) * 3)
    model = replace(MODEL, position_white=(0.05,) * 3, velocity_white=(0.03,) * 3)
    settings = replace(SETTINGS, gnss=model)
    result = examined("drive", settings=settings, errors=quiet, lag=0.12)
    assert "velocity-lag" in causes(result), summary(result)
    size = next(f.numbers["velocity_lag_s"] for f in result if f.kind == "velocity-lag")
    assert size == pytest.approx(0.12, abs=0.015)
    answer = next(f.answer for f in result if f.kind == "velocity-lag")
    assert answer.startswith("give --gnss-velocity-lag 0.1")
    assert examined("drive", settings=settings, errors=quiet) == ()


@pytest.mark.parametrize("kind", ["flight", "drive"])
def test_a_lever_arm(kind):
    result = examined(kind, lever_arm_b=(2.5, -1.5, -1.0))
    assert causes(result)[0] == "lever-arm", summary(result)
    arm = [result[0].numbers[name] for name in ("forward_m", "right_m", "down_m")]
    assert np.linalg.norm(arm) == pytest.approx(np.linalg.norm([2.5, -1.5, -1.0]), rel=0.4)
    chosen = replace(SETTINGS, lever_arm_b=(2.5, -1.5, -1.0))
    assert examined(kind, settings=chosen, lever_arm_b=(2.5, -1.5, -1.0)) == ()


@pytest.mark.parametrize(
    ("position", "velocity", "where"),
    [
        (1 / 3, 1.0, {"horizontal position", "height"}),
        (3.0, 1.0, {"horizontal position", "height"}),
        (1.0, 1 / 3, {"horizontal velocity", "vertical velocity"}),
        (1.0, 3.0, {"horizontal velocity", "vertical velocity"}),
    ],
)
def test_noise_three_times_wrong(position, velocity, where):
    settings = replace(SETTINGS, gnss=MODEL.scaled(position, velocity))
    result = [f for f in examined(settings=settings) if f.kind != "divergence"]
    assert {f.kind for f in result} == {"gnss-noise"}, summary(result)
    assert {f.topic for f in result} == where
    factor = 1.0 / position if position != 1.0 else 1.0 / velocity
    assert all(0.6 < f.numbers["sigma_ratio"] / factor < 1.6 for f in result)


@pytest.mark.parametrize("kind", ["flight", "drive"])
def test_gyro_axes_that_are_not_those_of_the_accelerometer(kind):
    for axes, names in ((SWAPPED, "y, x, z"), (FLIPPED, "x, y, -z")):
        result = examined(kind, gyro_axes=axes)
        assert causes(result) == ["axes"], summary(result)
        assert f"taken as {names}:" in str(result[0])


def test_a_left_handed_imu():
    result = examined(gyro_axes=SWAPPED, accel_axes=SWAPPED)
    assert causes(result) == ["axes"], summary(result)


@pytest.mark.parametrize("kind", ["flight", "drive"])
@pytest.mark.parametrize("axes", [TIPPED, TURNED])
def test_a_wrong_mount(kind, axes):
    result = examined(kind, gyro_axes=axes, accel_axes=axes)
    expected = "initial-attitude" if axes is TIPPED else "initial-heading"
    assert causes(result) == [expected], summary(result)
    (angle,) = result[0].numbers.values()
    assert angle == pytest.approx(180.0 if axes is TIPPED else 90.0, abs=10.0)


@pytest.mark.parametrize("off", [-20.0, 60.0, 179.0])
@pytest.mark.parametrize("kind", ["flight", "drive"])
def test_a_wrong_initial_heading(kind, off):
    result = examined(kind, wrong_start=(0.0, 0.0, off))
    assert causes(result) == ["initial-heading"], summary(result)
    assert exit_status(result) == 3
    assert result[0].numbers["heading_deg"] == pytest.approx(abs(off), abs=6.0)


def test_an_imu_much_worse_than_its_noise_says():
    worse = replace(
        GRADE,
        angle_random_walk=60.0 * GRADE.angle_random_walk,
        velocity_random_walk=300.0 * GRADE.velocity_random_walk,
    )
    control = replace(SETTINGS.control, gate_probability=1.0)
    result = examined("drive", settings=replace(SETTINGS, control=control), grade=worse)
    assert "imu-noise" in causes(result), summary(result)


def test_a_fault_without_a_cause_is_still_reported():
    jumps = tuple(Jump(t, t + 10.0, (80.0, -50.0, 0.0)) for t in range(40, 190, 30))
    result = examined(faults=GnssFaults(jumps=jumps))
    assert causes(result)[-1] == "divergence"
    assert "fixes" in summary(result)


def test_noise_that_the_gate_measured_is_reported():
    noisy = GnssErrors((40.0, 40.0, 60.0), (0.0,) * 3, 100.0, (0.05, 0.05, 0.08))
    result = examined(errors=noisy)
    assert {(f.kind, f.topic) for f in result} == {
        ("gnss-noise", "horizontal position"),
        ("gnss-noise", "height"),
    }
    assert all(20.0 < f.numbers["sigma_ratio"] < 60.0 for f in result)


def test_too_little_to_judge():
    path = truth("flight", 1)
    gnss = epochs(gnss_samples(path, Receiver(0.05, errors=ERRORS), 1))
    began = start_at(path, path.velocity_n[0], path.imu.q_nb[0])
    run = InsGnssFilter(began, SETTINGS, with_baro=False)
    imu = path.imu
    block = run.push(increments(imu, imu.gyro_mean_rate, imu.mean_specific_force), gnss)
    assert diagnose(began, block.updates, block.gnss, gnss, SETTINGS) == ()


@pytest.mark.parametrize(("following", "kind"), [(0.25, "gnss-noise"), (0.55, "imu-noise")])
def test_large_innovations_that_follow_one_another_are_the_imu_s(following, kind):
    """Innovations of four sigmas, each this much like the one before it."""
    path = truth("flight", 1)
    gnss = epochs(gnss_samples(path, Receiver(4.0, 0.13, errors=ERRORS), 1))
    began = start_at(path, path.velocity_n[0], path.imu.q_nb[0])
    imu = path.imu
    run = InsGnssFilter(began, SETTINGS, with_baro=False)
    block = run.push(increments(imu, imu.gyro_mean_rate, imu.mean_specific_force), gnss)
    white = np.random.default_rng(5).standard_normal((len(block.gnss), 2))
    ratio = white.copy()
    for k in range(1, len(ratio)):
        ratio[k] = following * ratio[k - 1] + np.sqrt(1.0 - following**2) * white[k]
    innovation = block.gnss.innovation.copy()
    innovation[:, :2] = 4.0 * ratio * block.gnss.innovation_sigma[:, :2]
    changed = replace(block.gnss, innovation=innovation)
    found = diagnose(began, block.updates, changed, gnss, SETTINGS)
    assert [(f.kind, f.topic) for f in found] == [(kind, "horizontal position")]


def test_what_a_gap_hides_is_not_integrated():
    """The update after a gap stands for five usual intervals at most, not for all of the gap."""
    ends = np.array([10, 20, 30, 2030, 2040, 2050], dtype=np.int64) * 1_000_000
    updates = SimpleNamespace(time_ns=ends)
    np.testing.assert_allclose(intervals_of(updates), [0.01, 0.01, 0.01, 0.05, 0.01, 0.01])


ON_THE_SPOT, MAST = np.array([1.0, -0.5, -1.0]), np.array([-2.5, 1.5, -1.0])


def turned_on_the_spot(seed, given):
    """An excavator that turns to and fro, with its IMU before its axis and its antenna behind."""
    random = np.random.default_rng(seed)
    t = np.arange(0.0, 150.0, 0.005)
    phases = np.array([0.45, 0.0, -0.45, 0.0])[(t / 5.0).astype(int) % 4]
    rate = smoothed(np.where(t > 10.0, phases, 0.0), 2.0)
    heading = running_integral(rate, random.uniform(0.0, 6.0))
    ahead = np.stack([np.cos(heading), np.sin(heading), 0.0 * t], axis=1)
    right = np.stack([-np.sin(heading), np.cos(heading), 0.0 * t], axis=1)
    velocity = rate[:, None] * (ON_THE_SPOT[0] * right - ON_THE_SPOT[1] * ahead)
    truth = motion_of(t, velocity, np.stack([0.01 + 0.0 * t, 0.02 + 0.0 * t, heading], axis=1))
    data = record(truth, PERFECT, seed, gnss_rate=5.0, sigma=0.02, sigma_v=0.03, lever=MAST)
    fixes, n = data.fixes, len(data.fixes.seconds)
    time_ns = np.round(fixes.seconds * 1e9).astype(np.int64)
    gnss = GnssEpochs(
        time_ns,
        time_ns,
        *(fixes.latitude, fixes.longitude, fixes.height, fixes.velocity_n),
        np.full((n, 3), 0.02),
        np.full((n, 3), 0.03),
    )
    interval = np.full(len(t) - 1, 0.005)
    imu = SimpleNamespace(time_ns=np.round(t * 1e9).astype(np.int64), interval=interval)
    steps = increments(imu, data.gyro / 0.005, data.accel / 0.005)
    model = replace(MODEL, position_white=(0.02,) * 3, velocity_white=(0.03,) * 3)
    settings = replace(SETTINGS, gnss=model, lever_arm_b=tuple(given.tolist()))
    attitude = normalise(multiply(exp([0.002, -0.002, 0.05]), from_dcm(truth.c_nb[0])))
    place = (truth.latitude[0], truth.longitude[0], truth.height[0])
    began = start(*map(float, place), truth.velocity_n[0], attitude, 2.0, 0.1, 4.0 * ATTITUDE)
    run = InsGnssFilter(began, settings, with_baro=False)
    block = run.push(steps, gnss)
    offsets = offsets_shown(began, settings, steps, gnss)
    return diagnose(began, block.updates, block.gnss, gnss, settings, 0, offsets)


@pytest.mark.parametrize("seed", range(6))
def test_an_antenna_that_turns_about_the_imu_shows_no_other_heading(seed):
    """Its velocity is opposite to that of the IMU: a good heading was said to be 157 deg off."""
    result = turned_on_the_spot(seed, MAST)
    assert exit_status(result) == 0, summary(result)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_where_an_antenna_is_taken_to_be_elsewhere_that_is_said_and_not_the_heading(seed):
    result = turned_on_the_spot(seed, np.array([-1.7, 0.9, -1.0]))
    assert "lever-arm" in causes(result) and "initial-heading" not in causes(result)
