"""The Foxglove layout in the documentation, held to the topics and fields that are written."""

import json
import re

import pytest

import sinstool
from sinstool.io.messages.encode import Encoder
from sinstool.io.readers import open_log
from sinstool.io.writers.solution_topics import (
    DIAGNOSTICS_TOPIC,
    TOPICS,
    Frames,
    diagnostic_strings,
)
from tests.docs.examples import ROOT

LAYOUT = json.loads((ROOT / "docs" / "foxglove" / "sinstool.json").read_text())
TYPES = {topic.topic: topic.type_name for topic in TOPICS.values()}
# Functions of a message path, which turn what the path names into what is drawn
FUNCTIONS = {"rad2deg"}
PATH = re.compile(r"(?P<topic>/[\w/]+)\.(?P<field>[\w.]+?)(?:\.@(?P<function>\w+))?")


def panels(kind):
    return [config for name, config in LAYOUT["configById"].items() if name.startswith(kind + "!")]


def leaves(node):
    return [node] if isinstance(node, str) else leaves(node["first"]) + leaves(node["second"])


def drawn():
    """Topic, field and function of every line in a plot."""
    for panel in panels("Plot"):
        for path in panel["paths"]:
            match = PATH.fullmatch(path["value"])
            assert match, path["value"]
            yield match["topic"], match["field"], match["function"], panel["yAxisLabel"]


def topics():
    """All that the layout shows."""
    named = {topic for topic, *_ in drawn()} | {p["followTopic"] for p in panels("map")}
    named |= {topic for panel in panels("3D") for topic in panel["topics"]}
    return named | {panel["topicToRender"] for panel in panels("DiagnosticStatusPanel")}


def test_every_panel_stands_somewhere_and_everything_that_stands_is_a_panel():
    assert sorted(leaves(LAYOUT["layout"])) == sorted(LAYOUT["configById"])
    kinds = {name.partition("!")[0] for name in LAYOUT["configById"]}
    assert kinds == {"map", "3D", "Plot", "DiagnosticStatusPanel"}


def test_every_line_is_a_number_in_a_message_in_the_unit_of_its_axis():
    seen = 0
    for topic, field, function, unit in drawn():
        numbers = Encoder(TYPES[topic], "cdr").layout.leaves
        assert field in numbers and numbers[field].dtype in ("f4", "f8"), (topic, field)
        assert function is None or function in FUNCTIONS
        # angles are written in rad, and drawn in degrees
        assert (function == "rad2deg") == unit.startswith("deg"), (topic, field)
        seen += 1
    assert seen >= 14


def test_maps_and_views_show_types_that_they_can_show():
    for panel in panels("map"):
        assert TYPES[panel["followTopic"]] == "sensor_msgs/msg/NavSatFix"
    for panel in panels("3D"):
        kinds = {TYPES[topic] for topic in panel["topics"]}
        assert kinds <= {"nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"}


def test_the_diagnostics_are_found_by_their_name():
    strings = diagnostic_strings((), Frames("enu", "map", "imu", "flu"))
    (panel,) = panels("DiagnosticStatusPanel")
    assert panel["topicToRender"] == DIAGNOSTICS_TOPIC
    assert panel["selectedName"] == strings["status[0].name"]
    assert panel["selectedHardwareId"] == strings["status[0].hardware_id"]


@pytest.mark.slow
def test_a_navigated_result_has_all_topics_but_those_for_which_one_asks(tmp_path):
    sinstool.simulate("drive", tmp_path / "drive.mcap", duration=60.0, still=15.0, rate=50.0)
    sinstool.process(tmp_path / "drive.mcap", tmp_path / "out.mcap", mode="ins-gnss")
    with open_log(tmp_path / "out.mcap") as log:
        written = {channel.topic for channel in log.channels.values()}
    assert topics() - written == {"/sinstool/euler", "/sinstool/pose"}
