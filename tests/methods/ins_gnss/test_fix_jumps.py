"""Which of a receiver's fixes are off by the same, by how they jump."""

import numpy as np
import pytest

from sinstool.methods.ins_gnss.fix_jumps import certainty, false_stretches
from sinstool.methods.ins_gnss.scattered_fixes import scattered_stretches

SIGMA = 0.02
WAY = np.array([0.6, -0.5, 1.3])


def innovations(off, rate=5.0, left=0.99, seed=0):
    """Of a filter that drifts, and takes off a part of each as it corrects."""
    random = np.random.default_rng(seed)
    n = len(off)
    left = np.broadcast_to(left, (n, 3)).copy()
    drift = 0.2 * np.sin(np.arange(n)[:, None] / rate / np.array([5.0, 7.0, 11.0]))
    own, nu = np.zeros(3), np.empty((n, 3))
    for k in range(n):
        own = own + (drift[k] - drift[k - 1] if k else 0.0)
        nu[k] = own - off[k] + SIGMA * random.standard_normal(3)
        own = own - (1.0 - left[k]) * nu[k]
    time_ns = np.round(np.arange(n) / rate * 1e9).astype(np.int64)
    return time_ns, nu, left, np.full((n, 3), SIGMA)


def spans(found):
    return [(one.first, one.last) for one in found]


def steps(*pairs, n=600):
    off = np.zeros((n, 3))
    for begin, end, way in pairs:
        off[begin:end] = way
    return off


@pytest.mark.parametrize("seed", range(3))
def test_those_that_return_are_off(seed):
    off = steps((100, 200, WAY), (300, 320, -2.0 * WAY), (500, 600, WAY))
    found = false_stretches(*innovations(off, seed=seed))
    assert spans(found) == [(100, 199), (300, 319), (500, 599)]
    expected = np.linalg.norm(WAY) * np.array([1.0, 2.0, 1.0])
    assert [one.off_m for one in found] == pytest.approx(expected, abs=0.2)
    assert all(one.sure for one in found)


def test_the_longer_part_is_right_and_of_two_halves_none():
    (first,) = false_stretches(*innovations(steps((0, 150, WAY))))
    assert (first.first, first.last, first.sure) == (0, 149, True)
    halves = false_stretches(*innovations(steps((0, 300, WAY))))
    assert spans(halves) == [(0, 299), (300, 599)]
    assert not any(one.sure for one in halves)


def test_a_receiver_that_says_so_is_right():
    time_ns, nu, left, sigma = innovations(steps((100, 200, WAY)))
    sigma[100:200] = 0.6
    assert false_stretches(time_ns, nu, left, sigma) == []


def shares_left(sigma):
    """What filters leave of innovations, by the sigma of their changes over that of the fixes."""
    left, after = [], 1.0
    for change in sigma:
        left.append(1.0 / (1.0 + after + change**2))
        after = 1.0 - left[-1]
    return np.repeat(np.array(left)[:, None], 3, axis=1)


def test_certainty_beside_the_usual():
    sigma = np.where(np.abs(np.arange(100) - 50) < 10, 5.0, 1.0)
    assert certainty(shares_left(sigma))[1:] == pytest.approx(1.0 / sigma[2:], rel=1e-6)
    assert np.all(certainty(np.ones((10, 3))) == 1.0)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    ("stretches", "lost"),
    [(false_stretches, [300, 360]), (scattered_stretches, range(300, 360))],
)
def test_errors_of_a_navigation_that_says_so_are_not_those_of_fixes(stretches, lost, seed):
    change = np.zeros((600, 3))
    change[lost] = np.random.default_rng([seed, 6]).normal(0.0, 1.0, (len(lost), 3))
    sigma = np.full(600, 0.02)
    assert stretches(*innovations(np.cumsum(change, axis=0), seed=seed))
    sigma[lost] = 1.0
    left = shares_left(sigma)
    assert stretches(*innovations(np.cumsum(change, axis=0), left=left, seed=seed)) == []


def test_what_is_no_jump():
    """Single outliers, what a filter takes off after an outage, slow errors, and huge ones."""
    outliers = steps(*((k, k + 1, 20.0 * WAY) for k in range(40, 600, 40)))
    assert false_stretches(*innovations(outliers)) == []
    slow = np.outer(np.sin(np.arange(600) / 60.0), WAY)
    assert false_stretches(*innovations(slow)) == []
    assert false_stretches(*innovations(steps((300, 600, 40.0 * WAY)))) == []
    time_ns, nu, left, sigma = innovations(np.zeros((600, 3)))
    time_ns[300:] += 40 * 10**9
    nu[300], left[300] = 100.0 * WAY, 1e-4  # believed at once
    assert false_stretches(time_ns, nu, left, sigma) == []
    assert false_stretches(time_ns[:10], nu[:10], left[:10], sigma[:10]) == []


def test_beyond_an_outage_nothing_is_compared():
    """A stretch that begins with an outage has no edge there: of what follows the most is right."""
    off = steps((250, 300, WAY))
    time_ns, nu, left, sigma = innovations(off)
    keep = np.r_[0:240, 260:600]
    found = false_stretches(time_ns[keep], nu[keep], left[keep], sigma[keep])
    assert spans(found) == [(240, 279)]


@pytest.mark.parametrize("rate", [1.0, 2.0, 5.0])
def test_a_lost_message_is_no_outage(rate):
    """Of fixes between two lost ones none would jump, and those that are off would seem right."""
    off = steps((100, 200, WAY), (300, 400, WAY))
    time_ns, nu, left, sigma = innovations(off, rate)
    keep = np.delete(np.arange(600), [102, 198, 302, 398])
    found = false_stretches(time_ns[keep], nu[keep], left[keep], sigma[keep])
    assert spans(found) == [(100, 197), (298, 395)]
    assert all(one.sure for one in found)


def test_a_receiver_that_scatters_as_much_shows_nothing():
    off = steps((100, 200, 3.0 * WAY)) + np.random.default_rng(1).normal(0.0, 0.4, (600, 3))
    assert false_stretches(*innovations(off)) == []
