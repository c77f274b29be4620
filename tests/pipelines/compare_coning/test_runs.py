"""Runs side by side: what each candidate is fed, and at which instants its attitudes hold."""

from math import lcm

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sinstool.methods.coning.registry import algorithm, names
from sinstool.pipelines.compare_coning import runs
from sinstool.pipelines.compare_coning.runs import (
    Candidate,
    Segment,
    candidates,
    increments_of,
    run,
)
from tests.helpers.quick import mostly_slow

STEP_NS = 2_500_000
STEP = STEP_NS * 1e-9
N = 700
OPTIONS = {"gyro-tuned": {"interval": STEP}}
ALL = [n for n in names() if n != "savage-4"]


def built(name, decimate=1, input="none"):
    return Candidate(name, algorithm(name, **OPTIONS.get(name, {})), decimate, input)


def one_axis(count=N):
    """Turning to and fro about one axis: increments add up, whatever the algorithm."""
    rng = np.random.default_rng(5)
    axis = np.array([0.6, -0.48, 0.64])
    rate = np.convolve(rng.standard_normal(count + 40), np.hanning(41), "valid")
    times = 10**18 + STEP_NS * np.arange(count)
    return Segment(times, rate[:, None] * axis), axis


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("decimate", mostly_slow(range(1, 9), 1, 3))
@pytest.mark.parametrize("input", ["sums", "points"])
def test_instants_are_shared_with_the_reference(name, decimate, input):
    if decimate == 1:
        input = "none"
    segment, _ = one_axis()
    kind = "rate" if input == "points" else "mean-rate"
    reference = run(built("quatfiter-4"), [segment], kind, STEP)[0]
    candidate = built(name, decimate, input)
    made = run(candidate, [segment], kind, STEP)[0]
    # on multiples of the update, but for a last update of what is left
    assert np.all(made.sample[:-1] % candidate.stride == 0)
    assert np.all(np.diff(made.sample) > 0)
    assert N - 1 - made.sample[-1] < decimate
    assert len(made.q) == len(made.sample)
    common = np.intersect1d(made.sample, reference.sample)
    every = lcm(candidate.stride, 4)
    first = candidate.stride if input == "sums" else 0
    expected = np.arange(-(-first // every) * every, N, every)
    assert set(expected) <= set(common)
    assert len(common) >= 2


@pytest.mark.parametrize("name", [n for n in ALL if algorithm(n).takes == "increments"])
@pytest.mark.parametrize("decimate", [1, 2, 3, 5, 8])
def test_attitudes_stand_at_the_samples_they_name(name, decimate):
    segment, axis = one_axis()
    made = run(
        built(name, decimate, "sums" if decimate > 1 else "none"), [segment], "mean-rate", STEP
    )[0]
    # a mean rate is that of the interval that ends at its sample
    angle = np.cumsum(segment.gyro @ axis) * STEP
    turned = angle[made.sample] - angle[made.sample[0]]
    expected = Rotation.from_rotvec(turned[:, None] * axis)
    apart = (Rotation.from_quat(made.q, scalar_first=True) * expected.inv()).magnitude()
    assert np.ptp(turned) > 0.1
    assert apart.max() < 1e-12


@pytest.mark.parametrize("name", ["singular-perturbation", "previous-3", "lookahead-12"])
@pytest.mark.parametrize("decimate", [1, 2, 5])
def test_picked_points_stand_at_the_samples_they_name(name, decimate):
    axis, rate = np.array([0.36, 0.48, 0.8]), 1.7
    times = 10**18 + STEP_NS * np.arange(N)
    segment = Segment(times, np.tile(rate * axis, (N, 1)))
    made = run(built(name, decimate, "points"), [segment], "rate", STEP)[0]
    assert made.sample[0] == 0
    turned = rate * (times[made.sample] - times[0]) * 1e-9
    expected = Rotation.from_rotvec(turned[:, None] * axis)
    apart = (Rotation.from_quat(made.q, scalar_first=True) * expected.inv()).magnitude()
    assert apart.max() < 1e-12


def test_increments_of_rates_integrate_polynomials():
    # six points integrate a polynomial of degree 5 exactly, at the ends too
    t = np.arange(60) * STEP
    poly = np.polynomial.Polynomial([1.0, -20.0, 300.0, 4e3, -5e4, 6e5])
    segment = Segment((t * 1e9).round().astype(np.int64), np.stack([poly(t), -poly(t), 0 * t], -1))
    result = increments_of(segment, "rate", STEP)
    whole = poly.integ()
    np.testing.assert_allclose(result[:, 0], np.diff(whole(t)), rtol=1e-12)
    np.testing.assert_allclose(result[:, 1], -result[:, 0], rtol=1e-12)


def test_sums_of_given_increments_are_the_same_to_the_bit():
    segment, _ = one_axis()
    c = built("previous-3", 4, "sums")
    shared = run(c, [segment], "rate", STEP, [increments_of(segment, "rate", STEP)])[0]
    own = run(c, [segment], "rate", STEP)[0]
    assert np.array_equal(shared.q, own.q)
    assert np.array_equal(shared.sample, own.sample)


def test_points_are_picked_of_rates_only():
    both = candidates(["previous-1", "optimal-2"], (1, 2), "rate", {})
    assert [c.label for c in both] == [
        "previous-1",
        "optimal-2",
        "previous-1 /2 sums",
        "optimal-2 /2 sums",
        "previous-1 /2 points",
        "optimal-2 /2 points",
    ]
    means = candidates(["previous-1"], (1, 2), "mean-rate", {})
    assert [c.input for c in means] == ["none", "sums"]


def test_options_reach_their_algorithm():
    sp = candidates(
        ["singular-perturbation"], (1,), "rate", {"singular-perturbation": {"preset": "paper"}}
    )[0].algorithm
    x = np.array([[0.0, 0.1, 0.0], [0.1, 0.2, 0.3]])
    dt = np.full(2, STEP)
    paper = algorithm("singular-perturbation", preset="paper").rotation_vectors(x, dt, 1, 1)
    best = algorithm("singular-perturbation").rotation_vectors(x, dt, 1, 1)
    result = sp.rotation_vectors(x, dt, 1, 1)
    assert np.array_equal(result, paper)
    assert not np.allclose(result, best, rtol=1e-6)


@pytest.mark.parametrize("count", [1, 2, 3, 5, 9])
@pytest.mark.parametrize("decimate", [1, 4])
@pytest.mark.parametrize("name", ["optimal-4", "lookahead-12", "singular-perturbation"])
def test_short_segments_give_what_there_is(count, decimate, name):
    segment, _ = one_axis()
    short = Segment(segment.time_ns[:count], segment.gyro[:count])
    made = run(
        built(name, decimate, "sums" if decimate > 1 else "none"), [short], "mean-rate", STEP
    )[0]
    assert len(made.q) == len(made.sample)
    assert np.all(made.sample < count)
    if decimate == 1:
        assert made.sample[-1] == count - 1


def test_time_is_that_of_the_thread():
    segment, _ = one_axis()
    made = run(built("previous-3"), [segment], "mean-rate", STEP)[0]
    assert 0.0 < made.seconds < 1.0
    assert made.samples == N


def test_many_stretches_are_run_as_often_as_one_of_their_length(monkeypatch):
    # what is timed again for its shortness is all of them, not each
    segment, _ = one_axis(4096)
    cuts = range(0, 4096, 64)
    pieces = [Segment(segment.time_ns[k : k + 64], segment.gyro[k : k + 64]) for k in cuts]
    monkeypatch.setattr(runs, "_ENOUGH_S", 0.0)
    monkeypatch.setattr(runs, "_TIMED", 1)
    calls = []
    original = runs._integrate
    monkeypatch.setattr(runs, "_integrate", lambda *a: calls.append(1) or original(*a))
    made = run(built("quatfiter-4"), pieces, "mean-rate", STEP)
    assert len(calls) == 1 + len(pieces)
    for piece, attitudes in zip(pieces, made, strict=True):
        (alone,) = run(built("quatfiter-4"), [piece], "mean-rate", STEP)
        assert np.array_equal(alone.q, attitudes.q)
        assert np.array_equal(alone.sample, attitudes.sample)
        assert attitudes.seconds > 0.0


def test_the_cost_of_a_short_stretch_is_that_of_its_samples(monkeypatch):
    """Of a thousand samples most of the time goes into the beginning, the same for all."""
    clock, integrate = [0.0], runs._integrate

    def timed(chosen, fed, interval, gyro, times):
        clock[0] += 1e-3 + (1e-6 if chosen.name == "lookahead-12" else 1e-7) * len(times)
        return integrate(chosen, fed, interval, gyro, times)

    monkeypatch.setattr(runs, "_integrate", timed)
    monkeypatch.setattr(runs.time, "thread_time", lambda: clock[0])
    segment = Segment(10**18 + STEP_NS * np.arange(400), np.full((400, 3), 0.1))
    costs = {}
    for candidate in candidates(["previous-3", "lookahead-12"], [1], "mean-rate", {}):
        (made,) = run(candidate, [segment], "mean-rate", STEP)
        assert made.sample[-1] == 399 and made.samples == 400
        costs[candidate.name] = made.seconds / made.samples
    assert costs["lookahead-12"] > 6.0 * costs["previous-3"]
