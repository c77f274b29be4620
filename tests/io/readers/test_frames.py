import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sinstool.io.readers.frames import (
    enu_to_ned,
    enu_to_ned_covariance,
    q_for_log,
    q_nb_from_log,
    turn_body,
)
from tests.helpers.imulogs import ENU_NED, FLU_FRD

number = st.floats(-100.0, 100.0)
vectors = st.tuples(number, number, number).map(np.array)


@st.composite
def quaternions(draw):
    q = np.array([draw(st.floats(-1.0, 1.0)) for _ in range(4)])
    assume(np.linalg.norm(q) > 1e-3)
    return q / np.linalg.norm(q)


def to_scipy(q):
    return Rotation.from_quat(q, scalar_first=True)


@given(vectors)
def test_vectors(v):
    np.testing.assert_array_equal(turn_body(v, "frd"), v)
    np.testing.assert_allclose(turn_body(v, "flu"), FLU_FRD.apply(v), atol=1e-12)
    np.testing.assert_allclose(enu_to_ned(v), ENU_NED.apply(v), atol=1e-12)
    np.testing.assert_array_equal(turn_body(turn_body(v, "flu"), "flu"), v)
    np.testing.assert_array_equal(enu_to_ned(enu_to_ned(v)), v)


def test_a_covariance_turns_with_its_vectors():
    v = np.random.default_rng(2).standard_normal((4, 5, 3))
    np.testing.assert_array_equal(enu_to_ned_covariance(np.cov(v[0].T)), np.cov(enu_to_ned(v[0]).T))
    outer = v[..., :, None] * v[..., None, :]
    turned = enu_to_ned(v)
    np.testing.assert_array_equal(
        enu_to_ned_covariance(outer), turned[..., :, None] * turned[..., None, :]
    )
    assert not np.signbit(enu_to_ned_covariance(np.zeros((3, 3)))).any()


def test_axes_by_name():
    """Forward, left, up and east, north, up: in words, not in matrices."""
    forward, left, up = np.eye(3)
    np.testing.assert_array_equal(turn_body(forward, "flu"), [1, 0, 0])
    np.testing.assert_array_equal(turn_body(left, "flu"), [0, -1, 0])  # right is negative
    np.testing.assert_array_equal(turn_body(up, "flu"), [0, 0, -1])
    east, north, up = np.eye(3)
    np.testing.assert_array_equal(enu_to_ned(east), [0, 1, 0])
    np.testing.assert_array_equal(enu_to_ned(north), [1, 0, 0])
    np.testing.assert_array_equal(enu_to_ned(up), [0, 0, -1])


@given(quaternions(), vectors)
def test_orientation_of_a_log(q, v):
    """The same physical vector, by way of the log's frames and by way of ours."""
    in_ned = ENU_NED.apply(to_scipy(q).apply(v))
    ours = to_scipy(q_nb_from_log(q, "flu")).apply(FLU_FRD.apply(v))
    np.testing.assert_allclose(ours, in_ned, atol=1e-12 * (1 + np.linalg.norm(v)))
    np.testing.assert_array_equal(q_nb_from_log(q, "frd"), q)


@given(quaternions(), vectors, st.sampled_from(["flu", "frd"]), st.sampled_from(["enu", "ned"]))
def test_orientation_for_a_log(q_nb, v, axes, world):
    """``v`` is in FRD."""
    written = q_for_log(q_nb, axes, world)
    assert written[0] >= 0.0
    assert np.linalg.norm(written) == pytest.approx(1.0, abs=1e-15)
    in_log_body = FLU_FRD.apply(v) if axes == "flu" else v
    in_ned = to_scipy(q_nb).apply(v)
    expected = ENU_NED.apply(in_ned) if world == "enu" else in_ned
    np.testing.assert_allclose(
        to_scipy(written).apply(in_log_body), expected, atol=1e-12 * (1 + np.linalg.norm(v))
    )


@given(quaternions(), st.sampled_from([("flu", "enu"), ("frd", "ned")]))
def test_there_and_back(q_nb, way):
    axes, world = way
    back = q_nb_from_log(q_for_log(q_nb, axes, world), axes)
    assert abs(back @ q_nb) == pytest.approx(1.0, abs=1e-14)


def test_many_rows_are_each_turned():
    q = np.random.default_rng(0).normal(size=(3, 5, 4))
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    for turned in (q_nb_from_log(q, "flu"), q_for_log(q, "flu", "enu")):
        assert turned.shape == q.shape
    one = q_for_log(q[1, 2], "flu", "enu")
    np.testing.assert_array_equal(q_for_log(q, "flu", "enu")[1, 2], one)


def test_rest_facing_north_and_level():
    """A robot that faces east has the identity in REP-103; facing north is a quarter turn."""
    np.testing.assert_allclose(
        np.abs(q_for_log(np.array([1.0, 0, 0, 0]), "flu", "enu")),
        [np.sqrt(0.5), 0, 0, np.sqrt(0.5)],
    )
    east = q_nb_from_log(np.array([1.0, 0, 0, 0]), "flu")
    heading = to_scipy(east).as_euler("ZYX", degrees=True)
    np.testing.assert_allclose(heading, [90.0, 0.0, 0.0], atol=1e-12)
