"""Whether samples are means or rates shows where fixes are good, or samples long."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.core.rotation import to_dcm
from tests.helpers.filter_logs import run
from tests.helpers.unseen_drives import GRADES, LEVER, T0, drive, multicopter, record, write
from tests.helpers.unseen_errors import slower

ARM = {"lever_arm": tuple(LEVER.tolist())}


def recorded(make, seed, sigma=0.02):
    truth = make(seed, 240.0, rest=20.0) if make is drive else make(seed, 240.0)
    return record(truth, GRADES["industrial"], seed, gnss_rate=5.0, sigma=sigma, sigma_v=0.05)


def at_instants(data, every=4):
    """The same at 50 Hz, each sample the mean over 10 ms about its stamp: as good as a rate."""
    k = np.arange(every - 1, len(data.seconds) - 1, every)
    gyro, accel = (0.5 * (part[k] + part[k + 1]) for part in (data.gyro, data.accel))
    return replace(data, seconds=data.seconds[k], gyro=gyro, accel=accel)


def kinds(result):
    return [finding["kind"] for finding in result["findings"]]


def off(data, solution):
    """Errors after the start: position, velocity and attitude, NED; and over their sigmas."""
    rows = solution.rows((solution.time_ns - T0) * 1e-9 > 30.0)
    seconds = (rows.time_ns - T0) * 1e-9
    error = data.truth.errors_of(seconds, *rows.position.T, rows.velocity_n, to_dcm(rows.q_nb))
    parts = rows.covariance_position_n, rows.covariance_velocity_n, rows.covariance_attitude_n
    sigma = np.sqrt(np.concatenate([np.einsum("nii->ni", part) for part in parts], axis=1))
    return np.sqrt(np.mean(error**2, axis=0)), np.sqrt(np.mean((error / sigma) ** 2, axis=0))


@pytest.mark.slow
@pytest.mark.parametrize("make", [drive, multicopter])
def test_means_are_read_as_means(tmp_path, make):
    """The solution is then that with --gyro-kind, which is several times as good."""
    for seed in range(3):
        data = slower(recorded(make, seed), 4)
        log = write(tmp_path / "log.mcap", data)
        result, solution = run(log, gnss=dict(ARM), filter={"smooth": True})
        told, known = run(
            log, gnss=dict(ARM), filter={"smooth": True}, input={"gyro_kind": "mean-rate"}
        )
        (error, ratio), (least, _) = off(data, solution), off(data, known)
        assert "gyro-kind-used" in kinds(result) and "gyro-kind-used" not in kinds(told)
        assert np.all(error < 1.05 * least) and np.all(ratio < 2.6)


@pytest.mark.slow
@pytest.mark.parametrize("make", [drive, multicopter])
def test_rates_are_read_as_rates(tmp_path, make):
    for seed in range(3):
        log = write(tmp_path / "log.mcap", at_instants(recorded(make, seed)))
        assert "gyro-kind-used" not in kinds(run(log, gnss=dict(ARM))[0])


@pytest.mark.slow
def test_coarse_fixes_show_half_of_a_long_sample(tmp_path):
    """Of 20 ms at 25 Hz, by a latency that no fix has."""
    for seed in range(3):
        data = recorded(drive, seed, sigma=0.5)
        for samples, read in ((slower(data, 8), True), (at_instants(data, 8), False)):
            log = write(tmp_path / "log.mcap", samples)
            assert ("gyro-kind-used" in kinds(run(log, gnss=dict(ARM))[0])) == read


@pytest.mark.slow
def test_coarse_fixes_and_unknown_latencies_show_nothing(tmp_path):
    log = write(tmp_path / "log.mcap", recorded(drive, 1, sigma=0.5))
    assert "gyro-kind-used" not in kinds(run(log, gnss=dict(ARM))[0])
    data = record(drive(1, 240.0, rest=20.0), GRADES["industrial"], 1, gnss_rate=5.0, latency=0.1)
    log = write(tmp_path / "log.mcap", slower(data, 4))
    assert "gyro-kind-used" not in kinds(run(log, gnss=dict(ARM))[0])
