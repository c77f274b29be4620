from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sinstool.core.streams import Imu, concatenate
from sinstool.core.timeline import reblock
from sinstool.io.readers import open_log
from sinstool.io.readers.streams import (
    ImuUnits,
    Losses,
    first_fix,
    frame_id,
    read_fixes,
    read_imu,
    read_joint,
    read_pressure,
    read_velocity,
)
from tests.helpers.imulogs import (
    ENU_NED,
    FLU_FRD,
    T0,
    Message,
    even_times,
    header,
    imu_messages,
    store,
    write_bag,
    write_log,
)

N = 40
TIMES = even_times(N)
LOG = TIMES + 3_000_000


def write(tmp_path, kind, make):
    """A log of messages that ``make(k, types, header)`` makes: ROS 2 MCAP, or ROS 1 MCAP or bag."""
    ros = 2 if kind == "ros2" else 1
    types = store(ros).types
    made = [make(k, types, header(TIMES[k], "sensor", ros)) for k in range(N)]
    messages = [Message("/t", m.__msgtype__, int(LOG[k]), m) for k, m in enumerate(made)]
    if kind == "bag":
        return write_bag(tmp_path / "a.bag", messages)
    return write_log(tmp_path / f"{kind}.mcap", messages, ros)


KINDS = pytest.mark.parametrize("kind", ["ros2", "ros1", "bag"])


def read(path, function, *options):
    losses = Losses()
    with open_log(path) as log:
        out = concatenate(list(function(log, log.channels_of("/t"), *options, losses)))
    assert (losses.malformed, losses.nonfinite, losses.problem) == (0, 0, "")
    np.testing.assert_array_equal(out.time_ns, TIMES)
    np.testing.assert_array_equal(out.log_time_ns, LOG)
    return out


rng = np.random.default_rng(5)
VECTORS = rng.normal(size=(N, 3))
MATRICES = rng.normal(size=(N, 3, 3))
NUMBERS = rng.normal(size=N)


def vector(types, k):
    return types["geometry_msgs/msg/Vector3"](*map(float, VECTORS[k]))


@KINDS
@pytest.mark.parametrize("axes", ["flu", "frd"])
def test_imu(tmp_path, kind, axes):
    ros = 2 if kind == "ros2" else 1
    q = Rotation.random(N, rng=np.random.default_rng(1))
    messages = imu_messages(
        TIMES, VECTORS, 10 * VECTORS, LOG, q.as_quat(), 0.0, topic="/t", ros=ros
    )
    if kind == "bag":
        path = write_bag(tmp_path / "a.bag", messages)
    else:
        path = write_log(tmp_path / "a.mcap", messages, ros)
    with open_log(path) as log:
        channels = log.channels_of("/t")
        losses = Losses()
        units = ImuUnits(axes, 2.0, 3.0)
        out = concatenate(list(read_imu(log, channels, units, losses, orientation=True)))
        on_log_time = concatenate(list(read_imu(log, channels, units, losses, log_time=True)))
    flip = FLU_FRD if axes == "flu" else Rotation.identity()
    np.testing.assert_allclose(out.gyro, 2 * flip.apply(VECTORS), rtol=1e-12)
    np.testing.assert_allclose(out.accel, 30 * flip.apply(VECTORS), rtol=1e-12)
    np.testing.assert_array_equal(out.time_ns, TIMES)
    np.testing.assert_array_equal(out.log_time_ns, LOG)
    expected = ENU_NED * q * FLU_FRD if axes == "flu" else q
    actual = Rotation.from_quat(out.orientation, scalar_first=True)
    assert (actual.inv() * expected).magnitude().max() < 1e-12
    np.testing.assert_array_equal(on_log_time.time_ns, LOG)
    assert on_log_time.orientation is None
    assert (losses.malformed, losses.nonfinite) == (0, 0)


NO_ORIENTATION = {
    "first of the covariance is -1": ((0.1, 0.2, 0.3, 0.9), -1.0),
    "all nine are -1": ((0.0, 0.0, 0.0, 1.0), np.full(9, -1.0)),
    "zero quaternion": ((0.0, 0.0, 0.0, 0.0), 0.0),
    "no rotation": ((0.5, 0.5, 0.5, 0.9), 0.0),
    "NaN": ((np.nan, 0.0, 0.0, 1.0), 0.0),
    "infinite": ((np.inf, 0.0, 0.0, 1.0), 0.0),
}


@pytest.mark.parametrize("name", NO_ORIENTATION)
def test_invalid_orientations(tmp_path, name):
    q, covariance = NO_ORIENTATION[name]
    messages = imu_messages(TIMES, VECTORS, VECTORS, LOG, q, covariance, topic="/t")
    # one that is valid amid them; not quite of unit length, as single precision writes it
    good = np.array([0.1, -0.2, 0.3, 0.9])
    good *= 1.0001 / np.linalg.norm(good)
    messages[7] = imu_messages(TIMES[7:8], VECTORS[7:8], VECTORS[7:8], LOG[7:8], good, 0.0, "/t")[0]
    out = read(write_log(tmp_path / "a.mcap", messages), _with_orientation)
    valid = np.isfinite(out.orientation).all(axis=1)
    assert np.flatnonzero(valid).tolist() == [7]
    assert np.isnan(out.orientation[~valid]).all()
    assert np.linalg.norm(out.orientation[7]) == pytest.approx(1.0, abs=1e-15)
    expected = ENU_NED * Rotation.from_quat(good) * FLU_FRD
    actual = Rotation.from_quat(out.orientation[7], scalar_first=True)
    assert (actual.inv() * expected).magnitude() < 1e-12


def _with_orientation(log, channels, losses):
    return read_imu(log, channels, ImuUnits(), losses, orientation=True)


def test_a_constant_identity_is_an_orientation_to_the_reader(tmp_path):
    """One message cannot tell; the survey, which sees them all, calls it a placeholder."""
    messages = imu_messages(TIMES, VECTORS, VECTORS, LOG, (0, 0, 0, 1), 0.0, topic="/t")
    out = read(write_log(tmp_path / "a.mcap", messages), _with_orientation)
    assert np.isfinite(out.orientation).all()


def test_orientation_is_read_for_as_long_as_it_is_wanted(tmp_path):
    messages = imu_messages(TIMES, VECTORS, VECTORS, LOG, (0, 0, 0, 1), 0.0, topic="/t")
    path = write_log(tmp_path / "a.mcap", messages)
    with open_log(path) as log:
        blocks = read_imu(
            log, log.channels_of("/t"), ImuUnits(), Losses(), orientation=lambda: False
        )
        assert np.isnan(concatenate(list(blocks)).orientation).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30, -1e200])
def test_rows_with_no_measurement_are_counted_and_left_out(tmp_path, bad):
    gyro, accel = VECTORS.copy(), VECTORS.copy()
    gyro[3, 1] = gyro[4, 0] = accel[4, 2] = accel[9, 0] = bad
    path = write_log(tmp_path / "a.mcap", imu_messages(TIMES, gyro, accel, topic="/t"))
    losses = Losses()
    with open_log(path) as log:
        out = concatenate(list(read_imu(log, log.channels_of("/t"), ImuUnits("frd"), losses)))
    keep = [k for k in range(N) if k not in (3, 4, 9)]
    assert losses.nonfinite == 3 and losses.malformed == 0
    np.testing.assert_array_equal(out.gyro, VECTORS[keep])
    np.testing.assert_array_equal(out.time_ns, TIMES[keep])


def test_malformed_rows_are_counted_and_left_out(tmp_path):
    messages = imu_messages(TIMES, VECTORS, VECTORS, topic="/t")
    whole = bytes(store(2).serialize_cdr(messages[0].message, messages[0].type_name))
    for k, payload in ((2, whole[:100]), (5, b""), (6, b"\x00\x01\x00\x00")):
        messages[k] = messages[k]._replace(message=payload)
    losses = Losses()
    with open_log(write_log(tmp_path / "a.mcap", messages)) as log:
        out = concatenate(list(read_imu(log, log.channels_of("/t"), ImuUnits("frd"), losses)))
    assert losses.malformed == 3 and losses.problem
    np.testing.assert_array_equal(out.gyro, np.delete(VECTORS, [2, 5, 6], axis=0))


@KINDS
def test_fixes(tmp_path, kind):
    def make(k, types, head):
        status = types["sensor_msgs/msg/NavSatStatus"](status=k % 4 - 1, service=1)
        return types["sensor_msgs/msg/NavSatFix"](
            header=head,
            status=status,
            latitude=40.0 + k,
            longitude=-100.0 - k,
            altitude=1000.0 + k,
            position_covariance=MATRICES[k].ravel(),
            position_covariance_type=k % 4,
        )

    out = read(write(tmp_path, kind, make), read_fixes)
    k = np.arange(N)
    np.testing.assert_allclose(np.degrees(out.latitude), 40.0 + k, rtol=1e-14)
    np.testing.assert_allclose(np.degrees(out.longitude), -100.0 - k, rtol=1e-14)
    np.testing.assert_array_equal(out.height, 1000.0 + k)
    np.testing.assert_array_equal(out.status, k % 4 - 1)
    np.testing.assert_array_equal(out.covariance_type, k % 4)
    turn = ENU_NED.as_matrix()
    for row in range(N):
        # the variance of east becomes that of the second axis
        assert out.covariance_n[row, 1, 1] == MATRICES[row, 0, 0]
        assert out.covariance_n[row, 0, 2] == -MATRICES[row, 1, 2]
        np.testing.assert_allclose(out.covariance_n[row], turn @ MATRICES[row] @ turn.T, atol=1e-12)


TWISTS = {
    "geometry_msgs/msg/TwistStamped": lambda types, head, twist: {"header": head, "twist": twist},
    "geometry_msgs/msg/TwistWithCovarianceStamped": lambda types, head, twist: {
        "header": head,
        "twist": types["geometry_msgs/msg/TwistWithCovariance"](
            twist=twist, covariance=np.arange(36.0)
        ),
    },
    "nav_msgs/msg/Odometry": lambda types, head, twist: {
        "header": head,
        "child_frame_id": "base_link",
        "pose": types["geometry_msgs/msg/PoseWithCovariance"](
            pose=types["geometry_msgs/msg/Pose"](
                position=types["geometry_msgs/msg/Point"](7.0, 8.0, 9.0),
                orientation=types["geometry_msgs/msg/Quaternion"](0.5, 0.5, 0.5, 0.5),
            ),
            covariance=np.arange(36.0),
        ),
        "twist": types["geometry_msgs/msg/TwistWithCovariance"](
            twist=twist, covariance=np.arange(36.0)
        ),
    },
}


@KINDS
@pytest.mark.parametrize("name", TWISTS)
def test_velocity(tmp_path, kind, name):
    def make(k, types, head):
        spin = types["geometry_msgs/msg/Vector3"](100.0, 200.0, 300.0)
        twist = types["geometry_msgs/msg/Twist"](linear=vector(types, k), angular=spin)
        return types[name](**TWISTS[name](types, head, twist))

    out = read(write(tmp_path, kind, make), read_velocity)
    np.testing.assert_allclose(out.velocity_n, ENU_NED.apply(VECTORS), rtol=1e-12)


@KINDS
def test_pressure(tmp_path, kind):
    def make(k, types, head):
        return types["sensor_msgs/msg/FluidPressure"](
            header=head, fluid_pressure=101325.0 + NUMBERS[k], variance=float(k)
        )

    out = read(write(tmp_path, kind, make), read_pressure)
    np.testing.assert_array_equal(out.pressure, 101325.0 + NUMBERS)
    np.testing.assert_array_equal(out.variance, np.arange(N))


@KINDS
def test_joint_by_name_wherever_it_stands(tmp_path, kind):
    def make(k, types, head):
        names = ["arm", "table", "wheel_" + "x" * (k % 3)]
        names = names[k % 3 :] + names[: k % 3]
        return types["sensor_msgs/msg/JointState"](
            header=head,
            name=names,
            position=np.array([NUMBERS[k] if n == "table" else 99.0 for n in names]),
            velocity=np.arange(float(k % 2)),
            effort=np.array([]),
        )

    out = read(write(tmp_path, kind, make), read_joint, "table")
    np.testing.assert_array_equal(out.position, NUMBERS)


def test_joints_without_the_name_or_without_positions_are_left_out(tmp_path):
    joint = store().types["sensor_msgs/msg/JointState"]

    def message(k, names, positions):
        body = joint(
            header=header(TIMES[k]),
            name=names,
            position=np.array(positions, float),
            velocity=np.array([]),
            effort=np.array([]),
        )
        return Message("/t", "sensor_msgs/msg/JointState", int(TIMES[k]), body)

    messages = [
        message(0, ["table"], [1.0]),
        message(1, ["table"], []),  # names alone: a controller without encoders
        message(2, ["arm"], [2.0]),
        message(3, ["arm", "table"], [3.0, 4.0]),
        message(4, [], []),
    ]
    losses = Losses()
    with open_log(write_log(tmp_path / "a.mcap", messages)) as log:
        out = concatenate(list(read_joint(log, log.channels_of("/t"), "table", losses)))
    assert out.position.tolist() == [1.0, 4.0]
    assert losses.malformed == 3


def fixes(tmp_path, rows):
    def make(k, types, head):
        latitude, longitude, altitude, status = rows[min(k, len(rows) - 1)]
        return types["sensor_msgs/msg/NavSatFix"](
            header=head,
            status=types["sensor_msgs/msg/NavSatStatus"](status=status, service=1),
            latitude=latitude,
            longitude=longitude,
            altitude=altitude,
            position_covariance=np.zeros(9),
            position_covariance_type=0,
        )

    path = write(tmp_path, "ros2", make)
    with open_log(path) as log:
        return first_fix(log, log.channels_of("/t"))


def test_the_first_fix_that_is_one(tmp_path):
    bad = [
        (47.0, 8.0, 400.0, -1),  # no fix
        (np.nan, 8.0, 400.0, 0),
        (0.0, 0.0, 0.0, 0),  # how receivers say that they know nothing
        (473_000_000.0, 80_000_000.0, 400.0, 0),  # 1e-7 degrees, as receivers send them
        (47.0, 8.0, 4e6, 0),  # damaged
    ]
    assert fixes(tmp_path, bad) is None
    result = fixes(tmp_path, [*bad, (48.5, 9.0, np.nan, 2), (1.0, 1.0, 1.0, 2)])
    assert len(result) == 1
    assert np.degrees(result.latitude[0]) == pytest.approx(48.5, abs=1e-12)
    assert result.time_ns[0] == TIMES[5]
    # one axis of zero is a place on the equator
    assert fixes(tmp_path, [(0.0, 9.0, 1.0, 0)]) is not None


@pytest.mark.parametrize("frame", ["", "imu_link", "/imu", "käfer"])
@pytest.mark.parametrize("ros", [1, 2])
def test_frame_id(tmp_path, frame, ros):
    messages = imu_messages(TIMES, VECTORS, VECTORS, topic="/t", frame=frame, ros=ros)
    messages[0] = messages[0]._replace(message=b"\x00\x01")  # the first that can be read counts
    with open_log(write_log(tmp_path / "a.mcap", messages, ros)) as log:
        assert frame_id(log, log.channels_of("/t")) == frame


@settings(max_examples=50)
@given(st.lists(st.integers(1, 30), max_size=20), st.integers(1, 40))
def test_reblock(sizes, rows):
    n = sum(sizes)
    column = np.arange(n, dtype=float)[:, None] + np.zeros(3)
    stream = Imu(np.arange(n) + T0, np.arange(n), column, -column)
    at = np.cumsum([0, *sizes])
    blocks = (stream.rows(slice(a, b)) for a, b in pairwise(at))
    out = list(reblock(blocks, rows))
    assert [len(b) for b in out] == [rows] * (n // rows) + ([n % rows] if n % rows else [])
    if n:
        joined = concatenate(out)
        np.testing.assert_array_equal(joined.time_ns, stream.time_ns)
        np.testing.assert_array_equal(joined.accel, stream.accel)
