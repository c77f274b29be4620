"""What clipped samples do to increments, and how well that is known."""

import numpy as np
import pytest

from sinstool.methods.sensor_errors import MISSED
from sinstool.methods.strapdown.clipped_samples import ClippedSamples
from sinstool.methods.strapdown.velocity import Increments

STEP = 0.01
LIMITS = np.array([np.inf, np.inf, 4.0, 40.0, np.inf, np.inf])


def updates(sample):
    """Updates that end at these samples, and do not move."""
    n = len(sample)
    time_ns = np.round(1e9 * STEP * sample).astype(np.int64)
    still = np.zeros((n, 3))
    return Increments(sample, time_ns, np.full(n, STEP), still, still, lost=np.zeros((n, 6)))


def variances(gyro, accel, parts, every=1):
    """Of updates over so many samples each, with the samples pushed in parts."""
    stage, out, done = ClippedSamples(LIMITS, STEP), [], 0
    for part in np.array_split(np.arange(len(gyro)), parts):
        stage.push(gyro[part], accel[part])
        ends = np.arange(done + every, part[-1] + 1, every)
        if len(ends):
            done = ends[-1]
            out.append(stage.marked(updates(ends)).lost)
    return np.concatenate(out)


@pytest.mark.parametrize("every", [1, 3])
@pytest.mark.parametrize("parts", [1, 7, 40])
def test_a_turn_beyond_the_range_is_as_uncertain_as_what_it_may_have_missed(parts, every):
    """What is missed has one sign: angles of a run add up, those of two runs do not."""
    gyro, accel = np.zeros((121, 3)), np.zeros((121, 3))
    gyro[10:40, 2], gyro[70:80, 2] = 4.0, -4.0
    gyro[50:60, 0] = 9.0  # its range is larger
    accel[20:25, 0] = 40.0
    found = variances(gyro, accel, parts, every)
    off = np.mean(np.square(MISSED)) * STEP**2
    expected = off * np.array([0.0, 0.0, 4.0**2 * (30**2 + 10**2), 40.0**2 * 5**2, 0.0, 0.0])
    assert found.sum(axis=0) == pytest.approx(expected, rel=1e-9)
    assert not found[60 // every + 1 : 69 // every].any()


def test_without_a_range_increments_stay_as_they_are():
    stage = ClippedSamples(np.full(6, np.inf), STEP)
    stage.push(np.full((9, 3), 50.0), np.full((9, 3), 500.0))
    made = updates(np.arange(1, 9))
    assert stage.marked(made) is made
