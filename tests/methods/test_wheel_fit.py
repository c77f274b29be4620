"""Wheels against a reference: scale, latency, their sigmas, and a wheel that slips."""

import numpy as np
import pytest
from scipy.signal import lfilter

from sinstool.methods.wheel_fit import LEAST, fit_wheels, slipping_wheels, variance_inflation

NS = 1_000_000_000
START = 1_700_000_000 * NS


def speed_at(t, seed=0):
    """Stop and go, in reverse now and then, m/s."""
    random = np.random.default_rng(seed)
    knots = np.arange(-20.0, 1220.0, 12.0)
    levels = np.maximum(random.uniform(-6.0, 16.0, len(knots)), -2.0)
    levels[random.random(len(knots)) < 0.3] = 0.0
    return np.convolve(np.interp(t, knots, levels), np.ones(21) / 21, "same")


def made(scale=1.0, latency=0.0, noise=0.05, slow=0.0, seconds=600.0, seed=0, slip=0.0):
    """Readings at 20 Hz and a reference at 5 Hz, whose noise is white or alike over 3 s.

    Wheels slip by the share `slip` of the speed for each m/s^2.
    """
    random = np.random.default_rng(seed)
    fine = np.arange(-10.0, seconds + 10.0, 0.01)
    truth = speed_at(fine, seed)
    at = np.arange(0.0, seconds, 0.05) + random.uniform(-0.002, 0.002, round(seconds * 20))
    t = np.arange(0.03, seconds, 0.2)
    wheel = truth + slip * np.abs(truth) * np.gradient(truth, fine)
    reading = np.interp(at - latency, fine, wheel) / scale
    error = noise * random.standard_normal(len(t))
    if slow:
        drift = random.standard_normal(len(t))
        for k in range(1, len(t)):
            drift[k] = np.exp(-0.2 / 3.0) * drift[k - 1] + 0.353 * drift[k]
        error = slow * drift
    reference = np.interp(t, fine, truth) + error
    stamp = START + np.round(at * NS).astype(np.int64)
    return stamp, reading, START + np.round(t * NS).astype(np.int64), reference


@pytest.mark.parametrize("scale", [1.0, 0.97, 0.31])
@pytest.mark.parametrize("latency", [-0.12, 0.0, 0.234, 0.8])
def test_scale_and_latency(scale, latency):
    fit = fit_wheels(*made(scale, latency))
    assert fit.scale == pytest.approx(scale, rel=2e-3)
    assert fit.latency_s == pytest.approx(latency, abs=0.02)
    assert fit.residual_sigma == pytest.approx(0.05, rel=0.2)
    assert 0.0 < fit.scale_sigma < 1e-3 * scale
    assert 0.0 < fit.latency_sigma < 0.02


@pytest.mark.parametrize("unit", [0.1, 1.0, 30.0])
def test_residual_sigma_is_at_least_a_thousandth_of_the_speed(unit):
    """Readings that fit exactly, at any speed: each is used, and the residual is the least."""
    stamps, reading, reference_ns, reference = made(0.97, noise=0.0)
    fit = fit_wheels(stamps, unit * reading, reference_ns, unit * reference)
    fastest = unit * np.quantile(np.abs(reference), 0.95)
    assert 0.999e-3 * fastest < fit.residual_sigma < 2e-3 * fastest


@pytest.mark.parametrize("slow", [0.0, 0.1])
def test_sigmas_are_those_of_the_errors(slow):
    pulls = []
    for seed in range(40):
        slip = 0.02 * np.random.default_rng(seed).standard_normal()
        fit = fit_wheels(*made(0.98, 0.1, slow=slow, seconds=300.0, seed=seed, slip=slip))
        pulls.append(
            [(fit.scale - 0.98) / fit.scale_sigma, (fit.latency_s - 0.1) / fit.latency_sigma]
        )
    rms = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert np.all(rms > 0.6) and np.all(rms < 1.6)


def test_noise_of_readings_does_not_draw_the_latency_between_them():
    # stamps of both on the same grid, where only latency decides how readings are mixed
    random = np.random.default_rng(4)
    fine = np.arange(-10.0, 610.0, 0.01)
    at, t = np.arange(0.0, 600.0, 0.05), np.arange(0.0, 600.0, 0.2)
    truth = speed_at(fine)
    for latency in (0.1, 0.12, 0.125):
        reading = np.interp(at, fine, truth) + 0.1 * random.standard_normal(len(at))
        stamp, reference = START + np.round((at + latency) * NS), np.interp(t, fine, truth)
        fit = fit_wheels(stamp.astype(np.int64), reading,
                         START + np.round(t * NS).astype(np.int64), reference)  # fmt: skip
        assert fit.latency_s == pytest.approx(latency, abs=3.0 * fit.latency_sigma)
        assert fit.latency_sigma < 0.01


def test_the_slope_of_noise_is_no_change_of_speed():
    """Noisy readings at 10 Hz of a speed that hardly changes: pulls were 10 sigmas rms."""
    pulls = []
    for seed in range(20):
        random = np.random.default_rng(seed)
        at = np.arange(0.0, 120.0, 0.1)
        speed = 12.0 + 0.2 * np.sin(2.0 * np.pi * at / 40.0 + seed)
        stamp = START + np.round(at * NS).astype(np.int64)
        fit = fit_wheels(stamp, speed + 0.1 * random.standard_normal(len(at)), stamp, speed)
        pulls.append(fit.latency_s / fit.latency_sigma)
        usual = fit.with_prior(0.2)
        assert abs(usual.latency_s) < abs(fit.latency_s)
        assert 0.02 < usual.latency_sigma < 0.2
    assert np.sqrt(np.mean(np.square(pulls))) < 2.5
    known = fit_wheels(*made(0.98, 0.3))
    assert known.with_prior(0.2).latency_s == pytest.approx(known.latency_s, abs=0.01)


def city(seed, latency):
    """A car that changes speed by 2 m/s^2 between lights; noisy readings, fixes at 2 Hz."""
    random = np.random.default_rng(seed)
    fine = np.arange(-5.0, 125.0, 0.01)
    speed, level = np.zeros(len(fine)), 0.0
    for begin in range(0, len(fine), 1500):
        other = random.uniform(0.0, 16.0)
        ramp = np.clip(2.0 * np.arange(1500) * 0.01, 0.0, abs(other - level))
        speed[begin : begin + 1500] = (level + np.sign(other - level) * ramp)[: len(fine) - begin]
        level = other
    at, t = np.arange(0.0, 120.0, 0.1), np.arange(0.03, 120.0, 0.5)
    reading = np.interp(at - latency, fine, speed) + 0.1 * random.standard_normal(len(at))
    reference = np.interp(t, fine, speed) + 0.02 * random.standard_normal(len(t))
    stamp, reference_ns = (START + np.round(x * NS).astype(np.int64) for x in (at, t))
    return stamp, reading, reference_ns, reference


@pytest.mark.parametrize("latency", [0.0, 0.2])
def test_ramps_between_constant_speeds_show_the_latency(latency):
    """Their ends alone drew it by more than 0.1 s, 4 sigmas."""
    found = [fit_wheels(*city(seed, latency)) for seed in range(20)]
    errors = np.array([fit.latency_s - latency for fit in found])
    sigmas = np.array([fit.latency_sigma for fit in found])
    assert np.abs(errors).max() < 0.06 and np.median(sigmas) < 0.02
    assert np.sqrt(np.mean((errors / sigmas) ** 2)) < 1.5


@pytest.mark.parametrize("slip", [-0.015, 0.0, 0.03])
def test_a_slip_by_acceleration_is_found_and_taken_off(slip):
    stamp, reading, t, reference = made(0.5, 0.1, noise=0.02, slip=slip)
    fit = fit_wheels(stamp, reading, t, reference)
    assert fit.slip == pytest.approx(slip, abs=2e-3)
    assert fit.latency_s == pytest.approx(0.1, abs=0.02)
    begin = int(stamp[0])
    seconds, at = (t - begin) * 1e-9, (stamp - begin) * 1e-9
    rest = fit.rolled(seconds, at - fit.latency_s, reading) - reference
    assert np.sqrt(np.mean(rest[10:-10] ** 2)) < 0.05


def test_slips_and_holes_do_not_count():
    stamp, reading, t, reference = made(0.98, 0.1)
    clean = fit_wheels(stamp, reading, t, reference)
    spoilt = reading.copy()
    for begin in range(1000, 11000, 1000):
        spoilt[begin : begin + 60] *= 1.3
    there = np.ones(len(stamp), bool)
    there[4000:4600] = False
    fit = fit_wheels(stamp[there], spoilt[there], t, reference)
    assert fit.scale == pytest.approx(0.98, rel=2e-3)
    assert fit.latency_s == pytest.approx(0.1, abs=0.02)
    assert fit.samples < clean.samples - 60


def test_too_little_motion_says_nothing():
    stamp, reading, t, reference = made()
    assert fit_wheels(stamp, 0.0 * reading, t, reference) is None
    assert fit_wheels(stamp[:1], reading[:1], t, reference) is None
    assert fit_wheels(stamp, reading, t[:0], reference[:0]) is None
    assert fit_wheels(stamp[:100], reading[:100], t, reference) is None


def test_constant_speed_shows_scale_and_no_latency():
    stamp, _, t, _ = made()
    random = np.random.default_rng(1)
    reference = 10.0 + 0.05 * random.standard_normal(len(t))
    fit = fit_wheels(stamp, np.full(len(stamp), 9.8), t, reference)
    assert fit.scale == pytest.approx(10.0 / 9.8, rel=1e-3)
    assert fit.latency_sigma > 10.0


@pytest.mark.parametrize("radius", [1.0, -0.31])
def test_a_wheel_that_slips_is_told_from_a_turn(radius):
    random = np.random.default_rng(2)
    n = 12000
    stamp = START + np.arange(n) * 50_000_000
    turn = np.repeat(random.choice([-0.3, 0.0, 0.0, 0.25], n // 200), 200)
    turn = np.convolve(turn, np.ones(41) / 41, "same")
    speed = np.convolve(
        np.repeat(random.uniform(4.0, 15.0, n // 400), 400), np.ones(81) / 81, "same"
    )
    apart = (1.52 * turn + 0.02 * random.standard_normal(n)) / radius
    slips = np.zeros(n, bool)
    for begin in range(700, n, 900):
        slips[begin : begin + 40] = True
    apart[slips] += 0.08 * speed[slips] / radius
    found = slipping_wheels(stamp, speed / abs(radius), apart, stamp[::10], turn[::10])
    assert found[slips].mean() > 0.95
    assert found[~slips].mean() < 0.002
    quiet = slipping_wheels(stamp, speed, apart, stamp[::10], 0.0 * turn[::10])
    assert not quiet.any()


@pytest.mark.parametrize("count", [LEAST - 1, LEAST])
def test_so_many_samples_of_a_reference_are_needed(count):
    stamp = START + np.arange(0, 1000) * 50_000_000
    t = START + 10 * NS + np.arange(count) * 200_000_000
    speed = [10.0 + 0.2 * np.sin((k - START) * 1e-9) for k in (stamp, t)]
    fit = fit_wheels(stamp, speed[0], t, speed[1])
    assert (fit is None) == (count < LEAST)
    assert fit is None or (fit.samples == LEAST and fit.scale == pytest.approx(1.0, rel=1e-3))


@pytest.mark.parametrize("alike_s", [0.0, 3.0, 20.0])
def test_the_variance_of_a_mean_grows_with_the_correlation_of_its_samples(alike_s):
    """Of a first-order process: (1 + phi) / (1 - phi) times that of white noise."""
    phi = np.exp(-0.2 / alike_s) if alike_s else 0.0
    found = []
    for seed in range(20):
        white = np.random.default_rng(seed).standard_normal(20_000)
        found.append(
            variance_inflation(0.2 * np.arange(20_000), lfilter([1.0], [1.0, -phi], white))
        )
    assert np.mean(found) == pytest.approx((1.0 + phi) / (1.0 - phi), rel=0.1)
