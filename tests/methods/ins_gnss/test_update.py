"""One measurement, against the same in matrices."""

import numpy as np
import pytest

from sinstool.core.rotation import from_euler
from sinstool.methods.height.layout import new_state
from sinstool.methods.ins_gnss import layout, update
from sinstool.methods.ins_gnss.states import ATTITUDE
from sinstool.methods.ins_gnss.update import NO_HEADING, NOT_LEVEL
from sinstool.methods.strapdown.navigation import initial_state

N = 15


def a_measurement(rows, tilt=1e-3, seed=3):
    """A filter about to be corrected, and its P, H, R, innovation and estimate."""
    random = np.random.default_rng(seed)
    nav = initial_state(0.8, 0.1, 300.0, np.zeros(3), from_euler(np.zeros(3)))
    root = random.standard_normal((N, N))
    root[ATTITUDE : ATTITUDE + 2] *= tilt
    root[ATTITUDE + 2] *= NO_HEADING
    p, x = root @ root.T, random.standard_normal(N)
    m = layout.new_memory(nav, np.zeros(24), p, new_state(), np.zeros(layout.VEHICLE_SIZE))
    h, nu = random.standard_normal((rows, N)), random.standard_normal(rows)
    r = random.uniform(0.5, 20.0, rows)
    m.h[:rows, :N], m.nu[:rows], m.r[:rows], m.x[:N] = h, nu, r, x
    update.project(m, rows)
    return m, p, h, np.diag(r), nu, x


@pytest.mark.parametrize("rows", [1, 3, 6])
@pytest.mark.parametrize(
    ("epsilon", "tilt"), [(0.0, 1e-3), (0.05, 1e-3), (0.7, 1e-3), (1.0, 1e-3), (0.0, 1.0)]
)
def test_a_measurement_with_kalmans_gain_and_with_schmidts(rows, epsilon, tilt):
    m, p, h, r, nu, x = a_measurement(rows, tilt)
    hph = h @ p @ h.T
    gain = p @ h.T @ (np.eye(rows) + epsilon * np.linalg.inv(hph) @ r) @ np.linalg.inv(hph + r)
    if tilt > NOT_LEVEL:
        gain[ATTITUDE + 2] = 0.0
    left = np.eye(N) - gain @ h
    np.testing.assert_allclose(m.s[:rows, :rows], hph, rtol=1e-12)
    assert update.apply_measurement(m, rows, epsilon)
    np.testing.assert_allclose(m.x[:N], x + gain @ nu, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(m.dx[:N], gain @ nu, rtol=1e-9, atol=1e-12)
    covariance = left @ p @ left.T + gain @ r @ gain.T
    scale = np.abs(covariance).max()
    np.testing.assert_allclose(m.p[:N, :N], covariance, rtol=1e-9, atol=1e-12 * scale)
    np.testing.assert_array_equal(m.p[:N, :N], m.p[:N, :N].T)
    assert not m.p[N:].any() and not m.p[:, N:].any()
    if epsilon == 1.0:  # the newest measurement is believed altogether
        np.testing.assert_allclose(h @ (m.x[:N] - x), nu, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("rows", [1, 3, 6])
def test_the_normalised_square_of_an_innovation(rows):
    m, p, h, r, nu, _ = a_measurement(rows)
    assert update.factor(m.s, m.r, rows, m.root)
    expected = nu @ np.linalg.solve(h @ p @ h.T + r, nu)
    assert update.normalised_square(m.root, m.nu, rows, m.work) == pytest.approx(expected)


def test_what_has_no_covariance_changes_nothing():
    m, p, *_, x = a_measurement(3)
    m.r[1] = -1e6
    assert not update.apply_measurement(m, 3, 0.0)
    np.testing.assert_array_equal(m.p[:N, :N], p)
    np.testing.assert_array_equal(m.x[:N], x)
