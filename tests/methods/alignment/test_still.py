import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sinstool.methods.alignment.still import (
    WINDOW_NS,
    Windows,
    WindowStage,
    lead_in,
    still_spans,
)
from tests.helpers.imulogs import G, even_times, handheld, resting

RATE = 200.0


def windows(gyro, accel, times=None, block=None):
    times = even_times(len(gyro), RATE) if times is None else times
    stage = WindowStage()
    block = block or max(1, len(times))
    for i in range(0, len(times), block):
        rows = slice(i, i + block)
        stage.push(times[rows], gyro[rows], accel[rows])
    return stage.finish()


def same(a: Windows, b: Windows):
    return all(getattr(a, f).tobytes() == getattr(b, f).tobytes() for f in a.__dataclass_fields__)


def test_windows_are_means_and_deviations_of_half_seconds():
    rng = np.random.default_rng(1)
    times = np.cumsum(rng.integers(1_000_000, 60_000_000, 500)) + 10**18
    times[300:] += 7 * 10**9  # windows without samples are absent
    gyro, accel = rng.normal(3.0, 1.0, (500, 3)), rng.normal(-20.0, 5.0, (500, 3))
    actual = windows(gyro, accel, times)
    number = (times - times[0]) // WINDOW_NS
    present = np.unique(number)
    np.testing.assert_array_equal(actual.start_ns, times[0] + present * WINDOW_NS)
    for k, n in enumerate(present):
        rows = number == n
        assert actual.count[k] == rows.sum()
        np.testing.assert_allclose(actual.gyro[k], gyro[rows].mean(axis=0), rtol=1e-12)
        np.testing.assert_allclose(actual.accel[k], accel[rows].mean(axis=0), rtol=1e-12)
        for std, x in ((actual.gyro_std[k], gyro[rows]), (actual.accel_std[k], accel[rows])):
            expected = np.sqrt(x.var(axis=0, ddof=1).sum()) if len(x) > 1 else 0.0
            np.testing.assert_allclose(std, expected, rtol=1e-10, atol=1e-12)


def test_what_is_fast_is_noise_and_no_motion():
    rng = np.random.default_rng(2)
    times = np.arange(6000) * 5_000_000
    motion = 20.0 * np.sin(2.0 * np.pi * 5.0 * times[:, None] * 1e-9 + np.arange(3.0))
    noise = rng.standard_normal((2, 6000, 3))
    actual = windows(motion + 0.02 * noise[0], 5.0 * motion + 0.3 * noise[1], times)
    for fast, sigma in ((actual.gyro_fast, 0.02), (actual.accel_fast, 0.3)):
        assert np.sqrt(np.mean(fast[1:] ** 2)) == pytest.approx(np.sqrt(3.0) * sigma, rel=0.03)
    # of too few samples nothing is known
    few = windows(motion[:10], motion[:10], times[:10])
    assert np.isnan(few.gyro_fast).all() and np.isnan(few.accel_fast).all()


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.lists(st.integers(1, 400), min_size=1, max_size=30))
def test_blocks_do_not_matter(seed, sizes):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.choice([1_000_000, 5_000_000, 600_000_000], 800, p=[0.2, 0.79, 0.01]))
    gyro, accel = rng.normal(size=(800, 3)), rng.normal(size=(800, 3))
    whole = windows(gyro, accel, times)
    stage, at = WindowStage(), 0
    for size in [*sizes, 800]:
        stage.push(times[at : at + size], gyro[at : at + size], accel[at : at + size])
        at += size
    assert same(stage.finish(), whole)
    assert same(windows(gyro, accel, times, block=1), whole)


@pytest.mark.parametrize("bias_deg_s", [0.0, 4.4, -30.0])
def test_rest_is_rest_however_large_the_bias(bias_deg_s):
    bias = np.radians(bias_deg_s) * np.array([0.6, -0.64, 0.48])
    gyro, accel = resting(4000, bias=bias)
    spans = still_spans(windows(gyro, accel))
    assert len(spans) == 1
    span = spans[0]
    assert span.duration_s == pytest.approx(20.0)
    assert span.samples == 4000
    # four sigma of a mean of 4000
    np.testing.assert_allclose(span.gyro, bias, atol=4 * 2e-3 / np.sqrt(4000))
    np.testing.assert_allclose(span.accel, [0, 0, G], atol=4 * 0.02 / np.sqrt(4000))
    assert span.gyro_std == pytest.approx(2e-3 * np.sqrt(3), rel=0.05)
    assert span.accel_std == pytest.approx(0.02 * np.sqrt(3), rel=0.05)


@pytest.mark.parametrize("seed", range(5))
def test_a_hand_is_never_still(seed):
    gyro, accel, _ = handheld(4000, seed=seed, size=0.5)
    assert still_spans(windows(gyro, accel)) == []


@pytest.mark.parametrize("rate_deg_s", [1.0, 3.0, 20.0])
@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.0, 0.8)])
def test_slow_rotation_is_not_rest(rate_deg_s, axis):
    """Its rate is as steady as a bias; gravity gives it away."""
    gyro, accel = resting(4000)
    rate = np.radians(rate_deg_s) * np.array(axis)
    turned = Rotation.from_rotvec(np.arange(4000)[:, None] / RATE * rate)
    tilted = Rotation.from_rotvec([0.4, 0.3, 0.0])  # no axis is along gravity
    spans = still_spans(windows(gyro + rate, turned.inv().apply(tilted.inv().apply(accel))))
    assert spans == []


def test_turning_about_the_vertical_is_not_rest():
    gyro, accel = resting(8000)
    gyro[:, 2] += 0.1 * np.sin(2 * np.pi / 8.0 * np.arange(8000) / RATE)
    assert lead_in(still_spans(windows(gyro, accel)), int(even_times(1)[0])) is None


def test_rest_ends_before_the_motion_begins():
    moving = handheld(2000, seed=3)
    rest = resting(2100)
    gyro = np.concatenate((rest[0], moving[0], rest[0]))
    accel = np.concatenate((rest[1], moving[1], rest[1]))
    first, last = still_spans(windows(gyro, accel))
    t0 = int(even_times(1)[0])
    # motion begins at 10.5 s: the window before it may hold the hand that reaches out
    assert (first.start_ns - t0) / 1e9 == 0.0
    assert (first.end_ns - t0) / 1e9 == pytest.approx(10.0)
    assert (last.start_ns - t0) / 1e9 == pytest.approx(20.5)
    assert lead_in([first, last], t0) is first
    assert lead_in([last], t0) is None
    assert lead_in([], t0) is None


@pytest.mark.parametrize("lost", [0.1, 0.6, 1.2])
def test_a_rest_goes_on_across_a_short_gap(lost):
    """A recorder that lost half a second left too little of a rest of a minute to gyrocompass."""
    gyro, accel = resting(2000)
    times = even_times(2000)
    times[1000:] += round(lost * 1e9)
    (span,) = still_spans(windows(gyro, accel, times))
    assert span.duration_s == pytest.approx(10.0 + lost, abs=0.6) and span.samples > 1900
    # Not where it was tilted meanwhile
    accel[1000:] = Rotation.from_euler("x", 5, degrees=True).apply(accel[1000:])
    assert len(still_spans(windows(gyro, accel, times))) == 2


def test_rest_does_not_reach_across_a_gap():
    gyro, accel = resting(2000)
    times = even_times(2000)
    times[1000:] += 60 * 10**9
    spans = still_spans(windows(gyro, accel, times))
    assert [s.duration_s for s in spans] == pytest.approx([4.5, 5.0], abs=0.51)
    assert spans[0].end_ns <= times[999] + WINDOW_NS
    assert spans[1].start_ns >= times[1000] - WINDOW_NS


def test_less_than_a_second_is_no_rest():
    gyro, accel = resting(100)
    assert still_spans(windows(gyro, accel)) == []
    assert still_spans(windows(np.empty((0, 3)), np.empty((0, 3)))) == []


def test_a_sensor_that_rests_elsewhere_afterwards_has_two_rests():
    gyro, accel = resting(4000)
    accel[2000:] = Rotation.from_euler("x", 5, degrees=True).apply(accel[2000:])
    spans = still_spans(windows(gyro, accel))
    assert len(spans) == 2
    for span, angle in zip(spans, (0.0, np.radians(5)), strict=True):
        np.testing.assert_allclose(np.arctan2(-span.accel[1], span.accel[2]), angle, atol=1e-3)
