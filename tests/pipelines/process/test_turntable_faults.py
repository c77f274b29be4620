"""`process --hse` on logs of a rig whose encoder, IMU or clock fails for a while."""

import json

import numpy as np
import pytest
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

from tests.helpers.hse_rigs import edited, simulate, sinstool
from tests.helpers.imulogs import Message, read_attitude, store, write_log

RATE = 50
NOISE = {"arw": 1e-3, "vrw": 5, "encoder_lsb": 1, "seed": 3}
# An attitude that is told and further off than this is wrong, rad
WRONG = np.radians(0.15)


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """A log at 60 and -60 deg/s with its truth, its rig and a calibration of that."""
    folder = tmp_path_factory.mktemp("rig")
    log, toml = simulate(
        folder, "sound", rates="60,-60", plateau=60, rate=RATE, encoder_rate=RATE,
        tilt_east=4e-3, epsilon="11,4,6", truth=True, **NOISE,
    )  # fmt: skip
    toml = edited(toml, "short", calibration={"min_turns": 3, "min_duration": 15.0})
    hse = folder / "hse.json"
    command = ("calibrate-hse", log, "--config", toml, "-o", hse, "--method", "axial")
    status, _, err = sinstool(*command)
    assert status == 0, err
    return log, toml, hse


def altered(log, path, change):
    """The log with what `change(topic, s since its start, message)` makes of each message.

    The latter is a message, of its header's time, or None for none.
    """
    types, messages, start = store(), [], None
    with log.open("rb") as stream:
        for schema, channel, m in make_reader(stream).iter_messages():
            start = m.log_time if start is None else start
            message = types.deserialize_cdr(m.data, schema.name)
            if channel.topic != "/truth/imu":
                message = change(channel.topic, (m.log_time - start) * 1e-9, message)
            if message is not None:
                messages.append(Message(channel.topic, schema.name, m.log_time, message))
    return write_log(path, messages)


def processed(folder, rig, change):
    """Status, JSON, messages; and times (s since the log's start) and errors (rad) of attitudes."""
    log, toml, hse = rig
    path, out = altered(log, folder / "fault.mcap", change), folder / "out.mcap"
    status, text, err = sinstool(
        "process", path, "-o", out, "--config", toml, "--hse", hse, "--json", "--world", "ned"
    )
    times, q = read_attitude(out)
    true_times, true = read_attitude(log, "/truth/imu")
    k = np.searchsorted(true_times, times)
    assert np.array_equal(true_times[k], times)
    error = (Rotation.from_quat(q).inv() * Rotation.from_quat(true[k])).magnitude()
    return status, json.loads(text), err, (times - true_times[0]) * 1e-9, error


def kinds(printed):
    return {f["kind"]: f for f in printed["findings"]}


def test_a_sound_log(rig, tmp_path):
    status, printed, _, seconds, error = processed(tmp_path, rig, lambda topic, at, m: m)
    assert status == 0 and error.max() < WRONG
    assert len(seconds) == printed["imu"]["n"] and "encoder" not in kinds(printed)


def repeats(begin, end):
    """The encoder repeats its reading meanwhile."""
    held = []

    def change(topic, at, message):
        if topic == "/joint_states":
            if begin < at < end and held:
                message.position = held[-1]
            held.append(message.position.copy())
        return message

    return change


def leaps(at_s, angle, until=np.inf):
    """Readings are off by an angle from a time on."""

    def change(topic, at, message):
        if topic == "/joint_states" and at_s <= at < until:
            message.position = message.position + angle
        return message

    return change


def late(at_s, seconds):
    """Encoder stamps are late from a time on."""

    def change(topic, at, message):
        if topic == "/joint_states" and at > at_s:
            time_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            sec, nanosec = divmod(time_ns + round(seconds * 1e9), 10**9)
            message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
        return message

    return change


@pytest.mark.parametrize(
    ("change", "begin", "end"),
    [
        (repeats(40.0, 40.2), 39.9, 40.3),
        (repeats(30.0, 42.0), 29.9, 43.0),
        # as the table turns round
        (repeats(68.0, 76.0), 67.9, 77.0),
        (leaps(40.0, 0.5, 40.01), 39.9, 40.1),
        (leaps(40.0, 0.5, 43.0), 39.9, 43.1),
        (late(120.0, 0.05), 119.9, 144.0),
    ],
    ids=["short", "long", "turning", "once", "leaps", "late"],
)
def test_no_attitude_where_the_gyros_deny_the_encoder(rig, tmp_path, change, begin, end):
    status, printed, err, seconds, error = processed(tmp_path, rig, change)
    # but for what is less than the angle that shows
    assert error.max() < WRONG
    assert status == 3
    found = kinds(printed)["encoder"]
    assert found["severity"] == "lost" and "the gyros deny" in err
    missing = printed["imu"]["n"] - len(seconds)
    assert found["numbers"]["samples"] == missing > 0
    assert missing < (end - begin) * RATE
    denied = np.setdiff1d(np.round(np.arange(printed["imu"]["n"]) / RATE, 3), np.round(seconds, 3))
    assert begin < denied.min() and denied.max() < end


def test_a_calibration_says_when_the_encoder_hung(rig, tmp_path):
    log, toml, _ = rig
    path = altered(log, tmp_path / "hung.mcap", repeats(40.0, 40.2))
    status, text, err = sinstool(
        "calibrate-hse", path, "--config", toml, "-o", tmp_path / "hse.json", "--json",
        "--method", "axial",
    )  # fmt: skip
    # What is left of the stretch is as good as ever
    assert status == 0 and "hung.mcap: at 9 samples from 40.0 to 40.1 s the gyros deny" in err
    printed = json.loads(text)
    assert kinds(printed)["encoder"]["severity"] == "warning"
    whole = json.loads(rig[2].read_text())
    axial = [one["axial"] for one in (printed["calibration"], whole)]
    off = axial[0]["lambda2_rad"] - axial[1]["lambda2_rad"]
    assert abs(off) < 3.0 * axial[0]["sigma_rad"]


def test_a_sensor_that_hangs_is_no_measurement(rig, tmp_path):
    held = []

    def change(topic, at, message):
        if topic == "/imu/data_raw":
            if 40.0 < at < 43.0:
                message.angular_velocity, message.linear_acceleration = held[-1]
            held.append((message.angular_velocity, message.linear_acceleration))
        return message

    _, printed, _, seconds, error = processed(tmp_path, rig, change)
    assert "imu-hangs" in kinds(printed)
    assert not np.any((seconds > 40.05) & (seconds < 42.95))
    assert error.max() < np.radians(0.06)


def test_a_wrong_value_is_no_measurement(rig, tmp_path):
    def change(topic, at, message):
        if topic == "/imu/data_raw" and abs(at - 40.0) < 0.5 / RATE:
            message.angular_velocity.y = 30.0
        return message

    _, printed, _, seconds, error = processed(tmp_path, rig, change)
    assert kinds(printed)["wrong-values"]["numbers"]["samples"] == 1
    assert len(seconds) == printed["imu"]["n"] and error.max() < np.radians(0.06)


@pytest.mark.parametrize("step", [-5.003, -0.307])
def test_a_clock_that_is_set_back(rig, tmp_path, step):
    """Stamps and log times of all topics: attitudes are those of the samples in their order."""
    log, toml, hse = rig
    types, messages, start = store(), [], None
    with log.open("rb") as stream:
        for schema, channel, m in make_reader(stream).iter_messages():
            start = m.log_time if start is None else start
            move = round(step * 1e9) if m.log_time - start > 40e9 else 0
            message = types.deserialize_cdr(m.data, schema.name)
            stamp = message.header.stamp
            time_ns = stamp.sec * 10**9 + stamp.nanosec + move
            stamp.sec, stamp.nanosec = divmod(time_ns, 10**9)
            messages.append(Message(channel.topic, schema.name, m.log_time + move, message))
    path, out = write_log(tmp_path / "set.mcap", messages), tmp_path / "out.mcap"
    status, text, err = sinstool(
        "process", path, "-o", out, "--config", toml, "--hse", hse, "--json", "--world", "ned"
    )
    found = kinds(json.loads(text))["clock-step"]
    assert found["numbers"]["step_s"] == pytest.approx(step, abs=1e-6) and "was set back" in err
    times, q = read_attitude(out)  # by log times, which come twice
    _, true = read_attitude(log, "/truth/imu")
    assert len(q) == len(true)
    error = (Rotation.from_quat(q[np.argsort(times)]).inv() * Rotation.from_quat(true)).magnitude()
    assert status == 0 and error.max() < WRONG
