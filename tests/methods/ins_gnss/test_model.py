"""F against differences of the mechanisation itself, in many digits."""

import types

import mpmath
import numpy as np
import pytest
from mpmath import mp, mpf

from sinstool.core import earth, quaternion_kernels, rotation
from sinstool.core.gravity import normal_gravity
from sinstool.core.quaternion_kernels import cross, increment_quaternion, to_unit, wrapped_angle
from sinstool.methods.height.channel import baro_sample
from sinstool.methods.height.layout import (
    ACCEPTED,
    CORRECTED,
    S_CORRECTION,
    S_L1,
    S_L2,
    S_L3,
    new_events,
    new_parameters,
    new_state,
)
from sinstool.methods.height.network import HeightNetwork
from sinstool.methods.ins_gnss.model import baro_correction, error_rates, radii, transition
from sinstool.methods.ins_gnss.states import (
    ACCEL_AXES,
    ACCEL_BIAS,
    ACCEL_SCALE,
    AXES_PAIRS,
    BARO,
    CORRECTION,
    FILTERS,
    GYRO_AXES,
    GYRO_BIAS,
    GYRO_SCALE,
    I_MOVING,
    I_STATES,
    VELOCITY,
    WIDTH,
)
from sinstool.methods.strapdown import navigation

FULL = FILTERS["network-29a"].with_axes
SIZE = FULL.size
DRIVING = ACCEL_AXES + 6  # states that drive the moving ones

# latitude, height, velocity, roll pitch heading, rate, specific force
MOTIONS = [
    (0.6, 400.0, (40.0, -43.0, -3.0), (0.03, 0.1, 2.0), (0.01, 0.02, -0.1), (0.5, 0.3, -9.7)),
    (-0.9, 9000.0, (-180.0, 160.0, 12.0), (-0.6, 0.2, -1.0), (0.2, 0.0, 0.1), (2.0, -4.0, -14.0)),
    (1.35, -50.0, (3.0, 1.0, 0.2), (0.0, -0.4, 0.5), (-0.3, 0.5, 1.0), (-3.0, 1.0, -8.0)),
    (0.02, 30000.0, (700.0, -500.0, -90.0), (2.5, 1.0, 3.0), (0.0, 0.0, 0.0), (20.0, 5.0, 3.0)),
]


def many_digits(function, **names):
    """A compiled function's own source, computing with as many digits as mpmath has."""
    plain = function.py_func
    exact = {name: getattr(mpmath, name) for name in ("sin", "cos", "sqrt", "atan2", "hypot")}
    return types.FunctionType(plain.__code__, {**plain.__globals__, **exact, **names})


EXACT_GRAVITY = many_digits(normal_gravity)


def exact_step(state, turn, push, dt, correction):
    """One update, with an acceleration taken from the upward one as a damping network does."""
    step = many_digits(
        navigation.step,
        increment_quaternion=many_digits(increment_quaternion),
        to_unit=many_digits(to_unit),
        cross=many_digits(cross),
        product=many_digits(quaternion_kernels.product),
        normal_gravity=lambda *where: EXACT_GRAVITY(*where) + correction,
        wrapped_angle=many_digits(wrapped_angle),
    )
    step(state, *turn, *push, dt, 0)


def exact_radii(latitude, height):
    square = 1 - mpf(earth.ECCENTRICITY_SQUARED) * mpmath.sin(latitude) ** 2
    transverse = mpf(earth.SEMI_MAJOR_AXIS) / mpmath.sqrt(square)
    return transverse * (1 - mpf(earth.ECCENTRICITY_SQUARED)) / square + height, transverse + height


def product(p, q):
    (a, b, c, d), (e, f, g, h) = p, q
    return [
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    ]


def propagated(motion, x, dt):
    """State after a step whose start, sensors and correction are wrong by x."""
    lat, h, v, angles, rate, force = motion
    rm, rn = exact_radii(mpf(lat), mpf(h))
    q = [mpf(float(a)) for a in rotation.from_euler(angles)]
    length = mpmath.sqrt(sum(a * a for a in q))
    q = [a / length for a in q]
    turn = [-x[6] / 2, -x[7] / 2, -x[8] / 2]
    q = product([mpmath.sqrt(1 - sum(a * a for a in turn)), *turn], q)
    state = [
        lat + x[0] / rm,
        mpf("0.3") + x[1] / (rn * mpmath.cos(mpf(lat))),
        h - x[2],
        *(v[i] + x[3 + i] for i in range(3)),
        *q,
    ]
    turn = [(rate[i] * (1 + x[GYRO_SCALE + i]) + x[GYRO_BIAS + i]) * dt for i in range(3)]
    push = [(force[i] * (1 + x[ACCEL_SCALE + i]) + x[ACCEL_BIAS + i]) * dt for i in range(3)]
    for k, (i, other) in enumerate(AXES_PAIRS):
        turn[i] += rate[other] * x[GYRO_AXES + k] * dt
        push[i] += force[other] * x[ACCEL_AXES + k] * dt
    exact_step(state, turn, push, dt, x[CORRECTION])
    return state


def difference_quotient(motion):
    """F by central differences of one step of the mechanisation, shape (9, DRIVING)."""
    dt, size = mpf("1e-40"), mpf("1e-8")
    out = np.zeros((9, DRIVING))
    none = [mpf(0)] * SIZE
    nominal = propagated(motion, none, dt)
    rm, rn = exact_radii(nominal[0], nominal[2])
    across = rn * mpmath.cos(nominal[0])
    for j in range(out.shape[1]):
        if j == BARO:
            continue
        ends = []
        for sign in (1, -1):
            x = list(none)
            x[j] = sign * size
            ends.append(propagated(motion, x, dt))
        plus, minus = ends
        change = [
            (plus[0] - minus[0]) * rm,
            (plus[1] - minus[1]) * across,
            minus[2] - plus[2],
            *(plus[3 + i] - minus[3 + i] for i in range(3)),
        ]
        # psi takes the computed attitude to the true one
        psi = [product(nominal[6:], [end[6], -end[7], -end[8], -end[9]]) for end in (plus, minus)]
        change += [2 * (psi[0][1 + i] - psi[1][1 + i]) for i in range(3)]
        for i in range(9):
            whole = change[i] / (2 * size)
            out[i, j] = float((whole - (1 if i == j else 0)) / dt)
    return out


def rates(motion, kind=FULL, gains=(0.0, 0.0, 0.0)):
    lat, h, v, angles, rate, force = motion
    c = rotation.to_dcm(rotation.from_euler(angles))
    index = kind.index
    out = np.full((index[I_MOVING], index[I_STATES]), np.nan)
    means = [2.0 * c, 2.0 * c * np.array(force), 2.0 * c * np.array(rate)]
    across = [2.0 * c[:, i] * of[k] for of in (rate, force) for i, k in AXES_PAIRS]
    means.append(np.stack(across, axis=1))
    error_rates(index, lat, h, *v, *means, 0.5, *gains, out)
    return out


@pytest.mark.parametrize("motion", MOTIONS)
def test_f_is_the_derivative_of_the_mechanisation(motion):
    with mp.workdps(130):
        exact = difference_quotient(motion)
    ours = rates(motion)[:9, :DRIVING]
    # An element of C that is nothing is nothing but for the rounding of C
    floor = np.full(ours.shape, 1e-35)
    floor[:, GYRO_BIAS:] = 1e-15
    assert np.all(abs(ours - exact) <= 1e-6 * abs(exact) + floor)
    assert np.all((ours != 0.0) | (abs(exact) <= floor))
    assert np.count_nonzero(ours) >= 60  # also where nothing turns


def test_radii():
    rm, rn = radii(0.7, 1234.0)
    meridian, transverse = earth.radii_of_curvature(0.7)
    assert (rm, rn) == pytest.approx((meridian + 1234.0, transverse + 1234.0), rel=1e-15)


@pytest.mark.parametrize("kind", [*FILTERS.values(), FILTERS["markov-27"].with_axes])
def test_smaller_filters_have_parts_of_f(kind):
    gains = (0.1, 0.02, 0.001) if kind.network else (0.0, 0.0, 0.0)
    full = rates(MOTIONS[0], gains=gains)
    part = rates(MOTIONS[0], kind, gains)
    moving = kind.states[kind.states < BARO]
    assert np.array_equal(part, full[np.ix_(moving, kind.states)])
    assert kind.size == len(part[0])


def test_continuous_network():
    gains = (0.3, 0.03, 0.001)
    change = rates(MOTIONS[1], gains=gains) - rates(MOTIONS[1])
    # h' -= K1 e, v_up' -= K2 e, A' += K3 e with e = dh - dh_B, h up
    expected = np.zeros_like(change)
    for row, gain, sign in (
        (2, gains[0], 1),
        (VELOCITY + 2, gains[1], 1),
        (CORRECTION, gains[2], -1),
    ):
        e = np.zeros(SIZE)
        e[2], e[BARO] = -1.0, -1.0
        expected[row] = sign * gain * e
    expected[CORRECTION] *= -1.0
    assert change == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize("motion", MOTIONS)
def test_transition_is_the_exponential_to_second_order(motion):
    from scipy.linalg import expm

    full = np.zeros((SIZE, SIZE))
    full[:10] = rates(motion, gains=(0.1, 0.02, 0.001))
    decay_rate = np.zeros(SIZE)
    decay_rate[BARO], decay_rate[DRIVING:] = 1 / 300, 1 / 60
    full -= np.diag(decay_rate)
    off = []
    for delta in (0.2, 0.1):
        phi, decay = np.zeros((10, WIDTH)), np.ones(WIDTH)
        made_up = np.pad(full[:10], ((0, 0), (0, WIDTH - SIZE)))
        transition(FULL.index, made_up, np.append(decay_rate, 0.0), delta, phi, decay)
        exact = expm(full * delta)
        off.append(abs(phi[:, :SIZE] - exact[:10]).max())
        assert not phi[:, SIZE:].any()
        assert decay[10:SIZE] == pytest.approx(np.diag(exact)[10:], rel=1e-12)
    assert off[0] < 0.05
    assert np.log2(off[0] / off[1]) == pytest.approx(3.0, abs=0.15)


@pytest.mark.parametrize("k4", [0.0, 0.5, -1.0])
def test_baro_correction_is_what_the_channel_does(k4):
    network = HeightNetwork(4.0, k4)
    parameters = new_parameters(network, shadow=False)
    channel, events = new_state(), new_events(10)
    truth = np.array([400.0, 7.0])  # height, v_up
    for t in (0.1, 0.2):
        baro_sample(channel, parameters, events, t, 400.0, 0.0, t, 400.0, ACCEPTED)
    wrong = {"height": 0.8, "v_up": -0.3, "a": 0.02, "baro": -0.5}
    channel[S_CORRECTION] = wrong["a"]
    v_up = truth[1] + wrong["v_up"]
    what, dh, dv = baro_sample(
        channel,
        parameters,
        events,
        0.7,
        truth[0] + wrong["height"],
        v_up,
        0.7,
        truth[0] + wrong["baro"],
        ACCEPTED,
    )
    assert what == CORRECTED
    x = np.zeros(SIZE)
    x[2], x[5], x[CORRECTION] = -wrong["height"], -wrong["v_up"], wrong["a"]
    x[BARO] = wrong["baro"]
    before = x.copy()
    random = np.random.default_rng(3)
    root = random.standard_normal((SIZE, SIZE))
    p = root @ root.T
    rest = p.copy()
    phi = random.standard_normal((SIZE, SIZE))
    phi_before = phi.copy()
    gains = channel[S_L1], channel[S_L2], channel[S_L3]
    baro_correction(FULL.index, *gains, k4 * v_up, 0.09, p, x, phi, np.zeros(SIZE))
    assert -x[2] == pytest.approx(wrong["height"] + dh, abs=1e-9)
    assert -x[5] == pytest.approx(wrong["v_up"] + dv, abs=1e-12)
    assert x[CORRECTION] == pytest.approx(channel[S_CORRECTION], abs=1e-14)
    assert np.array_equal(np.delete(x, [2, 5, 9]), np.delete(before, [2, 5, 9]))
    # as matrices
    gain = np.zeros(SIZE)
    gain[2], gain[5], gain[CORRECTION] = gains
    m = np.eye(SIZE)
    m[:, 2] -= gain
    m[:, BARO] -= gain
    assert p == pytest.approx(m @ rest @ m.T + 0.09 * np.outer(gain, gain), abs=1e-10)
    assert np.array_equal(p, p.T)
    assert phi == pytest.approx(m @ phi_before, abs=1e-12)
