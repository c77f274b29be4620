"""Magnetometers of a log: which one is meant, and what its numbers are."""

from itertools import chain

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.core.errors import TopicError
from sinstool.io.readers import open_log
from sinstool.io.readers.topics import choose_imu
from sinstool.pipelines.process.run import process
from sinstool.survey.magnetometer import (
    TESLA,
    choose_magnetometer,
    read_magnetometer,
    suspected_unit,
)
from tests.helpers.imulogs import Message, even_times, header, imu_messages, store, write_log

TIMES = even_times(200)
FIELD = np.array([20e-6, -5e-6, -40e-6])  # FLU
MAGNETIC = "sensor_msgs/msg/MagneticField"


def field_messages(topic, frame="imu_link", field=FIELD, times=TIMES):
    types = store().types
    rows = np.broadcast_to(field, (len(times), 3))
    return [
        Message(
            topic,
            MAGNETIC,
            int(t),
            types[MAGNETIC](
                header=header(t, frame),
                magnetic_field=types["geometry_msgs/msg/Vector3"](*map(float, row)),
                magnetic_field_covariance=np.zeros(9),
            ),
        )
        for t, row in zip(times, rows, strict=True)
    ]


def log_of(path, *topics, imu="/robot/imu/data"):
    messages = imu_messages(TIMES, [0.0, 0.0, 0.0], [0.0, 0.0, 9.81], topic=imu)
    return write_log(path, sorted([*messages, *chain(*topics)], key=lambda m: m.log_ns))


def chosen(path, name=None):
    with open_log(path) as log:
        return choose_magnetometer(log, name, choose_imu(log, None), "imu_link")


def read(path, axes="flu"):
    with open_log(path) as log:
        topic = choose_magnetometer(log, None, choose_imu(log, None), "imu_link")
        return read_magnetometer(log, topic, axes, False)


@pytest.mark.parametrize(
    ("topics", "expected", "why"),
    [
        ({}, "", "as the log has no MagneticField topic"),
        ({"/m": "elsewhere"}, "/m", "the log's only MagneticField topic"),
        ({"/a": "imu_link", "/robot/imu/mag": "gps"}, "/a", "of 2 the only one in the IMU's frame"),
        ({"/a": "/imu_link", "/b": "gps"}, "/a", "of 2 the only one in the IMU's frame"),
        ({"/gps/mag": "", "/robot/imu/mag": ""}, "/robot/imu/mag", "most resembles that of"),
        ({"/a": "imu_link", "/robot/b": "imu_link"}, "/robot/b", "most resembles that of"),
        ({"/a": "", "/b": ""}, "", "does not show which is meant of /a, /b"),
        ({"/sinstool/mag": "imu_link"}, "", "as the log has no MagneticField topic"),
    ],
)
def test_the_magnetometer_that_belongs_to_the_imu_is_chosen(tmp_path, topics, expected, why):
    path = log_of(tmp_path / "log.mcap", *(field_messages(t, f) for t, f in topics.items()))
    found = chosen(path)
    assert found.topic == expected
    assert why in found.reason
    assert found.doubtful == ("which is meant" in why)
    assert [c.topic for c in found.channels] == ([expected] if expected else [])


def test_a_named_topic_is_used_and_none_means_none(tmp_path):
    path = log_of(tmp_path / "log.mcap", field_messages("/a"), field_messages("/b"))
    assert chosen(path, "/b").topic == "/b"
    assert chosen(path, "none").topic == ""
    with pytest.raises(TopicError, match="there is no topic /c of type sensor_msgs/MagneticField"):
        chosen(path, "/c")
    with pytest.raises(TopicError):
        chosen(path, "/robot/imu/data")


@pytest.mark.parametrize("unit", TESLA)
def test_what_is_not_tesla_is_converted_and_said(tmp_path, unit):
    path = log_of(tmp_path / "log.mcap", field_messages("/mag", field=FIELD * TESLA[unit]))
    measured, findings = read(path)
    # the log's axes are FLU, ours FRD
    assert np.allclose(measured.field, FIELD * [1.0, -1.0, -1.0], rtol=1e-12, atol=0.0)
    assert [f.kind for f in findings] == ([] if unit == "T" else ["field-unit"])
    assert all(f"in {unit}," in f.text for f in findings)
    frd, _ = read(path, "frd")
    assert np.allclose(frd.field, FIELD, rtol=1e-12, atol=0.0)


@given(st.floats(15.001e-6, 99.99e-6), st.sampled_from(sorted(TESLA)))
def test_every_field_of_the_earth_is_known_in_every_unit(size, unit):
    assert suspected_unit(size * TESLA[unit]) == unit


@pytest.mark.parametrize("size", [0.0, 1e-9, 5e-4, 3.0, 1e9])
def test_what_is_no_field_of_the_earth_is_left_as_it_is(size):
    assert suspected_unit(size) == "T"


def test_zeros_and_what_is_not_finite_are_counted(tmp_path):
    field = np.tile(FIELD, (200, 1))
    field[10:20], field[30:35], field[40] = 0.0, np.nan, np.inf
    slow = even_times(200, rate=10.0)  # too slow to be averaged
    messages = field_messages("/mag", field=field, times=slow)
    measured, findings = read(log_of(tmp_path / "a.mcap", messages))
    assert len(measured) == 184
    (finding,) = findings
    assert finding.kind == "bad-fields" and finding.numbers["messages"] == 16
    none, findings = read(log_of(tmp_path / "b.mcap", field_messages("/mag", field=np.zeros(3))))
    assert none is None and findings[0].kind == "no-field"


@pytest.mark.parametrize("encoding", ["cdr", "json"])
def test_one_without_a_field_or_in_another_encoding_is_done_without(tmp_path, encoding):
    types = get_typestore(Stores.ROS2_HUMBLE)
    del types.fielddefs[MAGNETIC]
    types.register(get_types_from_msg("std_msgs/Header header\nfloat64 strength", MAGNETIC))
    messages = [
        m._replace(message=types.types[MAGNETIC](header=m.message.header, strength=4e-5))
        for m in field_messages("/mag")
    ]
    imu = imu_messages(TIMES, [0.0, 0.0, 0.0], [0.0, 0.0, 9.81])
    path = tmp_path / "log.mcap"
    write_log(path, sorted([*imu, *messages], key=lambda m: m.log_ns), types=types)
    config = build(ProcessConfig, {"navigation": {"attitude": "smoothed"}})
    if encoding == "json":
        path = rewritten(path, tmp_path / "json.mcap")
        assert chosen(path).topic == "" and "/mag is encoded as 'json'" in chosen(path).reason
        result = process(path, tmp_path / "out.mcap", config)
        assert result.smoothing.magnetometer is None
        (finding,) = [f for f in result.findings if f.kind == "unread-topic"]
        assert finding.topic == "/mag"
        return
    measured, (finding,) = read(path)
    assert measured is None
    assert finding.kind == "no-field" and "/mag" in finding.text
    result = process(path, tmp_path / "out.mcap", config)
    assert result.smoothing.magnetometer.refused == "short"
    assert [f.kind for f in result.findings if "/mag" in f.text] == ["no-field"]


def rewritten(path, to):
    """The log, with its magnetometer in an encoding that nobody reads."""
    with path.open("rb") as source, to.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        numbers = {}
        for schema, channel, message in make_reader(source).iter_messages():
            if channel.topic not in numbers:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                encoding = "json" if schema.name == MAGNETIC else channel.message_encoding
                numbers[channel.topic] = writer.register_channel(channel.topic, encoding, schema_id)
            writer.add_message(
                numbers[channel.topic], message.log_time, message.data, message.publish_time
            )
        writer.finish()
    return to


def test_a_fast_magnetometer_is_thinned_to_means(tmp_path):
    times = even_times(2000, rate=1000.0)
    ramp = FIELD * np.linspace(1.0, 2.0, 2000)[:, None]
    path = log_of(tmp_path / "log.mcap", field_messages("/mag", field=ramp, times=times))
    measured, _ = read(path)
    assert 95 <= len(measured) <= 105
    assert (np.diff(measured.time_ns) > 0).all()
    # the means lie on the ramp still
    share = (measured.time_ns - times[0]) / (times[-1] - times[0])
    expected = FIELD * [1.0, -1.0, -1.0] * (1.0 + share)[:, None]
    assert np.allclose(measured.field, expected, rtol=1e-4)
