import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sinstool.io.messages.decode import MAX_LAYOUTS, Decoder
from sinstool.io.messages.definitions import DefinitionError, parse_definition, schema_text
from sinstool.io.messages.encode import Encoder, standard_definition
from sinstool.io.messages.layout import LayoutError
from tests.io.messages.samples import (
    FLAVOURS,
    ROS2,
    TYPES,
    deserialise,
    encoding_of,
    fixed_paths,
    look_up,
    pack,
    random_message,
    same,
    serialise,
)

IMU = "sensor_msgs/msg/Imu"
JOINTS = "sensor_msgs/msg/JointState"
GYRO = [f"angular_velocity.{axis}" for axis in "xyz"]
ACCEL = [f"linear_acceleration.{axis}" for axis in "xyz"]
STAMP = {"sec": ["header.stamp.sec"], "nanosec": ["header.stamp.nanosec"]}


def decode(definition, columns, payloads, rng=None):
    decoder = Decoder(definition, columns)
    return decoder, decoder.decode(*pack(payloads, rng))


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize("name", TYPES)
@given(seed=st.integers(0, 2**32), count=st.integers(1, 12))
@settings(max_examples=15, deadline=None)
def test_columns_are_what_rosbags_reads(name, flavour, seed, count):
    rng = np.random.default_rng(seed)
    payloads = [serialise(random_message(name, flavour, rng), flavour) for _ in range(count)]
    definition = standard_definition(name, encoding_of(flavour))
    paths = fixed_paths(name, flavour)
    _, columns = decode(definition, {path: [path] for path in paths}, payloads, rng)
    assert columns.valid.all()
    for k, payload in enumerate(payloads):
        message = deserialise(payload, name, flavour)
        for path in paths:
            assert same(columns.values[path][k], look_up(message, path)), path


@pytest.mark.parametrize("flavour", FLAVOURS)
@given(
    frames=st.lists(st.text("abcdef_/", max_size=12), min_size=1, max_size=20),
    seed=st.integers(0, 2**32),
)
@settings(max_examples=30, deadline=None)
def test_frame_names_of_any_length_in_one_batch(flavour, frames, seed):
    rng = np.random.default_rng(seed)
    payloads, expected = [], []
    for frame in frames:
        message = random_message(IMU, flavour, rng)
        message.header.frame_id = frame
        payloads.append(serialise(message, flavour))
        expected.append(message)
    columns = {"gyro": GYRO, "accel": ACCEL, "cov": ["orientation_covariance"], **STAMP}
    _, out = decode(standard_definition(IMU, encoding_of(flavour)), columns, payloads, rng)
    assert out.valid.all()
    for k, message in enumerate(expected):
        g, a = message.angular_velocity, message.linear_acceleration
        assert same(out.values["gyro"][k], [g.x, g.y, g.z])
        assert same(out.values["accel"][k], [a.x, a.y, a.z])
        assert same(out.values["cov"][k], message.orientation_covariance)
        assert out.values["sec"][k] == message.header.stamp.sec
        assert out.values["nanosec"][k] == message.header.stamp.nanosec


def test_equal_length_does_not_mean_equal_layout():
    # The sum of two strings' lengths is the same, and so is the payload's, but not the layout.
    rng = np.random.default_rng(1)
    payloads, expected = [], []
    for frame, child in [("a" * 3, "b" * 19), ("a" * 11, "b" * 11), ("a" * 19, "b" * 3)] * 3:
        message = random_message("nav_msgs/msg/Odometry", "ros1", rng)
        message.header.frame_id, message.child_frame_id = frame, child
        payloads.append(serialise(message, "ros1"))
        expected.append(message.pose.pose.position.x)
    assert len({len(p) for p in payloads}) == 1
    # In CDR, names of 7 and 8 characters end at the same padded place with other lengths.
    definition = standard_definition("nav_msgs/msg/Odometry", "ros1")
    _, out = decode(definition, {"x": ["pose.pose.position.x"]}, payloads)
    assert out.valid.all()
    assert same(out.values["x"], expected)

    sevens = []
    for k in range(9):
        message = random_message(IMU, "cdr", rng)
        message.header.frame_id = "x" * (5 + k % 3)
        message.angular_velocity.x = float(k)
        sevens.append(serialise(message, "cdr"))
    assert len({len(p) for p in sevens}) < 3
    _, out = decode(standard_definition(IMU, "cdr"), {"x": GYRO[:1]}, sevens)
    assert out.values["x"].tolist() == list(range(9))


@pytest.mark.parametrize("flavour", FLAVOURS)
@given(seed=st.integers(0, 2**32))
@settings(max_examples=25, deadline=None)
def test_joint_is_found_by_name_wherever_it_stands(flavour, seed):
    rng = np.random.default_rng(seed)
    payloads, expected = [], []
    for _ in range(30):
        message = random_message(JOINTS, flavour, rng)
        count = int(rng.integers(0, 5))
        names = [str(n) for n in rng.permutation(["table", "arm", "tabl", "tablee", "x"])[:count]]
        message.name = names
        message.position = rng.normal(size=count if rng.random() < 0.9 else 0)
        payloads.append(serialise(message, flavour))
        place = names.index("table") if "table" in names else 99
        expected.append(message.position[place] if place < len(message.position) else None)
    definition = standard_definition(JOINTS, encoding_of(flavour))
    columns = {"angle": ["position[name=table]"], **STAMP}
    decoder, out = decode(definition, columns, payloads)
    assert out.valid.tolist() == [w is not None for w in expected]
    assert same(out.values["angle"], [0.0 if w is None else w for w in expected])
    assert out.values["sec"].dtype == (np.uint32 if flavour == "ros1" else np.int32)
    assert ("position[name=table]" in decoder.problem) == (None in expected)


def test_more_layouts_than_are_kept():
    rng = np.random.default_rng(3)
    payloads, expected = [], []
    for k in range(3 * MAX_LAYOUTS):
        message = random_message(JOINTS, "cdr", rng)
        message.header.frame_id = "f" * (k % 5)
        message.name = [f"joint_{i}" for i in range(k)] + ["table"]
        message.position = rng.normal(size=k + 1)
        payloads += [serialise(message, "cdr")] * 2
        expected += [(message.header.stamp.sec, message.position[k])] * 2
    columns = {"angle": ["position[name=table]"], "sec": ["header.stamp.sec"]}
    decoder = Decoder(standard_definition(JOINTS, "cdr"), columns)
    for _ in range(2):  # the second batch meets a full set of layouts
        out = decoder.decode(*pack(payloads))
        assert out.valid.all()
        assert out.values["sec"].tolist() == [w[0] for w in expected]
        assert out.values["angle"].tolist() == [w[1] for w in expected]


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize("name", TYPES)
def test_truncated_payloads_are_invalid_rows(name, flavour):
    rng = np.random.default_rng(4)
    whole = serialise(random_message(name, flavour, rng, (1, 2), (4, 5)), flavour)
    cuts = [whole[:n] for n in range(len(whole))]
    path = next(iter(fixed_paths(name, flavour)), "transforms[0].transform.rotation.w")
    definition = standard_definition(name, encoding_of(flavour))
    decoder, out = decode(definition, {"a": [path]}, [*cuts, whole])
    assert not out.valid[:-1].any()
    assert out.valid[-1]
    assert decoder.problem


@given(junk=st.lists(st.binary(max_size=200), min_size=1, max_size=10))
@settings(max_examples=100, deadline=None)
def test_junk_never_raises(junk):
    for name in (IMU, JOINTS, "tf2_msgs/msg/TFMessage", "diagnostic_msgs/msg/DiagnosticArray"):
        for encoding in ("cdr", "ros1"):
            definition = standard_definition(name, encoding)
            path = "transforms[0].header.stamp.sec" if "TF" in name else "header.stamp.sec"
            out = decode(definition, {"a": [path]}, [b"\0\1\0\0" + j for j in junk])[1]
            assert len(out.valid) == len(junk)


def test_columns_keep_their_type_without_a_single_good_message():
    columns = {"gyro": GYRO, "cov": ["orientation_covariance"], **STAMP}
    _, out = decode(standard_definition(IMU, "cdr"), columns, [b"", b"\0\1\0\0", b"junk"])
    assert not out.valid.any()
    assert out.values["gyro"].shape == (3, 3)
    assert out.values["cov"].shape == (3, 9)
    assert out.values["sec"].dtype == np.int32
    assert out.values["nanosec"].dtype == np.uint32


def test_a_first_batch_without_the_joint_spoils_nothing():
    def joints(names):
        message = random_message(JOINTS, "cdr", np.random.default_rng(5))
        message.name, message.position = names, np.arange(len(names), dtype=float)
        return serialise(message, "cdr")

    columns = {"angle": ["position[name=table]"], "sec": ["header.stamp.sec"]}
    decoder = Decoder(standard_definition(JOINTS, "cdr"), columns)
    assert not decoder.decode(*pack([joints(["arm"])])).valid.any()
    assert not decoder.decode(*pack([joints([])])).valid.any()
    out = decoder.decode(*pack([joints(["arm"]), joints(["arm", "table"])]))
    assert out.valid.tolist() == [False, True]
    assert out.values["angle"].tolist() == [0.0, 1.0]


@pytest.mark.parametrize("head", [b"\0\x06", b"\0\x07", b"\0\x02", b"\0\x03", b"\x01\x00"])
def test_other_encapsulations_are_refused_by_name(head):
    payload = serialise(random_message(IMU, "cdr", np.random.default_rng(6)), "cdr")
    decoder, out = decode(standard_definition(IMU, "cdr"), {"g": GYRO}, [head + payload[2:]])
    assert not out.valid.any()
    assert "encapsulation" in decoder.problem


def test_imu_inside_a_type_of_ones_own():
    text, _ = ROS2.generate_msgdef(IMU, ros_version=2)
    schema = (
        "# a device's own message\n"
        "uint8 MODE_FAST = 3 # a constant\n"
        'string<=8 label "none"\n'
        "sensor_msgs/Imu imu\n"
        "int8 status -2\n" + "=" * 80 + "\nMSG: sensor_msgs/Imu\n" + text
    )
    definition = parse_definition("acme_msgs/msg/Device", "ros2msg", schema, "cdr")
    assert list(definition.paths_of(IMU)) == ["imu"]
    rng = np.random.default_rng(7)
    imu = random_message(IMU, "cdr", rng)
    inner = serialise(imu, "cdr")[4:]
    # "label" takes 4 + 4 bytes, so what follows keeps its alignment
    payload = b"\0\1\0\0" + b"\x04\0\0\0abc\0" + inner + b"\xfe"
    columns = {"gyro": [f"imu.{p}" for p in GYRO], "status": ["status"]}
    _, out = decode(definition, columns, [payload])
    assert out.valid.all()
    g = imu.angular_velocity
    assert same(out.values["gyro"][0], [g.x, g.y, g.z])
    assert out.values["status"][0] == -2


def test_columns_of_mixed_types_are_the_callers_mistake():
    payload = serialise(random_message(IMU, "cdr", np.random.default_rng(8)), "cdr")
    with pytest.raises(LayoutError, match="mixes"):
        decode(standard_definition(IMU, "cdr"), {"x": ["header.stamp.sec", GYRO[0]]}, [payload])


def test_empty_schema_falls_back_on_the_standard_type():
    payload = serialise(random_message(IMU, "cdr", np.random.default_rng(9)), "cdr")
    definition = parse_definition(IMU, "ros2msg", "", "cdr")
    assert decode(definition, {"g": GYRO}, [payload])[1].valid.all()
    ros1 = parse_definition("sensor_msgs/Imu", "ros1msg", "", "ros1")
    payload = serialise(random_message(IMU, "ros1", np.random.default_rng(9)), "ros1")
    assert decode(ros1, {"g": GYRO}, [payload])[1].valid.all()
    with pytest.raises(DefinitionError, match="no definition of acme_msgs/msg/Thing"):
        parse_definition("acme_msgs/msg/Thing", "ros2msg", "", "cdr")


def test_batches_of_one_and_of_all_agree():
    rng = np.random.default_rng(10)
    payloads = [serialise(random_message(IMU, "cdr", rng), "cdr") for _ in range(50)]
    whole = decode(standard_definition(IMU, "cdr"), {"g": GYRO}, payloads)[1]
    decoder = Decoder(standard_definition(IMU, "cdr"), {"g": GYRO})
    for k, payload in enumerate(payloads):
        assert same(decoder.decode(*pack([payload])).values["g"][0], whole.values["g"][k])


def test_no_messages_at_all():
    _, out = decode(standard_definition(IMU, "cdr"), {"g": GYRO}, [])
    assert out.values["g"].shape == (0, 3)
    assert Encoder(IMU, "cdr").encode({GYRO[0]: np.zeros((0, 3))}, 0).shape[0] == 0


def test_schema_texts_parse_back_to_the_same_fields():
    for name in TYPES:
        for encoding, flavour in (("cdr", "ros2msg"), ("ros1", "ros1msg")):
            text = schema_text(name, encoding)
            assert parse_definition(name, flavour, text, encoding).types
            assert parse_definition(name, flavour, text, encoding) == parse_definition(
                name, flavour, "", encoding
            )
