"""A start carried back over gaps: where to, and what bridges them."""

import numpy as np
import pytest

from sinstool.methods.strapdown.velocity import Increments
from sinstool.pipelines.process.ins_gnss.start_over_gaps import choices_of_rows, with_bridges


@pytest.mark.parametrize(
    ("crossed", "rows", "chosen"),
    [
        ([5, 5, 4, 2, 1, 1, 0], [1, 2, 3, 4, 5], [1, 3, 4]),
        ([4, 3, 3, 0], [0, 1, 2], [0]),  # fixes are rarer than gaps
        ([1, 1, 0], [0], [0]),
        ([2, 1, 0], [], []),
    ],
)
def test_over_ever_fewer_gaps(crossed, rows, chosen):
    assert choices_of_rows(np.array(rows, dtype=np.int64), np.array(crossed)) == chosen


def test_a_gap_is_bridged_by_the_mean_motion_on_both_sides():
    """By one sample on each side, which may be mostly vibration, attitudes were 160 deg off."""
    n, dt = 600, 0.005
    random = np.random.default_rng(3)
    time_ns = np.arange(1, n + 1) * 5_000_000
    time_ns[300:] += 400_000_000
    rate = np.where(np.arange(n)[:, None] < 300, 0.2, 0.4) + 2.0 * random.standard_normal((n, 3))
    made = Increments(np.arange(n), time_ns, np.full(n, dt), dt * rate, np.full((n, 3), 9.8 * dt))
    whole, bridged = with_bridges(made)
    assert np.flatnonzero(bridged).tolist() == [300]
    assert whole.interval[300] == pytest.approx(0.4)
    assert whole.time_ns[300] == time_ns[300] - 5_000_000
    means = 0.5 * (rate[200:300].mean(axis=0) + rate[300:400].mean(axis=0))
    assert whole.rotation_vector[300] == pytest.approx(0.4 * means)
    assert whole.velocity_increment[300] == pytest.approx(np.full(3, 0.4 * 9.8))
    assert np.array_equal(np.delete(whole.rotation_vector, 300, axis=0), made.rotation_vector)
