"""How late fixes are, roughly, by the velocity changes of receiver and accelerometers.

An estimate of the latency with a filter needs a first value that is right to some tenths of a
second: fixes that are a second late look like noise, or give a wrong attitude. This one needs
neither attitude nor heading. Over some seconds the IMU shows how velocity changed, in axes that
were the body's at the beginning, and gravity belongs to it; at the right latency one rotation takes
these changes to those of the receiver. How much no rotation explains is the loss of Wahba's
problem, from the singular values of the attitude profile matrix [1]_.

References
----------
.. [1] F. L. Markley, "Attitude determination using vector observations and the singular value
   decomposition", J. Astronautical Sciences 36(3), 1988, 245-258, eqs. (6) to (17).
"""

from __future__ import annotations

import numpy as np

from sinstool.core import rotation
from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.earth import horizontal_metres
from sinstool.core.rotation import wrapped
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.core.units import STANDARD_GRAVITY
from sinstool.methods.alignment.still import WINDOW_NS, Windows

# Latencies of at most the first, s, are tried, in steps of the second.
MOST_S, STEP_S = 3.0, 0.25
# Velocity changes are those between fixes at least the first, s, and at most the second apart. One
# rotation holds for so many of them.
CHANGE_S, APART_S, SPAN = 0.8, 2.6, 8
# Of the spans in which velocity changes by more than this, m/s, the first ones: fewest and most.
LEAST_MS, LEAST_SPANS, MOST_SPANS = 1.0, 3, 100
# The latency is clear if the loss this far on either side, s, is so many times as large, and larger
# by so many times the loss of a degree of freedom.
BESIDE_S, CLEARLY, MARKED = 1.0, 1.3, 80.0
# Windows are turned in groups of so many, which one loop serves.
GROUP = 64


def rough_latency(windows: Windows, gnss: GnssEpochs | None) -> float | None:
    """How long before their stamps fixes are valid, to about 0.2 s.

    An antenna away from the IMU looks late or early by the time in which the vehicle moves so far.

    Parameters
    ----------
    windows : Windows
        In Forward-Right-Down axes, rates in rad/s.

    Returns
    -------
    float or None
        Latency, s; None unless it explains the velocity changes clearly better than one a second
        away, on either side.
    """
    if gnss is None or len(windows) < 2:
        return None
    time_ns, velocity_n = _velocities(gnss)
    lasted_s = np.diff(time_ns) / SECOND
    edges_ns = np.append(windows.start_ns, windows.start_ns[-1] + WINDOW_NS)
    missing = np.append(edges_ns[:-2] + WINDOW_NS != edges_ns[1:-1], False)
    beside, steps = round(BESIDE_S / STEP_S), round((MOST_S + BESIDE_S) / STEP_S)
    latencies = STEP_S * np.arange(-steps, steps + 1)
    reach_ns = round(latencies[-1] * SECOND)
    gaps = np.concatenate([[0], np.cumsum(missing)])
    # Gaps before the window in which each fix lies, however late it is
    earliest, latest = (
        np.searchsorted(edges_ns, time_ns + shift, side="right") - 1
        for shift in (-reach_ns, reach_ns)
    )
    inside = (earliest >= 0) & (latest < len(windows))
    before, behind = (gaps[np.clip(k, 0, len(windows) - 1)] for k in (earliest, latest))
    usable = inside[:-1] & inside[1:] & (before[:-1] == behind[1:]) & (lasted_s <= APART_S)
    rows = _spans(usable)
    changes_n = np.diff(velocity_n, axis=0)
    changes = np.linalg.norm(np.ptp(np.cumsum(changes_n[rows], axis=1), axis=1), axis=-1)
    rows = rows[changes > LEAST_MS][:MOST_SPANS]
    if len(rows) < LEAST_SPANS:
        return None
    seconds = (time_ns - edges_ns[0]) / SECOND
    felt_n = changes_n - np.outer(lasted_s, [0.0, 0.0, STANDARD_GRAVITY])
    # What follows the last span is not needed
    count = int(latest[rows[-1, -1] + 1]) + 1
    edges_s = (edges_ns[: count + 1] - edges_ns[0]) / SECOND
    integral = _by_imu(windows, count)
    loss = np.zeros(len(latencies))
    for k, late in enumerate(latencies):
        felt = np.stack([np.interp(seconds - late, edges_s, axis) for axis in integral.T], axis=-1)
        loss[k] = _loss(felt_n[rows], np.diff(felt, axis=0)[rows])
    k = int(np.argmin(loss))
    if not beside <= k < len(loss) - beside:
        return None
    free = len(rows) * 3 * (SPAN - 1)
    other = min(loss[k - beside], loss[k + beside])
    if other < CLEARLY * loss[k] or other - loss[k] < MARKED * loss[k] / free:
        return None
    left, middle, right = loss[k - 1 : k + 2]
    bend = left - 2.0 * middle + right
    return float(latencies[k] + (0.5 * STEP_S * (left - right) / bend if bend > 0.0 else 0.0))


def _velocities(gnss: GnssEpochs) -> tuple[IntArray, FloatArray]:
    """Times and velocities, NED, m/s, about a second apart: the receiver's, or of positions."""
    by_receiver = bool(gnss.has_velocity.any())
    rows = gnss.rows(gnss.has_velocity if by_receiver else gnss.has_position)
    # The first of each interval, whatever the rate
    number = (rows.time_ns - rows.time_ns[:1]) // round(CHANGE_S * SECOND)
    rows = rows.rows(np.unique(number, return_index=True)[1])
    if by_receiver:
        return rows.time_ns, np.nan_to_num(rows.velocity_n)
    lasted_ns = np.diff(rows.time_ns)
    north, east = horizontal_metres(
        np.diff(rows.latitude), wrapped(np.diff(rows.longitude)), rows.latitude[1:]
    )
    moved_n = np.stack([north, east, -np.nan_to_num(np.diff(rows.height))], axis=1)
    return rows.time_ns[:-1] + lasted_ns // 2, moved_n / (lasted_ns / SECOND)[:, None]


def _spans(usable: FloatArray) -> IntArray:
    """Numbers of `SPAN` usable changes in a row, shape (m, SPAN)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], usable.astype(np.int8), [0]])))
    runs = zip(edges[::2], edges[1::2], strict=True)
    first = [np.arange(a, b - SPAN + 1, SPAN) for a, b in runs]
    return np.concatenate([np.zeros(0, np.int64), *first])[:, None] + np.arange(SPAN)


def _by_imu(windows: Windows, n: int) -> FloatArray:
    """Integral of specific force at the edges of the first n windows, in one frame, m/s.

    Shape (n + 1, 3). A drift of that frame does not matter, as each span has a rotation of its own.
    """
    groups = -(-n // GROUP)
    padded = np.zeros((groups * GROUP, 4))
    padded[:, 0] = 1.0
    padded[:n] = windows.turn[0, :n]
    turn = padded.reshape(groups, GROUP, 4)
    within = np.empty_like(turn)
    q = np.tile([1.0, 0.0, 0.0, 0.0], (groups, 1))
    for k in range(GROUP):
        within[:, k] = q
        q = rotation.multiply(q, turn[:, k])
    first = np.tile([1.0, 0.0, 0.0, 0.0], (groups, 1))
    for k in range(1, groups):
        first[k] = rotation.normalise(rotation.multiply(first[k - 1], q[k - 1]))
    attitude = rotation.multiply(first[:, None], within).reshape(-1, 4)[:n]
    force = rotation.rotate(attitude, windows.force[0, :n])
    return np.concatenate([np.zeros((1, 3)), np.cumsum(force, axis=0) * (WINDOW_NS / SECOND)])


def _loss(changes_n: FloatArray, changes_b: FloatArray) -> float:
    """Sum of squares that the best rotation of each span leaves, (m/s)^2."""
    profile = np.einsum("mki,mkj->mij", changes_n, changes_b)
    s = np.linalg.svd(profile, compute_uv=False)
    explained = s[:, 0] + s[:, 1] + np.sign(np.linalg.det(profile)) * s[:, 2]
    return float(
        np.sum(np.square(changes_n)) + np.sum(np.square(changes_b)) - 2.0 * explained.sum()
    )
