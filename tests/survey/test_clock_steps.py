"""Steps of clocks are told from messages that are late, repeated, lost, or delayed."""

import numpy as np
import pytest

from sinstool.survey.clock_steps import recorder_steps, stamp_steps
from tests.helpers.imulogs import T0

SECOND = 10**9
SIZES = [-3600.0, -30.0, -2.0, -0.3, -0.05, 0.05, 0.3, 2.0, 30.0, 3600.0]


def clocks(seed, n=8000, rate=200.0, jitter_s=3e-4):
    """Stamps of even samples, and their times of recording."""
    random = np.random.default_rng(seed)
    time_ns = T0 + np.round(np.arange(n) / rate * 1e9).astype(np.int64)
    late_ns = 500_000 + np.round(random.gamma(2.0, jitter_s, n) * 1e9).astype(np.int64)
    return time_ns, np.maximum.accumulate(time_ns + late_ns)


def found(steps):
    return [(step.row, step.size_ns / SECOND) for step in steps]


@pytest.mark.parametrize("size", [s for s in SIZES if s < 0.0])
@pytest.mark.parametrize("seed", range(6))
def test_a_recorders_clock_that_is_set_back(seed, size):
    _, log_ns = clocks(seed)
    row = 3000 + 511 * seed
    log_ns[row:] += round(size * SECOND)
    ((at, step),) = found(recorder_steps(log_ns))
    assert at == row and step == pytest.approx(size, abs=1e-3)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("rate", [1.0, 10.0, 200.0])
@pytest.mark.parametrize("seed", range(3))
def test_stamps_that_step_by_themselves(seed, rate, size):
    time_ns, log_ns = clocks(seed, 600, rate)
    row = 200 + 51 * seed
    time_ns[row:] += round(size * SECOND)
    ((at, step),) = found(stamp_steps(time_ns, log_ns))
    assert at == row and step == pytest.approx(size, abs=1e-5)


def test_several_steps():
    time_ns, log_ns = clocks(1)
    sizes = ((2000, -2.0), (4000, 0.5), (6000, -0.05))
    for row, size in sizes:
        time_ns[row:] += round(size * SECOND)
    assert found(stamp_steps(time_ns, log_ns)) == list(sizes)
    for row, size in sizes:
        log_ns[row:] += round(size * SECOND)
    assert [step.row for step in recorder_steps(log_ns)] == [2000, 6000]


def test_samples_lost_where_a_clock_is_set_do_not_change_its_step():
    time_ns, log_ns = clocks(2)
    time_ns[4000:] -= 2 * SECOND
    keep = np.delete(np.arange(8000), np.arange(3990, 4020))
    ((at, step),) = found(stamp_steps(time_ns[keep], log_ns[keep]))
    assert (at, step) == (3990, -2.0)


def test_the_side_that_agrees_with_the_times_of_recording_is_right():
    time_ns, log_ns = clocks(3)
    for first, right_before in ((4000, True), (0, False)):
        moved = time_ns.copy()
        moved[first : first + 4000] += 5 * SECOND
        (step,) = stamp_steps(moved, log_ns)
        assert step.row == 4000 and step.from_there == right_before


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("count", [1, 20, 200])
@pytest.mark.parametrize("late_s", [0.05, 0.8, 5.0])
def test_late_messages_are_no_step(seed, late_s, count):
    """Some samples come later in the file than others that were taken after them."""
    time_ns, _ = clocks(seed)
    held = np.arange(1000, 1000 + count)
    last = held[-1] + round(late_s * 200.0)
    order = np.concatenate([np.arange(1000), np.arange(held[-1] + 1, last + 1), held])
    order = np.concatenate([order, np.arange(last + 1, len(time_ns))])
    times = time_ns[order]
    # Recorded in that order, as fast as they come
    log_ns = np.maximum.accumulate(times) + 500_000
    assert not recorder_steps(times) and not recorder_steps(log_ns)
    assert not stamp_steps(times, log_ns)


def test_parts_in_the_wrong_order_and_parts_twice_are_no_steps():
    _, log_ns = clocks(4)
    assert not recorder_steps(np.roll(log_ns, 4000))
    assert not recorder_steps(np.concatenate([log_ns[:5000], log_ns[3000:]]))


@pytest.mark.parametrize("seed", range(6))
def test_delays_are_no_steps(seed):
    random = np.random.default_rng(seed)
    time_ns, log_ns = clocks(seed)
    # a link that delivers late, in batches, and later for good
    slower = log_ns + np.where(np.arange(8000) > 4000, SECOND // 5, 0)
    batches = np.repeat(log_ns[19::20], 20)
    stalls = log_ns.copy()
    for row in random.integers(0, 7000, 10).tolist():
        wait = log_ns[row] + int(random.uniform(0.03, 1.5) * SECOND)
        stalls[row:] = np.maximum(stalls[row:], wait)
    jitter = log_ns + random.integers(0, 50_000_000, 8000)
    for recorded in (slower, batches, stalls, jitter):
        assert not stamp_steps(time_ns, recorded)
        assert not recorder_steps(recorded)
    # what a queue held back is lost, and messages are in time again
    queue = log_ns[3000:] + np.where(np.arange(5000) < 2000, 2 * SECOND, 0)
    keep = np.delete(np.arange(5000), np.arange(2000, 2400))
    assert not stamp_steps(time_ns[3000:][keep], queue[keep])


@pytest.mark.parametrize("delay_ms", [30, 40, 90])
@pytest.mark.parametrize("seed", range(6))
def test_a_delay_that_comes_and_goes_is_no_clock(seed, delay_ms):
    """An autopilot's barometer, of which every fifth sample is kept: a clock set six times."""
    random = np.random.default_rng(seed)
    log_ns = T0 + np.cumsum(random.normal(0.2 * SECOND, 1e-3 * SECOND, 170)).astype(np.int64)
    time_ns = log_ns - random.integers(0, 200_000, len(log_ns))
    waits = (np.arange(len(log_ns)) // random.integers(5, 12)) % 3 == 1
    time_ns[waits] -= delay_ms * SECOND // 1000
    assert not stamp_steps(time_ns, log_ns)
    # But a clock may be set meanwhile
    time_ns[90:] += 2 * SECOND
    assert [step.size_ns for step in stamp_steps(time_ns, log_ns)] == [
        pytest.approx(2 * SECOND, abs=0.1 * SECOND)
    ]


@pytest.mark.parametrize("pace", [0.01, 0.5, 3.0])
def test_times_of_a_log_that_was_written_anew_show_no_steps(pace):
    """Its times of recording are those of its writing, which passed over a gap."""
    time_ns, _ = clocks(6)
    keep = np.delete(np.arange(8000), np.arange(4000, 4400))
    log_ns = T0 + 10**15 + np.round(np.arange(len(keep)) * pace * 5e6).astype(np.int64)
    assert not stamp_steps(time_ns[keep], log_ns)


def test_gaps_of_a_sensor_are_no_steps():
    time_ns, log_ns = clocks(5)
    keep = np.delete(np.arange(8000), np.arange(4000, 4400))
    assert not stamp_steps(time_ns[keep], log_ns[keep])
    # a receiver without fixes for a while
    time_ns, log_ns = clocks(5, 400, 1.0)
    keep = np.delete(np.arange(400), np.arange(200, 230))
    assert not stamp_steps(time_ns[keep], log_ns[keep])
