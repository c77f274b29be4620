"""Covariances of filter and smoother against a vertical channel of six states, solved apart."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from benchmarks import ins_gnss_monte_carlo as monte_carlo
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.smoother import Smoother

SECONDS = 900
OUTAGE = (600, 660)
W2 = 3.086e-6  # 1/s^2: how gravity falls with height, both of normal gravity and of the way down
G = 9.80665


def riccati(with_baro):
    """Variances of height and vertical velocity at whole seconds, of filter and smoother.

    Height, velocity, one bias for that of the accelerometer and its scale factor under gravity,
    barometer, GNSS height and velocity. Sizes are those of the benchmark's spiral.
    """
    f = np.zeros((6, 6))
    f[0, 1], f[1, 0], f[1, 2] = 1.0, W2, 1.0
    f[3:, 3:] = -np.diag([1 / 500.0, 1 / 200.0, 1 / 60.0])
    density = np.diag(
        [0, (10e-6 * G) ** 2, 0, 2 * 10.0**2 / 500, 2 * 8.0**2 / 200, 2 * 0.15**2 / 60]
    )
    # Van Loan
    both = expm(np.block([[-f, density], [np.zeros((6, 6)), f.T]]))
    phi = both[6:, 6:].T
    q = phi @ both[:6, 6:]
    bias = 50e-6 * G * (np.sqrt(2.0) if with_baro else 1.0)  # markov-21 has no scale factors
    p = np.diag([5.0, 0.1, bias, 10.0, 8.0, 0.15]) ** 2
    h = np.array([[1.0, 0, 0, 0, -1, 0], [0, 1, 0, 0, 0, -1], [1, 0, 0, -1, 0, 0]])
    noise = np.diag([3.0, 0.08, 0.05]) ** 2
    before, after = [], []
    for k in range(1, SECONDS):
        p = phi @ p @ phi.T + q
        before.append(p)
        rows = [] if OUTAGE[0] <= k < OUTAGE[1] else [0, 1]
        rows += [2] if with_baro else []
        if rows:
            part = h[rows]
            s = part @ p @ part.T + noise[np.ix_(rows, rows)]
            gain = np.linalg.solve(s, part @ p).T
            p = p - gain @ s @ gain.T
        after.append(p)
    smooth = list(after)
    for k in range(len(after) - 2, -1, -1):
        gain = np.linalg.solve(before[k + 1], phi @ after[k]).T
        smooth[k] = after[k] + gain @ (smooth[k + 1] - before[k + 1]) @ gain.T
    return [np.array([np.diag(p)[:2] for p in result]) for result in (after, smooth)]


@pytest.mark.parametrize("name", ["baro-24", "markov-21"])
def test_height_is_known_as_well_as_a_small_filter_says(name):
    scene = replace(monte_carlo.spiral_scene(float(SECONDS), 16.0), gaps=(OUTAGE,))
    data = monte_carlo.simulate(scene, 1)
    with_baro = name == "baro-24"
    settings = monte_carlo.spiral_settings(scene, name)
    run = InsGnssFilter(data.start, settings, with_baro=with_baro, output=True, store=True)
    baro = (data.baro_time_ns, data.baro_height) if with_baro else ()
    block = run.push(data.increments, data.gnss, None, *baro)
    with Smoother(run.kind) as smoother:
        smoother.push(block)
        smoothed = smoother.epochs()
    stored = block.stored
    seconds = (stored.time_ns - scene.flight.time_ns[0]) * 1e-9
    whole = np.abs(seconds - np.round(seconds)) < 1e-3
    _, last = np.unique(np.round(seconds[whole]), return_index=True)
    rows = np.flatnonzero(whole)[last]
    second = np.round(seconds[rows]).astype(int)
    rows, second = rows[second >= 60], second[second >= 60]
    for ours, expected in zip(
        (stored.covariance_after, smoothed.covariance), riccati(with_baro), strict=True
    ):
        at = second[second < SECONDS] - 1
        result = np.sqrt(np.diagonal(ours, axis1=1, axis2=2)[rows[second < SECONDS]][:, [2, 5]])
        ratio = result / np.sqrt(expected[at])
        # the small one has no tilt and no Earth's turn
        assert np.median(ratio, axis=0) == pytest.approx([1.0, 1.0], abs=0.03)
        assert ratio == pytest.approx(np.ones_like(ratio), abs=0.12)
