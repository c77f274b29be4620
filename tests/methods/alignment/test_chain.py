import numpy as np

from sinstool.methods.alignment.inflight_types import GnssFixes
from sinstool.methods.alignment.solution import position_between
from tests.methods.alignment.launches import exact, trajectory

SECOND = 1_000_000_000


def test_between_fixes_and_beyond_their_ends():
    # Over the date line at 78 degrees north; the truth is that of the flight.
    options = {
        "latitude": np.radians(78.0),
        "longitude": np.pi - 0.001,
        "azimuth": 1.2,
        "duration_s": 60.0,
    }
    flight = trajectory(**options)
    _, _, gnss = exact(**options)
    inner = gnss.rows((gnss.time_ns > 12.05 * SECOND) & (gnss.time_ns < 59.0 * SECOND))
    latitude, longitude = position_between(inner, flight.time_ns)
    t = flight.time_ns * 1e-9
    across = np.angle(np.exp(1j * (longitude - flight.longitude))) * np.cos(flight.latitude)
    off = np.hypot(latitude - flight.latitude, across)
    inside = (t > 12.1) & (t < 58.9)
    # Chords of 0.1 s at 20 g: 0.25 m; half a second of straight flight beyond the ends.
    assert off[inside].max() * 6.4e6 < 0.5
    near = (t > 11.6) & (t < 59.4)
    assert off[near].max() * 6.4e6 < 30.0
    assert np.abs(np.diff(np.sign(flight.longitude))).max() == 2.0


def test_it_goes_on_for_a_second_only():
    time = np.arange(30) * SECOND // 10
    east = 1e-4 * np.arange(30)
    gnss = GnssFixes(time, 0.0 * east, east, 0.0 * east, np.zeros((30, 3)))
    times = np.array([-5 * SECOND, -SECOND // 2, 29 * SECOND // 10 + SECOND // 2, 60 * SECOND])
    _, longitude = position_between(gnss, times)
    np.testing.assert_allclose(longitude, [-1e-3, -5e-4, 29e-4 + 5e-4, 29e-4 + 1e-3], atol=1e-7)


def test_one_fix():
    gnss = GnssFixes([7], [0.3], [-2.0], [10.0], np.zeros((1, 3)))
    latitude, longitude = position_between(gnss, np.array([0, 7, 10**10]))
    np.testing.assert_allclose(latitude, 0.3)
    np.testing.assert_allclose(longitude, -2.0)
