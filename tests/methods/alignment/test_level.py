import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sinstool.methods.alignment.initial import level

# NED: at rest the specific force is one g upwards
UP = np.array([0.0, 0.0, -9.8])

roll = st.floats(-180.0, 180.0)
pitch = st.floats(-89.9, 89.9)
heading = st.floats(-180.0, 180.0)


def to_scipy(q):
    return Rotation.from_quat(q, scalar_first=True)


@given(roll, pitch, heading, st.floats(0.1, 1000.0))
def test_roll_and_pitch_of_any_attitude_at_rest(r, p, h, size):
    truth = Rotation.from_euler("ZYX", [h, p, r], degrees=True)
    q = level(size * truth.inv().apply(UP))
    expected = Rotation.from_euler("ZYX", [0.0, p, r], degrees=True)
    assert (to_scipy(q).inv() * expected).magnitude() < 1e-7
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-15)


@given(st.tuples(*[st.floats(-20.0, 20.0)] * 3).filter(lambda f: np.linalg.norm(f) > 1e-3))
def test_gravity_is_vertical_afterwards(force):
    """Also at the poles, where roll and heading are one."""
    force = np.array(force)
    up = to_scipy(level(force)).apply(force) / np.linalg.norm(force)
    np.testing.assert_allclose(up, [0.0, 0.0, -1.0], atol=1e-12)


def test_no_force_has_no_direction():
    with pytest.raises(ValueError, match="no direction"):
        level(np.zeros(3))
    with pytest.raises(ValueError, match="no direction"):
        level(np.full(3, np.nan))
    with pytest.raises(ValueError, match="shape"):
        level(np.ones((2, 3)))
