from dataclasses import replace

import numpy as np
import pytest

from sinstool.core.errors import ConfigurationError
from sinstool.methods.hse.design import Design, predict, run_order
from sinstool.methods.hse.fit import fit
from sinstool.methods.hse.fit_result import FitOptions
from tests.helpers.hse_exact import slope_gain
from tests.methods.hse.made_runs import ARCSEC, RATES, W, brute_runs

ARW = np.radians(5e-4) / 60.0
PLAN = Design(tuple(RATES), 3, 600.0, (8e-4,), ARW, 0.49)


@pytest.mark.parametrize(
    ("rates", "repeats", "gain"),
    [
        ((20, 40, 60), 3, 1.170),
        ((20, 40, 60, -20, -40, -60), 3, 0.313),
        ((60, -60), 3, 0.390),
        ((60, -60), 9, 0.225),
        ((20, 30, 40, 50, 60), 2, 1.281),
        ((20, 60), 4, 1.013),
    ],
)
def test_gain_of_designs(rates, repeats, gain):
    turning = tuple(np.radians(rates))
    assert slope_gain(np.repeat(turning, repeats)) == pytest.approx(gain, abs=5e-4)
    result = predict(replace(PLAN, rates=turning, repeats=repeats))
    # all of these turn a third of a turn short of 600 s at most: their noise is alike
    assert result.sigma_K == pytest.approx(gain * np.mean(result.sigma_run), rel=4e-3)
    assert result.sigma_lambda2_heading == pytest.approx(
        3 * W * np.cos(0.49) / 8e-4 * result.sigma_K, rel=1e-6
    )


def test_figures_of_the_usual_design():
    result = predict(PLAN)
    # 19.0" at 600 s; 33 turns at 20 deg/s take 594 s
    assert result.sigma_run[0] / ARCSEC == pytest.approx(19.04 * np.sqrt(600 / 594), abs=0.01)
    assert result.sigma_lambda2_heading / ARCSEC == pytest.approx(5.37, rel=6e-3)
    assert (result.n_runs, result.total_s) == (9, 5400.0)
    assert result.sigma_lambda2_joint is None
    best = predict(replace(PLAN, C23=(8e-3,), rates=tuple(RATES) + tuple(-RATES)))
    assert best.sigma_lambda2_heading / ARCSEC == pytest.approx(0.144, abs=1e-3)


@pytest.mark.parametrize("leans", [(8e-4,), (8e-4, -8e-4), (3e-3, 1e-3, 2e-3)])
def test_what_is_predicted_is_what_the_fit_claims(leans):
    """The plan against the fit's own covariance, which simulations confirm elsewhere."""
    duration = 540.0  # whole turns at all three rates
    plan = replace(PLAN, C23=leans, duration_s=duration)
    result = predict(plan)
    runs = []
    for k, lean in enumerate(leans):
        more = brute_runs(psi=0.7 + k, lean=lean, first=9 * k)
        runs += [
            replace(
                r,
                sigma_heading=ARW / np.sqrt(duration) / (W * np.cos(0.49)),
                sigma_C23=0.0,
                sigma_c_axial=ARW / np.sqrt(duration) / (r.rate - W * np.sin(0.49)),
            )
            for r in more
        ]
    claimed = fit(runs, FitOptions(method="heading"))
    assert result.sigma_lambda2_heading == pytest.approx(claimed.sigma_lambda2, rel=1e-3)
    assert result.sigma_lambda2_axial == pytest.approx(claimed.axial.sigma_lambda2, rel=1e-3)
    if len(leans) == 1:
        assert result.sigma_K == pytest.approx(claimed.sigma_K, rel=1e-3)
    else:
        both = fit(runs)
        assert both.method == "joint"
        assert result.sigma_lambda2_joint == pytest.approx(both.sigma_lambda2, rel=1e-3)
        assert result.sigma_delay == pytest.approx(both.sigma_delay, rel=1e-3)


def test_advice_names_what_helps_and_by_how_much():
    text = "\n".join(predict(PLAN).advice)
    assert "both directions, 6 runs: 2.49 arcsec instead of 5.39 arcsec" in text
    assert "a lean of 0.008 rad: 0.539 arcsec instead of 5.39 arcsec" in text
    assert "turned by 180 deg" in text
    assert "if it is 10.8 arcsec or more" in text
    level = predict(replace(PLAN, C23=(1e-5,)))
    assert level.sigma_lambda2_heading is None
    assert "tilt the base" in level.advice[0]
    short = predict(replace(PLAN, duration_s=100.0))
    assert any("fewer than 10 turns" in a for a in short.advice)
    both = predict(replace(PLAN, rates=tuple(RATES) + tuple(-RATES), C23=(8e-3, -8e-3)))
    assert len(both.advice) == 2


def test_order_goes_up_and_down():
    order = run_order([0.6, 0.2, 0.4], 3)
    assert order == (0.2, 0.4, 0.6, 0.6, 0.4, 0.2, 0.2, 0.4, 0.6)
    order = np.array(run_order([0.2, 0.4, 0.6], 2))
    # a drift with time is not seen as a slope
    assert (order - order.mean()) @ np.arange(6) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"rates": ()}, "no rate"),
        ({"rates": (0.35, 0.36)}, "differ by less than 10 deg/s"),
        ({"rates": (0.35, 1e308)}, "a rate is beyond 10000 deg/s"),
        ({"repeats": 0}, "no repeats"),
        ({"repeats": 100_000_000}, "more than 1000 repeats"),
        ({"C23": (1e9,)}, "leans by more than 1 rad"),
        ({"angle_random_walk": 1e300}, "beyond 100 deg/sqrt"),
        ({"C23": ()}, "no position"),
        ({"angle_random_walk": 0.0}, "random walk"),
        ({"latitude": 1.5}, "85 deg"),
        ({"duration_s": 5.0}, "less than a whole turn"),
    ],
)
def test_impossible_designs_are_refused(change, words):
    with pytest.raises(ConfigurationError, match=words):
        predict(replace(PLAN, **change))
