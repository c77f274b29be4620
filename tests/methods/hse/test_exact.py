import numpy as np
import pytest
from scipy.integrate import quad_vec

from sinstool.core import rotation
from sinstool.core.earth import EARTH_RATE, earth_rate_n
from sinstool.methods.hse.rig import axis_to_matrix
from tests.helpers import hse_exact as exact

ARCSEC = np.pi / 648000.0
LATITUDE = 0.49
E = -np.ones(3) / np.sqrt(3.0)


def skew(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def rz(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def lam(epsilon, kappa=(0, 0, 0)):
    return np.array(
        [[kappa[0], 0, 0], [epsilon[0], kappa[1], 0], [epsilon[1], epsilon[2], kappa[2]]]
    )


def base(heading, theta, gamma):
    return rotation.to_dcm(rotation.from_euler([gamma, theta, heading]))


def error(epsilon=(0, 0, 0), kappa=(0, 0, 0), xi=(0, 0, 0), axis=E):
    C = axis_to_matrix(axis)
    return exact.error_matrix(
        (np.eye(3) - skew(xi)) @ C, np.eye(3) + lam(epsilon, kappa), np.eye(3), C
    )


@pytest.mark.parametrize("rate", np.radians([20.0, -40.0, 60.0]))
@pytest.mark.parametrize("latitude", [0.49, -0.9])
def test_mean_over_a_turn_of_eqs_5_and_6(rate, latitude):
    # large errors, so that nothing of second order hides
    random = np.random.default_rng(5)
    K_g = np.eye(3) + np.tril(0.05 * random.standard_normal((3, 3)))
    axis = E + 0.01 * random.standard_normal(3)
    axis /= np.linalg.norm(axis)
    C = axis_to_matrix(axis)
    believed_K = (np.eye(3) + lam(*(1e-2 * random.standard_normal((2, 3))))) @ K_g
    believed_C = (np.eye(3) - skew(1e-3 * random.standard_normal(3))) @ C
    C_nb0 = base(2.3, 0.04, -0.06)
    earth, z = earth_rate_n(latitude), np.array([0.0, 0.0, rate])

    def estimated(angle):
        C_nb = C_nb0 @ rz(angle)
        omega_g = np.linalg.solve(K_g, C.T @ (C_nb.T @ earth + z))
        return C_nb @ (believed_C @ believed_K @ omega_g - z)

    turn = 2.0 * np.pi
    mean = quad_vec(estimated, 0.0, turn, epsabs=1e-18, epsrel=1e-15)[0] / turn
    X = exact.error_matrix(believed_C, believed_K, K_g, C)
    got = exact.rotation_mean(X)
    assert exact.east_rate_error(got, rate, C_nb0, latitude) == pytest.approx(mean[1], abs=2e-17)
    in_n = C_nb0 @ got.rate_error(rate, C_nb0.T @ earth)
    np.testing.assert_allclose(in_n, mean - earth, atol=5e-17)
    # north is where the horizontal rate points
    assert exact.heading_error(got, rate, C_nb0, latitude) == pytest.approx(
        -np.arctan2(mean[1], mean[0]), abs=1e-12
    )


def test_what_each_calibration_error_leaves():
    e1, e2, e3, k1, k2, k3 = 1.1e-5, -2.3e-5, 0.7e-5, 3e-6, -5e-6, 4e-6
    mean = exact.rotation_mean(error((e1, e2, e3), (k1, k2, k3)))
    eps, kappa = e1 + e2 + e3, k1 + k2 + k3
    assert mean.c == pytest.approx((eps + kappa) / 3, rel=1e-9)
    assert mean.a == pytest.approx(-eps / 6 + kappa / 3, rel=1e-9)
    assert mean.d == pytest.approx(-(e1 - e2 + e3) / (2 * np.sqrt(3.0)), rel=1e-9)
    assert mean.lambda2 == pytest.approx(-(eps + kappa), rel=1e-9)


def test_misalignment_of_the_axis_is_an_offset_without_slope():
    mean = exact.rotation_mean(error(xi=(1e-4, -1e-4, 1e-4)))
    C_nb0 = base(0.9, 5e-4, -6e-4)
    errors = [
        exact.heading_error(mean, rate, C_nb0, LATITUDE) / ARCSEC for rate in np.radians([20, 60])
    ]
    offset = 1e-4 * (1.0 + C_nb0[0, 2] * np.tan(LATITUDE)) / ARCSEC
    np.testing.assert_allclose(errors, offset, atol=1e-3)
    assert offset == pytest.approx(20.63, abs=0.02)


def test_published_magnitudes():
    rate = np.radians(40.0)
    assert exact.lambda1(rate, LATITUDE) == pytest.approx(0.698097, abs=5e-7)
    for lambda2, C23, arcsec in (
        (1e-5, 1e-3, 7.46),
        (3e-5, 1e-3, 22.38),
        (3e-5, np.sqrt(2) * 1e-3, 31.65),
        (4.2 * ARCSEC, 8e-4, 12.152),
    ):
        got = exact.linear_heading_error(lambda2, rate, C23, LATITUDE) / ARCSEC
        assert got == pytest.approx(arcsec, abs=0.006)
    K = exact.slope(4.2 * ARCSEC, 8e-4, LATITUDE)
    assert pytest.approx(17.4073, abs=5e-5) == K / ARCSEC
    assert exact.lambda2_from_slope(K, 8e-4, LATITUDE) == pytest.approx(4.2 * ARCSEC, rel=1e-14)
    c23 = 3 * EARTH_RATE * np.cos(LATITUDE) * 17.4 / 4.2
    assert c23 == pytest.approx(8.00e-4, abs=5e-7)


@pytest.mark.parametrize(
    ("rate_deg_s", "lambda2", "tilt", "published"),
    [
        (60.0, 1e-5, 1e-2, 3e-4),
        (60.0, 1e-4, 1e-2, 2.7e-3),
        (60.0, 1e-3, 1e-2, 2.8e-2),
        (60.0, 1e-4, 5e-2, 1.4e-2),
        (200.0, 1e-4, 5e-2, 4.7e-2),
    ],
)
def test_linear_form_is_as_good_as_is_said(rate_deg_s, lambda2, tilt, published):
    rate = np.radians(rate_deg_s)
    mean = exact.rotation_mean(error(epsilon=(-lambda2 / 3,) * 3))
    worst, largest = 0.0, 0.0
    for heading in np.linspace(0.0, 2 * np.pi, 73):
        C_nb0 = base(heading, tilt, 0.0)
        linear = exact.linear_heading_error(mean.lambda2, rate, C_nb0[1, 2], LATITUDE) - mean.d
        true = exact.heading_error(mean, rate, C_nb0, LATITUDE)
        worst, largest = max(worst, abs(true - linear)), max(largest, abs(linear))
    assert worst / largest == pytest.approx(published, rel=0.2)
    stated = exact.nonlinearity(lambda2, rate, tilt, LATITUDE)
    assert stated == pytest.approx(worst / largest, rel=0.2)
