"""The yardstick itself: the reference filter knows its errors, and its logs are what they say."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.helpers.filter_logs import run
from tests.helpers.optimal_filter import navigate, smooth
from tests.helpers.unseen_drives import (
    FIRST,
    GRADES,
    LEVER,
    PERFECT,
    drive,
    first_state,
    flight,
    record,
    within,
    without_fixes,
    without_samples,
)
from tests.helpers.unseen_drives import write as write_log

DRAWS = range(4)
OUTAGE = (150.0, 180.0)


@pytest.fixture(scope="module")
def road():
    return drive(seed=1, duration=240.0, rest=20.0)


def start_of(data, grade, seed):
    return first_state(data.truth, data.errors, seed, FIRST[grade])


def errors_of(truth, at):
    return truth.errors_of(at.seconds, at.latitude, at.longitude, at.height, at.velocity_n, at.c_nb)


def nees(truth, at, rows):
    """Normalised squared error of the nine states of the vehicle, over nine."""
    e, p = errors_of(truth, at)[rows], at.covariance[rows, :9, :9]
    unit = np.sqrt(np.diagonal(p, axis1=1, axis2=2))
    e, p = e / unit, p / (unit[:, :, None] * unit[:, None, :])
    return np.mean(np.sum(e * np.linalg.solve(p, e[:, :, None])[:, :, 0], axis=1)) / 9.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["drive", "smooth flight", "turbulent flight"])
def test_error_free_data_navigates_exactly(road, kind):
    truth = road if kind == "drive" else flight(2, 60.0, turbulent=kind.startswith("turbulent"))
    data = without_fixes(record(truth, PERFECT, 0), [(0.0, 1e9)])
    exact = replace(
        start_of(data, "tactical", 0),
        **{name: getattr(truth, name)[:1] for name in ("latitude", "longitude", "height")},
        velocity_n=truth.velocity_n[:1],
        c_nb=truth.c_nb[:1],
    )
    ran = navigate(
        data.seconds, data.gyro, data.accel, data.fixes, exact, GRADES["tactical"], LEVER
    )
    largest = np.abs(errors_of(truth, ran.after)).max(axis=0)
    assert largest[:3].max() < 0.05
    assert largest[3:6].max() < 5e-4
    assert largest[6:].max() < 2e-6


@pytest.mark.slow
@pytest.mark.parametrize("grade", ["tactical", "industrial"])
def test_reference_filter_and_smoother_know_their_errors(road, grade):
    filtered, smoothed, in_outage, better = [], [], [], []
    for seed in DRAWS:
        data = without_fixes(record(road, GRADES[grade], seed, sigma_v=0.1), [OUTAGE])
        ran = navigate(
            data.seconds,
            data.gyro,
            data.accel,
            data.fixes,
            start_of(data, grade, seed),
            data.errors,
            LEVER,
        )
        back = smooth(ran)
        rows = np.arange(100, len(back), 10)
        hidden = np.flatnonzero(within(back.seconds, [OUTAGE]))[::10]
        filtered.append(nees(road, ran.after, rows))
        smoothed.append(nees(road, back, rows))
        in_outage.append(nees(road, ran.after, hidden))
        sizes = [np.abs(errors_of(road, at)[hidden, :2]).max() for at in (ran.after, back)]
        better.append(sizes[1] < sizes[0])
    assert np.mean(filtered) == pytest.approx(1.0, abs=0.3)
    assert np.mean(smoothed) == pytest.approx(1.0, abs=0.3)
    assert np.mean(in_outage) == pytest.approx(1.0, abs=0.5)
    assert np.mean(better) > 0.5


def test_reference_finds_its_way_after_a_gap_of_the_imu(road):
    data = without_samples(record(road, GRADES["tactical"], 0), 120.0, 10.0)
    start = start_of(data, "tactical", 0)
    ran = navigate(data.seconds, data.gyro, data.accel, data.fixes, start, data.errors, LEVER)
    error = np.abs(errors_of(road, ran.after))
    assert not np.any((ran.after.seconds > 120.01) & (ran.after.seconds < 129.99))
    late = ran.after.seconds > 190.0
    assert error[late, :2].max() < 0.3


@pytest.mark.slow
def test_product_navigates_an_error_free_log_to_the_truth(road, tmp_path):
    data = record(road, PERFECT, 0, sigma=0.0)
    data = replace(data, fixes=replace(data.fixes, sigma=0.01))
    log = write_log(tmp_path / "drive.mcap", data)
    _, result = run(
        log,
        input={"gyro_kind": "mean-rate"},
        gnss={"lever_arm": tuple(LEVER.tolist()), "gnss_latency": 0.0},
        filter={"smooth": True},
        navigation={"mode": "ins-gnss", "imu_grade": "tactical"},
    )
    seconds = (result.time_ns - result.time_ns[0]) * 1e-9
    error = road.errors_of(
        seconds,
        *result.position.T,
        result.velocity_n,
        Rotation.from_quat(result.q_nb, scalar_first=True).as_matrix(),
    )
    assert np.abs(error[:, :3]).max() < 2e-3
    assert np.abs(error[:, 3:6]).max() < 2e-3
    assert np.abs(error[:, 6:]).max() < 5e-4
