"""Several updates as one: rotation and velocity increment over all of them, exactly.

With ``C_k`` the rotation of the first ``k`` updates, of rotation vectors ``phi``,

    C_k+1 = C_k exp(phi_k+1),     u = sum of C_k u_k+1

is what the updates together do to an attitude, and the integral of the specific force in the axes
in which they begin: the same as of one long update (P. G. Savage, "Strapdown inertial navigation
integration algorithm design, part 2: velocity and position algorithms", J. Guidance, Control and
Dynamics 21(2), 1998, 208-221, section II). What a mechanisation loses with it is what it takes as
constant over an update: gravity and the turning of the navigation axes.
"""

from __future__ import annotations

from itertools import pairwise
from math import ceil

import numpy as np

from sinstool.core.rotation import exp, log, multiply, rotate
from sinstool.core.timeline import SECOND
from sinstool.methods.strapdown.velocity import Increments

# By how much of an update stamps may jitter.
ROUNDING = 0.01


def joined_updates(increments: Increments, below_s: float) -> Increments:
    """Updates, as many made one as are shorter than a time together.

    Parameters
    ----------
    increments : Increments
        At least one update. Across gaps nothing is joined.
    below_s : float
        What is joined stays shorter, where updates have their usual interval.

    Returns
    -------
    Increments
        Each ends where the last of its updates does; the same as before where no two fit.
    """
    usual = float(np.median(increments.interval))
    most = ceil(below_s / usual - ROUNDING) - 1
    if most < 2:
        return increments
    time_ns, interval = increments.time_ns, increments.interval
    waited = np.diff(time_ns) / SECOND - interval[1:]
    runs = np.flatnonzero(np.concatenate([[True], waited > 0.5 * usual, [True]]))
    first = np.concatenate([np.arange(begin, end, most) for begin, end in pairwise(runs)])
    count = np.diff(first, append=len(time_ns))
    q = exp(increments.rotation_vector[first])
    velocity = increments.velocity_increment[first]
    for k in range(1, most):
        here = np.flatnonzero(count > k)
        at = first[here] + k
        velocity[here] += rotate(q[here], increments.velocity_increment[at])
        q[here] = multiply(q[here], exp(increments.rotation_vector[at]))
    last = first + count - 1
    return Increments(
        increments.sample[last],
        time_ns[last],
        np.add.reduceat(interval, first),
        log(q),
        velocity,
    )
