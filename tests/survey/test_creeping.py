"""Velocities below a walking pace that fixes follow: what creeps, not noise of a receiver."""

import numpy as np
import pytest

from sinstool.core.streams import GnssEpochs
from sinstool.survey.rest import crept, moving_at

T0 = 1_700_000_000_000_000_000
EARTH = 6.37e6


def wander(random, count, seconds, columns=2):
    """Noise of one sigma 1 with a correlation time, at 5 Hz."""
    keep = np.exp(-0.2 / seconds)
    out = random.standard_normal((count, columns))
    for k in range(1, count):
        out[k] = keep * out[k - 1] + np.sqrt(1.0 - keep**2) * out[k]
    return out


def receiver(random, velocity, fixes, sigma_v=0.05, sigma_p=1.0):
    """Epochs of a receiver whose position wanders, by true velocity and what its fixes do."""
    count = len(velocity)
    position = fixes + sigma_p * (0.7 * wander(random, count, 60.0))
    position += 0.3 * sigma_p * random.standard_normal((count, 2))
    shown = velocity + sigma_v * random.standard_normal((count, 2))
    time = T0 + 200_000_000 * np.arange(count)
    return GnssEpochs(
        time,
        time,
        0.8 + position[:, 0] / EARTH,
        0.2 + position[:, 1] / EARTH / np.cos(0.8),
        np.full(count, 400.0),
        np.column_stack([shown, np.zeros(count)]),
        np.full((count, 3), sigma_p),
        np.full((count, 3), sigma_v),
    )


def speed(gnss):
    return moving_at(gnss, T0, int(gnss.time_ns[-1]))


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("turn", [0.0, 0.3, 2.0])
@pytest.mark.parametrize("size", [0.25, 0.4, 0.7])
def test_what_creeps_moves(seed, turn, size):
    """Its fixes were left out as those of a receiver that had not settled."""
    heading = np.radians(turn) * 0.2 * np.arange(300) + seed
    velocity = size * np.column_stack([np.cos(heading), np.sin(heading)])
    gnss = receiver(np.random.default_rng(seed), velocity, np.cumsum(0.2 * velocity, axis=0))
    assert speed(gnss) == pytest.approx(size, rel=0.1)


@pytest.mark.parametrize("seed", range(30))
def test_what_rests_does_not_creep(seed):
    """Velocities that wander by more than they should, and those of a receiver that settles."""
    random = np.random.default_rng(seed)
    still = np.zeros((300, 2))
    wandering = 0.3 * wander(random, 300, 20.0)
    assert speed(receiver(random, wandering, still)) is None
    assert speed(receiver(random, wandering, np.cumsum(0.2 * wandering, axis=0))) is None
    # it comes to where it is, and its velocity says so
    settling = np.exp(-0.2 * np.arange(300) / 20.0)[:, None] * [0.5, 0.3]
    assert speed(receiver(random, settling, np.cumsum(0.2 * settling, axis=0))) is None


@pytest.mark.parametrize("seed", range(10))
def test_what_creeps_stops_with_the_jolt_that_ends_its_rest(seed):
    """An even wander of a receiver that ends later moved a parked car that was knocked."""
    random = np.random.default_rng(seed)
    seconds = 0.2 * np.arange(400)
    found = []
    for until in (30.0, 45.0):
        velocity = np.where(seconds[:, None] < until, [0.6, 0.3], 0.0)
        gnss = receiver(random, velocity, np.cumsum(0.2 * velocity, axis=0))
        assert speed(gnss) is None
        found.append(crept(gnss, T0, T0 + 30 * 10**9))
    assert found == [pytest.approx(np.hypot(0.6, 0.3), rel=0.1), None]
