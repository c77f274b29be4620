"""Which of a receiver's fixes are off by the same, by how they jump."""

import numpy as np
import pytest

from sinstool.methods.ins_gnss.fix_jumps import false_stretches, unsettled

SIGMA = 0.02
WAY = np.array([0.6, -0.5, 1.3])


def innovations(off, rate=5.0, left=0.99, seed=0):
    """Of a filter that drifts, and takes off a part of each as it corrects."""
    random = np.random.default_rng(seed)
    n = len(off)
    drift = 0.2 * np.sin(np.arange(n)[:, None] / rate / np.array([5.0, 7.0, 11.0]))
    own, nu = np.zeros(3), np.empty((n, 3))
    for k in range(n):
        own = own + (drift[k] - drift[k - 1] if k else 0.0)
        nu[k] = own - off[k] + SIGMA * random.standard_normal(3)
        own = own - (1.0 - left) * nu[k]
    time_ns = np.round(np.arange(n) / rate * 1e9).astype(np.int64)
    return time_ns, nu, np.full((n, 3), left), np.full((n, 3), SIGMA)


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


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("rate", [1.0, 5.0])
def test_what_a_navigation_that_lost_its_attitude_shows_is_left_aside(rate, seed):
    """Its errors shrink, some at once; the fixes are right until they are off, much later."""
    random = np.random.default_rng([seed, 6])
    since = np.maximum(np.arange(600) - 200, 0)
    wander = np.where(since > 0, np.exp(-since / 25.0), 0.0)[:, None]
    own = np.cumsum(wander * random.standard_normal((600, 3)), axis=0)
    own[260:] += 0.8
    off = own + steps((450, 500, WAY))
    time_ns, nu, left, _ = innovations(off, rate, seed=seed)
    aside = unsettled(time_ns, nu, left, time_ns[[200]] - 10)
    assert not aside[:200].any() and aside[200:260].all() and not aside[380:].any()
    assert not unsettled(time_ns, nu, left, time_ns[:0]).any()
    assert not unsettled(time_ns[:20], nu[:20], left[:20], time_ns[:1]).any()


def test_a_navigation_that_never_settles_shows_nothing():
    random = np.random.default_rng(7)
    own = np.cumsum(random.standard_normal((600, 3)) * (np.arange(600) >= 400)[:, None], axis=0)
    time_ns, nu, left, _ = innovations(own)
    aside = unsettled(time_ns, nu, left, time_ns[[400]])
    assert not aside[:400].any() and aside[400:].all()


def test_what_is_no_jump():
    """Single outliers, what a filter takes off after an outage, slow errors, and huge ones."""
    outliers = steps(*((k, k + 1, 20.0 * WAY) for k in range(40, 600, 40)))
    assert false_stretches(*innovations(outliers)) == []
    slow = np.outer(np.sin(np.arange(600) / 60.0), WAY)
    assert false_stretches(*innovations(slow)) == []
    assert false_stretches(*innovations(steps((300, 600, 40.0 * WAY)))) == []
    often = steps(*((k, k + 6, (-1.0) ** k * WAY) for k in range(0, 600, 11)))
    assert false_stretches(*innovations(often)) == []
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
