import numpy as np

from sinstool.core import earth
from sinstool.methods.alignment.reference import (
    acceleration_reference,
    dcm_ni,
    position_reference,
    to_inertial,
    velocity_reference,
)
from tests.methods.alignment.launches import exact, trajectory


def test_inertial_frame_stays_where_the_earth_was():
    time = np.array([0.0, 100.0, 21541.0])
    lat, lon = np.full(3, 0.8), np.full(3, -2.0)
    v = np.array([[1.0, 2.0, 3.0]] * 3)
    c_en = np.swapaxes(earth.dcm_ne(lat, lon), 1, 2)
    there = to_inertial(np.einsum("nij,nj->ni", c_en, v), time)
    back = np.einsum("nij,nj->ni", dcm_ni(lat, lon, time), there)
    np.testing.assert_allclose(back, v, atol=1e-14)
    np.testing.assert_allclose(there[0], c_en[0] @ v[0], atol=1e-15)
    # A quarter of a turn takes the x axis to the y axis.
    quarter = np.array([np.pi / 2 / earth.EARTH_RATE])
    np.testing.assert_allclose(
        to_inertial(np.array([[1.0, 0.0, 0.0]]), quarter), [[0, 1, 0]], atol=1e-15
    )


def test_at_rest_the_integral_is_that_of_gravity():
    # A constant vector of the Earth turned at the Earth's rate: closed form.
    time = np.linspace(0.0, 3600.0, 36001)
    lat, lon, h = (np.full_like(time, x) for x in (-0.9, 2.9, 4000.0))
    beta = velocity_reference(time, lat, lon, h, np.zeros((len(time), 3)))
    f = -(earth.dcm_ne(lat[0], lon[0]).T @ earth.gravity_n(lat[0], h[0]))
    a = earth.EARTH_RATE * time
    s, c = np.sin(a) / earth.EARTH_RATE, (1.0 - np.cos(a)) / earth.EARTH_RATE
    expected = np.stack([f[0] * s - f[1] * c, f[1] * s + f[0] * c, f[2] * time], axis=1)
    assert np.abs(beta - expected).max() < 1e-6
    assert np.abs(beta).max() > 2e4


def test_flight_three_ways():
    # Velocities, their derivative, and positions alone say the same of the same force.
    _, _, gnss = exact(duration_s=110.0)
    late = gnss.rows(gnss.time_ns > int(37e9))
    time = late.time_ns * 1e-9
    where = (late.latitude, late.longitude, late.height)
    beta = velocity_reference(time, *where, late.velocity_n)
    force, at, newer, older = acceleration_reference(time, *where, late.velocity_n, central=True)
    np.testing.assert_array_equal(newer - older, 2)
    np.testing.assert_array_equal(at, newer - 1)
    slope = (beta[newer] - beta[older]) / 0.2
    assert np.abs(slope - force).max() < 0.02  # m/s^2 of 10, where the rolls are weaved
    twice = position_reference(time, *where)
    # Less its start velocity, position's integral is the integral of beta.
    step = np.diff(time)[:, None]
    integral = np.zeros_like(beta)
    integral[1:] = np.cumsum(0.5 * step * (beta[1:] + beta[:-1]), axis=0)
    left = twice - integral
    line = np.polynomial.polynomial.polyfit(time - time[0], left, 1)
    fitted = np.polynomial.polynomial.polyval(time - time[0], line).T
    assert np.abs(left - fitted).max() < 2e-2
    assert np.abs(twice).max() > 1e4


def test_backward_difference_and_gaps():
    _, _, gnss = exact(duration_s=110.0)
    late = gnss.rows(gnss.time_ns > int(40e9))
    mask = np.ones(len(late), dtype=bool)
    mask[100:140] = False
    late = late.rows(mask)
    time = late.time_ns * 1e-9
    where = (late.latitude, late.longitude, late.height)
    _, at, newer, older = acceleration_reference(time, *where, late.velocity_n, central=False)
    np.testing.assert_array_equal(at, newer)
    assert len(newer) == len(late) - 2  # no derivative over the gap
    assert (time[newer] - time[older]).max() < 0.11


def test_date_line_does_not_show():
    options = {
        "latitude": np.radians(78.0),
        "longitude": np.pi - 0.001,
        "azimuth": 1.2,
        "duration_s": 60.0,
    }
    flight = trajectory(**options)
    assert flight.longitude.min() < -3.0 and flight.longitude.max() > 3.0
    _, _, gnss = exact(**options)
    beta = velocity_reference(
        gnss.time_ns * 1e-9, gnss.latitude, gnss.longitude, gnss.height, gnss.velocity_n
    )
    assert np.linalg.norm(np.diff(beta, axis=0), axis=1).max() < 25.0
