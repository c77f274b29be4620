from dataclasses import replace

import numpy as np
import pytest

from sinstool.core.finding import Finding, Severity, exit_status
from sinstool.methods.hse.fit import fit
from sinstool.methods.hse.fit_result import FitOptions
from sinstool.methods.hse.status import (
    APPLICABLE,
    STATUSES,
    implied_delay,
    judge,
    judgement,
    second_order,
)
from tests.methods.hse.made_runs import ARCSEC, RATES, W, brute_run, brute_runs, noisy

HEADING = FitOptions(method="heading")
BOTH = np.concatenate([RATES, -RATES])


def judged(runs, options=HEADING):
    return judge(fit(runs, options))


def outcome(result):
    """Status, exit status of the command, whether the coefficient may be applied."""
    return result.status, exit_status(result.findings), result.status in APPLICABLE


def sharp(runs, sigma=0.5 * ARCSEC):
    """Runs that scatter little, so that what is there is significant."""
    return [replace(r, sigma_heading=sigma) for r in runs]


def test_a_good_calibration_is_ok():
    result = judged(sharp(brute_runs()))
    assert outcome(result) == ("ok", 0, True)
    assert result.findings == ()
    assert result.warnings == ()


def test_scatter_as_in_the_paper_is_not_significant():
    """Yu et al. 2013: 17.4 "/(rad/s) of which a single run's 9.5" leave 11."""
    runs = [replace(r, sigma_heading=9.5 * ARCSEC) for r in brute_runs()]
    result = fit(runs, HEADING)
    assert result.sigma_K / ARCSEC == pytest.approx(11.1, abs=0.1)
    actual = judge(result)
    assert outcome(actual) == ("not_significant", 3, False)
    assert "--force" in actual.warnings[0]
    assert "-4.200 +- 2.6" in actual.warnings[0] and "95 % interval" in actual.warnings[0]
    assert '"' not in actual.warnings[0]
    # just above two sigma it stands out
    limit = 9.5 * abs(result.K) / result.sigma_K / 2.0
    assert judged(sharp(runs, 0.99 * limit * ARCSEC)).status == "ok"
    assert judged(sharp(runs, 1.01 * limit * ARCSEC)).status == "not_significant"


def test_one_rate_is_an_error():
    runs = brute_runs(rates=np.array([0.5, 0.5, 0.5003]))
    result = judged(runs)
    assert (result.status, exit_status(result.findings)) == ("error", 3)
    assert "28.65" in result.warnings[0] and "10 deg/s apart" in result.warnings[0]
    # 5 deg/s apart is too little, 10 is enough
    assert judged(brute_runs(rates=np.radians([40.0, 45.0, 40.0, 45.0]))).status == "error"
    near = judged(sharp(brute_runs(rates=np.radians([40.0, 50.01, 40.0, 50.01])), 0.01 * ARCSEC))
    assert near.status == "ok"
    axial = judged(runs, FitOptions(method="axial"))
    assert axial.status == "ok"
    assert "not the axial value" in axial.warnings[0]


def test_near_the_pole_is_an_error_and_high_latitude_a_remark():
    result = judged(sharp(brute_runs(latitude=np.radians(85.5))))
    assert (result.status, exit_status(result.findings)) == ("error", 3)
    assert "rate along the axis" in result.warnings[0]
    high = judged(sharp(brute_runs(latitude=np.radians(-80.0)), 0.1 * ARCSEC))
    assert high.status == "ok"
    assert "5.8 times" in high.warnings[0]
    assert judged(sharp(brute_runs(latitude=np.radians(74.0)), 0.1 * ARCSEC)).warnings == ()


def test_a_level_axis_is_unobservable():
    result = judged(sharp(brute_runs(lean=5e-5)))
    assert outcome(result) == ("unobservable", 3, False)
    message = result.warnings[0]
    assert "5e-3 rad" in message and "slope" in message and "-4.2" in message
    blurred = [replace(r, sigma_C23=2e-4) for r in sharp(brute_runs())]
    assert judged(blurred).status == "unobservable"
    axial = judged(sharp(brute_runs(lean=5e-5)), FitOptions(method="axial"))
    assert axial.status in APPLICABLE


def test_a_drift_of_the_rate_along_the_axis_is_told():
    slopes = {"axial_drift": 1e-10, "axial_drift_sigma": 1e-12}
    runs = [replace(run, quality=slopes) for run in sharp(brute_runs())]
    assert any("along the axis drifts" in line for line in judged(runs).warnings)


def test_a_stale_encoder_is_told_from_the_axial_value():
    delay = 84e-6
    runs = sharp(brute_runs(delay=delay), 2.0 * ARCSEC)
    result = fit(runs, HEADING)
    actual = judge(result)
    assert outcome(actual) == ("inconsistent_axial", 3, False)
    assert implied_delay(result) == pytest.approx(delay, rel=1e-3)
    assert "84.0 us" in actual.warnings[0]
    # with two positions it is estimated, and lambda2 may be used
    more = sharp(brute_runs(psi=0.7 + np.pi, lean=-8e-4, first=9, delay=delay), 2.0 * ARCSEC)
    joint = fit(runs + more)
    actual = judge(joint)
    assert actual.status == "ok" and actual.status in APPLICABLE
    assert implied_delay(joint) is None
    assert any("stale by 84.0" in w for w in actual.warnings)
    # the axial value is free of delays
    assert judge(fit(runs, FitOptions(method="axial"))).status in APPLICABLE


def test_consistency_is_three_sigmas_of_both():
    runs = sharp(brute_runs(delay=84e-6), 2.0 * ARCSEC)
    z = fit(runs, HEADING).z_consistency
    for share, status in ((0.99, "inconsistent_axial"), (1.01, "ok")):
        sigma = 2.0 * abs(z) / 3.0 * share * ARCSEC
        blurred = judged(sharp(runs, sigma))
        assert (blurred.status == "inconsistent_axial") == (status == "inconsistent_axial")


def test_a_bend_is_nonlinear_and_may_be_applied():
    rng = np.random.default_rng(1)
    bent = [
        replace(r, heading=r.heading + 40 * ARCSEC * (r.rate - RATES[1]) ** 2)
        for r in sharp(brute_runs())
    ]
    result = judged(noisy(bent, rng, 0.3 * ARCSEC))
    assert (result.status, result.status in APPLICABLE) == ("nonlinear", True)
    assert "lack of fit" in result.warnings[0]


@pytest.mark.parametrize(
    ("lambda2", "tilt", "expected"),
    [(1e-4, 1e-2, 2.7e-3), (1e-3, 1e-2, 2.7e-2), (1e-4, 5e-2, 1.4e-2)],
)
def test_second_order_of_the_model(lambda2, tilt, expected):
    """The bound against what the linear model leaves out at 60 deg/s, by brute force."""
    epsilon = np.array([lambda2, 0.0, 0.0])
    runs = sharp(brute_runs(rates=RATES[[0, 2]], lean=tilt, epsilon=epsilon))
    result = fit(runs, HEADING)
    assert second_order(result) == pytest.approx(expected, rel=0.05)
    assert (judge(result).status == "nonlinear") == (expected > 1e-2)
    # the worst azimuth errs by this much of the error at 60 deg/s
    worst = 0.0
    for psi in np.arange(0.0, 2.0 * np.pi, np.pi / 8.0):
        run = brute_run(RATES[2], psi, tilt, 0.0, epsilon=epsilon)
        lean = tilt * np.sin(psi)
        linear = -(RATES[2] - 1.5 * W * np.sin(0.49)) * lambda2 * lean / (3.0 * W * np.cos(0.49))
        d = -lambda2 / (2.0 * np.sqrt(3.0))
        linear -= d * (1.0 + tilt * np.cos(psi) * np.tan(0.49))
        error = (run.heading - psi - linear + np.pi) % (2.0 * np.pi) - np.pi
        worst = max(worst, abs(error))
    largest = RATES[2] * lambda2 * tilt / (3.0 * W * np.cos(0.49))
    assert worst / largest == pytest.approx(expected, rel=0.25)


def test_a_base_that_moves_is_remarked():
    runs = [replace(r, C23=r.C23 * (1.0 + 0.01 * i)) for i, r in enumerate(sharp(brute_runs()))]
    result = judged(runs)
    assert any("varies by 8 %" in w for w in result.warnings)
    assert not any("varies" in w for w in judged(sharp(brute_runs())).warnings)


def test_noise_of_the_leans_is_no_moving_base():
    random = np.random.default_rng(3)
    noise = 5e-5 * random.standard_normal(9)
    runs = [
        replace(r, C23=r.C23 + e, sigma_C23=5e-5)
        for r, e in zip(sharp(brute_runs(lean=1.6e-3)), noise, strict=True)
    ]
    result = fit(runs, HEADING)
    assert result.C23_spread > 0.05 and result.observable
    assert not any("the base moves" in w for w in judge(result).warnings)
    known = fit([replace(r, sigma_C23=5e-6) for r in runs], HEADING)
    assert any("the base moves" in w for w in judge(known).warnings)


def test_runs_that_do_not_belong_together_are_remarked():
    """Logs of two sites with the latitude of one, say: each run is good, they do not agree."""
    runs = sharp(brute_runs(), 2.0 * ARCSEC)
    mixed = [
        replace(r, heading=r.heading + (-1.0) ** k * 20.0 * ARCSEC) for k, r in enumerate(runs)
    ]  # fmt: skip
    found = [w for w in judged(mixed).warnings if "times as much as their own turns" in w]
    assert len(found) == 1 and "one rig at one site" in found[0]
    slightly = [
        replace(r, heading=r.heading + (-1.0) ** k * 3.0 * ARCSEC) for k, r in enumerate(runs)
    ]
    assert not any("their own turns" in w for w in judged(slightly).warnings)


def test_few_runs():
    two = judged(sharp(brute_runs(rates=RATES[[0, 2]])))
    assert any("scatter of turns alone" in w for w in two.warnings)
    assert two.status == "ok"
    bare = judged([replace(r, sigma_heading=np.nan) for r in brute_runs(rates=RATES[[0, 2]])])
    assert bare.status == "not_significant"
    assert "too few runs to show their scatter" in bare.warnings[0]


def test_runs_that_do_not_determine_the_drift():
    runs = brute_runs(rates=RATES[[0, 2]])
    result = judged(runs, replace(HEADING, drift=True))
    assert (result.status, exit_status(result.findings)) == ("error", 3)


def test_gravest_first_and_exit_codes():
    some = [
        Finding("remark", "a"),
        Finding("nonlinear", "b"),
        Finding("unobservable", "c", Severity.LOST),
    ]
    result = judgement(some)
    assert [f.kind for f in result.findings] == ["unobservable", "nonlinear", "remark"]
    assert (result.status, exit_status(result.findings)) == ("unobservable", 3)
    assert STATUSES[0] == "error" and STATUSES[-1] == "ok"


def test_warnings_of_the_fit_are_kept():
    result = judge(fit(sharp(brute_runs())))
    assert result.status == "ok"
    assert any("one position" in w for w in result.warnings)


def test_constants_are_the_earths():
    result = fit(brute_runs(delay=84e-6), HEADING)
    gain = result.C23 / (3 * W * np.cos(0.49))
    assert implied_delay(result) == pytest.approx(result.K - result.axial.lambda2 * gain, rel=1e-6)
