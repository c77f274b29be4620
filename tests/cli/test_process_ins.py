"""`process --mode ins` from the command line: what it says, writes, and lets others read."""

import json
import re
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from sinstool.cli.main import cli
from sinstool.core import earth
from sinstool.core.rotation import to_euler
from sinstool.pipelines.process import ins
from sinstool.pipelines.process.ins import drift_warning
from sinstool.report.text.process import first_sigma
from sinstool.survey.imu import BLOCK_ROWS
from sinstool.survey.source import imu_blocks
from tests.helpers.imulogs import angles_between, in_log_axes, read_topic, stamp_ns
from tests.helpers.logs import real
from tests.helpers.unseen_drives import (
    GRADES,
    T0,
    drive,
    flight,
    record,
    sensor_errors,
    without_fixes,
    write,
)
from tests.pipelines.process.flights import flight_log, read


def process(*arguments):
    return CliRunner().invoke(cli, ["process", *map(str, arguments)])


def options_of(f, *more):
    attitude = ",".join(repr(float(v)) for v in np.degrees(to_euler(f.flight.imu.q_nb[0])))
    return [
        "--mode", "ins", "--gyro-kind", "mean-rate", "--gyro-unit", "rad/s", "--align", "fixed",
        f"--initial-attitude={attitude}", "--gyro-bias", "none", *more,
    ]  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A flight over the date line as a log, and what ins makes of it."""
    folder = tmp_path_factory.mktemp("ins")
    f = flight_log(40.0, seed=4)
    log = f.write(folder / "log.mcap")
    out = folder / "out.mcap"
    done = process(
        log, "-o", out, *options_of(f, "--height-damping", "baro", "--json", "-q", "--emit",
        "imu,attitude,euler,odometry,pose,fix,tf,height"), "--report", folder / "r.html",
        "--truth", "/truth/imu,/truth/fix",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    return f, log, out, json.loads(done.stdout)


def enu(vectors_n):
    return vectors_n[:, [1, 0, 2]] * [1.0, 1.0, -1.0]


def local(f):
    position = np.stack([f.flight.latitude, f.flight.longitude, f.flight.height], axis=1)
    return enu(np.asarray(earth.local_position_n(position[0], position)))


def test_others_read_odometry(made):
    """By mcap's reader and rosbags: REP-103 axes, REP-105 frames, twist in the body."""
    f, _, out, _ = made
    messages = [m for _, m in read_topic(out, "/sinstool/odometry")]
    assert [stamp_ns(m) for m in messages] == f.flight.time_ns.tolist()
    assert {(m.header.frame_id, m.child_frame_id) for m in messages} == {("map", "imu_link")}
    p = np.array([(v.x, v.y, v.z) for v in (m.pose.pose.position for m in messages)])
    # the plane of the map begins where the first height of the barometer is not yet believed
    np.testing.assert_allclose(p, local(f), atol=0.5)
    q = np.array([(v.x, v.y, v.z, v.w) for v in (m.pose.pose.orientation for m in messages)])
    assert angles_between(q, in_log_axes(f.flight.imu.q_nb)).max() < 1e-6
    v = np.array([(v.x, v.y, v.z) for v in (m.twist.twist.linear for m in messages)])
    world = Rotation.from_quat(q).apply(v)
    np.testing.assert_allclose(world, enu(f.flight.velocity_n), atol=0.05)
    # nothing is known of its errors, and nothing is said
    assert all(not m.pose.covariance.any() and not m.twist.covariance.any() for m in messages)


def test_others_read_fixes(made):
    f, _, out, _ = made
    messages = [m for _, m in read_topic(out, "/sinstool/fix")]
    places = np.array([(m.latitude, m.longitude, m.altitude) for m in messages])
    np.testing.assert_allclose(places[:, 0], np.degrees(f.flight.latitude), atol=1e-8)
    off = (places[:, 1] - np.degrees(f.flight.longitude) + 180.0) % 360.0 - 180.0
    assert np.abs(off).max() < 1e-8
    assert np.abs(places[:, 1]).max() <= 180.0 and np.ptp(places[:, 1]) > 359.0
    np.testing.assert_allclose(places[:, 2], f.flight.height, atol=0.5)
    assert {m.position_covariance_type for m in messages} == {0}
    assert {m.status.status for m in messages} == {0}
    assert {m.header.frame_id for m in messages} == {"imu_link"}


def test_others_read_transforms_and_heights(made):
    f, _, out, summary = made
    transforms = [m.transforms for _, m in read_topic(out, "/tf")]
    assert {len(t) for t in transforms} == {1}
    first = [t[0] for t in transforms]
    assert {(t.header.frame_id, t.child_frame_id) for t in first} == {("map", "imu_link")}
    p = np.array([(v.x, v.y, v.z) for v in (t.transform.translation for t in first)])
    np.testing.assert_allclose(p, local(f), atol=0.5)
    vectors = [m.vector for _, m in read_topic(out, "/sinstool/height")]
    height = np.array([(v.x, v.y, v.z) for v in vectors])
    np.testing.assert_allclose(height[:, 0], f.flight.height, atol=0.5)
    np.testing.assert_allclose(height[:, 1], -f.flight.velocity_n[:, 2], atol=0.05)
    assert summary["final"]["height_m"] == height[-1, 0]
    assert summary["height"]["final"]["accelerometer_correction_m_s2"] == height[-1, 2]


def test_errors_against_the_truth(made):
    _, _, _, summary = made
    truth = summary["truth"]
    assert truth["names"] == ["/truth/imu", "/truth/fix"]
    assert truth["attitude_deg"]["instants"] == truth["position_m"]["instants"] == 4001
    assert max(truth["attitude_deg"]["largest"]) < 1e-5
    assert max(truth["position_m"]["largest"][:2]) < 1e-3
    assert truth["position_m"]["largest"][2] < 0.5


def test_what_is_off_the_last_fix(made):
    f, _, _, summary = made
    off = summary["gnss_difference"]
    assert int(off["time_ns"]) == f.flight.time_ns[-1]
    assert abs(off["north_m"]) < 1e-3 and abs(off["east_m"]) < 1e-3 and abs(off["up_m"]) < 0.5


def test_a_track_in_an_unknown_direction_is_not_to_be_trusted(tmp_path, sinstool):
    """A rest shows such gyros no heading; the track was 200 km off, with status 0."""
    truth = drive(5, 60.0, rest=20.0)
    data = record(truth, GRADES["industrial"], 5, gnss_rate=1.0, sigma_v=None)
    log = write(tmp_path / "log.mcap", data)
    words = ["--mode", "ins", "--align", "level", "--json"]
    status, out, _ = sinstool("process", log, "-o", tmp_path / "out.mcap", *words)
    assert status == 3
    finding = next(f for f in json.loads(out)["findings"] if f["kind"] == "unknown-heading")
    assert "do not trust" in finding["text"] and "ins-gnss" in finding["answer"]


def test_how_far_it_drifted_is_told_where_fixes_end_long_before_the_log(tmp_path):
    """Position was 12 km off the fixes, and not a word of it."""
    truth = drive(5, 120.0, rest=20.0)
    data = record(truth, GRADES["industrial"], 5, gnss_rate=1.0)
    log = write(tmp_path / "log.mcap", without_fixes(data, [(60.0, 120.0)]))
    words = ["process", str(log), "-o", str(tmp_path / "out.mcap"), "--mode", "ins", "--json"]
    ran = CliRunner().invoke(cli, words)
    summary = json.loads(ran.stdout)
    off = summary["gnss_difference"]
    assert 55.0 < (int(off["time_ns"]) - T0) * 1e-9 < 60.0
    told = next(f["text"] for f in summary["findings"] if "drift without fixes" in f["text"])
    distance = np.hypot(off["north_m"], off["east_m"])
    assert f"position is {distance:#.3g}".rstrip(".") in told and "--mode ins-gnss" in told


@pytest.mark.parametrize("rows", [BLOCK_ROWS, 50, 33])
def test_the_difference_to_the_last_fix_knows_of_latency_and_antenna(tmp_path, monkeypatch, rows):
    """Of a perfect navigation; the antenna and 0.6 s of motion counted as drift."""
    lever = np.array([3.0, -2.0, -1.5])
    truth = drive(5, 60.0, rest=20.0)
    perfect = sensor_errors(0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    data = record(truth, perfect, 5, gnss_rate=1.0, sigma=1e-3, latency=0.6, lever=lever)
    log = write(tmp_path / "log.mcap", data)
    angles = Rotation.from_matrix(truth.c_nb[0]).as_euler("ZYX", degrees=True)[::-1]
    monkeypatch.setattr(ins, "imu_blocks", partial(imu_blocks, rows=rows))
    words = [
        "process", str(log), "-o", str(tmp_path / "out.mcap"), "--mode", "ins", "--json",
        "--gyro-kind", "mean-rate", "--gyro-bias", "none", "--align", "fixed",
        "--initial-attitude", ",".join(map(str, angles)),
        "--lever-arm", "3,-2,-1.5", "--gnss-latency", "0.6",
    ]  # fmt: skip
    ran = CliRunner().invoke(cli, words)
    off = json.loads(ran.stdout)["gnss_difference"]
    assert (int(off["time_ns"]) - T0) * 1e-9 == pytest.approx(data.fixes.seconds[-1], abs=1e-6)
    assert np.hypot(off["north_m"], off["east_m"]) < 0.3 and abs(off["up_m"]) < 0.3


@pytest.mark.parametrize("mode", ["ins", "attitude"])
def test_heights_of_gnss_are_those_of_the_antenna_and_late(tmp_path, mode):
    """The height was held to the antenna's, 1.5 m above the IMU, and lagged in a climb."""
    lever = np.array([0.0, 0.0, -1.5])
    truth = flight(11, 90.0)
    perfect = sensor_errors(0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    data = record(truth, perfect, 4, gnss_rate=5.0, sigma=1e-3, latency=1.2, lever=lever)
    log, out = write(tmp_path / "log.mcap", data), tmp_path / "out.mcap"
    angles = Rotation.from_matrix(truth.c_nb[0]).as_euler("ZYX", degrees=True)[::-1]
    words = [
        "process", str(log), "-o", str(out), "--mode", mode, "--gyro-kind", "mean-rate",
        "--gyro-bias", "none", "--align", "fixed", "--height-damping", "gnss",
        "--initial-attitude", ",".join(map(str, angles)),
        "--lever-arm", "0,0,-1.5", "--gnss-latency", "1.2",
    ]  # fmt: skip
    words += ["--attitude", "inertial"] * (mode == "attitude")
    assert CliRunner().invoke(cli, words).exit_code in (0, 3)
    messages = [m for _, m in read_topic(out, "/sinstool/height")]
    seconds = (np.array([stamp_ns(m) for m in messages]) - T0) * 1e-9
    height = np.interp(seconds, truth.seconds, truth.height)
    off = np.array([m.vector.x for m in messages]) - height
    assert np.abs(off[seconds > 30.0]).max() < (0.3 if mode == "ins" else 0.7)


@pytest.mark.parametrize("seconds", [60.0, 600.0, 5000.0])
def test_the_drift_of_a_free_inertial_navigation_is_that_of_schuler(seconds):
    """A horizontal channel at rest, integrated: acceleration -g tilt, tilt v/R and drift."""
    earth, g = 6378137.0, 9.80665
    for bias, drift, which in ((1e-3 * g, 0.0, 0), (0.0, np.deg2rad(10.0) / 3600.0, 1)):
        end = solve_ivp(
            lambda _, y, bias=bias, drift=drift: [y[1], bias - g * y[2], y[1] / earth + drift],
            (0.0, seconds), [0.0, 0.0, 0.0], rtol=1e-10, atol=1e-12,
        ).y[0, -1]  # fmt: skip
        text = drift_warning(seconds, None, 0)
        numbers = re.findall(r"makes ([\d.e+]+) m|gyro ([\d.e+]+) m", text)
        shown = float(numbers[which][which])
        assert shown == pytest.approx(abs(end), rel=6e-3)


def test_the_page_has_it_all(made):
    _, _, out, _ = made
    text = (out.parent / "r.html").read_text()
    keys = ("tilt", "heading", "height", "difference", "up", "correction", "track", "velocity",
            "error-attitude", "error-position", "rate", "force")  # fmt: skip
    for key in keys:
        assert f'data-key="{key}"' in text, key
    assert "held to /baro (baro), tau 100 s" in text
    assert "Events of the vertical channel" in text
    assert len(text) < 10_000_000


def test_undamped_height_is_said_to_run_away(tmp_path, made):
    f, log, _, _ = made
    done = process(log, "-o", tmp_path / "out.mcap", *options_of(f))
    assert done.exit_code == 0
    assert "height is not damped and runs away" in done.stderr
    assert "1 mg of the vertical accelerometer makes 7.85 m" in done.stderr
    topics = {t for t in ("/sinstool/odometry", "/sinstool/height") if t in done.stdout}
    assert topics == {"/sinstool/odometry"}
    refused = process(log, "-o", tmp_path / "o.mcap", *options_of(f, "--emit", "height"))
    assert refused.exception.exit_code == 2


def test_an_hour_undamped_by_a_metre(tmp_path):
    """Gravity's gradient alone: 1 m grows as cosh, over 1200 s eightfold less than in an hour."""
    log = tmp_path / "log.mcap"
    made = CliRunner().invoke(
        cli, ["simulate", "spiral-climb", "-o", str(log), "--duration", "1200", "--rate", "32",
              "--gyro-kind", "mean-rate", "--gnss-model", "perfect", "--latitude", "-34",
              "--baro-sigma", "0"],
    )  # fmt: skip
    assert made.exit_code == 0, made.output
    ends = []
    for height in (400.0, 401.0):
        out = tmp_path / f"{height:.0f}.mcap"
        done = process(
            log, "-o", out, "--mode", "ins", "--gyro-kind", "mean-rate", "--align", "fixed",
            "--initial-attitude", "2,0,0", "--gyro-bias", "none", "--latitude", -34,
            "--longitude", 108.9, "--height", height, "--only-results", "--json", "-q",
        )  # fmt: skip
        assert done.exit_code == 0, done.output
        ends.append(json.loads(done.stdout)["final"]["height_m"])
    truth = read(log, "/truth/fix", ["altitude"])[1][-1]
    assert ends[0] == pytest.approx(float(np.squeeze(truth)), abs=1e-3)
    assert ends[1] - ends[0] == pytest.approx(np.cosh(np.sqrt(3.08e-6) * 1200.0), rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["rate", "mean-rate", "increment"])
def test_damped_spiral_meets_the_truth(tmp_path, kind):
    log, out = tmp_path / "log.mcap", tmp_path / "out.mcap"
    CliRunner().invoke(
        cli, ["simulate", "spiral-climb", "-o", str(log), "--duration", "300", "--rate", "128",
              "--gyro-kind", kind, "--gnss-model", "perfect", "--baro-sigma", "0"],
    )  # fmt: skip
    done = process(
        log, "-o", out, "--mode", "ins", "--gyro-kind", kind, "--align", "fixed",
        "--initial-attitude", "2,0,0", "--gyro-bias", "none", "--height-damping", "baro",
        "--truth", "/truth/fix,/truth/imu", "--json", "-q", "--only-results",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    truth = json.loads(done.stdout)["truth"]
    assert max(truth["position_m"]["largest"]) < 1e-3
    assert max(truth["attitude_deg"]["largest"]) < 1e-6


def test_a_report_that_cannot_be_written_is_refused_before_the_work(tmp_path, made):
    f, log, _, _ = made
    page = tmp_path / "r.html"
    page.write_text("mine")
    done = process(log, "-o", tmp_path / "out.mcap", *options_of(f), "--report", page)
    assert "--overwrite" in str(done.exception)
    assert [p.name for p in tmp_path.iterdir()] == ["r.html"] and page.read_text() == "mine"
    done = process(log, "-o", tmp_path / "o.mcap", *options_of(f), "--truth", "/imu/nothing")
    assert "/imu/nothing" in str(done.exception)
    done = process(log, "-o", tmp_path / "o.html", *options_of(f), "--report", tmp_path / "o.html")
    assert done.exit_code == 2
    assert [p.name for p in tmp_path.iterdir()] == ["r.html"]


def test_attitude_alone_has_a_page_too(tmp_path, made):
    _, log, _, _ = made
    page = tmp_path / "r.html"
    done = process(
        log, "-o", tmp_path / "out.mcap", "--mode", "attitude", "--gyro-unit", "rad/s",
        "--gyro-kind", "mean-rate", "--report", page, "--height-damping", "baro", "--only-results",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    text = page.read_text()
    assert 'data-key="tilt"' in text and 'data-key="height"' in text
    assert 'data-key="track"' not in text


# -- real logs -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("path", "damping", "more", "near"),
    [
        ("px4/px4_fmuv6c_inflight_6s.mcap", "baro", ["--body-axes", "frd"], 3.0),
        ("vehicle_gnss/yk_urban_short_turn_loop_nominal_002.mcap", "gnss", [], 15.0),
        ("vehicle_gnss/yk_urban_stop_go_large_mount_001.mcap", "gnss", [], 15.0),
        ("rtk_drive/rtk_drive_mems_100hz.mcap", "gnss", [], 5.0),
    ],
)
def test_real_logs_keep_their_height(tmp_path, path, damping, more, near):
    out = tmp_path / "out.mcap"
    log = real(path)
    done = process(
        log, "-o", out, "--mode", "ins", "--height-damping", damping, "--json", "-q",
        "--only-results", *more,
    )  # fmt: skip
    assert done.exit_code in (0, 3), done.output
    summary = json.loads(done.stdout)
    assert summary["height"]["samples"]["accepted"] > 10
    assert summary["height"]["difference_rms_m"] < near
    for topic, fields in (
        ("/sinstool/height", ["vector.x", "vector.y", "vector.z"]),
        ("/sinstool/fix", ["latitude", "longitude", "altitude"]),
        ("/sinstool/odometry", ["pose.pose.position.x", "pose.pose.position.y",
                                "pose.pose.position.z", "twist.twist.linear.x",
                                "twist.twist.linear.y", "twist.twist.linear.z"]),
        ("/sinstool/attitude", [f"quaternion.{a}" for a in "xyzw"]),
    ):  # fmt: skip
        times, values = read(out, topic, fields)
        assert len(times) == summary["output"]["attitudes"]
        assert np.isfinite(values).all(), topic
    _, height = read(out, "/sinstool/height", ["vector.x"])
    start = height[0]
    assert np.abs(height - start).max() < 200.0


def test_the_sigma_of_heading_is_not_said_to_be_that_of_tilt():
    said = [
        first_sigma(SimpleNamespace(sigma_deg=sigma))
        for sigma in [(0.061, 0.0612, 4.73), (0.8, 0.8, None), (None, None, None)]
    ]
    assert said == [
        ", sigma 0.061, 0.061, 4.7 deg about north, east, down",
        ", sigma of tilt 0.8 deg",
        "",
    ]
