"""Figures of a calibration: what they show is what was found."""

import dataclasses

import numpy as np
import pytest
from scipy import stats

from sinstool.cli.options import effective_config
from sinstool.pipelines.calibrate_hse.run import calibrate
from sinstool.report.figures.hse import figures, heading_against_rate
from sinstool.report.figures.hse_turns import allan_deviation
from tests.helpers.hse_rigs import ARCSEC, edited, simulate

W = 7.292115e-5


def calibrated_in(folder, logs, rig, **options):
    rig = edited(rig, "rules", calibration={"min_turns": 4, "min_duration": 15.0})
    flags = {f"calibration__{k}": v for k, v in options.items()}
    return calibrate(logs, None, effective_config(rig, flags))


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("figures")
    settings = {
        "rates": "120,60,-60", "plateau": 34, "rate": 40, "encoder_rate": 20, "epsilon": "11,4,6",
        "arw": 1e-4, "vrw": 5, "latitude": -35,
    }  # fmt: skip
    (a, rig), (b, _), (c, _) = (
        simulate(folder, name, heading=h, tilt_east=e, seed=h, **settings)
        for name, h, e in (("a", 30, 4e-3), ("b", 210, -4e-3), ("c", 120, 1e-3))
    )
    return folder, (a, b, c), rig


@pytest.fixture(scope="module")
def calibration(logs):
    folder, paths, rig = logs
    return calibrated_in(folder, paths, rig, azimuth=("a=30", "b=210", "c=120"), exclude=("c#2",))


@pytest.fixture(scope="module")
def drawn(calibration):
    return {one.key: one for one in figures(calibration)}


def series(figure, name):
    (one,) = [s for s in figure.series if s.name.startswith(name)]
    x = np.asarray(figure.x if one.x is None else one.x)
    return x, one.y


def test_all_are_there_and_have_units(drawn, calibration):
    assert list(drawn) == [
        "heading", "residuals", "studentised", "azimuth", "axial", "turns", "rates", "allan",
    ]  # fmt: skip
    for one in drawn.values():
        assert ", " in one.ylabel
        assert ", " in one.xlabel or one.key == "studentised"


def in_use(figure):
    """Runs of all positions, one position after the other."""
    parts = [(s.x, s.y) for s in figure.series if s.name.startswith("runs, ")]
    return np.concatenate([x for x, _ in parts]), np.concatenate([y for _, y in parts])


def test_fit_and_runs_part_by_the_residuals(drawn, calibration):
    figure = drawn["heading"]
    rate, heading = in_use(figure)
    used = [k for k, one in enumerate(calibration.fit.run_fits) if one.used]
    assert len(rate) == len(used) == 8
    used.sort(key=lambda k: calibration.fit.run_fits[k].position)
    for k, x, y in zip(used, rate, heading, strict=True):
        run, one = calibration.runs[k], calibration.fit.run_fits[k]
        assert x == pytest.approx(np.degrees(run.rate))
        psi0 = calibration.fit.psi0[one.position]
        assert y == pytest.approx(((run.heading - psi0 + 1.0) % (2 * np.pi) - 1.0) / ARCSEC)
        line = series(figure, f"fit, base at {np.degrees(psi0):.2f} deg")
        fitted = np.interp(x, *line)
        # lines have the mean lean of their position, residuals that of their run
        assert y - fitted == pytest.approx(one.residual / ARCSEC, abs=1.0)
    left_out, _ = series(figure, "runs left out")
    assert left_out == pytest.approx([np.degrees(calibration.runs[7].rate)])
    # and each position has the colour of its line
    colours = {s.name.partition("base")[2]: s.colour for s in figure.series if "fit" in s.name}
    runs = [s for s in figure.series if s.name.startswith("runs, ")]
    assert len(runs) == len(colours) == 3
    assert all(s.colour == colours[s.name.partition("base")[2]] for s in runs)
    x, y = in_use(drawn["residuals"])
    np.testing.assert_allclose(y, [calibration.fit.run_fits[k].residual / ARCSEC for k in used])


def test_band_is_that_of_a_fit_by_the_textbook(drawn, calibration):
    """Weighted least squares by numpy, on columns written out again."""
    result = calibration.fit
    keep = [k for k, one in enumerate(result.run_fits) if one.used]
    latitude = np.radians(-35.0)
    runs = [calibration.runs[k] for k in keep]
    position = np.array([result.run_fits[k].position for k in keep])
    rate = np.array([r.rate for r in runs])
    lean = np.array([r.C23 for r in runs])

    def row(rate, lean, position):
        x = (rate - W * np.sin(latitude)) * lean / (3.0 * W * np.cos(latitude))
        return np.concatenate([np.eye(3)[position], [x, rate]])

    H = np.array([row(*v) for v in zip(rate, lean, position, strict=True)])
    weight = np.array([r.sigma_heading**-2.0 for r in runs])
    P = np.linalg.inv(H.T @ (weight[:, None] * H)) * max(1.0, result.chi2 / result.dof)
    mean_lean = {k: lean[position == k].mean() for k in range(3)}
    lead = max(mean_lean, key=lambda k: abs(mean_lean[k]))
    x, y = series(drawn["heading"], "95 % band")
    half = (len(x) - 1) // 2
    assert np.isnan(y[half])
    width = 0.5 * (y[half + 1 :] - y[:half])
    for at in (0, half // 3, half - 1):
        h = row(np.radians(x[at]), mean_lean[lead], lead)
        sigma = np.sqrt(h @ P @ h) / ARCSEC
        quantile = stats.t.ppf(0.975, 3) if result.distribution == "t" else 1.959964
        assert width[at] == pytest.approx(quantile * sigma, rel=1e-4)


def test_axial_line(drawn, calibration):
    x, y = series(drawn["axial"], "fit")
    slope = np.polyfit(np.radians(x), y * ARCSEC, 1)[0]
    assert -3.0 * slope == pytest.approx(calibration.fit.axial.lambda2)
    x, y = series(drawn["axial"], "runs in use")
    np.testing.assert_allclose(y * ARCSEC / np.radians(x), 7.0 * ARCSEC, atol=0.02 * ARCSEC)


def test_azimuth_before_and_after(drawn):
    figure = drawn["azimuth"]
    _, before = series(figure, "before")
    x, after = series(figure, "after")
    assert np.ptp(before) > 10.0 * np.ptp(after)
    assert set(np.round(x)) == {30.0, 120.0, 210.0}
    # the axis leans as the base is turned: least where the slope of heading is least
    grid, wave = series(figure, "sinusoid, before")
    assert len(grid) == len(wave)


def test_positions_without_azimuths(logs):
    folder, paths, rig = logs
    calibration = calibrated_in(folder, paths, rig)
    figure = {one.key: one for one in figures(calibration)}["azimuth"]
    assert "No azimuths were given" in figure.notes[0]
    x, after = series(figure, "after")
    for heading in np.unique(x):
        assert np.mean(after[x == heading]) == pytest.approx(0.0, abs=1e-6)
    assert [s.name for s in figure.series] == ["before", "after"]


def test_rates_show_what_was_used(drawn, calibration):
    figure = drawn["rates"]
    assert [name for name, _ in figure.marks] == ["a", "b", "c"]
    _, used = series(figure, "used")
    shown = used[np.isfinite(used)]
    assert np.abs(np.abs(np.round(shown)) - 90.0) == pytest.approx(30.0)
    time, _ = series(figure, "table")
    length = sum(log.segmentation.block_time_s[-1] for log in calibration.logs) / 60.0
    assert np.nanmax(time) == pytest.approx(length)
    _, rejected = series(figure, "not used")
    assert np.nanmin(rejected) < 0.0 < np.nanmax(rejected)


def test_turns_are_about_their_run(drawn, calibration):
    figure = drawn["turns"]
    assert [s.name for s in figure.series] == ["-60.0 deg/s", "+60.0 deg/s", "+120.0 deg/s"]
    _, y = series(figure, "+120")
    assert np.count_nonzero(np.isfinite(y)) == sum(
        r.n_turns for r in calibration.runs if r.rate > 2.0
    )
    assert abs(np.nanmean(y)) < 1.0


def test_random_walk_of_the_simulated_gyros(drawn):
    name = drawn["allan"].series[-1].name
    walk = float(name.split(", ")[1].split()[0])
    # tens of turns in all: no better than this
    assert walk == pytest.approx(1e-4, rel=0.4)


def test_allan_deviation_of_white_noise_and_of_a_ramp():
    x = np.random.default_rng(3).standard_normal(200_000)
    m, variance = allan_deviation(x)
    np.testing.assert_array_equal(m[:10], 2.0 ** np.arange(10))
    np.testing.assert_allclose(variance[:9] * m[:9], 1.0, rtol=0.1)
    # a rate that grows by r an interval: deviation r m / sqrt(2)
    m, variance = allan_deviation(0.25 * np.arange(100))
    np.testing.assert_allclose(np.sqrt(variance), 0.25 * m / np.sqrt(2.0), rtol=1e-9)
    # by the definition: half the mean square difference of neighbours
    x = np.array([1.0, 4.0, 2.0, -1.0, 0.5, 3.0])
    assert allan_deviation(x)[1][0] == pytest.approx(0.5 * np.mean(np.diff(x) ** 2))
    assert [len(c) for c in allan_deviation([1.0])] == [0, 0]


@pytest.mark.parametrize("method", [("heading", "paper"), ("axial", "regressor")])
def test_other_methods_have_their_line(logs, method):
    folder, paths, rig = logs
    calibration = calibrated_in(folder, paths[:1], rig, method=method[0], form=method[1])
    figure = heading_against_rate(calibration.fit)
    x, y = series(figure, "fit")
    slope = np.polyfit(np.radians(x), y * ARCSEC, 1)[0]
    if method[0] == "heading":
        assert slope == pytest.approx(calibration.fit.K)
        rate, heading = in_use(figure)
        # the published line goes through the means at each rate
        by_hand = np.polyfit(rate, heading, 1)
        np.testing.assert_allclose(np.polyval(by_hand, x), y, atol=1e-6)
    x, y = series(figure, "slope by the axial rate")
    expected = (
        calibration.fit.axial.lambda2 * calibration.fit.C23 / (3.0 * W * np.cos(np.radians(35.0)))
    )
    assert np.polyfit(np.radians(x), y * ARCSEC, 1)[0] == pytest.approx(expected, rel=1e-4)


def test_without_a_slope_only_runs_are_shown(logs):
    folder, paths, rig = logs
    calibration = calibrated_in(folder, paths[:1], rig, exclude=("a#1", "a#3"))
    keys = [one.key for one in figures(calibration)]
    assert keys == ["heading", "axial", "turns", "rates", "allan"]
    assert {s.name for s in figures(calibration)[0].series} == {"runs, position 1", "runs left out"}


def test_noise_free_runs_can_be_drawn(tmp_path):
    log, rig = simulate(tmp_path, "still", rates="60,120", plateau=34, rate=40, encoder_rate=20)
    calibration = calibrated_in(tmp_path, [log], rig)
    made = figures(calibration)
    assert "heading" in [one.key for one in made]
    for run in calibration.runs:
        assert run.per_turn_heading is not None
    runs = tuple(
        dataclasses.replace(run, per_turn_heading=np.full(run.n_turns, run.heading))
        for run in calibration.runs
    )
    quiet = dataclasses.replace(calibration, runs=runs)
    assert "allan" not in [one.key for one in figures(quiet)]
