"""One epoch of the filter: what it does to state, errors and noise, against what they mean."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sinstool.core.earth import SEMI_MAJOR_AXIS
from sinstool.core.rotation import skew, to_dcm
from sinstool.methods.attitude_smoother import filter_step
from sinstool.methods.attitude_smoother.epochs import (
    AT_REST,
    DURATION,
    DV,
    GYRO,
    JB,
    MOVING,
    QUIET,
    REST,
    STEADY,
    WIDTH,
)
from sinstool.methods.attitude_smoother.heading_update import NO_FIELD
from sinstool.methods.attitude_smoother.model import EPOCH_S, GRAVITY
from sinstool.methods.attitude_smoother.state import (
    ERRORS,
    STATE,
    A,
    B,
    G,
    P,
    V,
    felt,
    inject,
    less,
    rotation_of,
)

# How many errors, and whether they are a hand's.
NEEDED = {
    "with position": (ERRORS, True),
    "with accelerometer bias": (ERRORS, False),
    "without": (10, False),
}
T = 0.7


def a_state():
    random = np.random.default_rng(5)
    x = np.zeros(STATE)
    q = random.normal(size=4)
    x[:9] = to_dcm(q / np.linalg.norm(q)).ravel()
    x[V : V + 3] = 3.0, -2.0, 0.7
    x[P : P + 3] = -4.0, 1.5, 2.5
    x[A : A + 3] = 0.05, -0.02, 0.01
    return x


def an_epoch(**columns):
    row = np.zeros(WIDTH)
    row[DURATION] = T
    row[JB : JB + 9] = T * to_dcm(np.array([0.9, 0.3, -0.2, 0.24]) / np.sqrt(0.9976)).ravel()
    for name, values in columns.items():
        at = getattr(filter_step, name)
        row[at : at + np.size(values)] = values
    return row


def advanced(x, row, n, hand, **parameters):
    """State, transition and noise after an epoch."""
    x, par = x.copy(), np.zeros(filter_step.PARAMETERS)
    par[filter_step.C0] = float(hand)
    for name, value in parameters.items():
        par[getattr(filter_step, name)] = value
    f, q = np.full((n, n), np.nan), np.full((n, n), np.nan)
    filter_step.predict_state(row, 0.0, par, n, x, f, q, np.empty((3, 3)))
    return x, f, q


@pytest.mark.parametrize("n, hand", NEEDED.values(), ids=NEEDED)
@pytest.mark.parametrize("pulled", [False, True])
def test_the_transition_is_what_an_epoch_makes_of_small_errors(n, hand, pulled):
    force = {"DV": (0.4, -0.3, -6.0), "DP": (0.15, -0.1, -2.1)} if pulled else {}
    row, x = an_epoch(**force), a_state()
    x[A : A + 3] *= pulled
    after, f, _ = advanced(x, row, n, hand)
    e = np.empty((3, 3))
    for j in range(n):
        if pulled and 6 <= j < 9:
            continue  # that a bias turns the force within the epoch is not in it
        ends = []
        for size in (-1e-5, 1e-5):
            wrong, dx, out = x.copy(), np.zeros(n), np.zeros(n)
            dx[j] = size
            inject(wrong, dx, n, hand, e)
            less(advanced(wrong, row, n, hand)[0], after, n, hand, out, e)
            ends.append(out)
        # a velocity turns the vertical by some 1e-6 rad an epoch, which no error turns further
        np.testing.assert_allclose(f[:, j], (ends[1] - ends[0]) / 2e-5, atol=1e-5)


def test_what_travels_turns_with_the_vertical():
    x, par = a_state(), np.zeros(filter_step.PARAMETERS)
    x[:9], x[V : V + 3], x[A : A + 3] = np.eye(3).ravel(), (200.0, -50.0, 0.0), 0.0
    # on the southern half of the Earth, whose rate points upwards less its level part
    par[filter_step.OMEGA + 2] = 5e-5
    row, f, q = an_epoch(DV=(0.0, 0.0, -GRAVITY * T)), np.empty((10, 10)), np.empty((10, 10))
    filter_step.predict_state(row, 0.0, par, 10, x, f, q, np.empty((3, 3)))
    turned = T / SEMI_MAJOR_AXIS
    np.testing.assert_allclose(x[[2, 5]], [turned * 200.0, turned * -50.0], rtol=1e-3)
    np.testing.assert_allclose(x[V : V + 2], [200.0 + 1e-4 * -50.0 * T, -50.0 - 1e-4 * 200.0 * T])
    np.testing.assert_allclose(f[:2, 3:5], [[0.0, -turned], [turned, 0.0]])


def test_a_velocity_that_was_far_off_is_none_at_rest():
    """Times the correction of the tilt it was one of some m/s, which refuted the rest."""
    x, none = a_state(), np.empty((0, STATE))
    x[V : V + 3] = 30.0, -3.0, 0.5
    for kind, left in ((AT_REST, 0.0), (MOVING, 0.01 * 30.0)):
        y, dx = x.copy(), np.zeros(ERRORS)
        dx[:2], dx[3:6] = (0.005, 0.01), -x[V : V + 3]
        filter_step.correct(none, 0, y, dx, 10, False, kind, np.empty((3, 3)))
        assert np.linalg.norm(y[V : V + 3]) == pytest.approx(left, rel=0.1, abs=1e-12)
        assert not dx.any()


def test_an_epoch_without_force_falls():
    x = a_state()
    x[G], x[A : A + 3] = 0.05, 0.0
    after, _, _ = advanced(x, an_epoch(), ERRORS, True)
    fall = np.array([0.0, 0.0, GRAVITY + 0.05])
    np.testing.assert_allclose(after[V : V + 3], x[V : V + 3] + fall * T, rtol=1e-12)
    here = x[P : P + 3] + x[V : V + 3] * T + fall * T**2 / 2.0
    np.testing.assert_allclose(after[P : P + 3], here, rtol=1e-12)
    np.testing.assert_array_equal(after[:9], x[:9])


@pytest.mark.parametrize("n, hand", NEEDED.values(), ids=NEEDED)
def test_noise_of_the_gyros_turns_velocity_and_position_with_the_attitude(n, hand):
    parameters = {"WALK": 0.02, "RATE_ERROR": 0.1, "VELOCITY_WALK": 0.5}
    parameters |= {"BIAS_WALK": 1e-3, "GRAVITY_WALK": 0.02}
    x, _, q = advanced(a_state(), an_epoch(W2=0.09), n, hand, **parameters)
    spread = 0.02**2 * T + 0.1**2 * 0.09
    through = np.zeros((n, 3))
    through[:3], through[3:6] = np.eye(3), skew(x[V : V + 3])
    if hand:
        through[10:] = skew(x[P : P + 3])
    expected = spread * through @ through.T
    for rows, walk in ((range(3, 6), 0.5), (range(6, 9), 1e-3), ((9,), 0.02)):
        for i in rows:
            expected[i, i] += walk**2 * T
    np.testing.assert_allclose(q, expected, atol=1e-15)


@pytest.mark.parametrize("n, hand", NEEDED.values(), ids=NEEDED)
def test_a_gap_leaves_attitude_and_biases_and_nothing_of_the_motion(n, hand):
    x = a_state()
    x[B : B + 3], x[G] = (0.01, -0.02, 0.03), 0.1
    variances = {"VELOCITY_VARIANCE": 9.0, "POSITION_VARIANCE": 49.0}
    row = an_epoch(DV=(1.0, 2.0, 3.0), DP=(0.1, 0.2, 0.3), GAP=1.0)
    after, f, q = advanced(x, row, n, hand, BIAS_WALK=1e-3, GRAVITY_WALK=0.02, **variances)
    lost = slice(10, 13)
    expected = x.copy()
    expected[V : V + 3] = 0.0
    same, noise = np.ones(n), np.zeros(n)
    same[3:6], noise[3:6] = 0.0, 9.0
    noise[:3] = (filter_step.GAP_RATE * T) ** 2
    noise[6:9], noise[9] = 1e-6 * T, 0.02**2 * T
    if hand:
        expected[P : P + 3] = 0.0
        same[lost], noise[lost] = 0.0, 49.0
    np.testing.assert_array_equal(after, expected)
    np.testing.assert_array_equal(f, np.diag(same))
    np.testing.assert_allclose(q, np.diag(noise), rtol=1e-12)


@pytest.mark.parametrize(
    "marked, tilt_sigma, pulled, kind",
    [
        (STEADY, 0.002, 0.0, STEADY),
        # braking, at a time when the tilt would show it
        (STEADY, 0.002, 0.12, QUIET),
        (STEADY, 0.002, 0.4, MOVING),
        # ... and when it might be a tilt
        (STEADY, 0.03, 0.0, QUIET),
        # A rest is more likely than an acceleration that looks like one.
        (AT_REST, 0.002, 0.12, AT_REST),
        (AT_REST, 0.03, 0.0, AT_REST),
        (AT_REST, 0.002, 0.4, MOVING),
    ],
)
def test_travel_is_steady_only_where_the_tilt_leaves_no_room_for_an_acceleration(
    marked, tilt_sigma, pulled, kind
):
    n = 10
    x, p = np.zeros(STATE), np.zeros((n, n))
    x[:9] = np.eye(3).ravel()
    p[0, 0] = p[1, 1] = tilt_sigma**2
    par = np.zeros(filter_step.PARAMETERS)
    par[filter_step.REST_FORCE], par[filter_step.ZERO_RATE] = 0.025, 1e-3
    row = an_epoch(DV=(pulled * T, 0.0, -GRAVITY * T))
    row[JB : JB + 9], row[REST] = 0.0, marked
    assert filter_step.rest_kind(row, par, x, p, np.zeros(n), 0.0) == kind


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-6, 9e-5, 1.1e-4, 1e-2, 1.0, 3.1])
def test_the_matrix_of_a_rotation_of_any_size(size):
    vector = size * np.array([0.48, -0.6, 0.64])
    e, found, x, y = np.empty((3, 3)), np.zeros(10), np.zeros(STATE), np.zeros(STATE)
    rotation_of(*vector, e)
    np.testing.assert_allclose(e, Rotation.from_rotvec(vector).as_matrix(), atol=1e-15, rtol=0)
    # and back again
    x[:9], y[:9] = e.ravel(), np.eye(3).ravel()
    less(x, y, 10, False, found, np.empty((3, 3)))
    np.testing.assert_allclose(found[:3], vector, rtol=1e-7, atol=2e-16)


@pytest.mark.parametrize("sways", [0.0, 3e-7])
def test_at_rest_the_rate_shows_the_bias_to_its_noise_and_its_sway(sways):
    n, known, own = 10, 1e-3, 4e-7
    row = an_epoch(DV=(0.0, 0.0, -GRAVITY * T), OWN_RATE=own, SWAY_RATE=own + sways)
    row[JB : JB + 9], row[REST] = T * np.eye(3).ravel(), STEADY
    rate = np.array([4e-3, -2e-3, 1e-3])
    row[GYRO : GYRO + 3] = rate
    par = np.zeros(filter_step.PARAMETERS)
    par[filter_step.ZERO_RATE] = 5e-4
    x, p, dx = np.zeros(STATE), np.zeros((n, n)), np.zeros(n)
    x[:9] = np.eye(3).ravel()
    p[range(6, 9), range(6, 9)] = known**2
    filter_step.measure(row, NO_FIELD, 0, par, n, x, p, np.empty(n), dx, np.empty((n, n)), STEADY)
    # the bias wanders as in epochs of the usual length
    noise = 5e-4**2 * EPOCH_S / T + own + filter_step.SWAY_LASTS * sways
    gain = known**2 / (known**2 + noise)
    np.testing.assert_allclose(dx[6:9], gain * rate, rtol=1e-9)
    np.testing.assert_allclose(p[range(6, 9), range(6, 9)], gain * noise, rtol=1e-9)


def test_a_bias_of_the_accelerometers_is_a_force_that_turns_with_the_body():
    """What a vehicle's level force shows of it, against differences of the force itself."""
    n, x, row = ERRORS, a_state(), an_epoch(DV=(0.2, -0.1, -GRAVITY * T))
    x[V : V + 3], e = 0.0, np.empty((3, 3))
    par = np.zeros(filter_step.PARAMETERS)
    par[filter_step.C1], par[filter_step.DENSITY] = 0.03, 4.0
    p, dx = np.diag(np.full(n, 1e-12)), np.zeros(n)
    p[10:, 10:] = np.diag([0.03, 0.05, 0.02]) ** 2
    slope = np.zeros((3, n))
    for j in range(10, 13):
        wrong, off = x.copy(), np.zeros(n)
        off[j] = 1e-3
        inject(wrong, off, n, False, e)
        slope[:, j] = np.subtract(felt(wrong, row, DV, 0.5), felt(x, row, DV, 0.5)) / T / 1e-3
    left = -np.array(felt(x, row, DV, 0.5)) / T - [0.0, 0.0, GRAVITY + x[G]]
    noise = 4.0**2 / T * np.eye(3)
    gain = p @ slope.T @ np.linalg.inv(slope @ p @ slope.T + noise)
    expected, less_sure = gain @ left, p - gain @ slope @ p
    work = np.empty(n), dx, np.empty((n, n))
    filter_step.measure(row, NO_FIELD, 0, par, n, x, p, *work, MOVING)
    np.testing.assert_allclose(dx[10:], expected[10:], rtol=1e-6)
    np.testing.assert_allclose(p[10:, 10:], less_sure[10:, 10:], rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("hidden", [0.0, 0.2**2])
def test_steady_travel_shows_the_tilt_but_for_an_acceleration_that_looks_like_none(hidden):
    n, known = 10, 0.03
    row = an_epoch(DV=(0.1 * T, 0.0, -GRAVITY * T), FORCE_DOUBT=hidden)
    row[JB : JB + 9], row[REST] = T * np.eye(3).ravel(), STEADY
    x, p, dx = np.zeros(STATE), np.zeros((n, n)), np.zeros(n)
    x[:9] = np.eye(3).ravel()
    p[0, 0] = p[1, 1] = known**2
    par = np.zeros(filter_step.PARAMETERS)
    par[filter_step.ZERO_RATE] = 1e-3
    filter_step.measure(row, NO_FIELD, 0, par, n, x, p, np.empty(n), dx, np.empty((n, n)), STEADY)
    noise = filter_step.REST_DENSITY**2 / T + hidden
    gain = (GRAVITY * known) ** 2 / ((GRAVITY * known) ** 2 + noise)
    np.testing.assert_allclose(dx[:2], [0.0, gain * 0.1 / GRAVITY], atol=1e-12)
    np.testing.assert_allclose(p[[0, 1], [0, 1]], (1.0 - gain) * known**2, rtol=1e-9)


def test_what_may_be_a_slow_turn_shows_the_bias_but_about_the_vertical():
    n, known, turn = 10, 1e-2, 3e-3
    row = an_epoch(DV=(0.0, 0.0, -GRAVITY * T), TURN_DOUBT=turn**2)
    body = Rotation.from_euler("xyz", [0.3, -0.4, 0.5]).as_matrix()
    row[JB : JB + 9], row[REST] = T * body.ravel(), QUIET
    x, p, dx = np.zeros(STATE), np.zeros((n, n)), np.zeros(n)
    x[:9] = np.eye(3).ravel()
    p[range(6, 9), range(6, 9)] = known**2
    par = np.zeros(filter_step.PARAMETERS)
    par[filter_step.DENSITY] = 1e3
    row[filter_step.OWN_RATE] = 1e-10
    filter_step.measure(row, NO_FIELD, 0, par, n, x, p, np.empty(n), dx, np.empty((n, n)), QUIET)
    sigma = np.sqrt(np.diag(body @ p[6:9, 6:9] @ body.T))
    left = known * turn / np.hypot(known, turn)
    np.testing.assert_allclose(sigma, [1e-5, 1e-5, left], rtol=1e-3)
