"""Estimate and covariance from one measurement to the next.

``P <- Phi (P + Q/2) Phi^T + Q/2``, with Phi of which only the rows of moving states are not
trivial, and at each sample of the barometer what the damping network does to the errors.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from sinstool.methods.ins_gnss.states import (
    I_BARO,
    I_CORRECTION,
    I_COUPLED,
    I_MOVING,
    I_STATES,
    POSITION,
    VELOCITY,
)

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_D = POSITION + 2
_VD = VELOCITY + 2


# Sums may be made in any order, or they would not be made several at a time.
@numba.njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def propagate_covariance(
    index: IntArray,
    phi: FloatArray,
    decay: FloatArray,
    noise: FloatArray,
    delta: float,
    p: FloatArray,
    half: FloatArray,
) -> None:
    """Covariance over a substep.

    Parameters
    ----------
    index : ndarray of int64
        :attr:`sinstool.methods.ins_gnss.states.FilterKind.index`.
    phi, decay : ndarray, shape (m, n) and (n,)
        See :func:`sinstool.methods.ins_gnss.model.transition`.
    noise : ndarray, shape (n,)
        Power densities.
    delta : float
        s.
    p : ndarray, shape (n, n)
        Changed in place; stays symmetric to the last bit.
    half : ndarray, shape (m, n)
        Room to work in.
    """
    m = index[I_MOVING]
    coupled = index[I_COUPLED]
    n = index[I_STATES]
    for i in range(n):
        p[i, i] += 0.5 * delta * noise[i]
    for i in range(m):
        for j in range(n):
            half[i, j] = 0.0
        for k in range(coupled):
            f = phi[i, k]
            if f != 0.0:
                for j in range(n):
                    half[i, j] += f * p[k, j]
    for i in range(m):
        for j in range(i + 1):
            total = 0.0
            for k in range(coupled):
                total += half[i, k] * phi[j, k]
            p[i, j] = total
            p[j, i] = total
        for j in range(m, n):
            total = half[i, j] * decay[j]
            p[i, j] = total
            p[j, i] = total
    for i in range(m, n):
        if decay[i] != 1.0:
            for j in range(m, n):
                p[i, j] *= decay[i]
                p[j, i] = p[i, j] if j != i else p[j, i] * decay[i]
    for i in range(n):
        p[i, i] += 0.5 * delta * noise[i]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def propagate_estimate(
    index: IntArray, phi: FloatArray, decay: FloatArray, x: FloatArray, half: FloatArray
) -> None:
    """Estimate over a substep: x, shape (n,), is changed; see :func:`propagate_covariance`."""
    m = index[I_MOVING]
    for i in range(m):
        total = 0.0
        for k in range(index[I_COUPLED]):
            total += phi[i, k] * x[k]
        half[i, 0] = total
    for i in range(m):
        x[i] = half[i, 0]
    for i in range(m, index[I_STATES]):
        x[i] *= decay[i]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def propagate_product(
    index: IntArray, phi: FloatArray, decay: FloatArray, product: FloatArray, half: FloatArray
) -> None:
    """Product of transitions, shape (n, n), times that of a substep."""
    m = index[I_MOVING]
    n = index[I_STATES]
    for i in range(m):
        for j in range(n):
            half[i, j] = 0.0
        for k in range(index[I_COUPLED]):
            f = phi[i, k]
            if f != 0.0:
                for j in range(n):
                    half[i, j] += f * product[k, j]
    for i in range(m):
        for j in range(n):
            product[i, j] = half[i, j]
    for i in range(m, n):
        for j in range(n):
            product[i, j] *= decay[i]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def baro_correction(
    index: IntArray,
    l1: float,
    l2: float,
    l3: float,
    offset: float,
    white: float,
    p: FloatArray,
    x: FloatArray,
    product: FloatArray,
    row: FloatArray,
) -> None:
    """What the network's correction at a sample does to the errors: ``M = I + L m^T``.

    The sample moves height, velocity and A by gains times
    ``e = dh - dh_B - w + K4 v_up``; in these states, ``m = (-1 at D, -1 at baro)`` and
    ``L = (l1 at D, l2 at v_D, l3 at A)``.

    Parameters
    ----------
    index : ndarray of int64
    l1, l2, l3 : float
        Gains: 1, 1/s, 1/s^2.
    offset : float
        ``K4 v_up``, m.
    white : float
        Variance of the sample's white noise w, m^2.
    p, x, product : ndarray
        Changed: covariance, estimate, product of transitions.
    row : ndarray, shape (n,)
        Room to work in.
    """
    n = index[I_STATES]
    a = index[I_CORRECTION]
    b = index[I_BARO]
    for j in range(n):
        row[j] = -p[_D, j] - p[b, j]
    square = white - row[_D] - row[b]
    for j in range(n):
        p[_D, j] += l1 * row[j]
        p[_VD, j] += l2 * row[j]
        p[a, j] += l3 * row[j]
    for j in range(n):
        p[j, _D] += l1 * row[j]
        p[j, _VD] += l2 * row[j]
        p[j, a] += l3 * row[j]
    p[_D, _D] += l1 * l1 * square
    p[_VD, _VD] += l2 * l2 * square
    p[a, a] += l3 * l3 * square
    p[_D, _VD] += l1 * l2 * square
    p[_D, a] += l1 * l3 * square
    p[_VD, a] += l2 * l3 * square
    p[_VD, _D] = p[_D, _VD]
    p[a, _D] = p[_D, a]
    p[a, _VD] = p[_VD, a]
    e = offset - x[_D] - x[b]
    x[_D] += l1 * e
    x[_VD] += l2 * e
    x[a] += l3 * e
    for j in range(n):
        e = -product[_D, j] - product[b, j]
        product[_D, j] += l1 * e
        product[_VD, j] += l2 * e
        product[a, j] += l3 * e
