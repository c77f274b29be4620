"""What the page of a log is drawn from: intervals, steps back, rates of topics."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sinstool.config import InputOptions, ProcessConfig
from sinstool.core.streams import Imu
from sinstool.pipelines.info.collect import (
    BINS,
    FIRST_BIN_NS,
    INCREMENTS,
    MESSAGES,
    Sampling,
    Traffic,
    Values,
)
from sinstool.pipelines.info.run import Shown, inspect
from sinstool.report.figures.inspection import figures
from tests.helpers.imulogs import even_times, imu_log, resting

START = 1_700_000_000_000_000_000


def sampled(steps_ms, blocks=1, delay_ms=0.0):
    """A sampling that saw stamps with these steps, in so many blocks."""
    steps = np.round(np.asarray(steps_ms) * 1e6).astype(np.int64)
    times = START + np.concatenate([[0], np.cumsum(steps)])
    n = len(times)
    log_times = times + np.round(delay_ms * 1e6 * np.ones(n)).astype(np.int64)
    imu = Imu(times, log_times, np.zeros((n, 3)), np.zeros((n, 3)))
    made = Sampling("/imu", Values("flu"))
    parts = [imu.rows(slice(a[0], a[-1] + 1)) for a in np.array_split(np.arange(n), blocks)]
    assert sum(len(block) for block in made.watch(iter(parts))) == n
    return made


@given(st.lists(st.floats(0.5, 50.0), min_size=5, max_size=60), st.integers(1, 5))
@settings(deadline=None)
def test_intervals_do_not_depend_on_blocks(steps, blocks):
    whole, cut = sampled(steps), sampled(steps, blocks)
    for a, b in zip(whole.curves(START), cut.curves(START), strict=True):
        np.testing.assert_array_equal(a, b)
    shown = whole.curves(START)[1][:, 0]
    np.testing.assert_allclose(shown[np.isfinite(shown)], np.round(np.array(steps), 6), atol=2e-6)


def test_steps_back_are_kept_and_no_interval_is_negative():
    made = sampled([10, 10, -25, 10, 10, 40], blocks=3, delay_ms=3.0)
    assert made.back == [(START + 20_000_000, 25.0)]
    shown = made.curves(START)[1][:, 0]
    assert np.nanmin(shown) == 10.0 and np.nanmax(shown) == 40.0
    assert made.least_delay_ns == 3_000_000


@pytest.mark.parametrize("interval_ms", [0.5, 1.0, 2.5, 10.0, 40.0])
def test_bars_of_even_intervals_are_about_them(interval_ms):
    """Edges to half of the bins in which intervals are counted, which are 0.1 % wide."""
    middles, counts, outside = sampled([interval_ms] * 2000 + [3.0 * interval_ms]).shares()
    assert middles.mean() == pytest.approx(interval_ms, rel=5.2e-4)
    assert np.ptp(middles) == pytest.approx(0.04 * interval_ms, rel=0.03)
    assert counts.sum() == counts.max() == 2000 and outside == 1
    assert middles[np.argmax(counts)] == pytest.approx(interval_ms, rel=2e-3)


def test_bars_of_uneven_intervals_are_their_histogram():
    steps = np.round(np.random.default_rng(3).normal(10.0, 0.5, 4000), 6)
    middles, counts, outside = sampled(steps).shares()
    width = middles[1] - middles[0]
    edges = np.append(middles - 0.5 * width, middles[-1] + 0.5 * width)
    expected, _ = np.histogram(steps, edges)
    # within what the fine bins, of a hundredth of a ms, hold at each edge
    assert np.abs(np.cumsum(counts) - np.cumsum(expected)).max() < 40
    assert counts.sum() + outside == 4000
    assert edges[0] < np.quantile(steps, 0.001) and edges[-1] > np.quantile(steps, 0.999)


def measured(steps_ms, blocks=1, increments=False):
    """Values that were 0.1, 0.2, 0.3 rad/s and 1, 2, -9.8 m/s² on the vehicle's axes."""
    times = START + np.round(np.concatenate([[0], np.cumsum(steps_ms)]) * 1e6).astype(np.int64)
    n = len(times)
    imu = Imu(times, times, np.tile([0.1, 0.2, 0.3], (n, 1)), np.tile([1.0, 2.0, -9.8], (n, 1)))
    made = Values("flu", increments)
    parts = [imu.rows(slice(a[0], a[-1] + 1)) for a in np.array_split(np.arange(n), blocks)]
    assert sum(len(block) for block in made.watch(iter(parts))) == n
    return made.curves(START)


def test_values_are_in_the_log_s_own_axes():
    seconds, values = measured([10] * 4)
    np.testing.assert_allclose(seconds, 0.01 * np.arange(5))
    # given in FRD, shown in FLU: y and z turn about
    np.testing.assert_allclose(values[0, :3], np.degrees([0.1, -0.2, -0.3]))
    np.testing.assert_allclose(values[0, 3:6], [1.0, -2.0, 9.8])
    np.testing.assert_allclose(values[0, 6], np.sqrt(1.0 + 4.0 + 9.8**2))


@pytest.mark.parametrize("blocks", [1, 2, 4])
def test_increments_after_a_gap_are_left_out(blocks):
    steps = np.array([10.0, 10.0, 20.0, 10.0, 10.0, 500.0, 10.0, 10.0, 31.0, 10.0])
    _, values = measured(steps, blocks)
    assert np.isfinite(values).all(axis=1).sum() == 11  # rates are what they are
    seconds, values = measured(steps, blocks, increments=True)
    times = np.concatenate([[0.0], np.cumsum(steps)]) / 1e3
    missing = np.isin(np.round(times, 6), np.round(seconds[np.isfinite(values[:, 6])], 6))
    assert np.flatnonzero(~missing).tolist() == [6, 9]


@pytest.mark.parametrize("blocks", [1, 3])
def test_of_even_increments_none_is_left_out(blocks):
    _, values = measured([10.0] * 120, blocks, increments=True)
    assert np.isfinite(values).all()


def shown_of(log, **options):
    shown = Shown()
    inspection = inspect(log, ProcessConfig(input=InputOptions(**options)), shown=shown)
    return {one.key: one for one in figures(inspection, shown.samplings, shown.traffic)}


@pytest.mark.parametrize("hertz", [400.0, 50.0])
def test_increments_at_rest_are_drawn_as_gravity(tmp_path, hertz):
    """Recorded a little out of order, with a gap: as rates and as increments they look alike."""
    times = np.delete(even_times(2000, hertz), slice(900, 1000))
    gyro, accel = resting(len(times), bias=(0.01, -0.02, 0.03))
    order = np.arange(len(times)).reshape(-1, 2)[:, ::-1].ravel()
    drawn = {}
    for kind, size in (("rate", 1.0), ("increment", 1.0 / hertz)):
        log = imu_log(
            tmp_path / f"{kind}.mcap", times[order], gyro[order] * size, accel[order] * size
        )
        drawn[kind] = shown_of(log, gyro_kind=kind)
    force, rate = drawn["increment"]["force-0"], drawn["increment"]["gyro-0"]
    norm = next(one.y for one in force.series if one.name == "norm")
    assert np.isfinite(norm).sum() > 1800
    np.testing.assert_allclose(norm[np.isfinite(norm)], 9.8, atol=0.15)
    for k, mean in enumerate((0.01, -0.02, 0.03)):
        np.testing.assert_allclose(np.nanmean(rate.series[k].y), np.degrees(mean), atol=0.05)
    assert INCREMENTS in force.notes and INCREMENTS in rate.notes
    assert INCREMENTS not in drawn["rate"]["force-0"].notes
    for key in ("force-0", "gyro-0"):
        for a, b in zip(drawn["rate"][key].series, drawn["increment"][key].series, strict=True):
            shared = np.isin(drawn["rate"][key].x, drawn["increment"][key].x[np.isfinite(b.y)])
            shared &= np.isfinite(a.y)
            np.testing.assert_allclose(b.y[np.isfinite(b.y)], a.y[shared], rtol=1e-4, atol=1e-6)


def test_shares_count_every_interval_once():
    steps = np.concatenate([np.full(900, 10.0), np.full(90, 10.5), np.full(9, 9.5), [5000.0]])
    middles, counts, outside = sampled(np.random.default_rng(1).permutation(steps)).shares()
    assert counts.sum() + outside == 1000 and outside >= 1
    assert counts.max() == 900 and abs(middles[np.argmax(counts)] - 10.0) < 0.1
    assert counts[np.abs(middles - 10.5) < 0.06].sum() == 90


def test_nothing_is_kept_of_a_reading_that_begins_again():
    made = sampled([10, -5, 10])
    again = Imu(*(np.arange(4) * 20_000_000 + START,) * 2, np.zeros((4, 3)), np.ones((4, 3)))
    list(made.watch(iter([again])))
    assert made.back == [] and np.nanmax(made.curves(START)[1][:, 0]) == 20.0


def rates(seconds):
    """Of two topics that are silent for a fifth of the time, in the middle."""
    traffic = Traffic()
    times = {}
    for topic, hertz in (("/fast", 100.0), ("/slow", 2.0)):
        at = START + np.arange(int(seconds * hertz)) * round(1e9 / hertz)
        late = (at - START) / 1e9
        times[topic] = at[(late < 0.4 * seconds) | (late >= 0.6 * seconds)]
    order = np.array_split(times["/fast"], 20)
    for k, part in enumerate(np.array_split(times["/slow"], 20)):
        traffic.add("/fast", order[k])
        traffic.add("/slow", part)
    assert traffic.width_ns < max(2 * seconds * 1e9 / BINS, 2 * FIRST_BIN_NS)
    return {topic: (at, rate) for topic, at, rate in traffic.rates()}


@pytest.mark.parametrize("seconds", [300.0, 4000.0])
def test_rates_of_topics(seconds):
    drawn = rates(seconds)
    for topic, hertz in (("/fast", 100.0), ("/slow", 2.0)):
        at, rate = drawn[topic]
        width = at[1] - at[0]
        inside = (np.abs(at - 0.5 * seconds) > 0.1 * seconds + width) & (at > width)
        inside &= at < seconds - width
        silent = np.abs(at - 0.5 * seconds) < 0.1 * seconds - 0.5 * width
        assert inside.any() and silent.any()
        np.testing.assert_allclose(rate[inside], hertz, rtol=0.06)
        assert np.isnan(rate[silent]).all()


def test_a_silence_shorter_than_a_point_lowers_the_rate_and_is_no_hole():
    """Six seconds, in which the slow topic would have sent twelve messages."""
    drawn = rates(30.0)
    at, rate = drawn["/fast"]
    assert np.isnan(rate[np.abs(at - 15.0) < 2.9]).all()
    at, rate = drawn["/slow"]
    assert at[1] - at[0] >= MESSAGES / 2.0
    assert np.isfinite(rate).all() and rate.min() < 1.9


def test_too_few_messages_have_no_rate():
    traffic = Traffic()
    traffic.add("/once", np.array([START]))
    assert list(traffic.rates()) == []
