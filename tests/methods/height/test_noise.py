"""Standard deviations of the network against Monte Carlo: a short run of the benchmark."""

import numpy as np
import pytest

from benchmarks import height_monte_carlo as monte_carlo


@pytest.mark.slow
@pytest.mark.parametrize(
    "source", ["baro_white", "baro_wander", "accel_white", "accel_bias_wander"]
)
@pytest.mark.parametrize(("tau", "k4"), [(2.4, 0.5), (10.0, 4.0), (30.0, 0.0), (100.0, 0.0)])
def test_sigmas(tau, k4, source):
    exact, closed = monte_carlo.sigma_ratios(tau, k4, source, trials=60, spans=60)
    assert exact == pytest.approx(np.ones(3), abs=0.05)
    # the closed forms leave 3 w2 tau^2 out
    assert closed[:2] == pytest.approx(np.ones(2), abs=0.06)


@pytest.mark.slow
def test_vertical_channel_with_the_papers_barometer():
    v, h, a = monte_carlo.channel_rms(2.4, 0.5, runs=4, duration=1500.0, rate=50.0)
    assert v == pytest.approx(0.335, rel=0.1)
    assert h == pytest.approx(0.427, rel=0.1)
    assert a == pytest.approx(0.0427, rel=0.1)
