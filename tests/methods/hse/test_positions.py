from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from sinstool.methods.hse.run import by_angle, positions, rate_groups
from tests.methods.hse.made_runs import RATES, brute_run, brute_runs


@given(
    st.integers(2, 8),
    st.floats(0.0, 2.0 * np.pi),
    st.integers(0, 10**6),
)
def test_azimuths_part_whatever_lies_at_north(n, turn, seed):
    rng = np.random.default_rng(seed)
    true = rng.integers(0, n, 25)
    true[:n] = np.arange(n)
    angle = (turn + 2.0 * np.pi * true / n + rng.uniform(-3e-3, 3e-3, 25)) % (2.0 * np.pi)
    result = by_angle(angle)
    for k in range(n):
        assert len(set(result[true == k])) == 1
    assert len(set(result)) == n


def test_one_azimuth_at_north():
    assert set(by_angle(np.array([0.001, 2.0 * np.pi - 0.001, 0.0]))) == {0}
    assert list(by_angle(np.array([1.0]))) == [0]


def test_positions_are_numbered_as_they_come_and_part_by_tilt():
    run = brute_run(0.7, 3.0, 0.0, 1e-3)
    leans = [1e-3, 1.03e-3, -2e-3, 1e-3]
    headings = [3.0, 3.0001, 3.0, 1.0]
    runs = [replace(run, C23=c, heading=h) for c, h in zip(leans, headings, strict=True)]
    assert list(positions(runs)) == [0, 0, 1, 2]
    assert list(positions([replace(r, sigma_C23=1e-3) for r in runs])) == [0, 0, 0, 1]
    assert list(positions([replace(r, sigma_C23=np.nan) for r in runs])) == [0, 0, 1, 2]
    assert len(positions([])) == 0


def test_a_large_error_is_no_new_position():
    """Headings at 20 and 60 deg/s 2 deg apart by an error of 1e-3 and a lean of 1e-2."""
    epsilon = np.array([1e-3, 0.0, 0.0])
    runs = brute_runs(rates=RATES[[0, 2]], lean=1e-2, epsilon=epsilon)
    assert np.degrees(abs(runs[1].heading - runs[0].heading)) > 2.0
    assert list(positions(runs)) == [0, 0]


def test_rates_part_by_one_percent_and_direction():
    rates = np.array([0.35, -0.35, 0.3502, 0.36, -0.3501, 0.7, 1.047, 1.05])
    result = rate_groups(rates)
    assert list(result) == [1, 0, 1, 2, 0, 3, 4, 4]
    assert len(rate_groups(np.array([]))) == 0
