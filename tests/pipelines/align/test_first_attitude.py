"""Where a run begins: automatic choice, carried back to the first sample; real logs."""

import json
from dataclasses import replace

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.core import rotation
from sinstool.core.units import DEGREE
from sinstool.io.readers import open_log
from sinstool.io.readers.truth import at_times, read_truth
from sinstool.methods.alignment.initial import level, tilted
from sinstool.methods.alignment.still import StillSpan
from sinstool.pipelines.align import in_motion
from sinstool.pipelines.align.first_attitude import align
from sinstool.pipelines.align.first_in_motion import denies_rest, in_flight
from sinstool.pipelines.align.log import align_log
from sinstool.survey.source import prepare
from tests.helpers.filter_logs import simulated
from tests.helpers.imulogs import G, even_times, imu_log, resting
from tests.helpers.launch_logs import TACTICAL, TRUTH, launched
from tests.helpers.logs import real
from tests.helpers.quick import mostly_slow
from tests.helpers.unseen_drives import GRADES, drive, record, without_samples, write

SHORT = "vehicle_gnss/yk_urban_short_turn_loop_nominal_002"
STOP = "vehicle_gnss/yk_urban_stop_go_large_mount_001"
REFERENCE_LATE_NS = 20_000_000


def started(path, **groups):
    config = build(ProcessConfig, groups)
    with open_log(path) as log:
        source = prepare(log, config)
        return source, align(source, config)


def test_a_flight_from_rest_is_carried_back_to_the_pad():
    log = launched(*TACTICAL, "--pad", "30")
    source, result = started(log, input={"gyro_kind": "increment"}, align={"align": "auto"})
    assert result.method == "svd" and result.north_referenced
    assert result.time_ns == source.survey.first_ns
    assert result.held_ns > result.time_ns
    with open_log(log) as opened:
        time_ns, q_nb = read_truth(opened, TRUTH, "flu")
    psi = rotation.log(rotation.multiply(result.q_nb, rotation.conjugate(q_nb[0])))
    assert time_ns[0] == result.time_ns
    assert np.rad2deg(np.linalg.norm(psi)) < 0.5
    assert psi @ np.linalg.solve(result.covariance_n, psi) / 3.0 < 5.0


@pytest.mark.parametrize("latitude", mostly_slow([65.0, -35.0, 20.0], 65.0))
def test_north_by_the_earth_at_rest_is_not_left_for_a_worse_one_by_gnss(tmp_path, latitude):
    """Fixes of a rest gave 2.7 deg of heading, where `process` knew it to 0.1 deg."""
    options = [
        "--grade",
        "navigation",
        "--rate",
        "20",
        "--duration",
        "300",
        "--latitude",
        f"{latitude}",
    ]
    path = simulated(tmp_path / "rest.mcap", "static", *options, "--attitude", "6,-21,315")
    _, first = started(path, align={"align": "auto"})
    found = align_log(path, ProcessConfig(), truth="/truth/imu").result
    assert found.method == first.method == found.plan.first_attitude.value == "gyrocompass"
    assert found.sigma_deg[2] == pytest.approx(np.degrees(first.sigma_rad[2]), rel=1e-6)
    assert abs(found.truth.error_deg[2]) < 4.0 * found.sigma_deg[2]


@pytest.mark.parametrize(
    ("lean_deg", "seconds", "denied"),
    [(2.0, 2.0, True), (2.0, 9.0, True), (2.0, 11.0, False), (0.4, 2.0, False)],
)
def test_an_attitude_denies_a_short_rest_by_five_sigmas(lean_deg, seconds, denied):
    """Nobody brakes evenly for longer than ten seconds: then the attitude is wrong."""
    lean = lean_deg * DEGREE
    force = G * np.array([np.sin(lean), 0.0, np.cos(lean)])
    still = StillSpan(0, round(seconds * 1e9), 100, np.zeros(3), -force, 0.0, 0.0)
    level_n, sigma = np.array([1.0, 0.0, 0.0, 0.0]), 0.1 * DEGREE
    assert denies_rest(level_n, sigma**2 * np.eye(3), still, 1e-4 * G) == denied


@pytest.mark.parametrize("grade", ["auto", "mems", "tactical"])
def test_agreement_with_gravity_proves_no_tilt(tmp_path, grade):
    """Biases across gravity tilt the attitude and do not change the size of the force."""
    gyro, accel = resting(2000)
    bias_mg = 1.0 if grade == "tactical" else 10.0
    lean = 1e-3 * bias_mg
    accel = accel * np.array([0.0, 0.0, np.cos(lean)]) + [G * np.sin(lean), 0.0, 0.0]
    log = imu_log(tmp_path / "log.mcap", even_times(2000), gyro, accel)
    _, result = started(log, navigation={"imu_grade": grade})
    roll, pitch = rotation.to_euler(result.q_nb)[:2]
    assert result.method == "level" and abs(pitch) == pytest.approx(lean, rel=0.05)
    assert abs(roll) < 1e-3
    assert abs(pitch) < 1.5 * result.sigma_rad[1]
    _, stated = started(log, navigation={"imu_grade": grade}, in_flight={"sigma_ba": 0.3})
    assert stated.sigma_rad[1] == pytest.approx(0.3 / G, rel=1e-3)


def test_tilt_at_rest_makes_a_carried_attitude_better():
    true = rotation.from_euler(np.deg2rad([12.0, -35.0, 130.0]))
    force = rotation.rotate(rotation.conjugate(true), np.array([0.0, 0.0, -9.8]))
    wrong = rotation.multiply(rotation.exp(np.deg2rad([1.0, -2.0, 3.0])), true)
    spread = np.diag(np.deg2rad([2.0, 2.0, 1.0]) ** 2)
    better, covariance = tilted(wrong, spread, force, 1e-6)
    np.testing.assert_allclose(
        rotation.to_euler(better)[:2], rotation.to_euler(level(force))[:2], atol=1e-3
    )
    off = rotation.log(rotation.multiply(better, rotation.conjugate(true)))
    assert abs(np.rad2deg(off[2])) == pytest.approx(3.0, abs=0.1)
    assert np.sqrt(np.diag(covariance))[:2].max() < 1e-5
    # with as much doubt in the accelerometer as in the attitude, half of it
    half, both = tilted(wrong, spread, force, 9.8 * np.deg2rad(2.0))
    off = np.rad2deg(rotation.log(rotation.multiply(half, rotation.conjugate(true))))
    np.testing.assert_allclose(off[:2], [0.5, -1.0], atol=0.06)
    np.testing.assert_allclose(np.diag(both)[:2], 0.5 * np.diag(spread)[:2])


@pytest.mark.parametrize(
    ("path", "method", "groups"),
    [
        ("broad/broad_02_undisturbed_slow_rotation_B.mcap", "level", {}),
        ("imu_tools/phidgets_imu_upside_down.bag", "level", {}),
        ("imu_tools/sparkfun_razor.bag", "level-moving", {}),
        ("px4/px4_fmuv6c_inflight_6s.mcap", "level-moving", {"input": {"body_axes": "frd"}}),
    ],
)
def test_without_enough_gnss_auto_is_what_it_was(path, method, groups):
    source, result = started(real(path), **groups)
    assert result.method == method and not result.north_referenced
    assert result.time_ns == source.survey.first_ns


@pytest.mark.parametrize(
    "path", [SHORT + ".mcap", STOP + ".mcap", "rtk_drive/rtk_drive_mems_100hz.mcap"]
)
def test_vehicles_are_north_referenced_from_their_first_sample(path):
    source, result = started(real(path))
    assert result.method == "svd" and result.north_referenced
    assert result.time_ns == source.survey.first_ns
    assert max(np.rad2deg(result.sigma_rad)) < 2.0
    still = source.survey.lead_in
    # two ways to the same tilt: motion, carried back, and gravity
    tilt = rotation.rotate(result.q_nb, still.accel / np.linalg.norm(still.accel))
    assert np.rad2deg(np.arccos(-tilt[2])) < 1.5


# -- a receiver's own attitude beside ours -----------------------------------------------------


def mounted(path, spans):
    """Attitudes of the vehicle by the reference in the IMU's axes, at the ends of alignments."""
    log, csv = real(path + ".mcap"), real(path + ".ref_att.csv")
    turns, answers = [], []
    for span in spans:
        options = {"align_start": float(span[0]), "align_end": float(span[1])}
        config = build(ProcessConfig, {"align": {"align": "svd"}, "in_flight": options})
        answer = align_log(log, config).answer
        with open_log(log) as opened:
            time_ns, q_nv = read_truth(opened, str(csv), "frd")
        at = np.arange(answer.t_ns - 30 * 10**9, answer.t_ns, 2 * 10**8)
        true = at_times(time_ns, q_nv, at + REFERENCE_LATE_NS)
        turns.append(rotation.multiply(rotation.conjugate(answer.attitude_at(at)), true))
        answers.append((answer, at, true))
    return turns, answers


def mean_turn(turns):
    """Of quaternions, their outliers left out."""
    close = np.concatenate(turns)
    for _ in range(4):
        mean = np.linalg.eigh(close.T @ close)[1][:, -1]
        off = np.linalg.norm(
            rotation.log(rotation.multiply(rotation.conjugate(mean), close)), axis=1
        )
        close = close[off <= 2.0 * np.median(off)]
    return mean


@pytest.mark.parametrize(
    ("path", "spans"),
    [
        (SHORT, [(0, 60), (60, 120), (120, 180), (0, 190)]),
        (STOP, [(150, 250), (250, 350), (300, 400), (150, 350)]),
    ],
)
def test_receivers_attitude_agrees(path, spans):
    # The IMU's mounting is not known: one rotation for all spans, of which each knows its own
    # heading. The receiver's attitude is no truth either: its tilt is 1 to 2 deg off at first.
    turns, answers = mounted(path, spans)
    mount = mean_turn(turns)
    for answer, at, true in answers:
        result = rotation.multiply(answer.attitude_at(at), mount)
        psi = np.median(rotation.log(rotation.multiply(result, rotation.conjugate(true))), axis=0)
        assert answer.status in ("ok", "degraded")
        assert np.abs(np.rad2deg(psi)).max() < 2.0
        assert abs(psi[2]) < 3.0 * answer.sigma_rad[2]
    # and that mounting is, to what is known of it, the one fitted from rates
    fitted = np.array(
        json.loads(real(path + ".json").read_text())["R_sensor_to_vehicleFRD_fit"]
    ) @ np.diag([1.0, -1.0, -1.0])
    off = rotation.log(rotation.multiply(mount, rotation.from_dcm(fitted)))
    assert np.rad2deg(np.linalg.norm(off)) < 5.0


def test_late_stamps_show_in_the_filters_residuals():
    # IMU stamps are late by 0.125 s there: with fixes moved by as much residuals fall.
    log = real("rtk_drive/rtk_drive_mems_100hz.mcap")
    span = {"align_start": 232.0, "align_end": 432.0}
    listed = {}
    for latency in (0.125, 0.0, -0.125):
        config = build(
            ProcessConfig,
            {
                "align": {"align": "svd"},
                "in_flight": span,
                "gnss": {"gnss_latency": latency, "lever_arm": (0.0, 0.0, 0.0)},
            },
        )
        listed[latency] = align_log(log, config).result.to_json()
    assert listed[-0.125]["refined_chi2"] < 0.85 * listed[0.0]["refined_chi2"]
    assert listed[0.0]["refined_chi2"] < 0.6 * listed[0.125]["refined_chi2"]
    assert listed[0.0]["latency_s"] < -0.02


def test_a_bias_of_motion_is_not_taken_for_one_of_a_rest(monkeypatch):
    """A mean turn of 3 deg/s was believed to 100 deg/h, as "by a rest", where nobody refined it."""
    config = build(ProcessConfig, {"input": {"gyro_kind": "increment"}})
    bias = np.array([0.0, 0.0, 0.05])
    with open_log(launched(*TACTICAL, "--pad", "30")) as log:
        source = prepare(log, config)
        whole = in_motion.align_moving(source, config, "mems", "svd", "start")
        settings = replace(
            whole.settings, grade=replace(whole.settings.grade, gyro_bias=0.2 * DEGREE)
        )
        rough = replace(
            whole,
            result=replace(whole.result, errors=None),
            gyro_bias=bias,
            settings=settings,
            bias_by_motion=True,
        )
        monkeypatch.setattr(in_motion, "align_moving", lambda *_, **__: rough)
        made = in_flight(source, config, "svd")
        given = replace(rough, bias_by_motion=False)
        monkeypatch.setattr(in_motion, "align_moving", lambda *_, **__: given)
        at_rest = in_flight(source, config, "svd")
    np.testing.assert_array_equal(made.gyro_bias, bias)
    assert made.bias_source == "alignment" and made.gyro_bias_sigma == 0.2 * DEGREE
    assert at_rest.bias_source == "rest" and at_rest.gyro_bias_sigma is None


@pytest.mark.parametrize(("lost_s", "sigma_v"), [(0.0, 0.05), (0.5, 0.05), (0.0, None)])
def test_the_heading_that_is_known_better_is_taken(tmp_path, lost_s, sigma_v):
    """A gyrocompass was taken wherever it could be, though motion showed ten times as much."""
    truth = drive(4, 240.0, 90.0)
    data = record(truth, GRADES["tactical"], 4, sigma_v=sigma_v)
    log = write(tmp_path / "log.mcap", without_samples(data, 20.0, lost_s))
    source, found = started(log, navigation={"imu_grade": "navigation"})
    assert found.method == ("svd" if sigma_v else "gyrocompass")
    assert found.time_ns == source.survey.first_ns
    heading = rotation.to_euler(found.q_nb)[2]
    off = rotation.wrapped(heading - rotation.to_euler(rotation.from_dcm(truth.c_nb[0]))[2])
    assert abs(off) < 4.0 * found.sigma_rad[2]
    assert sigma_v is None or found.sigma_rad[2] < 0.1 * DEGREE
