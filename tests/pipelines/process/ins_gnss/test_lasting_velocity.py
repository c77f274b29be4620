"""Velocities of a receiver that smooths them: their errors last, and tell less."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.trusted_navigation import process
from sinstool.pipelines.process.ins_gnss.lasting_velocity import noise_factor
from tests.helpers.unseen_drives import (
    DEG,
    GRADES,
    RATE,
    band_noise,
    motion_of,
    random_levels,
    record,
    running_integral,
    smoothed,
    write,
)


def hovering(seed, duration=240.0):
    """A multicopter that hardly moves, and leans to where it goes."""
    random = np.random.default_rng([seed, 21])
    t = np.arange(0.0, duration, 1.0 / RATE)
    velocity = np.stack(
        [smoothed(random_levels(random, t, (2.0, 8.0), most), 1.5) for most in (0.4, 0.4, 0.1)],
        axis=1,
    )
    turning = smoothed(random_levels(random, t, (5.0, 20.0), 0.15), 3.0)
    heading = running_integral(turning, 6.3 * random.random())
    force = np.gradient(velocity, t, axis=0) / 9.81
    c, s = np.cos(heading), np.sin(heading)
    ahead, right = force[:, 0] * c + force[:, 1] * s, force[:, 1] * c - force[:, 0] * s
    angles = np.stack([np.arctan(right), -np.arctan(ahead), heading], axis=1)
    angles += DEG * 0.3 * band_noise(random, t, 0.5, 8.0)
    return motion_of(t, velocity, angles)


def lasting(count, share, seed, width=3):
    """Errors of size 1, of which such a share is that of the epoch before."""
    white = np.random.default_rng([seed, 9]).standard_normal((count, width))
    errors = np.zeros((count, width))
    for row in range(1, count):
        errors[row] = share * errors[row - 1] + np.sqrt(1.0 - share**2) * white[row]
    return errors


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("share", "least", "most"), [(0.0, 0.5, 1.2), (0.7, 2.5, 5.7)])
def test_sums_of_innovations_show_how_long_errors_last(seed, share, least, most):
    """Those of a lasting share s are (1 + s) / (1 - s) times as large in the square."""
    count = 2000
    innovation = lasting(count, share, seed, 6)
    time_ns = 10**18 + np.arange(count) * 200_000_000
    epochs = SimpleNamespace(
        time_ns=time_ns, innovation=innovation, innovation_sigma=np.ones((count, 6))
    )
    assert least < noise_factor(epochs, slice(3, 5)) < most
    few = SimpleNamespace(
        time_ns=time_ns[:90], innovation=innovation[:90], innovation_sigma=np.ones((90, 6))
    )
    assert noise_factor(few, slice(3, 5)) == 1.0
    innovation[:, 3] = np.nan  # positions only
    assert noise_factor(epochs, slice(3, 5)) == 1.0


@pytest.mark.slow
def test_heading_by_velocities_whose_errors_last_is_in_its_sigma(tmp_path):
    """It was wrong by 2.6 of its sigmas in the root mean square before, and fixes were rejected."""
    truth = hovering(1)
    data = record(truth, GRADES["industrial"], 1, gnss_rate=5.0, sigma=1.0, sigma_v=0.03)
    errors = 0.25 * lasting(len(data.fixes.seconds), np.exp(-0.2), 1)
    data = replace(data, fixes=replace(data.fixes, velocity_n=data.fixes.velocity_n + errors))
    answer, status, note = process(write(tmp_path / "log.mcap", data), truth, ["--smooth"])
    assert status == 0 and "rejected" not in note
    ratio = answer.error[:, 8] / answer.sigma[:, 8]
    assert np.sqrt(np.mean(np.square(ratio))) < 1.5
