import mpmath
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import solve_ivp

from sinstool.core import earth, rotation
from sinstool.core.quaternion_kernels import dcm, product, to_unit
from sinstool.methods.strapdown.attitude import AttitudePropagator

START = rotation.from_euler([0.4, -1.1, 2.5])


def mp_exp(phi):
    phi = [mpmath.mpf(float(v)) if not isinstance(v, mpmath.mpf) else v for v in phi]
    angle = mpmath.sqrt(sum(v * v for v in phi))
    scale = mpmath.sin(angle / 2) / angle if angle else mpmath.mpf("0.5")
    return [mpmath.cos(angle / 2), *(scale * v for v in phi)]


def mp_multiply(a, b):
    return [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]


def updates(count, seed=2):
    """Rotation vectors of every size, from nothing to more than half a turn."""
    rng = np.random.default_rng(seed)
    phi = rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-9.0, 0.4, size=(count, 1))
    phi[::17] = 0.0
    return phi, rng.uniform(0.001, 0.02, size=count)


@pytest.mark.parametrize(
    "omega", [None, earth.earth_rate_n(0.7), np.array([3.0, -90.0, 20.0])], ids=str
)
def test_product_in_high_precision(omega):
    phi, dt = updates(600)
    ours = AttitudePropagator(START, omega).push(phi, dt)
    with mpmath.workdps(40):
        q = [mpmath.mpf(float(v)) for v in START]
        for k in range(len(phi)):
            q = mp_multiply(q, mp_exp(phi[k]))
            if omega is not None:
                turn = [-mpmath.mpf(float(o)) * mpmath.mpf(float(dt[k])) for o in omega]
                q = mp_multiply(mp_exp(turn), q)
            norm = mpmath.sqrt(sum(v * v for v in q))
            error = max(abs(a - b / norm) for a, b in zip(map(float, ours[k]), q, strict=True))
            assert error < 3e-16 * (4 + np.sqrt(k))  # rounding walks at random


def test_length_stays_one():
    phi, dt = updates(50_000)
    q = AttitudePropagator(1e5 * START, [1e-3, 0.0, -5.0]).push(phi, dt)
    assert np.abs(np.linalg.norm(q, axis=-1) - 1.0).max() < 1e-15


@pytest.mark.parametrize("scale", [1.0, 3000.0])
def test_integration_of_the_differential_equation_with_earth_rate(scale):
    # A body rate of constant direction is its own rotation vector per interval, with any
    # course in time; the Earth turns below it, at its own rate and a much larger one.
    latitude = np.deg2rad(48.0)
    omega_in_n = scale * earth.earth_rate_n(latitude)
    axis_b = np.array([0.3, -0.5, 0.81])

    def body_rate(t):
        return axis_b * (0.4 + 0.7 * np.cos(1.3 * t))

    def body_angle(t):
        return axis_b * (0.4 * t + 0.7 / 1.3 * np.sin(1.3 * t))

    def equation(t, q):
        return 0.5 * (
            rotation.multiply(q, [0.0, *body_rate(t)]) - rotation.multiply([0.0, *omega_in_n], q)
        )

    time = np.sort(np.random.default_rng(3).uniform(0.0, 20.0, size=900))
    time[0], time[-1] = 0.0, 20.0
    solution = solve_ivp(
        equation, (0.0, 20.0), START, method="DOP853", t_eval=time, rtol=1e-13, atol=1e-14
    )
    phi = np.diff([body_angle(t) for t in time], axis=0)
    ours = AttitudePropagator(START, omega_in_n).push(phi, np.diff(time))
    error = rotation.log(
        rotation.multiply(rotation.conjugate(ours), rotation.normalise(solution.y.T[1:]))
    )
    assert np.abs(error).max() < 2e-12


def test_body_at_rest_keeps_its_attitude():
    # The gyro sees the Earth turn; an hour later the vehicle still points where it did.
    omega = earth.earth_rate_n(-0.6)
    dt = np.full(36_000, 0.1)
    rate_b = rotation.rotate(rotation.conjugate(START), omega)
    q = AttitudePropagator(START, omega).push(rate_b * dt[:, None], dt)
    error = rotation.log(rotation.multiply(rotation.conjugate(START), q))
    # 36 000 times the same update rounds the same way: 1e-16 each, 2e-10 deg/h in all
    assert np.abs(error).max() < 36_000 * 1.5e-16
    inertial = AttitudePropagator(START).push(rate_b * dt[:, None], dt)
    turned = rotation.log(rotation.multiply(rotation.conjugate(START), inertial[-1]))
    assert np.linalg.norm(turned) == pytest.approx(3600 * earth.EARTH_RATE, rel=1e-12)


@pytest.mark.parametrize("omega", [None, [0.1, -0.2, 0.3]])
def test_blocks_do_not_matter(omega):
    phi, dt = updates(5000)
    dt[1000:3000] = 0.01  # equal intervals are computed once
    whole = AttitudePropagator(START, omega).push(phi, dt)
    for block in (1, 7, 4096):
        state = AttitudePropagator(START, omega)
        parts = [state.push(phi[i : i + block], dt[i : i + block]) for i in range(0, 5000, block)]
        np.testing.assert_array_equal(np.concatenate(parts), whole)
        np.testing.assert_array_equal(state.q_nb, whole[-1])


def test_no_updates_change_nothing():
    state = AttitudePropagator(START)
    assert state.push(np.empty((0, 3)), np.empty(0)).shape == (0, 4)
    np.testing.assert_array_equal(state.q_nb, rotation.normalise(START))


def test_bad_arguments_are_refused():
    with pytest.raises(ValueError, match="shape"):
        AttitudePropagator(np.ones((2, 4)))
    with pytest.raises(ValueError, match="zero"):
        AttitudePropagator(np.zeros(4))
    with pytest.raises(ValueError, match="omega_in_n"):
        AttitudePropagator(START, [1.0, 2.0])
    with pytest.raises(ValueError, match="shapes"):
        AttitudePropagator(START).push(np.zeros((3, 3)), np.zeros(2))
    with pytest.raises(ValueError, match="shapes"):
        AttitudePropagator(START).push(np.zeros((3, 4)), np.zeros(3))


@pytest.mark.parametrize("square", [1.0, 1.0 + 4e-16, 1.0 - 9e-8, 1.0 + 9e-8, 1.0 + 1e-4, 0.3, 7.0])
def test_a_quaternion_becomes_one_of_unit_length(square):
    q = np.sqrt(square) * np.array([0.5, -0.1, 0.7, np.sqrt(0.25)])
    assert np.linalg.norm(to_unit(*q)) == pytest.approx(1.0, abs=5e-14)


@given(arrays(np.float64, (2, 4), elements=st.floats(-1.0, 1.0)))
def test_scalars_of_the_loops_are_those_of_rotation(q):
    assert product(*q[0], *q[1]) == pytest.approx(rotation.multiply(*q), abs=1e-15)
    size = np.linalg.norm(q[0])
    assume(size > 1e-3)
    unit = q[0] / size
    assert dcm(*unit) == pytest.approx(rotation.to_dcm(unit).ravel(), abs=1e-15)
