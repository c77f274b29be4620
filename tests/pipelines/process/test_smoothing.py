"""`process --mode attitude` where gravity holds it up: on logs whose motion is known."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.core.errors import DataError
from sinstool.core.rotation import tilt_and_heading
from sinstool.methods.sensor_errors import LOW_COST
from sinstool.pipelines.process.run import plan_of, process
from sinstool.survey import samples, source
from tests.helpers.filter_logs import simulated
from tests.helpers.imulogs import T0, G, even_times, imu_log, read_topic, stamp_ns
from tests.helpers.logs import real
from tests.helpers.quick import mostly_slow

RATE = 100.0
BIAS = np.array([0.012, -0.02, 0.016])


@dataclass
class Hand:
    """A hand that turns and moves a FLU sensor: its samples, and its rotations to ENU."""

    time_ns: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray
    attitude: Rotation


def hand(seconds=60.0, seed=0, rest=(5.0, 0.0), bias=BIAS):
    """Means of sums of sines, after and before a rest, by sensors with errors."""
    rng = np.random.default_rng(seed)
    count = int(seconds * RATE) + 1
    t = np.arange(-1, count) / RATE
    moving = np.clip((t - rest[0]) / 2.0, 0.0, 1.0) * np.clip(
        (seconds - rest[1] - t) / 2.0, 0.0, 1.0
    )
    moving = moving**2 * (3.0 - 2.0 * moving)
    waves = [(0.35, 0.6), (0.9, 0.3), (1.6, 0.1)]

    def sines(size):
        phases = rng.uniform(0.0, 2.0 * np.pi, (3, 3))
        shape = sum(
            a * np.sin(2.0 * np.pi * f * t[:, None] + phases[k]) for k, (f, a) in enumerate(waves)
        )
        return size * moving[:, None] * shape

    attitude = Rotation.from_euler("xyz", sines(0.8) + rng.uniform(-0.4, 0.4, 3))
    position = sines(0.1)
    turned = (attitude[:-1].inv() * attitude[1:]).as_rotvec() * RATE
    velocity = np.gradient(position, 1.0 / RATE, axis=0)
    force = np.diff(velocity, axis=0) * RATE + [0.0, 0.0, G]
    half = attitude[:-1] * Rotation.from_rotvec(0.5 * turned / RATE)
    crooked = np.eye(3) + 3e-3 * rng.standard_normal((3, 3))
    gyro = turned @ crooked.T + bias + 2e-3 * rng.standard_normal(turned.shape)
    offset = 0.03 * rng.standard_normal(3)
    accel = half.inv().apply(force) + offset + 2e-2 * rng.standard_normal(turned.shape)
    return Hand(even_times(count, RATE), gyro, accel, attitude[1:])


def run(path, out, **groups):
    return process(path, out, build(ProcessConfig, groups)).to_json()


def written(path):
    """Stamps, rotations to ENU and covariances of /sinstool/imu."""
    messages = [m for _, m in read_topic(path, "/sinstool/imu")]
    q = [(m.orientation.x, m.orientation.y, m.orientation.z, m.orientation.w) for m in messages]
    covariance = np.array([m.orientation_covariance for m in messages]).reshape(-1, 3, 3)
    return np.array([stamp_ns(m) for m in messages]), Rotation.from_quat(q), covariance


def tilt(estimate, truth):
    """Errors of tilt about east and north, rad, of estimates of free heading."""
    return tilt_and_heading((truth * estimate.inv()).as_quat(scalar_first=True))[0]


def smoothed(tmp_path, log, **groups):
    path = imu_log(tmp_path / "in.mcap", log.time_ns, log.gyro, log.accel)
    summary = run(path, tmp_path / "out.mcap", **groups)
    times, q, covariance = written(tmp_path / "out.mcap")
    at = np.searchsorted(log.time_ns, times)
    return summary, tilt(q, log.attitude[at]), covariance


@pytest.mark.parametrize("rest", [(5.0, 0.0), (0.0, 5.0), (0.0, 0.0)])
def test_tilt_of_a_hand_wherever_it_rests(tmp_path, rest):
    """A first tilt from a moving second is degrees off, and a bias of 1.6 deg/s is not known."""
    log = hand(rest=rest)
    summary, off, covariance = smoothed(tmp_path, log)
    assert summary["plan"]["attitude"]["value"] == "smoothed"
    assert summary["smoothing"]["motion"] == "hand"
    assert np.degrees(np.sqrt(np.mean(off**2))) < 0.5
    sigma = np.sqrt(np.einsum("nii->ni", covariance))[:, :2]
    # a degree per second of gyro bias may well come with a worse accelerometer than this one
    assert 0.05 < np.sqrt(np.mean((off / sigma) ** 2)) < 1.6
    assert bool(summary["smoothing"]["rest_s"]) == any(rest)
    kinds = {finding["kind"] for finding in summary["findings"]}
    assert ("no-rest" in kinds) == (not any(rest))
    found = np.array(summary["smoothing"]["gyro_bias_rad_s"]) * [1.0, -1.0, -1.0]
    limit = np.maximum(4.0 * np.array(summary["smoothing"]["gyro_bias_sigma_rad_s"]), 1e-4)
    assert (np.abs(found - BIAS) < limit).all()
    # what is said of the sigmas is what stands in the output
    said = np.degrees(np.sqrt(np.einsum("nii->ni", covariance)))
    tilts, smoothing = said[:, :2].max(axis=1), summary["smoothing"]
    assert smoothing["heading_sigma_end_deg"] == pytest.approx(said[-1, 2], rel=0.02)
    assert smoothing["tilt_sigma_deg"] == pytest.approx(np.median(tilts), rel=0.02)
    assert smoothing["tilt_sigma_largest_deg"] == pytest.approx(tilts.max(), rel=0.02)


def test_an_inertial_attitude_is_worse_and_claims_no_sigma(tmp_path):
    _, off, covariance = smoothed(tmp_path, hand(), navigation={"attitude": "inertial"})
    assert not covariance.any()
    _, better, _ = smoothed(tmp_path, hand(), output={"overwrite": True})
    assert np.sqrt(np.mean(better**2)) < np.sqrt(np.mean(off**2))


def test_samples_that_are_read_twice_give_the_same(tmp_path, monkeypatch):
    log = hand(20.0)
    path = imu_log(tmp_path / "in.mcap", log.time_ns, log.gyro, log.accel)
    run(path, tmp_path / "a.mcap")
    monkeypatch.setattr(samples, "CACHED_SAMPLES", 100)
    monkeypatch.setattr(source, "BLOCK_ROWS", 777)
    run(path, tmp_path / "b.mcap")
    for one, other in zip(written(tmp_path / "a.mcap"), written(tmp_path / "b.mcap"), strict=True):
        if isinstance(one, Rotation):
            one, other = one.as_quat(), other.as_quat()
        np.testing.assert_array_equal(one, other)


def test_after_a_gap_tilt_is_found_again_and_heading_is_not(tmp_path):
    log = hand(60.0, seed=3)
    kept = np.ones(len(log.time_ns), bool)
    kept[3000:3300] = False
    part = Hand(log.time_ns[kept], log.gyro[kept], log.accel[kept], log.attitude[kept])
    summary, off, covariance = smoothed(tmp_path, part)
    sigma = np.sqrt(np.einsum("nii->ni", covariance))
    assert np.degrees(np.abs(off[3500:]).max()) < 2.0
    assert (np.abs(off) < 4.0 * sigma[:, :2]).all()
    assert sigma[2990, 2] < np.radians(10.0) and sigma[3010, 2] > np.radians(60.0)
    assert any("heading is held constant across gaps" in text for text in summary["warnings"])
    assert any("nothing is integrated across it" in text for text in summary["warnings"])


def test_after_a_gap_of_hours_tilt_is_found_again(tmp_path):
    """An angle that may be any was thousands of radians, in which the filter lost its digits."""
    log = hand(60.0, seed=3)
    log.time_ns[3000:] += 7200 * 10**9
    summary, off, covariance = smoothed(tmp_path, log)
    sigma = np.sqrt(np.einsum("nii->ni", covariance))
    assert np.degrees(np.abs(off).max()) < 2.0
    assert (np.abs(off) < 4.0 * sigma[:, :2]).all()
    assert np.degrees(np.median(sigma[:, :2])) < 2.0
    assert summary["smoothing"]["motion"] == "hand"


@pytest.mark.parametrize("long", [False, True])
def test_which_gaps_are_integrated_across_is_said(tmp_path, long):
    """Of 40 ms and less all are; "nothing is integrated across them" was said of all."""
    log = hand(60.0, seed=3)
    kept = np.ones(len(log.time_ns), bool)
    for row in (2000, 2500, 4000):
        kept[row : row + 3] = False
    if long:
        kept[3000:3300] = False
    part = Hand(log.time_ns[kept], log.gyro[kept], log.accel[kept], log.attitude[kept])
    summary, _, _ = smoothed(tmp_path, part)
    (text,) = (t for t in summary["warnings"] if "gaps longer than" in t)
    if long:
        assert text.startswith("4 gaps") and "across those longer than 80 ms" in text
    else:
        assert text.startswith("3 gaps") and "short enough to be integrated across" in text


def test_a_saturated_gyro_widens_sigmas(tmp_path):
    log = hand(60.0, seed=1)
    log.gyro = np.clip(log.gyro, -1.6, 1.6)
    summary, off, covariance = smoothed(tmp_path, log)
    (finding,) = (f for f in summary["findings"] if f["kind"] == "gyro-at-stop")
    assert finding["severity"] == "lost"
    assert finding["numbers"]["gyro_at_stop_s"] > 2.0
    sigma = np.sqrt(np.einsum("nii->ni", covariance))[:, :2]
    assert np.sqrt(np.mean((off / sigma) ** 2)) < 2.0


@pytest.mark.parametrize("seed", mostly_slow(range(1, 6), 1))
def test_a_stop_is_found_behind_a_calibration(tmp_path, seed):
    """Which makes of one value at the end of the range many that lie close together."""
    log = hand(60.0, seed=seed)
    crooked = np.eye(3) + 4e-3 * np.random.default_rng(seed).standard_normal((3, 3))
    log.gyro = np.clip(log.gyro, -2.0, 2.0) @ crooked.T - BIAS
    summary, off, covariance = smoothed(tmp_path, log)
    assert any(f["kind"] == "gyro-at-stop" for f in summary["findings"])
    sigma = np.sqrt(np.einsum("nii->ni", covariance))[:, :2]
    assert np.sqrt(np.mean((off / sigma) ** 2)) < 2.0


@pytest.mark.parametrize("seed", range(3))
def test_a_motor_at_its_fastest_is_at_no_stop(tmp_path, seed):
    """It tilts the sensor to and fro, as fast as it can: the gyro sees its largest rate often."""
    rng = np.random.default_rng(seed)
    t = np.arange(6001) / RATE
    rate = 2.0 * np.clip(4.0 * np.sin(2.0 * np.pi * 0.4 * t), -1.0, 1.0)
    rate *= (t > 5.0) & (t < 55.0)
    angle = np.cumsum(rate) / RATE
    attitude = Rotation.from_rotvec(np.outer(angle, [1.0, 0.0, 0.0]))
    gyro = np.outer(rate, [1.0, 4e-3, -4e-3]) + 2e-3 * rng.standard_normal((len(t), 3))
    accel = attitude.inv().apply([0.0, 0.0, G]) + 2e-2 * rng.standard_normal((len(t), 3))
    log = Hand(even_times(len(t), RATE), gyro, accel, attitude)
    summary, off, _ = smoothed(tmp_path, log)
    assert not any(f["kind"] == "gyro-at-stop" for f in summary["findings"])
    assert np.degrees(np.sqrt(np.mean(off**2))) < 1.0


@pytest.mark.parametrize("seed", range(4))
def test_a_steady_turn_is_no_rest_where_another_rate_is(tmp_path, seed):
    """Some seconds of a car in a roundabout, and fewer of steady travel straight on."""
    rng = np.random.default_rng(seed)
    t = np.arange(1001) / RATE
    rate = np.radians(rng.uniform(10.0, 20.0)) * ((t > 1.0) & (t < rng.uniform(5.5, 7.0)))
    attitude = Rotation.from_rotvec(np.outer(np.cumsum(rate) / RATE, [0.0, 0.0, 1.0]))
    gyro = np.outer(rate, [0.0, 0.0, 1.0]) + 2e-3 * rng.standard_normal((len(t), 3)) + 0.1 * BIAS
    accel = np.column_stack([0.0 * rate, 10.0 * rate, np.full(len(t), G)])  # at 10 m/s
    accel += 2e-2 * rng.standard_normal(accel.shape)
    _, off, covariance = smoothed(tmp_path, Hand(even_times(len(t), RATE), gyro, accel, attitude))
    sigma = np.sqrt(np.einsum("nii->ni", covariance))[:, :2]
    assert np.sqrt(np.mean((off / sigma) ** 2)) < 2.0


def test_motion_by_option(tmp_path):
    log = hand(30.0)
    summary, _, _ = smoothed(tmp_path, log, navigation={"motion": "vehicle"})
    assert summary["smoothing"]["motion"] == "vehicle"
    assert summary["smoothing"]["motion_margin_nat"] is None


def test_heading_is_compared_with_the_truth_as_it_changes(tmp_path):
    log = hand(30.0)
    path = imu_log(tmp_path / "in.mcap", log.time_ns, log.gyro, log.accel)
    turned = Rotation.from_euler("z", 1.0) * log.attitude
    q = turned.as_quat()[:, [3, 0, 1, 2]]
    lines = (f"{t},{','.join(map(str, row))}" for t, row in zip(log.time_ns, q, strict=True))
    truth = tmp_path / "truth.csv"
    truth.write_text("time_ns,qw,qx,qy,qz\n" + "\n".join(lines))
    from sinstool.cli.process import process_one

    config = build(ProcessConfig, {"output": {"truth": [str(truth)]}})
    errors = process_one(path, tmp_path / "out.mcap", None, config, None).truth
    apart = errors.vertical_deg
    # 1 rad to the left in ENU, and the heading that the sensor began with
    assert abs(apart.heading_aligned) > 20.0
    assert apart.heading_rms < 5.0 and abs(apart.heading_drift) < 8.0
    assert 0.0 < apart.inclination_rms < min(0.6, apart.inclination_largest)
    assert errors.attitude_deg.rms[2] == pytest.approx(apart.heading_rms, rel=0.05)


@pytest.mark.parametrize(
    ("arguments", "options", "value", "why"),
    [
        (["static", "--grade", "mems"], {}, "smoothed", "gravity"),
        (["static", "--grade", "navigation", "--duration", "40"], {}, "inertial", "navigation"),
        (["static", "--grade", "navigation"], {}, "smoothed", "gravity"),  # too short for north
        (["static", "--grade", "mems"], {"coning": {"coning": "optimal-4"}}, "inertial", "coning"),
        (["static", "--grade", "mems", "--duration", "2"], {}, "inertial", "shorter"),
        (
            ["static", "--grade", "navigation"],
            {"navigation": {"attitude": "smoothed"}},
            "smoothed",
            "configured",
        ),
    ],
)
def test_the_plan_says_what_holds_the_attitude(tmp_path, arguments, options, value, why):
    length = [] if "--duration" in arguments else ["--duration", "20"]
    log = simulated(tmp_path / "log.mcap", *arguments, *length)
    plan = plan_of(log, build(ProcessConfig, options))
    assert plan.attitude.value == value and why in plan.attitude.reason
    assert plan.gyro_samples.value == ("mean-rate" if value == "smoothed" else "rate")


def test_navigation_grade_is_held_up_where_nothing_shows_the_earths_rate(tmp_path):
    """15 deg/h, and the first tilt of a log that begins in motion, are not for gyros to undo."""
    log = circling(60.0, [(20.0, 30.0, 0.05)])
    path = imu_log(tmp_path / "in.mcap", log.time_ns, log.gyro, log.accel)
    good = {"imu_grade": "navigation"}

    def attitude(**groups):
        return plan_of(path, build(ProcessConfig, {"navigation": good, **groups})).attitude.value

    there, moving = {"latitude": 48.0}, {"input": {"start": "21"}}
    assert attitude() == "smoothed"
    assert attitude(align=there) == "smoothed"
    assert attitude(align=there, **moving) == "smoothed"
    given = {"align": "fixed", "initial_attitude": (0.0, 0.0, 0.0)}
    assert attitude(align=there | given) == "inertial"
    assert attitude(align=there | given, **moving) == "inertial"


def test_without_gravity_nothing_can_be_held_up(tmp_path):
    log = hand(20.0)
    accel = 0.3 * (log.accel - log.attitude.inv().apply([0.0, 0.0, G]))
    path = imu_log(tmp_path / "in.mcap", log.time_ns, log.gyro, accel)
    options = {"align": "fixed", "initial_attitude": (0.0, 0.0, 0.0)}
    summary = run(path, tmp_path / "out.mcap", align=options)
    assert summary["plan"]["attitude"]["value"] == "inertial"
    with pytest.raises(DataError, match="gravity has been removed"):
        run(path, tmp_path / "b.mcap", align=options, navigation={"attitude": "smoothed"})


def test_diagnostics_of_a_smoothed_attitude(tmp_path):
    log = hand(20.0)
    path = imu_log(tmp_path / "in.mcap", log.time_ns, log.gyro, log.accel)
    run(path, tmp_path / "out.mcap")
    messages = [m for _, m in read_topic(tmp_path / "out.mcap", "/sinstool/diagnostics")]
    assert len(messages) == pytest.approx(20.0, abs=2)
    values = [{v.key: float(v.value) for v in m.status[0].values} for m in messages]
    assert stamp_ns(messages[0]) == T0
    assert all(0.0 < v["tilt sigma (deg)"] < 5.0 for v in values)
    assert values[1]["at rest"] == 1.0 and values[12]["at rest"] == 0.0


@pytest.mark.parametrize("trial", ["08_undisturbed_fast_rotation_with_breaks_A"])
def test_a_recorded_hand(tmp_path, trial):
    """23.6 deg without gravity."""
    log = real(f"broad/broad_{trial}.mcap")
    config = build(ProcessConfig, {"output": {"truth": [str(log.with_suffix(".ref.csv"))]}})
    from sinstool.cli.process import process_one

    errors = process_one(log, tmp_path / "out.mcap", None, config, None).truth
    assert errors.vertical_deg.inclination_rms < 1.0


@pytest.mark.parametrize("turning_s, named", [(60.0, True), (5.0, False)])
def test_long_turns_without_a_rest_are_named(tmp_path, turning_s, named):
    # an aircraft at 60 m/s that circles with 14 deg of bank, left and right, and never rests
    random, count = np.random.default_rng(3), round(150.0 * RATE)
    t = np.arange(count) / RATE
    turn = 0.04 * np.sign(np.sin(np.pi * t / turning_s))
    bank = np.arctan(60.0 * turn / G)
    half = np.stack([np.zeros(count), -np.sin(bank), np.cos(bank)], axis=1)
    gyro = turn[:, None] * half + BIAS + 2e-3 * random.standard_normal((count, 3))
    gyro[:, 0] += np.gradient(bank, t)
    level = np.array([0.0, 0.0, G]) / np.cos(bank)[:, None]
    accel = level + 1.0 * random.standard_normal((count, 3))
    path = imu_log(tmp_path / "in.mcap", even_times(count, RATE), gyro, accel)
    summary = run(path, tmp_path / "out.mcap", navigation={"motion": "vehicle"})
    kinds = [one["kind"] for one in summary["findings"]]
    assert "no-rest" in kinds
    assert ("long-turns" in kinds) == named


@pytest.mark.parametrize(
    "rate, moves, named", [(3.0, 0.0, True), (0.3, 0.0, False), (3.0, 0.5, False)]
)
def test_a_log_that_is_one_steady_turn_may_be_no_rest(tmp_path, rate, moves, named):
    """Of an aircraft that circled, roll was 20 deg off at a stated 2 deg, without a word."""
    random, count = np.random.default_rng(4), round(60.0 * RATE)
    t = np.arange(count) / RATE
    gyro = np.radians(rate) * np.array([0.0, 0.3, 0.95]) + 2e-3 * random.standard_normal((count, 3))
    gyro[:, 0] += moves * np.sin(2.0 * t) * (t > 30.0)
    accel = np.array([0.0, 0.0, G]) + 0.02 * random.standard_normal((count, 3))
    path = imu_log(tmp_path / "in.mcap", even_times(count, RATE), gyro, accel)
    summary = run(path, tmp_path / "out.mcap")
    steady = [one["text"] for one in summary["findings"] if one["kind"] == "steady-rate"]
    assert any("nearly all the time" in text for text in steady) == named


def circling(seconds, turns, seed=5, speed=60.0):
    """An aircraft in smooth air, that banks as it turns: seconds to rates of turn, rad/s."""
    random = np.random.default_rng(seed)
    t = np.arange(-1, round(seconds * RATE)) / RATE
    rate = np.zeros_like(t)
    for begin, end, turn in turns:
        rate += turn * (np.clip((t - begin) / 3.0, 0.0, 1.0) - np.clip((t - end) / 3.0, 0.0, 1.0))
    yaw = np.cumsum(rate) / RATE
    bank = -np.arctan(speed * rate / G)
    attitude = Rotation.from_euler("ZYX", np.stack([yaw, 0.0 * yaw, bank], axis=1))
    velocity = speed * np.stack([np.cos(yaw), np.sin(yaw), 0.0 * yaw], axis=1)
    turned = (attitude[:-1].inv() * attitude[1:]).as_rotvec() * RATE
    half = attitude[:-1] * Rotation.from_rotvec(0.5 * turned / RATE)
    gyro = turned + BIAS + 2e-3 * random.standard_normal(turned.shape)
    accel = half.inv().apply(np.diff(velocity, axis=0) * RATE + [0.0, 0.0, G])
    accel += 2e-2 * random.standard_normal(turned.shape)
    return Hand(even_times(len(gyro), RATE), gyro, accel, attitude[1:])


def assert_as_said(summary, off, covariance):
    """Tilt and gyro bias are within what is said of their errors."""
    sigma = np.sqrt(np.einsum("nii->ni", covariance))[:, :2]
    assert np.sqrt(np.mean((off / sigma) ** 2)) < 2.0
    found = np.array(summary["smoothing"]["gyro_bias_rad_s"]) * [1.0, -1.0, -1.0]
    limit = 3.0 * np.array(summary["smoothing"]["gyro_bias_sigma_rad_s"])
    assert (np.abs(found - BIAS) < limit).all()


@pytest.mark.slow
def test_a_steady_turn_at_the_beginning_gives_no_bias(tmp_path):
    """It looks like a rest, which what follows refutes: so are its mean rate and its tilt."""
    turns = [(-5.0, 12.0, 0.03), (40.0, 60.0, -0.05), (90.0, 100.0, 0.06), (130.0, 160.0, -0.02)]
    summary, off, covariance = smoothed(tmp_path, circling(200.0, turns))
    assert summary["alignment"]["gyro_bias_source"] == "rest"
    assert_as_said(summary, off, covariance)


@pytest.mark.parametrize("size", [0.02, 0.25])
def test_accelerometers_are_doubted_as_much_as_the_gyros_beside_them(tmp_path, size):
    """At rest a bias is a tilt: of a gyro with a degree per second it may be a degree, too."""
    random, count = np.random.default_rng(1), round(20.0 * RATE)
    rate = size / 14.0 * np.array([1.0, -1.0, 1.0])
    gyro = rate + 2e-3 * random.standard_normal((count, 3))
    accel = [size, -size, G] + 0.02 * random.standard_normal((count, 3))
    log = Hand(
        even_times(count, RATE),
        gyro,
        accel,
        Rotation.from_quat(np.tile([0, 0, 0, 1.0], (count, 1))),
    )
    _, off, covariance = smoothed(tmp_path, log)
    sigma = np.sqrt(np.einsum("nii->ni", covariance))[:, :2]
    assert 0.1 < np.sqrt(np.mean((off / sigma) ** 2)) < 2.5
    if size < 0.1:
        assert np.degrees(sigma.max()) < 0.5


def test_bursts_make_a_turning_attitude_uncertain_not_wrong(tmp_path):
    log = hand(60.0)
    k = np.arange(len(log.time_ns))
    received = log.time_ns[np.minimum(k // 5 * 5 + 4, len(k) - 1)] + k % 5 * 200_000
    path = imu_log(tmp_path / "in.mcap", received, log.gyro, log.accel)
    run(path, tmp_path / "out.mcap", input={"imu_stamps": "kept"})
    times, q, covariance = written(tmp_path / "out.mcap")
    off = tilt(q, log.attitude[np.searchsorted(received, times)])
    sigma = np.sqrt(np.einsum("nii->ni", covariance))[:, :2]
    assert np.sqrt(np.mean((off / sigma) ** 2)) < 1.5


@pytest.mark.slow
def test_the_only_quiet_time_may_be_a_turn(tmp_path):
    """Half a minute of it, and no straight flight after it that a filter could refute it by."""
    random = np.random.default_rng(2)
    turns, t = [(-5.0, 28.0, 0.04)], 28.0
    while t < 200.0:
        length = random.uniform(4.0, 9.0)
        turns.append((t, t + length, random.uniform(-0.12, 0.12)))
        t += length
    summary, off, covariance = smoothed(tmp_path, circling(200.0, turns))
    assert_as_said(summary, off, covariance)


@pytest.mark.parametrize("noise", [0.0, 0.2])
def test_gyros_whose_resolution_hides_their_noise_are_not_good_ones(tmp_path, noise):
    """16 bits of 2000 deg/s, and less noise than a bit: at rest nothing scatters, but 1.6 deg/s."""
    log, random = hand(60.0), np.random.default_rng(3)
    bit = np.radians(2000.0) / 2**15
    turned = (log.attitude[:-1].inv() * log.attitude[1:]).as_rotvec() * RATE
    gyro = np.vstack([turned[:1], turned]) + BIAS
    gyro += noise * bit * random.standard_normal(gyro.shape)
    log.gyro = np.round(gyro / bit) * bit
    summary, off, _ = smoothed(tmp_path, log)
    assert summary["plan"]["imu_grade"]["value"] in LOW_COST
    assert "resolution" in summary["plan"]["imu_grade"]["reason"]
    assert np.degrees(np.sqrt(np.mean(off**2))) < 0.6
    assert summary["smoothing"]["rest_s"] > 4.0


def test_gyros_as_quiet_as_good_ones_do_not_turn_at_rest(tmp_path):
    """No gyro of 0.02 deg/sqrt(h) has a bias of 1.7 deg/s: this circle is no rest."""
    log, random = circling(25.0, [(-5.0, 30.0, 0.03)]), np.random.default_rng(1)
    turned = (log.attitude[:-1].inv() * log.attitude[1:]).as_rotvec() * RATE
    log.gyro = np.vstack([turned[:1], turned]) + 5e-5 * random.standard_normal(log.gyro.shape)
    summary, off, covariance = smoothed(tmp_path, log)
    assert summary["smoothing"]["rest_s"] == 0.0
    sigma = np.sqrt(np.einsum("nii->ni", covariance))[:, :2]
    assert np.sqrt(np.mean((off / sigma) ** 2)) < 2.5


@pytest.mark.parametrize(("deg_h", "grade"), [(0.0, "tactical"), (60.0, "industrial")])
def test_fifteen_seconds_of_rest_tell_calibrated_mems_from_tactical(tmp_path, deg_h, grade):
    random, count = np.random.default_rng(4), round(15.0 * RATE)
    walk = np.radians(0.1) / 60.0
    gyro = walk * np.sqrt(RATE) * random.standard_normal((count, 3))
    gyro[:, 1] += np.radians(deg_h) / 3600.0
    accel = [0.0, 0.0, G] + 0.01 * random.standard_normal((count, 3))
    path = imu_log(tmp_path / "in.mcap", even_times(count, RATE), gyro, accel)
    assert plan_of(path, build(ProcessConfig, {})).imu_grade.value == grade
