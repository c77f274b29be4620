import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sinstool.core import earth, rotation
from sinstool.methods.coning.registry import algorithm
from sinstool.methods.coning.stage import ConingStage
from sinstool.simulation.drive import road_drive
from sinstool.simulation.flight import SPIRAL_SPEED, manoeuvring_flight, spiral_climb
from sinstool.simulation.sensors import barometer
from sinstool.simulation.travel import COLUMNS, Levels, travel
from sinstool.simulation.truth import sample_times


def to_ecef(flight):
    _, transverse = earth.radii_of_curvature(flight.latitude)
    out = (transverse + flight.height) * np.cos(flight.latitude)
    polar = transverse * (1.0 - earth.ECCENTRICITY_SQUARED) + flight.height
    return np.stack(
        [
            out * np.cos(flight.longitude),
            out * np.sin(flight.longitude),
            polar * np.sin(flight.latitude),
        ],
        axis=-1,
    )


def q_en(flight):
    zero = np.zeros_like(flight.latitude)
    return rotation.multiply(
        rotation.exp(np.stack([zero, zero, flight.longitude], axis=-1)),
        rotation.exp(np.stack([zero, -flight.latitude - 0.5 * np.pi, zero], axis=-1)),
    )


def q_ie(flight):
    t = (flight.time_ns - flight.time_ns[0]) * 1e-9
    zero = np.zeros_like(t)
    return rotation.exp(np.stack([zero, zero, earth.EARTH_RATE * t], axis=-1))


def over_the_pole(rate_hz):
    def motion(t):
        out = np.zeros((len(t), COLUMNS))
        out[:, 0], out[:, 1], out[:, 2] = 200.0, 5.0 * np.sin(0.2 * t), -2.0
        out[:, 4] = np.cos(0.2 * t)
        out[:, 7], out[:, 10] = 0.1 * np.sin(t), 0.1 * np.cos(t)
        out[:, 8], out[:, 11] = 0.05 * t, 0.05
        return out

    return travel(motion, sample_times(rate_hz, 60.0), np.deg2rad(89.95), 2.0, 5000.0, 0.01)


FLIGHTS = {
    "spiral": lambda rate: spiral_climb(120.0, rate, latitude=-0.8, longitude=2.0, heading=1.0),
    "manoeuvres": lambda rate: manoeuvring_flight(120.0, rate, latitude=1.1, longitude=3.14159),
    "drive": lambda rate: road_drive(120.0, rate, latitude=-0.4, still_s=10.0),
    "pole": over_the_pole,
}


@pytest.mark.parametrize("name", FLIGHTS)
def test_specific_force_is_what_moves_it_in_inertial_space(name):
    # Second derivative of the place in inertial axes less gravitation: no Coriolis term, no
    # transport rate, no radius of curvature in it. Differences of the eighth order.
    step = 0.1 if name in ("spiral", "pole") else 0.02
    flight = FLIGHTS[name](1.0 / step)
    place = rotation.rotate(q_ie(flight), to_ecef(flight))
    weights = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72])
    weights = np.concatenate([weights, weights[-2::-1]]) / step**2
    acceleration = np.stack(
        [np.convolve(place[:, i] - place[0, i], weights, "valid") for i in range(3)], axis=-1
    )
    inner = slice(4, -4)
    turn = rotation.multiply(q_ie(flight), q_en(flight))
    gravity = rotation.rotate(turn, earth.gravity_n(flight.latitude, flight.height))
    outward = place.copy()
    outward[:, 2] = 0.0
    gravitation = gravity - earth.EARTH_RATE**2 * outward
    q_ib = rotation.multiply(turn, flight.imu.q_nb)
    expected = rotation.rotate(rotation.conjugate(q_ib[inner]), acceleration - gravitation[inner])
    error = np.abs(expected - flight.imu.specific_force[inner]).max()
    # 1e-9 m of rounding over step**2; and the levels' ninth-degree polynomials have knots
    assert error < 1.2e-8 / step**2 + {"drive": 2e-3, "manoeuvres": 1e-4}.get(name, 0.0)


@pytest.mark.parametrize("name", FLIGHTS)
def test_velocity_is_the_change_of_place(name):
    flight = FLIGHTS[name](50.0)
    place = to_ecef(flight)
    weights = np.array([-1 / 280, 4 / 105, -1 / 5, 4 / 5, 0, -4 / 5, 1 / 5, -4 / 105, 1 / 280])
    change = np.stack([np.convolve(place[:, i], 50.0 * weights, "valid") for i in range(3)], -1)
    velocity = rotation.rotate(q_en(flight), flight.velocity_n)[4:-4]
    assert np.abs(velocity - change).max() < 2e-5


@pytest.mark.parametrize("name", FLIGHTS)
def test_gyro_turns_the_attitude(name):
    # Both kinds of sample, through an algorithm that is tested elsewhere, turn the body in
    # inertial space from each attitude to the next.
    flight = FLIGHTS[name](200.0)
    imu = flight.imu
    q_ib = rotation.multiply(rotation.multiply(q_ie(flight), q_en(flight)), imu.q_nb)
    steps = rotation.log(rotation.multiply(rotation.conjugate(q_ib[:-1]), q_ib[1:]))
    for kind, gyro in (("increment", imu.gyro_increment), ("rate", imu.gyro_rate)):
        nominal = None if kind == "rate" else 0.005
        stage = ConingStage(algorithm("lookahead-8"), kind, nominal_interval=nominal)
        phi = np.concatenate(
            [p.rotation_vector for p in (stage.push(gyro, imu.time_ns), stage.finish())]
        )
        inner = slice(20, -20)
        error = np.abs(phi - steps)[inner]
        assert error.max() < (2e-9 if name == "drive" else 2e-11)


@pytest.mark.parametrize("name", FLIGHTS)
def test_samples_of_half_the_rate_are_sums(name):
    flight = FLIGHTS[name](100.0)
    coarse = FLIGHTS[name](50.0)
    gyro, force = sums_of_two(flight)
    np.testing.assert_allclose(coarse.imu.gyro_increment[1:], gyro, atol=2e-14)
    np.testing.assert_allclose(coarse.imu.mean_specific_force[1:], force, atol=1e-11)
    np.testing.assert_allclose(coarse.latitude, flight.latitude[::2], atol=1e-13)
    np.testing.assert_allclose(coarse.height, flight.height[::2], atol=1e-9)
    np.testing.assert_allclose(coarse.imu.q_nb, flight.imu.q_nb[::2], atol=1e-9)


def sums_of_two(flight):
    """Increments and mean specific forces over pairs of intervals, from row 1 on."""
    n = (len(flight.time_ns) - 1) // 2
    gyro = flight.imu.gyro_increment[1 : 2 * n + 1].reshape(n, 2, 3).sum(axis=1)
    force = flight.imu.mean_specific_force[1 : 2 * n + 1].reshape(n, 2, 3).mean(axis=1)
    return gyro, force


def test_spiral_is_the_published_one():
    flight = spiral_climb(3600.0, 2.0)
    assert pytest.approx(58.486, abs=5e-4) == SPIRAL_SPEED
    assert flight.height[-1] == pytest.approx(455.02, abs=0.005)
    assert earth.normal_gravity(flight.latitude[0], 388.0) == pytest.approx(9.79549, abs=2e-4)
    roll, pitch, heading = rotation.to_euler(flight.imu.q_nb).T
    np.testing.assert_allclose(roll, np.deg2rad(2.0), atol=1e-12)
    np.testing.assert_allclose(pitch, 0.0, atol=1e-12)
    turns = np.unwrap(heading)
    assert (turns[-1] - turns[0]) / (2.0 * np.pi) == pytest.approx(3.351, abs=1e-3)
    np.testing.assert_allclose(np.hypot(*flight.velocity_n[:, :2].T), SPIRAL_SPEED, rtol=1e-12)
    np.testing.assert_allclose(flight.velocity_n[:, 2], -0.018617, atol=5e-7)
    # a circle of 10 km that stays where it was, and a coordinated turn
    north = (flight.latitude - flight.latitude[0]) * 6_357_000.0
    assert north.max() - north.min() == pytest.approx(20_000.0, rel=3e-3)
    assert np.abs(flight.imu.specific_force[:, 1]).max() < 0.02


def test_manoeuvres_are_as_told():
    flight = manoeuvring_flight(1800.0, 20.0, latitude=-0.6, turbulence=0.0)
    roll, pitch, _ = np.rad2deg(rotation.to_euler(flight.imu.q_nb)).T
    assert roll.max() == pytest.approx(35.0, abs=8.0)
    assert roll.max() > 34.0
    assert roll.min() < -34.0
    up = -flight.velocity_n[:, 2]
    assert up.max() == pytest.approx(10.0)
    assert up.min() == pytest.approx(-20.0)
    speed = np.hypot(*flight.velocity_n[:, :2].T)
    assert 54.9 < speed.min() < 62.0 < speed.max() < 80.1
    steady = np.abs(np.gradient(up, 0.05)) < 1e-3
    assert np.mean(steady) > 0.5
    assert np.abs(flight.imu.specific_force[steady, 1]).max() < 0.5  # coordinated
    assert np.abs(pitch).max() < 25.0
    shaken = manoeuvring_flight(1800.0, 20.0, latitude=-0.6)
    assert np.std(shaken.imu.gyro_rate - flight.imu.gyro_rate) > 0.02
    np.testing.assert_array_equal(shaken.height, flight.height)


changes = st.lists(
    st.tuples(st.floats(0.0, 20.0), st.floats(0.1, 10.0), st.floats(-50.0, 50.0)),
    max_size=6,
)


@given(st.floats(-50.0, 50.0), changes)
def test_levels_and_their_integral_and_derivatives_fit(first, raw):
    changes, t = [], 0.0
    for wait, duration, level in raw:
        changes.append((t + wait, duration, level))
        t += wait + duration + 1e-6
    levels = Levels(first, changes)
    at = np.linspace(-3.0, t + 5.0, 400)
    small = 1e-4
    scale = 1.0 + max([abs(first), *(abs(level) for _, _, level in changes)])
    for value, slope, allowed in (
        (levels.integral, levels.value, 1e-5),
        (levels.value, levels.slope, 1e-2),
        (levels.slope, levels.curvature, 0.3),
    ):
        difference = (value(at + small) - value(at - small)) / (2.0 * small)
        np.testing.assert_allclose(difference, slope(at), atol=allowed * scale)
    assert levels.value(np.array([-100.0]))[0] == first
    assert levels.value(np.array([t + 1.0]))[0] == (changes[-1][2] if changes else first)
    assert levels.integral(np.zeros(1))[0] == 0.0


def test_levels_that_overlap_are_refused():
    with pytest.raises(ValueError, match="overlap"):
        Levels(0.0, [(1.0, 2.0, 3.0), (2.0, 1.0, 0.0)])
    with pytest.raises(ValueError, match="overlap"):
        Levels(0.0, [(1.0, 0.0, 3.0)])


def test_barometer_is_a_markov_process_at_any_instants():
    random = np.random.default_rng(5)
    time = np.cumsum(random.integers(100_000_000, 400_000_000_000, size=4000))
    height = np.linspace(100.0, 900.0, len(time))
    errors = np.empty((60, len(time)))
    for seed in range(len(errors)):
        measured, errors[seed] = barometer(time, height, seed=seed)
        np.testing.assert_allclose(measured, height + errors[seed], atol=1e-12)
    assert np.std(errors) == pytest.approx(10.0, rel=0.01)
    assert np.std(errors[:, 0]) == pytest.approx(10.0, rel=0.3)
    # correlation of neighbours is that of their own distance
    correlation = np.mean(errors[:, 1:] * errors[:, :-1], axis=0) / 100.0
    expected = np.exp(-np.diff(time) * 1e-9 / 500.0)
    for low, high in ((0.45, 0.6), (0.6, 0.8), (0.8, 1.0)):
        some = (expected > low) & (expected <= high)
        assert correlation[some].mean() == pytest.approx(expected[some].mean(), abs=0.02)


def test_barometer_noise_and_arguments():
    time = sample_times(10.0, 200.0)
    height = np.full(len(time), 50.0)
    quiet, error = barometer(time, height, sigma=3.0, correlation_time=50.0, seed=2)
    loud, same = barometer(time, height, sigma=3.0, correlation_time=50.0, white=0.2, seed=2)
    np.testing.assert_array_equal(error, same)
    assert np.std(loud - quiet) == pytest.approx(0.2, rel=0.1)
    with pytest.raises(ValueError, match="height"):
        barometer(time, height[1:])
