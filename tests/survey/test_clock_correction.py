"""Clocks that are set in the middle of a log: times are read as if they had not been."""

from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.core.timeline import sorted_stream
from sinstool.io.readers import open_log
from sinstool.io.readers.streams import ImuUnits, Losses, read_imu
from sinstool.survey.clock_correction import TopicTimes, forward_steps, may_have_stepped
from sinstool.survey.source import prepare
from tests.helpers.imulogs import (
    IMU,
    even_times,
    imu_messages,
    resting,
    serialised,
    write_bag,
)
from tests.helpers.logs import Row, write_bag2
from tests.helpers.quick import mostly_slow
from tests.helpers.stepped_clocks import TOGETHER, nanoseconds, write_stepped
from tests.helpers.unseen_drives import GRADES, drive, record, without_fixes, without_samples

BACK = [-3600.0, -30.0, -2.0, -0.3, -0.05]
FORWARD = [0.3, 2.0, 30.0, 3600.0]
PARTS = [("imu",), ("gnss",), ("imu", "recorder"), ("gnss", "recorder")]


def driven(seed=1):
    truth = drive(seed, 60.0, 5.0)
    return record(truth, GRADES["industrial"], seed, gnss_rate=5.0, sigma=0.5, sigma_v=0.1)


@pytest.fixture(scope="module")
def road():
    return driven()


def read(path):
    """The source, samples in the order of the file, and times of fixes as they are used."""
    with open_log(path) as log:
        source = prepare(log, ProcessConfig())
        samples = read_imu(log, log.channels_of("/imu"), ImuUnits(), Losses())
        gnss = source.aiding.gnss
        return source, sorted_stream(samples, repeats=True), gnss.time_ns[gnss.has_position]


def steps_of(source):
    found = (f for f in source.findings if f.kind == "clock-step")
    return [(f.topic, round(f.numbers["step_s"], 3)) for f in found]


@pytest.mark.parametrize("size", BACK)
def test_all_that_the_computer_stamps(tmp_path, road, size):
    log_ns = write_stepped(tmp_path / "log.mcap", road, [(31.4, size)])
    source, imu, fix_ns = read(tmp_path / "log.mcap")
    assert steps_of(source) == [("/imu", size)]
    (finding,) = (f for f in source.findings if f.kind == "clock-step")
    assert "set back by" in finding.text and "/imu, /fix, /velocity before" in finding.text
    survey = source.survey
    assert (survey.count, survey.gap_count, survey.time_source) == (len(log_ns), 0, "stamp")
    assert (survey.order.backward, survey.order.duplicates) == (0, 0)
    # by the clock as it was set, to the nanosecond
    np.testing.assert_array_equal(imu.stream.time_ns, nanoseconds(road.seconds + size))
    np.testing.assert_array_equal(fix_ns, nanoseconds(road.fixes.seconds + size))


@pytest.mark.parametrize("who", PARTS)
@pytest.mark.parametrize("size", mostly_slow([*BACK, *FORWARD], BACK[0], FORWARD[0]))
def test_stamps_of_some_topics_only(tmp_path, road, who, size):
    """Whichever clock was set, the IMU and the receiver agree again."""
    write_stepped(tmp_path / "log.mcap", road, [(31.4, size)], who)
    source, imu, fix_ns = read(tmp_path / "log.mcap")
    steps = steps_of(source)
    assert steps and all(step == pytest.approx(size, abs=1e-3) for _, step in steps)
    assert source.survey.gap_count == 0 and imu.backward == 0 == imu.repeated
    off = (imu.stream.time_ns - nanoseconds(road.seconds)) / 1e9
    fix_off = (fix_ns - nanoseconds(road.fixes.seconds)) / 1e9
    assert np.ptp(off) < 1e-6 and np.ptp(fix_off) < 1e-3
    # Steps of no more than messages are delayed by may be on either side
    assert abs(off[0] - fix_off[0]) == pytest.approx(0.0, abs=0.06)


@pytest.mark.parametrize("size", [0.0, -2.0])
@pytest.mark.parametrize("channels", [2, 3])
def test_a_topic_on_channels_that_take_turns(tmp_path, road, channels, size):
    """Its messages are read in the order of the file, not channel by channel."""
    steps = [(31.4, size)] if size else []
    write_stepped(tmp_path / "log.mcap", road, steps, channels=channels)
    source, imu, fix_ns = read(tmp_path / "log.mcap")
    assert steps_of(source) == ([("/imu", size)] if size else [])
    assert (source.survey.gap_count, imu.backward, imu.repeated) == (0, 0, 0)
    np.testing.assert_array_equal(imu.stream.time_ns, nanoseconds(road.seconds + size))
    np.testing.assert_array_equal(fix_ns, nanoseconds(road.fixes.seconds + size))


@pytest.mark.parametrize("length", [0.3, 2.0, 10.0])
@pytest.mark.parametrize("begin", [20.0, 31.4, 40.0])
def test_a_recorder_that_stood_still_is_a_gap(tmp_path, road, begin, length):
    """All stamps leap, but the vehicle went on."""
    paused = without_samples(road, begin, length)
    paused = without_fixes(paused, [(begin, begin + length)])
    write_stepped(tmp_path / "log.mcap", paused, [])
    source, _, _ = read(tmp_path / "log.mcap")
    assert not steps_of(source) and source.survey.gap_count == 1


@pytest.mark.parametrize("seed", range(3))
def test_a_clock_set_forward_in_motion(tmp_path, seed):
    """The vehicle did not go on meanwhile, so no time passed."""
    data = driven(seed)
    speed = np.linalg.norm(data.truth.velocity_n, axis=1)
    at = float(data.seconds[np.argmax(speed[: len(speed) - 1000])])
    write_stepped(tmp_path / "log.mcap", data, [(at, 2.0)])
    source, imu, fix_ns = read(tmp_path / "log.mcap")
    assert steps_of(source) == [("/imu", 2.0)] and source.survey.gap_count == 0
    np.testing.assert_array_equal(imu.stream.time_ns, nanoseconds(data.seconds + 2.0))
    np.testing.assert_array_equal(fix_ns, nanoseconds(data.fixes.seconds + 2.0))


@pytest.mark.parametrize("size", BACK)
def test_messages_on_their_way_when_the_clock_was_set(tmp_path, road, size):
    """Stamped before and recorded behind."""
    write_stepped(tmp_path / "log.mcap", road, [(31.41, size)], late_s=0.15)
    source, imu, fix_ns = read(tmp_path / "log.mcap")
    assert steps_of(source) == [("/imu", size)]
    np.testing.assert_array_equal(imu.stream.time_ns, nanoseconds(road.seconds + size))
    np.testing.assert_array_equal(fix_ns, nanoseconds(road.fixes.seconds + size))


@pytest.mark.parametrize("lost", ["imu", "fixes"])
@pytest.mark.parametrize("rate", [1.0, 10.0, 50.0])
def test_a_stall_after_which_some_topics_come_at_once_is_no_step(lost, rate):
    """A recorder hangs; one topic waits in a queue, and messages of the other are lost."""
    times, place = [], 0
    for topic, each in (("imu", 200.0), ("fixes", rate)):
        seconds = np.arange(0.0, 60.0, 1.0 / each)
        held = (seconds > 30.0) & (seconds <= 32.0)
        arrival = np.where(held, 32.0 + 1e-4 * np.cumsum(held) / each, seconds) + 1e-3
        keep = ~held if topic == lost else np.ones(len(held), bool)
        times.append((topic, seconds[keep], arrival[keep]))
    arrivals = np.concatenate([arrival for _, _, arrival in times])
    rank = np.argsort(np.argsort(arrivals, kind="stable"))
    made = []
    for topic, seconds, arrival in times:
        mine, place = rank[place : place + len(seconds)], place + len(seconds)
        number = np.arange(len(seconds))
        made.append(
            TopicTimes(topic, nanoseconds(seconds), nanoseconds(arrival), mine, 0 * number, number)
        )
    log = SimpleNamespace(channels_of=lambda topic, *types: [])
    assert not list(forward_steps(log, made[0], made[1:]))


def test_back_and_forth(tmp_path, road):
    write_stepped(tmp_path / "log.mcap", road, [(20.0, -2.0), (31.4, -0.3), (45.0, -7.0)])
    source, imu, fix_ns = read(tmp_path / "log.mcap")
    assert steps_of(source) == [("/imu", -2.0), ("/imu", -0.3), ("/imu", -7.0)]
    np.testing.assert_array_equal(imu.stream.time_ns, nanoseconds(road.seconds - 9.3))
    np.testing.assert_array_equal(fix_ns, nanoseconds(road.fixes.seconds - 9.3))


@pytest.mark.parametrize("ros", [1, 2])
def test_bags_keep_the_order_of_arrival(tmp_path, ros):
    """An IMU alone, most of whose computer's clock is an hour ahead."""
    right_ns = even_times(4000)
    shown_ns = right_ns + np.where(np.arange(4000) < 1500, 3600 * 10**9, 0)
    log_ns = shown_ns + np.random.default_rng(0).integers(200_000, 900_000, 4000)
    rows = imu_messages(shown_ns, *resting(4000), log_ns, ros=ros)
    if ros == 1:
        path = write_bag(tmp_path / "log.bag", rows)
    else:
        content = [
            Row("/imu", row.log_ns, row.log_ns, serialised(row.message, IMU, 2)) for row in rows
        ]
        path = write_bag2(tmp_path / "log", content, types={"/imu": IMU})
    with open_log(path) as log:
        source = prepare(log, ProcessConfig())
        assert steps_of(source) == [("/imu", -3600.0)]
        samples = read_imu(log, log.channels_of("/imu"), ImuUnits(), Losses())
        np.testing.assert_array_equal(sorted_stream(samples).stream.time_ns, right_ns)


def test_times_of_recording_that_nothing_depends_on_are_a_note(tmp_path, road):
    write_stepped(tmp_path / "log.mcap", road, [(31.4, -2.0)], ("recorder",))
    source, imu, _ = read(tmp_path / "log.mcap")
    (finding,) = (f for f in source.findings if f.kind == "clock-step")
    assert finding.severity.name == "NOTE" and "no stamps" in finding.text
    np.testing.assert_array_equal(imu.stream.time_ns, nanoseconds(road.seconds))


def test_a_clock_that_nobody_sets(tmp_path, road):
    log_ns = write_stepped(tmp_path / "log.mcap", road, [], TOGETHER)
    source, imu, _ = read(tmp_path / "log.mcap")
    assert not steps_of(source)
    np.testing.assert_array_equal(imu.stream.log_time_ns, log_ns)


@pytest.mark.parametrize("size_s", [-30.0, -0.5, 40.0])
@pytest.mark.parametrize("row", [500, 1000, 1700])  # within a part, and where two meet
@pytest.mark.parametrize("column", [0, 1])
def test_a_step_shows_wherever_the_parts_of_a_log_meet(size_s, row, column):
    times = np.tile(np.arange(3000, dtype=np.int64) * 10_000_000, (2, 1))
    parts = [(0, 1000), (1000, 1000), (1000, 1700), (1700, 3000)]
    assert not may_have_stepped([(times[0, a:b], times[1, a:b]) for a, b in parts])
    times[column, row:] += round(size_s * 1e9)
    assert may_have_stepped([(times[0, a:b], times[1, a:b]) for a, b in parts])
