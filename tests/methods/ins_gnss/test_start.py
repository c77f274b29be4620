"""Position and velocity of starts on simulated flights, against where the vehicle was."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.core.errors import AlignmentError
from sinstool.core.rotation import exp, multiply, rotate
from sinstool.methods.ins_gnss.parameters import initial_covariance
from sinstool.methods.ins_gnss.start import start_at
from sinstool.methods.ins_gnss.states import GNSS_POSITION, GNSS_VELOCITY, filter_kind
from sinstool.simulation.drive import road_drive
from sinstool.simulation.flight import manoeuvring_flight
from sinstool.simulation.gnss import GnssErrors, Receiver, gnss_samples
from sinstool.simulation.moments import moments
from tests.helpers.gnss import epochs
from tests.methods.ins_gnss.flown import for_grade

LEVER = (0.8, -0.4, -1.1)
SHARP = GnssErrors((0.5, 0.5, 0.8), (0.0,) * 3, 100.0, (0.05, 0.05, 0.08))


@pytest.mark.parametrize("latency", [0.0, 0.13])
def test_position_and_velocity_of_the_imu_between_two_fixes(latency):
    flight = manoeuvring_flight(60.0, 100.0, latitude=-0.6, longitude=2.8, heading=1.0, seed=3)
    receiver = Receiver(10.0, 0.033, latency, LEVER, GnssErrors())
    gnss = epochs(gnss_samples(flight, receiver, 1))
    settings = for_grade("mems", lever_arm_b=LEVER, gnss_latency=latency)
    for row in (2000, 2507, 4003):
        truth = moments(flight, flight.time_ns[row : row + 1])
        earth_rate = 7.3e-5
        start = start_at(
            int(flight.time_ns[row]),
            truth.q_nb[0],
            np.diag([1e-4, 2e-4, 9e-4]),
            gnss,
            settings,
            omega_eb_b=truth.omega_ib_b[0],
        )
        # What is left is the bend of the way within 0.1 s, and the Earth's turn of the lever arm
        bend = 10.0 * 0.1**2 / 8.0
        assert abs(start.nav[0] - truth.latitude[0]) * 6.37e6 < bend + 0.08
        assert abs(start.nav[1] - truth.longitude[0]) * 5.3e6 < bend + 0.08
        assert abs(start.nav[2] - truth.height[0]) < bend + 0.08
        limit = 2e-2 + 2.0 * earth_rate
        np.testing.assert_allclose(start.nav[3:6], truth.velocity_n[0], atol=limit)
        np.testing.assert_allclose(start.nav[6:], truth.q_nb[0], atol=1e-12)
        # Noise of the model, white and slow, and more where the lever arm may have turned
        sigma = np.sqrt(np.diag(start.covariance_position_n))
        model = np.hypot(settings.gnss.position_white, settings.gnss.position_markov)
        assert np.all(sigma >= model)
        np.testing.assert_allclose(sigma, model, rtol=0.01)
        turned = start.covariance_position_n - np.diag(model**2)
        assert np.trace(turned) > 1e-4 * np.dot(LEVER, LEVER)


@pytest.mark.parametrize("without", ["all", "near"])
def test_where_fixes_have_no_height_that_of_the_nearest_one_counts_or_none(without):
    flight = manoeuvring_flight(60.0, 100.0, latitude=-0.6, longitude=2.8, heading=1.0, seed=3)
    gnss = epochs(gnss_samples(flight, Receiver(10.0, 0.033, 0.0, LEVER, GnssErrors()), 1))
    seconds = (gnss.time_ns - flight.time_ns[0]) * 1e-9
    none = np.ones(len(gnss), bool) if without == "all" else np.abs(seconds - 30.0) < 5.0
    gnss = replace(gnss, height=np.where(none, np.nan, gnss.height))
    truth = moments(flight, flight.time_ns[3000:3001])
    start = start_at(
        int(flight.time_ns[3000]),
        truth.q_nb[0],
        1e-4 * np.eye(3),
        gnss,
        for_grade("mems", lever_arm_b=LEVER),
        omega_eb_b=truth.omega_ib_b[0],
    )
    assert abs(start.nav[0] - truth.latitude[0]) * 6.37e6 < 0.1
    sigma = np.sqrt(start.covariance_position_n[2, 2])
    if without == "all":
        assert abs(start.nav[2]) < 5.0 and sigma == pytest.approx(1000.0, rel=0.01)
    else:
        assert sigma == pytest.approx(25.0, rel=0.2)
        assert abs(start.nav[2] - truth.height[0]) < 3.0 * sigma


@pytest.mark.parametrize("before_s", [None, 5.0, 15.0], ids=["decades", "5 s", "15 s"])
@pytest.mark.parametrize("turned_round", [False, True])
def test_a_fix_beyond_an_outage_is_no_place_to_start_from(before_s, turned_round):
    """Before it, or behind it: the near fix counts, not the one that is first."""
    flight = manoeuvring_flight(60.0, 100.0, seed=3)
    gnss = epochs(gnss_samples(flight, Receiver(10.0, 0.0, 0.0, LEVER, GnssErrors()), 1))
    row = 3007
    at = int(flight.time_ns[row])
    seconds = (gnss.time_ns - at) * 1e-9
    near = seconds < 0.0 if turned_round else seconds > 0.0
    far = ~near & (np.abs(seconds) > (before_s or 20.0))
    gnss = gnss.rows(near | far)
    if before_s is None:
        stamps = np.where(near[near | far], gnss.time_ns, 2**62 if turned_round else 0)
        gnss = replace(gnss, time_ns=stamps)
    truth = moments(flight, flight.time_ns[row : row + 1])
    settings = for_grade("mems", lever_arm_b=LEVER)
    start = start_at(
        at, truth.q_nb[0], 1e-6 * np.eye(3), gnss, settings, omega_eb_b=truth.omega_ib_b[0]
    )
    assert abs(start.nav[0] - truth.latitude[0]) * 6.37e6 < 0.5
    assert abs(start.nav[2] - truth.height[0]) < 0.5
    np.testing.assert_allclose(start.nav[3:6], truth.velocity_n[0], atol=0.5)
    assert np.all(np.sqrt(np.diag(start.covariance_velocity_n)) < 1.0)


def test_a_lever_arm_left_out_is_seen():
    flight = manoeuvring_flight(30.0, 100.0, seed=3)
    gnss = epochs(
        gnss_samples(flight, Receiver(10.0, 0.0, 0.0, LEVER, GnssErrors()), 1), own_sigma=True
    )
    truth = moments(flight, flight.time_ns[2000:2001])
    at = (int(truth.time_ns[0]), truth.q_nb[0], 1e-6 * np.eye(3), gnss)
    near = start_at(*at, for_grade("mems", lever_arm_b=LEVER))
    far = start_at(*at, for_grade("mems"))
    assert abs(near.nav[2] - truth.height[0]) < 0.02
    assert abs(far.nav[2] - truth.height[0]) > 0.3


def test_far_from_any_fix_there_is_no_start():
    truth = road_drive(110.0, 100.0, heading=2.3, still_s=30.0, seed=2)
    gnss = epochs(gnss_samples(truth, Receiver(2.0, 20.0, errors=SHARP), 1), own_sigma=True)
    with pytest.raises(AlignmentError, match="within 2 s"):
        start_at(int(1e10), [1.0, 0.0, 0.0, 0.0], np.eye(3), gnss, for_grade("mems"))


def test_attitude_errors_turn_the_lever_arm_and_its_swing():
    """What of both covariances comes from the attitude's, by differences of turned vectors."""
    flight = manoeuvring_flight(30.0, 100.0, heading=1.0, seed=3)
    gnss = epochs(gnss_samples(flight, Receiver(10.0, 0.0, 0.0, LEVER, GnssErrors()), 1))
    truth = moments(flight, flight.time_ns[2000:2001])
    q_nb, omega = truth.q_nb[0], np.array([0.5, -0.8, 1.2])
    settings = for_grade("mems", lever_arm_b=LEVER)
    covariance = np.array([[4e-4, 1e-4, 0.0], [1e-4, 9e-4, 2e-4], [0.0, 2e-4, 1e-3]])

    def begun(psi):
        return start_at(int(truth.time_ns[0]), q_nb, psi, gnss, settings, omega_eb_b=omega)

    def turned(vector):
        """Jacobian of a body vector in NED by a small turn of the attitude about N, E, D."""
        step = 1e-6
        columns = [
            rotate(multiply(exp(step * axis), q_nb), vector)
            - rotate(multiply(exp(-step * axis), q_nb), vector)
            for axis in np.eye(3)
        ]
        return np.stack(columns, axis=1) / (2.0 * step)

    known, unknown = begun(np.zeros((3, 3))), begun(covariance)
    arm, swing = turned(np.array(LEVER)), turned(np.cross(omega, LEVER))
    position = unknown.covariance_position_n - known.covariance_position_n
    np.testing.assert_allclose(position, arm @ covariance @ arm.T, rtol=1e-6, atol=1e-10)
    velocity = unknown.covariance_velocity_n - known.covariance_velocity_n
    np.testing.assert_allclose(velocity, swing @ covariance @ swing.T, rtol=1e-6, atol=1e-10)


def test_a_start_by_fixes_shares_their_slow_errors():
    """A covariance still, whatever the fix claims, and for the slow part that of the model."""
    truth = road_drive(110.0, 100.0, heading=2.3, still_s=30.0, seed=2)
    gnss = epochs(gnss_samples(truth, Receiver(2.0, 20.0, errors=SHARP), 1), own_sigma=True)
    moment = moments(truth, truth.time_ns[4000:4001])
    kind = filter_kind("markov-27")
    position, velocity = (kind.first(block) for block in (GNSS_POSITION, GNSS_VELOCITY))
    for claims in (0.01, 1.0, 20.0):
        stated = replace(gnss, sigma_position_n=np.full_like(gnss.sigma_position_n, claims))
        settings = for_grade("mems", lever_arm_b=LEVER)
        start = start_at(int(moment.time_ns[0]), moment.q_nb[0], 1e-2 * np.eye(3), stated, settings)
        p = initial_covariance(kind, start, settings)
        np.linalg.cholesky(p + 1e-12 * np.eye(len(p)))
        shared = np.diagonal(p[:3, position : position + 3])
        assert np.all(shared > 0.0) and np.all(shared <= np.diagonal(p)[:3] + 1e-9)
        if claims > 10.0:
            assert shared == pytest.approx(np.square(settings.gnss.position_markov), rel=1e-6)
        assert np.all(np.diagonal(p[3:6, velocity : velocity + 3]) > 0.0)
