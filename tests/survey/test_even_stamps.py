"""Times of samples that a sensor takes evenly, from stamps of their receipt."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.core.streams import Imu, concatenate
from sinstool.io.readers import open_log
from sinstool.survey.even_stamps import even_stamps
from sinstool.survey.source import imu_blocks, part_of, prepare, rate_blocks
from tests.helpers.imulogs import imu_messages, write_log
from tests.helpers.quick import mostly_slow
from tests.helpers.unseen_drives import GRADES, drive, record, without_samples, write
from tests.helpers.unseen_errors import received

MS = 1_000_000
INTERVAL = 5 * MS
T0 = 1_700_000_000 * 10**9


def samples(stamp_ns, time_ns, size=1.0):
    """Rates that turn at half a hertz, as they were at `time_ns`, stamped otherwise."""
    seconds = (time_ns - T0) * 1e-9
    gyro = size * np.stack([np.sin(np.pi * seconds + phase) for phase in (0.0, 1.0, 2.0)], axis=1)
    gyro += 1e-3 * np.random.default_rng(1).standard_normal(gyro.shape)
    return Imu(stamp_ns, stamp_ns, gyro, np.tile([0.0, 0.0, 9.81], (len(stamp_ns), 1)), None)


def even_times(n=20_000):
    return T0 + INTERVAL * np.arange(n, dtype=np.int64)


def late_by(random, n, scale):
    return (scale * random.exponential(size=n)).astype(np.int64)


def received_at(time_ns, late_ns):
    """In order, and no two at once."""
    stamps = np.maximum.accumulate(time_ns + late_ns)
    return stamps + np.arange(len(stamps))


@given(st.integers(0, 10_000), st.floats(1.0, 12.0))
@example(279, 12.0)
@example(2048, 12.0)
@example(1032, 12.0)
@example(0, 2.3125)
@settings(max_examples=20, deadline=None)
def test_stamps_of_receipt_give_even_times(seed, scale_ms):
    """Late by exponential times, even by more than an interval: their median remains."""
    random, time_ns = np.random.default_rng(seed), even_times()
    imu = samples(received_at(time_ns, late_by(random, len(time_ns), scale_ms * MS)), time_ns)
    even = even_stamps([imu], False)
    assert even is not None and not even.gaps
    (out,) = even.applied([imu])
    assert even.usual_ns == pytest.approx(INTERVAL, rel=1e-5 * (3.0 + scale_ms))
    assert np.std(out.time_ns - time_ns) < 0.15 * scale_ms * MS
    np.testing.assert_allclose(np.diff(out.time_ns), INTERVAL, rtol=2e-3 * scale_ms)


@pytest.mark.parametrize("batch", range(2, 13))
@pytest.mark.parametrize("lost", [0.0, 0.003])
def test_samples_that_come_in_batches_are_even(batch, lost):
    """A bus hands over several at once: only the last of a batch is stamped in time.

    Nothing is missing but what was lost. Its time was spread over the samples beside it before.
    """
    random, time_ns = np.random.default_rng(batch), even_times()
    kept = random.uniform(size=len(time_ns)) >= lost
    number = np.arange(len(time_ns)) // batch
    last = np.minimum((number + 1) * batch, len(time_ns)) - 1
    arrival = time_ns[last] + late_by(random, len(time_ns), MS)[number]
    stamps = (arrival + MS // 10 * (np.arange(len(time_ns)) - last))[kept]
    imu = samples(stamps, time_ns[kept])
    even = even_stamps([imu], False)
    assert even is not None
    missing = np.sum(~kept)
    assert sum(seconds for _, seconds in even.gaps) <= 2.1 * missing * INTERVAL * 1e-9
    assert even.usual_ns == pytest.approx(INTERVAL, rel=5e-3 if lost else 1e-4)
    (out,) = even.applied([imu])
    # A batch waits as a whole: on average for half of it
    assert np.std(out.time_ns - time_ns[kept]) < (0.3 if lost else 0.16) * INTERVAL


@pytest.mark.parametrize("lost", [0.001, 0.003, 0.006])
@pytest.mark.parametrize("seed", range(3))
def test_single_samples_that_are_lost_leave_the_others_at_their_times(lost, seed):
    """With delays shorter than an interval; times were off by most of an interval before."""
    random, time_ns = np.random.default_rng(seed), even_times()
    kept = random.uniform(size=len(time_ns)) >= lost
    stamps = received_at(time_ns, late_by(random, len(time_ns), 0.1 * INTERVAL))[kept]
    even = even_stamps([samples(stamps, time_ns[kept])], False)
    assert even is not None
    (out,) = even.applied([samples(stamps, time_ns[kept])])
    assert np.std(out.time_ns - time_ns[kept]) < 0.1 * INTERVAL
    lacking = np.count_nonzero(np.diff(time_ns[kept]) > INTERVAL)
    assert len(even.gaps) == pytest.approx(lacking, rel=0.02)


def test_samples_that_were_taken_at_their_stamps_keep_them():
    """A computer that asks at uneven times: the rates follow the stamps."""
    random, time_ns = np.random.default_rng(2), even_times()
    stamps = received_at(time_ns, late_by(random, len(time_ns), 2 * MS))
    assert even_stamps([samples(stamps, stamps)], False) is None
    assert even_stamps([samples(stamps, stamps)], False, surely=True) is not None
    assert even_stamps([samples(stamps, time_ns)], False) is not None


def test_increments_over_uneven_intervals_keep_their_stamps():
    """They are as long as the intervals are, or all alike where the sensor is even."""
    random, time_ns = np.random.default_rng(3), even_times()
    stamps = received_at(time_ns, late_by(random, len(time_ns), 2 * MS))
    rates = samples(stamps, stamps)
    for at, expected in ((stamps, None), (time_ns, INTERVAL)):
        step = np.diff(at, prepend=at[0] - INTERVAL)[:, None] * 1e-9
        imu = Imu(stamps, stamps, rates.gyro * step, rates.accel * step, None)
        even = even_stamps([imu], True)
        if expected is None:
            assert even is None
        else:
            assert even is not None and even.usual_ns == pytest.approx(expected, rel=1e-5)


def shaken(time_ns, stamp_ns, seed):
    """Rates that vibration hides, so that they do not show which times are theirs."""
    gyro = np.random.default_rng(seed).standard_normal((len(time_ns), 3))
    return Imu(stamp_ns, stamp_ns, gyro, np.tile([0.0, 0.0, 9.81], (len(time_ns), 1)), None)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("jitter", [0.0, 0.02])
@pytest.mark.parametrize("lost", [0.3, 0.5, 0.6, 0.7])
def test_samples_of_which_most_are_lost_keep_their_stamps(lost, jitter, seed):
    """Their usual interval, of two or three samples, was taken for that of the sensor."""
    random, time_ns = np.random.default_rng(seed), even_times()
    kept = time_ns[random.uniform(size=len(time_ns)) >= lost]
    stamps = kept + np.rint(jitter * INTERVAL * random.uniform(-1, 1, len(kept))).astype(int)
    assert even_stamps([shaken(stamps, stamps, seed)], False) is None


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("lost", [(2, 2, 2, 3, 2, 2, 2, 28), (2, 2, 3, 2, 2, 25), (3, 3, 3, 21)])
def test_samples_lost_in_a_rhythm_leave_the_others_at_their_stamps(lost, seed):
    """A phone that pairs two sensors loses every second sample while their clocks pass.

    Even times would move the others by more than an interval.
    """
    missing = np.cumsum(np.tile(lost, 120))
    number = np.setdiff1d(np.arange(missing[-1]), missing)
    jitter = np.random.default_rng(seed).normal(scale=0.02 * MS, size=len(number))
    stamps = T0 + 4 * INTERVAL * number + jitter.astype(np.int64)
    assert even_stamps([shaken(stamps, stamps, seed)], False) is None


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("period_ms", [10.0, 11.3, 13.7])
def test_samples_that_a_bus_collects_at_its_ticks_are_even(period_ms, seed):
    """Their intervals are one tick or two, but no sample is missing."""
    time_ns = T0 + (period_ms * MS * np.arange(6000)).astype(np.int64)
    tick = 8 * MS
    jitter = np.random.default_rng(seed).integers(0, MS // 20, len(time_ns))
    stamps = T0 + tick * (1 + (time_ns - T0) // tick) + jitter
    even = even_stamps([shaken(time_ns, stamps, seed)], False)
    assert even is not None and not even.gaps
    assert even.usual_ns == pytest.approx(period_ms * MS, rel=1e-4)


def test_a_clock_that_is_not_steady_keeps_its_stamps():
    """Intervals that vary independently add up."""
    random = np.random.default_rng(4)
    step = random.uniform(0.5 * INTERVAL, 1.5 * INTERVAL, 20_000).astype(np.int64)
    stamps = T0 + np.cumsum(step)
    assert even_stamps([samples(stamps, even_times(), 0.0)], False) is None


def test_a_stall_is_no_gap_and_missing_samples_are():
    """What waited comes at once after a stall; after a gap all samples are as late as before."""
    random, time_ns = np.random.default_rng(5), even_times()
    late = late_by(random, len(time_ns), 2 * MS)
    stall = slice(8_000, 8_060)
    late[stall] = (time_ns[8_060] - time_ns[stall]).astype(np.int64)
    there = np.ones(len(time_ns), bool)
    there[12_000:12_200] = False
    imu = samples(received_at(time_ns, late)[there], time_ns[there])
    even = even_stamps([imu], False)
    assert even is not None
    (gap,) = even.gaps
    assert gap[0] == pytest.approx(int(time_ns[11_999]), abs=3 * MS)
    assert gap[1] == pytest.approx(1.005, abs=0.002)
    (out,) = even.applied([imu])
    assert np.abs(out.time_ns - time_ns[there] - 1.4 * MS).max() < 1.5 * MS


@pytest.mark.parametrize("seed", [9, 10, 12])
def test_stretches_between_gaps_may_be_of_any_length(seed):
    """That lines differ in their number of samples was taken for a clock that is not steady.

    What changes across a gap was taken for rates that belong to their stamps.
    """
    random, time_ns = np.random.default_rng(seed), even_times()
    there = np.ones(len(time_ns), bool)
    for begin in range(250, 20_000, 1_040):  # stretches of 250 and of 590
        there[begin : begin + 100] = there[begin + 690 : begin + 790] = False
    stamps = received_at(time_ns, late_by(random, len(time_ns), 3 * MS))[there]
    even = even_stamps([samples(stamps, time_ns[there])], False)
    assert even is not None
    assert sum(seconds for _, seconds in even.gaps) == pytest.approx(38 * 0.505, rel=0.02)


@pytest.mark.parametrize("seed", range(4))
def test_even_times_increase_where_few_samples_lie_between_losses(seed):
    """Lines through some samples of a burst began before the end of those before."""
    random, time_ns = np.random.default_rng(seed), even_times()
    stamps = time_ns + INTERVAL * (5 - np.arange(len(time_ns)) % 6)
    there = random.random(len(time_ns)) > 0.08
    for begin in np.cumsum(random.integers(650, 2_000, 9)):
        there[begin : begin + 500] = False
    stamps = received_at(stamps[there], np.zeros(there.sum(), np.int64))
    even = even_stamps([samples(stamps, time_ns[there])], False, surely=True)
    assert even is not None and len(even.gaps) >= 9
    assert min(seconds for _, seconds in even.gaps) * 1e9 > even.usual_ns
    (out,) = even.applied([samples(stamps, time_ns[there])])
    assert np.diff(out.time_ns).min() > 0


@given(st.lists(st.integers(1, 19_999), max_size=6), st.integers(0, 40))
@settings(max_examples=20, deadline=None)
def test_times_do_not_depend_on_blocks(cuts, line):
    """Nor on how many lines were left out before."""
    random, time_ns = np.random.default_rng(6), even_times()
    imu = samples(received_at(time_ns, late_by(random, len(time_ns), 4 * MS)), time_ns)
    even = even_stamps([imu], False)
    assert even is not None
    (whole,) = even.applied([imu])
    edges = [0, *sorted(set(cuts)), len(imu)]
    parts = [imu.rows(slice(a, b)) for a, b in pairwise(edges)]
    again = concatenate(list(even.applied(parts)))
    np.testing.assert_array_equal(again.time_ns, whole.time_ns)
    begin = int(np.searchsorted(imu.time_ns, even.stamp_ns[line]))
    (late,) = even.applied([imu.rows(slice(begin, None))])
    np.testing.assert_array_equal(late.time_ns, whole.time_ns[begin:])
    sought = int(whole.time_ns[begin]) + random.integers(-INTERVAL, INTERVAL)
    expected = whole.time_ns[np.searchsorted(whole.time_ns, sought)]
    assert even.sample_from(sought) == expected
    assert even.sample_from(int(whole.time_ns[-1]) + 1) == whole.time_ns[-1] == even.last_ns


@pytest.fixture(scope="module")
def jittering(tmp_path_factory):
    """A drive with stamps of receipt that vary by most of an interval, and a gap."""
    data = record(drive(3, 200.0, 30.0), GRADES["industrial"], 3)
    log = tmp_path_factory.mktemp("jitter") / "drive.mcap"
    return write(log, received(without_samples(data, 100.0, 3.0), 3, 4e-3))


def test_a_log_with_stamps_of_receipt(jittering):
    """Its only gap is the one where samples are missing; any part has the same times."""
    config = ProcessConfig()
    with open_log(jittering) as opened:
        source = prepare(opened, config)
        found = source.survey
        assert found.even is not None and found.interval_ns == pytest.approx(5e6, rel=1e-4)
        assert {finding.kind for finding in source.findings} >= {"uneven-stamps", "gaps"}
        (gap,) = found.gaps
        assert gap[1] == pytest.approx(3.005, abs=0.002)
        whole = concatenate(list(imu_blocks(source, found.first_ns)))
        assert len(whole) == found.count
        assert whole.time_ns[0] == found.even.time_ns[0]
        assert whole.time_ns[-1] == found.even.last_ns
        middle = int(whole.time_ns[15_000]) + 1
        part = part_of(source, config, middle, found.last_ns)
        some = concatenate(list(imu_blocks(part, part.survey.first_ns)))
        np.testing.assert_array_equal(some.time_ns, whole.time_ns[15_001:])
        later = concatenate(list(imu_blocks(source, middle)))
        np.testing.assert_array_equal(later.time_ns, whole.time_ns[15_001:])
        np.testing.assert_array_equal(later.gyro, whole.gyro[15_001:])


@pytest.mark.parametrize(
    ("jitter", "hertz", "even"),
    [(0.02, 6.0, False), (0.1, 6.0, True), (0.1, 0.5, False), (0.3, 0.5, True)],
)
def test_stamps_that_vary_by_little_are_kept_unless_it_turns_more_than_noise(
    tmp_path, jitter, hertz, even
):
    """Over such intervals a sensor that cones at 6 Hz would turn by wrong angles."""
    times = even_times(6000)
    spread = jitter * INTERVAL * np.random.default_rng(2).uniform(-1.0, 1.0, len(times))
    stamps = times + spread.astype(np.int64)
    noise = samples(times, times, 0.0).gyro
    for taken, found in ((times, even), (stamps, False)):
        phase = 2.0 * np.pi * hertz * (taken - T0) * 1e-9
        gyro = noise + 0.3 * np.stack([np.cos(phase), np.sin(phase), 0.0 * phase], axis=1)
        accel = np.tile([0.0, 0.0, 9.81], (len(taken), 1))
        log = write_log(tmp_path / "log.mcap", imu_messages(stamps, gyro, accel))
        with open_log(log) as opened:
            assert (prepare(opened, ProcessConfig()).survey.even is not None) == found


def test_a_long_gap_makes_no_stamps_uneven(tmp_path):
    """The mean interval is twice the usual one then, as with samples in batches."""
    times = even_times(2000)
    times[1000:] += 3600 * 10**9
    imu = samples(times, times, 0.03)
    log = write_log(tmp_path / "a.mcap", imu_messages(times, imu.gyro, imu.accel))
    with open_log(log) as opened:
        source = prepare(opened, ProcessConfig())
    assert source.survey.even is None
    assert "uneven-stamps" not in {finding.kind for finding in source.findings}


@pytest.mark.parametrize(("option", "gaps"), [("kept", True), ("auto", False), ("even", False)])
def test_the_option_about_stamps(jittering, option, gaps):
    with open_log(jittering) as opened:
        source = prepare(opened, ProcessConfig(input={"imu_stamps": option}))
    assert (source.survey.gap_count > 100) is gaps


@pytest.mark.parametrize("batch", mostly_slow([5, 9, 10, 12, 16, 20, 32, 50], 5, 16))
@pytest.mark.parametrize("seed", [1, 2])
def test_a_log_with_samples_in_batches(tmp_path, batch, seed):
    """Nine of ten intervals tell nothing, so no spread between tenths of them does."""
    data = record(drive(seed, 100.0, 30.0), GRADES["industrial"], seed)
    row = np.arange(len(data.seconds))
    last = np.minimum((row // batch + 1) * batch, len(row)) - 1
    late = np.random.default_rng(seed).exponential(1e-3, len(row))[last]
    data = replace(data, seconds=data.seconds[last] + late + 1e-4 * (row - last))
    with open_log(write(tmp_path / "log.mcap", data)) as log:
        source = prepare(log, ProcessConfig())
    assert source.survey.even is not None and not source.survey.gaps
    assert source.survey.interval_ns == pytest.approx(5e6, rel=1e-3)
    assert {finding.kind for finding in source.findings} & {"bursts", "uneven-stamps"} == {
        "uneven-stamps"
    }


@pytest.mark.parametrize("seed", [1, 2])
def test_means_over_uneven_intervals_are_left_as_they_are(tmp_path, seed):
    """Each long interval was taken for a lost sample: a heading was 3 sigmas off."""
    data = record(drive(seed, 60.0, 20.0), GRADES["industrial"], seed)
    ticks = np.cumsum(np.random.default_rng(seed).choice([1, 2, 4], 6_000, p=[0.3, 0.6, 0.1]))
    ticks = ticks[ticks < len(data.seconds)]
    steps = np.diff(ticks, prepend=-1)[:, None]
    gyro, accel = (
        np.diff(np.cumsum(values, axis=0)[ticks], axis=0, prepend=0.0) / steps
        for values in (data.gyro, data.accel)
    )
    data = replace(data, seconds=data.seconds[ticks], gyro=gyro, accel=accel)
    config = ProcessConfig(input={"gyro_kind": "mean-rate"})
    with open_log(write(tmp_path / "log.mcap", data)) as log:
        source = prepare(log, config)
        first = source.survey.first_ns
        measured, used = (
            concatenate(list(blocks))
            for blocks in (imu_blocks(source, first), rate_blocks(source, config, first))
        )
    assert source.survey.even is None
    np.testing.assert_array_equal(used.gyro, measured.gyro)


@pytest.mark.parametrize("options", [{}, {"imu_rate": 200.0}])
def test_stamps_of_receipt_show_no_gaps(tmp_path, options):
    """With --imu-rate a driver that hung for 40 ms was a gap: 5.6 deg off at 0.5."""
    count, random = 4000, np.random.default_rng(2)
    times = even_times(count)
    stamps = times + late_by(random, count, 1.0 * MS)
    for begin in range(500, count, 500):
        stamps[begin : begin + 9] = np.maximum(stamps[begin : begin + 9], times[begin] + 40 * MS)
    stamps = np.maximum.accumulate(stamps) + np.arange(count)
    imu = samples(stamps, times, 0.03)
    log = write_log(tmp_path / "a.mcap", imu_messages(stamps, imu.gyro, imu.accel))
    with open_log(log) as opened:
        survey = prepare(opened, build(ProcessConfig, {"input": options})).survey
    assert (survey.count, survey.gap_count, survey.missed) == (count, 0, 0)


@pytest.mark.parametrize("options", [{}, {"imu_rate": 200.0}])
def test_samples_that_arrive_together_are_all_kept(tmp_path, options):
    """Each has the time of the last of them, which is no reason to take them for one sample."""
    count, random = 4000, np.random.default_rng(2)
    times = even_times(count)
    stamps = np.maximum.accumulate(times + late_by(random, count, 2.0 * MS))
    assert np.count_nonzero(np.diff(stamps) == 0) > 0.02 * count
    imu = samples(stamps, times, 0.03)
    log = write_log(tmp_path / "a.mcap", imu_messages(stamps, imu.gyro, imu.accel))
    config = build(ProcessConfig, {"input": options})
    with open_log(log) as opened:
        source = prepare(opened, config)
        assert (source.survey.count, source.survey.order.duplicates) == (count, 0)
        assert source.survey.gap_count == 0 and source.survey.even is not None
        got = concatenate(list(imu_blocks(source, source.survey.first_ns)))
        # and a part of them, from wherever it begins, has the same times
        for first_ns in got.time_ns[500:3000:167].tolist():
            part = part_of(source, config, first_ns, source.survey.last_ns)
            again = concatenate(list(imu_blocks(part, part.survey.first_ns)))
            np.testing.assert_array_equal(again.time_ns, got.time_ns[got.time_ns >= first_ns])
            np.testing.assert_array_equal(again.gyro, got.gyro[got.time_ns >= first_ns])
        kinds = {f.kind for f in source.findings}
    assert not kinds & {"duplicate-stamps", "gaps"}
    assert len(got) == count
    np.testing.assert_array_equal(got.gyro, imu.gyro * [1.0, -1.0, -1.0])
    assert np.std(got.time_ns - times) < 0.3 * MS


def test_two_samples_a_stamp_in_step_with_the_recorder_are_both_kept(tmp_path):
    """As of a clock that counts hundredths of a second."""
    times = even_times(4000)
    imu = samples(times // (2 * INTERVAL) * (2 * INTERVAL), times, 0.03)
    log = write_log(tmp_path / "a.mcap", imu_messages(imu.time_ns, imu.gyro, imu.accel))
    with open_log(log) as opened:
        survey = prepare(opened, ProcessConfig()).survey
    assert (survey.count, survey.order.duplicates) == (4000, 0)
    assert survey.interval_ns == pytest.approx(INTERVAL, rel=1e-3)


@pytest.mark.parametrize("lost", [0.0, 0.6])
def test_samples_that_repeat_a_stamp_of_an_even_clock_are_left_out(tmp_path, lost):
    """Also with a rate: the stamps themselves show it, or a part of it."""
    random = np.random.default_rng(4)
    there = np.flatnonzero(random.random(6000) >= lost)
    rows = np.sort(np.r_[there, random.choice(there, 60)])
    stamps = even_times(6000)[rows]
    imu = samples(stamps, stamps, 0.03)
    gyro = imu.gyro + 1e-3 * random.standard_normal(imu.gyro.shape)
    log = write_log(tmp_path / "a.mcap", imu_messages(stamps, gyro, imu.accel))
    config = build(ProcessConfig, {"input": {"imu_rate": 200.0}})
    with open_log(log) as opened:
        survey = prepare(opened, config).survey
    assert (survey.count, survey.order.duplicates) == (len(there), 60)


@pytest.mark.parametrize("count", [100, 4000])
def test_coarse_stamps_with_a_rate_leave_all_samples(tmp_path, count):
    """One of ten stamps is that of the sample before, of a log too short for even times, too."""
    times = even_times(count)
    stamps = np.where(np.arange(count) % 10 == 1, times - INTERVAL, times)
    imu = samples(stamps, times, 0.03)
    log = write_log(tmp_path / "a.mcap", imu_messages(stamps, imu.gyro, imu.accel))
    config = build(ProcessConfig, {"input": {"imu_rate": 200.0}})
    with open_log(log) as opened:
        survey = prepare(opened, config).survey
    assert (survey.count, survey.order.duplicates) == (count, 0)
