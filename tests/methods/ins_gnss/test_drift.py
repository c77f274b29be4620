"""What a restart admits of velocity and tilt, by how far the navigation drifted."""

import numpy as np
import pytest

from sinstool.core.rotation import from_euler
from sinstool.core.units import STANDARD_GRAVITY
from sinstool.methods.height.layout import new_state
from sinstool.methods.ins_gnss import gnss, layout, states
from sinstool.methods.strapdown.navigation import initial_state


def test_a_restart_admits_what_explains_the_drift():
    nav = initial_state(0.8, 0.1, 300.0, np.zeros(3), from_euler(np.zeros(3)))
    p0 = 1e-6 * np.eye(27)
    vehicle = np.zeros(layout.VEHICLE_SIZE)
    m = layout.new_memory(nav, np.zeros(24), p0, new_state(), vehicle)
    m.rejected[:3] = [30.0, -40.0, 5.0]
    gnss.admit_drift(m, 20.0)
    sigma = np.sqrt(np.diag(m.p))
    assert sigma[states.VELOCITY : states.VELOCITY + 3] == pytest.approx([1.5, 2.0, 0.25])
    # 50 m within 20 s are half of g times the tilt times the time squared
    tilt = 2.0 * 50.0 / (STANDARD_GRAVITY * 20.0**2)
    assert sigma[states.ATTITUDE : states.ATTITUDE + 2] == pytest.approx([tilt, tilt])
    assert sigma[states.ATTITUDE + 2] == pytest.approx(1e-3)
    before = m.p.copy()
    m.rejected[:3] = 1e-6
    gnss.admit_drift(m, 20.0)
    assert np.array_equal(m.p, before)  # never less than what is uncertain already
