from dataclasses import replace

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import sinstool
from sinstool.config import ProcessConfig
from sinstool.core.errors import TopicError, UnsupportedLogError
from sinstool.io.readers import open_log
from sinstool.io.readers.message_types import FIX_TYPE
from sinstool.io.readers.streams import ImuUnits, Losses, read_imu
from sinstool.io.readers.topics import choose_imu, choose_optional, imu_candidates, unread_topics
from sinstool.pipelines.info.run import inspect
from tests.helpers.imulogs import (
    IMU,
    G,
    Message,
    even_times,
    header,
    imu_messages,
    resting,
    store,
    write_bag,
    write_log,
)
from tests.helpers.logs import rows, write_mcap

TIMES = even_times(50)
NESTED = "vendor_msgs/msg/Packet"


def imu(topic, gyro=0.1, times=TIMES, ros=2):
    return imu_messages(
        times, [gyro, 0.0, 0.0], [0.0, 0.0, G if gyro else 0.0], topic=topic, ros=ros
    )


def nested_types():
    types = get_typestore(Stores.ROS2_HUMBLE)
    text = "uint8 kind\nstring name\nsensor_msgs/Imu first\nfloat32 temperature"
    types.register(get_types_from_msg(text, NESTED))
    text = "sensor_msgs/Imu left\nsensor_msgs/Imu right"
    types.register(get_types_from_msg(text, "vendor_msgs/msg/Pair"))
    return types


DRIVER = "vendor_msgs/msg/Ahrs"
TURNED = {"q_xyzw": (0.0, 0.6, 0.0, 0.8), "covariance": 0.0}


def of_a_driver(topic, oriented, covered):
    """Messages of a type of its own that names its fields as an IMU does."""
    types = get_typestore(Stores.ROS2_HUMBLE)
    fields = {"header": "std_msgs/Header", "temperature": "float32"}
    if oriented:
        fields["orientation"] = "geometry_msgs/Quaternion"
    if covered:
        fields["orientation_covariance"] = "float64[9]"
    fields["linear_acceleration"] = fields["angular_velocity"] = "geometry_msgs/Vector3"
    text = "\n".join(f"{kind} {name}" for name, kind in fields.items())
    types.register(get_types_from_msg(text, DRIVER))
    gyro, accel = resting(len(TIMES))
    messages = []
    for m in imu_messages(TIMES, gyro, accel, **TURNED):
        values = {name: getattr(m.message, name, 20.0) for name in fields}
        messages.append(Message(topic, DRIVER, m.log_ns, types.types[DRIVER](**values)))
    return messages, types


def nested(topic):
    types = nested_types()
    gyro, accel = resting(len(TIMES))
    return [
        Message(
            topic,
            NESTED,
            m.log_ns,
            types.types[NESTED](kind=3, name="x" * (k % 5), first=m.message, temperature=20.0),
        )
        for k, m in enumerate(imu_messages(TIMES, gyro, accel))
    ]


def fix(topic, time_ns, latitude=48.0):
    types = store().types
    status = types["sensor_msgs/msg/NavSatStatus"](status=0, service=1)
    return Message(
        topic,
        FIX_TYPE,
        int(time_ns),
        types[FIX_TYPE](
            header=header(time_ns),
            status=status,
            latitude=latitude,
            longitude=11.0,
            altitude=500.0,
            position_covariance=np.zeros(9),
            position_covariance_type=0,
        ),
    )


def chosen(path, topic=None):
    with open_log(path) as log:
        return choose_imu(log, topic)


def refused(path, topic=None):
    with pytest.raises(TopicError) as info:
        chosen(path, topic)
    return str(info.value)


def test_the_only_one(tmp_path):
    got = chosen(write_log(tmp_path / "a.mcap", [*imu("/imu"), fix("/fix", TIMES[0])]))
    assert (got.topic, got.path, got.obvious) == ("/imu", "", True)
    assert len(got.channels) == 1


@pytest.mark.parametrize("bag", [False, True])
def test_several_with_data_are_refused_with_their_rates(tmp_path, bag):
    slow = imu("/slow", times=even_times(30, 50.0), ros=1 if bag else 2)
    messages = [*imu("/a/imu", ros=1 if bag else 2), *slow]
    if bag:
        path = write_bag(tmp_path / "a.bag", messages)
    else:
        path = write_log(tmp_path / "a.mcap", messages)
    text = refused(path)
    assert "/a/imu (200 Hz)" in text and "/slow (50 Hz)" in text and "--imu-topic" in text
    assert str(path) in text
    assert chosen(path, "/slow").topic == "/slow"


def test_the_one_that_is_not_all_zeros(tmp_path):
    path = write_log(tmp_path / "a.mcap", [*imu("/dead", 0.0), *imu("/alive")])
    got = chosen(path)
    assert got.topic == "/alive"
    assert "not all zeros" in got.reason and not got.obvious
    assert chosen(path, "/dead").topic == "/dead"


def test_a_topic_without_messages_is_no_rival(tmp_path):
    path = write_log(tmp_path / "a.mcap", imu("/alive"), channels=[("/declared", IMU)])
    assert chosen(path).topic == "/alive"


def test_all_zeros_in_both(tmp_path):
    text = refused(write_log(tmp_path / "a.mcap", [*imu("/a", 0.0), *imu("/b", 0.0)]))
    assert "/a (no data)" in text and "/b (no data)" in text


def test_accelerations_alone_are_data(tmp_path):
    still = imu_messages(TIMES, [0.0, 0.0, 0.0], [0.0, 0.0, G], topic="/still")
    assert chosen(write_log(tmp_path / "a.mcap", [*imu("/dead", 0.0), *still])).topic == "/still"


def test_nested(tmp_path):
    messages = nested("/packet")
    path = write_log(tmp_path / "a.mcap", messages, types=nested_types())
    with open_log(path) as log:
        got = choose_imu(log, None)
        assert (got.topic, got.path) == ("/packet", "first")
        blocks = list(read_imu(log, got.channels, ImuUnits("frd"), Losses(), path=got.path))
    gyro, accel = resting(len(TIMES))
    np.testing.assert_array_equal(np.concatenate([b.gyro for b in blocks]), gyro)
    np.testing.assert_array_equal(np.concatenate([b.accel for b in blocks]), accel)
    np.testing.assert_array_equal(np.concatenate([b.time_ns for b in blocks]), TIMES)


def test_a_plain_topic_goes_before_a_nested_one(tmp_path):
    path = write_log(tmp_path / "a.mcap", [*nested("/packet"), *imu("/imu")], types=nested_types())
    got = chosen(path)
    assert (got.topic, got.path) == ("/imu", "")
    assert "plain" in got.reason and not got.obvious
    assert chosen(path, "/packet").path == "first"


@pytest.mark.parametrize("oriented, covered", [(True, True), (True, False), (False, False)])
def test_a_type_with_the_fields_of_an_imu_is_read_as_one(tmp_path, oriented, covered):
    messages, types = of_a_driver("/ahrs", oriented, covered)
    path = write_log(tmp_path / "a.mcap", messages, types=types)
    got = chosen(path)
    assert (got.topic, got.path) == ("/ahrs", "")
    messages_of_ros = imu_messages(TIMES, *resting(len(TIMES)), **TURNED)
    plain = write_log(tmp_path / "b.mcap", messages_of_ros)
    with open_log(path) as log, open_log(plain) as other:
        expected = next(read_imu(other, chosen(plain).channels, ImuUnits(), Losses(),
                                 orientation=True))  # fmt: skip
        block = next(read_imu(log, got.channels, ImuUnits(), Losses(), orientation=True))
    for name in ("time_ns", "gyro", "accel"):
        np.testing.assert_array_equal(getattr(block, name), getattr(expected, name))
    if oriented:
        np.testing.assert_array_equal(block.orientation, expected.orientation)
        assert np.isfinite(block.orientation).all()
    else:
        assert np.isnan(block.orientation).all()
    # A plain IMU beside it is the sensor's own
    both = write_log(tmp_path / "c.mcap", [*messages, *imu("/imu")], types=types)
    assert chosen(both).topic == "/imu"


def test_two_in_one_message_are_no_topic(tmp_path):
    types = nested_types()
    pair = types.types["vendor_msgs/msg/Pair"]
    m = imu("/x")[0].message
    message = Message("/pair", "vendor_msgs/msg/Pair", int(TIMES[0]), pair(left=m, right=m))
    path = write_log(tmp_path / "a.mcap", [message], types=types)
    assert "no sensor_msgs/Imu topic" in refused(path)


def test_our_own_topics_are_not_taken_for_sensors(tmp_path):
    ours = [*imu("/sinstool/imu"), *imu("/truth/imu")]
    path = write_log(tmp_path / "a.mcap", [*ours, *imu("/imu")])
    got = chosen(path)
    assert (got.topic, got.obvious) == ("/imu", True)
    assert chosen(path, "/truth/imu").topic == "/truth/imu"
    assert "no sensor_msgs/Imu topic" in refused(write_log(tmp_path / "b.mcap", ours))


def test_a_topic_with_other_types_beside_the_imu(tmp_path):
    """Two nodes publish on one topic: a sensor's messages are those of its type."""
    mixed = [fix("/imu", TIMES[0]), *imu("/imu")]
    path = write_log(tmp_path / "a.mcap", mixed)
    for name in (None, "/imu"):
        topic = chosen(path, name)
        assert [c.type for c in topic.channels] == [IMU]
    with open_log(path) as log:
        (channel,) = choose_optional(log, "--gnss-topic", None, FIX_TYPE)
        assert channel.type == FIX_TYPE and channel.topic == "/imu"
        blocks = list(read_imu(log, topic.channels, ImuUnits(), Losses()))
    assert sum(map(len, blocks)) == len(TIMES)


def test_no_imu_says_what_there_is(tmp_path):
    text = refused(write_log(tmp_path / "a.mcap", [fix("/fix", TIMES[0])]))
    assert "no sensor_msgs/Imu topic" in text and FIX_TYPE in text
    assert "no topic of a known type" in refused(write_log(tmp_path / "b.mcap", []))


def test_a_wanted_topic_that_is_not_there_or_is_something_else(tmp_path):
    path = write_log(tmp_path / "a.mcap", [fix("/fix", TIMES[0]), *imu("/imu")])
    text = refused(path, "/imu2")
    assert "no topic /imu2" in text and "IMU topics are /imu" in text
    assert f"topic /fix is {FIX_TYPE}, not sensor_msgs/Imu" in refused(path, "/fix")
    none = write_log(tmp_path / "b.mcap", [fix("/fix", TIMES[0])])
    assert "no topic of this log carries an IMU" in refused(none, "/imu")


def test_an_encoding_that_is_not_read_is_named(tmp_path):
    from mcap.writer import Writer

    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema(IMU, "jsonschema", b"{}")
        channel = writer.register_channel("/imu", "json", schema)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with open_log(path) as log:
        (only,) = imu_candidates(log)
        with pytest.raises(UnsupportedLogError, match="encoded as 'json'"):
            list(read_imu(log, only.channels, ImuUnits(), Losses()))


def in_json(path, *channels):
    """Add channels in JSON, of types that are also ROS messages, to the messages of a log."""
    from mcap.reader import make_reader
    from mcap.writer import Writer

    with path.open("rb") as stream:
        content = list(make_reader(stream).iter_messages())
    with path.open("wb") as stream:
        writer, numbers = Writer(stream), {}
        writer.start()
        for topic, name in channels:
            schema = writer.register_schema(name, "jsonschema", b"{}")
            writer.add_message(writer.register_channel(topic, "json", schema), 1, b"{}", 1)
        for schema, channel, message in content:
            if channel.id not in numbers:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                numbers[channel.id] = writer.register_channel(channel.topic, "cdr", number)
            writer.add_message(numbers[channel.id], message.log_time, message.data, 1)
        writer.finish()
    return path


def test_topics_that_cannot_be_read_are_left_aside(tmp_path):
    path = write_log(tmp_path / "a.mcap", [fix("/fix", TIMES[0]), *imu("/imu")])
    in_json(path, ("/imu", IMU), ("/a/imu", IMU), ("/fix", FIX_TYPE), ("/a/fix", FIX_TYPE))
    with open_log(path) as log:
        chosen = choose_imu(log, None)
        assert chosen.topic == "/imu" and chosen.reason == "the only one with an IMU"
        (block,) = read_imu(log, chosen.channels, ImuUnits(), Losses())
        assert len(block) == len(TIMES)
        assert [c.topic for c in choose_optional(log, "--gnss-topic", None, FIX_TYPE)] == ["/fix"]
        with pytest.raises(UnsupportedLogError, match="topic /a/fix is encoded as 'json'"):
            choose_optional(log, "--gnss-topic", "/a/fix", FIX_TYPE)
        assert unread_topics(log, IMU, FIX_TYPE) == {
            f"/a/{one}": f"topic /a/{one} is encoded as 'json'" for one in ("imu", "fix")
        }


def test_a_log_none_of_whose_topics_can_be_read_is_listed(tmp_path):
    path = in_json(write_log(tmp_path / "a.mcap", []), ("/imu", IMU), ("/fix", FIX_TYPE))
    found = inspect(path, ProcessConfig())
    assert [topic.topic for topic in found.topics] == ["/fix", "/imu"]
    assert found.process.why.startswith("topic /imu is encoded as 'json'")


def test_a_run_says_which_topics_it_cannot_read(tmp_path):
    path = in_json(write_log(tmp_path / "a.mcap", imu("/imu")), ("/fix", FIX_TYPE))
    (said,) = [f for f in inspect(path, ProcessConfig()).findings if f.kind == "unread-topic"]
    assert said.topic == "/fix" and "'json'" in said.text


def test_fixes_that_are_asked_for_and_cannot_be_read_are_named(tmp_path):
    path = in_json(write_log(tmp_path / "a.mcap", imu("/imu")), ("/fix", FIX_TYPE))
    for call in (
        lambda: sinstool.process(path, mode="ins-gnss"),
        lambda: sinstool.open_log(path).gnss(),
    ):
        with pytest.raises(TopicError, match=r"no .*fixes.*; topic /fix is encoded as 'json'"):
            call()


def test_fixes(tmp_path):
    one = write_log(tmp_path / "a.mcap", [fix("/fix", TIMES[0]), *imu("/imu")])
    with open_log(one) as log:
        assert [c.topic for c in choose_optional(log, "--gnss-topic", None, FIX_TYPE)] == ["/fix"]
        assert [c.topic for c in choose_optional(log, "--gnss-topic", "/fix", FIX_TYPE)] == ["/fix"]
        with pytest.raises(TopicError, match="no topic /im of type sensor_msgs/NavSatFix"):
            choose_optional(log, "--gnss-topic", "/im", FIX_TYPE)
        with pytest.raises(
            TopicError, match="topic /imu is sensor_msgs/msg/Imu, not sensor_msgs/N"
        ):
            choose_optional(log, "--gnss-topic", "/imu", FIX_TYPE)
        assert choose_optional(log, "--x", None, "std_msgs/msg/String") == ()
    ours = fix("/sinstool/fix", TIMES[0])
    two = write_log(tmp_path / "b.mcap", [fix("/a", TIMES[0]), fix("/b", TIMES[0]), ours])
    with open_log(two) as log:
        with pytest.raises(TopicError, match=r"/a, /b: choose one with --gnss-topic"):
            choose_optional(log, "--gnss-topic", None, FIX_TYPE)
        assert [c.topic for c in choose_optional(log, "--gnss-topic", "/b", FIX_TYPE)] == ["/b"]


def test_channels_are_found_by_topic_without_a_look_at_all_of_them(tmp_path):
    class Counting(dict):
        looks = 0

        def items(self):
            Counting.looks += 1
            return super().items()

    with open_log(write_mcap(tmp_path / "a.mcap", rows(3))) as log:
        first = log.channels_of("/imu")
        assert [c.topic for c in first] == ["/imu"]
        log.channels = Counting(
            {k: replace(first[0], id=k, recorded_topic=f"/t{k % 500}") for k in range(1000, 0, -1)}
        )
        for k in range(500):
            assert [c.id for c in log.channels_of(f"/t{k}")] == [k or 500, k + 500 if k else 1000]
        assert log.channels_of("/imu") == []
        assert Counting.looks == 1
        log.channels[1001] = replace(first[0], id=1001, recorded_topic="/t1")  # met while reading
        assert [c.id for c in log.channels_of("/t1")] == [1, 501, 1001]
