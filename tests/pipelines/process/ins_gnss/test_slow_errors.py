"""Slow errors of fixes that an IMU shows, and those that it cannot."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.trusted_navigation import process
from sinstool.core.streams import GnssEpochs
from sinstool.methods.ins_gnss.settings import GnssModel, Settings
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.slow_errors import as_stated, expected_factors
from sinstool.survey.grade import ImuGrade
from tests.helpers.filter_logs import start_of
from tests.helpers.filter_start import start as first_state
from tests.helpers.unseen_drives import (
    CONSUMER,
    GRADES,
    LEVER,
    boat,
    drive,
    flight,
    record,
    sensor_errors,
    stated_velocities,
    write,
)
from tests.helpers.unseen_errors import drifting, shaken, smoothed_by_receiver, wandering

SIGMA = 0.4


def started(folder, seed, times, time=100.0, grade="tactical", **options):
    """A start from a drive whose fixes wander so many times as far as they are noisy."""
    data = record(drive(seed, 400.0, 20.0), GRADES[grade], seed, gnss_rate=2.0, sigma=SIGMA)
    data = wandering(data, seed, times * SIGMA, time) if times else data
    log = write(folder / "log.mcap", data)
    gnss = {"lever_arm": tuple(LEVER.tolist()), "gnss_latency": 0.0}
    return start_of(log, input={"gyro_kind": "mean-rate"}, gnss=gnss, **options)


@pytest.mark.parametrize(("seed", "times"), [(1, 4.0), (2, 2.0), (3, 8.0)])
@pytest.mark.slow
def test_a_wander_that_the_receiver_does_not_state(tmp_path, seed, times):
    """It left a navigation 11 sigmas off, and the IMU taken for a poor one.

    Of a Gauss-Markov process of another correlation time, over minutes, the rate of change shows.
    """
    start = started(tmp_path, seed, times)
    slow = np.array(start.settings.gnss.position_markov)
    same_rate = times * SIGMA * np.sqrt(start.settings.gnss.position_time / 100.0)
    assert slow == pytest.approx(np.array([1.0, 1.0, 1.5]) * same_rate, rel=0.6)
    white = np.array(start.settings.gnss.position_white)
    assert white == pytest.approx(3 * [SIGMA], rel=0.15)
    # What is left beside the slow part is white noise of each fix
    sigma = np.median(start.gnss.sigma_position_n, axis=0)
    assert np.sqrt(sigma**2 - slow**2) == pytest.approx(white, rel=0.01)
    assert start.start.covariance_position_n[0, 0] >= slow[0] ** 2
    assert start.grade.grade != "mems"
    assert any("fixes wander by" in text for text in start.warnings)
    assert "; slow errors" in start.gnss_why and "; ;" not in start.gnss_why


@pytest.mark.parametrize("seed", [4, 5])
@pytest.mark.parametrize("grade", ["tactical", "industrial"])
@pytest.mark.slow
def test_fixes_with_white_noise_only_do_not_wander(tmp_path, seed, grade):
    start = started(tmp_path, seed, 0.0, grade=grade)
    assert start.slow_errors == (1.0, 1.0)
    assert not any("fixes wander by" in text for text in start.warnings)


@pytest.mark.slow
def test_what_options_say_of_the_fixes_stays(tmp_path):
    start = started(tmp_path, 1, 4.0, filter={"gnss_lasting": 0.5})
    assert start.slow_errors == (1.0, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "times"), [(1, 4.0), (2, 4.0), (12, 16.0), (13, 16.0)])
def test_fixes_wander_beside_an_imu_of_a_stated_grade(tmp_path, seed, times):
    """A navigation ended 24 of its sigmas off where a grade was given."""
    start = started(tmp_path, seed, times, navigation={"imu_grade": "tactical"})
    assert_wandering(start, times)
    assert start.grade.grade == "tactical"


@pytest.mark.slow
@pytest.mark.parametrize("seed", [11, 13])
def test_fixes_that_wander_far_are_not_taken_for_a_poor_imu(tmp_path, seed):
    """A filter without slow errors diverges, and is no likelier with slightly larger ones."""
    start = started(tmp_path, seed, 16.0)
    assert_wandering(start, 16.0)
    assert start.grade.grade in ("tactical", "navigation")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "sensors"),
    [
        (4, (0.365, 8.5, 0.277, 18.0, 1640.0, 1.6)),
        (11, (0.004, 7.7, 0.077, 12.6, 198.0, 34.0)),
        (24, (0.012, 3.4, 0.071, 414.0, 1344.0, 4.6)),
    ],
)
def test_an_aircraft_that_is_buffeted_is_no_wander_of_its_fixes(tmp_path, seed, sensors):
    """Its position sigmas were five to nine times too wide: fits had joined too long updates.

    They are still wider than the errors: the latency, which is not given, makes horizontal ones of
    the last of these flights two to three times as wide as they are with it.
    """
    truth = flight(seed, 400.0, turbulent=True)
    data = record(truth, sensor_errors(*sensors), seed, gnss_rate=5.0, sigma=0.02, sigma_v=0.1)
    answer, status, _ = process(write(tmp_path / "log.mcap", data), truth, [])
    assert answer is not None and status == 0
    late = answer.seconds > 60.0
    ratio = np.sqrt(np.mean(np.square(answer.error / answer.sigma)[late, :3]))
    assert 0.3 < ratio < 1.6


def assert_wandering(start, times):
    same_rate = times * SIGMA * np.sqrt(start.settings.gnss.position_time / 100.0)
    assert start.settings.gnss.position_markov == pytest.approx(3 * (same_rate,), rel=0.6)


@pytest.mark.parametrize("seed", [4, 5])
@pytest.mark.slow
def test_what_a_stated_grade_lacks_is_not_taken_for_errors_of_fixes(tmp_path, seed):
    stated = {"imu_grade": "navigation"}
    start = started(tmp_path, seed, 0.0, grade="industrial", navigation=stated)
    assert start.slow_errors == (1.0, 1.0)


@pytest.mark.slow
def test_what_options_say_of_the_noise_of_the_imu_stays(tmp_path):
    start = started(tmp_path, 1, 4.0, in_flight={"arw": 1e-5, "vrw": 1e-3})
    assert start.slow_errors == (1.0, 1.0)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.slow
def test_a_filter_without_states_for_slow_errors_has_them_in_its_sigmas(tmp_path, seed):
    """It follows fixes that wander: 4 to 10 of its sigmas off before."""
    truth = drive(seed, 300.0, 20.0)
    data = record(truth, GRADES["tactical"], seed, gnss_rate=2.0, sigma=SIGMA)
    log = write(tmp_path / "log.mcap", wandering(data, seed, 4.0 * SIGMA, 100.0))
    answer, status, _ = process(log, truth, ["--filter", "plain-15"])
    assert answer is not None and status == 0
    off = np.hypot(*answer.error[:, :2].T) / np.hypot(*answer.sigma[:, :2].T)
    assert 0.3 < np.sqrt(np.mean(np.square(off))) < 2.0


def navigated(folder, seed, times):
    """Errors of positions over their sigmas, rms by axis, beside a shaken IMU in five minutes."""
    truth = drive(seed, 300.0, 5.0)
    data = record(truth, GRADES["industrial"], seed, gnss_rate=2.0, sigma=3.0)
    data = shaken(data, seed, 1.0, 0.02)
    data = wandering(data, seed, times * 3.0, 100.0) if times else data
    answer, status, _ = process(write(folder / "log.mcap", data), truth, [])
    assert answer is not None and status == 0
    late = answer.seconds > 30.0
    return np.sqrt(np.mean(np.square(answer.error[late, :3] / answer.sigma[late, :3]), axis=0))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 10, 15])
def test_slow_errors_that_do_not_show_are_expected(tmp_path, seed):
    """The noise of fixes hid that they wander by 2 m: rms of 3.6 to 4.4 sigmas before."""
    assert navigated(tmp_path, seed, 0.7).max() < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 5])
def test_noisy_fixes_with_white_noise_only_keep_their_sigmas(tmp_path, seed):
    errors = navigated(tmp_path, seed, 0.0)
    assert 0.4 < errors.min() <= errors.max() < 1.2


@pytest.mark.parametrize("seed", [4, 5])
@pytest.mark.slow
def test_a_good_imu_shows_that_fixes_do_not_wander(tmp_path, seed):
    start = started(tmp_path, seed, 0.0)
    assert start.expected_slow_errors == (1.0, 1.0, 1.0, 1.0)
    assert start.settings.gnss.position_markov[0] < 0.15 * SIGMA


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.slow
def test_the_velocity_of_fixes_that_a_receiver_smooths_is_not_believed(tmp_path, seed):
    """All that shows from fix to fix is a noise of millimetres.

    With less white noise than the usual share of what the receiver states, the filter would follow
    the fixes: rms of 1.8 to 2.4 sigmas, and twice the error.
    """
    truth = drive(seed, 200.0, 20.0)
    data = record(truth, GRADES["tactical"], seed, gnss_rate=10.0, sigma=0.002)
    data = smoothed_by_receiver(data, seed, 0.6, 5.0)
    data = replace(data, fixes=replace(data.fixes, sigma=0.6))
    answer, status, _ = process(write(tmp_path / "log.mcap", data), truth, [])
    assert answer is not None and status == 0
    late = answer.seconds > 60.0
    ratio = answer.error[late, 3:5] / answer.sigma[late, 3:5]
    assert np.sqrt(np.mean(np.square(ratio))) < 1.4


def afloat(folder, seed, size, time, velocity=0.0):
    """Position errors over their sigmas and in m, rms, of a boat in twenty minutes."""
    truth = boat(seed, 1200.0)
    data = record(truth, GRADES["tactical"], seed, gnss_rate=1.0, sigma=0.3, sigma_v=0.03)
    data = wandering(data, seed, size, time)
    data = drifting(data, seed, velocity, 60.0) if velocity else data
    velocities = stated_velocities(data.fixes)
    positions = replace(
        data.fixes,
        sigma=float(np.hypot(0.3, size)),
        velocity_n=np.full_like(data.fixes.velocity_n, np.nan),
    )
    log = write(folder / "log.mcap", replace(data, fixes=positions), velocities)
    answer, status, _ = process(log, truth, ["--smooth"])
    assert answer is not None and status == 0
    error = answer.error[:, :3]
    return tuple(np.sqrt(np.mean(np.square(e))) for e in (error / answer.sigma[:, :3], error))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_velocities_that_are_off_for_a_minute(tmp_path, seed):
    """The filter followed them past fixes of a metre: by 4 to 5 m, or 3 to 5 sigmas."""
    over_sigma, metres = afloat(tmp_path, seed, 1.0, 200.0, 0.04)
    assert over_sigma < 2.0
    assert metres < 2.0


@pytest.mark.slow
def test_slow_errors_that_outlast_the_log_are_not_averaged(tmp_path):
    """Fixes change within minutes as little as their errors do that last an hour: 2.0 before."""
    ratios = [afloat(tmp_path, seed, 1.0, 3600.0)[0] for seed in range(1, 7)]
    assert 0.6 < np.sqrt(np.mean(np.square(ratios))) < 1.6


@pytest.mark.slow
@pytest.mark.parametrize("stated", [2.0, np.nan])
def test_slow_errors_of_fixes_that_scatter_less_than_assumed(tmp_path, stated):
    """They seemed to last up to an hour, and velocities were off by 1.5 sigmas.

    Where they are taken for larger than they are, they last longer: it is their change that shows.
    """
    changes = []
    for seed in (1, 2, 3):
        noisy = {"gnss_rate": 5.0, "sigma": 0.05, "sigma_v": 0.05}
        data = wandering(
            record(drive(seed, 300.0, 20.0), CONSUMER, seed, **noisy), seed, 2.0, 200.0
        )
        data = replace(data, fixes=replace(data.fixes, sigma=stated))
        log = write(tmp_path / "log.mcap", data)
        gnss = {"lever_arm": tuple(LEVER.tolist()), "gnss_latency": 0.0}
        model = start_of(log, input={"gyro_kind": "mean-rate"}, gnss=gnss).settings.gnss
        changes.append(model.position_markov[0] * np.sqrt(2.0 / model.position_time))
    assert changes == pytest.approx(3 * [2.0 * np.sqrt(2.0 / 200.0)], rel=0.3)


def test_errors_beyond_all_that_the_receiver_states_are_not_expected():
    """Where the filter diverges with smaller ones they are likelier by hundreds: nan came out."""
    slow, white = (0.1, 0.1, 0.1), (1.0, 1.0, 1.0)
    costs = np.array([3655.0, 3655.0, 3655.0, 3654.5, 3654.0, 3656.0, 1752.0, 1887.0])
    assert expected_factors(slow, white, costs) == (1.0, 1.0, 1.0)
    costs[3] -= 20.0
    assert expected_factors(slow, white, costs) == pytest.approx((8.0, 8.0, 8.0), rel=0.01)


def with_fixes(model, position, velocity):
    """A start with fixes of these sigmas, each the same on all axes."""
    count = len(position)
    zeros, axes = np.zeros(count), np.ones(3)
    fixes = GnssEpochs(
        np.arange(count) * 10**9,
        np.arange(count) * 10**9,
        zeros,
        zeros,
        zeros,
        np.zeros((count, 3)),
        np.outer(position, axes),
        np.outer(velocity, axes),
    )
    return FilterStart(
        Settings(gnss=model),
        first_state(0.0, 0.0, 0.0, np.zeros(3), (1.0, 0.0, 0.0, 0.0), 1, 1, 1),
        0, "", None, fixes, np.zeros(count, dtype=bool), None, None, "given", 0.0,
        ImuGrade("mems", ""), "", (),
    )  # fmt: skip


def white_part(start):
    """White sigmas of the fixes, of positions and velocities, as a filter with slow states has."""
    model, made = start.settings.gnss, []
    for kind in ("position", "velocity"):
        white, slow = (np.square(getattr(model, f"{kind}_{part}")) for part in ("white", "markov"))
        square = np.square(getattr(start.gnss, f"sigma_{kind}_n"))
        usual = square >= white + slow
        made.append(np.where(usual, square - slow, square * white / (white + slow)))
    return np.sqrt(made)


@pytest.mark.parametrize("times", [(1.0, 1.0), (4.0, 2.0), (1.0, 16.0)])
def test_larger_slow_errors_leave_the_white_noise_of_good_fixes_alone(times):
    """The sigmas of fixes that are stated better than usual grew, also with factors of 1."""
    rng = np.random.default_rng(1)
    model = GnssModel((0.3, 0.3, 0.5), (0.4, 0.4, 0.6), 200.0, (0.1, 0.1, 0.2), (0.2, 0.2, 0.1))
    position, velocity = rng.uniform(0.05, 2.0, 50), rng.uniform(0.02, 1.0, 50)
    start = with_fixes(model, position, velocity)
    larger = start.with_slow_position(*times, "").with_slow_velocity(*times)
    np.testing.assert_allclose(white_part(larger), white_part(start), rtol=1e-9)
    back = as_stated(replace(larger, slow_errors=times, slow_velocity=times))
    np.testing.assert_allclose(back.gnss.sigma_position_n, start.gnss.sigma_position_n, rtol=1e-9)
    np.testing.assert_allclose(back.gnss.sigma_velocity_n, start.gnss.sigma_velocity_n, rtol=1e-9)
