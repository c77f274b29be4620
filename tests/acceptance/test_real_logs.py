"""Every real log through `process`, and those with a reference against it."""

import collections

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.config.logs import EMITS
from sinstool.core.streams import concatenate
from sinstool.io.readers import open_log
from sinstool.io.readers.streams import ImuUnits, Losses, read_columns, read_imu
from sinstool.io.readers.topics import choose_imu
from sinstool.io.writers.solution_topics import topic_of
from sinstool.methods.coning.registry import algorithm
from sinstool.methods.coning.stage import ConingStage
from sinstool.methods.strapdown.attitude import AttitudePropagator
from sinstool.pipelines.process.run import process
from tests.helpers.imulogs import (
    ENU_NED,
    FLU_FRD,
    REAL,
    products,
    read_attitude,
    read_topic,
    stamp_ns,
)
from tests.helpers.logs import real

pytestmark = pytest.mark.slow

BROAD_06 = "broad/broad_06_undisturbed_fast_rotation_A.mcap"
BROAD_02 = "broad/broad_02_undisturbed_slow_rotation_B.mcap"
LAG_NS = 4_000_000


OWN = {topic_of(name) for name in EMITS}


def run(path, out, **groups):
    return process(path, out, build(ProcessConfig, groups)).to_json()


def axes_of(path):
    return {"body_axes": "frd"} if path.startswith("px4") else {}


def messages(log, own=None):
    """How often each message is there; ``own`` tells our topics from the log's."""
    result = collections.Counter()
    for batch in log.batches():
        data = batch.buffer.data
        rows = (batch.channel, batch.log_time, batch.offset, batch.length)
        for number, time, at, length in zip(*(r.tolist() for r in rows), strict=True):
            topic = log.channels[number].topic
            if own is None or (topic in OWN) == own:
                result[topic, time, hash(bytes(data[at : at + length]))] += 1
    return result


def attitudes(path):
    """Stamps and scalar-last orientations of /sinstool/imu and /sinstool/attitude."""
    out = []
    with open_log(path) as log:
        for topic, field in (
            ("/sinstool/imu", "orientation"),
            ("/sinstool/attitude", "quaternion"),
        ):
            columns = {
                "sec": ["header.stamp.sec"],
                "nanosec": ["header.stamp.nanosec"],
                "q": [f"{field}.{axis}" for axis in "xyzw"],
            }
            blocks = [v for _, v in read_columns(log, log.channels_of(topic), columns, Losses())]
            sec, nanosec, q = (np.concatenate([b[c] for b in blocks]) for c in columns)
            out.append((sec.astype(np.int64) * 10**9 + nanosec.astype(np.int64), q))
    (times, q), (same_times, same_q) = out
    np.testing.assert_array_equal(times, same_times)
    np.testing.assert_array_equal(q, same_q)
    return times, q


def raw_imu(path, axes="flu"):
    with open_log(real(path)) as log:
        topic = choose_imu(log, None)
        return concatenate(list(read_imu(log, topic.channels, ImuUnits(axes), Losses())))


@pytest.mark.parametrize("path", REAL)
def test_every_log(tmp_path, path):
    source, out = real(path), tmp_path / "out.mcap"
    summary = run(source, out, input=axes_of(path))
    times, q = attitudes(out)
    stamps = raw_imu(path, axes_of(path).get("body_axes", "flu")).time_ns
    np.testing.assert_array_equal(times, np.unique(stamps))
    assert summary["imu"]["n"] == summary["output"]["attitudes"] == len(times)
    assert summary["imu"]["time_source"] == "stamp"
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-14)
    with open_log(source) as log, open_log(out) as written:
        assert messages(log) == messages(written, own=False)
        assert written.profile == ("ros1" if log.profile == "ros1" else "ros2")
        ours = messages(written, own=True)
    by_topic = collections.Counter()
    for (topic, _, _), count in ours.items():
        by_topic[topic] += count
    assert set(by_topic) == set(summary["output"]["topics"])
    by_topic.pop("/sinstool/diagnostics", None)
    assert set(by_topic.values()) == {len(times)}
    assert [p.name for p in tmp_path.iterdir()] == ["out.mcap"]


@pytest.mark.parametrize(
    "path", ["imu_tools/sparkfun_razor.bag", "px4/px4_fmuv6c_inflight_6s.mcap"]
)
def test_stock_readers_see_the_same(tmp_path, path):
    out = tmp_path / "out.mcap"
    run(real(path), out, input=axes_of(path))
    times, q = attitudes(out)
    stock_times, stock_q = read_attitude(out)
    np.testing.assert_array_equal(stock_times, times)
    np.testing.assert_array_equal(stock_q, q)
    stock = read_topic(out, "/sinstool/imu")
    assert [stamp_ns(m) for _, m in stock] == times.tolist()


# -- the optical reference -------------------------------------------------------------------


def reference(path):
    """Times (parsed as integers) and rotations of the rows that have one."""
    lines = [line.split(",") for line in path.read_text().splitlines() if line[0] != "#"]
    names, rows = lines[0], lines[1:]
    at = [names.index(c) for c in ("qx", "qy", "qz", "qw")]
    rows = [r for r in rows if all(r[i] and np.isfinite(float(r[i])) for i in at)]

    def ns(text):
        whole, _, part = text.partition(".")
        return int(whole) * 10**9 + int(part.ljust(9, "0"))

    q = Rotation.from_quat([[float(r[i]) for i in at] for r in rows])
    return np.array([ns(r[names.index("time_s")]) for r in rows]), q


def errors_deg(log, out):
    """At 10 s, 60 s and the end of the reference, less the heading offset of its first row."""
    times, truth = reference(real(log).with_suffix(".ref.csv"))
    stamps, q = attitudes(out)
    inside = (times + LAG_NS >= stamps[0]) & (times + LAG_NS <= stamps[-1])
    times, truth = times[inside], truth[inside]
    origin = stamps[0]
    estimate = Slerp((stamps - origin) / 1e9, Rotation.from_quat(q))
    estimate = estimate((times + LAG_NS - origin) / 1e9)
    difference = (truth[0] * estimate[0].inv()).as_matrix()
    heading = np.arctan2(difference[1, 0] - difference[0, 1], difference[0, 0] + difference[1, 1])
    turned = Rotation.from_euler("z", heading) * estimate
    off = np.degrees((turned.inv() * truth).magnitude())
    elapsed = (times - times[0]) / 1e9
    return np.array([off[np.argmin(np.abs(elapsed - t))] for t in (10.0, 60.0, elapsed[-1])])


def test_broad_06_from_level(tmp_path):
    options = {"align": {"align": "level"}, "navigation": {"attitude": "inertial"}}
    run(real(BROAD_06), tmp_path / "out.mcap", **options)
    result = errors_deg(BROAD_06, tmp_path / "out.mcap")
    assert (result < [0.2, 1.5, 3.0]).all(), result


def test_broad_02_from_the_reference(tmp_path):
    """Not worse by more than a quarter than plain integration in the data's README."""
    _, truth = reference(real(BROAD_02).with_suffix(".ref.csv"))
    # its world is z up with some heading: ENU will do
    angles = (ENU_NED * truth[0] * FLU_FRD).as_euler("ZYX", degrees=True)[::-1]
    options = {"align": "fixed", "initial_attitude": tuple(map(float, angles))}
    inertial = {"attitude": "inertial"}
    run(real(BROAD_02), tmp_path / "out.mcap", align=options, navigation=inertial)
    result = errors_deg(BROAD_02, tmp_path / "out.mcap")
    assert (result < 1.25 * np.array([0.05, 1.37, 6.30])).all(), result


# -- coning on real motion -------------------------------------------------------------------


@pytest.fixture(scope="module")
def increments():
    """Instants of broad_06, what it turned between them, and the attitude where that ends.

    A multiple of sixteen intervals.
    """
    imu = raw_imu(BROAD_06)
    times = imu.time_ns[: (len(imu) - 1) // 16 * 16 + 1]
    turned = imu.gyro[1 : len(times)] * (np.diff(times) / 1e9)[:, None]
    return times, turned, products(Rotation.from_rotvec(turned))[-1]


def end_attitude(name, times, turned):
    """Through the stage; the log begins at rest, so what came before is nothing."""
    nominal = float(np.median(np.diff(times))) / 1e9
    stage = ConingStage(algorithm(name), "increment", nominal_interval=nominal)
    samples = np.concatenate((np.zeros((1, 3)), turned))
    propagator = AttitudePropagator([1.0, 0.0, 0.0, 0.0])
    for answer in (stage.push(samples, times), stage.finish()):
        propagator.push(answer.rotation_vector, answer.interval)
    return Rotation.from_quat(propagator.q_nb, scalar_first=True)


def off_deg(increments, name, summed):
    """End attitude from sums of so many samples, against that of every sample by itself."""
    times, turned, full = increments
    sums = turned.reshape(-1, summed, 3).sum(axis=1)
    return np.degrees((full.inv() * end_attitude(name, times[::summed], sums)).magnitude())


@pytest.mark.parametrize(("summed", "expected"), [(1, 0.0), (4, 1.53), (8, 6.37), (16, 25.0)])
def test_sums_without_compensation(increments, summed, expected):
    """The table of the data's README."""
    assert off_deg(increments, "uncompensated", summed) == pytest.approx(expected, abs=0.1)


@pytest.mark.parametrize(
    ("name", "summed"), [("optimal-2", 8), ("savage-two-speed-16", 1), ("savage-two-speed-8", 2)]
)
def test_updates_of_sixteen_samples_with_compensation(increments, name, summed):
    """25 degrees without. What is left, half a degree, is of third order in turns of 0.9 rad."""
    assert off_deg(increments, name, summed) < 0.6


@pytest.mark.parametrize(("summed", "limit"), [(4, 0.15), (8, 0.7), (16, 2.5)])
@pytest.mark.parametrize("name", ["previous-1", "previous-2", "previous-3"])
def test_compensation_from_the_updates_before(increments, name, summed, limit):
    """Whole sums of sixteen know nothing of what happens inside: ten times better all the same."""
    result = off_deg(increments, name, summed)
    assert result < limit
    assert result < 0.12 * off_deg(increments, "uncompensated", summed)


def test_previous_1_by_hand(increments):
    """Savage's equation without any of our code."""
    times, turned, _ = increments
    sums = turned.reshape(-1, 16, 3).sum(axis=1)
    before = np.vstack((np.zeros((1, 3)), sums[:-1]))
    by_hand = products(Rotation.from_rotvec(sums + np.cross(before, sums) / 12.0))[-1]
    ours = end_attitude("previous-1", times[::16], sums)
    assert (by_hand.inv() * ours).magnitude() < 1e-9


@pytest.mark.parametrize("name", [f"optimal-{n}" for n in range(2, 7)])
def test_samples_as_they_are(increments, name):
    """Six samples an update at most: 0.1 degrees is what compensation makes of 190 s."""
    assert off_deg(increments, name, 1) < 0.2
