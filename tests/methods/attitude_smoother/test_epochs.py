"""Epochs of solutions: gyros at their stops, and logs without any."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.methods.attitude_smoother.epochs import SATURATED, STOP_RUN, UNEVEN, EpochStage
from tests.helpers.matched_motion import MAX_GAP_NS, solution_of

DT = 0.02
STOPS = np.array([1.0, 2.0, 3.0])


def saturated_s(at_stop):
    """Time at a stop that is counted, by samples and axes that are there."""
    gyro = (
        np.where(at_stop, STOPS, 0.3 * STOPS)
        * np.where(np.arange(len(at_stop)) % 2, 1, -1)[:, None]
    )
    q = np.tile([1.0, 0.0, 0.0, 0.0], (len(gyro) + 1, 1))
    stage = EpochStage(MAX_GAP_NS, STOPS)
    solution = solution_of(DT, q, gyro, np.zeros((len(gyro), 3)))
    for begin in range(0, len(solution), 37):
        stage.push(solution.rows(slice(begin, begin + 37)))
    return stage.finish().values[:, SATURATED].sum()


def runs(flags):
    """Lengths of the runs of True."""
    edge = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return edge[1::2] - edge[::2]


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("seed", range(3))
def test_time_at_a_stop_is_that_of_the_runs_of_it(axis, seed):
    # a gyro touches its stop, never for long; then stays there again and again
    random = np.random.default_rng(seed)
    at_stop = np.zeros((600, 3), bool)
    at_stop[:200:5, axis] = True
    at_stop[200:, axis] = np.repeat(random.random(80) < 0.5, 5)
    at_stop[203::17, axis] = False
    lengths = runs(at_stop[:, axis])
    expected = DT * lengths[lengths >= STOP_RUN].sum()
    assert expected > 1.0 and (lengths < STOP_RUN).sum() > 40
    assert saturated_s(at_stop) == pytest.approx(expected)


def test_other_axes_that_touch_their_stops_change_nothing():
    random = np.random.default_rng(4)
    at_stop = np.zeros((900, 3), bool)
    at_stop[50::7, 0] = True  # one sample each
    at_stop[51::7, 2] = True
    at_stop[300:340, 1] = at_stop[600:610, 1] = True
    at_stop[random.integers(0, 50, 5), 1] = False
    assert saturated_s(at_stop) == pytest.approx(50 * DT)


def test_two_axes_at_their_stops_count_once():
    at_stop = np.zeros((300, 3), bool)
    at_stop[100:150, 0] = at_stop[100:150, 2] = True
    assert saturated_s(at_stop) == pytest.approx(50 * DT)


def test_of_nothing_there_are_no_epochs():
    assert len(EpochStage(MAX_GAP_NS, STOPS).finish()) == 0
    one = solution_of(DT, np.array([[1.0, 0.0, 0.0, 0.0]]), np.empty((0, 3)), np.empty((0, 3)))
    stage = EpochStage(MAX_GAP_NS, STOPS)
    stage.push(one)
    epochs = stage.finish()
    assert len(epochs) == 0 and len(epochs.time_ns) == 1


def uneven(stamps, seed=0):
    """Angle by which epochs of a gyro that swings are uncertain for their stamps, rad, RMS."""
    t = np.arange(0.0, 40.0, DT)
    gyro = np.stack([np.sin(7.0 * t), np.cos(5.0 * t), np.sin(3.0 * t)], axis=1)
    q = np.tile([1.0, 0.0, 0.0, 0.0], (len(t) + 1, 1))
    solution = solution_of(DT, q, gyro, np.zeros((len(gyro), 3)))
    stage = EpochStage(10 * MAX_GAP_NS, np.full(3, np.inf))
    rows = stamps(np.random.default_rng(seed), solution.time_ns)
    stage.push(replace(solution.rows(slice(0, len(rows))), time_ns=rows))
    values = stage.finish().values
    # what the stamps say the gyro turned, less what it did; a constant delay is no error
    off = np.diff(rows)[:, None] * 1e-9 * gyro[: len(rows) - 1] - DT * gyro[: len(rows) - 1]
    walk = np.cumsum(off, axis=0)
    return values[:, UNEVEN].sum(), walk


def test_an_even_clock_leaves_no_doubt():
    doubt, _ = uneven(lambda random, times: times)
    assert doubt < 1e-20
    # nor does one that runs fast
    doubt, _ = uneven(lambda random, times: times[0] + (times - times[0]) * 11 // 10)
    assert doubt < 1e-20


@pytest.mark.parametrize("how", ["jitter", "bursts"])
def test_stamps_of_receipt_are_doubted_by_what_they_spoil(how):
    def stamps(random, times):
        if how == "jitter":
            return times + np.round(2e6 * random.standard_normal(len(times))).astype(int)
        k = np.arange(len(times))
        return times[np.minimum(k // 4 * 4 + 3, len(k) - 1)] + k % 4 * 100_000

    drawn = [uneven(stamps, seed) for seed in range(20 if how == "jitter" else 1)]
    spread = np.mean([np.sum(walk[-1] ** 2) for _, walk in drawn])
    doubt = np.mean([one for one, _ in drawn])
    if how == "jitter":
        # what the stamps at the limits of an epoch are off counts in both, though it cancels
        assert spread < doubt < 6.0 * spread
    else:
        # the angle that is off goes round with the swing
        assert doubt > np.max(np.sum(drawn[0][1] ** 2, axis=1))
