"""RodFIter: functional iteration of Rodrigues vectors, to check the iterations of quaternions.

It shares no formula with them but the fit of the rate.

References
----------
.. [1] Y. Wu, "RodFIter: Attitude reconstruction from inertial measurement by functional
   iteration", IEEE Trans. Aerospace and Electronic Systems 54(5), 2018, 2131-2142.
"""

import numpy as np
from numpy.polynomial import chebyshev as cheb

from sinstool.methods.coning import polynomial

MOST_ORDER = 96

# A Rodrigues vector of two radians is 3.1 long; an iterate of this length is on its way out.
DIVERGED = 1e3


def rodrigues_iteration(increments, iterations=40):
    """Rotation vector of one update by functional iteration of Rodrigues vectors (RodFIter).

    Parameters
    ----------
    increments : array_like, shape (N, 3)
        Of the update, rad.
    iterations : int, optional
        At most; it stops where nothing changes.

    Returns
    -------
    ndarray, shape (3,)
        rad.

    Raises
    ------
    ValueError
        If the shape is wrong, or the iteration does not converge: that is so for rotations
        of more than some two radians at any time within the update, as a Rodrigues vector
        is infinite at half a turn.

    Notes
    -----
    ``g = 2 tan(phi/2) phi/|phi|`` obeys ``g' = omega + g x omega / 2 + g (g . omega) / 4``.
    """
    rows = np.asarray(increments, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != 3 or len(rows) < 1:
        raise ValueError(f"Expected `increments` to have shape (N, 3), got {rows.shape}.")
    # the coefficients of each axis in a row
    count = len(rows)
    fits = polynomial.product(
        polynomial.chebyshev(count), polynomial.through_increments(count, 0, count)
    )
    omega = (polynomial.table([fits])[0] @ rows).T
    g = np.zeros((3, 1))
    change = np.inf
    for _ in range(iterations):
        a, b, c = g
        x, y, z = omega
        along = _sum(cheb.chebmul(a, x), cheb.chebmul(b, y), cheb.chebmul(c, z))
        rate = [
            _sum(x, 0.5 * _cross(b, z, c, y)),
            _sum(y, 0.5 * _cross(c, x, a, z)),
            _sum(z, 0.5 * _cross(a, y, b, x)),
        ]
        turned = [
            cheb.chebint(_sum(r, 0.25 * cheb.chebmul(v, along)), lbnd=-1.0)
            for r, v in zip(rate, g, strict=True)
        ]
        longest = min(max(len(v) for v in turned), MOST_ORDER)
        following = np.array([np.pad(v, (0, max(0, longest - len(v))))[:longest] for v in turned])
        before = np.pad(g, ((0, 0), (0, longest - g.shape[1])))
        change = float(np.max(np.abs(following - before)))
        g = following
        if not change > 1e-17 or not np.max(np.abs(g)) < DIVERGED:
            break
    end = g.sum(axis=1)  # every T_k is 1 at tau = 1
    length = float(np.linalg.norm(end))
    if not change < 1e-15 * max(1.0, length):
        raise ValueError("The iteration of Rodrigues vectors does not converge.")
    return np.asarray(end * (2.0 * np.arctan(0.5 * length) / length if length else 1.0))


def _cross(a, b, c, d):
    return _sum(cheb.chebmul(a, b), -cheb.chebmul(c, d))


def _sum(*terms):
    out = np.zeros(max(len(t) for t in terms))
    for term in terms:
        out[: len(term)] += term
    return out
