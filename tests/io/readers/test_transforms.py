"""The mount of an IMU, and the place of an antenna, from a log's static transforms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sinstool.io.readers import open_log
from sinstool.io.readers.transforms import in_vehicle, position_in, tf_parent
from tests.helpers.imulogs import (
    T0,
    Message,
    even_times,
    header,
    imu_messages,
    resting,
    store,
    write_log,
)


def static(*rows, topic="/tf_static"):
    """A message of transforms: parent, child, a rotation, and where the child is."""
    types = store().types
    transforms = []
    for parent, child, rotation, *place in rows:
        where = place[0] if place else (0.1, 0.2, 0.3)
        x, y, z, w = (float(v) for v in rotation)
        transforms.append(
            types["geometry_msgs/msg/TransformStamped"](
                header(T0, parent),
                child,
                types["geometry_msgs/msg/Transform"](
                    types["geometry_msgs/msg/Vector3"](*map(float, where)),
                    types["geometry_msgs/msg/Quaternion"](x, y, z, w),
                ),
            )
        )
    kind = "tf2_msgs/msg/TFMessage"
    return Message(topic, kind, T0, types[kind](transforms))


def found(folder, *messages, suffix="mcap"):
    imu = imu_messages(even_times(20), *resting(20))
    with open_log(write_log(folder / f"log.{suffix}", [*messages, *imu])) as log:
        return in_vehicle(log, "imu_link"), tf_parent(log, "imu_link")


NONE = (0.0, 0.0, 0.0, 1.0)
ANGLES = st.floats(-3.0, 3.0)


@settings(max_examples=25, deadline=None)
@given(first=st.tuples(ANGLES, ANGLES, ANGLES), second=st.tuples(ANGLES, ANGLES, ANGLES))
def test_a_chain_is_the_product_of_its_rotations(tmp_path_factory, first, second):
    outer, inner = Rotation.from_rotvec(first), Rotation.from_rotvec(second)
    mount, parent = found(
        tmp_path_factory.mktemp("tf"),
        static(("/base_link", "sensors", outer.as_quat()), ("map", "base_link", NONE)),
        static(("sensors", "/imu_link", inner.as_quat()), ("sensors", "lidar", NONE)),
    )
    assert (mount.vehicle, parent) == ("base_link", "sensors")
    w, *v = mount.q
    off = Rotation.from_quat([*v, w]).inv() * outer * inner
    assert off.magnitude() < 1e-12


@pytest.mark.parametrize("suffix", ["bag", "db3"])
def test_every_format_has_it(tmp_path, suffix):
    turn = Rotation.from_euler("z", 90.0, degrees=True)
    mount, _ = found(
        tmp_path, static(("base_footprint", "imu_link", turn.as_quat())), suffix=suffix
    )
    assert mount.vehicle == "base_footprint"
    assert np.allclose(mount.q, [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])


@pytest.mark.parametrize(
    "rows",
    [
        [("odom", "imu_link", NONE)],
        [("a", "imu_link", NONE), ("imu_link", "a", NONE)],
        [("imu_link", "imu_link", NONE)],
        [("base_link", "imu_link", (0.0, 0.0, 0.0, 0.0))],
        [("base_link", "imu_link", (np.nan, 0.0, 0.0, 1.0))],
        [("base_link", "lidar", NONE)],
        [],
    ],
)
def test_nothing_is_made_up(tmp_path, rows):
    assert found(tmp_path, static(*rows))[0] is None


def placed(folder, *rows, child="gps", topic="/tf_static"):
    imu = imu_messages(even_times(20), *resting(20))
    with open_log(write_log(folder / "log.mcap", [static(*rows, topic=topic), *imu])) as log:
        return position_in(log, child, "imu_link")


VECTORS = st.tuples(ANGLES, ANGLES, ANGLES)


@settings(max_examples=25, deadline=None)
@given(
    turns=st.lists(VECTORS, min_size=4, max_size=4), at=st.lists(VECTORS, min_size=4, max_size=4)
)
def test_a_place_is_seen_from_another_branch_of_the_tree(tmp_path_factory, turns, at):
    q = [Rotation.from_rotvec(turn) for turn in turns]
    names = [("base", "deck"), ("deck", "imu_link"), ("/base", "mast"), ("mast", "/gps")]
    rows = [(*two, r.as_quat(), p) for two, r, p in zip(names, q, at, strict=True)]
    found = placed(tmp_path_factory.mktemp("tf"), ("map", "base", NONE), *rows)
    # From the antenna to the base, and from there to the IMU
    in_base = q[2].apply(at[3]) + at[2]
    right = q[1].inv().apply(q[0].inv().apply(in_base - at[0]) - at[1])
    np.testing.assert_allclose(found, right, atol=1e-12)


def test_a_place_in_the_imu_itself_needs_no_common_frame(tmp_path):
    place = (0.4, -0.1, 1.2)
    np.testing.assert_allclose(placed(tmp_path, ("imu_link", "gps", NONE, place)), place)


def test_a_place_in_the_parent_of_the_imu(tmp_path):
    half_turn, place = (0.0, 0.0, 1.0, 0.0), (0.4, -0.1, 1.2)
    np.testing.assert_allclose(
        placed(tmp_path, ("gps", "imu_link", half_turn, place)),
        (0.4, -0.1, -1.2),
        atol=1e-15,
    )


@pytest.mark.parametrize(
    "rows",
    [
        [("base_link", "imu_link", NONE), ("other", "gps", NONE)],
        [("base_link", "gps", NONE)],
        [("imu_link", "gps", (0.0, 0.0, 0.0, 0.0))],
        [("a", "gps", NONE), ("gps", "a", NONE)],
        [],
    ],
)
def test_no_place_without_a_chain(tmp_path, rows):
    assert placed(tmp_path, *rows) is None


def test_moving_transforms_place_nothing(tmp_path):
    assert placed(tmp_path, ("imu_link", "gps", NONE), topic="/tf") is None


def test_moving_transforms_are_no_mount(tmp_path):
    moving = static(("base_link", "imu_link", NONE), topic="/tf")
    assert found(tmp_path, moving) == (None, "base_link")
