"""Noise of an IMU that is shaken at rest, by the fixes alone."""

import numpy as np
import pytest

from sinstool.core.streams import GnssEpochs
from sinstool.methods.land_vehicle.shaking import find_shaking
from sinstool.methods.land_vehicle.track import within
from sinstool.methods.sensor_errors import SensorGrade
from tests.methods.land_vehicle.test_rest import STEP, a_drive

LATE_NS = 200_000_000
IDLE = 3e-3  # of a mean over a step, rad/s; force ten times as much


def epochs(track, hidden=None):
    """Fixes of a track, stamped late."""
    n = len(track.time_ns)
    sigma, place = np.full((n, 3), 0.05), np.zeros(n)
    time_ns = track.time_ns + LATE_NS
    gnss = GnssEpochs(time_ns, time_ns, place, place, place, track.velocity_n, sigma, sigma)
    return gnss if hidden is None else gnss.rows(~hidden)


def test_shaking_is_found_and_holds_for_all_of_each_stop():
    means, track, speed = a_drive(idle=IDLE, minutes=12.0)
    shaking = find_shaking(means, epochs(track), LATE_NS)
    density = np.array([(10.0 * IDLE) ** 2, IDLE**2]) * STEP
    assert np.sqrt(shaking.noise) == pytest.approx(np.sqrt(density), rel=0.15)
    still = ~within(speed > 0.0, 1, 1)
    assert shaking.stands[still].all()
    assert not shaking.stands[~within(still, 20, 20)].any()


def test_a_stop_without_fixes_is_one_of_them():
    means, track, speed = a_drive(idle=IDLE, minutes=12.0)
    seconds = (track.time_ns - means.start_ns) * 1e-9
    shaking = find_shaking(means, epochs(track, (seconds > 270.0) & (seconds < 310.0)), LATE_NS)
    stop = (STEP * np.arange(len(speed)) > 282.0) & (STEP * np.arange(len(speed)) < 298.0)
    assert (speed[stop] == 0.0).all() and shaking.stands[stop].all()


def test_vibration_beyond_the_noise_of_the_imu_reaches_the_filter():
    means, track, _ = a_drive(idle=IDLE, minutes=12.0)
    shaking = find_shaking(means, epochs(track), LATE_NS)
    walks = {"velocity_random_walk": 1e-3, "angle_random_walk": 1e-4}
    known = shaking.constraints(SensorGrade(**walks))
    own = np.square([1e-3, 1e-4])
    assert np.array(known.shaken) == pytest.approx(np.array(shaking.noise) - own)
    assert known.vehicle is None and not known.rests.any() and not known.rolls.any()
    noisy = SensorGrade(velocity_random_walk=0.1, angle_random_walk=0.01)
    assert shaking.constraints(noisy) is None


def test_fixes_without_velocity_show_nothing():
    means, track, _ = a_drive(idle=IDLE)
    gnss = epochs(track)
    gnss.velocity_n[:] = np.nan
    assert find_shaking(means, gnss, LATE_NS).constraints(SensorGrade()) is None
