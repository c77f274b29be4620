from dataclasses import replace

import numpy as np
import pytest

from sinstool.core import rotation
from sinstool.core.errors import AlignmentError
from sinstool.methods.alignment.inflight import align_in_flight
from sinstool.methods.alignment.inflight_types import (
    TACTICAL,
    AlignmentSettings,
    GateLimits,
    GnssFixes,
    ImuIncrements,
)
from sinstool.methods.sensor_errors import SensorGrade
from sinstool.simulation.gnss import GnssFaults, Receiver
from tests.methods.alignment.launches import (
    DEGREE,
    NOISY,
    PERFECT,
    angle_deg,
    exact,
    noisy,
    psi,
    true_attitude,
)

FORMS = ("win", "int", "cen", "diffc", "pos", "triad")
SITES = {
    "north": {},
    "south": {"latitude": -0.6, "longitude": -1.0, "azimuth": -2.0},
    "date line": {"latitude": np.radians(78.0), "longitude": np.pi - 0.001, "azimuth": 1.2},
}


def with_form(form, **changes):
    if form == "triad":
        return AlignmentSettings(method="triad", **changes)
    return AlignmentSettings(vectors=form, **changes)


def error_deg(answer, flight):
    return float(angle_deg(answer.q_nb, true_attitude(flight, answer.t_ns)[0]))


def course_error_deg(answer, flight, after_s):
    late = answer.series.time_ns >= answer.t_q_ns + int(after_s * 1e9)
    assert late.sum() > 10
    true = true_attitude(flight, answer.series.time_ns[late])
    return angle_deg(answer.series.q_nb[late], true).max()


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("site", SITES)
def test_exact_data_give_the_attitude(site, form):
    flight, imu, gnss = exact(**SITES[site])
    answer = align_in_flight(imu, gnss, with_form(form))
    assert (answer.t_q_ns - imu.time_ns[0]) * 1e-9 == pytest.approx(40.1, abs=0.1)
    assert error_deg(answer, flight) < 0.002
    # Central differences leave a sixth of the square of their interval times the jerk's rate.
    assert course_error_deg(answer, flight, 10.0) < (0.005 if form == "diffc" else 0.002)
    assert answer.q_nb[0] >= 0.0 and np.linalg.norm(answer.q_nb) == pytest.approx(1.0)


@pytest.mark.parametrize("form", [f for f in FORMS if f != "diffc"])
def test_exact_data_from_lift_off(form):
    flight, imu, gnss = exact()
    answer = align_in_flight(imu, gnss, with_form(form, gate="off"))
    assert answer.t_q_ns == imu.time_ns[0]
    assert error_deg(answer, flight) < 0.002
    assert course_error_deg(answer, flight, 10.0) < 0.005


@pytest.mark.parametrize("form", ["diff", "diffc"])
@pytest.mark.parametrize("rate", [1.0, 2.0, 5.0, 10.0])
@pytest.mark.parametrize("gate", ["paper", "off"])
def test_sigmas_of_differences_include_their_lag(gate, rate, form):
    """A backward difference of fixes each second was 2 deg off, 17 of its sigmas, and ok."""
    flight, imu, gnss = exact(Receiver(errors=PERFECT, rate_hz=rate))
    answer = align_in_flight(imu, gnss, with_form(form, gate=gate, refine=False))
    assert rate < 3.0 or answer.status in ("ok", "degraded")
    if answer.status in ("ok", "degraded"):
        off = psi(answer.q_nb, true_attitude(flight, answer.t_ns)[0])
        assert np.abs(off / answer.sigma_rad).max() < 1.1


def test_differences_know_that_an_antenna_swings():
    """Its acceleration against the IMU was left out: of a drive with 10 Hz that cost a degree."""
    lever = (3.0, 1.5, 0.5)
    flight, imu, gnss = exact(Receiver(errors=PERFECT, lever_arm_b=lever))
    answer = align_in_flight(imu, gnss, with_form("diffc", refine=False, lever_arm_b=lever))
    assert error_deg(answer, flight) < 0.002


def test_misaligned_gyros_lean_in_turns():
    """The axes of a car's gyros turned its tilt by 20 mdeg, six sigmas."""
    _, imu, gnss = noisy(3)
    plain = align_in_flight(imu, gnss, AlignmentSettings(grade=TACTICAL))
    crossed = align_in_flight(
        imu, gnss, AlignmentSettings(grade=replace(TACTICAL, gyro_misalignment=1e-3))
    )
    np.testing.assert_allclose(crossed.cov - plain.cov, 1e-6 * np.eye(3), atol=1e-12)


@pytest.mark.parametrize("gate", ["paper", "off"])
@pytest.mark.parametrize(
    "receiver",
    [
        Receiver(errors=PERFECT, offset_s=0.0173),
        Receiver(errors=PERFECT, offset_s=0.0173, lever_arm_b=(3.0, 1.5, 0.5)),
        Receiver(errors=PERFECT, offset_s=0.0173, latency_s=0.083),
        Receiver(errors=PERFECT, rate_hz=1.0, offset_s=0.31),
    ],
    ids=["between", "lever", "latency", "1 Hz"],
)
def test_fixes_as_receivers_give_them(receiver, gate):
    flight, imu, gnss = exact(receiver)
    settings = AlignmentSettings(
        gate=gate, gnss_latency_s=receiver.latency_s, lever_arm_b=receiver.lever_arm_b
    )
    answer = align_in_flight(imu, gnss, settings)
    assert error_deg(answer, flight) < 0.002
    assert course_error_deg(answer, flight, 12.0) < 0.005
    ignored = align_in_flight(imu, gnss, AlignmentSettings(gate=gate))
    if gate == "paper" and (receiver.latency_s or receiver.lever_arm_b[0]):
        assert error_deg(ignored, flight) > 0.01


@pytest.mark.parametrize("mounting", [[0.1, -0.9, 0.3, 0.5], [0, 0, 1, 0], [0.5, 0.5, 0.5, -0.5]])
def test_imu_mounted_any_way_round(mounting):
    flight, imu, gnss = exact()
    q = rotation.normalise(mounting)  # from the IMU's axes to the vehicle's
    turned = ImuIncrements(
        imu.time_ns,
        rotation.rotate(rotation.conjugate(q), imu.delta_theta),
        rotation.rotate(rotation.conjugate(q), imu.delta_velocity),
    )
    answer = align_in_flight(turned, gnss)
    true = rotation.multiply(true_attitude(flight, answer.t_ns)[0], q)
    assert angle_deg(answer.q_nb, true) < 0.002


@pytest.mark.parametrize("refine", [False, True])
def test_attitude_at_any_time(refine):
    flight, imu, gnss = exact(Receiver(errors=PERFECT, offset_s=0.0173))
    answer = align_in_flight(imu, gnss, AlignmentSettings(refine=refine))
    times = np.linspace(imu.time_ns[0], imu.time_ns[-1], 300).astype(np.int64)
    times = np.random.default_rng(1).permutation(times)
    result = answer.attitude_at(times)
    assert angle_deg(result, true_attitude(flight, times)).max() < 0.002
    np.testing.assert_allclose(answer.attitude_at([answer.t_ns])[0], answer.q_nb, atol=1e-12)
    with pytest.raises(ValueError, match="within the samples"):
        answer.attitude_at([imu.time_ns[-1] + 1])


@pytest.mark.parametrize("refine", [False, True])
def test_answer_at_a_time_given(refine):
    flight, imu, gnss = noisy(3)
    sigma = {}
    for at in ("start", 70_002_500_000, "end"):
        answer = align_in_flight(imu, gnss, AlignmentSettings(at=at, refine=refine))
        assert error_deg(answer, flight) < 0.3
        sigma[at] = answer.sigma_worst
    assert answer.t_ns == answer.series.time_ns[-1]
    answer = align_in_flight(imu, gnss, AlignmentSettings(at="start", refine=refine))
    assert answer.t_ns == answer.t_q_ns
    assert max(sigma.values()) < np.deg2rad(0.3)
    with pytest.raises(AlignmentError, match="no attitude can be given"):
        align_in_flight(imu, gnss, AlignmentSettings(at=10**15))


@pytest.mark.parametrize("method", ["quest", "davenport"])
def test_solvers_give_one_answer(method):
    _, imu, gnss = noisy(3)
    one = align_in_flight(imu, gnss)
    other = align_in_flight(imu, gnss, AlignmentSettings(method=method))
    assert angle_deg(one.q_nb, other.q_nb) < 1e-10
    assert other.method == method


def test_what_the_answer_says():
    flight, imu, gnss = noisy(3)
    answer = align_in_flight(imu, gnss)
    assert answer.status == "ok" and answer.warnings == ()
    assert 0.8 < answer.chi2 < 1.2
    assert answer.residual_rms == pytest.approx(0.1 * np.sqrt(6.0), rel=0.1)
    assert answer.n_pairs == len(answer.series.time_ns) - 1 + 2  # a solution needs two of them
    assert answer.n_rejected == 0
    assert 0.1 < answer.rho < 0.6
    assert 5.0 < answer.time_to_align_s < 20.0
    k = np.searchsorted(answer.series.time_ns, answer.t_q_ns + int(answer.time_to_align_s * 1e9))
    assert np.all(answer.series.sigma_worst[k:] < DEGREE)
    assert answer.series.sigma_worst[k - 1] > DEGREE
    np.testing.assert_allclose(answer.series.q_nb[-1], answer.q_nb, atol=1e-12)
    np.testing.assert_allclose(answer.series.sigma[-1], answer.sigma_rad, rtol=1e-6)
    np.testing.assert_allclose(answer.cov, answer.cov.T)
    assert answer.sigma_worst == pytest.approx(np.sqrt(np.linalg.eigvalsh(answer.cov)[-1]))
    # The rolls are not calm, the glide is.
    calm = answer.series.calm
    t = (answer.series.time_ns - imu.time_ns[0]) * 1e-9
    assert not calm[(t > 78.0) & (t < 84.0)].any() and calm[(t > 50.0) & (t < 70.0)].all()
    assert course_error_deg(answer, flight, 60.0) < 0.3
    assert align_in_flight(imu, gnss, AlignmentSettings(series=False)).series is None


@pytest.mark.parametrize("form", ["win", "cen", "diff", "diffc"])
def test_residuals_are_what_noise_explains(form):
    _, imu, gnss = noisy(3)
    answer = align_in_flight(imu, gnss, with_form(form, grade=SensorGrade()))
    assert answer.chi2 == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("form", ["int", "cen"])
def test_residuals_are_what_sensor_errors_explain(form):
    """Over minutes constant biases leave far more than noise: the sigma is not theirs twice."""
    grade = SensorGrade(gyro_bias=10.0 * DEGREE / 3600.0, accel_bias=0.02)
    random, ratios, squares, inconsistent = np.random.default_rng(11), [], [], 0
    for seed in range(10):
        flight, imu, gnss = noisy(seed)
        interval = np.gradient(imu.time_ns * 1e-9)[:, None]
        off = replace(
            imu,
            delta_theta=imu.delta_theta + grade.gyro_bias * random.normal(size=3) * interval,
            delta_velocity=imu.delta_velocity + grade.accel_bias * random.normal(size=3) * interval,
        )
        settings = with_form(form, gate="off", grade=grade, kappa=1.0)
        answer = align_in_flight(off, gnss, settings)
        inconsistent += any("inconsistent" in w for w in answer.warnings)
        ratios.append(answer.chi2)
        error = psi(answer.q_nb, true_attitude(flight, answer.t_ns)[0])
        squares.append(error @ np.linalg.solve(answer.cov, error) / 3.0)
        if seed == 0:
            blind = align_in_flight(off, gnss, replace(settings, grade=SensorGrade()))
            assert any("inconsistent" in w for w in blind.warnings)
    assert inconsistent <= 2  # three sigmas of one bias are
    assert 0.4 < np.mean(ratios) < 1.6
    assert 0.4 < np.mean(squares) < 1.6


def test_stop_by_sigma_and_by_the_gate():
    _, imu, gnss = noisy(3)
    answer = align_in_flight(imu, gnss, AlignmentSettings(sigma_stop=0.5 * DEGREE))
    assert answer.sigma_worst < 0.5 * DEGREE
    assert answer.t_stop_ns == answer.t_ns < imu.time_ns[-1] - int(20e9)
    assert answer.series.sigma_worst[-2] > 0.5 * DEGREE
    limits = GateLimits(t_set2=20.0)
    answer = align_in_flight(imu, gnss, AlignmentSettings(limits=limits))
    assert (answer.t_stop_ns - answer.t_q_ns) * 1e-9 == pytest.approx(21.0, abs=0.1)


def clipped(imu, limit):
    return replace(imu, delta_theta=np.clip(imu.delta_theta, -0.005 * limit, 0.005 * limit))


def test_clipped_gyro():
    limit = 200.0 * DEGREE
    flight, imu, gnss = noisy(3)
    bad = clipped(imu, limit)
    plain = error_deg(align_in_flight(imu, gnss), flight)
    # The gate starts after it; so does a start forced by the range known.
    gated = align_in_flight(bad, gnss)
    assert error_deg(gated, flight) == pytest.approx(plain, abs=1e-6)
    masked = align_in_flight(bad, gnss, AlignmentSettings(gate="mask"))
    assert error_deg(masked, flight) < 0.3
    ungated = align_in_flight(bad, gnss, AlignmentSettings(gate="off"))
    assert error_deg(ungated, flight) > 2.0
    assert any("gyro x seems to be clipped" in w for w in ungated.warnings)
    assert any("inconsistent" in w for w in ungated.warnings)
    forced = align_in_flight(bad, gnss, AlignmentSettings(gate="off", gyro_limit=limit))
    assert error_deg(forced, flight) < 0.3
    assert forced.t_q_ns > imu.time_ns[0] + int(11e9)
    assert any("saturated" in w for w in forced.warnings)


def test_residuals_tell_what_is_wrong():
    late = Receiver(errors=NOISY, latency_s=0.1)
    _, imu, gnss = noisy(3, late)
    answer = align_in_flight(imu, gnss, AlignmentSettings(gate="off"))
    assert any("fixes 10" in w and "ms late" in w for w in answer.warnings)
    lever = Receiver(errors=NOISY, lever_arm_b=(0.0, 2.5, -1.5))
    _, imu, gnss = noisy(3, lever)
    answer = align_in_flight(imu, gnss)
    assert any("antenna at" in w and ", 2.5" in w and ", -1.5" in w for w in answer.warnings)


@pytest.mark.parametrize("fraction", [0.02, 0.1])
def test_outliers_do_no_harm(fraction):
    faults = GnssFaults(outlier_fraction=fraction, outlier_velocity=20.0)
    flight, imu, gnss = noisy(3, Receiver(errors=NOISY, faults=faults))
    answer = align_in_flight(imu, gnss)
    assert answer.n_rejected > 5
    assert error_deg(answer, flight) < 0.25 and answer.chi2 < 1.3
    rough = align_in_flight(imu, gnss, AlignmentSettings(screen=False))
    assert rough.chi2 > 20.0 and any("inconsistent" in w for w in rough.warnings)


@pytest.mark.parametrize(("fraction", "given"), [(0.1, True), (0.3, False)])
def test_a_heading_that_many_fixes_deny_is_given_only_if_it_can_be_refined(
    monkeypatch, fraction, given
):
    faults = GnssFaults(outlier_fraction=fraction, outlier_velocity=20.0)
    _, imu, gnss = noisy(3, Receiver(errors=NOISY, faults=faults))
    assert align_in_flight(imu, gnss, AlignmentSettings(refine=True)).status == "ok"
    # As where the gyros' bias leaves the attitude at the end too uncertain
    monkeypatch.setattr("sinstool.methods.alignment.inflight_answer.REFINE_SIGMA", 0.0)
    answer = align_in_flight(imu, gnss, AlignmentSettings(refine=True))
    assert (answer.status in ("ok", "degraded")) == given
    assert any("not refined" in text for text in answer.warnings)


@pytest.mark.parametrize("straight_s", [10.5, 20.0, 40.0])
def test_heading_is_not_made_up(straight_s):
    # Straight and level, and below on the pad: what is told is either right or not told.
    for seed in range(5):
        flight, imu, gnss = noisy(seed, straight=True, rate_hz=100.0)
        settings = AlignmentSettings(end_ns=int((40.1 + straight_s) * 1e9))
        check_honest(align_in_flight(imu, gnss, settings), flight)


@pytest.mark.parametrize("pad_s", [10.0, 30.0])
def test_on_the_pad(pad_s):
    for seed in range(5):
        flight, imu, gnss = noisy(seed, pad_s=60.0, duration_s=1.0, rate_hz=100.0)
        settings = AlignmentSettings(gate="off", end_ns=int(pad_s * 1e9))
        answer = align_in_flight(imu, gnss, settings)
        assert answer.status == "level-only"
        check_honest(answer, flight)


def check_honest(answer, flight):
    if answer.status == "unobservable":
        assert np.isnan(answer.q_nb).all()
        with pytest.raises(AlignmentError):
            answer.attitude_at([answer.t_ns])
        return
    error = psi(answer.q_nb, true_attitude(flight, answer.t_ns)[0])
    euler = rotation.to_euler(np.stack([answer.q_nb, true_attitude(flight, answer.t_ns)[0]]))
    assert np.rad2deg(np.abs(euler[0, :2] - euler[1, :2])).max() < 1.0
    if answer.status == "level-only":
        assert answer.sigma_worst > 5.0 * DEGREE
        assert answer.sigma_rad[2] == pytest.approx(np.pi / np.sqrt(3.0))
        assert any("heading is not known" in w for w in answer.warnings)
    else:
        assert answer.sigma_worst <= 5.0 * DEGREE
        assert np.linalg.norm(error) < 4.0 * answer.sigma_worst


def test_tilt_on_the_pad():
    for seed in range(8):
        flight, imu, gnss = noisy(seed, pad_s=60.0, duration_s=1.0, rate_hz=100.0)
        answer = align_in_flight(
            imu, gnss, AlignmentSettings(gate="off", end_ns=int(10e9), at="start")
        )
        down = rotation.to_dcm(np.stack([answer.q_nb, true_attitude(flight, answer.t_ns)[0]]))
        tilt = np.arccos(np.clip(down[0, 2] @ down[1, 2], -1.0, 1.0))
        assert np.rad2deg(tilt) < 0.3


def test_gaps_of_fixes():
    short = Receiver(errors=NOISY, faults=GnssFaults(outages=((50.0, 58.0),)))
    flight, imu, gnss = noisy(3, short)
    answer = align_in_flight(imu, gnss)
    assert answer.warnings == () and error_deg(answer, flight) < 0.3
    long = Receiver(errors=NOISY, faults=GnssFaults(outages=((50.0, 75.0),)))
    flight, imu, gnss = noisy(3, long)
    for form in FORMS:
        answer = align_in_flight(imu, gnss, with_form(form))
        assert any("fixes are missing for 25" in w for w in answer.warnings)
        assert error_deg(answer, flight) < 4.0 * np.rad2deg(answer.sigma_worst) + 0.1


def test_a_gap_of_a_minute_breaks_the_segment():
    receiver = Receiver(errors=NOISY, faults=GnssFaults(outages=((52.0, 115.0),)))
    flight, imu, gnss = noisy(3, receiver, duration_s=150.0)
    answer = align_in_flight(imu, gnss)
    assert any("2 segments" in w for w in answer.warnings)
    assert answer.t_q_ns >= int(115e9)
    assert error_deg(answer, flight) < 1.0


def test_a_gap_of_the_imu_breaks_the_segment():
    flight, imu, gnss = noisy(3)
    mask = (imu.time_ns < 60e9) | (imu.time_ns > 60.2e9)
    holed = ImuIncrements(imu.time_ns[mask], imu.delta_theta[mask], imu.delta_velocity[mask])
    answer = align_in_flight(holed, gnss)
    assert any("gap in the IMU" in w for w in answer.warnings)
    assert answer.t_q_ns > 60e9 and answer.status == "ok"
    assert error_deg(answer, flight) < 0.3


def test_samples_lost_every_few_seconds_leave_an_attitude():
    """No stretch between losses was long enough, and a recorder that loses samples loses many."""
    for seed in range(4):
        flight, imu, gnss = noisy(seed)
        kept = (imu.time_ns + seed * 10**9) % (4 * 10**9) > 60 * 10**6
        holed = ImuIncrements(imu.time_ns[kept], imu.delta_theta[kept], imu.delta_velocity[kept])
        answer = align_in_flight(holed, gnss)
        assert answer.status in ("ok", "degraded")
        assert any("gaps of up to 0.070 s" in w for w in answer.warnings)
        check_honest(answer, flight)


def test_no_start():
    _, imu, gnss = noisy(3, duration_s=60.0)
    answer = align_in_flight(imu, gnss, AlignmentSettings(limits=GateLimits(t_set1=80.0)))
    assert answer.status == "failed" and np.isnan(answer.q_nb).all() and answer.series is None
    assert any("the gate waits 80 s" in w for w in answer.warnings)
    with pytest.raises(AlignmentError, match="failed"):
        answer.attitude_at([answer.t_ns])
    answer = align_in_flight(imu, gnss, AlignmentSettings(limits=GateLimits(f_set=5.0)))
    assert any("|f| for " in w for w in answer.warnings)
    answer = align_in_flight(imu, gnss, AlignmentSettings(limits=GateLimits(t_set1=53.0)))
    assert answer.status == "failed" and any("10 s are needed" in w for w in answer.warnings)


def test_start_given():
    flight, imu, gnss = noisy(3)
    start = int(imu.time_ns[10000]) + 3
    answer = align_in_flight(imu, gnss, AlignmentSettings(start_ns=start))
    assert answer.t_q_ns == imu.time_ns[10001]
    assert error_deg(answer, flight) < 0.3


def test_velocity_missing():
    flight, imu, gnss = exact()
    blind = replace(gnss, velocity_n=np.full_like(gnss.velocity_n, np.nan))
    answer = align_in_flight(imu, blind)
    assert answer.vectors == "pos" and error_deg(answer, flight) < 0.002
    answer = align_in_flight(imu, blind, AlignmentSettings(refine=True))
    assert answer.errors is None and any("not refined" in w for w in answer.warnings)
    sparse = gnss.velocity_n.copy()
    sparse[::7] = np.nan
    answer = align_in_flight(imu, replace(gnss, velocity_n=sparse))
    assert answer.vectors == "win" and error_deg(answer, flight) < 0.002


def test_noise_of_each_fix():
    # Every third fix is ten times worse and says so.
    flight, imu, gnss = exact()
    rng = np.random.default_rng(7)
    sigma = np.where(np.arange(len(gnss)) % 3 == 0, 1.0, 0.1)
    weighted, alike = [], []
    for _ in range(8):
        noise = sigma[:, None] * rng.normal(size=(len(gnss), 3))
        rough = replace(gnss, velocity_n=gnss.velocity_n + noise)
        answer = align_in_flight(imu, replace(rough, sigma_v=sigma))
        assert 0.8 < answer.chi2 < 1.2
        assert any("much less certain than those of their neighbours" in w for w in answer.warnings)
        weighted.append(error_deg(answer, flight))
        alike.append(
            error_deg(align_in_flight(imu, rough, AlignmentSettings(gnss_sigma_v=1.0)), flight)
        )
    assert np.mean(weighted) < 0.6 * np.mean(alike)


def test_far_future_times():
    # Nanoseconds since 1970 do not fit a float: only differences are floats.
    offset = 1_790_000_000_123_456_789
    _, imu, gnss = noisy(3)
    moved = align_in_flight(
        replace(imu, time_ns=imu.time_ns + offset),
        GnssFixes(**{**vars(gnss), "time_ns": gnss.time_ns + offset}),
    )
    plain = align_in_flight(imu, gnss)
    np.testing.assert_array_equal(moved.q_nb, plain.q_nb)
    assert moved.t_ns == plain.t_ns + offset


def test_fading_forgets_drift():
    # A gyro 50 times worse than the grade: with fading the newest pairs decide.
    flight, imu, gnss = exact()
    drift = replace(
        imu, delta_theta=imu.delta_theta + 0.005 * np.deg2rad([50.0, -50.0, 50.0]) / 3600
    )
    grade = replace(TACTICAL, gyro_bias=np.deg2rad(50.0) / 3600.0)
    plain = align_in_flight(drift, gnss, AlignmentSettings(grade=grade))
    faded = align_in_flight(drift, gnss, AlignmentSettings(grade=grade, fade_s=15.0))
    assert error_deg(faded, flight) < 0.75 * error_deg(plain, flight)
    assert faded.sigma_worst < plain.sigma_worst
