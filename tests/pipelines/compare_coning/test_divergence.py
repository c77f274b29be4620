"""Divergence against brute force: integration begun anew in every window, by other software."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sinstool.methods.coning.registry import algorithm
from sinstool.methods.coning.stage import ConingStage
from sinstool.pipelines.compare_coning import divergence
from sinstool.pipelines.compare_coning.divergence import IN_DEG_H, part, statistics, widest_gap
from sinstool.pipelines.compare_coning.runs import Attitudes, Candidate, Segment, run
from sinstool.simulation.motions import random_manoeuvre, sample
from sinstool.simulation.truth import sample_times


def attitudes(rotations, sample=None):
    q = rotations.as_quat(scalar_first=True)
    n = len(q)
    return Attitudes(np.arange(n) if sample is None else sample, q, 0.0, n)


def random_walk(n, seed=0):
    rng = np.random.default_rng(seed)
    out = Rotation.from_rotvec(np.cumsum(0.01 * rng.standard_normal((n, 3)), axis=0))
    # signs of quaternions mean nothing
    q = out.as_quat() * rng.choice([-1.0, 1.0], (n, 1))
    return out, q[:, [3, 0, 1, 2]]


@pytest.fixture(scope="module")
def manoeuvre():
    truth = sample(random_manoeuvre(2.0, (0.3, 3.0), seed=4), sample_times(100.0, 25.0))
    return Segment(truth.time_ns, truth.gyro_mean_rate)


@pytest.mark.parametrize("name", ["uncompensated", "optimal-4", "lookahead-8"])
def test_windows_are_restarted_integrations(manoeuvre, name):
    chosen = algorithm(name)
    stage = ConingStage(chosen, "mean-rate", nominal_interval=0.01)
    steps = [stage.push(manoeuvre.gyro, manoeuvre.time_ns), stage.finish()]
    ends = np.concatenate([s.sample for s in steps])
    turns = Rotation.from_rotvec(np.concatenate([s.rotation_vector for s in steps]))
    reference = run(
        Candidate("quatfiter-4", algorithm("quatfiter-4")), [manoeuvre], "mean-rate", 0.01
    )[0]
    true = dict(
        zip(
            reference.sample.tolist(),
            Rotation.from_quat(reference.q, scalar_first=True),
            strict=True,
        )
    )
    expected = []
    for begin, end in ((0, 1000), (1000, 2000), (2000, len(manoeuvre) - 1)):
        attitude = true[begin]
        for k in np.flatnonzero((ends > begin) & (ends <= end)):
            attitude = attitude * turns[k]
        psi = (attitude * true[end].inv()).as_rotvec()
        expected.append(psi / ((end - begin) * 0.01))
    mine = run(Candidate(name, chosen), [manoeuvre], "mean-rate", 0.01)[0]
    actual = part(mine, reference, manoeuvre.time_ns, 10.0)
    assert np.linalg.norm(expected, axis=1).min() > 1e-10
    np.testing.assert_allclose(actual.window_rate, expected, atol=1e-13)
    np.testing.assert_allclose(actual.window_start_s, [0.0, 10.0, 20.0], atol=1e-9)
    np.testing.assert_allclose(actual.window_length_s, [10.0, 10.0, 5.0], atol=1e-9)


def test_slopes_see_drift_and_not_what_swings():
    n, step = 6001, 0.01
    t = np.arange(n) * step
    reference, _ = random_walk(n)
    drift = np.array([2e-6, -1e-6, 5e-7])
    swing = 3e-5 * np.sin(2 * np.pi * 17.33 * t)[:, None] * np.array([1.0, 2.0, -1.0])
    candidate = Rotation.from_rotvec(drift * t[:, None] + swing) * reference
    result = part(attitudes(candidate), attitudes(reference), (t * 1e9).astype(np.int64), 10.0)
    assert result.window_slope.shape == (6, 3)
    np.testing.assert_allclose(result.window_slope, np.tile(drift, (6, 1)), atol=2e-7)
    np.testing.assert_allclose(result.slope, drift, atol=1e-8)
    # the end of a window takes the swing as it happens to be
    assert np.abs(result.window_rate - drift).max() > 1e-6
    np.testing.assert_allclose(result.end, drift * t[-1] + swing[-1], atol=1e-9)
    largest = np.linalg.norm(drift * t[:, None] + swing, axis=1).max()
    assert result.largest == pytest.approx(largest, rel=1e-6)


def test_slopes_are_those_of_a_line_through_each_window():
    n, step = 900, 0.02
    reference, _ = random_walk(n, 1)
    candidate, q = random_walk(n, 2)
    times = (np.arange(n) * step * 1e9).astype(np.int64)
    result = part(Attitudes(np.arange(n), q, 0.0, n), attitudes(reference), times, 5.0)
    for w, begin in enumerate((0, 250, 500)):
        rows = np.arange(begin, begin + 251)
        turn = reference[begin] * candidate[begin].inv()
        psi = (turn * candidate[rows] * reference[rows].inv()).as_rotvec()
        line = np.polyfit(rows * step, psi, 1)[0]
        np.testing.assert_allclose(result.window_slope[w], line, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(result.window_rate[w], psi[-1] / 5.0, rtol=1e-9)


@pytest.mark.parametrize(
    ("seconds", "window", "lengths"),
    [
        (25.0, 10.0, [10, 10, 5]),  # half a window counts
        (24.9, 10.0, [10, 10]),  # less does not
        (2.0, 10.0, [2]),  # unless it is all there is
        (14.0, 10.0, [10]),
        (10.0, 10.0, [10]),
    ],
)
def test_windows_and_their_remainder(seconds, window, lengths):
    n = round(seconds * 100) + 1
    reference, _ = random_walk(n)
    times = 10_000_000 * np.arange(n)
    result = part(attitudes(reference), attitudes(reference), times, window)
    np.testing.assert_allclose(result.window_length_s, lengths, atol=1e-9)
    assert np.abs(result.window_rate).max() < 1e-16


def test_only_shared_instants_count():
    n = 1000
    reference, _ = random_walk(n)
    other, q = random_walk(n, 3)
    times = 10_000_000 * np.arange(n)
    mine = np.arange(3, n, 3)
    theirs = np.arange(0, n, 4)
    sparse = part(
        Attitudes(mine, q[mine], 0.0, n), attitudes(reference[theirs], theirs), times, 2.0
    )
    both = np.arange(12, n, 12)
    dense = part(attitudes(other[both], both), attitudes(reference[both], both), times, 2.0)
    np.testing.assert_allclose(sparse.window_rate, dense.window_rate, atol=1e-15)
    np.testing.assert_allclose(sparse.norm, dense.norm, atol=1e-15)
    alone = attitudes(reference[[5]], np.array([5]))
    assert part(alone, attitudes(reference), times, 2.0) is None
    assert np.isnan(widest_gap(alone, attitudes(reference)))


def test_long_runs_are_thinned_without_moving_anything(monkeypatch):
    n = 20001
    t = np.arange(n) * 0.01
    reference, _ = random_walk(n)
    psi = np.array([1e-6, 2e-6, -3e-6]) * t[:, None] + 1e-5 * np.sin(0.05 * t)[:, None]
    candidate = Rotation.from_rotvec(psi) * reference
    times = (t * 1e9).astype(np.int64)
    whole = part(attitudes(candidate), attitudes(reference), times, 10.0)
    monkeypatch.setattr(divergence, "_MOST", 3000)
    few = part(attitudes(candidate), attitudes(reference), times, 10.0)
    np.testing.assert_allclose(few.end, whole.end, atol=1e-15)
    np.testing.assert_allclose(few.slope, whole.slope, rtol=1e-3)
    np.testing.assert_allclose(few.window_slope, whole.window_slope, rtol=1e-2)
    np.testing.assert_allclose(few.window_length_s, 10.0, atol=0.07)
    assert len(few.time_s) <= 2000


def test_statistics_are_those_of_the_windows():
    rng = np.random.default_rng(0)
    rates = rng.normal([1.0, -2.0, 0.0], 0.3, (50, 3)) / IN_DEG_H
    slopes = rng.normal(0.0, 1.0, (50, 3)) / IN_DEG_H
    result = statistics(rates, slopes)
    d = rates * IN_DEG_H
    np.testing.assert_allclose(result.mean, d.mean(axis=0))
    np.testing.assert_allclose(result.confidence, 2 * np.std(d, axis=0, ddof=1) / np.sqrt(50))
    np.testing.assert_allclose(result.max, np.abs(d).max(axis=0))
    np.testing.assert_allclose(result.p95, np.quantile(np.abs(d), 0.95, axis=0))
    assert result.norm_rms == pytest.approx(np.sqrt((np.linalg.norm(d, axis=1) ** 2).mean()))
    assert result.slope_rms == pytest.approx(np.linalg.norm(slopes * IN_DEG_H) / np.sqrt(50))
    assert result.norm_rms**2 == pytest.approx(np.sum(result.rms**2))
    one = statistics(rates[:1], slopes[:1])
    assert np.isnan(one.confidence).all()
    np.testing.assert_allclose(one.mean, d[0])


def test_widest_gap_is_the_largest_angle():
    n = 400
    first, q = random_walk(n, 5)
    second, _ = random_walk(n, 6)
    turn = second[0] * first[0].inv()
    expected = (turn * first * second.inv()).magnitude().max()
    actual = widest_gap(Attitudes(np.arange(n), q, 0.0, n), attitudes(second))
    assert actual == pytest.approx(expected, rel=1e-12)
    assert expected > 0.1
