"""The standard atmosphere as printed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sinstool.methods.height.standard_atmosphere import (
    geometric,
    geopotential,
    height_per_pascal,
    pressure_altitude,
    pressure_at,
)

# Geopotential m and Pa, as printed in the standard.
ATMOSPHERE = [
    (-1000, 113929.0),
    (0, 101325.0),
    (1000, 89874.6),
    (5000, 54019.9),
    (10000, 26436.3),
    (11000, 22632.06),
    (15000, 12044.6),
    (20000, 5474.89),
]
# Of the layers above, as the U.S. Standard Atmosphere of 1976 prints them, to five digits.
HIGH = [(25000, 2511.0), (30000, 1171.9), (32000, 868.02), (40000, 277.52), (47000, 110.91)]


@pytest.mark.parametrize(("height", "pressure"), ATMOSPHERE)
def test_standard_atmosphere(height, pressure):
    assert pressure_altitude(pressure) == pytest.approx(height, abs=0.1)
    assert pressure_at(height) == pytest.approx(pressure, rel=4e-6)


@pytest.mark.parametrize(("height", "pressure"), HIGH)
def test_layers_above_20_km(height, pressure):
    assert pressure_at(height) == pytest.approx(pressure, rel=5e-5)
    assert pressure_altitude(pressure) == pytest.approx(height, abs=0.4)


@pytest.mark.parametrize("base", [11000.0, 20000.0, 32000.0])
def test_layers_join(base):
    below, above = pressure_at([base - 1e-6, base + 1e-6])
    assert below == pytest.approx(above, rel=1e-9)
    assert height_per_pascal(below) == pytest.approx(height_per_pascal(above), rel=1e-9)


@given(st.floats(-2000.0, 47000.0))
def test_inverse(height):
    assert pressure_altitude(pressure_at(height)) == pytest.approx(height, abs=1e-7)


@given(st.floats(120.0, 115000.0))
def test_slope(pressure):
    step = 1e-5 * pressure
    ends = pressure_altitude(np.array([pressure - step, pressure + step]))
    assert height_per_pascal(pressure) == pytest.approx((ends[1] - ends[0]) / (2 * step), rel=1e-5)


def test_slope_in_metres_per_hectopascal():
    slope = 100 * height_per_pascal([101325.0, float(pressure_at(5000.0))])
    assert slope == pytest.approx([-8.32, -13.8], abs=0.06)


def test_geometric_height():
    # gravity falls off as 1/r^2: the potential of a height is g0 R h / (R + h)
    assert geometric(11000.0) == pytest.approx(11019.07, abs=0.01)
    assert geopotential(geometric(7321.0)) == pytest.approx(7321.0, abs=1e-9)


def test_impossible_pressures_give_nan():
    assert np.isnan(pressure_altitude([np.nan, 0.0, -5.0, np.inf])).all()
