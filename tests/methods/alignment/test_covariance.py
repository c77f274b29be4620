import numpy as np
import pytest

from sinstool.core import rotation
from sinstool.methods.alignment.covariance import (
    attitude_covariance,
    drifting_noise,
    geometry,
    triad_attitude,
    triad_covariance,
    worst_sigma,
)
from sinstool.methods.alignment.inflight_types import AlignmentSettings
from sinstool.methods.alignment.solution import (
    Segment,
    make_pairs,
    solution_covariance,
    solve,
    sums_so_far,
)
from sinstool.methods.sensor_errors import SensorGrade
from tests.methods.alignment.launches import exact
from tests.methods.alignment.segments import segment_of

SIZES = {"gyro_bias": 1e-6, "accel_bias": 1e-3, "gyro_scale": 1e-5, "accel_scale": 1e-5}
NOTHING = {**dict.fromkeys(SIZES, 0.0), "angle_random_walk": 0.0, "velocity_random_walk": 0.0}


def with_error(imu, name, axis):
    step = np.diff(imu.time_ns, prepend=2 * imu.time_ns[0] - imu.time_ns[1])[:, None] * 1e-9
    theta, velocity = imu.delta_theta.copy(), imu.delta_velocity.copy()
    size = SIZES[name] * np.eye(3)[axis]
    if name == "gyro_bias":
        theta += size * step
    elif name == "gyro_scale":
        theta *= 1.0 + size
    elif name == "accel_bias":
        velocity += size * step
    else:
        velocity *= 1.0 + size
    return type(imu)(imu.time_ns, theta, velocity)


@pytest.mark.parametrize("kind", ["win", "int", "cen", "diffc", "pos", "triad"])
@pytest.mark.parametrize("name", SIZES)
def test_what_sensor_errors_do(kind, name):
    # Put an error into the samples: the attitude moves by what the covariance says of it,
    # at the end of the segment and at its start. The frame was frozen 36 s earlier.
    method, kind = ("triad", "int") if kind == "triad" else ("svd", kind)
    _, imu, gnss = exact()
    settings = AlignmentSettings(
        vectors=kind, method=method, kappa=1.0, gnss_sigma_v=1e-9, gnss_sigma_p=1e-9,
        gnss_drift_p=1e-9, grade=SensorGrade(**{**NOTHING, name: SIZES[name]}),
    )  # fmt: skip

    def attitude(imu, row):
        segment = segment_of(imu, gnss, 36.0, 100.0, sigma=1e-9)
        solution = solve(segment, settings)
        q = rotation.to_dcm(segment.rows.q[row])
        return segment, solution, solution.dcm @ q

    for row in (-1, 0):
        segment, solution, before = attitude(imu, row)
        moved = []
        for axis in range(3):
            after = attitude(with_error(imu, name, axis), row)[2]
            turn = solution.dcm.T @ after @ before.T @ solution.dcm  # in ib0, as the covariance
            moved.append(rotation.log(rotation.from_dcm(turn)))
        expected = np.array(moved).T @ np.array(moved)
        at = segment.rows.rows(slice(row, None if row == -1 else row + 1))
        actual = solution_covariance(solution, segment, at, settings)
        assert np.abs(expected).max() > 1e-13
        assert np.abs(actual - expected).max() < 0.02 * np.abs(expected).max()


@pytest.mark.parametrize("kind", ["win", "cen"])
def test_angle_random_walk(kind):
    # 1 deg/sqrt(h) and all else perfect: the attitude found wanders as told, all in all.
    _, imu, gnss = exact(rate_hz=50.0)
    rng = np.random.default_rng(8)
    walk = np.deg2rad(1.0) / 60.0
    settings = AlignmentSettings(
        vectors=kind, gnss_sigma_v=1e-6, kappa=1.0,
        grade=SensorGrade(**{**NOTHING, "angle_random_walk": walk}),
    )  # fmt: skip
    squares = []
    clean = segment_of(imu, gnss, 40.0, sigma=1e-6)
    true = clean.dcm_ni()[-1] @ solve(clean, settings).dcm @ rotation.to_dcm(clean.rows.q[-1])
    for _ in range(60):
        theta = imu.delta_theta + walk * np.sqrt(0.02) * rng.normal(size=(len(imu), 3))
        segment = segment_of(
            type(imu)(imu.time_ns, theta, imu.delta_velocity), gnss, 40.0, sigma=1e-6
        )
        solution = solve(segment, settings)
        at = segment.rows.rows(slice(-1, None))
        result = segment.dcm_ni()[-1] @ solution.dcm @ rotation.to_dcm(segment.rows.q[-1])
        error = rotation.log(rotation.from_dcm(result @ true.T))
        covariance = solution_covariance(solution, segment, at, settings)
        squares.append(error @ error / np.trace(covariance))
    assert 0.5 < np.mean(squares) < 2.0


def test_noise_of_drifting_positions():
    _, imu, gnss = exact()
    segment = segment_of(imu, gnss, 40.0, 70.0)
    uneven = np.ones(len(segment), dtype=bool)
    uneven[50:90] = False
    segment = segment.take(uneven)
    pairs = make_pairs(segment, AlignmentSettings(vectors="pos"))
    time = segment.rows.time_s
    d = pairs.weight[:, None] * pairs.alpha
    r = 4.0 * np.exp(-np.abs(time[:, None] - time) / 20.0) + 0.25 * np.eye(len(time))
    np.testing.assert_allclose(drifting_noise(pairs, time, 0.5, 2.0, 20.0), d.T @ r @ d, rtol=1e-9)


def test_centred_vectors_have_the_information_matrix():
    # For white noise without sensor errors: sigma^2 (tr M I - M)^-1, Markley & Mortari.
    _, imu, gnss = exact()
    segment = segment_of(imu, gnss, 40.0)
    settings = AlignmentSettings(vectors="cen")
    sums = sums_so_far(segment, settings)
    zero = np.zeros((len(segment), 3, 3))
    p = attitude_covariance(sums, zero, zero, np.zeros(len(segment)), SensorGrade(**NOTHING), 1.0)
    m = sums.second[-1]
    np.testing.assert_allclose(p[-1], 0.01 * np.linalg.inv(np.trace(m) * np.eye(3) - m), rtol=1e-6)


def test_parallel_vectors_leave_one_axis_open():
    _, imu, gnss = exact()
    segment = segment_of(imu, gnss, 40.0, 60.0)
    force = np.array([0.3, -2.0, -9.0])
    time = segment.rows.time_s[:, None] - segment.rows.time_s[0]
    rows = type(segment.rows)(**{**vars(segment.rows), "alpha": force * time})
    segment = Segment(**{**vars(segment), "rows": rows})
    sums = sums_so_far(segment, AlignmentSettings())
    zero = np.zeros((len(segment), 3, 3))
    p = attitude_covariance(sums, zero, zero, np.zeros(len(segment)), SensorGrade(**NOTHING), 1.0)
    values, axes = np.linalg.eigh(p[-1])
    assert np.sqrt(values[1]) < 0.01
    # What is open is the turn about the force.
    assert abs(axes[:, 2] @ force) / np.linalg.norm(force) > 0.9999
    assert worst_sigma(p[-1]) > np.pi
    assert geometry(sums.second[-1]) < 1e-6


def test_geometry_and_worst():
    np.testing.assert_allclose(geometry(np.diag([1.0, 4.0, 0.0])), np.sqrt(1.0 / 5.0))
    assert geometry(np.eye(3)) == 1.0
    turn = rotation.to_dcm(rotation.normalise([0.3, 0.2, -0.4, 0.8]))
    assert worst_sigma(turn @ np.diag([1.0, 9.0, 4.0]) @ turn.T) == pytest.approx(3.0)
    assert worst_sigma(-np.eye(3)) == np.inf


@pytest.mark.parametrize("which", ["first", "middle", "last"])
def test_what_noise_of_a_fix_does_to_triad(which):
    """Put noise into one velocity: the attitude moves by what the covariance says of it."""
    _, imu, gnss = exact()
    rows = segment_of(imu, gnss, 36.0, 100.0, sigma=1e-9).rows
    turned = rotation.to_dcm(rotation.exp(np.array([0.3, -1.0, 2.0])))
    beta = rows.alpha @ turned.T
    ends = np.array([len(rows.time_s) - 1])
    before, middle = triad_attitude(rows, beta, ends)
    row = {"first": 0, "middle": middle[0], "last": ends[0]}[which]
    noise = 1e-4 * np.linalg.norm(rows.alpha[middle[0]] - rows.alpha[0])
    moved = []
    for axis in range(3):
        other = beta.copy()
        other[row] += noise * turned[:, axis]
        after, _ = triad_attitude(rows, other, ends)
        moved.append(rotation.log(rotation.from_dcm(before[0].T @ after[0])))
    expected = np.array(moved).T @ np.array(moved)
    sigma = np.zeros(len(rows.time_s))
    sigma[row] = noise
    grade = SensorGrade(**NOTHING)
    actual = triad_covariance(rows, sigma, middle, ends, ends, grade, 0.0)[0]
    assert np.abs(actual - expected).max() < 0.01 * np.abs(expected).max()
