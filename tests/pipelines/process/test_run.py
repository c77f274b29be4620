import hashlib
import tomllib
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

import sinstool
from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.core.errors import AlignmentError, DataError, OutputError
from sinstool.core.rotation import from_euler
from sinstool.core.streams import Imu, concatenate
from sinstool.methods.coning.registry import algorithm, names
from sinstool.methods.strapdown.attitude import AttitudeRun, AttitudeSettings
from sinstool.pipelines.process import attitude
from sinstool.pipelines.process import output as result
from sinstool.pipelines.process.run import process
from sinstool.pipelines.provenance import sha256
from sinstool.simulation.coning import classical_coning
from sinstool.simulation.log import resting_fixes, write_simulated
from sinstool.simulation.truth import after_rest, sample_times, static
from sinstool.survey import samples, source
from tests.helpers.imulogs import (
    FLU_FRD,
    T0,
    G,
    angles_between,
    even_times,
    handheld,
    imu_log,
    imu_messages,
    in_log_axes,
    read_attitude,
    read_topic,
    resting,
    stamp_ns,
    write_bag,
    write_log,
)
from tests.helpers.motion_topics import motion_topics

RATE = 200.0
SECOND = 10**9
START_DEG = (20.0, -35.0, 110.0)  # roll, pitch, heading
START = from_euler(np.radians(START_DEG))
FIXED = {"align": "fixed", "initial_attitude": START_DEG}
INERTIAL = {"attitude": "inertial"}


def lost(summary):
    return any(finding["severity"] == "lost" for finding in summary["findings"])


def run(path, out, **groups):
    return process(path, out, build(ProcessConfig, groups)).to_json()


def cone(seconds=2.0, half_angle_deg=2.0, frequency=3.0, rate=RATE, q_nc=START):
    times = sample_times(rate, seconds, T0)
    return classical_coning(times, np.radians(half_angle_deg), frequency, q_nc=q_nc)


def rested_cone(rest_s=3.0, seconds=3.0):
    """Rest in the attitude that the cone begins with."""
    times = sample_times(RATE, rest_s + seconds, T0)
    at = int(rest_s * RATE)
    motion = classical_coning(times[at:], np.radians(2.0), 3.0, q_nc=START)
    return after_rest(motion, classical_coning(times[: at + 1], 0.0, 3.0, q_nc=motion.q_nb[0]))


def still_at(latitude_deg, seconds=10.0):
    return static(sample_times(RATE, seconds, T0), START, np.radians(latitude_deg), 300.0)


def simulated(path, truth, kind="rate", axes="flu", position=None):
    topics = motion_topics(truth, kind, axes)
    if position is not None:
        topics.append(resting_fixes(truth.time_ns, position))
    write_simulated(path, topics, {})
    return path


def degrees_off(out, truth, axes="flu", world="enu"):
    """Largest angle between what was written and the truth at those instants."""
    times, q = read_attitude(out)
    rows = np.searchsorted(truth.time_ns, times)
    np.testing.assert_array_equal(truth.time_ns[rows], times)
    return np.degrees(angles_between(q, in_log_axes(truth.q_nb[rows], axes, world)).max())


def fixed_at(q_nb):
    heading, pitch, roll = Rotation.from_quat(q_nb, scalar_first=True).as_euler("ZYX", degrees=True)
    return {"align": "fixed", "initial_attitude": (float(roll), float(pitch), float(heading))}


@pytest.mark.parametrize("kind", ["rate", "mean-rate", "increment"])
@pytest.mark.parametrize("name", names())
def test_every_algorithm_meets_the_truth(tmp_path, name, kind):
    truth = cone()
    path = simulated(tmp_path / "in.mcap", truth, kind)
    out = tmp_path / "out.mcap"
    summary = run(
        path,
        out,
        input={"gyro_kind": kind},
        coning={"coning": name},
        align=fixed_at(truth.q_nb[0]),
    )
    off = degrees_off(out, truth)
    # What no compensation leaves is what the cone turns between samples, two seconds long.
    turn = 2 * np.pi * 3.0
    step = turn / RATE
    expected = np.degrees(
        turn * 2.0 * 2 * np.sin(np.radians(1.0)) ** 2 * (1 - np.sinc(step / np.pi))
    )
    if name == "uncompensated":
        assert off == pytest.approx(expected, rel=0.05)
    elif name == "singular-perturbation":
        # Two rates are joined by a straight line, which cuts the corners of the cone's turn; and
        # the mean rate of an interval stands for the rate at its end, half a sample late.
        assert off < 2 * 2.0 * (step**2 / 12 if kind == "rate" else step / 2)
        q, at_end = read_attitude(out)[1][-1:], in_log_axes(truth.q_nb[-1:])
        assert np.degrees(angles_between(q, at_end)[0]) < (0.02 if kind == "rate" else 1) * expected
    else:
        assert off < 0.02 * expected
    # one attitude per update, the first sample, and what is left at the end
    samples = algorithm(name).samples
    rows = sorted({*range(0, 401, samples), 400})
    assert read_attitude(out)[0].tolist() == truth.time_ns[rows].tolist()
    assert summary["output"]["attitudes"] == summary["coning"]["updates"] == len(rows)
    assert summary["coning"]["samples_per_update"] == samples


@pytest.mark.parametrize("world", ["enu", "ned"])
@pytest.mark.parametrize("axes", ["flu", "frd"])
@pytest.mark.parametrize("container", ["ros2", "ros1", "bag"])
def test_axes_worlds_and_containers(tmp_path, container, axes, world):
    truth = cone()
    turn = FLU_FRD if axes == "flu" else Rotation.identity()
    ros = 2 if container == "ros2" else 1
    messages = imu_messages(
        truth.time_ns, turn.apply(truth.gyro_rate), turn.apply(truth.specific_force), ros=ros
    )
    if container == "bag":
        path = write_bag(tmp_path / "in.bag", messages)
    else:
        path = write_log(tmp_path / "in.mcap", messages, ros)
    out = tmp_path / "out.mcap"
    run(
        path,
        out,
        input={"body_axes": axes},
        align=fixed_at(truth.q_nb[0]),
        output={"world": world, "emit": ["imu", "attitude", "euler", "pose", "tf"]},
    )
    assert degrees_off(out, truth, axes, world) < 1e-4

    _, q = read_attitude(out)
    written = [m for _, m in read_topic(out, "/sinstool/imu")]
    frame = "odom" if world == "enu" else "odom_ned"
    for k in (0, 7, 300, 400):
        m = written[k]
        v = m.orientation
        np.testing.assert_array_equal((v.x, v.y, v.z, v.w), q[k])
        v = m.angular_velocity
        np.testing.assert_allclose((v.x, v.y, v.z), turn.apply(truth.gyro_rate[k]), rtol=1e-12)
        v = m.linear_acceleration
        np.testing.assert_allclose((v.x, v.y, v.z), turn.apply(truth.specific_force[k]), rtol=1e-12)
        assert m.header.frame_id == "imu_link"
        if ros == 1:
            assert m.header.seq == k

        m = read_topic(out, "/sinstool/euler")[k][1]
        angles = np.degrees([m.vector.x, m.vector.y, m.vector.z])
        expected = Rotation.from_quat(truth.q_nb[k], scalar_first=True).as_euler(
            "ZYX", degrees=True
        )
        np.testing.assert_allclose(angles, expected[::-1], atol=1e-3)
        assert m.header.frame_id == "odom_ned"  # these angles are of FRD in NED in any case

        v = read_topic(out, "/sinstool/pose")[k][1].pose.orientation
        np.testing.assert_array_equal((v.x, v.y, v.z, v.w), q[k])
        (m,) = read_topic(out, "/tf")[k][1].transforms
        v = m.transform.rotation
        np.testing.assert_array_equal((v.x, v.y, v.z, v.w), q[k])
        assert (m.header.frame_id, m.child_frame_id) == (frame, "imu_link")
        assert stamp_ns(m) == truth.time_ns[k]
    with out.open("rb") as stream:
        assert make_reader(stream).get_header().profile == f"ros{ros}"


def test_input_messages_are_kept_and_left_out(tmp_path):
    path = simulated(tmp_path / "in.mcap", cone(), position=(0.7, 0.1, 300.0))

    def contents(file, own):
        with file.open("rb") as stream:
            return [
                (c.topic, m.log_time, m.publish_time, m.sequence, m.data)
                for _, c, m in make_reader(stream).iter_messages()
                if c.topic.startswith("/sinstool/") == own
            ]

    out = tmp_path / "out.mcap"
    run(path, out, align=FIXED)
    assert sorted(contents(out, False)) == sorted(contents(path, False))
    only = tmp_path / "only.mcap"
    run(path, only, align=FIXED, output={"only_results": True})
    assert contents(only, False) == []
    assert contents(only, True) == contents(out, True)


def test_only_results_are_always_ros2(tmp_path):
    truth = cone()
    messages = imu_messages(truth.time_ns, truth.gyro_rate, truth.specific_force, ros=1)
    path = write_bag(tmp_path / "in.bag", messages)
    run(path, tmp_path / "out.mcap", input={"body_axes": "frd"}, output={"only_results": True})
    with (tmp_path / "out.mcap").open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        assert {c.message_encoding for _, c, _ in reader.iter_messages()} == {"cdr"}


def test_metadata(tmp_path):
    path = simulated(tmp_path / "in.mcap", cone())
    options = {
        "input": {"imu_topic": "/imu/data_raw", "max_gap": 0.5, "start": "0.5"},
        "coning": {"coning": "singular-perturbation", "epsilon": 1e-3, "beta": (1.0, 2.0, 3.0)},
        "align": {**FIXED, "gyro_bias": (1e-3, 0.0, -1e-3), "latitude": 48.25},
        "output": {"emit": ("euler", "attitude"), "world": "ned"},
    }
    summary = run(path, tmp_path / "out.mcap", **options)
    with (tmp_path / "out.mcap").open("rb") as stream:
        records = {m.name: m.metadata for m in make_reader(stream).iter_metadata()}
    record = records["sinstool"]
    assert record["version"] == sinstool.__version__
    assert record["input_name"] == "in.mcap"
    assert record["input_size"] == str(path.stat().st_size)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    assert record["input_sha256"] == digest == summary["input"]["sha256"]
    again = build(ProcessConfig, tomllib.loads(record["config"]))
    assert again == build(ProcessConfig, options)
    # and the same configuration gives the same file
    process(path, tmp_path / "again.mcap", again)
    assert (tmp_path / "again.mcap").read_bytes() == (tmp_path / "out.mcap").read_bytes()


def test_sha256_of_a_directory(tmp_path):
    (tmp_path / "b").mkdir()
    for name, data in (("a.db3", b"1" * 3_000_000), ("b/c.yaml", b"")):
        (tmp_path / name).write_bytes(data)
    lines = "".join(
        f"{hashlib.sha256((tmp_path / n).read_bytes()).hexdigest()}  {n}\n"
        for n in ("a.db3", "b/c.yaml")
    )
    assert sha256(tmp_path) == hashlib.sha256(lines.encode()).hexdigest()


# -- the first attitude ----------------------------------------------------------------------


def test_align_level(tmp_path):
    truth = rested_cone()
    path = simulated(tmp_path / "in.mcap", truth, "mean-rate")
    options = {"gyro_kind": "mean-rate"}
    summary = run(path, tmp_path / "out.mcap", input=options, align={"align": "level"})
    aligned = summary["alignment"]
    expected = Rotation.from_quat(truth.q_nb[0], scalar_first=True).as_euler("ZYX", degrees=True)
    assert aligned["method"] == "level" and aligned["heading_deg"] == pytest.approx(0.0, abs=1e-9)
    assert aligned["roll_deg"] == pytest.approx(expected[2], abs=1e-6)
    assert aligned["pitch_deg"] == pytest.approx(expected[1], abs=1e-6)
    assert aligned["time_ns"] == str(T0)
    assert not aligned["north_referenced"] and summary["output"]["frame"] == "odom"
    # the truth turned to heading 0, all the way
    unturn = Rotation.from_euler("Z", -expected[0], degrees=True)
    turned = unturn * Rotation.from_quat(truth.q_nb, scalar_first=True)
    times, q = read_attitude(tmp_path / "out.mcap")
    assert len(times) == len(truth.time_ns)
    off = angles_between(q, in_log_axes(turned.as_quat(scalar_first=True)))
    assert np.degrees(off.max()) < 1e-4


def test_align_level_wants_rest(tmp_path):
    path = simulated(tmp_path / "in.mcap", cone(half_angle_deg=20.0))
    with pytest.raises(AlignmentError, match=r"does not begin at rest.*--start"):
        run(path, tmp_path / "out.mcap", align={"align": "level"})
    assert [p.name for p in tmp_path.iterdir()] == ["in.mcap"]


@pytest.mark.parametrize("axes", ["flu", "frd"])
@pytest.mark.parametrize("how", ["log", "auto"])
def test_align_log(tmp_path, axes, how):
    truth = cone(half_angle_deg=20.0)
    path = simulated(tmp_path / "in.mcap", truth, axes=axes)
    summary = run(
        path,
        tmp_path / "out.mcap",
        input={"imu_topic": "/truth/imu", "body_axes": axes},
        align={"align": how},
    )
    assert summary["alignment"]["method"] == "log"
    assert degrees_off(tmp_path / "out.mcap", truth, axes) < 5e-3


def test_align_log_begins_with_the_first_orientation(tmp_path):
    gyro, accel, attitude = handheld(1000)
    q = attitude.as_quat()
    q[:100] = 0.0
    log = imu_log(tmp_path / "in.mcap", even_times(1000), gyro, accel, q_xyzw=q, covariance=0.0)
    run(log, tmp_path / "out.mcap", align={"align": "log"}, navigation=INERTIAL)
    times, written = read_attitude(tmp_path / "out.mcap")
    assert times.tolist() == even_times(1000)[100:].tolist()
    assert angles_between(written[:1], attitude[100:101])[0] < 1e-12


def test_align_log_without_orientations(tmp_path):
    path = simulated(tmp_path / "in.mcap", cone())
    with pytest.raises(AlignmentError, match=r"holds no orientation.*--align level"):
        run(path, tmp_path / "out.mcap", align={"align": "log"})


def test_a_constant_orientation_is_taken_only_when_asked_for(tmp_path):
    gyro, accel, _ = handheld(1000)
    q = Rotation.from_euler("ZYX", [50, 10, -5], degrees=True)
    log = imu_log(
        tmp_path / "in.mcap", even_times(1000), gyro, accel, q_xyzw=q.as_quat(), covariance=0.0
    )
    auto = run(log, tmp_path / "a.mcap")
    assert auto["alignment"]["method"] == "level-moving"
    by_option = run(log, tmp_path / "b.mcap", align={"align": "log"}, navigation=INERTIAL)
    assert by_option["alignment"]["method"] == "log"
    assert angles_between(read_attitude(tmp_path / "b.mcap")[1][:1], q)[0] < 1e-12


def test_auto_of_a_moving_start(tmp_path):
    path = simulated(tmp_path / "in.mcap", cone(half_angle_deg=20.0))
    summary = run(path, tmp_path / "out.mcap")
    assert summary["alignment"]["status"] == "degraded"
    assert any("6 deg for each" in w for w in summary["warnings"])
    assert any("no gyro bias is removed" in w for w in summary["warnings"])


# -- gyro bias -------------------------------------------------------------------------------


def biased(path, bias):
    """Mean rates, which know of the jump with which the cone begins."""
    truth = rested_cone()
    gyro = FLU_FRD.apply(truth.gyro_mean_rate) + bias  # in the log's axes
    return truth, imu_log(path, truth.time_ns, gyro, FLU_FRD.apply(truth.specific_force))


BIAS = np.array([0.01, -0.02, 0.03])


@pytest.mark.parametrize("how", ["given", "still", "none"])
def test_gyro_bias(tmp_path, how):
    truth, path = biased(tmp_path / "in.mcap", BIAS)
    options = tuple(BIAS) if how == "given" else how
    summary = run(
        path,
        tmp_path / "out.mcap",
        input={"gyro_kind": "mean-rate"},
        align={**fixed_at(truth.q_nb[0]), "gyro_bias": options},
        navigation=INERTIAL,
    )
    assert summary["alignment"]["gyro_bias_source"] == how
    used = np.zeros(3) if how == "none" else FLU_FRD.apply(BIAS)
    np.testing.assert_allclose(summary["alignment"]["gyro_bias_rad_s"], used, atol=1e-12)
    off = degrees_off(tmp_path / "out.mcap", truth)
    if how == "none":
        # six seconds of it: the cone averages out
        assert off == pytest.approx(np.degrees(np.linalg.norm(BIAS)) * 6.0, rel=0.05)
    else:
        assert off < 1e-4
    m = read_topic(tmp_path / "out.mcap", "/sinstool/imu")[0][1].angular_velocity
    rate = FLU_FRD.apply(truth.gyro_mean_rate[0]) + (BIAS if how == "none" else 0.0)
    np.testing.assert_allclose((m.x, m.y, m.z), rate, atol=1e-12)


def test_attitude_stays_while_the_vehicle_is_known_to_rest(tmp_path):
    """Noise and a wandering bias do not turn what is still; with --gyro-bias none they do."""
    truth, _ = biased(tmp_path / "in.mcap", BIAS)
    rng = np.random.default_rng(0)
    gyro = FLU_FRD.apply(truth.gyro_rate) + BIAS + 0.002 * rng.standard_normal((1201, 3))
    path = imu_log(tmp_path / "in.mcap", truth.time_ns, gyro, FLU_FRD.apply(truth.specific_force))
    run(path, tmp_path / "out.mcap", align={"align": "level"}, navigation=INERTIAL)
    times, q = read_attitude(tmp_path / "out.mcap")
    # a window before the motion may hold its beginning, so 2.5 of the three seconds
    still = times <= T0 + int(2.5 * SECOND)
    assert (q[still] == q[0]).all()
    assert (q[~still][1:] != q[0]).any(axis=1).all()
    free = {"align": "level", "gyro_bias": "none"}
    run(path, tmp_path / "free.mcap", align=free, navigation=INERTIAL)
    assert not (read_attitude(tmp_path / "free.mcap")[1][still] == q[0]).all()


# -- where on Earth --------------------------------------------------------------------------


@pytest.mark.parametrize("source", ["given", "fix", "none"])
def test_the_earths_rate(tmp_path, source):
    latitude = 48.0
    truth = still_at(latitude, 20.0)
    position = (np.radians(latitude), np.radians(11.0), 300.0) if source == "fix" else None
    path = simulated(tmp_path / "in.mcap", truth, position=position)
    options = {"latitude": latitude} if source == "given" else {}
    align = {**FIXED, "gyro_bias": "none", **options}
    summary = run(path, tmp_path / "out.mcap", align=align, navigation=INERTIAL)
    off = degrees_off(tmp_path / "out.mcap", truth)
    if source == "none":
        assert off == pytest.approx(np.degrees(7.292115e-5) * 20.0, rel=1e-3)
        assert any("give --latitude" in w for w in summary["warnings"])
        assert summary["output"]["frame"] == "odom"
    else:
        assert off < 1e-9
        assert summary["output"]["frame"] == "map"
        assert not any("latitude" in w for w in summary["warnings"])


@pytest.mark.parametrize("attitude", ["smoothed", "inertial"])
def test_attitude_alone_has_no_final_position(tmp_path, attitude):
    place = (np.radians(48.0), np.radians(11.0), 300.0)
    path = simulated(tmp_path / "in.mcap", still_at(48.0, 20.0), position=place)
    only = {"mode": "attitude", "attitude": attitude}
    summary = run(path, tmp_path / "out.mcap", align=FIXED, navigation=only)
    final = summary["final"]
    assert (final["lat_deg"], final["lon_deg"], final["height_m"]) == (None, None, None)


def test_the_earths_rate_is_no_bias(tmp_path):
    truth = still_at(-33.0)
    path = simulated(tmp_path / "in.mcap", truth)
    summary = run(path, tmp_path / "out.mcap", align={**FIXED, "latitude": -33.0})
    np.testing.assert_allclose(summary["alignment"]["gyro_bias_rad_s"], 0.0, atol=1e-15)
    summary = run(path, tmp_path / "without.mcap", align=FIXED)
    assert np.linalg.norm(summary["alignment"]["gyro_bias_rad_s"]) == pytest.approx(7.292115e-5)


# -- spans, gaps, order ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("start", "end"),
    [("1", "1.5"), ("2023-11-14T22:13:21Z", f"{T0 + 1_500_000_000}"), (f"{T0 + SECOND}ns", "1.5")],
)
def test_start_and_end(tmp_path, start, end):
    truth = cone()
    path = simulated(tmp_path / "in.mcap", truth)
    out = tmp_path / "out.mcap"
    first = fixed_at(truth.q_nb[200])
    summary = run(path, out, input={"start": start, "end": end}, align=first)
    times, _ = read_attitude(out)
    assert times.tolist() == truth.time_ns[200:301].tolist()
    assert degrees_off(out, truth) < 1e-4
    assert summary["imu"]["n"] == 101
    assert summary["final"]["time_ns"] == str(truth.time_ns[300])
    # the input's own messages are all there, the span is of what is computed
    assert len(read_topic(out, "/imu/data_raw")) == 401


def test_impossible_spans(tmp_path):
    path = simulated(tmp_path / "in.mcap", cone())
    with pytest.raises(DataError, match="--end is not after --start"):
        run(path, tmp_path / "out.mcap", input={"start": "2", "end": "1"})
    with pytest.raises(DataError, match=r"span 2\.000 s"):
        run(path, tmp_path / "out.mcap", input={"start": "5"})


def test_attitude_is_held_across_gaps(tmp_path):
    gyro, accel, _ = handheld(1200, noise=0.0)
    times = even_times(1200)
    times[600:] += 10 * SECOND
    out = tmp_path / "out.mcap"
    log = imu_log(tmp_path / "in.mcap", times, gyro, accel)
    summary = run(log, out, align=FIXED, navigation=INERTIAL)
    stamps, q = read_attitude(out)
    assert stamps.tolist() == times.tolist()
    assert (q[600] == q[599]).all() and (q[601] != q[600]).any()
    turned = np.degrees(np.linalg.norm(gyro[599] + gyro[600]) / 2 * 10.005)
    (warning,) = [w for w in summary["warnings"] if "held constant across" in w]
    assert f"{turned:.3g} deg" in warning
    assert summary["imu"]["gaps"] == 1
    # each side of the gap is what it would be alone
    for name, rows in (("a", slice(0, 600)), ("b", slice(600, None))):
        alone = imu_log(tmp_path / f"{name}.mcap", times[rows], gyro[rows], accel[rows])
        run(alone, tmp_path / f"{name}.out.mcap", align=FIXED, navigation=INERTIAL)
        part = Rotation.from_quat(read_attitude(tmp_path / f"{name}.out.mcap")[1])
        whole = Rotation.from_quat(q[rows])
        turn = (part[0].inv() * part).inv() * (whole[0].inv() * whole)
        assert turn.magnitude().max() < 1e-9


@pytest.mark.parametrize("name", ["optimal-3", "savage-two-speed"])
def test_several_samples_an_update_begin_anew_after_a_gap(tmp_path, name):
    gyro, accel, _ = handheld(1000)
    times = even_times(1000)
    times[500:] += SECOND
    out = tmp_path / "out.mcap"
    log = imu_log(tmp_path / "in.mcap", times, gyro, accel)
    run(log, out, coning={"coning": name}, align=FIXED)
    n = algorithm(name).samples
    rows = sorted({*range(0, 500, n), 499, *range(500, 1000, n), 999})
    assert read_attitude(out)[0].tolist() == times[rows].tolist()


def test_a_given_rate_replaces_the_intervals(tmp_path):
    """Evenly sampled, stamped with jitter."""
    truth = cone()
    rng = np.random.default_rng(0)
    stamps = truth.time_ns + rng.integers(-2_000_000, 2_000_000, len(truth.time_ns))
    for kind, gyro, unit in (
        ("rate", truth.gyro_rate, 1.0),
        ("mean-rate", truth.gyro_mean_rate, 1.0),
        ("increment", truth.gyro_increment, 1 / RATE),
    ):
        log = imu_log(tmp_path / "in.mcap", stamps, gyro, truth.mean_specific_force * unit)
        out = tmp_path / f"{kind}.mcap"
        options = {"gyro_kind": kind, "body_axes": "frd", "imu_rate": RATE, "imu_stamps": "kept"}
        run(log, out, input=options, align=fixed_at(truth.q_nb[0]))
        times, q = read_attitude(out)
        assert times.tolist() == stamps.tolist()  # stamps stay the log's own
        off = angles_between(q, in_log_axes(truth.q_nb, "frd"))
        assert np.degrees(off.max()) < 1e-4


def messy_columns(count=4000):
    """Late, repeated and missing samples and gaps: columns, rows in order, rows as in the log."""
    rng = np.random.default_rng(11)
    gyro, accel, _ = handheld(count, rest_s=2.0, seed=5)
    times = even_times(count) + rng.integers(-300_000, 300_000, count)
    times[count // 3 :] += 2 * SECOND
    times[count // 2 :] += 4797 * SECOND
    keep = np.sort(rng.choice(count, count - 200, replace=False))
    order = keep.copy()
    for begin in range(0, count // 4, 5):  # no gap lies there
        order[begin : begin + 5] = order[begin : begin + 5][[0, 3, 1, 2, 4]]
    order = np.insert(order, 400, order[390:400])  # a packet that came twice
    return times, gyro, accel, keep, order


def test_out_of_order_and_duplicates_are_as_if_they_were_not(tmp_path):
    times, gyro, accel, keep, order = messy_columns()
    log_ns = np.maximum.accumulate(times[order]) + np.arange(len(order))  # one after the other
    messy = imu_log(tmp_path / "a.mcap", times[order], gyro[order], accel[order], log_ns=log_ns)
    clean = imu_log(tmp_path / "b.mcap", times[keep], gyro[keep], accel[keep])
    one = run(messy, tmp_path / "a.out.mcap", align=FIXED)
    run(clean, tmp_path / "b.out.mcap", align=FIXED)
    stamps, q = read_attitude(tmp_path / "a.out.mcap")
    by_stamp = np.argsort(stamps)  # readers go by log time, which stays each sample's own
    stamps, q = stamps[by_stamp], q[by_stamp]
    np.testing.assert_array_equal(stamps, times[keep])
    np.testing.assert_array_equal(q, read_attitude(tmp_path / "b.out.mcap")[1])
    assert one["imu"]["duplicates"] == 10 and one["imu"]["backward"] >= 200


# -- blocks ----------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("previous-3", "rate"),
        ("previous-3", "mean-rate"),
        ("previous-3", "increment"),
        ("optimal-4", "rate"),
        ("savage-two-speed", "increment"),
        ("singular-perturbation", "rate"),
    ],
)
def test_files_do_not_depend_on_blocks(tmp_path, monkeypatch, name, kind):
    times, gyro, accel, _, order = messy_columns(1800)
    scale = 0.005 if kind == "increment" else 1.0
    columns = times[order], gyro[order] * scale, accel[order] * scale
    path = imu_log(tmp_path / "in.mcap", *columns, log_ns=even_times(len(order)))
    whole_survey, whole_blocks = source.survey, attitude.imu_blocks
    written = set()
    # with samples kept from the first pass for the second, and read again
    for rows, cached in ((10**9, 10**9), (4096, 0), (7, 10**9), (1, 0)):
        monkeypatch.setattr(samples, "CACHED_SAMPLES", cached)
        monkeypatch.setattr(source, "survey", partial(whole_survey, block_rows=rows))
        monkeypatch.setattr(attitude, "imu_blocks", partial(whole_blocks, rows=rows))
        out = tmp_path / f"{rows}.mcap"
        run(path, out, input={"gyro_kind": kind}, coning={"coning": name}, align={"latitude": 40.0})
        written.add(out.read_bytes())
    assert len(written) == 1


@pytest.mark.slow
@settings(max_examples=40)
@given(
    name=st.sampled_from(names()),
    kind=st.sampled_from(["rate", "mean-rate", "increment"]),
    sizes=st.lists(st.integers(1, 60), min_size=1, max_size=40),
    gaps=st.sets(st.integers(1, 399), max_size=6),
    earth=st.booleans(),
    still_s=st.one_of(st.none(), st.floats(0.0, 2.0)),
    rate=st.one_of(st.none(), st.just(199.0)),
)
def test_runs_do_not_depend_on_blocks(name, kind, sizes, gaps, earth, still_s, rate):
    rng = np.random.default_rng(len(sizes))
    steps = rng.integers(4_500_000, 5_500_000, 400)
    steps[list(gaps)] += SECOND
    times = T0 + np.cumsum(steps)
    imu = Imu(times, times + 7, rng.normal(size=(400, 3)), rng.normal(size=(400, 3)))

    def out(blocks):
        chosen = AttitudeSettings(
            algorithm=algorithm(name),
            gyro_kind=kind,
            nominal_ns=5e6,
            max_gap_ns=15_000_000,
            gyro_bias=np.array([0.1, -0.2, 0.3]),
            sample_rate=rate,
            still_until_ns=None if still_s is None else T0 + int(still_s * SECOND),
            omega_ie_n=np.array([1e-3, 0.0, 1e-3]) if earth else None,
        )
        attitude = AttitudeRun(START, chosen)
        solution = concatenate(list(attitude.run(blocks)))
        return solution, (attitude.updates, attitude.missed_rotation)

    def blocks():
        at = 0
        for size in [*sizes, 400]:
            if at < 400:
                yield imu.rows(slice(at, at + size))
            at += size

    (one, numbers), (many, same) = out([imu]), out(blocks())
    assert numbers == same
    for column in ("time_ns", "log_time_ns", "q_nb", "omega_ib_b", "specific_force_b"):
        assert getattr(one, column).tobytes() == getattr(many, column).tobytes()
    assert numbers[0] == len(one)
    np.testing.assert_allclose(np.linalg.norm(one.q_nb, axis=1), 1.0, atol=1e-14)
    # every segment begins and ends with an attitude
    ends = {0, 399, *(g for g in gaps), *(g - 1 for g in gaps)}
    assert {int(times[k]) for k in ends} <= set(one.time_ns.tolist())


# -- refusals and what is lost ---------------------------------------------------------------


def test_lost_samples_are_reported(tmp_path):
    gyro, accel = resting(1000)
    gyro[500] = np.nan
    messages = imu_messages(even_times(1000), gyro, accel)
    messages[600] = messages[600]._replace(message=b"\x00\x01\x00\x00")
    summary = run(write_log(tmp_path / "in.mcap", messages), tmp_path / "out.mcap")
    assert lost(summary)
    counts = {name: summary["lost"][name] for name in ("parts", "malformed", "not_finite", "late")}
    assert counts == {"parts": [], "malformed": 1, "not_finite": 1, "late": 0}
    assert summary["imu"]["dropped"] == 2
    assert len(read_topic(tmp_path / "out.mcap", "/sinstool/attitude")) == 998
    clean = imu_log(tmp_path / "b.mcap", even_times(1000), *resting(1000))
    assert not lost(run(clean, tmp_path / "b.out.mcap"))


def test_results_are_not_processed_again(tmp_path):
    path = simulated(tmp_path / "in.mcap", cone())
    once = tmp_path / "once.mcap"
    run(path, once, align=FIXED)
    with pytest.raises(OutputError, match=r"holds results of sinstool.*--only-results"):
        run(once, tmp_path / "twice.mcap", align=FIXED)
    again = tmp_path / "again.mcap"
    run(once, again, align=FIXED, output={"only_results": True})
    np.testing.assert_array_equal(read_attitude(again)[1], read_attitude(once)[1])


def test_a_failing_run_leaves_nothing(tmp_path, monkeypatch):
    path = simulated(tmp_path / "in.mcap", cone())
    out = tmp_path / "out.mcap"
    out.write_bytes(b"older")

    def broken(self):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(result.Copier, "finish", broken)
    with pytest.raises(OutputError, match="No space left"):
        run(path, out, align=FIXED, output={"overwrite": True})
    assert out.read_bytes() == b"older"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in.mcap", "out.mcap"]


def test_a_frame_keeps_its_one_parent(tmp_path):
    from tests.helpers.imulogs import Message, header, store

    types = store().types
    vector = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    transform = types["geometry_msgs/msg/Transform"](
        vector, types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    )

    def tf(child):
        stamped = types["geometry_msgs/msg/TransformStamped"](
            header(T0, "base_link"), child, transform
        )
        message = types["tf2_msgs/msg/TFMessage"]([stamped])
        return Message("/tf_static", "tf2_msgs/msg/TFMessage", T0, message)

    imu = imu_messages(even_times(400), *resting(400))
    options = {"emit": ["attitude", "tf"]}
    bound = write_log(tmp_path / "a.mcap", [tf("lidar"), tf("/imu_link"), *imu])
    summary = run(bound, tmp_path / "a.out.mcap", output=options)
    assert summary["output"]["topics"] == ["/sinstool/attitude"]
    assert any("imu_link has the parent base_link" in w for w in summary["warnings"])
    free = write_log(tmp_path / "b.mcap", [tf("lidar"), *imu])
    summary = run(free, tmp_path / "b.out.mcap", output=options)
    assert summary["output"]["topics"] == ["/sinstool/attitude", "/tf"]


def test_an_imu_of_one_sample(tmp_path):
    path = imu_log(tmp_path / "in.mcap", even_times(1), [0.0, 0.0, 0.0], [0.0, 0.0, G])
    summary = run(path, tmp_path / "out.mcap")
    assert summary["output"]["attitudes"] == 1
    assert read_attitude(tmp_path / "out.mcap")[0].tolist() == [T0]
