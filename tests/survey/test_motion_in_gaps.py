"""Motion to expect in gaps, from that of a log's windows."""

from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.core.rotation import from_euler, rotate
from sinstool.survey.motion_in_gaps import motion_in_gaps

COUNT = 20_000
RATE, FORCE = 0.3, 0.7  # of each axis, independent from window to window
# Root of the mean of the larger half, over the root of the mean: of a normal distribution, and of
# the sum of two squares
ONE, TWO = 1.3620, 1.3012


class Columns(SimpleNamespace):
    def __len__(self):
        return len(self.start_ns)


def surveyed(gaps=((0, 0.4),), count=COUNT, turning=RATE):
    random = np.random.default_rng(8)
    gyro = random.normal(0.0, [RATE, RATE, turning], (count, 3))
    accel = np.array([0.0, 0.0, -9.8]) + random.normal(0.0, FORCE, (count, 3))
    axes = from_euler([0.4, 1.0, 0.3])  # of the sensor in the vehicle
    windows = Columns(
        start_ns=np.arange(count) * 500_000_000,
        count=np.full(count, 100),
        gyro=rotate(axes, gyro),
        accel=rotate(axes, accel),
    )
    return SimpleNamespace(gaps=gaps, windows=windows)


@pytest.mark.parametrize("length, count", [(0.4, 1), (1.7, 4)])
def test_of_motion_that_is_independent_from_window_to_window(length, count):
    motion = motion_in_gaps(surveyed(((0, 0.1), (5, length), (9, 60.0))), 5.0)
    # Windows inside, less so many times the mean of the two beside
    root = 0.5 * np.sqrt(count + 0.5 * count**2) / np.sqrt(0.5 * count)
    assert motion.force == pytest.approx(ONE * FORCE * root, rel=0.04)
    assert motion.heading == pytest.approx(ONE * RATE * root, rel=0.04)
    assert motion.tilt == pytest.approx(TWO * RATE * root, rel=0.04)


def test_turning_about_the_vertical_is_no_tilting():
    motion = motion_in_gaps(surveyed(turning=3.0), 5.0)
    # The specific force is a few degrees off the vertical
    assert motion.heading > 6.0 * motion.tilt


def test_half_full_windows_and_missing_ones_are_left_out():
    survey = surveyed()
    plain = motion_in_gaps(survey, 5.0)
    windows = survey.windows
    windows.gyro[::50], windows.count[::50] = 40.0, 60
    windows.start_ns[1000:] += 3_000_000_000
    windows.gyro[1000:] = windows.gyro[1000:] + 7.0
    assert motion_in_gaps(survey, 5.0).tilt == pytest.approx(plain.tilt, rel=0.05)


@pytest.mark.parametrize("gaps, count", [((), COUNT), (((0, 8.0),), COUNT), (((0, 0.4),), 41)])
def test_nothing_to_say(gaps, count):
    assert motion_in_gaps(surveyed(gaps, count), 5.0) is None
