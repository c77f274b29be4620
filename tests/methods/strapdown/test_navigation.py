import numpy as np
import pytest

from sinstool.core import earth, rotation
from sinstool.core.earth import ecef
from sinstool.methods.strapdown.navigation import initial_state
from sinstool.simulation.flight import manoeuvring_flight, spiral_climb
from sinstool.simulation.travel import COLUMNS, travel
from sinstool.simulation.truth import sample_times
from tests.methods.strapdown import flying
from tests.methods.strapdown.navigator import Navigator

ATTITUDE = rotation.from_euler([0.4, -0.3, 2.5])


def at_rest(latitude, height, seconds, interval, q_nb=ATTITUDE):
    """Exact increments of a vehicle that stands still."""
    n = round(seconds / interval)
    q_bn = rotation.conjugate(q_nb)
    rate = rotation.rotate(q_bn, earth.earth_rate_n(latitude))
    force = rotation.rotate(q_bn, -earth.gravity_n(latitude, height))
    # The axes of the update's start: the integral of exp(rate t) force
    turned = force + 0.5 * interval * np.cross(rate, force)
    return (
        np.tile(rate * interval, (n, 1)),
        np.tile(turned * interval, (n, 1)),
        np.full(n, interval),
    )


# --- against simulated truth ---------------------------------------------------------------


@pytest.mark.slow
def test_spiral_climb_of_an_hour():
    flight = spiral_climb(3600.0, 128.0)
    result, errors = flying.fly(flight)
    assert len(result.rows) == 460_800
    assert errors.horizontal < 1e-3
    assert errors.vertical[: 60 * 128].max() < 1e-6  # 1e-3 is what was asked for
    assert errors.vertical.max() < 1e-3  # undamped: e**6 of what was there after a minute
    assert errors.attitude < 1e-10
    assert errors.velocity < 1e-6


@pytest.mark.slow
def test_manoeuvring_flight_in_the_south_over_the_date_line():
    flight = manoeuvring_flight(
        1800.0, 100.0, turbulence=0.0, latitude=-0.75, longitude=np.pi - 2e-5, heading=1.0
    )
    assert flight.longitude.min() < -3.14 < 3.14 < flight.longitude.max()
    _, errors = flying.fly(flight)
    assert errors.horizontal < 0.02
    assert errors.vertical.max() < 0.01
    assert errors.attitude < 2e-8


@pytest.mark.parametrize("kind", ["mean-rate", "rate", "increment"])
def test_turbulence_needs_no_more_than_a_better_coning_algorithm(kind):
    flight = manoeuvring_flight(300.0, 100.0, latitude=-0.3, seed=1)
    _, errors = flying.fly(flight, "lookahead-12", kind)
    assert errors.horizontal < 2e-4
    assert errors.vertical.max() < 2e-4
    assert errors.attitude < 1e-10


def test_updates_of_several_samples():
    flight = manoeuvring_flight(300.0, 100.0, latitude=0.9, seed=2)
    result, errors = flying.fly(flight, "quatfiter-4")
    assert len(result.rows) == 7_500
    # trapezoid of velocity over 0.04 s: 1/12 * 0.04**2 * change of acceleration
    assert errors.horizontal < 2e-3
    assert errors.attitude < 1e-9


@pytest.mark.parametrize(
    ("latitude", "azimuth"),
    [(89.72, 0.0), (89.72, 2e-9), (89.72, 1e-4), (89.7, 0.02), (-89.72, np.pi - 3e-6)],
)
def test_flight_over_a_pole(latitude, azimuth):
    # 250 m/s straight ahead with a roll back and forth: over the pole itself, by 0.1 mm, 3 m and
    # 700 m, and ends at 89.6 degrees on the other side
    def motion(t):
        out = np.zeros((len(t), COLUMNS))
        out[:, 0], out[:, 1] = 250.0, 3.0
        out[:, 6], out[:, 9] = 0.3 * np.sin(0.5 * t), 0.15 * np.cos(0.5 * t)
        out[:, 7] = 0.05
        out[:, 8] = 0.2
        return out

    flight = travel(motion, sample_times(50.0, 320.0), np.deg2rad(latitude), 0.4, 9000.0, azimuth)
    assert np.abs(np.rad2deg(flight.latitude[[0, -1]])).max() < 89.75
    assert np.abs(np.rad2deg(flight.latitude)).max() > 89.99
    result, errors = flying.fly(flight, "lookahead-12")
    assert errors.horizontal < 2e-5
    assert errors.vertical.max() < 2e-5
    assert errors.attitude < 1e-10
    assert errors.velocity < 1e-6
    # at a regular latitude afterwards the numbers themselves are right
    assert result.latitude[-1] == pytest.approx(flight.latitude[-1], abs=1e-11)
    assert result.longitude[-1] == pytest.approx(flight.longitude[-1], abs=1e-9)
    np.testing.assert_allclose(result.velocity_n[-1], flight.velocity_n[-1], atol=1e-6)


# --- against integration in other axes -----------------------------------------------------


def rate_b(t):
    return np.array([0.3 * np.cos(0.9 * t), 0.2 * np.sin(1.1 * t), 0.1 + 0.05 * np.cos(0.3 * t)])


def rate_integral(t):
    return np.stack(
        [
            0.3 / 0.9 * np.sin(0.9 * t),
            -0.2 / 1.1 * np.cos(1.1 * t),
            0.1 * t + 0.05 / 0.3 * np.sin(0.3 * t),
        ],
        axis=-1,
    )


def force_b(t):
    return np.array([3.0 * np.sin(0.7 * t), 2.0 * np.cos(0.4 * t), -9.0 + 2.0 * np.sin(t)])


def force_integral(t):
    return np.stack(
        [
            -3.0 / 0.7 * np.cos(0.7 * t),
            2.0 / 0.4 * np.sin(0.4 * t),
            -9.0 * t - 2.0 * np.cos(t),
        ],
        axis=-1,
    )


@pytest.mark.slow
@pytest.mark.parametrize(("latitude", "longitude"), [(-0.9, 3.1415), (1.57, -2.0)], ids=str)
def test_integration_in_earth_axes(latitude, longitude):
    # Tumbling with specific forces that do not care about gravity: some 20 km in 60 s. The
    # increments are closed integrals, the reference shares nothing but the gravity model.
    state = initial_state(latitude, longitude, 20_000.0, [200.0, -150.0, 30.0], ATTITUDE)
    time = sample_times(100.0, 60.0)
    t = time * 1e-9
    run = flying.stage("lookahead-12", "increment", 0.01)
    before = np.concatenate([[t[0] - 0.01], t])
    gyro = np.diff(rate_integral(before), axis=0)
    accel = np.diff(force_integral(before), axis=0)
    updates = flying.joined([run.push(gyro, accel, time), run.finish()])
    result = Navigator(state).push(
        updates.rotation_vector, updates.velocity_increment, updates.interval
    )
    expected = flying.integrate_in_earth_axes(state, rate_b, force_b, t[::500])
    rows = np.arange(499, 6_000, 500)
    place = ecef(result.latitude[rows], result.longitude[rows], result.height[rows])
    turn = flying.q_en(result.latitude[rows], result.longitude[rows])
    assert np.abs(expected[-1, :3] - expected[0, :3]).max() > 10e3
    assert np.abs(place - expected[1:, :3]).max() < 1e-3
    velocity = rotation.rotate(turn, result.velocity_n[rows])
    assert np.abs(velocity - expected[1:, 3:6]).max() < 2e-5
    attitude = rotation.multiply(
        rotation.conjugate(expected[1:, 6:]), rotation.multiply(turn, result.q_nb[rows])
    )
    assert np.abs(rotation.log(attitude)).max() < 1e-10


def test_schuler_oscillation():
    # 0.1 m/s too fast at rest: a pendulum of 84.4 minutes, its plane turning with the Earth
    latitude, height = -1.2, 300.0
    phi, dv, dt = at_rest(latitude, height, 2700.0, 0.05)
    state = initial_state(latitude, 3.1, height, [0.1, 0.0, 0.0], ATTITUDE)
    result = Navigator(state).push(phi, dv, dt)
    meridian, transverse = earth.radii_of_curvature(latitude)
    north = (result.latitude - latitude) * (meridian + height)
    east = (result.longitude - 3.1) * (transverse + height) * np.cos(latitude)
    t = np.cumsum(dt)
    schuler = np.sqrt(earth.normal_gravity(latitude, height) / (meridian + height))
    pendulum = 0.1 / schuler * np.sin(schuler * t)
    turned = earth.EARTH_RATE * np.sin(latitude) * t  # Foucault
    early = t < 1500.0  # later the vertical, which is not stable, pushes back by Coriolis
    assert np.abs(north - pendulum * np.cos(turned))[early].max() < 0.01 * 0.1 / schuler
    assert np.abs(east - pendulum * np.sin(turned))[early].max() < 0.01 * 0.1 / schuler
    assert np.abs(pendulum * np.sin(turned))[early].max() > 0.05 * 0.1 / schuler
    # and exactly, by other equations
    rate, force = (
        phi[0] / 0.05,
        rotation.rotate(rotation.conjugate(ATTITUDE), -earth.gravity_n(latitude, height)),
    )
    expected = flying.integrate_in_earth_axes(
        state, lambda t: rate, lambda t: force, np.array([0.0, 1300.0, 2700.0])
    )
    rows = np.array([1300, 2700]) * 20 - 1
    place = ecef(result.latitude[rows], result.longitude[rows], result.height[rows])
    assert np.abs(place - expected[1:, :3]).max() < 1e-3


def test_height_error_grows_as_cosh():
    latitude, height = -1.45, 500.0
    phi, dv, dt = at_rest(latitude, height, 1800.0, 0.02)
    state = initial_state(latitude, -1.0, height + 1.0, np.zeros(3), ATTITUDE)
    result = Navigator(state).push(phi, dv, dt)
    gradient = earth.normal_gravity(latitude, height - 50.0) - earth.normal_gravity(
        latitude, height + 50.0
    )
    root = np.sqrt(gradient / 100.0)
    growth = np.cosh(root * np.cumsum(dt))
    assert growth[-1] > 10.0
    # Coriolis takes (2 Omega cos(latitude))**2 off the gradient: little where that is small
    np.testing.assert_allclose(result.height - height, growth, rtol=3e-4)
    np.testing.assert_allclose(
        -result.velocity_n[:, 2], root * np.sinh(root * np.cumsum(dt)), rtol=3e-4, atol=1e-9
    )


def test_rest_stays_rest():
    latitude, height = -0.6, 300.0
    phi, dv, dt = at_rest(latitude, height, 600.0, 1.0 / 128.0)
    result = Navigator(initial_state(latitude, 3.1, height, np.zeros(3), ATTITUDE)).push(
        phi, dv, dt
    )
    assert np.abs(result.latitude - latitude).max() < 1e-14
    assert np.abs(result.height - height).max() < 1e-6
    assert np.abs(result.velocity_n).max() < 1e-7
    turn = rotation.log(rotation.multiply(rotation.conjugate(ATTITUDE), result.q_nb))
    assert np.abs(turn).max() < 76_800 * 3e-16  # the same update rounds the same way


# --- Picard's quaternions ------------------------------------------------------------------


def test_drift_of_picard_orders_in_a_turn():
    # 100 deg/s at 128 Hz about an oblique axis: 1 s beside the exact quaternion
    rate, interval, n = np.deg2rad(100.0), 1.0 / 128.0, 128
    theta = rate * interval
    axis = np.array([0.6, -0.48, 0.64])
    phi = np.tile(theta * axis, (n, 1))
    dv, dt = np.zeros((n, 3)), np.full(n, interval)
    state = initial_state(0.8, 0.3, 100.0, [30.0, 20.0, 1.0], ATTITUDE)
    exact = Navigator(state).push(phi, dv, dt).q_nb[-1]
    law = {1: -(theta**3) / 12, 2: theta**3 / 24, 3: theta**5 / 480, 4: -(theta**5) / 1920}
    drift = {}
    for order, per_step in law.items():
        q = Navigator(state, order).push(phi, dv, dt).q_nb[-1]
        ahead = rotation.log(rotation.multiply(rotation.conjugate(exact), q))
        np.testing.assert_allclose(ahead, n * per_step * axis, rtol=2e-3, atol=3e-14)
        drift[order] = np.rad2deg(np.linalg.norm(ahead)) * 3600.0
    published = {1: 5.6, 2: 2.8, 3: 2.6e-5, 4: 6.5e-6}  # deg/h
    for order, value in published.items():
        assert drift[order] == pytest.approx(value, rel=0.02)


# --- streaming, corrections, arguments -----------------------------------------------------


def test_blocks_do_not_matter():
    flight = manoeuvring_flight(45.0, 100.0, latitude=-1.1, longitude=3.0)
    imu = flight.imu
    gyro, accel = flying.samples(imu, "rate")

    def run(block):
        run = flying.stage("lookahead-8", "rate", 0.01)
        navigator = Navigator(flying.start(flight))
        answers = []
        cuts = range(0, len(gyro), block)
        parts = [run.push(gyro[i : i + block], accel[i : i + block], imu.time_ns[i : i + block])
                 for i in cuts]  # fmt: skip
        for part in [*parts, run.finish()]:
            result = navigator.push(part.rotation_vector, part.velocity_increment, part.interval)
            answers.append(result.rows)
        answers = np.concatenate(answers)
        np.testing.assert_array_equal(navigator.state, answers[-1])
        return answers

    whole = run(len(gyro))
    assert len(whole) == 4500
    for block in (1, 7, 4096):
        np.testing.assert_array_equal(run(block), whole)


def test_a_state_may_be_corrected_between_updates():
    flight = spiral_climb(20.0, 128.0, latitude=-0.5)
    updates = flying.increments(flight.imu)
    parts = (updates.rotation_vector, updates.velocity_increment, updates.interval)
    navigator = Navigator(flying.start(flight))
    navigator.push(*(p[:1000] for p in parts))
    moved = navigator.state.copy()
    moved[0] += 1e-5
    moved[4] -= 0.3
    navigator.state[:] = moved
    result = navigator.push(*(p[1000:] for p in parts))
    fresh = Navigator(moved).push(*(p[1000:] for p in parts))
    np.testing.assert_array_equal(result.latitude, fresh.latitude)
    np.testing.assert_array_equal(result.q_nb, fresh.q_nb)


def test_start_is_checked():
    good = (0.5, 1.0, 0.0, np.zeros(3), ATTITUDE)
    assert initial_state(0.5, 1.0 + 2.0 * np.pi, 0.0, np.zeros(3), ATTITUDE)[1] == pytest.approx(1)
    np.testing.assert_allclose(initial_state(*good)[6:], ATTITUDE, atol=3e-16)
    with pytest.raises(ValueError, match="quarter"):
        initial_state(1.6, *good[1:])
    with pytest.raises(ValueError, match="finite"):
        initial_state(0.5, 1.0, np.nan, *good[3:])
    with pytest.raises(ValueError, match="shapes"):
        initial_state(*good[:3], np.zeros(2), ATTITUDE)
