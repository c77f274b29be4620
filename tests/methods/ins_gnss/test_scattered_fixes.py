"""Which of a receiver's fixes scatter by far more than it states."""

import numpy as np
import pytest

from sinstool.methods.ins_gnss.scattered_fixes import scattered_stretches
from tests.methods.ins_gnss.test_fix_jumps import SIGMA, WAY, innovations, spans, steps


def scattered(*spans_, size=0.5, seed=0, way=None):
    """Offsets of fixes that scatter in some spans, and are off by `way` there."""
    random = np.random.default_rng([seed, 5])
    off = np.zeros((600, 3)) if way is None else steps(*((*span, way) for span in spans_))
    for begin, end in spans_:
        off[begin:end] += size * random.standard_normal((end - begin, 3))
    return off


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("way", [None, WAY])
def test_stretches_are_found_and_how_far_they_are_off(seed, way):
    inside = [(0, 60), (200, 300), (400, 430), (560, 600)]
    found = scattered_stretches(*innovations(scattered(*inside, seed=seed, way=way), seed=seed))
    expected = [(begin, end - 1) for begin, end in inside]
    assert np.abs(np.array(spans(found)) - expected).max() <= 2
    assert [one.scatter_m for one in found] == pytest.approx([0.5] * 4, rel=0.4)
    off = 0.5 if way is None else float(np.linalg.norm(way))
    assert [one.off_m for one in found] == pytest.approx([off] * 4, abs=0.5)


def test_what_does_not_scatter():
    """Good fixes, jumps, outliers, a receiver that says so, and one that is always that noisy."""
    assert scattered_stretches(*innovations(steps())) == []
    assert scattered_stretches(*innovations(steps((100, 200, WAY), (300, 320, -WAY)))) == []
    outliers = steps(*((k, k + 1, 2.0 * WAY) for k in range(40, 600, 20)))
    assert scattered_stretches(*innovations(outliers)) == []
    time_ns, nu, left, sigma = innovations(scattered((100, 200)))
    sigma[100:200] = 0.4
    assert scattered_stretches(time_ns, nu, left, sigma) == []
    assert scattered_stretches(*innovations(scattered((0, 600)))) == []
    assert scattered_stretches(*innovations(scattered((100, 200), size=3.0 * SIGMA))) == []
    assert scattered_stretches(time_ns[:10], nu[:10], left[:10], sigma[:10]) == []


def test_an_outage_ends_a_stretch():
    time_ns, nu, left, sigma = innovations(scattered((200, 300), (320, 400)))
    time_ns[310:] += 40 * 10**9
    found = scattered_stretches(time_ns, nu, left, sigma)
    assert np.abs(np.array(spans(found)) - [(200, 299), (320, 399)]).max() <= 2
