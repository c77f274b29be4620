"""Receivers that smooth their velocities: whole runs, beside what is true."""

import numpy as np
import pytest

import sinstool
from benchmarks.trusted_navigation import process
from tests.helpers.unseen_drives import (
    GRADES,
    LEVER,
    boat,
    drive,
    multicopter,
    record,
    walk,
    write,
)
from tests.helpers.unseen_errors import lowpassed_velocities


def made(motion, seed, rate, time_s):
    truth = motion(seed, 300.0)
    data = record(truth, GRADES["industrial"], seed, gnss_rate=rate, sigma=0.5, sigma_v=0.05)
    return truth, lowpassed_velocities(data, seed, time_s) if time_s else data


@pytest.mark.slow
@pytest.mark.parametrize(
    ("motion", "seed", "rate", "time_s"),
    [(multicopter, 1, 5.0, 0.6), (walk, 1, 10.0, 0.5), (boat, 1, 5.0, 1.0), (boat, 6, 5.0, 1.0)],
)
def test_it_is_undone_or_the_velocities_are_not_used(tmp_path, motion, seed, rate, time_s):
    """Left as they are, the walk's tilt was 19 sigmas off, and the second boat's height 15 m."""
    truth, data = made(motion, seed, rate, time_s)
    log = write(tmp_path / "log.mcap", data)
    answer, status, _ = process(log, truth, ["--smooth"])
    # The first boat's velocities are too noisy for an attitude in its first minute
    assert status == (3 if (motion, seed) == (boat, 1) else 0)
    late = answer.seconds > 60.0
    ratio = np.sqrt(np.mean(np.square(answer.error / answer.sigma)[late], axis=0))
    assert ratio.max() < 1.6
    error = np.sqrt(np.mean(np.square(answer.error)[late], axis=0))
    assert error[:3].max() < 0.25
    assert np.rad2deg(error[6:8]).max() < 0.2
    assert np.rad2deg(error[8]) < 0.6


@pytest.mark.slow
@pytest.mark.parametrize("motion", [multicopter, walk, boat, drive])
def test_velocities_that_nobody_smoothed_stay(tmp_path, motion):
    _, data = made(motion, 2, 5.0, 0.0)
    write(tmp_path / "log.mcap", data)
    lever = tuple(LEVER.tolist())
    made_of = sinstool.process(
        tmp_path / "log.mcap", mode="ins-gnss", gyro_kind="mean-rate", lever_arm=lever
    )
    assert not [f for f in made_of.findings if f.kind == "smoothed-velocity"]
