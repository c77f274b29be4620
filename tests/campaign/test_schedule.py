"""The simulated schedule of many logs on many workers."""

from dataclasses import replace

import pytest

from benchmarks.schedule import Farm, lengths, simulate

SMALL = Farm(logs=300, workers=20, store=1e9)


@pytest.mark.parametrize("seed", range(4))
def test_largest_first_is_as_near_the_best_as_graham_proved(seed):
    # at most 4/3 - 1/(3 m) of the best schedule, and each start and dispatch
    farm = replace(SMALL, seed=seed)
    report = simulate(farm)
    more = farm.start + farm.logs * farm.dispatch
    assert report.bound <= report.makespan <= 4.0 / 3.0 * report.bound + more
    assert report.makespan <= simulate(replace(farm, order="smallest")).makespan
    assert (report.done, report.given_up, report.deaths) == (300, 0, 0)


def test_one_worker_does_one_log_after_the_other():
    farm = replace(SMALL, logs=30, workers=1, dispatch=0.5)
    each = farm.compute + farm.moved_mb / farm.link
    assert simulate(farm).makespan == pytest.approx(3.0 + 15.0 + each * sum(lengths(farm)))


def test_a_slow_store_is_all_that_counts():
    farm = replace(SMALL, store=20.0)
    expected = sum(lengths(farm)) * farm.moved_mb / 20.0
    assert simulate(farm).makespan == pytest.approx(expected, rel=0.05)


def test_no_log_is_lost_with_its_worker():
    farm = replace(SMALL, life=0.02)
    report = simulate(farm)
    assert report.deaths > 10
    assert report.lost > 0.0
    assert report.done + report.given_up == 300
    # those that always kill are given up, the others done
    report = simulate(replace(SMALL, deadly=0.05))
    assert report.given_up > 5
    assert report.deaths == SMALL.attempts * report.given_up
    assert report.done == 300 - report.given_up
