from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from sinstool.core.errors import ConfigurationError
from sinstool.methods.hse.axial import earth_rate_along_axis, fit_axial
from sinstool.methods.hse.fit import fit
from sinstool.methods.hse.fit_result import FitOptions
from tests.methods.hse.made_runs import (
    ARCSEC,
    EPSILON,
    RATES,
    W,
    attitude,
    brute_run,
    brute_runs,
    noisy,
    spread,
)

HEADING = FitOptions(method="heading")
TRUE = -EPSILON.sum()


def two_positions(**more):
    return brute_runs(**more) + brute_runs(psi=0.7 + np.pi, lean=-8e-4, first=9, **more)


@pytest.mark.parametrize("latitude", [0.49, -0.6, 0.9])
@pytest.mark.parametrize(
    "options",
    [
        HEADING,
        FitOptions(method="heading", form="paper"),
        FitOptions(method="joint"),
        FitOptions(method="axial"),
        FitOptions(method="heading", weights="equal"),
    ],
    ids=lambda o: f"{o.method}-{o.form}-{o.weights}",
)
def test_without_noise_every_method_finds_the_error_of_the_matrix(latitude, options):
    runs = two_positions(latitude=latitude)
    result = fit(runs, options)
    # what the linear model leaves out is c Omega tilt / (2 w cos L), some 2e-5, and X33 to
    # second order
    assert result.lambda2 == pytest.approx(TRUE, rel=1e-4)
    assert result.axial.lambda2 == pytest.approx(TRUE, rel=1e-6)
    gain = result.C23 / (3.0 * W * np.cos(latitude))
    assert abs(result.C23) == pytest.approx(8e-4, rel=1e-3)
    assert pytest.approx(result.lambda2 * gain, rel=1e-9) == result.K


def test_slope_is_that_of_heading_against_rate():
    runs = brute_runs()
    result = fit(runs, HEADING)
    heading = np.array([r.heading for r in runs])
    slope = np.polyfit([r.rate for r in runs], heading, 1)[0]
    assert pytest.approx(slope, rel=1e-6) == result.K
    assert pytest.approx(-17.41, abs=0.01) == result.K / ARCSEC
    # free of heading-sensitive error, but not of its constant part (-d, and the tilt's share)
    d = -(EPSILON[0] - EPSILON[1] + EPSILON[2]) / (2.0 * np.sqrt(3.0))
    assert result.psi0[0] - 0.7 == pytest.approx(-d, abs=0.01 * ARCSEC)


def test_a_stale_encoder_fools_one_position_and_not_two():
    delay = 50e-6
    result = fit(two_positions(delay=delay))
    assert result.method == "joint"
    assert result.lambda2 == pytest.approx(TRUE, rel=1e-4)
    assert result.delay == pytest.approx(delay, rel=1e-4)
    assert result.axial.lambda2 == pytest.approx(TRUE, rel=1e-6)
    for lean, psi in ((8e-4, 0.7), (-8e-4, 0.7 + np.pi)):
        alone = fit(brute_runs(psi=psi, lean=lean, delay=delay), HEADING)
        shift = delay * 3.0 * W * np.cos(0.49) / lean
        assert alone.lambda2 == pytest.approx(TRUE + shift, rel=1e-3)


def test_joint_falls_back_and_says_so():
    alone = fit(brute_runs())
    assert (alone.method, alone.delay) == ("heading", None)
    assert any("one position" in w for w in alone.warnings)
    # the stand leans, not the system: turning it does not change the axis
    alike = fit(brute_runs() + brute_runs(psi=2.3, lean=8.2e-4, first=9))
    assert (alike.method, alike.delay) == ("heading", None)
    assert any("nearly the same" in w for w in alike.warnings)
    assert alike.lambda2 == pytest.approx(TRUE, rel=1e-4)
    assert len(alike.psi0) == 2


def test_the_papers_line_goes_through_unweighted_means():
    rng = np.random.default_rng(4)
    rates = np.repeat(RATES, [1, 2, 5])
    runs = noisy(spread(brute_runs(rates=rates), rng), rng)
    result = fit(runs, FitOptions(method="heading", form="paper", reject_outliers=False))
    means = [np.mean([r.heading for r in runs if r.rate == x]) for x in RATES]
    slope, at_zero = np.polyfit(RATES, means, 1)
    assert pytest.approx(slope, rel=1e-9) == result.K
    assert result.psi0[0] == pytest.approx(at_zero, abs=1e-12)
    assert result.lambda2 == pytest.approx(3 * W * np.cos(0.49) * slope / result.C23, rel=1e-9)
    assert result.dof == 5
    assert pytest.approx(fit(runs, HEADING).K, rel=0.01) != result.K


def test_headings_either_side_of_north_are_neighbours():
    rng = np.random.default_rng(5)
    runs = noisy(brute_runs(), rng)
    turned = [replace(r, heading=(r.heading - runs[0].heading) % (2 * np.pi)) for r in runs]
    assert max(r.heading for r in turned) - min(r.heading for r in turned) > 6.0
    assert fit(turned, HEADING).lambda2 == pytest.approx(fit(runs, HEADING).lambda2, abs=1e-13)


def test_order_of_the_runs_does_not_matter():
    rng = np.random.default_rng(6)
    runs = noisy(two_positions(), rng)
    one, other = fit(runs), fit(runs[::-1])
    assert other.lambda2 == pytest.approx(one.lambda2, rel=1e-9)
    assert other.delay == pytest.approx(one.delay, rel=1e-9)
    assert other.F_lof == pytest.approx(one.F_lof, rel=1e-6)


def test_the_papers_sigma_is_of_the_scatter_within_rates():
    """Three repeats of three rates: pooled variance, and the slope through the means."""
    runs = noisy(brute_runs(), np.random.default_rng(4))
    result = fit(runs, FitOptions(method="heading", form="paper", reject_outliers=False))
    heading, rate = np.array([[r.heading, r.rate] for r in runs]).T
    groups = [heading[rate == one] for one in RATES]
    pooled = np.mean([group.var(ddof=1) for group in groups])
    sigma = np.sqrt(pooled / 3.0 / np.sum((RATES - RATES.mean()) ** 2))
    assert result.sigma_K == pytest.approx(sigma, rel=1e-6)
    assert result.dof == 6
    assert np.polyfit(RATES, [g.mean() for g in groups], 1)[0] == pytest.approx(result.K, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["heading", "joint", "drift", "equal", "paper"])
def test_covariance_is_that_of_many_simulations(kind):
    """Formal deviations of estimates, with runs of unequal weight, against 400 noisy copies."""
    rng = np.random.default_rng(7)
    runs = spread(two_positions() if kind == "joint" else brute_runs(), rng)
    options = {
        "heading": HEADING,
        "joint": FitOptions(reject_outliers=False),
        "drift": FitOptions(method="heading", drift=True),
        "equal": FitOptions(method="heading", weights="equal"),
        "paper": FitOptions(method="heading", form="paper"),
    }[kind]
    options = replace(options, reject_outliers=False)
    if kind in ("equal", "paper"):
        runs = [replace(r, sigma_heading=19 * ARCSEC) for r in runs]
    fits = [fit(noisy(runs, rng), options) for _ in range(400)]
    values = np.array([[f.lambda2, f.K, f.delay or 0.0] for f in fits])
    if kind in ("equal", "paper"):
        formal = np.sqrt(np.mean([f.sigma_lambda2**2 for f in fits]))
    else:
        # without noise chi-squared is below its degrees and does not scale
        formal = fit(runs, options).sigma_lambda2
    assert values[:, 0].std() == pytest.approx(formal, rel=0.14)
    assert values[:, 0].mean() == pytest.approx(TRUE, abs=3.5 * formal / np.sqrt(400))
    if kind == "joint":
        formal_delay = fit(runs, options).sigma_delay
        assert values[:, 2].std() == pytest.approx(formal_delay, rel=0.14)
    held = np.mean([f.ci95_lambda2[0] <= TRUE <= f.ci95_lambda2[1] for f in fits])
    assert 0.92 < held < 0.985
    true_k = fit(runs, options).K
    held = np.mean([f.ci95_K[0] <= true_k <= f.ci95_K[1] for f in fits])
    assert 0.92 < held < 0.985


def test_sigmas_that_are_too_small_do_not_deceive():
    """Turns that scatter too little (drift from run to run): chi-squared tells, Birge scales."""
    rng = np.random.default_rng(8)
    runs = brute_runs()
    fits = [fit(noisy(runs, rng, 80 * ARCSEC), HEADING) for _ in range(400)]
    assert {f.distribution for f in fits} >= {"t"}
    held = np.mean([f.ci95_lambda2[0] <= TRUE <= f.ci95_lambda2[1] for f in fits])
    assert 0.92 < held < 0.98
    spread_of = np.std([f.lambda2 for f in fits])
    assert np.sqrt(np.mean([f.sigma_lambda2**2 for f in fits])) == pytest.approx(spread_of, rel=0.1)


def test_axial_sigma_and_bias():
    rng = np.random.default_rng(9)
    bias = 3e-8
    runs = [
        replace(r, c_axial=r.c_axial + bias / (r.rate - W * np.sin(0.49))) for r in brute_runs()
    ]
    clean = fit(runs, FitOptions(method="axial"))
    assert clean.lambda2 == pytest.approx(TRUE, rel=1e-5)
    assert clean.axial.bias == pytest.approx(bias, rel=1e-4)
    fits = [fit(noisy(runs, rng), FitOptions(method="axial")) for _ in range(400)]
    values = np.array([f.lambda2 for f in fits])
    assert values.std() == pytest.approx(clean.sigma_lambda2, rel=0.13)
    assert np.mean([f.ci95_lambda2[0] <= TRUE <= f.ci95_lambda2[1] for f in fits]) > 0.92
    assert np.std([f.axial.bias for f in fits]) == pytest.approx(clean.axial.sigma_bias, rel=0.13)


def test_axial_runs_count_by_the_scatter_of_their_turns():
    rng = np.random.default_rng(12)
    runs = [
        replace(r, sigma_c_axial=s * r.sigma_c_axial, c_axial=r.c_axial + s * r.sigma_c_axial * e)
        for r, s, e in zip(
            brute_runs(), rng.uniform(0.3, 20.0, 9), rng.standard_normal(9), strict=True
        )
    ]
    rate = np.array([r.rate + earth_rate_along_axis(r) for r in runs])
    error = rate * [r.c_axial for r in runs]
    weight = 1.0 / np.abs(rate * [r.sigma_c_axial for r in runs])
    slope, bias = np.polyfit(rate, error, 1, w=weight)
    found = fit_axial(runs, weighted=True)
    assert found.c == pytest.approx(slope, rel=1e-6)
    assert found.bias == pytest.approx(bias, rel=1e-6)
    slope, bias = np.polyfit(rate, error, 1)
    assert fit_axial(runs, weighted=False).c == pytest.approx(slope, rel=1e-6)


def warming(runs, rate_s=1e-10, decay_s=2000.0):
    """The same by gyros whose bias along the axis ends, and what the turns show of that."""
    out = []
    for run in runs:
        middle = run.t_start_s + 0.5 * run.duration_s
        slope = rate_s * np.exp(-middle / decay_s)
        bias = -slope * decay_s / (run.rate + earth_rate_along_axis(run))
        shown = {"axial_drift": slope, "axial_drift_sigma": rate_s / 30.0}
        out.append(replace(run, c_axial=run.c_axial + bias, quality=shown))
    return out


def test_a_bias_that_drifts_while_the_rates_rise_is_taken_off():
    """It was 13 sigma off, without a word."""
    runs = brute_runs(np.repeat(RATES, 2))
    clean, found = (
        fit_axial(noisy(each, np.random.default_rng(3)), True) for each in (runs, warming(runs))
    )
    assert clean.drift == 0.0
    assert found.drift == pytest.approx(1e-10 * 2000.0 * (np.exp(-0.15) - np.exp(-1.65)), rel=0.05)
    blind = [replace(run, quality={}) for run in noisy(warming(runs), np.random.default_rng(3))]
    missed, off = (abs(one.lambda2 - TRUE) for one in (fit_axial(blind, True), found))
    assert missed > 10.0 * clean.sigma_lambda2
    assert off < 0.5 * missed
    assert off < 2.0 * found.sigma_lambda2
    # less so where the next log takes the rates downwards
    half = len(runs) // 2
    both = [
        replace(run, source=f"{k // half}.mcap", t_start_s=600.0 * (k % half))
        for k, run in enumerate(brute_runs(np.concatenate([RATES, RATES[::-1]])))
    ]
    assert fit_axial(warming(both), True).sigma_lambda2 < 0.8 * found.sigma_lambda2


@pytest.mark.parametrize("form", ["regressor", "paper"])
def test_a_bias_that_drifts_turns_headings_as_well_and_is_in_their_sigma(form):
    """It was 5 sigma off: what drifts along the axis looks like lambda2 in headings too."""
    options = FitOptions(method="heading", form=form)
    runs = brute_runs(np.repeat(RATES, 2), lean=8e-3)

    def turned(run, bias):  # eq. (13): the east error of an axis that leans
        east = run.C23 * bias
        return replace(run, heading=run.heading - east / (W * np.cos(run.latitude)))

    warm = [
        replace(turned(after, (after.c_axial - before.c_axial) * after.rate), sigma_heading=ARCSEC)
        for before, after in zip(runs, warming(runs, 1e-9), strict=True)
    ]
    found = fit(noisy(warm, np.random.default_rng(3)), options)
    calm = fit(noisy([replace(run, quality={}) for run in warm], np.random.default_rng(3)), options)
    off = abs(found.lambda2 - TRUE)
    assert off > 3.0 * calm.sigma_lambda2
    assert off < 2.0 * found.sigma_lambda2
    assert found.sigma_K > 2.0 * calm.sigma_K


def test_slopes_of_noise_are_no_drift():
    rng = np.random.default_rng(7)
    for _ in range(50):
        slopes = [{"axial_drift": rng.normal(), "axial_drift_sigma": 1.0} for _ in range(9)]
        runs = [replace(r, quality=q) for r, q in zip(brute_runs(), slopes, strict=True)]
        assert fit_axial(runs, True).drift == 0.0


def test_one_rate_gives_the_axial_value_only():
    runs = brute_runs(rates=RATES[1] * np.ones(4))
    result = fit(runs)
    assert result.lambda2 is None and result.K is None and result.sigma_K is None
    assert result.axial.lambda2 == pytest.approx(TRUE, rel=1e-4)
    assert result.axial.bias is None


def test_rates_that_differ_by_a_tenth_show_the_bias_along_the_axis():
    bias = 3e-8
    for rates, seen in ((20.0, 24.0), True), ((20.0, 21.0), False):
        runs = brute_runs(rates=np.repeat(np.radians(rates), 2))
        runs = [replace(r, c_axial=r.c_axial + bias / (r.rate - W * np.sin(0.49))) for r in runs]
        found = fit_axial(runs, weighted=False)
        assert (found.bias is not None) == seen
        if seen:
            assert found.bias == pytest.approx(bias, rel=0.01)
            assert found.lambda2 == pytest.approx(TRUE, rel=1e-3)


def test_an_outlier_is_left_out_and_named():
    rng = np.random.default_rng(10)
    runs = noisy(brute_runs(rates=np.tile(RATES, 4)), rng)
    runs[4] = replace(runs[4], heading=runs[4].heading + 400 * ARCSEC)
    result = fit(runs, HEADING)
    assert [i for i, f in enumerate(result.run_fits) if not f.used] == [4]
    assert "outlier" in result.run_fits[4].reason
    assert result.run_fits[4].residual == pytest.approx(400 * ARCSEC, abs=80 * ARCSEC)
    assert any("r4" in w and "outlier" in w for w in result.warnings)
    clean = fit(runs[:4] + runs[5:], HEADING)
    assert result.lambda2 == pytest.approx(clean.lambda2, abs=1e-13)
    whole = fit(runs, replace(HEADING, reject_outliers=False))
    assert whole.n_used == 12
    assert abs(whole.run_fits[4].studentised) > 5


def test_two_repeats_are_never_made_one():
    rng = np.random.default_rng(11)
    runs = noisy(brute_runs(rates=np.tile(RATES, 2)), rng)
    runs[4] = replace(runs[4], heading=runs[4].heading + 4000 * ARCSEC)
    result = fit(runs, HEADING)
    assert result.n_used == 6
    assert not any("outlier" in w for w in result.warnings)


def test_sound_runs_are_seldom_left_out():
    rng = np.random.default_rng(12)
    runs = brute_runs()
    fits = [fit(noisy(runs, rng), HEADING) for _ in range(800)]
    rejected = sum(f.n_used < 9 for f in fits)
    # 1 % is the bound by Bonferroni, nearly reached by nine nearly independent residuals
    low, high = stats.binom.ppf([1e-4, 1 - 1e-4], 800, 0.0095)
    assert low <= rejected <= high


def test_lack_of_fit_is_seen_and_not_imagined():
    rng = np.random.default_rng(13)
    runs = brute_runs()
    p = [fit(noisy(runs, rng), replace(HEADING, reject_outliers=False)).p_lof for _ in range(400)]
    assert stats.kstest(p, "uniform").pvalue > 1e-3
    bent = [replace(r, heading=r.heading + 500 * ARCSEC * (r.rate - RATES[1]) ** 2) for r in runs]
    assert fit(noisy(bent, rng, 5 * ARCSEC), HEADING).p_lof < 1e-4


def test_drift_with_time_is_taken_out():
    drift = 30 * ARCSEC / 600.0
    runs = [
        replace(r, heading=r.heading + drift * r.t_start_s) for r in brute_runs(np.repeat(RATES, 3))
    ]
    assert fit(runs, HEADING).lambda2 != pytest.approx(TRUE, rel=1.0)
    result = fit(runs, FitOptions(method="heading", drift=True))
    assert result.lambda2 == pytest.approx(TRUE, rel=1e-4)
    assert result.parameters[-1] == "drift"


def test_drift_over_logs_needs_their_starts():
    drift = 30 * ARCSEC / 600.0
    options = FitOptions(method="heading", drift=True)
    runs = [
        replace(r, heading=r.heading + drift * r.t_start_s, source=f"{r.id}.mcap", t_start_s=0.0)
        for r in brute_runs(np.repeat(RATES, 3))
    ]
    with pytest.raises(ConfigurationError, match="starts are unknown"):
        fit(runs, options)
    epoch = 1_400_000_000_000_000_000
    dated = [replace(r, log_start_ns=epoch + 600 * 10**9 * i) for i, r in enumerate(runs)]
    assert fit(dated, options).lambda2 == pytest.approx(TRUE, rel=1e-4)
    skipped = fit(dated, replace(options, skip_warmup_s=1000.0))
    assert [f.used for f in skipped.run_fits] == [False, False] + [True] * 7
    assert skipped.run_fits[0].reason == "warm-up"


def test_runs_are_left_out_by_name_and_by_time():
    runs = brute_runs()
    result = fit(runs, replace(HEADING, exclude=("r2",), skip_warmup_s=500.0))
    assert [f.reason for f in result.run_fits[:3]] == ["warm-up", "", "excluded"]
    assert result.n_used == 7
    assert result.lambda2 == pytest.approx(TRUE, rel=1e-4)
    with pytest.raises(ConfigurationError, match="no run is called 'x'"):
        fit(runs, replace(HEADING, exclude=("x",)))
    with pytest.raises(ConfigurationError, match="every run is left out"):
        fit(runs, replace(HEADING, skip_warmup_s=1e6))
    with pytest.raises(ConfigurationError, match="two runs are called 'r0'"):
        fit([*runs, runs[0]])
    with pytest.raises(ConfigurationError, match="no run"):
        fit([])
    with pytest.raises(ConfigurationError, match="method 'best' is unknown: give one of joint"):
        FitOptions(method="best")


def test_a_run_that_warms_up_is_named():
    rng = np.random.default_rng(14)
    turns = 0.7 + 100 * ARCSEC * rng.standard_normal(33)
    runs = [replace(r, per_turn_heading=turns) for r in brute_runs()]
    assert not any("drifts" in w for w in fit(runs, HEADING).warnings)
    runs[3] = replace(runs[3], per_turn_heading=turns + np.linspace(0, 600, 33) * ARCSEC)
    warnings = [w for w in fit(runs, HEADING).warnings if "drifts" in w]
    assert len(warnings) == 1 and "r3" in warnings[0]


def test_without_the_scatter_of_turns_all_runs_weigh_the_same():
    rng = np.random.default_rng(15)
    runs = noisy(brute_runs(), rng)
    runs[1] = replace(runs[1], sigma_heading=np.nan)
    result = fit(runs, HEADING)
    assert any("get the same weight" in w for w in result.warnings)
    assert result.distribution == "t"
    equal = fit(runs, FitOptions(method="heading", weights="equal"))
    assert result.lambda2 == equal.lambda2


@pytest.mark.parametrize("weights", ["turns", "equal"])
def test_two_runs_have_the_scatter_of_their_turns(weights):
    runs = brute_runs(rates=RATES[[0, 2]])
    result = fit(runs, FitOptions(method="heading", weights=weights))
    assert (result.dof, result.distribution) == (0, "turns")
    sigma_k = 19 * ARCSEC * np.sqrt(2.0) / (RATES[2] - RATES[0])
    assert result.sigma_K == pytest.approx(sigma_k, rel=1e-3)
    bare = [replace(r, sigma_heading=np.nan) for r in runs]
    result = fit(bare, FitOptions(method="heading", weights=weights))
    assert (result.sigma_K, result.ci95_K, result.distribution) == (None, None, "")
    assert result.lambda2 == pytest.approx(TRUE, rel=1e-3)


def test_a_level_axis_leaves_the_slope():
    runs = brute_runs(lean=2e-5, delay=50e-6)
    result = fit(runs, HEADING)
    assert not result.observable
    assert result.lambda2 is None
    assert result.parameters == ("psi0[0]", "K")
    assert pytest.approx(50e-6, rel=0.1) == result.K
    assert result.sigma_K is not None


def test_uncertain_lean_is_in_the_sigma():
    runs = [replace(r, sigma_C23=1e-4, sigma_heading=1 * ARCSEC) for r in brute_runs()]
    sure = fit([replace(r, sigma_C23=0.0) for r in runs], HEADING).sigma_lambda2
    expected = np.hypot(sure, abs(TRUE) * 1e-4 / 8e-4)
    assert fit(runs, HEADING).sigma_lambda2 == pytest.approx(expected, rel=1e-3)
    assert fit(runs, HEADING).sigma_K == pytest.approx(
        sure * 8e-4 / (3 * W * np.cos(0.49)), rel=1e-3
    )


def test_the_model_to_the_last_digit():
    """Headings by eq. (14) with leans that vary: every parameter comes back."""
    runs, lambda2, psi0 = [], 1e-3, 1.0
    for i, r in enumerate(brute_runs()):
        lean = 8e-4 * (1.0 + 0.01 * i)
        hse = (r.rate - W * np.sin(0.49)) * lambda2 * lean / (3.0 * W * np.cos(0.49))
        runs.append(replace(r, heading=psi0 + hse, C23=lean))
    result = fit(runs, HEADING)
    assert result.lambda2 == pytest.approx(lambda2, rel=1e-9)
    assert result.psi0[0] == pytest.approx(psi0, abs=1e-10)


def test_figures_of_a_straight_line():
    rng = np.random.default_rng(16)
    runs = noisy(brute_runs(), rng)
    result = fit(runs, FitOptions(method="heading", weights="equal", reject_outliers=False))
    line = stats.linregress([r.rate for r in runs], [r.heading for r in runs])
    assert result.r2 == pytest.approx(line.rvalue**2, rel=1e-5)
    assert result.sigma_K == pytest.approx(line.stderr, rel=1e-5)
    residual = np.array([f.residual for f in result.run_fits])
    assert result.s == pytest.approx(np.sqrt(np.sum(residual**2) / 7))
    assert result.ci95_K[1] - result.K == pytest.approx(
        stats.t.ppf(0.975, 7) * line.stderr, rel=1e-5
    )


def test_uncertain_leans_of_two_positions():
    runs = [replace(r, sigma_heading=0.1 * ARCSEC) for r in two_positions()]
    sure = fit([replace(r, sigma_C23=0.0) for r in runs]).sigma_lambda2
    result = fit([replace(r, sigma_C23=1e-5) for r in runs])
    assert result.method == "joint"
    share = np.sqrt(2.0) * 1e-5 / 1.6e-3
    assert result.sigma_lambda2 == pytest.approx(np.hypot(sure, TRUE * share), rel=1e-3)


def test_the_papers_line_is_for_the_position_that_leans_most():
    runs = brute_runs(lean=4e-4) + brute_runs(psi=2.0, lean=-8e-4, first=9)
    result = fit(runs, FitOptions(method="heading", form="paper"))
    assert [f.reason for f in result.run_fits] == ["another position"] * 9 + [""] * 9
    assert pytest.approx(-8e-4, rel=1e-3) == result.C23
    assert result.lambda2 == pytest.approx(TRUE, rel=1e-4)


def test_earth_rate_along_a_tilted_axis():
    run = brute_run(0.7, 2.0, 0.2, -0.3, latitude=-0.6)
    w_n = W * np.array([np.cos(-0.6), 0.0, -np.sin(-0.6)])
    tilted = replace(run, heading=2.0)
    assert earth_rate_along_axis(tilted) == pytest.approx(w_n @ attitude(2.0, 0.2, -0.3)[:, 2])
