"""What looks like rest and is none, and what the Earth's rate does at rest."""

import numpy as np
import pytest

from sinstool.core.earth import earth_rate_n
from sinstool.core.rotation import conjugate, exp, from_euler, log, multiply, rotate
from sinstool.core.streams import Imu, concatenate
from sinstool.core.timeline import SECOND
from sinstool.methods.attitude_smoother.epochs import EpochStage
from sinstool.methods.attitude_smoother.model import GRAVITY, HAND, VEHICLE, sensor_model
from sinstool.methods.attitude_smoother.motion import find_motion
from sinstool.methods.attitude_smoother.rest import confirmed, with_rest
from sinstool.methods.attitude_smoother.smoother import smooth
from sinstool.methods.coning.registry import algorithm
from sinstool.methods.strapdown.attitude import AttitudeRun, AttitudeSettings
from sinstool.simulation.truth import sample_times, static
from tests.helpers.matched_motion import (
    MAX_GAP_NS,
    NO_STOPS,
    drawn,
    epochs_of,
    solution_of,
    tilt_error,
    turned,
)

DT = 0.02
LATITUDE = np.deg2rad(48.0)


def ride(parts, sensors, seed):
    """A level ride, without a shake, of parts: seconds, acceleration ahead and rate of turn.

    Returns the integrated solution of noisy samples without bias, and the true attitude.
    """
    count = [round(seconds / DT) for seconds, _, _ in parts]
    pull = np.repeat([a for _, a, _ in parts], count)
    turn = np.repeat([w for _, _, w in parts], count)
    n = len(pull)
    speed = np.cumsum(pull) * DT
    zero = np.zeros(n)
    rate = np.stack([zero, zero, turn], axis=1)
    q0 = np.array([1.0, 0.0, 0.0, 0.0])
    q = turned(q0, rate, DT)
    force = np.stack([pull, speed * turn, np.full(n, -GRAVITY)], axis=1)
    random = np.random.default_rng(seed)
    noise = sensors.angle_random_walk / 3.0 / np.sqrt(DT)
    gyro = rate + noise * random.standard_normal((n, 3))
    felt = force + 0.02 * random.standard_normal((n, 3))
    return solution_of(DT, turned(q0, gyro, DT), gyro, felt), q


TRAPS = {
    # seconds, m/s^2, rad/s: a minute of cruise, of a bend, at another speed, and a stop at last
    "cruise": [(20, 0, 0), (20, 1.25, 0), (60, 0, 0), (10, 1.0, 0), (60, 0, 0),
               (35, -1.0, 0), (20, 0, 0)],
    "bend": [(20, 0, 0), (16, 1.25, 0), (60, 0, 0.015), (30, 0, 0), (60, 0, -0.02),
             (16, -1.25, 0), (20, 0, 0)],
}  # fmt: skip


@pytest.mark.parametrize("grade", ["mems", "tactical"])
@pytest.mark.parametrize("trap", TRAPS)
def test_steady_travel_is_not_taken_for_rest(trap, grade):
    sensors = sensor_model(grade, walk_at_rest=None, bias_known=True, earth_removed=True)
    solution, q_true = ride(TRAPS[trap], sensors, 3)
    epochs = with_rest(epochs_of(solution))
    moving = np.cumsum([p[0] for p in TRAPS[trap]])
    seconds = epochs.time_ns[:-1] / SECOND
    travelling = (seconds > moving[1] + 2.0) & (seconds < moving[2] - 2.0)
    assert trap != "cruise" or epochs.rest[travelling].all(), "else this test shows nothing"
    after = smooth(confirmed(epochs, sensors), VEHICLE, sensors).apply(solution)
    tilt, heading = tilt_error(q_true, after.q_nb)
    sigma = np.sqrt(np.einsum("nii->ni", after.covariance_attitude_n))
    limit = {"mems": 0.5, "tactical": 0.1}[grade]
    assert np.degrees(np.abs(tilt)).max() < limit
    assert np.all(np.abs(tilt) < 4.0 * sigma[:, :2])
    assert np.degrees(np.abs(heading)).max() < 4.0 * limit


def turning(parts, seed=4):
    """Where a body that stands or turns at so many rad/s is at rest: the epochs, and the parts'."""
    sensors = sensor_model("mems", walk_at_rest=None, bias_known=True, earth_removed=True)
    solution, q_true = ride([(seconds, 0.0, rate) for seconds, rate in parts], sensors, seed)
    epochs = with_rest(epochs_of(solution))
    ends = np.cumsum([seconds for seconds, _ in parts])
    part = np.searchsorted(ends, epochs.time_ns[:-1] / SECOND + 0.1)
    return solution, q_true, epochs, confirmed(epochs, sensors), part, sensors


def test_a_slow_turn_after_a_rest_is_none():
    # half a degree a second: by itself it might be the bias of a MEMS gyro
    solution, q_true, epochs, believed, part, sensors = turning([(40, 0.0), (60, 0.0087), (20, 0)])
    assert np.mean(epochs.rest[part == 1]) > 0.9, "else this test shows nothing"
    assert not np.any(believed.rest[part == 1])
    assert np.mean(believed.at_rest[part != 1]) > 0.8
    after = smooth(believed, HAND, sensors).apply(solution)
    _, heading = tilt_error(q_true, after.q_nb)
    sigma = np.sqrt(after.covariance_attitude_n[:, 2, 2])
    assert np.degrees(np.abs(heading)).max() < 2.0
    assert np.all(np.abs(heading[50:]) < 4.0 * sigma[50:])


def test_a_log_may_be_shorter_than_what_a_denial_spoils():
    _, _, epochs, believed, _, _ = turning([(3, 0.0)])
    assert len(believed) == len(epochs) < 20
    assert believed.at_rest.all()


def test_a_slow_turn_at_the_beginning_is_not_the_rest_of_a_log():
    _, _, epochs, believed, part, _ = turning([(3, 0.0087), (30, 0.0)])
    assert np.any(epochs.rest[part == 0]), "else this test shows nothing"
    assert not np.any(believed.rest[part == 0])
    assert np.mean(believed.at_rest[part == 1]) > 0.9


@pytest.mark.parametrize("rolling_deg", [0.0, 0.1])
def test_what_sways_by_more_than_its_gyros_noise_may_travel(rolling_deg):
    # A swell of 8 s, of which a tactical gyro sees all.
    sensors = sensor_model("tactical", walk_at_rest=None, bias_known=True, earth_removed=True)
    n, random = round(60.0 / DT), np.random.default_rng(6)
    rate = np.zeros((n, 3))
    swell = 2.0 * np.pi / 8.0
    rate[:, 0] = np.deg2rad(rolling_deg) * swell * np.cos(swell * DT * np.arange(n))
    gyro = rate + sensors.angle_random_walk / np.sqrt(DT) * random.standard_normal((n, 3))
    force = [0.0, 0.0, -GRAVITY] + 1e-3 * random.standard_normal((n, 3))
    level = np.array([1.0, 0.0, 0.0, 0.0])
    epochs = with_rest(epochs_of(solution_of(DT, turned(level, gyro, DT), gyro, force)))
    believed = confirmed(epochs, sensors)
    assert epochs.rest.all()
    if rolling_deg:
        assert not np.any(believed.at_rest)
    else:
        assert np.mean(believed.at_rest) > 0.95
    # and its rate is not taken for bias
    found = smooth(believed, VEHICLE, sensors)
    assert np.all(np.abs(found.gyro_bias) < 4.0 * found.gyro_bias_sigma)


def test_a_few_seconds_do_not_show_that_a_position_is_bounded():
    sensors = sensor_model("mems", walk_at_rest=None, bias_known=False, earth_removed=True)
    for seconds, short in ((10.0, True), (60.0, False)):
        epochs = epochs_of(drawn(HAND, sensors, seconds, 3, turning=0.5).solution)
        motion = find_motion(epochs, sensors)
        assert motion.short == short
        assert motion.model.name == ("vehicle" if short else "hand")
        assert motion.sure != short
        assert find_motion(epochs, sensors, "hand").model.name == "hand"


def at_rest(q_start, seconds=120.0):
    """Exact samples of a body at rest on the turning Earth, integrated from a first attitude."""
    times = sample_times(50.0, seconds)
    imu = static(times, from_euler([0.05, -0.03, 1.0]), LATITUDE)
    earth = np.asarray(earth_rate_n(LATITUDE))
    settings = AttitudeSettings(
        algorithm=algorithm("previous-1"),
        gyro_kind="mean-rate",
        nominal_ns=DT * SECOND,
        max_gap_ns=MAX_GAP_NS,
        omega_ie_n=earth,
    )
    samples = Imu(times, times, imu.gyro_mean_rate, imu.mean_specific_force)
    solution = concatenate(list(AttitudeRun(q_start, settings).run([samples])))
    stage = EpochStage(MAX_GAP_NS, NO_STOPS, omega_in_n=earth)
    stage.push(solution)
    return solution, with_rest(stage.finish()), imu.q_nb


def test_a_rest_does_not_take_the_rate_of_the_earth_for_a_bias():
    sensors = sensor_model("tactical", walk_at_rest=None, bias_known=True, earth_removed=True)
    solution, epochs, q_true = at_rest(from_euler([0.05, -0.03, 1.0]))
    assert epochs.rest.all()
    found = smooth(confirmed(epochs, sensors), HAND, sensors)
    after = found.apply(solution)
    assert np.abs(found.gyro_bias).max() < 1e-8
    assert np.abs(log(multiply(q_true, conjugate(after.q_nb)))).max() < 1e-5


def test_the_rate_of_the_earth_is_taken_off_in_the_axes_that_are_found():
    # Begun with a tilt that is 5 degrees off, the integration takes the Earth's rate off in a
    # direction that is 5 degrees off; where the smoother finds the tilt it must not find a bias.
    sensors = sensor_model("tactical", walk_at_rest=None, bias_known=True, earth_removed=True)
    lean = exp([np.deg2rad(5.0), 0.0, 0.0])
    solution, epochs, q_true = at_rest(multiply(lean, from_euler([0.05, -0.03, 1.0])))
    found = smooth(confirmed(epochs, sensors), HAND, sensors)
    tilt, _ = tilt_error(q_true, found.apply(solution).q_nb)
    off = np.linalg.norm(rotate(lean, earth_rate_n(LATITUDE)) - earth_rate_n(LATITUDE))
    assert off > 4e-6
    assert np.abs(found.gyro_bias[-1]).max() < 0.2 * off
    assert np.abs(tilt).max() < 1e-4


def test_in_doubt_a_gentle_ride_is_a_vehicles():
    """A hand explains it nearly as well, but would pull the velocity back to zero."""
    sensors = sensor_model("mems", walk_at_rest=None, bias_known=True, earth_removed=True)
    stage = [(4, 0.5, 0), (5, 0, 0.02), (4, -0.5, 0), (3, 0, 0)]
    solution, q_true = ride([(10, 0, 0), *12 * stage], sensors, 5)
    epochs = confirmed(with_rest(epochs_of(solution)), sensors)
    motion = find_motion(epochs, sensors)
    assert motion.model.name == "vehicle"
    over_sigma = {}
    for model in (motion.model, HAND):
        after = smooth(epochs, model, sensors).apply(solution)
        tilt, _ = tilt_error(q_true, after.q_nb)
        variance = np.einsum("nii->ni", after.covariance_attitude_n)[:, :2]
        over_sigma[model.name] = np.sqrt(np.mean(tilt**2 / variance))
    assert over_sigma["vehicle"] < 1.4
    assert over_sigma["vehicle"] < 0.5 * over_sigma["hand"]


@pytest.mark.parametrize("swaying", [False, True])
def test_a_sway_within_the_noise_shows_over_a_minute(swaying):
    # a calm ship rolls by less than the noise of a MEMS gyro: no two seconds of it show it
    sensors = sensor_model("mems", walk_at_rest=None, bias_known=True, earth_removed=True)
    n, random = round(60.0 / DT), np.random.default_rng(11)
    noise = sensors.angle_random_walk / np.sqrt(DT)
    swell = np.sin(2.0 * np.pi / 3.0 * DT * np.arange(n))[:, None] * [1.0, 0.7, 0.7]
    rate = 1.2 * sensors.angle_random_walk / np.sqrt(0.2) * swell if swaying else np.zeros((n, 3))
    gyro = rate + noise * random.standard_normal((n, 3))
    force = [0.0, 0.0, -GRAVITY] + 1e-3 * random.standard_normal((n, 3))
    level = np.array([1.0, 0.0, 0.0, 0.0])
    epochs = with_rest(epochs_of(solution_of(DT, turned(level, gyro, DT), gyro, force)))
    believed = confirmed(epochs, sensors)
    assert np.mean(epochs.rest) > 0.95
    assert believed.at_rest.mean() == (pytest.approx(1.0, abs=0.05) if not swaying else 0.0)


def test_braking_at_the_start_is_no_tilt():
    # From 45 m/s to a standstill soon, in ten minutes: only the first velocity shows that the mean
    # acceleration is no tilt. (As uncertain as later ones, 16 m/s, it leaves 0.25 deg.)
    sensors = sensor_model("tactical", walk_at_rest=None, bias_known=True, earth_removed=True)
    solution, q_true = ride([(10, 0, 0), (30, -1.5, 0), (560, 0, 0)], sensors, 8)
    after = smooth(epochs_of(solution), VEHICLE, sensors).apply(solution)
    tilt, _ = tilt_error(q_true, after.q_nb)
    level = after.covariance_attitude_n[:, :2, :2]
    squares = np.einsum("ni,nij,nj->n", tilt, np.linalg.inv(level), tilt) / 2.0
    assert np.degrees(np.abs(tilt)).max() < 0.15
    assert squares.mean() < 1.5
