import numpy as np
import pytest

from sinstool.core import earth, rotation
from sinstool.core.earth import ecef
from sinstool.methods.strapdown.attitude import AttitudePropagator
from sinstool.simulation.launch import launch, launch_profile
from sinstool.simulation.profile import Profile, Ramp, Step, Wave, fly, harmonic_gravity_n
from sinstool.simulation.sensors import launch_grade, saturated, with_errors
from sinstool.simulation.truth import sample_times

DEGREE = np.pi / 180.0
RATE = 7.292115e-5
DATE_LINE = {"latitude": 78.0 * DEGREE, "longitude": 179.9 * DEGREE, "azimuth": 80.0 * DEGREE}
SOUTH = {"latitude": -54.0 * DEGREE, "longitude": -68.0 * DEGREE, "azimuth": -150.0 * DEGREE}


@pytest.fixture(scope="module")
def flight():
    return launch()


def q_en(latitude, longitude):
    """NED in Earth axes, from the rows of the textbook matrix (Groves eq. 2.150)."""
    sl, cl, so, co = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    zero = np.zeros_like(sl)
    rows = [[-sl * co, -so, -cl * co], [-sl * so, co, -cl * so], [cl, zero, -sl]]
    return rotation.from_dcm(np.moveaxis(np.array(rows), -1, 0))


def inertial(trajectory, q_first):
    """Attitude of NED in the Earth's axes as they were at row ``q_first``."""
    t = (trajectory.time_ns - trajectory.time_ns[q_first]) * 1e-9
    spin = rotation.exp(t[:, None] * np.array([0.0, 0.0, RATE]))
    return rotation.multiply(spin, q_en(trajectory.latitude, trajectory.longitude))


def consistency(trajectory, first):
    """Attitude from increments against truth, and integrated velocity against specific force.

    The equations that Qu et al. align with, (3) and (4), from row ``first`` on, with the second
    order of rotation besides (rolling at 60 deg/s for 10 s makes 3e-4 m/s of it); rad and m/s.
    """
    imu = trajectory.imu
    q_in = inertial(trajectory, first)
    q_ib = rotation.multiply(q_in, imu.q_nb)
    dtheta, dv = imu.gyro_increment, imu.mean_specific_force * imu.interval[:, None]
    k = np.arange(first + 1, len(dtheta))
    phi = dtheta[k] + np.cross(dtheta[k - 1], dtheta[k]) / 12.0
    attitudes = AttitudePropagator([1.0, 0, 0, 0]).push(phi, imu.interval[k])
    expected = rotation.multiply(rotation.conjugate(q_ib[first]), q_ib[k])
    attitude = rotation.log(rotation.multiply(attitudes, rotation.conjugate(expected)))
    turned = (
        dv[k]
        + 0.5 * np.cross(dtheta[k], dv[k])
        + np.cross(dtheta[k], np.cross(dtheta[k], dv[k])) / 6.0
        + (np.cross(dtheta[k - 1], dv[k]) + np.cross(dv[k - 1], dtheta[k])) / 12.0
    )
    before = np.concatenate([[[1.0, 0, 0, 0]], attitudes[:-1]])
    alpha = np.cumsum(rotation.rotate(before, turned), axis=0)
    v, lat, h = trajectory.velocity_n, trajectory.latitude, trajectory.height
    change = np.cross(earth.earth_rate_n(lat), v) - earth.gravity_n(lat, h)
    change = rotation.rotate(q_in, change)[first:]
    dt = imu.interval[k][:, None]
    beta = rotation.rotate(q_in, v)[first:] - rotation.rotate(q_in[first], v[first])
    beta = beta[1:] + np.cumsum(0.5 * (change[1:] + change[:-1]) * dt, axis=0)
    left = beta - rotation.rotate(q_ib[first], alpha)
    return np.linalg.norm(attitude, axis=1).max(), np.linalg.norm(left, axis=1).max()


def test_the_flight_has_the_published_dynamics(flight):
    t = flight.time_ns * 1e-9
    force, rate = flight.imu.mean_specific_force, flight.imu.gyro_mean_rate
    size, turn = np.linalg.norm(force, axis=1), np.linalg.norm(rate, axis=1) / DEGREE
    jerk = np.linalg.norm(np.diff(force, axis=0, prepend=force[:1]), axis=1) / 0.005
    jolt = np.linalg.norm(np.diff(rate, axis=0, prepend=rate[:1]), axis=1) / 0.005 / DEGREE

    def largest(values, begin, end):
        return values[(t >= begin) & (t <= end)].max()

    assert 190.0 < largest(size, 0, 30) < 200.0
    assert 980.0 < largest(jerk, 0, 30) < 2700.0
    assert 220.0 < largest(turn, 0, 30) < 224.0
    assert 1000.0 < largest(jolt, 0, 30) < 1400.0
    assert largest(turn, 40, 76) < 1.5 and largest(turn, 86.1, 110) < 1.5
    assert 8.0 <= 0.005 * np.sum((turn > 40.0) & (t > 70) & (t < 90)) < 9.0
    assert 60.0 < largest(turn, 110, 130) < 63.0
    assert 140.0 < largest(jolt, 110, 130) < 150.0
    assert largest(turn, 131, 260) < 1.5
    # calm by every limit of the gate from 40 s on, but for the rolls
    calm = (size < 12.0) & (jerk < 100.0) & (turn < 5.0) & (jolt < 100.0)
    assert calm[(t >= 40) & (t < 76)].all() and calm[(t > 131)].all()
    assert not calm[(t > 1) & (t < 24)].any()
    assert 900.0 < largest(np.linalg.norm(flight.velocity_n, axis=1), 0, 40) < 950.0


@pytest.mark.slow
@pytest.mark.parametrize("where", [{}, DATE_LINE, SOUTH], ids=["default", "date line", "south"])
def test_attitude_and_velocity_agree_with_the_increments(where):
    flight = launch(**where)
    attitude, velocity = consistency(flight, 40 * 200)
    assert attitude < 4e-10 and velocity < 5e-4
    attitude, velocity = consistency(flight, 0)
    # one sample and the previous do not take all of coning at 17 Hz and of turns at 220 deg/s
    assert attitude < 1.4e-6 and velocity < 2e-3


@pytest.mark.parametrize("where", [{}, DATE_LINE, SOUTH], ids=["default", "date line", "south"])
def test_position_is_the_integral_of_velocity(where):
    flight = launch(100.0, 120.0, **where)
    r = ecef(flight.latitude, flight.longitude, flight.height)
    v = rotation.rotate(q_en(flight.latitude, flight.longitude), flight.velocity_n)
    dt = 0.01
    # Simpson's rule over pairs of steps once the vibration is over
    k = np.arange(3000, len(r) - 2, 2)
    moved = np.cumsum((v[k] + 4.0 * v[k + 1] + v[k + 2]) * dt / 3.0, axis=0)
    np.testing.assert_allclose(r[k + 2] - r[3000], moved, atol=2e-5)
    assert np.abs(flight.longitude).max() <= np.pi
    if where is DATE_LINE:
        assert flight.longitude.min() < -3.0 and flight.longitude.max() > 3.0


def test_increments_add_up_and_instants_are_their_derivatives(flight):
    fine = launch(1000.0, 60.0)
    for name in ("gyro_increment", "mean_specific_force"):
        coarse, dense = getattr(flight.imu, name), getattr(fine.imu, name)
        factor = 5 if name == "gyro_increment" else 1
        dense = dense[1:].reshape(-1, 5, 3).mean(axis=1) * factor
        # four nodes in 5 ms leave 6e-9 of a vibration at 43 Hz
        np.testing.assert_allclose(coarse[1 : len(dense) + 1], dense, rtol=1e-9, atol=4e-8)
    # the attitude's rate by central differences over 2 ms
    q = rotation.multiply(inertial(fine, 0), fine.imu.q_nb)
    across = rotation.log(rotation.multiply(rotation.conjugate(q[:-2]), q[2:])) / 0.002
    late = np.arange(len(across)) > 35_000
    np.testing.assert_allclose(across[late], fine.imu.gyro_rate[1:-1][late], atol=1e-7)
    np.testing.assert_allclose(across, fine.imu.gyro_rate[1:-1], atol=2e-3)
    middle = 0.5 * (fine.imu.mean_specific_force[1:-1] + fine.imu.mean_specific_force[2:])
    np.testing.assert_allclose(fine.imu.specific_force[1:-1][late], middle[late], atol=1e-4)


def test_two_gravities_agree():
    latitude = np.linspace(-1.5, 1.5, 31)
    for height in (0.0, 1e4, 2e4):
        other = earth.gravity_n(latitude, height)
        got = harmonic_gravity_n(latitude, np.full(31, height))
        np.testing.assert_allclose(got, other, atol=2e-6)
    np.testing.assert_allclose(
        harmonic_gravity_n(np.array([0.0]), np.zeros(1))[0, 2], 9.7803253359, atol=2e-8
    )


@pytest.mark.parametrize(
    "term",
    [
        Step(1.0, 2.0, 3.0),
        Ramp(1.0, 2.0, -3.0),
        Wave(0.7, 2.1, 0.4, (Step(0.5, 2.0, 1.0), Step(4.0, 1.5, -0.6))),
    ],
)
def test_rates_of_terms_are_derivatives(term):
    t = np.linspace(0.0, 7.0, 7001)
    value, rate = term.at(t)
    np.testing.assert_allclose(np.gradient(value, t)[1:-1], rate[1:-1], atol=2e-5)
    assert value[0] == 0.0 and np.abs(value).max() > 0.5


def test_dynamics_scale_the_gentle_part_only(flight):
    double = launch(200.0, 140.0, dynamics=2.0)
    none = launch(200.0, 140.0, dynamics=0.0)
    rows = slice(0, 35 * 200)
    np.testing.assert_array_equal(double.imu.q_nb[rows], flight.imu.q_nb[rows])
    later = slice(45 * 200, 75 * 200)
    one = flight.velocity_n[later] - none.velocity_n[later]
    two = double.velocity_n[later] - none.velocity_n[later]
    ratio = np.linalg.norm(two, axis=1).max() / np.linalg.norm(one, axis=1).max()
    assert ratio == pytest.approx(2.0, rel=0.05)


def test_straight_flight_keeps_the_direction_of_force():
    straight = launch(200.0, 140.0, straight=True)
    rows = slice(45 * 200, None)
    np.testing.assert_allclose(np.ptp(straight.velocity_n[rows, 2]), 0.0, atol=1e-9)
    force = rotation.rotate(straight.imu.q_nb[rows], straight.imu.specific_force[rows])
    assert np.ptp(force, axis=0).max() < 0.02
    assert np.linalg.norm(straight.imu.gyro_rate[rows], axis=1).max() < 0.02 * DEGREE


def test_rest_on_the_pad():
    padded = launch(100.0, 20.0, pad_s=5.0, start_ns=7, latitude=-0.4)
    plain = launch(100.0, 20.0, latitude=-0.4)
    assert padded.time_ns[0] == 7 and len(padded.time_ns) == 2501
    rest = slice(0, 500)
    assert not padded.velocity_n[rest].any()
    felt = rotation.rotate(padded.imu.q_nb[rest], padded.imu.mean_specific_force[rest])
    np.testing.assert_allclose(felt, np.tile(-earth.gravity_n(-0.4, 1000.0), (500, 1)), atol=2e-6)
    np.testing.assert_allclose(padded.imu.gyro_increment[501:], plain.imu.gyro_increment[1:])
    np.testing.assert_allclose(padded.latitude[500:], plain.latitude, atol=1e-14)


def test_any_profile_flies():
    """A level circle: centripetal force, and a turn of the body once round."""
    profile = Profile((Step(-9.0, 1.0, 50.0),), (), (Ramp(-9.0, 1.0, 0.1),), (), (), ())
    circle = fly(profile, sample_times(50.0, 62.0), 0, (0.5, 0.1, 100.0), -0.2)
    force = circle.imu.specific_force
    np.testing.assert_allclose(force[:, 1], 5.0, atol=0.01)  # Coriolis: 2 omega v = 7e-3
    np.testing.assert_allclose(force[:, 2], -earth.normal_gravity(0.5, 100.0), atol=0.01)
    begin, end = circle.imu.q_nb[0], circle.imu.q_nb[-1]
    turned = np.mod(rotation.to_euler(end)[2] - rotation.to_euler(begin)[2], 2.0 * np.pi)
    assert turned == pytest.approx(6.2, abs=1e-9)
    r = ecef(circle.latitude, circle.longitude, circle.height)
    assert np.linalg.norm(r - r[0], axis=1).max() == pytest.approx(1000.0, rel=1e-3)


@pytest.mark.parametrize(("rate", "duration"), [(0.0, 10.0), (100.0, -1.0)])
def test_impossible_flights(rate, duration):
    with pytest.raises(ValueError):
        launch(rate, duration)
    assert launch_profile().speed


def test_grades_are_the_published_ones():
    set_up, meant = launch_grade("10", "m/s^2"), launch_grade("10", "g")
    assert set_up.gyro_bias == set_up.gyro_instability == pytest.approx(10.0 * DEGREE / 3600.0)
    assert set_up.accel_bias == 0.005 and meant.accel_instability == pytest.approx(0.04903325)
    assert meant.gyro_scale == 3e-4 and launch_grade("1", "g").accel_scale == 1e-4
    assert launch_grade("0.01", "g").gyro_scale == 1e-5
    assert meant.gyro_misalignment == 1.5e-4 and meant.bias_time_s == 100.0
    assert meant.angle_random_walk * 60.0 == pytest.approx(0.3 * DEGREE)
    assert meant.velocity_random_walk == pytest.approx(150e-6 * 9.80665)


def test_clipping_takes_what_is_beyond_the_range(flight):
    noisy = with_errors(flight.imu, launch_grade("1", "g"), 3)
    clipped = saturated(noisy, 200.0 * DEGREE)
    within = (np.abs(noisy.gyro_mean_rate) < 200.0 * DEGREE).all(axis=1)
    assert 1000 < (~within).sum() < 2000  # 8 s of roll
    np.testing.assert_allclose(clipped.gyro_increment[within], noisy.gyro_increment[within])
    assert np.abs(clipped.gyro_increment).max() == pytest.approx(200.0 * DEGREE * 0.005)
    np.testing.assert_array_equal(clipped.q_nb, noisy.q_nb)
