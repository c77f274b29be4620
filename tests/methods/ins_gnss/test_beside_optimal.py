"""The filter beside an optimal one, with the same noise, on drives by another program."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.core.rotation import from_dcm, to_dcm
from sinstool.core.streams import GnssEpochs
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.settings import DivergenceControl, GnssModel, Settings, Start
from sinstool.methods.sensor_errors import SensorGrade
from sinstool.methods.strapdown.velocity import Increments
from tests.helpers.optimal_filter import navigate
from tests.helpers.unseen_drives import (
    FIRST,
    GRADES,
    RATE,
    drive,
    first_state,
    frozen,
    record,
    within,
    without_samples,
)

pytestmark = pytest.mark.slow
T0 = 10**18
OUTAGES = [(300.0, 360.0), (450.0, 510.0)]


@pytest.fixture(scope="module")
def road():
    return drive(seed=1, duration=600.0)


def same_noise(errors):
    """Settings of the exact noise; a hundredth of what is white in the fixes lasts."""
    imu = SensorGrade(
        gyro_bias=errors.gyro_bias,
        accel_bias=errors.accel_bias,
        gyro_scale=errors.gyro_scale,
        accel_scale=errors.accel_scale,
        angle_random_walk=errors.angle_random_walk,
        velocity_random_walk=errors.velocity_random_walk,
        bias_time_s=errors.time,
        gyro_instability=errors.gyro_bias,
        accel_instability=errors.accel_bias,
        scale_wander=1.0,
    )
    gnss = GnssModel(position_white=(0.0497,) * 3, position_markov=(0.005,) * 3)
    return Settings("markov-27", imu, gnss, control=DivergenceControl(virtual_noise=False))


def navigated(data, grade, seed, settings, hidden=()):
    """Answer of the filter at all samples, and the run."""
    at = first_state(data.truth, data.errors, seed, FIRST[grade])
    place = [at.latitude[0], at.longitude[0], at.height[0], *at.velocity_n[0]]
    p = at.covariance[0]
    begin = Start(
        np.concatenate([place, from_dcm(at.c_nb[0])]),
        *(p[k : k + 3, k : k + 3] for k in (0, 3, 6)),
        gyro_bias_sigma=data.errors.gyro_bias,
        accel_bias_sigma=data.errors.accel_bias,
    )
    stamps, fixes = T0 + np.round(data.fixes.seconds * 1e9).astype(np.int64), data.fixes
    none = np.full((len(stamps), 3), np.nan)
    gnss = GnssEpochs(
        stamps, stamps, fixes.latitude, fixes.longitude, fixes.height, none, none + 0.05, none
    )
    gnss = replace(gnss, sigma_position_n=np.full((len(stamps), 3), fixes.sigma))
    turn, push = data.gyro[1:], data.accel[1:]
    turn0, push0 = (np.vstack([a[:1], a[:-1]]) for a in (turn, push))
    phi = turn + np.cross(turn0, turn) / 12.0
    swept = push + np.cross(turn, push) / 2.0
    swept += (np.cross(turn0, push) + np.cross(push0, turn)) / 12.0
    step = np.minimum(np.diff(data.seconds), 1.0 / RATE)
    time_ns = T0 + np.round(data.seconds[1:] * 1e9).astype(np.int64)
    increments = Increments(np.arange(1, len(data.seconds)), time_ns, step, phi, swept)
    run = InsGnssFilter(begin, settings, with_baro=False)
    answer = run.push(increments, gnss, within(fixes.seconds, hidden)).updates
    return answer, run


def errors_at(data, answer):
    """Truth less answer at the samples, (n, 9), and its sigma."""
    seconds = (answer.time_ns - T0) * 1e-9
    where = answer.latitude, answer.longitude, answer.height, answer.velocity_n
    error = data.truth.errors_of(seconds, *where, to_dcm(answer.q_nb))
    blocks = (
        answer.covariance_position_n,
        answer.covariance_velocity_n,
        answer.covariance_attitude_n,
    )
    sigma = np.hstack([np.sqrt(np.einsum("kii->ki", block)) for block in blocks])
    return seconds, error, sigma


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


@pytest.mark.parametrize("grade", GRADES)
def test_as_accurate_as_the_optimal_filter(road, grade):
    ours, best, ratios, reference_ratios = [], [], [], []
    for seed in (1, 2, 3):
        data = record(road, GRADES[grade], seed)
        settings = replace(same_noise(data.errors), lever_arm_b=tuple(data.lever))
        answer, run = navigated(data, grade, seed, settings, OUTAGES)
        assert run.summary.restarts == 0
        seconds, error, sigma = errors_at(data, answer)
        start = first_state(road, data.errors, seed, FIRST[grade])
        used = data.fixes.rows(~within(data.fixes.seconds, OUTAGES))
        ref = navigate(
            data.seconds, data.gyro, data.accel, used, start, data.errors, data.lever
        ).after
        at = (ref.latitude, ref.longitude, ref.height, ref.velocity_n, ref.c_nb)
        optimal = road.errors_of(ref.seconds, *at)
        mask = (seconds > 200.0) & ~within(seconds, [(b, e + 20.0) for b, e in OUTAGES])
        rows = (ref.seconds > 200.0) & ~within(ref.seconds, [(b, e + 20.0) for b, e in OUTAGES])
        ends = [np.searchsorted(seconds, end) - 1 for _, end in OUTAGES]
        last = [np.searchsorted(ref.seconds, end) - 1 for _, end in OUTAGES]
        ours.append([rms(error[mask, :2]), rms(error[mask, 8]), rms(error[ends, :2])])
        best.append([rms(optimal[rows, :2]), rms(optimal[rows, 8]), rms(optimal[last, :2])])
        ratios.append((error / sigma)[mask])
        spread = np.sqrt(np.diagonal(ref.covariance, axis1=1, axis2=2)[:, :9])
        reference_ratios.append((optimal / spread)[rows])
    mean, reference = rms_of(ours), rms_of(best)
    assert np.all(mean < 1.1 * reference), (mean, reference)
    off, known = np.concatenate(ratios), np.concatenate(reference_ratios)
    for part in (slice(0, 3), slice(3, 6), slice(6, 8), slice(8, 9)):
        assert 0.8 < rms(off[:, part]) / rms(known[:, part]) < 1.25


def rms_of(draws):
    return np.sqrt(np.mean(np.square(draws), axis=0))


def test_a_wrong_lever_arm_costs_no_more_than_itself(road):
    data = record(road, GRADES["tactical"], 1)
    settings = replace(same_noise(data.errors), lever_arm_b=tuple(data.lever + np.eye(3)[0]))
    answer, _ = navigated(data, "tactical", 1, settings)
    seconds, error, _ = errors_at(data, answer)
    assert rms(error[seconds > 200.0, :2]) < 3.0


def test_a_way_back_after_a_gap(road):
    data = without_samples(record(road, GRADES["tactical"], 1), 300.0, 10.0)
    settings = replace(same_noise(data.errors), lever_arm_b=tuple(data.lever))
    answer, _ = navigated(data, "tactical", 1, settings)
    seconds, error, sigma = errors_at(data, answer)
    late = seconds > 400.0
    assert np.abs(error[late, :2]).max() < 3.0
    after = seconds > 310.0
    far = np.abs(error[after]) / sigma[after]
    assert np.percentile(far, 99.0) < 5.0


def test_a_receiver_that_hangs_causes_no_restart(road):
    data = frozen(record(road, GRADES["tactical"], 1), 300.0, 30.0)
    settings = replace(same_noise(data.errors), lever_arm_b=tuple(data.lever))
    answer, run = navigated(data, "tactical", 1, settings)
    seconds, error, _ = errors_at(data, answer)
    assert run.summary.restarts == 0
    assert np.abs(error[seconds > 200.0, :2]).max() < 2.0


def test_too_good_a_grade_is_survived(road):
    """Sensors thirty times worse than the filter believes: it begins anew, and finds back."""
    data = record(road, GRADES["industrial"], 2)
    settings = replace(same_noise(GRADES["tactical"]), lever_arm_b=tuple(data.lever))
    answer, run = navigated(data, "tactical", 2, settings)
    seconds, error, _ = errors_at(data, answer)
    assert run.summary.restarts > 0
    # Its first five minutes are for the diagnosis
    assert rms(error[seconds > 400.0, :2]) < 3.0
