"""Navigation backwards in time: what came before a state that is known.

One update of :func:`sinstool.methods.strapdown.navigation.step` is undone by finding the state that
it takes to the one known. The step is the identity but for terms of first order in its duration, so
that the fixed point converges by that factor at each round.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from sinstool.core.quaternion_kernels import EXACT, product, unit_factor, wrapped_angle
from sinstool.methods.strapdown.navigation import (
    LATITUDE,
    LONGITUDE,
    Q_W,
    Q_X,
    Q_Y,
    Q_Z,
    SIZE,
    V_DOWN,
    advance,
)

FloatArray = NDArray[np.float64]

ROUNDS = 5
"""Each leaves of the error about the turn of the body in one update."""


@numba.njit(cache=True, nogil=True)
def navigate_backward(
    state: FloatArray, phi: FloatArray, dv: FloatArray, dt: FloatArray, out: FloatArray
) -> None:
    """Undo the updates of a block, the last first.

    Parameters
    ----------
    state : ndarray, shape (SIZE,)
        At the end of the block; in its place comes the one at the start.
    phi, dv : ndarray, shape (n, 3)
        Rotation vectors, rad, and velocity increments, m/s, biases taken off.
    dt : ndarray, shape (n,)
        s.
    out : ndarray, shape (n, SIZE)
        Gets the state at the **start** of each update.
    """
    before = state.copy()
    trial = state.copy()
    for k in range(out.shape[0] - 1, -1, -1):
        before[:] = state
        for _ in range(ROUNDS):
            trial[:] = before
            advance(trial, phi, dv, dt, k, EXACT)
            for i in range(V_DOWN + 1):
                before[i] += state[i] - trial[i]
            before[LONGITUDE] = wrapped_angle(before[LONGITUDE])
            before[LATITUDE] = min(max(before[LATITUDE], -0.5 * np.pi), 0.5 * np.pi)
            # the turn of n that is left, from the left
            w, x, y, z = state[Q_W], state[Q_X], state[Q_Y], state[Q_Z]
            ew, ex, ey, ez = product(w, x, y, z, trial[Q_W], -trial[Q_X], -trial[Q_Y], -trial[Q_Z])
            w, x, y, z = before[Q_W], before[Q_X], before[Q_Y], before[Q_Z]
            bw, bx, by, bz = product(ew, ex, ey, ez, w, x, y, z)
            f = unit_factor(bw * bw + bx * bx + by * by + bz * bz)
            before[Q_W], before[Q_X], before[Q_Y], before[Q_Z] = bw * f, bx * f, by * f, bz * f
        state[:] = before
        for i in range(SIZE):
            out[k, i] = state[i]
