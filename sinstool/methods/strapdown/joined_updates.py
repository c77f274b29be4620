"""Several updates as one: rotation and velocity increment over all of them, exactly.

With ``C_k`` the rotation of the first ``k`` updates, of rotation vectors ``phi``,

    C_k+1 = C_k exp(phi_k+1),     u = sum of C_k u_k+1

are the rotation over all updates, and the integral of the specific force in the body axes at their
start: the same as those of one long update (P. G. Savage, "Strapdown inertial navigation
integration algorithm design, part 2: velocity and position algorithms", J. Guidance, Control and
Dynamics 21(2), 1998, 208-221, section II). A mechanisation loses accuracy only in what it takes as
constant over an update: gravity and the rotation of the navigation axes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import ceil

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.parts import kernel
from sinstool.core.quaternion_kernels import (
    EXACT,
    cross,
    increment_quaternion,
    product,
    put,
    row,
    to_rotation_vector,
)
from sinstool.core.streams import concatenate, take_rows
from sinstool.core.timeline import SECOND
from sinstool.methods.strapdown.velocity import Increments

# Duration below which updates are joined where navigations are only compared, or sampled at such
# steps, s. A mechanisation takes the velocity to change evenly over an update: with longer ones the
# buffeting of an aircraft moves it by centimetres within seconds.
JOINED_S = 0.05
# Jitter of the stamps that is allowed for, as a fraction of an update
ROUNDING = 0.01


def joined_updates(
    increments: Increments, below_s: float, seen_ns: IntArray | None = None
) -> Increments:
    """Join as many consecutive updates into one as stay shorter than a given time.

    Parameters
    ----------
    increments : Increments
        At least one update. Across gaps nothing is joined.
    below_s : float
        Upper limit of the duration of a joined update, s, at the usual interval.
    seen_ns : ndarray of int64, shape (m,), optional
        When fixes are valid, in order. The updates in which they lie stay as they are: how a
        vehicle shakes, and its antenna swings, within a joined one would look like noise of fixes.

    Returns
    -------
    Increments
        Each ends where the last of its updates does; the input itself where no two updates fit.
    """
    return _joined(increments, _first_rows(increments, below_s, seen_ns))


def joined_blocks(
    blocks: Iterable[Increments], below_s: float, seen_ns: IntArray | None = None
) -> Iterator[Increments]:
    """Join updates that come in blocks, wherever those end; see :func:`joined_updates`."""
    rest: Increments | None = None
    for block in blocks:
        rest = block if rest is None else concatenate([rest, block])
        first = _first_rows(rest, below_s, seen_ns)
        if len(first) > 1:
            # More may join the last
            begin = int(first[-1])
            yield _joined(take_rows(rest, slice(0, begin)), first[:-1])
            rest = take_rows(rest, slice(begin, None))
    if rest is not None:
        yield joined_updates(rest, below_s, seen_ns)


def _first_rows(increments: Increments, below_s: float, seen_ns: IntArray | None) -> IntArray:
    """The first update of each that they are joined to."""
    usual = float(np.median(increments.interval))
    most = max(ceil(below_s / usual - ROUNDING) - 1, 1)
    time_ns, interval = increments.time_ns, increments.interval
    waited = np.diff(time_ns) / SECOND - interval[1:]
    edges = np.flatnonzero(np.concatenate([[True], waited > 0.5 * usual, [True]]))
    if seen_ns is not None:
        begin_ns = int(time_ns[0]) - round(float(interval[0]) * SECOND)
        slack_ns = round(ROUNDING * usual * SECOND)
        edges = np.union1d(edges, _about(time_ns, begin_ns, seen_ns, slack_ns))
    pieces = -(-np.diff(edges) // most)
    before = np.repeat(np.cumsum(pieces) - pieces, pieces)
    return np.asarray(np.repeat(edges[:-1], pieces) + most * (np.arange(len(before)) - before))


def _joined(increments: Increments, first: IntArray) -> Increments:
    """From each of these updates to the next as one."""
    time_ns, interval = increments.time_ns, increments.interval
    if len(first) == len(time_ns):
        return increments
    count = np.diff(first, append=len(time_ns))
    turned, velocity = np.empty((len(first), 3)), np.empty((len(first), 3))
    _join(
        first,
        count,
        np.ascontiguousarray(increments.rotation_vector),
        np.ascontiguousarray(increments.velocity_increment),
        turned,
        velocity,
    )
    last = first + count - 1
    return Increments(
        increments.sample[last],
        time_ns[last],
        np.add.reduceat(interval, first),
        turned,
        velocity,
        None if increments.followed_rate is None else increments.followed_rate[last],
        None if increments.lost is None else np.add.reduceat(increments.lost, first),
    )


def _about(time_ns: IntArray, begin_ns: int, seen_ns: IntArray, slack_ns: int) -> IntArray:
    """The updates in which times lie, unless at their ends, and those after them."""
    seen_ns = seen_ns[(seen_ns > begin_ns + slack_ns) & (seen_ns <= time_ns[-1])]
    at = np.searchsorted(time_ns, seen_ns - slack_ns)
    within = np.abs(time_ns[at] - seen_ns) > slack_ns
    return np.concatenate([at[within], at + 1])


@kernel()
def _join(
    first: IntArray,
    count: IntArray,
    phi: FloatArray,
    u: FloatArray,
    turned: FloatArray,
    velocity: FloatArray,
) -> None:
    """Set rotation vectors and velocity increments over so many updates from each first one on."""
    for i in range(len(first)):
        w, x, y, z = 1.0, 0.0, 0.0, 0.0
        vx, vy, vz = 0.0, 0.0, 0.0
        for k in range(first[i], first[i] + count[i]):
            # v + 2 w (q x v) + 2 q x (q x v), as `rotation.rotate` has it
            ux, uy, uz = row(u, k)
            ax, ay, az = cross(x, y, z, ux, uy, uz)
            bx, by, bz = cross(x, y, z, ax, ay, az)
            vx += ux + 2.0 * (w * ax + bx)
            vy += uy + 2.0 * (w * ay + by)
            vz += uz + 2.0 * (w * az + bz)
            px, py, pz = row(phi, k)
            qw, qx, qy, qz = increment_quaternion(px, py, pz, EXACT)
            w, x, y, z = product(w, x, y, z, qw, qx, qy, qz)
        to_rotation_vector(w, x, y, z, turned, i)
        put(velocity, i, vx, vy, vz)
