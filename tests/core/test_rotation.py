import mpmath
import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sinstool.core import rotation
from sinstool.core.quaternion_kernels import wrapped_angle

component = st.floats(-1.0, 1.0, allow_nan=False)


@st.composite
def directions(draw):
    v = np.array([draw(component) for _ in range(3)])
    assume(np.linalg.norm(v) > 1e-3)
    return v / np.linalg.norm(v)


# Angles where something could go wrong, and everywhere else.
angles = st.one_of(
    st.floats(0.0, np.pi),
    st.floats(-320.0, 0.0).map(lambda e: 10.0**e),
    st.floats(-16.0, 0.0).map(lambda e: np.pi - 10.0**e),
    st.sampled_from([0.0, 1e-4, np.nextafter(1e-4, 0.0), np.pi / 2, np.pi]),
)
vectors = st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)).map(np.array)


@st.composite
def quaternions(draw):
    q = np.array([draw(component) for _ in range(4)])
    assume(np.linalg.norm(q) > 1e-3)
    return q / np.linalg.norm(q)


def scipy_of(q):
    return Rotation.from_quat(q, scalar_first=True)


def same_rotation(p, q):
    return np.linalg.norm(rotation.log(rotation.multiply(rotation.conjugate(p), q)), axis=-1)


@given(directions(), angles)
def test_log_inverts_exp(direction, angle):
    phi = angle * direction
    q = rotation.exp(phi)
    assert abs(np.linalg.norm(q) - 1.0) < 4e-16
    back = rotation.log(q)
    if angle > np.pi - 1e-15:  # either axis is right at half a turn
        back = back * np.sign(back @ phi)
    np.testing.assert_allclose(back, phi, rtol=1e-15, atol=1e-15 if angle > 1e-3 else 1e-300)


@given(directions(), st.floats(0.0, 30.0))
def test_exp_is_that_of_scipy(direction, angle):
    ours = rotation.exp(angle * direction)
    theirs = Rotation.from_rotvec(angle * direction).as_quat(scalar_first=True)
    np.testing.assert_allclose(ours * np.sign(ours @ theirs), theirs, rtol=0, atol=1e-15)


@pytest.mark.parametrize("angle", [1e-12, 9.9e-5, 1.01e-4, 0.3, 3.1415, 7.0])
def test_exp_to_full_precision(angle):
    direction = np.array([2.0, -3.0, 6.0]) / 7.0
    q = rotation.exp(angle * direction)
    with mpmath.workdps(40):
        phi = [mpmath.mpf(float(v)) for v in angle * direction]
        length = mpmath.sqrt(sum(v * v for v in phi))
        exact = [mpmath.cos(length / 2)] + [mpmath.sin(length / 2) / length * v for v in phi]
        assert abs(q[0] - exact[0]) <= 2e-16 * max(1.0, angle)
        for ours, true in zip(q[1:], exact[1:], strict=True):
            assert abs(ours - true) <= 2e-16 * angle  # relative, for the smallest angles too


@given(quaternions())
@example(np.array([0.0, 0.6, -0.8, 0.0]))
@example(np.array([-1.0, 1e-9, 0.0, 0.0]))
def test_log_is_the_shortest_and_that_of_scipy(q):
    phi = rotation.log(q)
    assert np.linalg.norm(phi) <= np.pi * (1 + 1e-15)
    np.testing.assert_allclose(rotation.log(3.7 * q), phi, atol=2e-15)
    if abs(q[0]) > 1e-12:
        np.testing.assert_allclose(rotation.log(-q), phi, atol=0)
        np.testing.assert_allclose(phi, scipy_of(q).as_rotvec(), atol=4e-15)
    assert same_rotation(rotation.exp(phi), q) < 4e-15


@given(quaternions(), quaternions(), vectors)
def test_composition_is_the_product_of_matrices(p, q, v):
    product = rotation.multiply(p, q)
    np.testing.assert_allclose(
        rotation.to_dcm(product), rotation.to_dcm(p) @ rotation.to_dcm(q), atol=2e-15
    )
    assert same_rotation(product, (scipy_of(p) * scipy_of(q)).as_quat(scalar_first=True)) < 4e-15
    rotated = rotation.rotate(q, v)
    scale = np.abs(v).max()  # a norm may underflow
    np.testing.assert_allclose(rotated, rotation.to_dcm(q) @ v, atol=2e-15 * scale)
    np.testing.assert_allclose(rotated, scipy_of(q).apply(v), atol=2e-15 * scale)
    sandwich = rotation.multiply(rotation.multiply(q, [0.0, *v]), rotation.conjugate(q))
    np.testing.assert_allclose(sandwich, [0.0, *rotated], atol=3e-15 * scale)


@given(quaternions())
def test_conjugate_undoes(q):
    one = rotation.multiply(rotation.conjugate(q), q)
    np.testing.assert_allclose(one, [1, 0, 0, 0], atol=1e-15)


@given(directions(), angles)
def test_dcm_roundtrip_at_every_angle(direction, angle):
    q = rotation.exp(angle * direction)
    back = rotation.from_dcm(rotation.to_dcm(q))
    assert back[0] >= 0.0
    assert same_rotation(back, q) < 2e-15
    theirs = Rotation.from_matrix(rotation.to_dcm(q)).as_quat(scalar_first=True)
    assert same_rotation(back, theirs) < 3e-15


@given(st.floats(-np.pi, np.pi), st.floats(-np.pi / 2, np.pi / 2), st.floats(-np.pi, np.pi))
def test_euler_is_that_of_scipy(roll, pitch, heading):
    q = rotation.from_euler([roll, pitch, heading])
    # upper case: intrinsic, heading about z first, then pitch about the new y, then roll
    theirs = Rotation.from_euler("ZYX", [heading, pitch, roll])
    assert same_rotation(q, theirs.as_quat(scalar_first=True)) < 2e-15
    angles = rotation.to_euler(q)
    if np.cos(pitch) > 1e-3:
        turns = (angles - [roll, pitch, heading]) / (2 * np.pi)
        assert np.all(np.abs(turns - np.round(turns)) < 1e-12)


@given(
    st.floats(-np.pi, np.pi),
    st.sampled_from([-1.0, 1.0]),
    st.one_of(st.just(0.0), st.floats(-17.0, -1.0).map(lambda e: 10.0**e)),
    st.floats(-np.pi, np.pi),
)
def test_euler_keeps_the_attitude_near_straight_up_and_down(roll, sign, off, heading):
    q = rotation.from_euler([roll, sign * (np.pi / 2 - off), heading])
    angles = rotation.to_euler(q)
    assert same_rotation(rotation.from_euler(angles), q) < 1e-14
    assert np.all(np.abs(angles) <= [np.pi, np.pi / 2, np.pi])


@given(quaternions())
@example(np.array([0.0, 0.6, -0.8, 0.0]))  # upside down
@example(np.array([0.0, 0.0, 0.0, 1.0]))
@example(np.array([-(2.0**-52), 0.0, 0.0, 1.0]))
def test_tilt_and_heading_are_all_of_a_rotation(q):
    tilt, heading = rotation.tilt_and_heading(q)
    turned = rotation.exp([0.0, 0.0, heading])
    assert same_rotation(rotation.multiply(turned, rotation.exp([*tilt, 0.0])), q) < 1e-12
    down = np.array([0.0, 0.0, 1.0])
    between = np.linalg.norm(np.cross(rotation.rotate(q, down), down))
    assert abs(np.sin(np.linalg.norm(tilt)) - between) < 1e-12
    assert -np.pi < heading <= np.pi


def test_straight_up_has_heading_alone():
    q = rotation.from_euler([0.3, np.pi / 2, 1.0])
    np.testing.assert_allclose(rotation.to_euler(q), [0.0, np.pi / 2, 0.7], atol=1e-15)
    q = rotation.from_euler([0.3, -np.pi / 2, 1.0])
    np.testing.assert_allclose(rotation.to_euler(q), [0.0, -np.pi / 2, 1.3], atol=1e-15)


def test_signs_of_roll_pitch_heading_are_those_of_frd_in_ned():
    # Heading 90 degrees: forward is East. Then nose up 30: forward has Down = -1/2.
    q = rotation.from_euler(np.deg2rad([0.0, 30.0, 90.0]))
    np.testing.assert_allclose(rotation.rotate(q, [1, 0, 0]), [0, np.sqrt(3) / 2, -0.5], atol=1e-15)
    # Right wing down 30 at heading East: right (South) points down by 1/2.
    q = rotation.from_euler(np.deg2rad([30.0, 0.0, 90.0]))
    np.testing.assert_allclose(rotation.rotate(q, [0, 1, 0]), [-np.sqrt(3) / 2, 0, 0.5], atol=1e-15)


@given(quaternions(), st.floats(-300.0, 300.0))
def test_normalise_of_any_scale(q, exponent):
    np.testing.assert_allclose(rotation.normalise(10.0**exponent * q), q, atol=1e-14)


def test_everything_broadcasts():
    rng = np.random.default_rng(5)
    q = rotation.exp(rng.normal(size=(2, 1, 5, 3)))
    p = rotation.exp(rng.normal(size=(4, 1, 3)))
    v = rng.normal(size=(5, 3))
    product = rotation.multiply(q, p)
    assert product.shape == (2, 4, 5, 4)
    np.testing.assert_array_equal(product[1, 2, 3], rotation.multiply(q[1, 0, 3], p[2, 0]))
    assert rotation.rotate(q, v).shape == (2, 1, 5, 3)
    for there, back in (
        (rotation.to_dcm, rotation.from_dcm),
        (rotation.to_euler, rotation.from_euler),
        (rotation.log, rotation.exp),
    ):
        assert np.max(same_rotation(back(there(q)), q)) < 4e-15
    for function in (rotation.log, rotation.to_euler, rotation.to_dcm, rotation.normalise):
        np.testing.assert_array_equal(function(q)[1, 0, 4], function(q[1, 0, 4]))


@pytest.mark.parametrize(
    ("function", "shape"),
    [
        (rotation.exp, (4,)),
        (rotation.log, (3,)),
        (rotation.conjugate, (2, 3)),
        (rotation.normalise, (3,)),
        (rotation.to_dcm, (3, 3)),
        (rotation.from_dcm, (3, 4)),
        (rotation.from_dcm, (3,)),
        (rotation.to_euler, ()),
        (rotation.tilt_and_heading, (3,)),
        (rotation.from_euler, (4,)),
        (lambda v: rotation.rotate([1, 0, 0, 0], v), (4,)),
        (lambda q: rotation.multiply(q, [1, 0, 0, 0]), (3,)),
    ],
)
def test_wrong_shapes_are_refused(function, shape):
    with pytest.raises(ValueError, match="shape"):
        function(np.ones(shape))


def test_impossible_values_are_refused():
    with pytest.raises(ValueError, match="zero"):
        rotation.normalise([[1, 0, 0, 0], [0, 0, 0, 0]])
    with pytest.raises(ValueError, match="zero or infinite"):
        rotation.normalise([np.nan, 0, 0, 0])
    with pytest.raises(ValueError, match="determinant"):
        rotation.from_dcm(np.diag([1.0, 1.0, -1.0]))


def test_wrapped():
    angles = np.array([4.0, -4.0, 0.5, np.pi, -np.pi, 30.0])
    expected = [4 - 2 * np.pi, 2 * np.pi - 4, 0.5, np.pi, np.pi, 30.0 - 10 * np.pi]
    np.testing.assert_allclose(rotation.wrapped(angles), expected, atol=1e-14)
    np.testing.assert_allclose([wrapped_angle(a) for a in angles], expected, atol=1e-14)


def test_skew_is_the_cross_product():
    v, w = np.random.default_rng(1).standard_normal((2, 4, 3))
    product = np.einsum("...ij,...j->...i", rotation.skew(v), w)
    np.testing.assert_allclose(product, np.cross(v, w), atol=1e-15)
    with pytest.raises(ValueError, match="shape"):
        rotation.skew([1.0, 2.0])


def test_many_matrices_are_converted_as_one_by_one(monkeypatch):
    q = rotation.normalise(np.random.default_rng(2).normal(size=(7, 3, 4)))
    whole = rotation.from_dcm(rotation.to_dcm(q))
    monkeypatch.setattr(rotation, "_AT_ONCE", 5)
    np.testing.assert_array_equal(rotation.from_dcm(rotation.to_dcm(q)), whole)
    assert rotation.from_dcm(np.empty((0, 3, 3))).shape == (0, 4)
