"""Logs in which a filter finds its start late, or by a detour."""

import numpy as np
import pytest

from sinstool.core.finding import exit_status
from sinstool.core.rotation import to_dcm
from sinstool.core.units import DEGREE
from tests.helpers.filter_logs import first_start_of, start_of
from tests.helpers.imulogs import T0
from tests.helpers.unseen_drives import (
    CONSUMER,
    GRADES,
    drive,
    flight,
    record,
    without_samples,
    write,
)
from tests.helpers.unseen_errors import any_mount, slower, turned
from tests.helpers.unseen_vehicles import helicopter, robot, tractor
from tests.pipelines.process.ins_gnss.test_doubtful_logs import navigated

ON_A_MAST = np.array([-0.15, 0.2, -0.4])


@pytest.mark.slow
def test_an_antenna_that_swings_shows_a_latency_of_a_fifth_of_its_swing(tmp_path):
    """About a wrong latency there are other minima: antennas elsewhere explain the swing too."""
    truth = tractor(11, 200.0)
    data = record(truth, GRADES["tactical"], 11, sigma=0.025, sigma_v=0.04, latency=0.1)
    log = write(tmp_path / "log.mcap", data)
    result, _, off, _ = navigated(log, truth, tmp_path / "out.mcap")
    assert exit_status(result.findings) == 0
    assert abs(result.filter.gnss_latency.position_s - 0.1) < 0.005
    assert off.max() < 0.5


@pytest.mark.slow
def test_a_start_after_a_gap_is_at_a_fix(tmp_path):
    """From one fix to the next the antenna swings in ways that neither shows."""
    truth = tractor(13, 230.0)
    whole = record(truth, GRADES["tactical"], 13, sigma=0.025, sigma_v=0.04)
    log = write(tmp_path / "log.mcap", without_samples(whole, 70.0, 5.2))
    result, seconds, off, _ = navigated(log, truth, tmp_path / "out.mcap")
    assert result.filter.epochs_gated == 0
    assert off[seconds > 76.0].max() < 0.5


@pytest.mark.slow
def test_a_flight_that_shows_its_heading_in_short_spans_only(tmp_path):
    truth = flight(4, 150.0)
    data = record(truth, CONSUMER, 16002, sigma=0.83, sigma_v=0.23)
    log = write(tmp_path / "log.mcap", data)
    _, seconds, off, heading = navigated(log, truth, tmp_path / "out.mcap")
    assert off[-1] < 3.0 and np.median(heading[seconds > 100.0]) < 5.0


@pytest.mark.slow
def test_a_filter_starts_from_a_heading_that_an_alignment_alone_refuses(tmp_path):
    truth = flight(1, 150.0)
    data = record(truth, CONSUMER, 1, sigma=0.16, sigma_v=0.28)
    log = write(tmp_path / "log.mcap", data)
    _, _, off, heading = navigated(log, truth, tmp_path / "out.mcap")
    assert off[-1] < 1.0 and heading[-1] < 6.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3])
def test_a_gyro_bias_a_little_beyond_the_ordinary_is_not_taken_for_degrees_a_second(tmp_path, seed):
    """Heading was off by 98 deg in one, with status 0, and by twice its sigma in the other."""
    truth = helicopter(seed, 260.0)
    log = write(tmp_path / "log.mcap", record(truth, CONSUMER, seed, gnss_rate=10.0, sigma=0.9))
    result, _, off, heading = navigated(log, truth, tmp_path / "out.mcap")
    assert np.linalg.norm(result.alignment.gyro_bias_rad_s) < 0.1 * np.pi / 180.0
    assert off[-1] < 2.0 and np.sqrt(np.mean(heading**2)) < 3.0


def test_a_start_at_rest_is_not_put_off_for_want_of_a_sample_at_a_fix(tmp_path):
    """Samples 40 ms apart: no fix was near enough, and a minute at rest lay before the start."""
    truth = drive(3, 150.0, 60.0)
    data = slower(record(truth, CONSUMER, 3, sigma=0.1, sigma_v=0.1), 8)
    log = write(tmp_path / "log.mcap", data)
    begun = start_of(log, input={"gyro_kind": "mean-rate"}, gnss={"gnss_latency": 0.0})
    assert begun.time_ns - T0 < 3 * 10**9


def heading_off(log, truth):
    """By how much the heading of a log's first start is off, rad, and its sigma."""
    begun, _ = first_start_of(log, navigation={"mode": "ins-gnss"})
    start = begun.start
    k = int(np.searchsorted(truth.seconds, (begun.time_ns - T0) / 1e9 - 1e-6))
    off = truth.c_nb[k] @ to_dcm(start.nav[None, 6:10])[0].T
    sigma = float(np.sqrt(start.covariance_attitude_n[2, 2]))
    return float(np.arctan2(off[1, 0] - off[0, 1], off[0, 0] + off[1, 1])), sigma


# How often a second fixes come, and the noise of their velocities, m/s, if they have any
@pytest.mark.slow
@pytest.mark.parametrize("rate, sigma_v", [(1.0, None), (1.0, 0.05), (5.0, None), (10.0, 0.03)])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_slow_robot_with_fixes_of_a_centimetre_shows_its_heading(tmp_path, rate, sigma_v, seed):
    """However its IMU is mounted, and whether it goes forwards or backwards: all were refused.

    Its few changes of velocity are worth less than the sensors' errors, until these are estimated
    with the heading.
    """
    random = np.random.default_rng([seed, 31])
    truth = turned(robot(seed), any_mount(random))
    data = record(
        truth, CONSUMER, seed, gnss_rate=rate, sigma=0.01, sigma_v=sigma_v, lever=ON_A_MAST
    )
    off, sigma = heading_off(write(tmp_path / "log.mcap", data), truth)
    assert sigma < 11.0 * DEGREE and abs(off) < 2.5 * sigma
