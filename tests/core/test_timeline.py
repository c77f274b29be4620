from dataclasses import asdict
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sinstool.core.streams import Imu, concatenate
from sinstool.core.timeline import (
    SECOND,
    Order,
    OrderCounts,
    longest_part,
    mean_rates,
    means_with_lost,
    ordered,
    segments,
)

BASES = [0, -50, 1_700_000_000_000_000_000]


def columns(times, gyro=None):
    """A stream whose every row can be told from the others."""
    n = len(times)
    number = np.arange(n, dtype=float)
    gyro = np.stack((number, -number, number**2), axis=1) if gyro is None else gyro
    times = np.asarray(times, np.int64)
    return Imu(times, np.arange(n, dtype=np.int64), gyro, gyro + 0.5)


def cut(stream, edges):
    edges = [0, *sorted({e % (len(stream) + 1) for e in edges}), len(stream)]
    return [stream.rows(slice(a, b)) for a, b in pairwise(edges) if b > a]


@st.composite
def stamps(draw):
    """Even, bursty, repeated, late, and leaping stamps, mixed."""
    step = st.one_of(
        st.just(5),
        st.sampled_from([0, 1, 5, 6, -1, -5, -7]),
        st.sampled_from([0, 100, -90, 40, -40, 2000, -2000]),
    )
    steps = draw(st.lists(step, min_size=0, max_size=60))
    return (draw(st.sampled_from(BASES)) + np.cumsum([0, *steps])).tolist()


edges = st.lists(st.integers(0, 1000), max_size=12)
values = st.integers(0, 2)


def order_by_hand(times, gyro, horizon):
    """One sample at a time."""
    counts = OrderCounts()
    row_at = {}
    newest = last = None
    for row, t in enumerate(times):
        if last is not None and t < last:
            counts.backward += 1
        last = t
        if newest is not None and t < newest:
            counts.lateness_ns = max(counts.lateness_ns, newest - t)
            if newest - t > horizon:
                counts.late += 1
                continue
        newest = t if newest is None else max(newest, t)
        if t in row_at:
            counts.duplicates += 1
            counts.differing_duplicates += int(any(gyro[row] != gyro[row_at[t]]))
        else:
            row_at[t] = row
    return [row_at[t] for t in sorted(row_at)], counts


@given(stamps(), edges, st.integers(0, 120), st.data())
def test_order_is_that_of_one_sample_at_a_time(times, at, horizon, data):
    # few different values, so that duplicates are sometimes true copies
    gyro = np.array([[data.draw(values), 0, 0] for _ in times], float)
    stream = columns(times, gyro)
    order = Order(horizon)
    out = concatenate(list(ordered(cut(stream, at), order)))
    rows, counts = order_by_hand(times, gyro, horizon)
    assert asdict(order.counts) == asdict(counts)
    np.testing.assert_array_equal(out.log_time_ns, rows)  # which number the rows
    np.testing.assert_array_equal(out.time_ns, np.array(times)[rows])
    np.testing.assert_array_equal(out.gyro, gyro[rows])
    np.testing.assert_array_equal(out.accel, gyro[rows] + 0.5)
    assert np.all(np.diff(out.time_ns) > 0)


@given(stamps(), edges, st.integers(0, 120))
def test_samples_are_held_no_longer_than_the_horizon(times, at, horizon):
    order = Order(horizon)
    newest = None
    for block in cut(columns(times), at):
        order.push(block)
        newest = max(int(block.time_ns.max()), newest if newest is not None else -(2**62))
        held = order.held
        assert held is None or np.all(held.time_ns > newest - horizon)


@pytest.mark.parametrize("block", [1, 2, 7, 100])
def test_late_samples_within_and_beyond_the_horizon(block):
    horizon = 100 * 5
    times = (np.arange(400) * 5).tolist()
    moved = times.pop(100)  # comes 100 samples late: just in time
    times.insert(200, moved)
    lost = times.pop(50)  # comes far too late
    times.append(lost)
    order = Order(horizon)
    blocks = [columns(times).rows(slice(i, i + block)) for i in range(0, 400, block)]
    out = concatenate(list(ordered(blocks, order)))
    assert out.time_ns.tolist() == [5 * k for k in range(400) if k != 50]
    assert asdict(order.counts) == {
        "backward": 2,
        "lateness_ns": (399 - 50) * 5,
        "duplicates": 0,
        "differing_duplicates": 0,
        "late": 1,
        "keep_repeated": False,
    }


def test_the_first_of_equal_stamps_stays():
    gyro = np.array([[1, 0, 0], [2, 0, 0], [1, 0, 0], [2, 0, 0]], float)
    order = Order(10)
    out = concatenate(list(ordered([columns([7, 7, 7, 7], gyro)], order)))
    assert out.gyro.tolist() == [[1, 0, 0]]
    # two of the three hold other values than the one kept
    assert (order.counts.duplicates, order.counts.differing_duplicates) == (3, 2)


@given(stamps(), edges, st.data())
def test_samples_of_one_time_may_be_kept_apart(times, at, data):
    """Later ones a nanosecond later; a sample that repeats all values was sent twice."""
    gyro = np.array(
        data.draw(st.lists(st.integers(0, 3), min_size=len(times), max_size=len(times)))
    )
    values = np.repeat(gyro[:, None], 3, axis=1).astype(float)
    order = Order(10**9, keep_repeated=True)
    out = list(ordered(cut(columns(times, values), at), order))
    got = concatenate(out) if out else None
    expected: list[tuple[int, int]] = []
    before = None
    for row in sorted(range(len(times)), key=lambda k: (times[k], k)):
        this = int(times[row]), int(gyro[row])
        if this != before:
            time = max(this[0], expected[-1][0] + 1) if expected else this[0]
            expected.append((time, this[1]))
        before = this
    if got is None:
        assert not expected
        return
    assert got.time_ns.tolist() == [time for time, _ in expected]
    assert got.gyro[:, 0].tolist() == [value for _, value in expected]
    assert order.counts.duplicates == len(times) - len(expected)


def test_nothing_in_nothing_out():
    assert list(ordered([], Order())) == []
    assert list(segments([], 5)) == []
    assert list(mean_rates([])) == []


def strictly(times):
    return sorted(set(times))


@given(stamps(), edges, st.integers(1, 60))
def test_segments_end_at_every_gap_and_nowhere_else(times, at, limit):
    stream = columns(strictly(times))
    pieces = list(segments(cut(stream, at), limit))
    assert all(len(p.imu) for p in pieces)
    out = concatenate([p.imu for p in pieces])
    np.testing.assert_array_equal(out.gyro, stream.gyro)

    starts, row = [], 0
    for piece in pieces:
        if piece.starts:
            starts.append((row, piece.gap_s))
        else:
            assert piece.gap_s == 0.0
        row += len(piece.imu)
    t = stream.time_ns.tolist()
    expected = [(0, 0.0)]
    for k in range(1, len(t)):
        if t[k] - t[k - 1] > limit:
            expected.append((k, (t[k] - t[k - 1]) / SECOND))
    assert starts == expected


@given(
    stamps(),
    edges,
    st.one_of(st.none(), st.floats(1.0, 20.0)),
    st.one_of(st.none(), st.integers(0, 60)),
)
def test_mean_rates_divide_by_each_interval(times, at, nominal, limit):
    stream = columns(strictly(times))
    out = concatenate(list(mean_rates(cut(stream, at), nominal, limit)))
    t = stream.time_ns.tolist()
    for k in range(len(t)):
        if k:
            step = float(t[k] - t[k - 1])
            if nominal is not None and limit is not None and step > limit:
                step = nominal
        elif nominal is not None:
            step = nominal
        else:
            step = float(t[1] - t[0]) if len(t) > 1 else float(SECOND)
        np.testing.assert_array_equal(out.gyro[k], stream.gyro[k] / (step / SECOND))
        np.testing.assert_array_equal(out.accel[k], stream.accel[k] / (step / SECOND))
    np.testing.assert_array_equal(out.time_ns, stream.time_ns)
    np.testing.assert_array_equal(out.log_time_ns, stream.log_time_ns)


STEP = 5_000_000  # ns


def means(there, rocking):
    """Means of a rate that rocks over the intervals that end at the samples; which are there."""
    edges = np.arange(len(there) + 1) * STEP / SECOND
    turned = -np.cos(rocking * edges)[:, None] * [1.0, -2.0, 0.5]
    rate = np.diff(turned, axis=0) / (STEP / SECOND)
    times = np.arange(1, len(there) + 1) * STEP
    log = Imu(times[there], times[there], rate[there], 9.0 * rate[there])
    return log, turned, rate


@given(st.lists(st.booleans(), min_size=40, max_size=80), st.floats(1.0, 12.0), st.data())
def test_a_lost_mean_lies_between_its_neighbours(there, rocking, data):
    """However many are lost and wherever blocks end, the angle is that of all intervals."""
    there = np.array(there)
    there[[0, -1]] = True
    imu, turned, rate = means(there, rocking)
    edges = data.draw(st.lists(st.integers(0, len(imu)), max_size=4))
    blocks = [b for b in cut(imu, sorted(edges)) if len(b)]
    out = concatenate(list(means_with_lost(blocks, STEP, 100 * STEP)))
    assert np.array_equal(out.time_ns, imu.time_ns)
    steps = np.diff(imu.time_ns, prepend=0) / SECOND
    angle = np.cumsum(out.gyro * steps[:, None], axis=0)
    lost = np.diff(np.flatnonzero(there), prepend=-1) - 1
    # Of a straight line: an eighth of the second derivative times the square of its length
    bend = np.sum(lost * ((lost + 1) * STEP / SECOND) ** 2 / 8.0 * 2.0 * rocking**3)
    off = np.abs(angle - (turned[1:] - turned[0])[there])
    assert np.all(off <= 1.1 * bend * STEP / SECOND + 1e-12)
    assert np.allclose(out.accel, 9.0 * out.gyro)
    whole = lost == 0
    assert np.array_equal(out.gyro[whole], rate[there][whole])


def test_a_mean_behind_a_gap_is_that_of_its_own_interval():
    there = np.ones(40, bool)
    there[10:25] = False
    imu, _, rate = means(there, 5.0)
    out = concatenate(list(means_with_lost([imu], STEP, 3 * STEP)))
    assert np.array_equal(out.gyro, rate[there])


@given(st.lists(st.booleans(), min_size=40, max_size=80), st.data())
def test_stamps_that_are_late_lose_nothing(late, data):
    """A late one by more than half an interval was taken for a lost one: 0.15 deg each time."""
    late = np.array(late) & np.append(False, ~np.array(late)[:-1])
    imu, _, rate = means(np.ones(len(late), bool), 5.0)
    times = imu.time_ns + np.where(late, 3 * STEP // 5, 0)
    imu = Imu(times, times, rate, rate)
    edges = data.draw(st.lists(st.integers(0, len(imu)), max_size=4))
    blocks = [b for b in cut(imu, sorted(edges)) if len(b)]
    out = concatenate(list(means_with_lost(blocks, STEP, 3 * STEP)))
    inside = slice(0, len(late) - 1)  # what comes behind the last is not known
    assert np.array_equal(out.gyro[inside], rate[inside])
    assert np.array_equal(out.time_ns, times)


@pytest.mark.parametrize(
    ("hours", "rows"),
    [([0, 1, 2], (0, 3)), ([0, 7, 8, 9], (1, 4)), ([0, 1, 9], (0, 2)), ([], (0, 0)), ([5], (0, 1))],
)
def test_the_longest_part_between_gaps_of_hours(hours, rows):
    part = longest_part(3600 * SECOND * np.array(hours, dtype=np.int64))
    assert (part.start, part.stop) == rows
