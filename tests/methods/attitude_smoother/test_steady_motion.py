"""What looks like rest and is none, and what the Earth's rate does at rest."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.core.earth import SEMI_MAJOR_AXIS, earth_rate_n
from sinstool.core.rotation import conjugate, exp, from_euler, log, multiply, rotate
from sinstool.core.streams import Imu, concatenate
from sinstool.core.timeline import SECOND
from sinstool.methods.attitude_smoother.correction import Correction
from sinstool.methods.attitude_smoother.epochs import (
    ACCEL,
    ACCEL_VARIANCE,
    AT_REST,
    MOVING,
    QUIET,
    RATE_DOUBT,
    REST,
    STEADY,
    TURN_DOUBT,
    WAY_TURNS,
    WIDTH,
    EpochStage,
)
from sinstool.methods.attitude_smoother.model import (
    FOLLOWER,
    GRAVITY,
    HAND,
    VEHICLE,
    SensorModel,
    sensor_model,
)
from sinstool.methods.attitude_smoother.motion import find_motion
from sinstool.methods.attitude_smoother.quiet_doubt import note_doubt
from sinstool.methods.attitude_smoother.rest import MARKS, confirmed, with_rest
from sinstool.methods.attitude_smoother.smoother import smooth
from sinstool.methods.attitude_smoother.steady import agrees_with_travel, with_steady
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


def ride(parts, sensors, seed, first_speed=0.0, sway=0.0, wobble=0.0):
    """A level ride round the Earth, without a shake.

    It has parts: seconds, acceleration ahead and rate of turn.

    It sways by so many rad/s, about all axes, back and forth within 0.4 s, and wobbles by so many
    rad about the vertical, once in 2 s.

    Returns the integrated solution of noisy samples without bias, and the true attitude.
    """
    count = [round(seconds / DT) for seconds, _, _ in parts]
    pull = np.repeat([a for _, a, _ in parts], count)
    turn = np.repeat([w for _, _, w in parts], count)
    n = len(pull)
    speed = first_speed + np.cumsum(pull) * DT
    zero, phase = np.zeros(n), np.pi * DT * np.arange(n)
    off = wobble * np.sin(phase)
    rate = np.stack([zero, zero, turn + np.pi * wobble * np.cos(phase)], axis=1)
    q0 = np.array([1.0, 0.0, 0.0, 0.0])
    ahead = pull * np.cos(off) + speed * turn * np.sin(off)
    force = np.stack([ahead, speed * turn * np.cos(off) - pull * np.sin(off), zero - GRAVITY], 1)
    random = np.random.default_rng(seed)
    swings = np.repeat(random.standard_normal((n // 20 + 1, 3)), 20, axis=0)
    rate = rate + sway * np.where(np.arange(n + 10) % 20 < 10, 1.0, -1.0)[:n, None] * swings[:n]
    q = turned(q0, rate, DT)
    noise = sensors.angle_random_walk / 3.0 / np.sqrt(DT)
    gyro = rate + noise * random.standard_normal((n, 3))
    gyro[:, 0] -= speed / SEMI_MAJOR_AXIS * np.sin(off)
    gyro[:, 1] -= speed / SEMI_MAJOR_AXIS * np.cos(off)
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


@pytest.mark.parametrize("seed", range(3))
def test_rests_in_which_accelerometers_show_other_sizes_of_gravity(seed):
    """They are not calibrated, and lie another way up; the rate is that of the gyros' bias."""
    sensors = sensor_model("mems", walk_at_rest=None, bias_known=True, earth_removed=True)
    solution, _ = ride([(20, 0, 0), (8, 2.0, 0.3), (8, -2.0, -0.3), (10, 0, 0)], sensors, seed)
    force = solution.specific_force_b.copy()
    last = solution.time_ns - solution.time_ns[0] > 36 * SECOND
    force[last, 2] -= 0.4
    epochs = with_rest(epochs_of(replace(solution, specific_force_b=force)))
    seconds = (epochs.time_ns[:-1] - epochs.time_ns[0]) / SECOND
    assert epochs.rest[seconds > 37.0].all()
    assert epochs.rest[seconds < 19.0].all()


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
        chosen = find_motion(epochs, sensors, "hand")
        assert chosen.model.name == "hand" and chosen.sure and not chosen.denied


def test_a_few_seconds_of_the_way_of_a_vehicle_are_no_hands():
    sensors = sensor_model("mems", walk_at_rest=None, bias_known=False, earth_removed=True)
    for seed in range(3, 8):
        epochs = epochs_of(drawn(VEHICLE, sensors, 30.0, seed, turning=0.5).solution)
        motion = find_motion(epochs, sensors)
        assert motion.model.name == "vehicle" and motion.short
        assert motion.sure


def test_a_hand_that_was_chosen_is_denied_by_the_way_of_a_vehicle():
    sensors = sensor_model("mems", walk_at_rest=None, bias_known=False, earth_removed=True)
    epochs = epochs_of(drawn(VEHICLE, sensors, 120.0, 3, turning=0.5).solution)
    chosen = find_motion(epochs, sensors, "hand")
    assert chosen.model.name == "hand" and chosen.denied
    assert not find_motion(epochs, sensors, "vehicle").denied
    assert not find_motion(epochs, sensors).denied


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


@pytest.mark.parametrize("swaying", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_noise_that_a_sensor_filters_is_no_sway(seed, swaying):
    """An autopilot on a desk passed for a ship, as three of its samples are much alike."""
    sensors = sensor_model("mems", walk_at_rest=None, bias_known=True, earth_removed=True)
    dt, n, random = 0.004, 5000, np.random.default_rng(seed)
    swell = np.sin(2.0 * np.pi / 3.0 * dt * np.arange(n))[:, None] * [1.0, 0.7, 0.7]
    white = random.standard_normal((n + 2, 3))
    filtered = 6e-3 * (white[2:] + 2.0 * white[1:-1] + white[:-2]) / np.sqrt(6.0)
    gyro = filtered + (2e-3 * swell if swaying else 0.0)
    force = [0.0, 0.0, -GRAVITY] + 0.02 * random.standard_normal((n, 3))
    level = np.array([1.0, 0.0, 0.0, 0.0])
    epochs = with_rest(epochs_of(solution_of(dt, turned(level, gyro, dt), gyro, force)))
    assert np.mean(epochs.rest) > 0.95
    at_rest = confirmed(epochs, sensors).at_rest.mean()
    assert at_rest == (pytest.approx(1.0, abs=0.05) if not swaying else 0.0)


def test_braking_at_the_start_is_no_tilt():
    # From 45 m/s to a standstill soon, in ten minutes: only the first velocity shows that the mean
    # acceleration is no tilt. (As uncertain as later ones, 16 m/s, it leaves 0.25 deg.)
    sensors = sensor_model("tactical", walk_at_rest=None, bias_known=True, earth_removed=True)
    solution, q_true = ride([(10, 0, 0), (30, -1.5, 0), (560, 0, 0)], sensors, 8, 45.0)
    after = smooth(epochs_of(solution), VEHICLE, sensors).apply(solution)
    tilt, _ = tilt_error(q_true, after.q_nb)
    level = after.covariance_attitude_n[:, :2, :2]
    squares = np.einsum("ni,nij,nj->n", tilt, np.linalg.inv(level), tilt) / 2.0
    assert np.degrees(np.abs(tilt)).max() < 0.15
    assert squares.mean() < 1.5


def of_part(parts, epochs):
    """Index of the part of a ride that each epoch belongs to, -1 within two seconds of its ends."""
    ends = np.cumsum([part[0] for part in parts])
    at = epochs.time_ns[:-1] / SECOND
    part = np.searchsorted(ends, at)
    near = np.min(np.abs(at[:, None] - np.append(0.0, ends)), axis=1) < 2.0
    return np.where(near, -1, part)


def test_a_bend_slower_than_the_sway_is_no_rest():
    # Five times the sway are more than its rate, but not of a mean over many epochs.
    sensors = sensor_model("tactical", walk_at_rest=None, bias_known=False, earth_removed=True)
    parts = [(60, 0, 0), (240, 0, 0.004), (60, 0, 0)]
    solution, _ = ride(parts, sensors, 4, first_speed=14.0, sway=1e-3)
    epochs = with_rest(epochs_of(solution))
    part = of_part(parts, epochs)
    believed = confirmed(epochs, sensors)
    believed = with_steady(believed, epochs.rest, VEHICLE, sensors)
    assert np.mean(epochs.rest[part == 1]) > 0.5, "else this test shows nothing"
    assert np.mean(believed.rest[part == 1]) < 0.05
    assert np.mean(believed.rest[part == 2]) > 0.5 * np.mean(epochs.rest[part == 2])


def test_straight_flight_before_and_after_a_turn_is_steady():
    # The turn tilts the first pass by degrees, so that straight flight seems to accelerate.
    sensors = sensor_model("tactical", walk_at_rest=None, bias_known=False, earth_removed=True)
    parts = [(80, 0, 0), (80, 0, 0.027), (60, 0, 0), (40, 0.2, 0), (80, 0, 0), (80, 0, -0.03),
             (100, 0, 0)]  # fmt: skip
    solution, q_true = ride(parts, sensors, 5, first_speed=60.0, sway=5e-4)
    marked = with_rest(epochs_of(solution))
    part = of_part(parts, marked)
    straight = np.isin(part, (0, 2, 4, 6))
    before = confirmed(marked, sensors)
    model = VEHICLE.with_density(8.0)
    after = with_steady(before, marked.rest, model, sensors)
    assert np.mean(before.values[straight, REST] == STEADY) < 0.8, "else this test shows nothing"
    assert np.mean(after.values[straight, REST] == STEADY) > 0.9
    assert not np.any(after.values[part == 3, REST] == STEADY)
    # it agrees with the tilt as the rest of the log has it
    values, known = before.values.copy(), []
    values[before.values[:, REST] == STEADY, REST] = QUIET
    for epochs in (replace(before, values=values), after):
        found = smooth(epochs, model, sensors).apply(solution)
        tilt, _ = tilt_error(q_true, found.q_nb)
        sigma = np.sqrt(np.einsum("nii->ni", found.covariance_attitude_n))[:, :2]
        assert np.all(np.abs(tilt) < 4.0 * sigma)
        known.append(sigma.mean())
    assert np.degrees(np.abs(tilt)).max() < 0.25
    assert known[1] < 0.5 * known[0]


@pytest.mark.parametrize("trap", TRAPS)
def test_epochs_judged_in_place_are_those_judged_as_copies(trap):
    sensors = sensor_model("mems", walk_at_rest=None, bias_known=True, earth_removed=True)
    marked = with_rest(epochs_of(ride(TRAPS[trap], sensors, 3)[0]))
    still, looked = marked.rest, marked.values.copy()
    before = confirmed(marked, sensors)
    after = with_steady(before, still, VEHICLE, sensors)
    assert np.array_equal(marked.values, looked)
    assert not np.array_equal(after.values, looked), "else this test shows nothing"
    own = confirmed(marked, sensors, in_place=True)
    assert own.values is marked.values
    assert np.array_equal(own.values, before.values)
    own = with_steady(own, still, VEHICLE, sensors, in_place=True)
    assert own.values is marked.values
    assert np.array_equal(own.values, after.values)
    # and what looked like rest can be judged once more
    own.values[:, MARKS] = looked[:, MARKS]
    assert np.array_equal(own.values, looked)


def test_what_is_a_hands_is_not_made_steady():
    sensors = sensor_model("tactical", walk_at_rest=None, bias_known=False, earth_removed=True)
    solution, _ = ride([(60, 0, 0)], sensors, 5, first_speed=60.0, sway=5e-4)
    marked = with_rest(epochs_of(solution))
    before = confirmed(marked, sensors)
    assert with_steady(before, marked.rest, HAND, sensors) is before


def test_gentle_braking_is_not_steady():
    # While it brakes, the tilt of a MEMS gyro's first pass follows.
    sensors = sensor_model("mems", walk_at_rest=None, bias_known=True, earth_removed=True)
    stage = [(25, 0.4, 0), (15, 0, 0), (10, 0, 0.1), (25, -0.4, 0), (10, 0, 0)]
    parts = [(10, 0, 0), *3 * stage]
    solution, q_true = ride(parts, sensors, 5, sway=1e-3)
    marked = with_rest(epochs_of(solution))
    pulled = np.isin(of_part(parts, marked), [k for k, part in enumerate(parts) if part[1]])
    before = confirmed(marked, sensors)
    assert np.mean(before.values[pulled, REST] >= STEADY) > 0.05, "else this test shows nothing"
    after = with_steady(before, marked.rest, VEHICLE, sensors)
    assert np.mean(after.values[pulled, REST] >= STEADY) < 0.02
    found = smooth(after, VEHICLE, sensors).apply(solution)
    tilt, _ = tilt_error(q_true, found.q_nb)
    sigma = np.sqrt(np.einsum("nii->ni", found.covariance_attitude_n))[:, :2]
    assert np.sqrt(np.mean((tilt / sigma) ** 2)) < 1.2


def known_level(epochs, tilt_sigma):
    """A correction that finds a level vehicle level, by so much."""
    n = len(epochs)
    return Correction(
        epochs.time_ns,
        q=np.tile([1.0, 0.0, 0.0, 0.0], (n + 1, 1)),
        turn=np.zeros((n, 3)),
        gyro_bias=np.zeros((n + 1, 3)),
        covariance_n=np.tile(tilt_sigma**2 * np.eye(3), (n + 1, 1, 1)),
        gyro_bias_sigma=np.full((n + 1, 3), 1e-6),
        accel_bias_sigma=0.0,
        accel_bias=None,
        diverged=False,
    )


def test_a_start_at_the_end_of_a_rest_is_not_steady():
    # The mean over all that looks like rest is small, that of its last seconds is not.
    sensors = sensor_model("navigation", walk_at_rest=None, bias_known=False, earth_removed=True)
    solution, _ = ride([(20, 0, 0), (3, 0.08, 0), (4, 0.16, 0)], sensors, 5)
    epochs = with_rest(epochs_of(solution))
    assert epochs.rest.all(), "else this test shows nothing"
    agrees, _ = agrees_with_travel(epochs, epochs.rest, sensors, known_level(epochs, 0.003))
    assert np.mean(agrees[:80]) > 0.95
    assert not agrees[-15:].any()


@pytest.mark.parametrize("grade, steady", [("navigation", False), ("mems", True)])
def test_a_tilt_that_leaves_room_for_an_acceleration_shows_no_steady_travel(grade, steady):
    """That is much for good sensors, and what the bias of a MEMS makes anyway."""
    sensors = sensor_model(grade, walk_at_rest=None, bias_known=False, earth_removed=True)
    solution, _ = ride([(27, 0, 0)], sensors, 5)
    epochs = with_rest(epochs_of(solution))
    agrees, hidden = agrees_with_travel(
        epochs, epochs.rest, sensors, known_level(epochs, 0.08 / GRAVITY)
    )
    assert np.mean(agrees) == (1.0 if steady else 0.0)
    shown = sensors.accel_bias**2 + (GRAVITY * sensors.rate_error) ** 2
    assert hidden == pytest.approx(np.full(len(epochs), 0.08**2 - shown))


FLIGHT = [(60, 0, 0), (100, 0, 0.02), (80, 0, 0), (60, 0.4, 0), (120, 0, -0.015), (180, 0, 0)]


def test_the_speed_of_what_goes_where_it_points_is_what_its_turns_show():
    # An airliner: what is expected of a car would be seven of its sigmas off.
    sensors = sensor_model("tactical", walk_at_rest=None, bias_known=True, earth_removed=True)
    solution, q_true = ride(FLIGHT, sensors, 7, first_speed=200.0, wobble=0.002)
    epochs = epochs_of(solution)
    motion = find_motion(epochs, sensors).model
    assert motion.follows
    off = []
    for model in (motion, VEHICLE.with_density(motion.density)):
        found = smooth(epochs, model, sensors).apply(solution)
        tilt, _ = tilt_error(q_true, found.q_nb)
        sigma = np.sqrt(np.einsum("nii->ni", found.covariance_attitude_n))[:, :2]
        assert np.sqrt(np.mean((tilt / sigma) ** 2)) < 1.5
        off.append(np.degrees(np.abs(tilt).max()))
    assert off[0] < 0.4 and off[0] < 0.5 * off[1]


def test_an_axis_that_wobbles_is_not_the_way(monkeypatch):
    # The wobble of each epoch by itself would make the velocity smaller than it is.
    sensors = sensor_model("tactical", walk_at_rest=None, bias_known=True, earth_removed=True)
    solution, q_true = ride(FLIGHT, sensors, 8, first_speed=200.0, wobble=0.06)
    off = []
    for wide in (WAY_TURNS, 1):
        monkeypatch.setattr("sinstool.methods.attitude_smoother.epochs.WAY_TURNS", wide)
        found = smooth(epochs_of(solution), FOLLOWER, sensors).apply(solution)
        tilt, _ = tilt_error(q_true, found.q_nb)
        off.append(np.degrees(np.abs(tilt).max()))
    assert off[0] < 0.2 and off[1] > 2.0 * off[0]


def test_slow_sway_does_not_show_the_bias_of_a_good_gyro():
    # Within each piece that looks steady the sway is smaller than how much their mean rates differ.
    sensors = sensor_model("tactical", walk_at_rest=None, bias_known=False, earth_removed=True)
    random = np.random.default_rng(9)
    parts = [(9, 0, rate) for rate in 5e-4 * random.standard_normal(6)]
    parts = [one for part in parts for one in (part, (20, 0.3, 0.02), (20, -0.3, -0.02))]
    solution, _ = ride(parts, sensors, 9, first_speed=8.0, sway=3e-4)
    marked = with_rest(epochs_of(solution))
    after = with_steady(confirmed(marked, sensors), marked.rest, VEHICLE, sensors)
    kinds = after.values[:, REST]
    quiet = (kinds > MOVING) & (kinds < AT_REST)
    assert quiet.any(), "else this test shows nothing"
    assert np.all(after.values[quiet, RATE_DOUBT] > 1e-8)
    found = smooth(after, VEHICLE, sensors)
    assert np.abs(found.gyro_bias).max() < 3.0 * found.gyro_bias_sigma.max()


@pytest.mark.parametrize("seconds", [4, 12])
def test_a_lull_is_no_stop(seconds):
    # Calm for some seconds at 12 m/s, in which a velocity of zero would be a false acceleration.
    sensors = sensor_model("tactical", walk_at_rest=None, bias_known=False, earth_removed=True)
    driving = [(2, 1.5, 0.1), (2, -1.5, -0.1)]
    parts = [*10 * driving, (seconds, 0, 0), *30 * driving]
    solution, _ = ride(parts, sensors, 6, first_speed=12.0)
    marked = with_rest(epochs_of(solution))
    before = confirmed(marked, sensors)
    assert before.at_rest.any(), "else this test shows nothing"
    after = with_steady(before, marked.rest, VEHICLE, sensors)
    assert not after.at_rest.any()
    assert np.array_equal(after.rest, before.rest)
    # at a stop it shakes less
    calm = before.values.copy()
    calm[marked.rest, ACCEL_VARIANCE : ACCEL_VARIANCE + 3] *= 0.1
    stops = with_steady(replace(before, values=calm), marked.rest, VEHICLE, sensors)
    assert np.array_equal(stops.at_rest, before.at_rest)


def test_one_long_bend_is_not_the_bias_of_gyros():
    """Of which nothing else is known: it shows the bias but for that of a slow turn."""
    sensors = sensor_model("mems", walk_at_rest=None, bias_known=False, earth_removed=True)
    driving = [(4, 1.5, 0.2), (4, -1.5, 0.1), (4, 1.0, -0.25), (4, -1.0, -0.12)]
    parts = [*6 * driving, (250, 0, 0.006), *10 * driving]
    solution, q_true = ride(parts, sensors, 7, first_speed=8.0)
    marked = with_rest(epochs_of(solution))
    before = confirmed(marked, sensors)
    motion = find_motion(before, sensors).model
    after = with_steady(before, marked.rest, motion, sensors)
    bend = of_part(parts, marked) == len(6 * driving)
    assert np.mean(after.rest[bend]) > 0.9, "else this test shows nothing"
    found = smooth(after, motion, sensors)
    assert np.all(np.abs(found.gyro_bias[-1]) < 4.0 * found.gyro_bias_sigma[-1])
    assert np.all(found.gyro_bias_sigma[-1, :2] < 3e-4)
    after = found.apply(solution)
    tilt, _ = tilt_error(q_true, after.q_nb)
    sigma = np.sqrt(np.einsum("nii->ni", after.covariance_attitude_n))[:, :2]
    assert np.sqrt(np.mean((tilt / sigma) ** 2)) < 0.8


@pytest.mark.parametrize(("deg_s", "least", "most"), [(0.1, 0.17, 0.2), (2.0, 1.5, 2.0)])
def test_the_faster_a_lone_quiet_time_turns_the_less_it_shows_the_bias(deg_s, least, most):
    """Two degrees per second about the vertical are an aircraft's turn more often than a bias."""
    rows = np.zeros((100, WIDTH))
    rows[20:60, REST] = QUIET
    rows[:, ACCEL : ACCEL + 3] = [0.0, 0.0, -9.8]
    sensors = replace(SensorModel(), bias_mean=(0.0, 0.0, np.radians(deg_s)))
    note_doubt(rows, rows[:, REST] > MOVING, sensors)
    doubt = np.degrees(np.sqrt(rows[:, TURN_DOUBT] / 40.0))
    assert least < doubt[20:60].min() <= doubt.max() < most
    assert not doubt[:20].any() and not doubt[60:].any()
