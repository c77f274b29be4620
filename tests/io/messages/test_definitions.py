import random

import pytest

from sinstool.io.messages.definitions import definition_of, parse_definition, schema_text
from tests.helpers import standard_types

SEPARATOR = "=" * 80


def test_usual_definitions_are_those_of_rosbags():
    """They are made by ``python -m tests.helpers.standard_types``."""
    assert standard_types.PATH.read_text() == standard_types.content()


def as_recorded(text, seed):
    """A schema as recorders write it: remarks, blanks, and nested types in any order."""
    rng = random.Random(seed)
    first, *others = text.split(SEPARATOR)
    rng.shuffle(others)
    lines = SEPARATOR.join([first, *others]).split("\n")
    remarked = []
    for line in lines:
        if " " in line and not line.startswith("MSG: "):
            if rng.random() < 0.3:
                remarked += ["# A remark", ""]
            line = line.replace("=", " =  ", 1) + "  # of it"
        remarked.append(line)
    return "\r\n".join(remarked)


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
@pytest.mark.parametrize("name", standard_types.NAMES)
def test_usual_schemas_need_no_parser(monkeypatch, name, encoding):
    flavour = "ros1msg" if encoding == "ros1" else "ros2msg"
    text = as_recorded(schema_text(name, encoding), name)
    parsed = definition_of(name, flavour, text, encoding)
    monkeypatch.setattr("sinstool.io.messages.definitions.definition_of", None)
    parse_definition.cache_clear()
    found = parse_definition(name, flavour, text, encoding)
    assert found == parsed


@pytest.mark.parametrize(
    "other",
    [
        lambda text: text.replace("float64 x", "float32 x", 1),
        lambda text: text + "\nfloat64 more",
        lambda text: text.replace("float64 z", "float64 z\nstring name '#'", 1),
        lambda text: text.replace("float64[9]", "float64[8]", 1),
    ],
)
def test_schemas_that_differ_from_a_usual_one_are_parsed(other):
    text = other(schema_text("sensor_msgs/msg/Imu", "cdr"))
    found = parse_definition("sensor_msgs/msg/Imu", "ros2msg", text, "cdr")
    assert found == definition_of("sensor_msgs/msg/Imu", "ros2msg", text, "cdr")
    assert found != parse_definition("sensor_msgs/msg/Imu", "ros2msg", "", "cdr")
