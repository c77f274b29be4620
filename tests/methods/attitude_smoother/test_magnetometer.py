"""Heading by a magnetometer: what is taken for the Earth's field, and what is said of heading."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sinstool.core.rotation import from_euler, rotate, to_dcm, to_euler, wrapped
from sinstool.core.streams import Magnetometer, Solution
from sinstool.core.units import DEGREE
from sinstool.methods.attitude_smoother.earth_field import EarthField, model_field
from sinstool.methods.attitude_smoother.field import EpochField, FieldStage
from sinstool.methods.attitude_smoother.hard_iron import find_hard_iron
from sinstool.methods.attitude_smoother.heading_update import (
    FIELD_GATE,
    FIELD_VARIANCE,
    measure_heading,
)
from sinstool.methods.attitude_smoother.magnetometer import find_north, heading_off
from sinstool.methods.attitude_smoother.model import HAND
from sinstool.methods.attitude_smoother.smoother import smooth
from sinstool.methods.attitude_smoother.state import STATE, rotation_of
from tests.methods.attitude_smoother.compass_runs import (
    SENSORS,
    SIZE,
    earth,
    run,
    turning,
    wandering,
)


@given(
    seed=st.integers(0, 2**32 - 1),
    iron=st.tuples(*[st.floats(-40e-6, 40e-6)] * 3),
    dip=st.floats(-75.0, 75.0),
)
@settings(max_examples=40, deadline=None)
def test_a_hard_iron_is_found_whatever_it_is(seed, iron, dip):
    rng = np.random.default_rng(seed)
    n = 400
    attitude = to_dcm(from_euler(rng.uniform(-np.pi, np.pi, (n, 3)) * [1.0, 0.5, 1.0]))
    field = earth(dip) + attitude @ np.array(iron) + 2e-7 * rng.standard_normal((n, 3))
    found = find_hard_iron(field, attitude, np.arange(n) // 50)
    assert np.linalg.norm(found.offset - iron) < 0.02 * SIZE
    assert found.seen
    assert np.linalg.norm(found.offset - iron) < 6.0 * found.sigma


def test_a_hard_iron_is_found_though_a_third_of_the_time_is_disturbed():
    rng = np.random.default_rng(1)
    n = 600
    attitude = to_dcm(from_euler(rng.uniform(-np.pi, np.pi, (n, 3)) * [1.0, 0.5, 1.0]))
    iron = np.array([15e-6, 10e-6, -8e-6])
    field = earth(69.0) + attitude @ iron + 2e-7 * rng.standard_normal((n, 3))
    field[200:400] += 30e-6 * rng.standard_normal((200, 3)) + [20e-6, 0.0, 0.0]
    found = find_hard_iron(field, attitude, np.arange(n) // 150)
    assert found.applied
    assert np.linalg.norm(found.offset - iron) < 0.03 * SIZE


@given(seed=st.integers(0, 2**32 - 1), gradient=st.floats(0.0, 3e-6))
@settings(max_examples=20, deadline=None)
def test_where_there_is_no_iron_none_is_taken_off(seed, gradient):
    rng = np.random.default_rng(seed)
    n = 600
    attitude = to_dcm(from_euler(rng.uniform(-1.0, 1.0, (n, 3)) * rng.uniform(0.05, 3.0)))
    room = gradient * rng.standard_normal((n // 25, 3)).repeat(25, axis=0)
    field = earth(66.0) + room + 2e-7 * rng.standard_normal((n, 3))
    assert not find_hard_iron(field, attitude, np.arange(n) // 150).applied


@pytest.mark.parametrize("range_rad", [(1.0, 1.0, 1.0), (0.3, 0.3, 1.5)])
@pytest.mark.parametrize("size", [1e-6, 4e-6])
def test_a_field_that_changes_where_a_sensor_swings_is_in_the_sigma_of_iron(range_rad, size):
    """About a joint beside a magnet, what it passes of the magnet's field looks like iron."""
    squares = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        _, q = turning(120.0, rng)
        attitude = to_dcm(from_euler(0.6 * np.array(range_rad) * to_euler(q[::10])))
        gradient = rng.standard_normal((3, 3))
        gradient += gradient.T
        gradient -= np.eye(3) * np.trace(gradient) / 3.0
        gradient *= size / np.linalg.norm(gradient)
        field = earth(66.0) + attitude @ rng.standard_normal(3) @ gradient
        field += 2e-7 * rng.standard_normal(field.shape)
        found = find_hard_iron(field, attitude, np.arange(len(field)) // 150)
        across = (attitude @ found.offset)[:, 1]
        squares.append(np.mean(across**2) / found.sigma**2)
    assert 0.05 < np.mean(squares) < 2.5
    assert max(squares) < 12.0


def test_an_iron_is_found_in_a_log_of_many_hours():
    rng = np.random.default_rng(2)
    made = run(2, seconds=60.0)
    # as many epochs as 6 hours have, of the same minute again and again
    again = np.arange(108_000) % 290
    attitude, iron = made.measured.attitude[again], np.array([12e-6, 4e-6, -9e-6])
    field = made.measured.field[again] + attitude @ iron
    field += 3e-7 * rng.standard_normal(field.shape)
    time_ns = np.arange(108_001) * 200_000_000
    epochs = replace(made.epochs, time_ns=time_ns, values=made.epochs.values[again])
    measured = EpochField(field, attitude, np.full(len(again), 10.0))
    found = find_north(epochs, measured, made.before.q[again])
    assert found.hard_iron.applied
    assert np.linalg.norm(found.hard_iron.offset - iron) < 0.02 * SIZE
    assert found.trusted > 0.99


def test_fields_of_epochs_do_not_depend_on_blocks():
    rng = np.random.default_rng(15)
    times, q = turning(30.0, rng)
    one, other = (run(15, turn=(times, q), blocks=k).measured for k in (1, 501))
    assert np.abs(one.field - other.field).max() < 1e-18
    assert np.abs(one.attitude - other.attitude).max() < 1e-13
    assert (one.count == other.count).all() and (one.count == 10.0).all()


@pytest.mark.parametrize("size", [0.0, 0.02])
def test_a_body_that_hardly_turns_says_that_it_shows_no_hard_iron(size):
    made = run(3, seconds=60.0, iron=(15e-6, -10e-6, 8e-6), size=size)
    found = made.compass()
    assert found.north is not None
    assert not found.hard_iron.seen
    assert not found.verified
    error, sigma = made.heading_errors(made.smoothed(found))
    assert np.abs(error).max() > 10.0 * DEGREE
    assert (np.abs(error) < 2.0 * sigma).all()


def test_a_vehicle_that_keeps_level_shows_the_iron_that_turns_its_heading():
    # Of the vertical part it shows nothing, but a level heading does not depend on that.
    made = run(4, iron=(12e-6, -9e-6, 5e-6), tilts=False)
    found = made.compass()
    assert found.hard_iron.applied
    assert found.hard_iron.seen
    assert np.abs(found.hard_iron.offset[:2] - [12e-6, -9e-6]).max() < 0.02 * SIZE
    error, _ = made.heading_errors(made.smoothed(found))
    assert np.abs(error).max() < 3.0 * DEGREE


@pytest.mark.parametrize("tilts", [False, True])
@pytest.mark.parametrize("size", [1e-6, 2e-6, 4e-6])
def test_a_small_iron_is_taken_off_or_in_the_sigma_of_heading(tilts, size):
    squares = []
    for seed in range(12):
        iron = (size, -size, 0.5 * size)
        made = run(40 + seed, seconds=90.0, field=earth(69.0), iron=iron, tilts=tilts)
        found = made.compass()
        assert found.verified
        error, sigma = made.heading_errors(made.smoothed(found))
        squares.append(np.mean((error / sigma) ** 2))
    assert np.mean(squares) < 1.0


def test_axes_of_a_body_that_turns_little_are_seldom_taken_for_the_imus():
    """Of fields in other axes, too, a part lies close together in size and dip."""
    taken = 0
    for seed in range(48):
        dip = np.random.default_rng(seed).uniform(-60.0, 60.0)
        turned = [[[0, 1, 0], [1, 0, 0], [0, 0, -1]], np.diag([1.0, 1.0, -1.0])][seed % 2]
        made = run(seed, 60.0, earth(dip), size=0.35, body_of_field=lambda f, m=turned: f @ m)
        taken += made.compass().north is not None
    assert taken <= 1


@pytest.mark.parametrize("dip", [-60.0, 0.0, 69.0])
def test_heading_counts_from_the_azimuth_of_the_field(dip):
    made = run(5, field=earth(dip, azimuth_deg=-17.0))
    magnetic, true = made.compass(), made.compass(azimuth_deg=-17.0)
    assert np.degrees(true.dip) == pytest.approx(dip, abs=0.3)
    assert true.size == pytest.approx(SIZE, rel=0.01)
    error, _ = made.heading_errors(made.smoothed(true))
    assert np.abs(error).max() < 2.0 * DEGREE
    error, _ = made.heading_errors(made.smoothed(magnetic))
    assert np.degrees(np.median(error)) == pytest.approx(-17.0, abs=1.0)


def test_tilt_is_that_without_a_magnetometer():
    made = run(6)
    with_it = made.smoothed(made.compass())
    down = np.broadcast_to([0.0, 0.0, 1.0], (len(with_it.q), 3))
    # the vertical of the body, but for the turn of the navigation axes
    ours, before = rotate(with_it.q, down)[:, 2], rotate(made.before.q, down)[:, 2]
    assert np.abs(np.arccos(np.clip(ours, -1, 1)) - np.arccos(np.clip(before, -1, 1))).max() < (
        0.1 * DEGREE
    )


def test_heading_errors_have_the_size_that_is_said():
    field = earth(60.0)
    squares, held = [], []
    for seed in range(24):
        made = run(100 + seed, seconds=90.0, field=field, disturbance=wandering(4.0, field))
        found = made.compass()
        assert found.north is not None
        correction = made.smoothed(found)
        error, sigma = made.heading_errors(correction)
        # what all headings have in common was not simulated
        own = np.sqrt(sigma**2 - found.north.variance)
        squares.append(np.mean((error / own) ** 2))
        held.append(np.abs(error) < 2.5 * sigma)
    assert 0.5 < np.mean(squares) < 1.5
    assert np.mean(held) > 0.99


def test_a_magnet_in_passing_is_left_out():
    def passing(times, _):
        near = (times > 40.0) & (times < 55.0)
        return np.where(near[:, None], [-10e-6, 25e-6, 15e-6], 0.0)

    made = run(7, disturbance=passing)
    found = made.compass()
    begins = (made.epochs.time_ns[:-1] - made.epochs.time_ns[0]) * 1e-9
    used = found.north.rows[:, FIELD_VARIANCE] > 0.0
    assert not used[(begins > 39.3) & (begins < 55.7)].any()
    assert used[(begins < 38.5) | (begins > 56.5)].all()
    assert found.trusted == pytest.approx(1.0 - 17.0 / 120.0, abs=0.02)
    error, sigma = made.heading_errors(made.smoothed(found))
    assert np.abs(error).max() < 2.0 * DEGREE
    assert (np.abs(error) < 2.5 * sigma).all()


def test_a_magnet_that_looks_like_another_north_is_held_back_by_the_gate():
    # The Earth's field turned about the vertical for a while: size and dip are right.
    field = earth(60.0)
    turned = rotate(from_euler(np.array([0.0, 0.0, 60.0 * DEGREE])), field) - field

    def false_north(times, _):
        near = (times > 60.0) & (times < 64.0)
        return np.where(near[:, None], turned, 0.0)

    made = run(8, field=field, disturbance=false_north)
    found = made.compass()
    assert found.north is not None
    error, _ = made.heading_errors(made.smoothed(found))
    assert np.abs(error).max() < 2.0 * DEGREE


def test_a_gyro_bias_about_the_vertical_is_seen():
    made = run(9, bias=0.005, tilts=False)
    without, sigma_without = made.heading_errors(made.before)
    error, sigma = made.heading_errors(made.smoothed(made.compass()))
    assert np.ptp(np.unwrap(without)) > 10.0 * DEGREE
    assert np.abs(error).max() < 3.0 * DEGREE
    assert (np.abs(error) < 3.0 * sigma).all()
    assert sigma_without[-1] > sigma[-1]


@pytest.mark.parametrize("seed", [9, 10, 11])
def test_gyros_whose_bias_is_not_what_they_claim_leave_the_field(seed):
    """Then an attitude does not follow the headings that it was smoothed with, and that shows."""
    made = run(seed, bias=0.02, tilts=False)
    north = made.compass().north
    sure = replace(SENSORS, bias=1e-5, bias_walk=1e-7)
    follows = made.smoothed(made.compass()).q[:-1]
    leaves = smooth(made.epochs, HAND, sure, north=north).q[:-1]
    assert heading_off(north, follows) < 3.0 * DEGREE
    assert heading_off(north, leaves) > 20.0 * DEGREE


@pytest.mark.parametrize("mag_rate", [1, 5, 50])
def test_a_slow_magnetometer_will_do(mag_rate):
    made = run(10, mag_rate=mag_rate)
    found = made.compass()
    ratio = found.north.rows[:, FIELD_VARIANCE].max() / found.north.rows[0, FIELD_GATE]
    assert ratio == pytest.approx(6.0 if mag_rate == 1 else 30.0, rel=0.01)
    error, _ = made.heading_errors(made.smoothed(found))
    assert np.abs(error).max() < 2.0 * DEGREE


def noise_alone(times, rng):
    return 40e-6 * rng.standard_normal((len(times) // 10 + 1, 3)).repeat(10, axis=0)[: len(times)]


@pytest.mark.parametrize(
    ("options", "refused"),
    [
        ({"seconds": 8.0}, "short"),
        ({"field": earth(86.0)}, "steep"),
        ({"field": earth(-86.0)}, "steep"),
        ({"disturbance": noise_alone}, "disturbed"),
        ({"field": 0.2 * earth(60.0)}, "size"),
        ({"field": 3.0 * earth(60.0)}, "size"),
        # of a log in other axes
        ({"body_of_field": lambda body: body * [1.0, -1.0, -1.0]}, "disturbed"),
        ({"body_of_field": lambda body: body * [1.0, -1.0, 1.0], "tilts": False}, "disturbed"),
    ],
)
def test_what_shows_no_north_is_refused(options, refused):
    found = run(11, **options).compass()
    assert found.refused == refused
    assert found.north is None
    assert not found.verified


def test_no_field_at_all_is_refused():
    made = run(12, seconds=30.0)
    empty = replace(made.measured, count=np.zeros(len(made.epochs)))
    assert find_north(made.epochs, empty, made.before.q[:-1]).refused == "short"


def test_fields_within_a_gap_are_left_out():
    rng = np.random.default_rng(13)
    times, q = turning(60.0, rng)
    keep = (times < 20.0) | (times > 24.0)
    made = run(13, turn=(times[keep], q[keep]))
    gap = np.flatnonzero(made.epochs.gap)
    assert len(gap) == 1
    assert made.measured.count[gap[0]] == 0.0
    assert made.measured.count.sum() == pytest.approx(np.count_nonzero(keep), abs=25)
    error, sigma = made.heading_errors(made.smoothed(made.compass()))
    after = gap[0] + 5
    assert np.abs(error[after:]).max() < 4.0 * DEGREE
    assert (np.abs(error) < 3.0 * sigma).all()


@pytest.mark.parametrize(
    ("latitude", "longitude", "north", "east", "down"),
    # the test values that NOAA publishes with the model of 2020, nT
    [(80, 0, 6570.4, -146.3, 54606.0), (0, 120, 39624.3, 109.9, -10932.5)],
)
def test_the_field_is_that_of_the_world_magnetic_model(latitude, longitude, north, east, down):
    time_ns = 1_577_836_800 * 10**9
    found = model_field(np.radians(latitude), np.radians(longitude), 0.0, time_ns)
    assert np.degrees(found.declination) == pytest.approx(
        np.degrees(np.arctan2(east, north)), abs=1e-3
    )
    assert found.dip == pytest.approx(np.arctan2(down, np.hypot(north, east)), abs=1e-5)
    assert found.size == pytest.approx(1e-9 * np.linalg.norm([north, east, down]), rel=1e-5)


@pytest.mark.parametrize(
    ("dip", "size", "of_place"),
    [(60, 1.0, True), (66, 0.8, True), (75, 1.0, False), (60, 0.6, False), (60, 1.5, False)],
)
def test_a_field_that_is_not_that_of_the_place_verifies_nothing(dip, size, of_place):
    made = run(18)
    expected = EarthField(0.1, np.radians(dip), size * SIZE)
    found = find_north(made.epochs, made.measured, made.before.q[:-1], 0.0, expected)
    assert (found.of_place, found.verified) == (of_place, of_place)
    assert (found.north.variance > (20.0 * DEGREE) ** 2) == (not of_place)


def of_a_place(made, dip_deg):
    expected = EarthField(0.1, dip_deg * DEGREE, SIZE)
    return find_north(made.epochs, made.measured, made.before.q[:-1], 0.0, expected)


def test_a_field_that_points_up_where_it_should_point_down_is_refused():
    """By a sensor with all axes turned round, all headings would be off by half a turn."""
    assert of_a_place(run(18, field=earth(-60.0)), 64.0).refused == "reversed"
    assert of_a_place(run(18, field=earth(60.0)), -64.0).refused == "reversed"
    assert of_a_place(run(18, field=earth(60.0)), 64.0).refused == ""
    # Near the magnetic equator the sign of the dip says nothing
    assert of_a_place(run(18, field=earth(-9.0)), 8.0).refused == ""


def test_headings_of_a_field_that_iron_nearby_bends_are_as_uncertain_as_it_is_bent():
    rng, squares = np.random.default_rng(3), []
    for seed in range(20):
        bend = 3e-6 * rng.standard_normal(3)
        found = of_a_place(run(seed, field=earth(64.0) + bend), 64.0)
        assert found.of_place
        heading = np.arctan2(bend[1], earth(64.0)[0] + bend[0])
        squares.append(heading**2 / found.north.variance)
    assert 0.3 < np.mean(squares) < 2.5


@pytest.mark.parametrize("year", [1970, 2009, 2031])
def test_there_is_no_declination_for_other_years(year):
    time_ns = round((year - 1970.0) * 365.2425 * 86400e9) + 10**15
    assert model_field(0.8, 0.2, 0.0, time_ns) is None


def test_heading_of_a_field_is_that_of_the_body():
    made = run(14)
    correction = made.smoothed(made.compass())
    at = np.searchsorted(made.time_ns, correction.time_ns[:-1])
    given_ = to_dcm(correction.q[:-1]) @ to_dcm(made.integrated[at])
    heading = np.arctan2(given_[:, 1, 0], given_[:, 0, 0])
    true = to_euler(made.true[at])[:, 2]
    level = np.abs(to_euler(made.true[at])[:, 1]) < 1.0
    assert np.abs(wrapped(heading - true)[level]).max() < 3.0 * DEGREE


def test_a_heading_depends_on_small_turns_as_the_filter_thinks():
    rng = np.random.default_rng(16)
    matrix = to_dcm(from_euler(rng.uniform(-1.0, 1.0, 3)))
    field = earth(50.0, azimuth_deg=30.0) @ matrix  # before the matrix turns it

    def heading(turn):
        small = np.empty((3, 3))
        rotation_of(*turn, small)
        north, east, _ = small @ matrix @ field
        return np.arctan2(east, north)

    row = np.array([*field, 0.5, 0.1, 0.1])
    x, p = np.zeros(STATE), np.eye(10)
    x[:9] = matrix.ravel()
    gain, dx = np.empty(13), np.zeros(13)
    measure_heading(row, 10, x, p, gain, dx)
    steps = 1e-6 * np.eye(3)
    slope = np.array([(heading(s) - heading(-s)) / 2e-6 for s in steps])
    # of unit covariance: the gain is the derivative over its square and the variance
    expected = slope * (0.5 - heading(np.zeros(3))) / (slope @ slope + 0.1)
    assert np.allclose(dx[:3], expected, rtol=1e-6)
    assert not dx[3:].any()


def test_the_sign_of_a_quaternion_is_of_no_account():
    rng = np.random.default_rng(17)
    times, q = turning(10.0, rng)
    time_ns = np.rint(times * 1e9).astype(np.int64)
    # between the attitudes, so that they are interpolated
    at = time_ns[:-1] + 7_000_000
    magnetic = Magnetometer(at, at, rng.standard_normal((len(at), 3)))
    epochs = run(17, turn=(times, q)).epochs
    means = []
    for signs in (np.ones(len(q)), rng.choice([-1.0, 1.0], len(q))):
        stage = FieldStage(magnetic, 60_000_000)
        stage.push(Solution(time_ns, time_ns, signs[:, None] * q, q[:, 1:], q[:, 1:]))
        means.append(stage.means(epochs).field)
    assert np.abs(means[0]).max() > 0.1
    assert np.abs(means[0] - means[1]).max() < 1e-14


@pytest.mark.parametrize("noise", [0.04, 0.08])
def test_the_sigma_of_a_hard_iron_is_that_of_least_squares(noise):
    """Of epochs that hang together by 25, in one piece, beside what does not average out."""
    rng = np.random.default_rng(19)
    n = 300
    attitude = to_dcm(from_euler(rng.uniform(-np.pi, np.pi, (n, 3)) * [1.0, 0.5, 1.0]))
    field = earth(60.0) + noise * SIZE * rng.standard_normal((n, 3))
    found = find_hard_iron(field, attitude, np.zeros(n, int))
    turned = (attitude - attitude.mean(axis=0)).reshape(-1, 3)
    information = turned.T @ turned
    white = 25.0 * (noise * SIZE) ** 2 * np.linalg.inv(information)
    together = np.linalg.inv(information / n / (0.005 * SIZE) ** 2 + np.eye(3) / SIZE**2)
    # the field level, across which a heading turns: one axis of three, each turned about alike
    sigma = np.sqrt(np.trace(white + together) / 3.0)
    # far residuals count less, and so do those that remain
    assert found.sigma == pytest.approx(sigma, rel=0.3)
    assert np.sqrt(np.trace(white)) > 2.0 * np.sqrt(np.trace(together)), "else it shows nothing"
