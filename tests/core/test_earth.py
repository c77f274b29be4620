import mpmath
import numpy as np
import pytest
from scipy.integrate import quad

from sinstool.core import earth
from sinstool.core.earth import (
    dcm_ne,
    displaced,
    ecef,
    horizontal_metres,
    local_position_n,
    radii_of_curvature,
)

LATITUDES = np.deg2rad([-89.9, -67.3, -45.0, -12.1, 0.0, 3.4, 28.2, 51.5, 78.0, 90.0])


def meridian_point(latitude):
    """Distance from the axis and from the equator's plane, by the parametric latitude."""
    a, b = mpmath.mpf(earth.SEMI_MAJOR_AXIS), mpmath.mpf(earth.SEMI_MINOR_AXIS)
    # of the normal (cos lat, sin lat) to the ellipse: tan(beta) = b/a tan(lat)
    beta = mpmath.atan2(b * mpmath.sin(latitude), a * mpmath.cos(latitude))
    return a * mpmath.cos(beta), b * mpmath.sin(beta)


@pytest.mark.parametrize("latitude", LATITUDES)
def test_radii_from_the_ellipse_itself(latitude):
    meridian, transverse = earth.radii_of_curvature(latitude)
    with mpmath.workdps(40):
        at = mpmath.mpf(float(latitude))
        radius = mpmath.diff(lambda x: meridian_point(x)[0], at)
        up = mpmath.diff(lambda x: meridian_point(x)[1], at)
        assert abs(meridian / mpmath.sqrt(radius**2 + up**2) - 1) < 1e-14
        # the normal meets the axis at the distance of the transverse radius
        if abs(latitude) < np.pi / 2:
            assert abs(transverse * mpmath.cos(at) / meridian_point(at)[0] - 1) < 1e-14


def test_quarter_of_a_meridian_is_the_published_one():
    arc, _ = quad(lambda x: float(earth.radii_of_curvature(x)[0]), 0.0, np.pi / 2, epsabs=1e-6)
    assert arc == pytest.approx(10_001_965.729, abs=2e-3)  # EPSG:7030


def test_published_constants_follow_from_the_defining_ones():
    assert pytest.approx(6356752.3142, abs=5e-5) == earth.SEMI_MINOR_AXIS
    assert pytest.approx(6.69437999014e-3, rel=1e-12) == earth.ECCENTRICITY_SQUARED


def test_gravity_on_the_ellipsoid_is_the_published_one():
    assert earth.normal_gravity(0.0) == pytest.approx(9.7803253359, rel=1e-11)
    assert earth.normal_gravity(np.pi / 2) == pytest.approx(9.8321849378, rel=1e-10)
    assert earth.normal_gravity(-np.pi / 2) == pytest.approx(9.8321849378, rel=1e-10)
    # 45 degrees, as tabulated for WGS-84
    assert earth.normal_gravity(np.pi / 4) == pytest.approx(9.806197769, abs=5e-9)


def potential(latitude0, north, up, height):
    """Gravity potential with the zonal harmonics of the WGS-84 ellipsoid, near a point."""
    r_axis, z = meridian_point(latitude0)
    s, c = mpmath.sin(latitude0), mpmath.cos(latitude0)
    p = r_axis + (height + up) * c - north * s
    z = z + (height + up) * s + north * c
    e2 = mpmath.mpf(earth.ECCENTRICITY_SQUARED)
    j2 = mpmath.mpf("1.082629821313e-3")
    a, gm = mpmath.mpf(earth.SEMI_MAJOR_AXIS), mpmath.mpf(earth.GRAVITATIONAL_CONSTANT)
    r = mpmath.sqrt(p * p + z * z)
    value = mpmath.mpf(1)
    for n in range(1, 5):  # Heiskanen and Moritz, eq. 2-92: J_2n of a level ellipsoid
        j = (-1) ** (n + 1) * 3 * e2**n / ((2 * n + 1) * (2 * n + 3)) * (1 - n + 5 * n * j2 / e2)
        value -= j * (a / r) ** (2 * n) * mpmath.legendre(2 * n, z / r)
    return gm / r * value + mpmath.mpf(earth.EARTH_RATE) ** 2 * p * p / 2


@pytest.mark.parametrize("latitude", np.deg2rad([-71.0, -33.0, 0.5, 28.2, 45.0, 60.0]))
@pytest.mark.parametrize("height", [0.0, 1200.0, 9000.0, 20000.0])
def test_gravity_is_the_gradient_of_the_potential(latitude, height):
    g = earth.gravity_n(latitude, height)
    with mpmath.workdps(40):
        at, h = mpmath.mpf(float(latitude)), mpmath.mpf(height)
        down = -mpmath.diff(lambda u: potential(at, 0, u, h), 0)
        north = mpmath.diff(lambda n: potential(at, n, 0, h), 0)
    assert g[2] == pytest.approx(float(down), abs=1.5e-6)
    # the factor of the north component is the rounded one of the books
    assert g[0] == pytest.approx(float(north), abs=2e-7 + 0.012 * abs(float(north)))
    assert g[1] == 0.0


def test_earth_rate_points_along_the_axis():
    for latitude in LATITUDES:
        axis_n = np.array([np.cos(latitude), 0.0, -np.sin(latitude)])
        rate = earth.earth_rate_n(latitude)
        assert np.linalg.norm(rate) == pytest.approx(7.292115e-5, rel=1e-15)
        np.testing.assert_allclose(np.cross(rate, axis_n), 0.0, atol=1e-20)
        assert rate @ axis_n > 0
    assert earth.earth_rate_n(LATITUDES.reshape(2, 5)).shape == (2, 5, 3)
    assert earth.earth_rate_n(np.deg2rad(30.0))[2] < 0  # up in the north


def c_en(latitude, longitude):
    sl, cl = mpmath.sin(latitude), mpmath.cos(latitude)
    so, co = mpmath.sin(longitude), mpmath.cos(longitude)
    return mpmath.matrix([[-sl * co, -so, -cl * co], [-sl * so, co, -cl * so], [cl, 0, -sl]])


@pytest.mark.parametrize("latitude", np.deg2rad([-62.0, 28.2, 75.0]))
def test_transport_rate_is_how_the_axes_turn_along_a_path(latitude):
    height, velocity = 4000.0, np.array([120.0, -85.0, 7.0])
    meridian, transverse = (float(r) for r in earth.radii_of_curvature(latitude))
    latitude_rate = velocity[0] / (meridian + height)
    longitude_rate = velocity[1] / ((transverse + height) * np.cos(latitude))
    with mpmath.workdps(40):

        def axes(t, i, j):
            return c_en(latitude + latitude_rate * t, 0.4 + longitude_rate * t)[i, j]

        rate = mpmath.matrix(3, 3)
        for i in range(3):
            for j in range(3):
                rate[i, j] = mpmath.diff(lambda t, i=i, j=j: axes(t, i, j), 0)
        skew = c_en(mpmath.mpf(latitude), mpmath.mpf("0.4")).T * rate
    expected = [float(skew[2, 1]), float(skew[0, 2]), float(skew[1, 0])]
    ours = earth.transport_rate_n(latitude, height, velocity)
    np.testing.assert_allclose(ours, expected, rtol=1e-12)


def test_transport_rate_broadcasts_and_checks():
    rate = earth.transport_rate_n(LATITUDES[1:4], 10.0, np.ones((5, 3, 3)))
    assert rate.shape == (5, 3, 3)
    np.testing.assert_array_equal(
        rate[2, 1], earth.transport_rate_n(LATITUDES[2], 10.0, np.ones(3))
    )
    with pytest.raises(ValueError, match="velocity_n"):
        earth.transport_rate_n(0.1, 0.0, [1.0, 2.0])


def test_axes_of_ned_are_the_ways_that_latitude_longitude_and_height_go():
    lat, lon = np.array([0.7, -1.2, 1.5]), np.array([3.1, -2.0, 0.4])
    c = dcm_ne(lat, lon)
    np.testing.assert_allclose(c @ np.swapaxes(c, 1, 2) - np.eye(3), 0.0, atol=1e-15)
    # North and east are where latitude and longitude grow, down where height falls.
    e = 1e-3
    r = ecef(lat, lon, 100.0 + 0.0 * lat)
    m, t = radii_of_curvature(lat)
    north = (ecef(lat + e / m, lon, 100.0 + 0.0 * lat) - r) / e
    east = (ecef(lat, lon + e / (t * np.cos(lat)), 100.0 + 0.0 * lat) - r) / e
    np.testing.assert_allclose(c[:, 0], north, atol=2e-5)
    np.testing.assert_allclose(c[:, 1], east, atol=2e-5)
    np.testing.assert_allclose(c[:, 2], r - ecef(lat, lon, 101.0 + 0.0 * lat), atol=1e-8)


def test_displaced_goes_the_way_that_horizontal_metres_measures():
    lat, lon, height = np.array([0.7, -1.2]), np.array([3.1, -2.0]), np.array([100.0, 9000.0])
    there = displaced(lat, lon, height, 30.0, [-4.0, 5.0])
    north, east, _ = local_position_n((lat[0], lon[0], 100.0), (there[0][0], there[1][0], 100.0))
    assert (north, east) == pytest.approx((30.0, -4.0), abs=1e-3)
    north, east = horizontal_metres(there[0] - lat, there[1] - lon, lat, height)
    np.testing.assert_allclose(north, 30.0, atol=1e-6)
    np.testing.assert_allclose(east, [-4.0, 5.0], atol=1e-6)
