"""The filter over epochs and its smoother, compiled; see `state` for the states."""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import kernel
from sinstool.methods.attitude_smoother.epochs import AT_REST, DURATION, MOVING, REST
from sinstool.methods.attitude_smoother.filter_step import (
    C0,
    DIVERGED,
    DRIFTED_S,
    JUDGED_AGAIN,
    correct,
    measure,
    predict_covariance,
    predict_error,
    predict_state,
    rate_at_gap,
    rest_kind,
)
from sinstool.methods.attitude_smoother.state import (
    STATE,
    copy,
    copy_square,
    inject,
    keep,
    less,
)
from sinstool.methods.products import product
from sinstool.methods.rts import ROWS, smoothed_change, smoother_gain

# What the filter stores of each epoch for the smoother: after its measurements (plus) and at its
# end, before those of the next (minus).
X_PLUS, X_MINUS, DX_PLUS, DX_MINUS, VECTORS = range(5)
P_PLUS, P_MINUS, TRANSITION, MATRICES = range(4)


def storage(count: int, n: int) -> tuple[FloatArray, FloatArray]:
    """Arrays for what :func:`forward` stores of so many epochs with `n` error states.

    Zeros make up the number of rows of matrices, here and below.
    """
    even = n + -n % ROWS
    return np.empty((count, VECTORS, STATE)), np.zeros((count, MATRICES, even, even))


def scratch(n: int) -> tuple[FloatArray, ...]:
    """Arrays that :func:`forward` and :func:`backward` work in, which allocate none themselves."""
    even = n + -n % ROWS
    return np.empty(even), np.empty(n), *np.zeros((3, even, even)), np.empty((3, 3))


@kernel()
def forward(
    epochs: FloatArray,
    field: FloatArray,
    begin: int,
    end: int,
    par: FloatArray,
    n: int,
    x: FloatArray,
    p: FloatArray,
    near: FloatArray,
    dx: FloatArray,
    last_x: FloatArray,
    last_p: FloatArray,
    kinds: FloatArray,
    vectors: FloatArray,
    matrices: FloatArray,
    gain: FloatArray,
    ahead: FloatArray,
    f: FloatArray,
    q: FloatArray,
    half: FloatArray,
    e: FloatArray,
) -> float:
    """Run the filter over a segment of the epochs.

    Parameters
    ----------
    epochs : ndarray, shape (m, WIDTH)
    field : ndarray, shape (m, FIELD_WIDTH) or (0, FIELD_WIDTH)
        Of the Earth at each, where there is a magnetometer.
    begin, end : int
        Of the segment: its first epoch, and the one after its last.
    par : ndarray, shape (PARAMETERS,)
    n : int
        Number of error states: 10 or 13.
    x : ndarray, shape (STATE,)
        State before the first epoch; replaced by the state after the last.
    p : ndarray, shape (n, n)
        Its covariance, replaced likewise.
    near : ndarray, shape (m + 1, STATE) or (0, STATE)
        States before and after each epoch to linearise about; none: the filter's own estimates.
    dx : ndarray, shape (ERRORS,)
        Estimated error of the state of `near` before the first epoch, zeros at the start of a log;
        replaced by that after the last.
    last_x, last_p : ndarray, shape (STATE,) and (KEPT,)
        Outputs: the state after the last epoch, corrected by `dx`, and its covariance of attitude
        and bias.
    kinds : ndarray, shape (m,) or (0,)
        Output: the kind of each epoch, MOVING to AT_REST, as the filter judges it; none: the kinds
        marked in `epochs` are taken.
    vectors, matrices : ndarray
        Of :func:`storage`. Outputs: states, error estimates, covariances and transitions of each
        epoch, for :func:`backward`. Where they have no room nothing is stored, and a filter that
        diverges stops at once.
    gain, ahead, f, q, half, e : ndarray
        Of :func:`scratch`.

    Returns
    -------
    float
        Log likelihood of the specific force in the moving epochs; `DIVERGED` where the filter
        diverged.
    """
    stored, hand = len(matrices) > 0, par[C0] > 0.0
    if len(near) and begin == 0:
        less(x, near[0], n, hand, dx, e)
        copy(near[0], x)
    total, since = 0.0, 0.0
    for k in range(begin, end):
        kind = int(epochs[k, REST])
        if kind > MOVING and len(kinds):
            kind = rest_kind(epochs[k], par, x, p, dx, since)
        elif kind > MOVING and par[JUDGED_AGAIN] > 0.0:
            kind = rest_kind(epochs[k], par, x, p, dx, DRIFTED_S)
        if len(kinds):
            since = 0.0 if kind == AT_REST else since + epochs[k, DURATION]
            kinds[k] = kind
        likelihood = measure(epochs[k], field, k, par, n, x, p, gain, dx, half, kind)
        if likelihood > DIVERGED:
            total += likelihood
        else:
            total = DIVERGED
            if not stored:
                break
        correct(near, k, x, dx, n, hand, kind, e)
        if stored:
            copy(x, vectors[k - begin, X_PLUS])
            copy(dx, vectors[k - begin, DX_PLUS])
            copy_square(p, n, matrices[k - begin, P_PLUS])
        predict_state(epochs[k], rate_at_gap(epochs, k), par, n, x, f, q, e)
        predict_error(near, k, x, f, dx, n, hand, e, ahead)
        predict_covariance(p, n, f, q, half)
        if stored:
            copy(x, vectors[k - begin, X_MINUS])
            copy(dx, vectors[k - begin, DX_MINUS])
            copy_square(p, n, matrices[k - begin, P_MINUS])
            copy_square(f, n, matrices[k - begin, TRANSITION])
    copy(x, last_x)
    inject(last_x, dx, n, hand, e)
    keep(p, last_p)
    return total


@kernel(vectorizes=False)
def backward(
    begin: int,
    end: int,
    n: int,
    hand: bool,
    vectors: FloatArray,
    matrices: FloatArray,
    end_x: FloatArray,
    end_p: FloatArray,
    end_dx: FloatArray,
    smoothed: FloatArray,
    covariance: FloatArray,
    relinearised: bool,
    scale: FloatArray,
    difference: FloatArray,
    low: FloatArray,
    right: FloatArray,
    half: FloatArray,
    e: FloatArray,
) -> None:
    """Smooth a segment, from its last epoch to its first (Rauch, Tung and Striebel).

    Parameters
    ----------
    begin, end, n
        See :func:`forward`.
    vectors, matrices : ndarray
        What :func:`forward` stored for the segment.
    end_x, end_p, end_dx : ndarray, shape (STATE,), (n, n) and (ERRORS,)
        Smoothed state, covariance and error estimate after the last epoch; replaced by those before
        the first.
    smoothed : ndarray, shape (m + 1, STATE)
        Output: smoothed states before the epochs `begin` to `end` - 1.
    covariance : ndarray, shape (m + 1, KEPT)
        Output: covariances of attitude and variances of the bias there.
    relinearised : bool
        The filter was linear about states of an earlier pass.
    scale, difference, low, right, half, e : ndarray
        Of :func:`scratch`.
    """
    for k in range(end - begin - 1, -1, -1):
        if relinearised:
            for j in range(n):
                difference[j] = end_dx[j] - vectors[k, DX_MINUS, j]
        else:
            less(end_x, vectors[k, X_MINUS], n, hand, difference, e)
        p_plus, p_minus = matrices[k, P_PLUS], matrices[k, P_MINUS]
        even = len(p_minus)
        product(matrices[k, TRANSITION], p_plus, n, n, n, right)
        smoother_gain(p_minus, even, right, low, scale)
        for j in range(n):
            s = 0.0
            for m in range(n):
                s += right[m, j] * difference[m]
            end_dx[j] = vectors[k, DX_PLUS, j] + s
        copy(vectors[k, X_PLUS], end_x)
        inject(end_x, end_dx, n, hand, e)
        smoothed_change(p_minus, end_p, even, right, half, low)
        for i in range(n):
            for j in range(i + 1):
                end_p[i, j] = 0.5 * (p_plus[i, j] + p_plus[j, i]) + low[i, j]
                end_p[j, i] = end_p[i, j]
        copy(end_x, smoothed[begin + k])
        keep(end_p, covariance[begin + k])
