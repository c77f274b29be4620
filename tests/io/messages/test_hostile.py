"""Definitions that are made to cost time or memory, or that say of a known type what it is not."""

import numpy as np
import pytest

from sinstool.core.errors import UnsupportedLogError
from sinstool.io.messages.decode import Decoder
from sinstool.io.messages.definitions import DefinitionError, parse_definition
from sinstool.io.messages.layout import LayoutError, walk
from sinstool.io.readers import open_log
from sinstool.io.readers.streams import ImuUnits, Losses, read_fixes, read_imu
from tests.helpers.logs import IMU, definition, payload_of, write_mcap

SEAM = "=" * 80 + "\nMSG: "
FIX = "sensor_msgs/msg/NavSatFix"


def chain(levels, fields=1, last="uint8 x"):
    """Types in a row, each with a number of fields of the next."""
    parts = []
    for k in range(levels):
        lines = "\n".join(f"a_msgs/T{k + 1} f{i}" for i in range(fields))
        parts.append((f"a_msgs/T{k}", lines if k < levels - 1 else last))
    first = parts[0][1]
    return "\n".join([first, *(f"{SEAM}{name}\n{text}" for name, text in parts[1:])])


def test_types_that_double_at_every_level():
    for last in ("uint8 x", "uint8 ONE=1"):  # the second takes no bytes in ROS 1
        result = parse_definition("a_msgs/msg/T0", "ros1msg", chain(30, 2, last), "ros1")
        assert list(result.paths_of(IMU)) == []
        assert len(list(result.paths_of("a_msgs/msg/T29"))) == 64
        with pytest.raises(LayoutError):
            walk(result, bytes(100))


@pytest.mark.parametrize("levels", [40, 1000])
def test_types_that_nest_too_deep(levels):
    with pytest.raises(DefinitionError, match=r"nest|parsed"):
        parse_definition("a_msgs/msg/T0", "ros2msg", chain(levels), "cdr")


def test_a_schema_of_megabytes():
    with pytest.raises(DefinitionError, match="characters"):
        parse_definition("a_msgs/msg/T0", "ros2msg", "uint8 x\n" * 2**18, "cdr")


def test_a_schema_encoding_that_is_not_read():
    with pytest.raises(DefinitionError, match="unsupported schema encoding 'omgidl'"):
        parse_definition(IMU, "omgidl", "struct X {};", "cdr")
    assert parse_definition(IMU, "unknown", "", "cdr").types  # rosbag2's for a text that is missing


@pytest.mark.parametrize("count", [10**5, 10**9])
def test_arrays_too_long_for_a_column(count):
    result = parse_definition("a_msgs/msg/T", "ros2msg", f"float64[{count}] x", "cdr")
    with pytest.raises(LayoutError, match=f"x has {count} elements"):
        Decoder(result, {"x": ["x"]})
    result = parse_definition("a_msgs/msg/T", "ros2msg", "float64[] x", "cdr")
    payload = b"\0\1\0\0" + np.uint32(20000).tobytes() + bytes(4 + 160000)
    decoder = Decoder(result, {"x": ["x"]})
    columns = decoder.decode(
        np.frombuffer(payload, np.uint8), np.array([0]), np.array([len(payload)])
    )
    assert not columns.valid.any() and "160000 bytes" in decoder.problem


def log_of(path, name, text, count=3):
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema(name, "ros2msg", text.encode())
        channel = writer.register_channel("/x", "cdr", schema)
        for k in range(count):
            payload = b"\0\1\0\0" + bytes(4096)
            writer.add_message(channel, k, payload[: 4 + size_of(name, text)], k)
        writer.finish()
    return path


def size_of(name, text):
    result = parse_definition(name, "ros2msg", text, "cdr")
    for size in range(4096):
        try:
            walk(result, b"\0\1\0\0" + bytes(size))
        except LayoutError:
            continue
        return size
    raise AssertionError("no size fits")


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("float64[9] orientation_covariance", "float64[4] orientation_covariance", "4 elements"),
        ("float64[9] orientation_covariance", "float64 orientation_covariance", "1 elements"),
        ("float64 x\nfloat64 y", "float32 x\nfloat64 y", "mixes the types"),
    ],
)
def test_an_imu_that_is_none(tmp_path, old, new, match):
    text = definition(IMU)[0]
    assert old in text
    path = log_of(tmp_path / "a.mcap", IMU, text.replace(old, new))
    with open_log(path) as log, pytest.raises(UnsupportedLogError, match=f"topic /x: .*{match}"):
        list(read_imu(log, log.channels_of("/x"), ImuUnits(), Losses(), orientation=True))


def test_a_fix_that_is_none(tmp_path):
    text = definition(FIX)[0].replace("float64[9] position", "float64[2] position")
    path = log_of(tmp_path / "a.mcap", FIX, text)
    with open_log(path) as log, pytest.raises(UnsupportedLogError, match="2 elements"):
        list(read_fixes(log, log.channels_of("/x"), Losses()))


def test_a_field_that_a_type_lacks_makes_bad_rows_not_errors(tmp_path):
    text = definition(IMU)[0].replace("Vector3 angular_velocity\n", "Vector3 rates\n")
    path = log_of(tmp_path / "a.mcap", IMU, text)
    losses = Losses()
    with open_log(path) as log:
        assert list(read_imu(log, log.channels_of("/x"), ImuUnits(), losses)) == []
    assert losses.malformed == 3 and "lacks angular_velocity" in losses.problem


@pytest.mark.parametrize("payload", [b"", b"\0", b"\0\1\0\0", b"\0\7\0\0", b"\xff" * 324])
def test_one_bad_payload_is_a_row_lost_in_either_mode(tmp_path, payload):
    from tests.helpers.logs import Row

    rows = [Row("/imu", k, k, payload_of(IMU, k)) for k in range(20)]
    rows[7] = rows[7]._replace(payload=payload)
    path = write_mcap(tmp_path / "a.mcap", rows)
    for salvage in (False, True):
        losses = Losses()
        with open_log(path, salvage) as log:
            listed = list(read_imu(log, log.channels_of("/imu"), ImuUnits(), losses))
            assert sum(map(len, listed)) == 19
            assert 7 not in np.concatenate([imu.log_time_ns for imu in listed])
            assert not log.lost
        assert losses.malformed == 1 and losses.problem
