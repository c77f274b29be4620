"""First attitudes that the minutes after them deny: other ones are taken, stated ones are told."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.trusted_navigation import process
from sinstool.core.finding import exit_status
from sinstool.core.rotation import conjugate, exp, from_dcm, log, multiply, to_euler
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.pipelines.process.ins_gnss.iterated_start import iterated
from sinstool.pipelines.process.ins_gnss.likeliest_attitude import TILT_SIGMA, likeliest
from tests.helpers.filter_logs import first_start_of
from tests.helpers.imulogs import T0
from tests.helpers.unseen_drives import (
    CONSUMER,
    DEG,
    GRADES,
    LEVER,
    RATE,
    boat,
    drive,
    multicopter,
    record,
    sensor_errors,
    walk,
    write,
)
from tests.pipelines.process.ins_gnss.test_doubtful_logs import kinds, navigated

AS_LOGGED = {"input": {"gyro_kind": "mean-rate"}, "gnss": {"lever_arm": tuple(LEVER.tolist())}}


def road(seed, duration):
    return drive(seed, duration, rest=10.0)


@pytest.fixture(scope="module", params=[(multicopter, 5), (boat, 6), (multicopter, 7)])
def begun(request, tmp_path_factory):
    """A first start, the motion after it, and the true attitude there; the truth."""
    kind, seed = request.param
    truth = kind(seed, 240.0)
    data = record(truth, CONSUMER, seed, gnss_rate=5.0, sigma=0.3)
    log_path = write(tmp_path_factory.mktemp("log") / "log.mcap", data)
    start, motion = first_start_of(log_path, **AS_LOGGED)
    at = int(np.searchsorted(truth.seconds, (start.time_ns - T0) * 1e-9))
    return start, motion, truth.c_nb[at], truth


def turned(start, c_nb, heading_deg, sigma_deg):
    """The start with the true attitude turned, and as sure of it."""
    q = multiply(exp([0.0, 0.0, heading_deg * DEG]), from_dcm(c_nb))
    nav = np.concatenate([start.start.nav[:6], q])
    covariance = np.eye(3) * (sigma_deg * DEG) ** 2
    return replace(start, start=replace(start.start, nav=nav, covariance_attitude_n=covariance))


@pytest.mark.slow
@pytest.mark.parametrize("heading_deg", [60.0, -100.0, 180.0])
def test_a_wrong_heading_is_not_the_likeliest(begun, heading_deg):
    start, motion, c_nb, truth = begun
    wrong = turned(start, c_nb, heading_deg, 3.0)
    best, gain = likeliest(wrong, motion, TILT_SIGMA)
    assert gain > 25.0
    best = iterated(replace(wrong, start=best), motion)
    run = InsGnssFilter(best, start.settings, with_baro=False)
    updates = run.push(motion, start.used).updates
    at = int(np.searchsorted(truth.seconds, (updates.time_ns[-1] - T0) * 1e-9))
    off = log(multiply(from_dcm(truth.c_nb[at]), conjugate(updates.q_nb[-1])))
    sigma = np.sqrt(np.diagonal(updates.covariance_attitude_n[-1]))
    assert np.all(np.abs(off) < 4.0 * sigma) and sigma.max() < 10.0 * DEG


@pytest.mark.parametrize("heading_deg", [0.0, 3.0])
def test_a_heading_within_its_sigma_stays(begun, heading_deg):
    start, motion, c_nb, _ = begun
    made = turned(start, c_nb, heading_deg, 3.0)
    assert likeliest(made, motion, TILT_SIGMA) == (made.start, 0.0)
    assert likeliest(made, None, TILT_SIGMA) == (made.start, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 8])
def test_a_walk_whose_few_velocity_changes_fit_several_headings(tmp_path, seed):
    """It began 99 and 43 deg off, at sigmas of ten."""
    truth = walk(seed, 300.0)
    data = record(truth, GRADES["industrial"], seed, gnss_rate=2.0, sigma=0.44)
    result, seconds, off, heading = navigated(
        write(tmp_path / "log.mcap", data), truth, tmp_path / "out.mcap"
    )
    assert exit_status(result.findings) == 0
    assert off[-1] < 1.5
    assert np.sqrt(np.mean(heading[seconds > 120.0] ** 2)) < 10.0


@pytest.mark.parametrize(
    ("kind", "seed", "off_deg", "denied"),
    [
        (boat, 3, [0.0, 0.0, 90.0], True),
        (road, 4, [0.0, 0.0, 20.0], True),
        (multicopter, 6, [15.0, 0.0, 0.0], True),
        (multicopter, 6, [0.0, 15.0, 0.0], True),
        (road, 4, [1.0, -1.0, 2.0], False),
        (multicopter, 5, [0.0, 0.0, 3.0], False),
    ],
)
@pytest.mark.slow
def test_a_stated_attitude_is_compared_with_fixes_without_velocity(
    tmp_path, kind, seed, off_deg, denied
):
    truth = kind(seed, 240.0)
    data = record(truth, GRADES["industrial"], seed, gnss_rate=5.0, sigma=0.3)
    stated = np.rad2deg(to_euler(from_dcm(truth.c_nb[0]))) + off_deg
    align = {"align": "fixed", "initial_attitude": tuple(stated.tolist())}
    result, _, _, heading = navigated(
        write(tmp_path / "log.mcap", data), truth, tmp_path / "out.mcap", align=align
    )
    assert ("stated-attitude" in kinds(result)) == denied
    assert exit_status(result.findings) == (3 if denied else 0)
    assert denied or np.sqrt(np.mean(heading**2)) < 4.0


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "seed"), [(walk, 6), (boat, 5)])
def test_another_attitude_of_a_bare_chip_comes_with_another_bias(tmp_path, kind, seed):
    """The bias of the attitude that was wrong kept its sigma: heading 6 to 10 sigmas off."""
    truth = kind(seed, 300.0)
    chip = sensor_errors(0.6, 150.0, 0.15, 1500.0, 5000.0, 0.5)
    data = record(truth, chip, seed, gnss_rate=2.0, sigma=1.0, sigma_v=0.1)
    bias = np.radians(0.5) * np.random.default_rng(seed).standard_normal(3)
    log = write(tmp_path / "log.mcap", replace(data, gyro=data.gyro + bias / RATE))
    answer, status, _ = process(log, truth, [])
    assert answer is not None and status == 0
    assert np.abs(answer.error[:, 8] / answer.sigma[:, 8]).max() < 4.0
