import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sinstool.io.messages.definitions import DefinitionError, parse_definition
from sinstool.io.messages.encode import standard_definition
from sinstool.io.messages.layout import LayoutError, walk
from tests.io.messages.samples import (
    FLAVOURS,
    TYPES,
    deserialise,
    encoding_of,
    field_at,
    look_up,
    random_message,
    same,
    serialise,
)


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize("name", TYPES)
@given(seed=st.integers(0, 2**32))
@settings(max_examples=15, deadline=None)
def test_every_leaf_lies_where_rosbags_finds_it(name, flavour, seed):
    payload = serialise(random_message(name, flavour, np.random.default_rng(seed)), flavour)
    definition = standard_definition(name, encoding_of(flavour))
    layout = walk(definition, payload)
    message = deserialise(payload, name, flavour)
    order = ">" if flavour == "cdr_be" else "<"
    for path, leaf in layout.leaves.items():
        theirs = look_up(message, path)
        if field_at(definition, path).name == "string":
            assert layout.text(path, payload) == theirs
            continue
        dtype = np.dtype(order + leaf.dtype)
        ours = np.frombuffer(payload, dtype, leaf.count, leaf.offset)
        assert same(ours, np.atleast_1d(theirs)), path


@pytest.mark.parametrize("name", TYPES)
@given(seed=st.integers(0, 2**32), data=st.data())
@settings(max_examples=25, deadline=None)
def test_guards_tell_layouts_apart(name, seed, data):
    """A message in which all guards of another hold has the other's layout."""
    rng = np.random.default_rng(seed)
    flavour = data.draw(st.sampled_from(FLAVOURS))
    definition = standard_definition(name, encoding_of(flavour))
    a, b = (serialise(random_message(name, flavour, rng), flavour) for _ in "ab")
    one, other = walk(definition, a), walk(definition, b)
    hold = all(b[at : at + len(raw)] == raw for at, raw in one.guards)
    if hold and len(a) == len(b):
        assert one.leaves == other.leaves
    if one.leaves == other.leaves and flavour != "ros1":
        assert hold


def test_lengths_that_lie_cost_nothing():
    definition = standard_definition("sensor_msgs/msg/JointState", "cdr")
    head = b"\0\1\0\0" + bytes(8) + b"\1\0\0\0\0" + bytes(3)
    for claim in (5, 2**16, 2**31, 2**32 - 1):
        with pytest.raises(LayoutError):
            walk(definition, head + claim.to_bytes(4, "little") + bytes(12))


def test_padding_behind_the_message_is_accepted_in_cdr_only():
    rng = np.random.default_rng(0)
    for flavour, good in (("cdr", True), ("ros1", False)):
        payload = serialise(random_message("sensor_msgs/msg/Imu", flavour, rng), flavour)
        definition = standard_definition("sensor_msgs/msg/Imu", encoding_of(flavour))
        walk(definition, payload)
        if good:
            walk(definition, payload + bytes(3))
        else:
            with pytest.raises(LayoutError):
                walk(definition, payload + bytes(3))
        with pytest.raises(LayoutError):
            walk(definition, payload + bytes(8))


SCHEMA = """# comment with = signs and "quotes"
int8 A=1
string NAME=some text # with a comment
int8 status -2   # a default
float64[3] fixed [1.0, 2.0, 3.0]
float32[<=4] bounded
string<=10 short
string[] names
bool flag true
builtin_interfaces/Duration wait
geometry_msgs/Vector3[2] pair
================================================================================
MSG: geometry_msgs/Vector3
# three
float64 x
float64 y 0
float64 z
"""


@pytest.mark.parametrize("text", [SCHEMA, SCHEMA.replace("\n", "\r\n")])
def test_everything_the_grammar_allows(text):
    definition = parse_definition("acme_msgs/msg/All", "ros2msg", text, "cdr")
    names = [name for name, _ in definition.types["acme_msgs/msg/All"]]
    assert names == ["status", "fixed", "bounded", "short", "names", "flag", "wait", "pair"]
    body = bytearray(b"\0\1\0\0" + b"\xfe" + bytes(7) + np.arange(3.0).tobytes())
    body += b"\2\0\0\0" + np.array([4, 5], "<f4").tobytes()
    body += b"\3\0\0\0hi\0\0" + b"\2\0\0\0" + b"\2\0\0\0a\0\0\0" + b"\1\0\0\0\0" + b"\1"
    body += bytes(-(len(body) - 4) % 4) + b"\1\0\0\0\2\0\0\0"
    body += bytes(-(len(body) - 4) % 8) + np.arange(6.0).tobytes()
    layout = walk(definition, bytes(body))
    assert layout.size == len(body)
    assert layout.text("short", body) == "hi"
    assert [layout.text(f"names[{i}]", body) for i in range(2)] == ["a", ""]
    assert layout.leaves["bounded"].count == 2
    last = layout.leaves["pair[1].z"]
    assert np.frombuffer(body, "<f8", 1, last.offset)[0] == 5.0


IDL = """================================================================================
IDL: geometry_msgs/msg/Vector3
module geometry_msgs {
  module msg {
    struct Vector3 {
      double x;
      double y;
      double z;
    };
  };
};
================================================================================
IDL: acme_msgs/msg/V
// from somewhere
#include "geometry_msgs/msg/Vector3.idl"
module acme_msgs {
  module msg {
    typedef double double__2[2];
    @verbatim (language="comment", text="what it is")
    struct V {
      octet kind;
      double__2 pair;
      geometry_msgs::msg::Vector3 v;
      sequence<double, 3> few;
    };
  };
};
"""


@pytest.mark.parametrize("text", [IDL, IDL.replace("\n", "\r\n")])
def test_idl_of_several_files(text):
    definition = parse_definition("acme_msgs/msg/V", "ros2idl", text, "cdr")
    payload = b"\0\1\0\0" + bytes(8) + np.arange(5.0).tobytes() + bytes(4)
    layout = walk(definition, payload)
    assert layout.leaves["pair"].count == 2
    assert layout.leaves["v.z"].offset == 4 + 8 + 32
    assert layout.leaves["few"].count == 0


def test_types_that_have_no_layout():
    with pytest.raises(DefinitionError, match="contains itself"):
        parse_definition("a_msgs/msg/A", "ros2msg", "a_msgs/A again\nint8 x\n", "cdr")
    with pytest.raises(DefinitionError, match="not defined"):
        parse_definition("a_msgs/msg/B", "ros2msg", "a_msgs/Missing m\n", "cdr")
    with pytest.raises(DefinitionError, match="cannot be parsed"):
        parse_definition("a_msgs/msg/C", "ros2msg", "float64 3x = {", "cdr")


def test_header_of_ros1_has_its_sequence_number():
    text = "Header header\nfloat64 x\n" + "=" * 80 + "\nMSG: std_msgs/Header\n"
    text += "uint32 seq\ntime stamp\nstring frame_id\n"
    definition = parse_definition("a_msgs/Thing", "ros1msg", text, "ros1")
    payload = (7).to_bytes(4, "little") + (2**32 - 1).to_bytes(4, "little") + bytes(4)
    layout = walk(definition, payload + b"\2\0\0\0ab" + np.float64(1.5).tobytes())
    assert layout.leaves["header.seq"].offset == 0
    assert layout.leaves["header.stamp.sec"].dtype == "u4"
    assert layout.leaves["x"].offset == 18
