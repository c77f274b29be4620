"""The track of a vehicle on a plane, and the unit of lengths."""

import numpy as np
import pytest

from sinstool.report.figures.parts import length, track

# WGS-84, by its definition
EQUATOR_M = 6_378_137.0
FLATTENING = 1.0 / 298.257223563
SQUARED = FLATTENING * (2.0 - FLATTENING)


def curve(figure, name):
    return next(one for one in figure.series if one.name == name)


@pytest.mark.parametrize(
    "values, unit",
    [
        ([4999.0, np.nan], (1.0, "m")),
        ([-5001.0, 0.0, np.nan], (1000.0, "km")),
        ([4000.0, -4000.0], (1.0, "m")),
        ([np.nan], (1.0, "m")),
        ([], (1.0, "m")),
    ],
)
def test_lengths_are_in_km_by_the_largest(values, unit):
    assert length(np.array(values)) == unit


def test_track_goes_on_over_180_degrees():
    """Along the equator, where the plane's east is the radius times the sine."""
    along = np.linspace(0.0, 0.2, 21)
    longitude = np.radians((179.9 + along + 180.0) % 360.0 - 180.0)
    assert longitude.min() < -3.1 and longitude.max() > 3.1
    back = np.radians(np.array([[0.0, 179.8], [0.0, -179.7]]))
    figure = track("true", np.zeros(21), longitude, back)
    assert (figure.xlabel, figure.ylabel, figure.equal) == ("east, km", "north, km", True)
    expected = EQUATOR_M / 1000.0 * np.sin(np.radians(along))
    np.testing.assert_allclose(figure.x, expected, atol=1e-9)
    np.testing.assert_allclose(curve(figure, "true").y, 0.0, atol=1e-9)
    fixes = curve(figure, "GNSS fixes")
    expected = EQUATOR_M / 1000.0 * np.sin(np.radians([-0.1, 0.4]))
    np.testing.assert_allclose(fixes.x, expected, atol=1e-9)
    np.testing.assert_allclose(fixes.y, 0.0, atol=1e-9)
    assert "0.000000 deg north, 179.900000 deg east" in figure.notes[0]


def test_track_northward_in_metres_ends_before_a_hole():
    """From the equator along a meridian, by the ellipsoid's own equation."""
    latitude = np.radians([0.0, 0.01, np.nan, 0.02, 0.03, np.nan])
    longitude = np.where(np.isnan(latitude), np.nan, np.radians(15.0))
    figure = track("computed", latitude, longitude)
    sine = np.sin(latitude)
    expected = EQUATOR_M * (1.0 - SQUARED) * sine / np.sqrt(1.0 - SQUARED * sine**2)
    assert (figure.xlabel, figure.ylabel) == ("east, m", "north, m")
    np.testing.assert_allclose(curve(figure, "computed").y, expected, atol=1e-6)
    np.testing.assert_allclose(figure.x, np.where(np.isnan(expected), np.nan, 0.0), atol=1e-6)
    assert [one.name for one in figure.series] == ["computed", "start", "end"]
    assert (curve(figure, "start").x[0], curve(figure, "start").y[0]) == (0.0, 0.0)
    np.testing.assert_allclose(curve(figure, "end").y, expected[4])


@pytest.mark.parametrize("latitude", [-43.5, 60.0, 80.0])
def test_steps_on_the_track_are_those_on_the_ground(latitude):
    """A small square, by lengths of a degree from the radii of curvature."""
    latitude = np.radians(latitude)
    square = 1.0 - SQUARED * np.sin(latitude) ** 2
    transverse = EQUATOR_M / np.sqrt(square)
    meridian = transverse * (1.0 - SQUARED) / square
    north, east = np.array([0.0, 30.0, 30.0, 0.0]), np.array([0.0, 0.0, 40.0, 40.0])
    figure = track(
        "true", latitude + north / meridian, east / (transverse * np.cos(latitude)) - np.pi
    )
    np.testing.assert_allclose(figure.x, east, atol=2e-3)
    np.testing.assert_allclose(curve(figure, "true").y, north, atol=2e-3)
