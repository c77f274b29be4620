"""Definitions of the usual types, as rosbags has them.

python -m tests.helpers.standard_types

writes them to where the package looks for them.
"""

import json
from dataclasses import astuple

from sinstool.io.messages.definitions import collected, definition_of
from sinstool.io.writers.solution_topics import DIAGNOSTICS_TYPE, TOPICS
from tests.helpers.paths import ROOT

ENCODINGS = ("cdr", "ros1")
PATH = ROOT / "sinstool/io/messages/standard.json"
# What logs have beside what results are written in
OF_LOGS = (
    "geometry_msgs/msg/TwistStamped",
    "geometry_msgs/msg/TwistWithCovarianceStamped",
    "sensor_msgs/msg/FluidPressure",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/MagneticField",
    "std_msgs/msg/Float64",
)
NAMES = sorted({topic.type_name for topic in TOPICS.values()} | {DIAGNOSTICS_TYPE, *OF_LOGS})


def content():
    """By encoding and type: schema text, hash and the types nested; fields of all these."""
    types, fields = {}, {}
    for one in ENCODINGS:
        types[one], fields[one] = {}, {}
        for name in NAMES:
            text, value = collected(name, one)
            nested = definition_of(name, "ros1msg" if one == "ros1" else "ros2msg", text, one).types
            types[one][name] = text, value, list(nested)
            for each, columns in nested.items():
                fields[one][each] = [(field, *astuple(ftype)) for field, ftype in columns]
    return json.dumps({**types, "fields": fields}, separators=(",", ":")) + "\n"


if __name__ == "__main__":
    PATH.write_text(content())
