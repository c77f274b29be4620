"""Programs that people open an output with: what each finds in it, by topic."""

from __future__ import annotations

import logging
import os
import re
import subprocess
import sys
from collections import Counter

from mcap.reader import NonSeekingReader, make_reader

# Types that evo makes a trajectory of, of those that are written
POSES = {"geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Odometry"}
# What pip installs as programs, wherever it puts them
START = """
import sys
from importlib.metadata import distribution
package, name = sys.argv[1:3]
sys.argv = sys.argv[2:]
found = (e for e in distribution(package).entry_points if e.name == name)
next(found).load()()
"""


def program(package, name, *arguments, home):
    """Run a package's program, which may keep settings in a home of its own."""
    command = [sys.executable, "-c", START, package, name, *map(str, arguments)]
    environment = os.environ | {"HOME": str(home), "XDG_CONFIG_HOME": str(home), "NO_COLOR": "1"}
    return subprocess.run(command, capture_output=True, text=True, timeout=300, env=environment)


def by_mcap(path):
    """Messages decoded by the packages of MCAP's makers, checksums checked."""
    from mcap_ros1.decoder import DecoderFactory as Ros1
    from mcap_ros2.decoder import DecoderFactory as Ros2

    counts = Counter()
    last = 0
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[Ros1(), Ros2()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            assert decoded is not None
            assert message.log_time >= last
            last = message.log_time
            counts[channel.topic] += 1
    return counts


def by_mcap_stream(path):
    """Messages by mcap's reader that never looks at the index, checksums checked."""
    with path.open("rb") as stream:
        reader = NonSeekingReader(stream, validate_crcs=True)
        return Counter(c.topic for _, c, _ in reader.iter_messages(log_time_order=False))


def declared(path):
    """Messages by topic as the file's statistics have them, and types by topic."""
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    counts = summary.statistics.channel_message_counts
    result = Counter()
    for number, channel in summary.channels.items():
        result[channel.topic] += counts.get(number, 0)
    types = {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}
    return result, types


def by_rosbags(path):
    """Messages as rosbags deserialises them."""
    from rosbags.highlevel import AnyReader

    counts = Counter()
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            assert reader.deserialize(data, connection.msgtype) is not None
            counts[connection.topic] += 1
    return counts


def by_pybag(path):
    """Messages by pybag, checksums checked; ours decoded too."""
    from pybag.mcap.record_reader import McapRecordReaderFactory
    from pybag.mcap_reader import McapFileReader

    logging.getLogger("pybag").setLevel(logging.ERROR)  # chunks overlap, as they may
    with McapRecordReaderFactory.from_file(path, enable_crc_check=True) as reader:
        topics = {number: channel.topic for number, channel in reader.get_channels().items()}
        counts = Counter(topics[message.channel_id] for message in reader.get_messages())
    with McapFileReader.from_file(path, enable_crc_check=True) as reader:
        for topic in sorted(counts):
            # It pads NavSatFix wrongly behind frame names of some lengths (0.13, whoever wrote it).
            if topic.startswith("/sinstool/") and topic != "/sinstool/fix":
                assert sum(1 for _ in reader.messages(topic)) == counts[topic], topic
    return counts


def by_rerun(path, home):
    """Topics that `rerun mcap check --full` finds nothing wrong with."""
    done = program("rerun-sdk", "rerun", "mcap", "check", "--full", path, home=home)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = re.findall(r"^(\w+) +\d+ +\d+ +(/\S+)", done.stdout, re.MULTILINE)
    assert {status for status, _ in rows} == {"ok"}, done.stdout
    return {topic for _, topic in rows}


def by_evo(path, topic, home):
    """Poses of a topic as evo reads them."""
    done = program("evo", "evo_traj", "bag2", path, topic, home=home)
    assert done.returncode == 0, done.stdout + done.stderr
    (poses,) = re.findall(r"infos:\t(\d+) poses", done.stdout)
    return int(poses)


def check_everywhere(path, home):
    """Open a file in every Python client that is here; all must find the same.

    Parameters
    ----------
    path : Path
    home : Path
        Where clients may keep settings.

    Returns
    -------
    Counter
        Messages by topic.
    """
    expected, _ = declared(path)
    expected = +expected
    assert by_mcap_stream(path) == expected
    assert by_mcap(path) == expected
    assert by_pybag(path) == expected
    with path.open("rb") as stream:
        ros = make_reader(stream).get_header().profile
    if ros == "ros2":  # rosbags and evo read MCAP of no other profile
        assert by_rosbags(path) == expected
    return expected


def poses(path):
    """Topics that evo reads, and how many poses each has."""
    counts, types = declared(path)
    return {t: n for t, n in counts.items() if n and types[t] in POSES}
