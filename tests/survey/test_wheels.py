"""Wheels of a log: found by what they say, held against the fixes, read in columns."""

import json
from dataclasses import replace

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer

from sinstool.config import InputOptions
from sinstool.core.errors import TopicError
from sinstool.io.readers import open_log
from sinstool.simulation.car import Car, axle_motion
from sinstool.simulation.drive import road_drive
from sinstool.simulation.gnss import MODELS, Receiver, gnss_samples
from sinstool.simulation.log import SimulatedTopic, gnss_topics, write_simulated
from sinstool.simulation.wheels import WheelSensor, wheel_readings, wheel_topic
from sinstool.survey.gnss import read_gnss
from sinstool.survey.wheels import matched, read_wheels, slipping, wheel_joints
from tests.helpers.imulogs import T0, store
from tests.helpers.logs import memory_below, read_back

CAR = Car(axle_lever=1.5)
RADIUS = 0.31


@pytest.fixture(scope="module")
def road():
    return road_drive(300.0, 50.0, still_s=20.0, seed=6, start_ns=T0, car=CAR)


@pytest.fixture(scope="module")
def readings(road):
    return wheel_readings(road, CAR, WheelSensor(scale=0.02, latency_s=0.1, noise=0.02), 1)


@pytest.fixture(scope="module")
def receiver(road):
    receiver = Receiver(rate_hz=4.0, errors=MODELS["coloured"])
    return gnss_topics(gnss_samples(road, receiver, 3))


def twist(topic, time_ns, linear, kind="twist", frame="base_link"):
    path = "twist" if kind == "twist" else "twist.twist"
    name = "geometry_msgs/msg/TwistStamped" if kind == "twist" else "nav_msgs/msg/Odometry"
    return SimulatedTopic(
        topic, name, time_ns, lambda rows: {f"{path}.linear.x": linear[rows]},
        {"header.frame_id": frame},
    )  # fmt: skip


def joints(topic, time_ns, rates, names):
    return SimulatedTopic(
        topic,
        "sensor_msgs/msg/JointState",
        time_ns,
        lambda rows: {"velocity": rates[rows], "position": np.cumsum(rates, axis=0)[rows]},
        {f"name[{k}]": name for k, name in enumerate(names)},
        {"name": len(names), "position": len(names), "velocity": len(names)},
    )


def found(path, topics, wheels=None, taken=None, velocity=None, write=write_simulated):
    write(path, topics, {})
    options = InputOptions(wheels=wheels, velocity_topic=velocity)
    with open_log(path) as log:
        aiding = read_gnss(log, options, False)
        used = aiding.velocity_topic if taken is None else taken
        return read_wheels(log, options, aiding.gnss, used)


@pytest.mark.parametrize("velocity", [None, "none"])
@pytest.mark.parametrize("kind", ["odometry", "twist", "joint"])
def test_wheels_of_each_kind_are_found_and_read(tmp_path, receiver, readings, kind, velocity):
    topics = [*receiver, wheel_topic(readings, kind, RADIUS)]
    wheels = found(tmp_path / "log.mcap", topics, velocity=velocity)
    assert wheels.topic == "/wheels", wheels.reason
    np.testing.assert_array_equal(wheels.time_ns, readings.time_ns)
    unit = 1.0 / RADIUS if kind == "joint" else 1.0
    np.testing.assert_allclose(wheels.speed, unit * readings.speed.mean(axis=1), rtol=1e-12)
    assert wheels.unit == ("rad/s" if kind == "joint" else "m/s")
    assert wheels.wheels == (2 if kind == "joint" else 0)
    if kind == "joint":
        np.testing.assert_allclose(
            wheels.apart, unit * np.subtract(*readings.speed.T), rtol=1e-9, atol=1e-12
        )
        assert "2 wheels of 0.3" in wheels.reason


@pytest.mark.parametrize(("row", "stamp_ns"), [(0, 0), (-1, 2**62)])
def test_a_stamp_that_is_decades_off_takes_no_memory(tmp_path, receiver, readings, row, stamp_ns):
    """Of a node that published before its clock was set."""
    time_ns = readings.time_ns.copy()
    time_ns[row] = stamp_ns
    topics = [*receiver, twist("/wheels", time_ns, readings.speed.mean(axis=1))]
    with memory_below(2**26):
        wheels = found(tmp_path / "log.mcap", topics)
    assert wheels.topic == "/wheels", wheels.reason


def as_db3(folder, topics, settings):
    """The same messages in a ROS 2 bag of SQLite, by rosbags' writer."""
    path = folder.parent / "source.mcap"
    write_simulated(path, topics, settings)
    with (
        open_log(path) as log,
        Bag2Writer(folder, version=8, storage_plugin=StoragePlugin.SQLITE3) as bag,
    ):
        made = {
            c.topic: bag.add_connection(c.topic, c.type, typestore=store(2))
            for c in log.channels.values()
        }
        for row in read_back(log):
            bag.write(made[row.topic], row.log_time, row.payload)


def test_wheels_of_a_ros_2_bag(tmp_path, receiver, readings):
    topics = [*receiver, wheel_topic(readings, "joint", RADIUS)]
    wheels = found(tmp_path / "bag", topics, write=as_db3)
    assert wheels.topic == "/wheels"
    np.testing.assert_array_equal(wheels.time_ns, readings.time_ns)
    np.testing.assert_allclose(wheels.speed, readings.speed.mean(axis=1) / RADIUS, rtol=1e-12)


def no_wheels(road):
    """Topics that move with the vehicle, or look like wheels, and are none: with a reason."""
    time_ns = road.time_ns[::5]
    velocity = road.velocity_n[::5]
    speed = np.linalg.norm(velocity, axis=1)
    random = np.random.default_rng(0)
    none = np.zeros_like(speed)
    enu = velocity[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
    filtered = np.stack([speed, *0.01 * random.standard_normal((2, len(speed)))], axis=1)
    forward = np.stack([speed, none, none], axis=1)
    both = np.stack([speed, speed], axis=1) / RADIUS
    wheels = ["left_wheel", "right_wheel"]
    return {
        "world axes": (twist("/odom", time_ns, enu, "odometry", "map"), "world axes"),
        "a filter": (twist("/odometry/filtered", time_ns, filtered, "odometry"), "filter's output"),
        "a command": (twist("/cmd_vel", time_ns, forward), "command"),
        "km/h": (twist("/speed", time_ns, 3.6 * forward), "3.6"),
        "another drive": (twist("/speed", time_ns, forward[::-1]), "does not follow"),
        "a standing one": (twist("/speed", time_ns, 0.0 * forward), "too little"),
        "an arm": (joints("/joint_states", time_ns, both, ["elbow", "shoulder"]), "no wheel"),
        "other wheels": (joints("/joint_states", time_ns, both[::-1], wheels), "does not follow"),
        "tiny wheels": (joints("/joint_states", time_ns, 30.0 * both, wheels), "wheels of 0.01"),
        "damage": (twist("/speed", time_ns, np.nan * forward), "no velocity"),
    }  # fmt: skip


@pytest.mark.parametrize("what", no_wheels(road_drive(30.0, 10.0)))
def test_what_is_no_wheel_is_left_with_the_reason(tmp_path, road, receiver, what):
    topic, reason = no_wheels(road)[what]
    wheels = found(tmp_path / "log.mcap", [*receiver, topic])
    assert wheels.topic == ""
    assert reason in wheels.reason
    assert topic.topic in wheels.reason


@pytest.mark.parametrize("what", ["a filter", "km/h", "an arm"])
def test_a_topic_that_is_named_is_taken(tmp_path, road, receiver, what):
    topic, _ = no_wheels(road)[what]
    wheels = found(tmp_path / "log.mcap", [*receiver, topic], wheels=topic.topic)
    assert (wheels.topic, wheels.reason) == (topic.topic, "as configured")
    assert wheels.unit == ("rad/s" if what == "an arm" else "m/s")
    assert len(wheels) == len(topic.time_ns)


def test_none_and_names_that_are_wrong(tmp_path, receiver, readings):
    topics = [*receiver, wheel_topic(readings, "twist", RADIUS)]
    assert found(tmp_path / "a.mcap", topics, wheels="none").reason == "as --wheels is none"
    for name in ("/wheel", "/gnss/fix"):
        with pytest.raises(TopicError, match=name):
            found(tmp_path / "b.mcap", topics, wheels=name)
    assert "no topic" in found(tmp_path / "c.mcap", receiver).reason


def test_the_velocity_over_ground_is_not_taken_for_wheels_too(tmp_path, receiver, readings):
    topics = [receiver[0], wheel_topic(readings, "twist", RADIUS)]
    wheels = found(tmp_path / "log.mcap", topics, taken="/wheels", velocity="none")
    assert wheels.topic == ""


def test_the_best_of_two(tmp_path, receiver, readings):
    seconds = (readings.time_ns - T0) * 1e-9
    wander = 1.0 + 0.1 * np.sin(0.1 * seconds)[:, None]
    worse = replace(readings, speed=readings.speed * wander)
    worse = replace(wheel_topic(worse, "twist", RADIUS), topic="/a_worse_one")
    wheels = found(
        tmp_path / "log.mcap", [*receiver, worse, wheel_topic(readings, "twist", RADIUS)]
    )
    assert wheels.topic == "/wheels"
    assert "best of 2 topics" in wheels.reason


def test_a_wheel_that_counts_backward_and_messages_of_others(tmp_path, receiver, readings):
    rates = readings.speed / RADIUS * [1.0, -1.0]
    names = ["wheel_left_joint", "wheel_right_joint"]
    own = joints("/joint_states", readings.time_ns, rates, names)
    arm = joints("/joint_states", readings.time_ns + 7, 1.0 + 0.0 * rates[:, :1], ["elbow"])
    wheels = found(tmp_path / "log.mcap", [*receiver, arm, own])
    assert wheels.topic == "/joint_states", wheels.reason
    np.testing.assert_array_equal(wheels.time_ns, readings.time_ns)
    np.testing.assert_allclose(wheels.speed, readings.speed.mean(axis=1) / RADIUS, rtol=1e-12)


def test_wheels_on_a_ferry_are_still_wheels(tmp_path):
    car = Car(axle_lever=1.5, ferry=(150.0, 90.0))
    road = road_drive(500.0, 50.0, still_s=20.0, seed=6, start_ns=T0, car=car)
    receiver = gnss_topics(gnss_samples(road, Receiver(rate_hz=4.0, errors=MODELS["coloured"]), 3))
    readings = wheel_readings(road, car, WheelSensor(), 1)
    wheels = found(tmp_path / "log.mcap", [*receiver, wheel_topic(readings, "twist", RADIUS)])
    assert wheels.topic == "/wheels"


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["front_left_wheel", "rear_left_wheel", "rear_right_wheel"], [1, 2]),
        (["wheelFL", "wheelFR", "wheelRL", "wheelRR"], [2, 3]),
        (["leftWheel", "rightWheel", "elbow"], [0, 1]),
        (["steering_wheel", "left_wheel_steer_joint", "left_wheels"], [2]),
        (["caster_wheel", "wheel_1", "wheel_2"], [1, 2]),
        (["shoulder", "elbow"], []),
    ],
)
def test_joints_of_wheels(names, expected):
    assert wheel_joints(names) == [names[k] for k in expected]


def test_scale_latency_and_a_slipping_wheel_of_a_log(tmp_path, road, receiver):
    sensor = WheelSensor(scale=-0.02, latency_s=0.15, slip=0.05, slipping="left", noise=0.02)
    readings = wheel_readings(road, CAR, sensor, 1)
    topics = [*receiver, wheel_topic(readings, "joint", RADIUS)]
    wheels = found(tmp_path / "log.mcap", topics)
    axle = axle_motion(road, CAR, road.time_ns[::20])
    fit = matched(wheels, axle.time_ns, axle.velocity_v[:, 0])
    assert fit.scale == pytest.approx(RADIUS / 0.98, rel=0.003)
    assert fit.latency_s == pytest.approx(0.15, abs=0.02)
    slips = slipping(wheels, axle.time_ns, axle.rate_v[:, 2], fit.latency_s)
    gain = np.abs(np.gradient(readings.truth, 0.05))
    hard = (gain > 1.8) & (readings.truth > 5.0)
    assert hard.sum() > 50
    assert slips[hard].mean() > 0.9
    assert slips[gain < 1.2].mean() < 0.01
    one = replace(wheels, apart=None)
    assert not slipping(one, axle.time_ns, axle.rate_v[:, 2]).any()


def test_info_shows_the_wheels_and_does_not_complain_of_them(sinstool, tmp_path):
    log = tmp_path / "log.mcap"
    options = ["--duration", 200, "--rate", 50, "--still", 20, "--wheels", "odometry"]
    assert sinstool("simulate", "drive", "-o", log, "--grade", "mems", *options)[0] == 0
    status, out, _ = sinstool("info", log)
    assert status == 0
    assert "wheels /wheels, as it is forward speed alone" in out
    assert "no velocity over ground" not in out
    status, out, _ = sinstool("info", log, "--wheels", "none", "--json")
    plan = json.loads(out)["process"]["plan"]
    assert plan["wheels"] == {
        "value": "none", "reason": "as --wheels is none", "option": "--wheels"
    }  # fmt: skip
    assert "no velocity over ground" not in out
