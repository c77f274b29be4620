from dataclasses import fields, is_dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sinstool.core.errors import DataError
from sinstool.io.readers import open_log
from sinstool.io.readers.streams import ImuUnits
from sinstool.io.readers.topics import choose_imu
from sinstool.survey.imu import survey
from tests.helpers.imulogs import (
    T0,
    G,
    even_times,
    handheld,
    imu_log,
    imu_messages,
    resting,
    write_log,
)
from tests.helpers.quick import mostly_slow

SECOND = 10**9


def look(path, units=None, **options):
    with open_log(path) as log:
        return survey(log, choose_imu(log, None), units or ImuUnits(), **options)


def rest(path, times, **options):
    gyro, accel = resting(len(times))
    return look(imu_log(path, times, gyro, accel, **options))


def plain(value):
    """A survey as something that == compares bit for bit."""
    if is_dataclass(value):
        return {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, np.ndarray):
        return (value.dtype, value.shape, value.tobytes())
    if isinstance(value, (tuple, list)):
        return [plain(v) for v in value]
    return value


def messy(path):
    """Everything at once: late, repeated, missing and broken samples, gaps, and a rest."""
    rng = np.random.default_rng(3)
    gyro, accel, q = handheld(3000, rest_s=4.0, seed=2)
    times = even_times(3000) + rng.integers(-400_000, 400_000, 3000)
    times[1500:] += 3 * SECOND
    times[2000:] += 4797 * SECOND
    order = np.arange(3000)
    order[100:300] = order[100:300].reshape(-1, 4)[:, ::-1].ravel()
    order = np.delete(order, rng.integers(0, 3000, 60))
    gyro[700] = np.nan
    accel[710, 2] = np.inf
    log_ns = times[order] + rng.integers(0, 20_000_000, len(order))
    rows = imu_messages(times[order], gyro[order], accel[order], log_ns, q.as_quat()[order], 0.0)
    rows[1000:1010] = [rows[999]] * 10
    rows[50] = rows[50]._replace(message=b"\x00\x01\x00\x00rest is missing")
    return write_log(path, rows)


@pytest.mark.slow
@pytest.mark.parametrize("increments", [False, True])
def test_blocks_do_not_matter(tmp_path, increments):
    path = messy(tmp_path / "a.mcap")
    whole = look(path, increments=increments, block_rows=10**9)
    assert whole.order.duplicates and whole.order.backward and whole.gap_count >= 2
    assert whole.losses.malformed == 1 and whole.losses.nonfinite == 2
    for rows in (1, 7, 4096):
        assert plain(look(path, increments=increments, block_rows=rows)) == plain(whole)


def test_a_clean_log(tmp_path):
    gyro, accel, _ = handheld(2000, rest_s=3.0)
    log_ns = even_times(2000) + 2_000_000
    path = imu_log(tmp_path / "a.mcap", even_times(2000), gyro, accel, log_ns=log_ns)
    s = look(path)
    assert (s.count, s.first_ns, s.last_ns) == (2000, T0, T0 + 1999 * 5_000_000)
    assert (s.time_source, s.time_note, s.bursty) == ("stamp", "", False)
    assert s.rate_hz == pytest.approx(200.0, rel=1e-12)
    assert s.interval_range_ns == (5_000_000, 5_000_000)
    assert s.max_gap_ns == 15_000_000
    assert (s.gaps, s.gap_count, s.gap_total_s, s.missed, s.held) == ((), 0, 0.0, 0, 0)
    assert s.clock_offset_s == (0.002, 0.002)
    np.testing.assert_array_equal(s.gyro_max, np.abs(gyro).max(axis=0))
    np.testing.assert_array_equal(s.accel_max, np.abs(accel).max(axis=0))
    assert s.specific_force_median == pytest.approx(G, abs=0.01)
    assert s.saturated == () and s.orientation is None
    assert s.lead_in.duration_s == pytest.approx(2.5, abs=0.51)
    assert s.duration_s == pytest.approx(1999 * 0.005)


@pytest.mark.parametrize("rate", [99.50, 285.714, 104.36, 1000 / 7])
def test_rates_that_are_not_round(tmp_path, rate):
    assert rest(tmp_path / "a.mcap", even_times(500, rate)).rate_hz == pytest.approx(rate, rel=1e-6)


@pytest.mark.parametrize("start", [0, 37_250_000_000])
@pytest.mark.parametrize("log_start", [0, T0])
def test_clocks_that_count_from_zero_or_from_boot(tmp_path, start, log_start):
    times = even_times(500, start_ns=start)
    s = rest(tmp_path / "a.mcap", times, log_ns=even_times(500, start_ns=log_start + start))
    assert (s.time_source, s.first_ns, s.count) == ("stamp", start, 500)
    assert s.clock_offset_s == (log_start / SECOND, log_start / SECOND)


def test_stamps_that_are_all_the_same(tmp_path):
    for value in (0, T0):
        s = rest(tmp_path / f"{value}.mcap", np.full(500, value), log_ns=even_times(500))
        assert s.time_source == "log"
        assert s.time_note == f"all header stamps are {value} ns"
        assert (s.count, s.first_ns) == (500, T0)
        assert s.order.duplicates == 0
        assert s.rate_hz == pytest.approx(200.0)


def test_stamps_shared_by_bursts(tmp_path):
    """A driver that stamps whole packets: most samples repeat a stamp."""
    log_ns = even_times(500)
    s = rest(tmp_path / "a.mcap", np.repeat(log_ns[::10], 10), log_ns=log_ns)
    assert s.time_source == "log" and "repeat the stamp" in s.time_note
    assert s.count == 500


@pytest.mark.parametrize("back_s", [3600, 70, 30, 10, 2, 0.5])
def test_a_clock_that_is_set_back(tmp_path, back_s):
    log_ns = even_times(8000)
    times = log_ns.copy()
    times[7000:] -= int(back_s * SECOND)
    times[7000:] += 1_300_000  # it need not fall onto the same instants
    s = rest(tmp_path / "a.mcap", times, log_ns=log_ns)
    assert s.time_source == "log" and "back" in s.time_note
    assert s.count == 8000 and s.order.late == 0 and s.order.duplicates == 0
    np.testing.assert_array_equal((s.first_ns, s.last_ns), log_ns[[0, -1]])


def test_a_clock_that_is_set_forward_is_a_gap(tmp_path):
    times = even_times(2000)
    times[1000:] += 3600 * SECOND
    s = rest(tmp_path / "a.mcap", times, log_ns=even_times(2000))
    assert (s.time_source, s.gap_count) == ("stamp", 1)
    assert s.gaps == ((times[999], 3600.005),)


@pytest.mark.parametrize("late_s", [0.05, 0.8, 3.0, 30.0])
def test_late_messages_are_put_in_their_place(tmp_path, late_s):
    """One message, and a second's worth of them that waited in a buffer."""
    times = even_times(8000)
    late = int(late_s * 200)
    for rows in (np.arange(100, 101), np.arange(100, 300)):
        order = np.concatenate((np.arange(100), np.arange(rows[-1] + 1, rows[-1] + late + 1), rows))
        order = np.concatenate((order, np.arange(rows[-1] + late + 1, 8000)))
        s = rest(tmp_path / "a.mcap", times[order], log_ns=even_times(8000))
        assert s.time_source == "stamp"
        assert (s.count, s.gap_count, s.missed) == (8000, 0, 0)
        assert s.order.backward == 1 and s.order.late == 0
        assert s.order.lateness_ns == (late + len(rows) - 1) * 5_000_000
        assert s.horizon_ns >= s.order.lateness_ns


def test_a_file_out_of_order_with_both_clocks(tmp_path):
    """Parts of a recording joined the wrong way round: stamps and log times agree."""
    times = np.roll(even_times(4000), 2000)
    s = rest(tmp_path / "a.mcap", times)
    assert (s.time_source, s.count, s.gap_count) == ("stamp", 4000, 0)


def test_log_times_in_disorder_do_not_make_stamps_unusable(tmp_path):
    rng = np.random.default_rng(0)
    log_ns = even_times(2000) + rng.integers(0, 50_000_000, 2000)
    times = even_times(2000)
    times[[500, 501]] = times[[501, 500]]
    s = rest(tmp_path / "a.mcap", times, log_ns=log_ns)
    assert (s.time_source, s.count, s.order.backward) == ("stamp", 2000, 1)


def test_gaps_from_20_ms_to_4797_s(tmp_path):
    times = even_times(3000)
    times[1000:] += 15_000_000
    times[2000:] += 4797 * SECOND
    s = rest(tmp_path / "a.mcap", times)
    assert s.gap_count == 2
    assert s.gaps == ((times[999], 0.02), (times[1999], 4797.005))
    assert s.gap_total_s == pytest.approx(4797.025, rel=1e-15)
    assert s.rate_hz == pytest.approx(200.0, rel=1e-12)
    assert s.duration_s == pytest.approx((2999 - 2) * 0.005)


def test_more_gaps_than_are_listed(tmp_path):
    """Of 1500 gaps the thousand longest are listed, and all of them counted."""
    steps = np.full(4500, 5_000_000)
    steps[::3] = 20_000_000 + np.arange(1500) * 100_000
    times = T0 + np.cumsum(steps)
    s = rest(tmp_path / "a.mcap", times)
    # every third interval a gap: bursts, were the limit not given
    stricter = look(tmp_path / "a.mcap", max_gap_s=0.015)
    assert stricter.gap_count == 1499  # the first step lies before the first sample
    assert stricter.gap_total_s == pytest.approx(steps[3::3].sum() / SECOND, rel=1e-12)
    assert len(stricter.gaps) == 1000
    assert min(length for _, length in stricter.gaps) == pytest.approx(0.07)
    assert [t for t, _ in stricter.gaps] == sorted(t for t, _ in stricter.gaps)
    assert s.bursty


def test_the_longest_interval_that_is_no_gap_can_be_configured(tmp_path):
    times = even_times(1000)
    times[500:] += 95_000_000
    path = imu_log(tmp_path / "a.mcap", times, *resting(1000))
    assert look(path).gap_count == 1
    wide = look(path, max_gap_s=0.2)
    assert (wide.gap_count, wide.missed, wide.max_gap_ns) == (0, 1, 200_000_000)
    narrow = look(path, max_gap_s=0.001)
    assert (narrow.gap_count, narrow.missed) == (999, 0)


def test_missed_samples(tmp_path):
    times = np.delete(even_times(1000), [100, 400, 401, 700])
    s = rest(tmp_path / "a.mcap", times)
    assert (s.missed, s.gap_count) == (3, 0)


def test_intervals_over_four_decades(tmp_path):
    """Samples arrive ten at a time, within 5 us, and then 50 ms pass."""
    times = (T0 + np.arange(100)[:, None] * 50_000_000 + np.arange(10) * 5_000).ravel()
    s = rest(tmp_path / "a.mcap", times)
    assert s.bursty and s.gap_count == 0
    assert s.interval_range_ns[1] / s.interval_range_ns[0] > 9e3


def test_sample_and_hold(tmp_path):
    gyro, accel = resting(1000)
    copies = np.repeat(np.arange(560), 2)[:1000]
    s = look(imu_log(tmp_path / "a.mcap", even_times(1000), gyro[copies], accel[copies]))
    assert s.held == 500
    # what is repeated is not saturated
    gyro[:, 0] = np.abs(gyro[:, 0])
    gyro[100, 0] = 1.0
    copies = np.repeat(np.arange(250), 4)
    s = look(imu_log(tmp_path / "a.mcap", even_times(1000), gyro[copies], accel[copies]))
    assert s.held == 750 and s.saturated == ()


def test_what_coarse_axes_repeat_is_not_held(tmp_path):
    """Each repeats its value for most of the time, but not because the others do."""
    random = np.random.default_rng(3)
    gyro = np.round(0.2 * random.standard_normal((2000, 3)) + [0.1, 0.2, 0.3])
    accel = np.round(0.2 * random.standard_normal((2000, 3)) + [0.2, 9.7, 0.0])
    s = look(imu_log(tmp_path / "a.mcap", even_times(2000), 0.01 * gyro, 0.05 * accel))
    assert s.held == 0


def test_zeros_from_the_first_sample_on_are_one_value(tmp_path):
    s = look(imu_log(tmp_path / "a.mcap", even_times(10), [0.0, 0, 0], [0.0, 0, 0]))
    assert s.held == 9  # the first repeats nothing


def test_saturation(tmp_path):
    gyro, accel, _ = handheld(4000)
    limit = 0.6 * np.abs(gyro[:, 1]).max()
    gyro[:, 1] = np.clip(gyro[:, 1], -limit, limit)
    s = look(imu_log(tmp_path / "a.mcap", even_times(4000), gyro, accel))
    assert s.saturated == ("gyro y",)
    accel[1000:1003, 0] = -40.0
    s = look(imu_log(tmp_path / "a.mcap", even_times(4000), gyro, accel))
    assert s.saturated == ("gyro y", "accelerometer x")


@pytest.mark.parametrize("seed", mostly_slow(range(6), 0, 1))
def test_the_end_of_a_range_behind_a_calibration(tmp_path, seed):
    gyro, accel, _ = handheld(4000)
    random = np.random.default_rng(seed)
    limit = 0.6 * np.abs(gyro[:, 1]).max()
    crooked = np.eye(3) + 4e-3 * random.standard_normal((3, 3))
    clipped = np.column_stack([gyro[:, 0], np.clip(gyro[:, 1], -limit, limit), gyro[:, 2]])
    times = even_times(4000)
    s = look(imu_log(tmp_path / "a.mcap", times, clipped @ crooked.T, accel))
    assert s.saturated == ()
    np.testing.assert_allclose(s.gyro_stops[:, 1], 0.98 * limit, rtol=0.02)
    s = look(imu_log(tmp_path / "b.mcap", times, gyro @ crooked.T, accel))
    assert np.isinf(s.gyro_stops).all()
    # A sine turns back slowly, but not as slowly as that
    sine = gyro + np.outer(5.0 * np.sin(random.uniform(0.01, 0.1) * np.arange(4000)), [0, 1, 0])
    assert np.isinf(look(imu_log(tmp_path / "c.mcap", times, sine, accel)).gyro_stops).all()


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_log_that_begins_at_the_end_of_a_range(tmp_path, seed, sign):
    gyro, accel, _ = handheld(4000)
    limit = 0.6 * np.abs(gyro[:, 1]).max()
    crooked = np.eye(3) + 4e-3 * np.random.default_rng(seed).standard_normal((3, 3))
    clipped = np.column_stack([gyro[:, 0], np.clip(gyro[:, 1], -limit, limit), gyro[:, 2]])
    rows = slice(np.flatnonzero(clipped[:, 1] == limit)[0], None)
    turned = sign * clipped[rows] @ crooked.T
    s = look(imu_log(tmp_path / "a.mcap", even_times(4000)[rows], turned, accel[rows]))
    np.testing.assert_allclose(s.gyro_stops[:, 1], 0.98 * limit, rtol=0.02)


@pytest.mark.parametrize("more", [-1.0, 1.0])
def test_saturation_of_integers(tmp_path, more):
    """A range of integers goes a step farther down than up, and most stops may be at either end."""
    gyro, accel, _ = handheld(4000)
    step = np.abs(gyro[:, 1]).max() / 32768.0
    moved = gyro[:, 1] + more * 6000 * step
    gyro[:, 1] = step * np.clip(np.round(moved / step), -16384, 16383)
    assert len(set(np.sign(gyro[np.abs(gyro[:, 1]) > 16382 * step, 1]))) == 2
    s = look(imu_log(tmp_path / "a.mcap", even_times(4000), gyro, accel))
    assert s.saturated == ("gyro y",)


def coarse(values, step=0.001):
    return np.round(values / step) * step


@pytest.mark.parametrize("seed", mostly_slow(range(8), 0, 1))
def test_coarse_steps_are_no_stop(tmp_path, seed):
    """About its largest rate a slow motion stays for many samples, but also a step below it."""
    random = np.random.default_rng(seed)
    n = 12_000
    t = 0.01 * np.arange(n)
    f, phase = random.uniform(0.01, 0.1, (6, 3)), random.uniform(size=(6, 3))
    gyro = 0.1 * np.sin(2 * np.pi * (f * t[:, None, None] + phase)).sum(axis=1)
    gyro = coarse(gyro + 0.0005 * random.standard_normal((n, 3)))
    accel = coarse([0.0, 0.0, 9.81] + 0.02 * random.standard_normal((n, 3)))
    s = look(imu_log(tmp_path / "a.mcap", even_times(n), gyro, accel))
    assert s.saturated == ()


@pytest.mark.parametrize("seed", range(4))
def test_counts_of_a_laser_gyro_at_rest_are_no_stop(tmp_path, seed):
    random, n = np.random.default_rng(seed), 6000
    count = np.pi / 648000.0
    sway = np.sin(0.01 * np.arange(n)[:, None] + random.uniform(0.0, 6.0, 3))
    rate = 40.0 * count * (1.0 + sway) + 1e-5 * random.standard_normal((n, 3))
    # Differences of an angle in rad, which rounds them
    gyro = 100.0 * np.diff(count * np.floor(np.cumsum(0.01 * rate / count, axis=0)), axis=0)
    accel = [0.0, 0.0, 9.81] + 0.02 * random.standard_normal((n - 1, 3))
    s = look(imu_log(tmp_path / "a.mcap", even_times(n - 1), gyro, accel))
    assert s.saturated == ()


def test_a_stop_that_lasts(tmp_path):
    """A wheel turns a little faster than its gyro's range for most of the log, at either sign."""
    random = np.random.default_rng(5)
    n = 8000
    rate = 8.5 * np.clip((np.arange(n) - 1000) / 2000, 0.0, 1.0)
    gyro = 0.002 * random.standard_normal((n, 3))
    gyro[:, 1] -= rate + 0.3 * np.sin(0.003 * np.arange(n))
    accel = [0.0, 0.0, 9.81] + 0.02 * random.standard_normal((n, 3))
    stopped = coarse(np.clip(gyro, -7.85, 7.85), 2e-4)
    s = look(imu_log(tmp_path / "a.mcap", even_times(n), stopped, accel))
    assert s.saturated == ("gyro y",)
    assert look(imu_log(tmp_path / "b.mcap", even_times(n), gyro, accel)).saturated == ()
    # A turntable at one rate, of a gyro whose steps are larger than its noise, is at no stop.
    table = coarse(gyro * [1.0, 0.0, 1.0] + np.outer(rate, [0.0, 1.0, 0.0]), 0.01)
    assert look(imu_log(tmp_path / "c.mcap", even_times(n), table, accel)).saturated == ()


IDENTITY = (0.0, 0.0, 0.0, 1.0)


def oriented(path, q_xyzw, covariance=0.0):
    gyro, accel, _ = handheld(600)
    return look(imu_log(path, even_times(600), gyro, accel, q_xyzw=q_xyzw, covariance=covariance))


def test_placeholders_are_no_orientation(tmp_path):
    for k, q in enumerate((IDENTITY, (1.0, 0.0, 0.0, 0.0))):  # also in the wrong order
        s = oriented(tmp_path / f"{k}.mcap", q)
        assert s.orientation is None and s.orientation_constant
    s = oriented(tmp_path / "no.mcap", IDENTITY, -1.0)
    assert s.orientation is None and not s.orientation_constant
    s = oriented(tmp_path / "zero.mcap", (0.0, 0.0, 0.0, 0.0))
    assert s.orientation is None and not s.orientation_constant


def test_a_constant_orientation_that_says_something(tmp_path):
    q = Rotation.from_euler("ZYX", [50, 10, -5], degrees=True).as_quat()
    s = oriented(tmp_path / "a.mcap", q)
    assert s.orientation is not None and s.orientation_constant


def test_the_first_valid_orientation(tmp_path):
    q = Rotation.random(600, rng=np.random.default_rng(0)).as_quat()
    q[:20] = 0.0  # before the filter had settled
    q[30::2] *= -1.0  # signs flip
    s = oriented(tmp_path / "a.mcap", q)
    assert s.orientation_ns == even_times(600)[20] and not s.orientation_constant
    path = tmp_path / "a.mcap"
    assert plain(look(path, block_rows=1)) == plain(look(path, block_rows=600))


def test_increments_are_judged_as_rates(tmp_path):
    gyro, accel, _ = handheld(2000, rest_s=3.0)
    path = imu_log(tmp_path / "a.mcap", even_times(2000), gyro * 0.005, accel * 0.005)
    s = look(path, increments=True)
    assert s.specific_force_median == pytest.approx(G, abs=0.01)
    np.testing.assert_allclose(s.gyro_max, np.abs(gyro).max(axis=0), rtol=1e-12)
    assert s.lead_in is not None


def span(start, end):
    return lambda first: (
        None if start is None else first + int(start * SECOND),
        None if end is None else first + int(end * SECOND),
    )


@pytest.mark.parametrize("zero_stamps", [False, True])
def test_a_span_is_of_the_clock_in_use(tmp_path, zero_stamps):
    times = even_times(2000)
    stamps = np.zeros(2000, int) if zero_stamps else times
    path = imu_log(tmp_path / "a.mcap", stamps, *resting(2000), log_ns=times)
    s = look(path, span=span(2.0, 6.0))
    assert s.time_source == ("log" if zero_stamps else "stamp")
    assert (s.first_ns, s.last_ns, s.count) == (T0 + 2 * SECOND, T0 + 6 * SECOND, 801)
    assert look(path, span=span(None, 6.0)).count == 1201
    assert look(path, span=span(9.0, None)).count == 200
    with pytest.raises(DataError, match=r"between --start and --end: its samples span 9\.995 s"):
        look(path, span=span(20.0, None))


def test_a_span_leaves_out_a_clock_that_is_set_later(tmp_path):
    log_ns = even_times(2000)
    times = log_ns.copy()
    times[1000:] -= 3600 * SECOND
    path = imu_log(tmp_path / "a.mcap", times, *resting(2000), log_ns=log_ns)
    s = look(path, span=span(0.0, 4.0))
    assert (s.time_source, s.count) == ("stamp", 801)


def test_nothing_usable_is_refused_with_the_reason(tmp_path):
    gyro, accel = resting(10)
    what = r"no usable Imu message \(10 hold NaN, infinity or more than 1e\+09\)"
    with pytest.raises(DataError, match=what):
        look(imu_log(tmp_path / "a.mcap", even_times(10), gyro * np.nan, accel))
    rows = [m._replace(message=b"\x00\x01\x00\x00") for m in imu_messages(even_times(3), 0, 0)]
    with pytest.raises(DataError, match=r"no usable Imu message \(.+\)"):
        look(write_log(tmp_path / "b.mcap", rows))
    empty = write_log(tmp_path / "c.mcap", [], channels=[("/imu", "sensor_msgs/msg/Imu")])
    with pytest.raises(DataError, match=r"topic /imu has no usable Imu message$"):
        look(empty)


def test_one_sample(tmp_path):
    s = rest(tmp_path / "a.mcap", even_times(1))
    assert (s.count, s.rate_hz, s.gap_count, s.lead_in, s.time_source) == (1, 0.0, 0, None, "stamp")
