"""Reference attitudes from every type that holds one, and from CSV files."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sinstool.core.errors import LogError, TopicError
from sinstool.io.readers import open_log
from sinstool.io.readers.truth import at_times, read_truth
from tests.helpers.imulogs import (
    IMU,
    T0,
    Message,
    even_times,
    handheld,
    header,
    imu_messages,
    in_log_axes,
    store,
    write_log,
)

N = 50
TIMES = even_times(N, 100.0, T0 + 123_456_789)


@pytest.fixture(scope="module")
def q_nb():
    rng = np.random.default_rng(8)
    turned = Rotation.from_rotvec(np.cumsum(0.1 * rng.standard_normal((N, 3)), axis=0))
    return turned.as_quat(scalar_first=True)


def truth_messages(kind, q_xyzw, times=TIMES):
    types = store().types
    quaternion = types["geometry_msgs/msg/Quaternion"]
    point = types["geometry_msgs/msg/Point"](0.0, 0.0, 0.0)
    pose, zero = types["geometry_msgs/msg/Pose"], types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    if kind == IMU:
        return imu_messages(times, 0.0, 0.0, q_xyzw=q_xyzw, covariance=1.0, topic="/truth")
    out = []
    for t, q in zip(times, q_xyzw, strict=True):
        turned = quaternion(*map(float, q))
        if kind == "geometry_msgs/msg/QuaternionStamped":
            message = types[kind](header=header(t), quaternion=turned)
        elif kind == "geometry_msgs/msg/PoseStamped":
            message = types[kind](header=header(t), pose=pose(point, turned))
        else:
            with_covariance = types["geometry_msgs/msg/PoseWithCovariance"]
            twist = types["geometry_msgs/msg/TwistWithCovariance"]
            still = types["geometry_msgs/msg/Twist"](zero, zero)
            message = types[kind](
                header=header(t),
                child_frame_id="base",
                pose=with_covariance(pose(point, turned), np.zeros(36)),
                twist=twist(still, np.zeros(36)),
            )
        out.append(Message("/truth", kind, int(t), message))
    return out


def angle(q, other):
    turned = Rotation.from_quat(q, scalar_first=True).inv()
    return (turned * Rotation.from_quat(other, scalar_first=True)).magnitude().max()


@pytest.mark.parametrize("axes", ["flu", "frd"])
@pytest.mark.parametrize(
    "kind",
    [
        IMU,
        "geometry_msgs/msg/QuaternionStamped",
        "geometry_msgs/msg/PoseStamped",
        "nav_msgs/msg/Odometry",
    ],
)
def test_topics_of_every_type(tmp_path, q_nb, kind, axes):
    said = in_log_axes(q_nb, axes, "enu" if axes == "flu" else "ned").as_quat()
    path = write_log(tmp_path / "log.mcap", truth_messages(kind, said))
    with open_log(path) as log:
        times, result = read_truth(log, "/truth", axes)
    assert np.array_equal(times, TIMES)
    assert angle(result, q_nb) < 1e-12


def test_order_repeats_and_nonsense_are_sorted_out(tmp_path, q_nb):
    said = in_log_axes(q_nb).as_quat()
    said[7] = 0.0
    said[9] = np.nan
    said[11] *= 1.01  # not quite of unit length, as floats are
    shuffled = np.random.default_rng(0).permutation(N)
    messages = truth_messages("geometry_msgs/msg/PoseStamped", said[shuffled], TIMES[shuffled])
    again = truth_messages("geometry_msgs/msg/PoseStamped", said[:3], TIMES[:3])
    path = write_log(tmp_path / "log.mcap", messages + again)
    with open_log(path) as log:
        times, result = read_truth(log, "/truth", "flu")
    rows = np.delete(np.arange(N), [7, 9])
    assert np.array_equal(times, TIMES[rows])
    assert angle(result, q_nb[rows]) < 1e-12
    np.testing.assert_allclose(np.linalg.norm(result, axis=1), 1.0, atol=1e-15)


@pytest.fixture
def log(tmp_path):
    gyro, accel, _ = handheld(100)
    path = write_log(tmp_path / "imu.mcap", imu_messages(even_times(100), gyro, accel))
    with open_log(path) as opened:
        yield opened


@pytest.mark.parametrize("mark", ["", "\ufeff"], ids=["plain", "with a byte order mark"])
@pytest.mark.parametrize("clock", ["time_s", "time_ns"])
def test_csv(tmp_path, log, q_nb, clock, mark):
    said = in_log_axes(q_nb).as_quat()
    rows = [*([] if mark else ["# a comment"]), f"{mark}{clock}, x, qx, qy, qz, qw"]
    for t, (x, y, z, w) in zip(TIMES.tolist(), said.tolist(), strict=True):
        when = str(t) if clock == "time_ns" else f"{t // 10**9}.{t % 10**9:09d}"
        rows += [f"{when}, 5, {x!r}, {y!r}, {z!r}, {w!r}", ""]
    path = tmp_path / "truth.csv"
    path.write_text("\n".join(rows), "utf-8")
    times, result = read_truth(log, str(path), "flu")
    # to the nanosecond, which a float64 of seconds since 1970 is not
    assert np.array_equal(times, TIMES)
    assert angle(result, q_nb) < 1e-12


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,qw,qx,qy\n0,1,0,0\n", "no column qz"),
        ("t,qw,qx,qy,qz\n0,1,0,0,0\n", "no column time_s or time_ns"),
        ("time_s,qw,qx,qy,qz\n0,1,0,0,0\n1,a,0,0,0\n", "line 3 holds no numbers"),
        ("time_s,qw,qx,qy,qz\n0,1,0,0,0\nx,1,0,0,0\n", "line 3 holds no numbers"),
        ("time_s,qw,qx,qy,qz\n0,1,0,0,0\n1,1\n", "fewer than two attitudes|holds no numbers"),
        ("time_s,qw,qx,qy,qz\n", "fewer than two attitudes"),
        ("time_s,qw,qx,qy,qz\n0,1,0,0,0\n1,,,,\n", "fewer than two attitudes"),
        ("", "no column qw"),
        ("time_s,qw,qx,qy,qz\n0,1,0,0,0\nInfinity,1,0,0,0\n", "line 3 holds no numbers"),
        ("time_s,qw,qx,qy,qz\n0,1,0,0,0\n1e30,1,0,0,0\n", "line 3 holds a time that no log has"),
        (f"time_ns,qw,qx,qy,qz\n{2**63},1,0,0,0\n", "line 2 holds a time that no log has"),
        ("time_s,qw,qx,qy,qz\n0,1,0,0," + "0" * 200_000 + "\n", "line 2 cannot be read"),
        (b"time_s,qw,qx,qy,qz\n\xff\xfe", "is not text"),
    ],
)
def test_csv_that_is_none(tmp_path, log, text, message):
    path = tmp_path / "truth.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(LogError, match=message):
        read_truth(log, str(path), "flu")


def test_no_such_truth_and_a_topic_without_attitude(tmp_path, log):
    with pytest.raises(TopicError, match="neither a topic of the log nor a file"):
        read_truth(log, "/nope", "flu")
    types = store().types
    pressure = types["sensor_msgs/msg/FluidPressure"](header(T0), 1.0, 0.0)
    messages = [Message("/baro", "sensor_msgs/msg/FluidPressure", T0, pressure)]
    path = write_log(tmp_path / "baro.mcap", messages)
    with (
        open_log(path) as other,
        pytest.raises(TopicError, match=r"is sensor_msgs/.*FluidPressure: .* nav_msgs/Odometry"),
    ):
        read_truth(other, "/baro", "flu")


def test_between_instants_it_turns_evenly_the_short_way():
    axis = np.array([0.0, 0.6, -0.8])
    times = T0 + 10_000_000 * np.arange(6)
    rates = 3.0
    q = Rotation.from_rotvec(rates * 0.01 * np.arange(6)[:, None] * axis).as_quat(scalar_first=True)
    q[2::2] *= -1.0  # the same attitudes
    target = T0 + np.array([0, 3_333_333, 10_000_000, 27_000_001, 50_000_000])
    actual = at_times(times, q, target)
    turned = rates * (target - T0) * 1e-9
    expected = Rotation.from_rotvec(turned[:, None] * axis).as_quat(scalar_first=True)
    assert angle(actual, expected) < 1e-12
    assert np.array_equal(actual[2], q[1])
    assert at_times(times, q, target[:0]).shape == (0, 4)
