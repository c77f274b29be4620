"""Velocities that are not what they are read as: found, named and left out; right ones stay."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.config import InputOptions
from sinstool.core.streams import Gnss, Velocity
from sinstool.io.readers import open_log
from sinstool.survey.gnss import read_gnss
from sinstool.survey.velocity import agreement, odd_frame
from tests.helpers.imulogs import T0, header, serialised, store
from tests.helpers.unseen_drives import (
    DEG,
    LEVER,
    PERFECT,
    drive,
    fix_messages,
    record,
    walk,
    write,
)
from tests.helpers.unseen_vehicles import helicopter

DURATION = 240.0


@pytest.fixture(scope="module")
def roads():
    return [drive(seed, DURATION, rest=20.0) for seed in (11, 12, 13)]


def measured(truth, seed, sigma=2.5, stated=True, rate=5.0):
    """Fixes with white noise, and true velocity over ground at 10 Hz with 5 cm/s."""
    random = np.random.default_rng(seed)
    fixes = record(truth, PERFECT, seed, gnss_rate=rate, sigma=sigma).fixes
    times = T0 + np.round(fixes.seconds * 1e9).astype(np.int64)
    n = len(times)
    covariance = np.tile(sigma**2 * np.eye(3), (n, 1, 1))
    kind = np.full(n, 2 if stated else 0)
    gnss = Gnss(times, times, fixes.latitude, fixes.longitude, fixes.height, covariance, kind,
                np.zeros(n, int))  # fmt: skip
    rows = np.arange(0, len(truth.seconds), 20)
    times = T0 + np.round(truth.seconds[rows] * 1e9).astype(np.int64)
    velocity = truth.velocity_n[rows] + 0.05 * random.standard_normal((len(rows), 3))
    return gnss, Velocity(times, times, velocity, np.zeros((len(rows), 3, 3)))


def ways(velocity_n):
    """Speed and course of velocities."""
    return np.hypot(*velocity_n.T[:2]), np.arctan2(velocity_n[:, 1], velocity_n[:, 0])


def in_body(velocity_n):
    """As an odometer says: forward and left, read as east and north."""
    return np.stack([np.zeros(len(velocity_n)), ways(velocity_n)[0], 0.0 * velocity_n[:, 2]], 1)


def turned(velocity_n, angle):
    speed, course = ways(velocity_n)
    return np.stack(
        [speed * np.cos(course + angle), speed * np.sin(course + angle), velocity_n[:, 2]], axis=1
    )


def radians_as_degrees(velocity_n):
    speed, course = ways(velocity_n)
    course = course % (2.0 * np.pi) * DEG
    return np.stack([speed * np.cos(course), speed * np.sin(course), velocity_n[:, 2]], axis=1)


WRONG = {
    "body axes": (in_body, "the vehicle's own axes"),
    "odom frame": (lambda v: turned(v, -1.2), "turned by 69 deg"),
    "radians read as degrees": (radians_as_degrees, ""),
    "north, east, down": (lambda v: v[:, [1, 0, 2]] * [1.0, 1.0, -1.0], "north, east, down"),
    "km/h": (lambda v: 3.6 * v, "3.6 times as large"),
    "backward": (lambda v: -v, "turned by"),
    "nothing": (lambda v: 0.0 * v, "zero while the fixes move"),
}


@pytest.mark.parametrize("sigma", [0.02, 2.5])
@pytest.mark.parametrize("name", WRONG)
def test_a_velocity_that_contradicts_its_fixes_is_found_and_named(roads, name, sigma):
    spoil, likeness = WRONG[name]
    for seed, road in enumerate(roads):
        fixes, velocity = measured(road, seed, sigma)
        result = agreement(fixes, replace(velocity, velocity_n=spoil(velocity.velocity_n)))
        assert result.contradicts and likeness in result.likeness, (seed, result)


@pytest.mark.parametrize("late_s", [0.0, 0.5])
@pytest.mark.parametrize(("sigma", "stated"), [(0.02, True), (2.5, True), (2.5, False)])
def test_a_right_velocity_agrees_however_noisy_the_fixes_and_late(roads, sigma, stated, late_s):
    for seed, road in enumerate(roads):
        fixes, velocity = measured(road, seed, sigma, stated)
        late = replace(velocity, time_ns=velocity.time_ns + round(late_s * 1e9))
        result = agreement(fixes, late)
        assert result.misfit is not None and result.misfit < 0.25, (seed, result)


@pytest.mark.parametrize("apart_s", [5, 10])
@pytest.mark.parametrize("name", ["right", *WRONG])
def test_velocities_too_far_apart_to_be_integrated(roads, name, apart_s):
    spoil, _ = WRONG.get(name, (lambda v: v, ""))
    for seed, road in enumerate(roads):
        fixes, velocity = measured(road, seed, 0.2)
        seldom = velocity.rows(np.arange(0, len(velocity), 10 * apart_s))
        result = agreement(fixes, replace(seldom, velocity_n=spoil(seldom.velocity_n)))
        assert result.misfit is not None, seed
        assert result.contradicts == (name != "right"), (seed, result)


@pytest.mark.parametrize(
    ("make", "sigma", "metres"), [(helicopter, 0.3, 234.0), (walk, 0.67, 9.0), (walk, 0.67, 14.0)]
)
@pytest.mark.parametrize("share", [0.01, 0.05, 0.1])
@pytest.mark.slow
def test_bad_fixes_say_nothing_against_a_velocity(make, sigma, metres, share):
    """Of a slow vehicle each would be a longer way than those it drives."""
    for seed in range(4):
        truth = make(seed, DURATION)
        fixes, velocity = measured(truth, seed, sigma, rate=1.0)
        random = np.random.default_rng(seed)
        bad = random.random(len(fixes.latitude)) < share
        latitude = fixes.latitude + bad * random.choice([-1.0, 1.0], len(bad)) * metres / 6.37e6
        spoilt = replace(fixes, latitude=latitude)
        assert not agreement(spoilt, velocity).contradicts, seed
        wrong = replace(velocity, velocity_n=turned(velocity.velocity_n, -1.2))
        assert agreement(spoilt, wrong).contradicts, seed


def test_a_vehicle_that_stands_shows_nothing():
    standing = drive(5, 60.0, rest=60.0)
    fixes, velocity = measured(standing, 1)
    assert agreement(fixes, velocity).misfit is None
    assert agreement(fixes, velocity.rows(slice(0, 1))).misfit is None


@pytest.mark.parametrize(
    ("frame", "child", "odd"),
    [
        ("gps", None, False),
        ("map", None, False),
        ("", None, False),
        ("robot/base_link", None, True),
        ("odom", None, True),
        ("wheel_odom", None, True),
        ("map", "base_link", True),
        ("odom", "map", False),
        ("odom", "", True),
        ("map", "", False),
    ],
)
def test_frames_by_name(frame, child, odd):
    assert bool(odd_frame(frame, child)) == odd


# --- logs --------------------------------------------------------------------------------------


def odometry(truth, spoil=in_body, topic="/wheels/odometry", frame="odom", child="base_link"):
    """Messages of wheel odometry at 20 Hz."""
    types = store().types
    vector, point = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Point"]
    still = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    out, nothing, name = [], np.zeros(36), "nav_msgs/msg/Odometry"
    for k in range(0, len(truth.seconds), 10):
        stamp = T0 + round(truth.seconds[k] * 1e9) + 1000
        north, east, down = spoil(truth.velocity_n[k : k + 1])[0].tolist()
        twist = types["geometry_msgs/msg/Twist"](vector(east, north, -down), vector(0.0, 0.0, 0.0))
        pose = types["geometry_msgs/msg/Pose"](point(0.0, 0.0, 0.0), still)
        message = types[name](
            header=header(stamp, frame),
            child_frame_id=child,
            pose=types["geometry_msgs/msg/PoseWithCovariance"](pose, nothing),
            twist=types["geometry_msgs/msg/TwistWithCovariance"](twist, nothing),
        )
        out.append((stamp, topic, name, serialised(message, name, 2)))
    return out


def read(path, references=(), **options):
    with open_log(path) as log:
        log.references = frozenset(references)
        return read_gnss(log, InputOptions(**options), False)


def kinds(aiding):
    return {f.kind: f for f in aiding.findings}


def test_wheel_odometry_beside_fixes_is_left_out_and_a_user_may_insist(tmp_path, roads):
    data = record(roads[0], PERFECT, 1)
    log = write(tmp_path / "log.mcap", data, odometry(roads[0]))
    aiding = read(log)
    finding = kinds(aiding)["velocity-left-out"]
    assert aiding.velocity_topic == "" and not aiding.gnss.has_velocity.any()
    assert aiding.gnss.has_position.all() and len(aiding.gnss) == len(data.fixes.seconds)
    for part in ("/wheels/odometry", "child_frame_id, base_link", "/fix", "own axes"):
        assert part in finding.text
    assert finding.answer.startswith("--velocity-topic /wheels/odometry")
    insisted = read(log, velocity_topic="/wheels/odometry")
    assert insisted.gnss.has_velocity.any()
    assert "--velocity-topic none" in kinds(insisted)["velocity-contradicts"].answer
    assert kinds(read(log, velocity_topic="none")) == {}


def test_without_fixes_that_tell_names_of_frames_decide(tmp_path):
    standing = drive(5, 30.0, rest=30.0)
    data = record(standing, PERFECT, 1)
    log = write(tmp_path / "body.mcap", data, odometry(standing))
    assert "velocity-left-out" in kinds(read(log))
    log = write(tmp_path / "world.mcap", data, odometry(standing, lambda v: v, child="map"))
    assert read(log).gnss.has_velocity.any()


def test_an_odometry_that_is_in_east_north_up_after_all_is_used(tmp_path, roads):
    log = write(
        tmp_path / "log.mcap", record(roads[1], PERFECT, 1), odometry(roads[1], lambda v: v)
    )
    aiding = read(log)
    assert aiding.velocity_topic == "/wheels/odometry" and aiding.gnss.has_velocity.any()


def test_the_better_of_two_receivers_is_used_and_its_velocity(tmp_path, roads):
    truth = roads[2]
    good = record(truth, PERFECT, 1, gnss_rate=2.0, sigma=0.5, sigma_v=0.05)
    poor = record(truth, PERFECT, 2, gnss_rate=5.0, sigma=5.0, sigma_v=0.5)
    more = [*fix_messages(poor.fixes, "/a"), *fix_messages(good.fixes, "/b")]
    none = replace(good, fixes=good.fixes.rows(slice(0, 0)))
    log = write(tmp_path / "log.mcap", none, more)
    aiding = read(log)
    assert (aiding.fix_topic, aiding.velocity_topic) == ("/b/fix", "/b/velocity")
    said = kinds(aiding)
    assert "--gnss-topic" in said["several-receivers"].answer
    assert "/b/fix is used" in said["several-receivers"].text
    assert "--velocity-topic" in said["several-velocities"].answer
    assert read(log, gnss_topic="/a/fix").velocity_topic == "/a/velocity"
    # a receiver that works for a few seconds only is no choice, however good it says it is
    brief = replace(good, fixes=good.fixes.rows(slice(0, 60)))
    more = [*fix_messages(poor.fixes, "/a"), *fix_messages(brief.fixes, "/b")]
    assert read(write(tmp_path / "brief.mcap", none, more)).fix_topic == "/a/fix"


@pytest.mark.slow
def test_a_reference_is_no_measurement_unless_it_is_named_or_alone(tmp_path, roads):
    truth = roads[2]
    good = record(truth, PERFECT, 1, gnss_rate=2.0, sigma=0.01, sigma_v=0.01)
    poor = record(truth, PERFECT, 2, gnss_rate=2.0, sigma=2.0, sigma_v=0.2)
    none = replace(good, fixes=good.fixes.rows(slice(0, 0)))
    two = [*fix_messages(poor.fixes, "/a"), *fix_messages(good.fixes, "/b")]
    log, names = write(tmp_path / "log.mcap", none, two), ("/b/fix", "/b/velocity")
    assert read(log).fix_topic == "/b/fix"
    aiding = read(log, names)
    assert (aiding.fix_topic, aiding.velocity_topic) == ("/a/fix", "/a/velocity")
    assert not {"several-receivers", "truth-used"} & set(kinds(aiding))
    named = read(log, names, gnss_topic="/b/fix")
    assert named.fix_topic == "/b/fix" and kinds(named)["truth-used"].topic == "/b/fix"
    alone = write(tmp_path / "alone.mcap", none, fix_messages(good.fixes, "/b"))
    aiding = read(alone, names)
    assert aiding.fix_topic == "/b/fix" and not aiding.velocity_topic
    assert "--truth" in kinds(aiding)["truth-used"].text and "truth-used" not in kinds(read(alone))


def test_no_topic_is_used_where_none_is_named(tmp_path, roads):
    data = record(roads[2], PERFECT, 1, sigma_v=0.1, lever=LEVER)
    log = write(tmp_path / "log.mcap", data)
    assert read(log, gnss_topic="none", velocity_topic="none").gnss is None
    # who wants no GNSS wants no velocity of the receiver, unless it is named
    without = read(log, gnss_topic="none")
    assert without.gnss is None and not without.velocity_topic
    topic = read(log).velocity_topic
    assert read(log, gnss_topic="none", velocity_topic=topic).gnss.has_velocity.all()
    fixes = read(log, velocity_topic="none").gnss
    assert fixes.has_position.all() and not fixes.has_velocity.any()


@pytest.mark.parametrize("seed", range(3))
def test_a_few_wild_velocities_are_no_wrong_axes(roads, seed):
    """A receiver at 1 Hz of whose velocities one in twelve is off by tens of m/s."""
    gnss, velocity = measured(roads[seed], seed)
    velocity = velocity.rows(slice(0, None, 10))
    random = np.random.default_rng([seed, 7])
    wild = np.where(random.random(len(velocity)) < 0.08, 40.0, 0.0)[:, None]
    said = velocity.velocity_n + wild * random.standard_normal((len(velocity), 3))
    assert not agreement(gnss, replace(velocity, velocity_n=said)).contradicts
    # and the wrong ones among them are still found
    assert agreement(gnss, replace(velocity, velocity_n=3.6 * said)).contradicts
