"""The mount of an IMU from a log's static transforms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sinstool.io.readers import open_log
from sinstool.io.readers.transforms import in_vehicle, tf_parent
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
    """A message of transforms: parent, child and a rotation."""
    types = store().types
    transforms = []
    for parent, child, rotation in rows:
        x, y, z, w = (float(v) for v in rotation)
        transforms.append(
            types["geometry_msgs/msg/TransformStamped"](
                header(T0, parent),
                child,
                types["geometry_msgs/msg/Transform"](
                    types["geometry_msgs/msg/Vector3"](0.1, 0.2, 0.3),
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


def test_moving_transforms_are_no_mount(tmp_path):
    moving = static(("base_link", "imu_link", NONE), topic="/tf")
    assert found(tmp_path, moving) == (None, "base_link")
