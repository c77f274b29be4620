"""The same increments through a published package: the difference is that package's gravity."""

import numpy as np
import pandas as pd
import pytest
from pyins import strapdown

from sinstool.core import earth, rotation
from sinstool.core.earth import ecef
from sinstool.simulation.flight import spiral_climb
from tests.methods.strapdown import flying
from tests.methods.strapdown.navigator import Navigator

DV = ["dv_x", "dv_y", "dv_z"]


@pytest.fixture(scope="module")
def flight():
    return spiral_climb(900.0, 128.0, latitude=-0.7, longitude=-2.0, heading=2.0)


def their_increments(flight):
    imu = flight.imu
    names = [f"{s}_{a}" for s in ("gyro", "accel") for a in "xyz"]
    data = pd.DataFrame(
        np.hstack(flying.samples(imu, "increment")), flight.time_ns * 1e-9, columns=names
    )
    return strapdown.compute_increments_from_imu(data, "increment")


def their_run(flight, updates):
    """Places in Earth axes."""
    first = [
        *np.rad2deg([flight.latitude[0], flight.longitude[0]]),
        flight.height[0],
        *flight.velocity_n[0],
        *np.rad2deg(rotation.to_euler(flight.imu.q_nb[0])),
    ]
    names = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
    result = strapdown.Integrator(pd.Series(first, index=names)).integrate(updates)[1:]
    return ecef(
        np.deg2rad(result.lat.to_numpy()), np.deg2rad(result.lon.to_numpy()), result.alt.to_numpy()
    )


def lacking_gravity(latitude, height):
    """What theirs, linear in height, leaves out of the ellipsoid's."""
    on_ellipsoid = earth.normal_gravity(latitude)
    lack = earth.gravity_n(latitude, height)
    lack[:, 2] -= on_ellipsoid * (1.0 - 2.0 * height / earth.SEMI_MAJOR_AXIS)
    return lack


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:The copy keyword")
def test_difference_is_their_gravity(flight):
    truth = ecef(flight.latitude, flight.longitude, flight.height)[1:]
    updates = flying.increments(flight.imu)
    result = Navigator(flying.start(flight)).push(
        updates.rotation_vector, updates.velocity_increment, updates.interval
    )
    ours = ecef(result.latitude, result.longitude, result.height)
    theirs = their_increments(flight)
    np.testing.assert_allclose(
        theirs[["theta_x", "theta_y", "theta_z"]], updates.rotation_vector[:], atol=1e-12
    )
    np.testing.assert_allclose(theirs[DV], updates.velocity_increment, atol=1e-9)
    there = their_run(flight, theirs)

    def largest(difference):
        return np.linalg.norm(difference, axis=-1).max()

    assert largest(ours - truth) < 1e-3
    error = largest(there - truth)
    assert error > 1.0
    assert largest(ours - there) < error * 1.001

    middle = [0.5 * (c[1:] + c[:-1]) for c in (flight.latitude, flight.height)]
    made_up = rotation.rotate(rotation.conjugate(flight.imu.q_nb[:-1]), lacking_gravity(*middle))
    corrected = theirs.copy()
    corrected[DV] += made_up * theirs[["dt"]].to_numpy()
    again = their_run(flight, corrected)
    assert largest(again - truth) < error / 50.0
    assert largest(ours - again) < error / 50.0
