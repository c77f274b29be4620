from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import linregress

from sinstool.core import rotation
from sinstool.core.earth import EARTH_RATE, earth_rate_n
from sinstool.core.errors import AlignmentError, ConfigurationError
from sinstool.methods.hse.encoder import table_angle
from sinstool.methods.hse.rig import EncoderModel, Rig
from sinstool.methods.hse.segments import SegmentRules, find_segments, turn_statistics
from sinstool.methods.hse.whole_turn import (
    align_whole_turns,
    run_from_turns,
    slope_of_columns,
    slope_t,
)
from sinstool.simulation.hse_rig import HseRigErrors, HseRigSetup, hse_rig
from tests.helpers import hse_exact as exact

ARCSEC = np.pi / 648000.0
LATITUDE = 0.49
EPSILON = (2.2 * ARCSEC, 0.8 * ARCSEC, 1.2 * ARCSEC)
RULES = SegmentRules(min_turns=4, min_duration_s=20.0)
RATES = np.radians([20.0, 40.0, 60.0])


def leaning_east(heading=0.7, lean=8e-4, latitude=LATITUDE, **more):
    return HseRigSetup(
        latitude=latitude,
        heading=heading,
        theta=lean * np.sin(heading),
        gamma=-lean * np.cos(heading),
        imu_rate=100.0,
        encoder_rate=50.0,
        **more,
    )


def first_turns(turns, n):
    return replace(turns, S=turns.S[:n], circle=turns.circle[:n], duration=turns.duration[:n])


def rig_of(log, setup, **more):
    more = {"latitude": setup.latitude, "imu_stamp": setup.imu_stamp} | more
    return Rig(log.believed_K_g, log.believed_C_s_to_b, **more)


def statistics(log, rig, rules=RULES):
    pieces = table_angle(
        log.time_ns, log.encoder_time_ns, log.encoder_position, rig.encoder, rig.imu_stamp
    )
    (segment,) = find_segments(pieces, rules).used
    return turn_statistics(pieces[segment.piece], segment, log.gyro, log.accel)


def aligned(rate, setup, errors=None, seconds=150.0, seed=0, level_rate="off", **more):
    log = hse_rig([(float(rate), seconds)], setup, errors, seed=seed)
    rig = rig_of(log, setup, **more)
    return log.truth, align_whole_turns(statistics(log, rig), rig, level_rate)


def off(alignment, truth):
    """Heading error, rad."""
    return float(np.angle(np.exp(1j * (alignment.heading - truth.heading))))


def test_published_case_end_to_end():
    setup = leaning_east(epsilon=EPSILON)
    psi = []
    for rate in RATES:
        truth, a = aligned(rate, setup)
        mean = exact.rotation_mean(truth.X)
        predicted = exact.heading_error(mean, rate, truth.C_nb0, LATITUDE)
        assert off(a, truth) == pytest.approx(predicted, abs=1e-5 * ARCSEC)
        np.testing.assert_allclose(a.C23, truth.C23, atol=1e-9)
        np.testing.assert_allclose(a.C23, 8e-4, rtol=1e-6)
        assert -3.0 * a.c_axial == pytest.approx(-4.2 * ARCSEC, abs=1e-4 * ARCSEC)
        psi.append(off(a, truth))
    K = np.polyfit(RATES, psi, 1)[0]
    np.testing.assert_allclose(K / ARCSEC, -17.4073, atol=2e-3)
    lambda2 = exact.lambda2_from_slope(K, 8e-4, LATITUDE)
    assert lambda2 == pytest.approx(-4.2 * ARCSEC, abs=0.002 * ARCSEC)


@pytest.mark.parametrize("latitude", [0.9, -0.6, 0.0])
def test_correction_leaves_a_constant_anywhere(latitude):
    # one coefficient, other sites, headings, tilts and directions: only -d is left
    for heading in (0.3, 1.9, 3.6, 5.5):
        for rate in np.radians([25.0, -60.0]):
            setup = replace(
                leaning_east(heading, latitude=latitude, epsilon=EPSILON),
                theta=5e-4,
                gamma=-7e-4,
            )
            truth, a = aligned(rate, setup, seconds=110.0)
            correction = exact.linear_heading_error(truth.lambda2, a.rate, a.C23, latitude)
            d = exact.rotation_mean(truth.X).d
            assert -d == pytest.approx(0.7506 * ARCSEC, abs=1e-4 * ARCSEC)
            assert off(a, truth) - correction == pytest.approx(-d, abs=0.003 * ARCSEC)
            assert np.degrees(a.rate) == pytest.approx(np.degrees(rate), rel=1e-9)
            np.testing.assert_allclose([a.theta, a.gamma], [5e-4, -7e-4], atol=1e-9)
            np.testing.assert_allclose(a.C23, truth.C23, atol=1e-3 * abs(off(a, truth)) + 1e-9)


def test_everything_wrong_at_once_is_what_the_exact_formula_says():
    setup = replace(
        leaning_east(
            2.9,
            axis=(-0.6, -0.48, -0.64),
            K_g=((1.01, 0.0, 0.0), (0.02, 0.99, 0.0), (-0.01, 0.03, 1.02)),
            epsilon=(1e-4, -2e-4, 3e-4),
            kappa=(5e-5, -1e-4, 2e-4),
            xi=(1e-4, -2e-4, 1e-4),
        ),
        theta=0.04,
        gamma=-0.03,
    )
    for stamp in ("end", "mid", "start"):
        rate = np.radians(-37.0)
        truth, a = aligned(rate, replace(setup, imu_stamp=stamp))
        mean = exact.rotation_mean(truth.X)
        # the vertical is seen through the same misaligned axes of b
        u = truth.C_nb0.T @ earth_rate_n(LATITUDE)
        w = u + mean.rate_error(rate, u)
        C_s_to_b = np.linalg.inv(truth.C_s_to_b.T) - np.cross(setup.xi, truth.C_s_to_b.T).T
        Y = exact.rotation_mean(C_s_to_b @ truth.C_s_to_b.T - np.eye(3))
        down = truth.C_nb0[2] + Y.rate_error(0.0, truth.C_nb0[2])
        down /= np.linalg.norm(down)
        east = np.cross(down, w)
        expected = np.arctan2(east[0], np.cross(east, down)[0])
        error = off(a, truth)
        assert abs(error) > 100.0 * ARCSEC
        target = np.angle(np.exp(1j * (expected - truth.heading)))
        # turns end within samples; what is fixed to b0 is not constant in those
        assert error == pytest.approx(target, abs=0.04 * ARCSEC)
        # Earth rate along the axis is that of the heading found
        assert a.c_axial == pytest.approx(truth.X[2, 2], abs=2e-7)
        near = exact.heading_error(mean, rate, truth.C_nb0, LATITUDE)
        assert error == pytest.approx(near, abs=2.0 * ARCSEC)


def test_calibration_taken_out_at_its_source():
    setup = leaning_east(epsilon=EPSILON, lean=8e-3)
    log = hse_rig([(float(RATES[2]), 100.0)], setup)
    rig = rig_of(log, setup)
    turns = statistics(log, rig)
    before = align_whole_turns(turns, rig)
    after = align_whole_turns(turns, rig.scaled(before.c_axial))
    assert 3.0 * abs(before.c_axial) > 4.0 * ARCSEC
    assert -3.0 * after.c_axial == pytest.approx(0.0, abs=1e-3 * ARCSEC)
    assert abs(off(before, log.truth)) > 100.0 * ARCSEC
    offset = -exact.rotation_mean(log.truth.X).d
    assert off(after, log.truth) == pytest.approx(offset, abs=0.03 * ARCSEC)


@pytest.mark.parametrize(("tau", "stamp"), [(84e-6, "end"), (-5e-3, "mid")])
def test_time_error_is_a_slope(tau, stamp):
    # encoder stale by tau, or a mean over 10 ms taken for the value in its middle
    setup = leaning_east()
    errors = HseRigErrors(encoder_delay=max(tau, 0.0))
    psi = []
    for rate in RATES:
        truth, a = aligned(rate, setup, errors, imu_stamp=stamp)
        psi.append(off(a, truth))
        assert -3.0 * a.c_axial == pytest.approx(0.0, abs=1e-4 * ARCSEC)
    np.testing.assert_allclose(psi, tau * RATES, atol=1e-3 * ARCSEC)
    if tau > 0:
        truth, a = aligned(RATES[2], setup, errors, encoder=EncoderModel(delay=tau))
        assert off(a, truth) == pytest.approx(0.0, abs=1e-4 * ARCSEC)


def test_encoder_of_any_kind():
    setup = leaning_east(2.2, epsilon=EPSILON)
    rate = RATES[1]
    truth, plain = aligned(rate, setup)
    errors = HseRigErrors(
        encoder_sign=-1, encoder_offset=0.8, encoder_degrees=True, encoder_wrap="half-turn"
    )
    model = EncoderModel(sign=-1, offset=0.8, unit="deg")
    _, other = aligned(rate, setup, errors, encoder=model)
    assert other.heading == pytest.approx(plain.heading, abs=1e-4 * ARCSEC)
    # another zero mark is another heading of b0
    _, moved = aligned(rate, setup, errors, encoder=replace(model, offset=0.0))
    assert off(moved, truth) - off(plain, truth) == pytest.approx(0.8, abs=1e-6)
    with pytest.raises(
        ConfigurationError, match=r"gyros turn at \+39\.998.*at -40\.000.*rig\.encoder\.sign"
    ):
        aligned(rate, setup, errors, encoder=replace(model, sign=1))
    with pytest.raises(ConfigurationError, match=r"unit of the gyros, rig\.encoder\.unit"):
        aligned(rate, setup, HseRigErrors(gyro_scale=np.degrees(1.0) - 1.0))


def test_biases_average_out_and_can_be_taken_off():
    rate = RATES[1]
    setup = leaning_east()
    gyro, accel = (2e-5, -1e-5, 3e-5), (0.02, -0.01, 0.03)
    ripple = HseRigErrors(ripple=5e-4)  # so that bias times cos alpha does not average out
    errors = replace(ripple, gyro_bias=gyro, accel_bias=accel)
    truth, clean = aligned(rate, setup, ripple)
    _, biased = aligned(rate, setup, errors)
    _, known = aligned(rate, setup, errors, gyro_bias=gyro, accel_bias=accel)
    assert abs(off(biased, truth) - off(clean, truth)) > 0.5 * ARCSEC
    assert off(known, truth) == pytest.approx(off(clean, truth), abs=1e-3 * ARCSEC)
    assert known.c_axial == pytest.approx(clean.c_axial, abs=1e-12)
    _, steady = aligned(rate, setup, replace(errors, ripple=0.0, accel_bias=(0.0, 0.0, 0.0)))
    axial = np.dot(truth.C_s_to_b[2], gyro)
    assert steady.c_axial == pytest.approx(axial / (rate + steady.C_nb0[:, 2] @ [
        EARTH_RATE * np.cos(LATITUDE), 0.0, -EARTH_RATE * np.sin(LATITUDE)
    ]), rel=1e-6)  # fmt: skip


def test_sigmas_are_those_of_many_runs():
    arw, vrw = 2e-5, 2e-3
    setup = replace(leaning_east(1.3, epsilon=EPSILON), theta=0.02, gamma=0.01)
    log = hse_rig([(float(RATES[2]), 120.0)], setup)
    rig = rig_of(log, setup)
    truth = log.truth
    expected = exact.heading_error(exact.rotation_mean(truth.X), RATES[2], truth.C_nb0, LATITUDE)
    clean = align_whole_turns(statistics(log, rig), rig)
    random = np.random.default_rng(8)
    runs = []
    for _ in range(60):
        noise = random.standard_normal((2, *log.gyro.shape)) * 10.0  # per sqrt(interval)
        noisy = statistics(
            replace(log, gyro=log.gyro + arw * noise[0], accel=log.accel + vrw * noise[1]), rig
        )
        runs.append(align_whole_turns(noisy, rig))
    n = len(runs)
    spread = 2.6 / np.sqrt(2 * n)
    heading = np.array([off(a, truth) for a in runs])
    sigma_rms = np.sqrt(np.mean([a.sigma_heading**2 for a in runs]))
    duration = 2 * np.pi * 19 / RATES[2]
    assert len(runs[0].per_turn_heading) == 19
    assert sigma_rms == pytest.approx(
        arw / np.sqrt(duration) / (EARTH_RATE * np.cos(LATITUDE)), rel=0.1
    )
    assert heading.std(ddof=1) == pytest.approx(sigma_rms, rel=spread)
    assert heading.mean() == pytest.approx(expected, abs=3.5 * sigma_rms / np.sqrt(n))
    for name, sigma in (("c_axial", "sigma_c_axial"), ("C23", "sigma_C23")):
        values = np.array([getattr(a, name) for a in runs])
        sigma_rms = np.sqrt(np.mean([getattr(a, sigma) ** 2 for a in runs]))
        assert values.std(ddof=1) == pytest.approx(sigma_rms, rel=spread), name
        assert values.mean() == pytest.approx(
            getattr(clean, name), abs=3.5 * sigma_rms / np.sqrt(n)
        )
    trends = np.array([a.quality["heading_trend_t"] for a in runs])
    assert np.abs(trends).max() < 5.0
    assert 0.7 < trends.std() < 1.4
    assert abs(np.mean([a.quality["lag1_correlation"] for a in runs])) < 0.15
    allowed = align_whole_turns(noisy, rig, gyro_bias_sigma=1e-6)
    white = runs[-1].sigma_c_axial
    u_z = clean.rate * 1e-3
    assert allowed.sigma_c_axial == pytest.approx(
        np.hypot(white, 1e-6 / clean.rate), rel=abs(u_z / clean.rate)
    )


def test_base_that_tilts():
    drift = 1.0 * ARCSEC / 120.0
    setup = leaning_east(0.9)
    east = HseRigErrors(base_drift_n=(0.0, drift, 0.0))
    truth, a = aligned(RATES[1], setup, east, seconds=120.0)
    raw = -drift / (EARTH_RATE * np.cos(LATITUDE))
    assert off(a, truth) == pytest.approx(raw, rel=1e-3)
    assert raw / ARCSEC == pytest.approx(-129.5, abs=0.2)
    duration = len(a.per_turn_heading) * 2 * np.pi / a.rate
    assert a.quality["tilt_drift_north"] == pytest.approx(drift * duration, rel=1e-3)
    assert a.quality["tilt_drift_east"] == pytest.approx(0.0, abs=1e-3 * ARCSEC)
    assert a.quality["level_rate_used"] == 0.0
    for how in ("on", "auto"):
        _, level = aligned(RATES[1], setup, east, seconds=120.0, level_rate=how)
        assert off(level, truth) == pytest.approx(0.0, abs=0.01 * ARCSEC)
        assert level.quality["level_rate_used"] == 1.0
    north = HseRigErrors(base_drift_n=(drift, 0.0, 0.0))
    truth, a = aligned(RATES[1], setup, north, seconds=120.0)
    assert abs(off(a, truth)) < 0.1 * ARCSEC
    assert a.quality["tilt_drift_east"] == pytest.approx(-drift * duration, rel=1e-3)
    # a drift within its noise is left alone
    noise = replace(east, velocity_random_walk=1e-2)
    _, a = aligned(RATES[1], setup, noise, seconds=120.0, level_rate="auto")
    assert a.quality["level_rate_used"] == 0.0
    with pytest.raises(ConfigurationError, match="level-rate"):
        aligned(RATES[1], setup, level_rate="yes")


def test_quality_of_a_clean_and_of_a_wrong_site():
    setup = leaning_east(epsilon=EPSILON)
    _, a = aligned(RATES[1], setup)
    c, u_z = a.c_axial, a.C_nb0[:, 2] @ [0.0, 0.0, -EARTH_RATE * np.sin(LATITUDE)]
    assert a.quality["rate_north_residual"] == pytest.approx(0.0, abs=2e-9)
    assert a.quality["rate_down_residual"] == pytest.approx(c * (a.rate + u_z), rel=1e-3)
    assert a.quality["force_residual"] == pytest.approx(0.0, abs=1e-4)
    _, elsewhere = aligned(RATES[1], setup, latitude=LATITUDE + 0.01)
    lost = EARTH_RATE * (np.cos(LATITUDE) - np.cos(LATITUDE + 0.01))
    assert elsewhere.quality["rate_north_residual"] == pytest.approx(lost, rel=1e-2)


def test_a_bias_along_the_axis_that_drifts_is_seen_in_the_turns():
    setup = leaning_east()
    log = hse_rig([(float(RATES[2]), 120.0)], setup, HseRigErrors(angle_random_walk=1e-7))
    rig = rig_of(log, setup)
    turns = statistics(log, rig)
    steady = align_whole_turns(turns, rig).quality
    assert abs(steady["axial_drift"]) < 5.0 * steady["axial_drift_sigma"]
    S, middle = turns.S.copy(), np.cumsum(turns.duration) - 0.5 * turns.duration
    axis = np.linalg.inv(rig.gyro_to_b) @ [0.0, 0.0, 1.0]
    S[:, 2, :3] += np.outer(1e-8 * middle * turns.duration, axis)
    drifting = align_whole_turns(replace(turns, S=S), rig).quality
    assert drifting["axial_drift"] == pytest.approx(1e-8, rel=1e-2)
    assert drifting["axial_drift"] > 20.0 * drifting["axial_drift_sigma"]


def test_heading_that_drifts_is_seen_in_the_turns():
    setup = leaning_east()
    log = hse_rig([(float(RATES[2]), 120.0)], setup, HseRigErrors(angle_random_walk=1e-7))
    rig = rig_of(log, setup)
    turns = statistics(log, rig)
    steady = align_whole_turns(turns, rig)
    assert abs(steady.quality["heading_trend_t"]) < 4.0
    # the base turns about East ever faster
    lean = 1e-7 * np.arange(len(turns)) * turns.duration
    S = turns.S.copy()
    r2 = steady.C_nb0[1]
    in_s = np.linalg.inv(rig.gyro_to_b)
    half = 0.5 * lean
    S[:, 0, :3] += np.outer(half, in_s @ [r2[0], r2[1], 0.0])
    S[:, 1, :3] += np.outer(half, in_s @ [r2[1], -r2[0], 0.0])
    drifting = align_whole_turns(replace(turns, S=S), rig)
    assert drifting.quality["heading_trend_t"] < -20.0
    assert drifting.quality["lag1_correlation"] > 0.5
    fall = np.polyfit(np.arange(len(turns)), drifting.per_turn_heading, 1)[0]
    assert fall == pytest.approx(-1e-7 / (EARTH_RATE * np.cos(LATITUDE)), rel=0.08)


def test_attitude_of_the_turning_body():
    setup = leaning_east(2.2, lean=8e-3)
    log = hse_rig([(float(RATES[1]), 120.0)], setup)
    rig = rig_of(log, setup)
    a = align_whole_turns(statistics(log, rig), rig)
    got = a.q_nb(log.truth.alpha)
    away = rotation.log(rotation.multiply(rotation.conjugate(log.truth.q_nb), got))
    assert np.abs(away).max() < 1e-6
    np.testing.assert_allclose(a.C_nb0 @ a.C_nb0.T, np.eye(3), atol=1e-14)
    turned = a.q_nb(log.truth.alpha[:5], heading_correction=0.01)
    less = rotation.to_euler(got[:5])[:, 2] - rotation.to_euler(turned)[:, 2]
    np.testing.assert_allclose(less, 0.01, atol=1e-12)


def test_run_for_the_calibration():
    setup = leaning_east(epsilon=EPSILON)
    log = hse_rig([(float(-RATES[1]), 120.0)], setup, HseRigErrors(angle_random_walk=1e-6))
    rig = rig_of(log, setup)
    turns = statistics(log, rig)
    a = align_whole_turns(turns, rig)
    run = run_from_turns(turns, rig, id="a:1", source="a.mcap", log_start_ns=17)
    assert (run.id, run.source, run.log_start_ns, run.n_turns) == ("a:1", "a.mcap", 17, 12)
    assert run.t_start_s == turns.start_s
    assert run.duration_s == pytest.approx(12 * 9.0, rel=1e-6)
    for name in ("rate", "heading", "sigma_heading", "theta", "gamma", "C23", "sigma_C23",
                 "c_axial", "sigma_c_axial", "latitude", "quality"):  # fmt: skip
        assert getattr(run, name) == getattr(a, name)
    assert run.rate < 0.0
    # turns are independent of the calibration: another one needs no other pass
    other = run_from_turns(turns, rig.scaled(run.c_axial), id="b", source="")
    assert abs(other.c_axial) < 1e-9


def test_what_cannot_be_aligned():
    setup = leaning_east()
    log = hse_rig([(float(RATES[1]), 60.0)], setup)
    rig = rig_of(log, setup)
    turns = statistics(log, rig)
    with pytest.raises(AlignmentError, match=r"85\.9. degrees"):
        align_whole_turns(turns, replace(rig, latitude=1.5))
    with pytest.raises(ConfigurationError, match="latitude_deg is missing"):
        align_whole_turns(turns, replace(rig, latitude=None))
    with pytest.raises(AlignmentError, match="no whole turn"):
        align_whole_turns(first_turns(turns, 0), rig)
    S = turns.S.copy()
    S[:, :, 3:] = 0.0
    with pytest.raises(AlignmentError, match="force is zero"):
        align_whole_turns(replace(turns, S=S), rig)
    few = align_whole_turns(first_turns(turns, 3), rig)
    assert np.isnan([few.sigma_heading, few.sigma_c_axial, few.quality["heading_trend_t"]]).all()
    assert abs(off(few, log.truth)) < 0.01 * ARCSEC


@pytest.mark.parametrize(
    ("errors", "xi", "slope", "axial", "offset"),
    [
        # arcsec per rad/s of K, arcsec of lambda2 along the axis, arcsec of heading
        (HseRigErrors(gyro_scale=1e-6), 0.0, -2.5647, -0.6188, 0.0),
        (HseRigErrors(gyro_scale=20e-6), 0.0, -51.292, -12.376, 0.0),
        (HseRigErrors(clock=1e-6), 0.0, -2.5647, -0.6188, 0.0),
        (HseRigErrors(encoder_delay=1e-5), 0.0, 2.0626, 0.0, 0.0),
        (HseRigErrors(accel_bias=(4.9e-4, 0.0, 0.0)), 0.0, 0.0005, 0.0, -0.0026),
        (HseRigErrors(lever_arm=(0.1, 0.05, 0.1)), 0.0, 0.0, 0.0, 0.0),
        # an angle wrong once a turn meets what is misaligned; twice a turn it does not
        (HseRigErrors(encoder_harmonics=((1, 5 * ARCSEC, 0.7 + np.pi / 4),)), 1e-4, 5.49, 0.0, 0.0),
        (HseRigErrors(encoder_harmonics=((2, 5 * ARCSEC, 0.7 + np.pi / 4),)), 1e-4, 0.0, 0.0, 0.0),
        (HseRigErrors(ripple=1e-4), 1e-4, 0.0, 0.0, 0.0),
        (HseRigErrors(base_drift_n=(0.0, ARCSEC / 600, 0.0)), 0.0, 0.0, 0.0, -25.904),
    ],
)
def test_single_errors_make_the_published_changes(errors, xi, slope, axial, offset):
    setup = leaning_east(xi=(xi, xi, xi)) if xi else leaning_east(epsilon=EPSILON)
    change, along = [], []
    for rate in RATES:
        _, clean = aligned(rate, setup, seconds=112.5)
        _, wrong = aligned(rate, setup, errors, seconds=112.5)
        change.append((wrong.heading - clean.heading) / ARCSEC)
        along.append(-3.0 * (wrong.c_axial - clean.c_axial) / ARCSEC)
    K, at_rest = np.polyfit(RATES, change, 1)
    # smoothing takes a hundredth of what happens once a turn at the highest rate
    np.testing.assert_allclose(K, slope, atol=0.1 if xi else 6e-4, rtol=1e-4)
    np.testing.assert_allclose(along, axial, atol=2e-3)
    np.testing.assert_allclose(at_rest, offset, atol=0.05 if xi else 3e-3)


@pytest.mark.parametrize("count", [4, 5, 30])
def test_sigma_of_a_slope_is_that_of_regression(count):
    random = np.random.default_rng(count)
    x, y = np.sort(random.uniform(0.0, 9.0, count)), random.standard_normal((count, 3))
    slope, sigma = slope_of_columns(x, y)
    for k in range(3):
        line = linregress(x, y[:, k])
        assert slope[k] == pytest.approx(line.slope)
        assert sigma[k] == pytest.approx(line.stderr)
        assert slope_t(x, y[:, k]) == pytest.approx(line.slope / line.stderr)
