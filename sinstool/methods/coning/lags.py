"""Coning corrections from one cross product: earlier increments with the last one.

The families ``uncompensated``, ``previous-P`` (one update per sample, P earlier samples),
``optimal-N`` (N samples per update, none from outside it) and ``optimal-N-previous-P`` differ
only in how many samples an update has and how many earlier ones it may use; the weights are
solved for.

References
----------
.. [1] R. B. Miller, "A new strapdown attitude algorithm", J. Guidance 6(4), 1983, 287-291.
.. [2] M. B. Ignagni, "Efficient class of optimized coning compensation algorithms",
   J. Guidance, Control, and Dynamics 19(2), 1996, 424-429.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import kernel
from sinstool.core.quaternion_kernels import cross, put, row, weighted_sum
from sinstool.methods.coning.algorithm import ConingAlgorithm, MultiSampleAlgorithm


class LagAlgorithm(MultiSampleAlgorithm):
    """Sum of increments plus one cross product of weighted earlier ones with the last.

    Parameters
    ----------
    samples : int
        Increments per update.
    previous : int
        Increments from before the update that are used where they exist.
    name, summary, source : str
        See :class:`ConingAlgorithm`.
    """

    def __init__(self, samples: int, previous: int, name: str, summary: str, source: str) -> None:
        self.name = name
        self.summary = summary
        self.source = source
        self.samples = samples
        self.before = previous
        # Row h: the weights when h earlier samples exist, zeros behind them.
        lags = samples - 1 + previous
        self._weights = np.zeros((previous + 1, max(lags, 1)))
        for history in range(previous + 1):
            exact = lag_coefficients(samples, history)
            self._weights[history, : len(exact)] = [float(x) for x in exact]

    def _fill(self, x: FloatArray, dt: FloatArray, first: int, out: FloatArray) -> None:
        lag_kernel(x, first, self.samples, self._weights, out)

    def _of_samples(self, samples: int) -> ConingAlgorithm:
        previous = self.before + self.samples - samples  # as many lags: the same order
        return LagAlgorithm(samples, previous, f"{self.name}[{samples}]", self.summary, self.source)


def uncompensated() -> LagAlgorithm:
    """Build the rectangle rule: the increment itself is the rotation vector."""
    return LagAlgorithm(
        1,
        0,
        "uncompensated",
        "no coning correction",
        "Bortz 1971, first term of the rotation vector",
    )


def previous(count: int) -> LagAlgorithm:
    """Build one update per sample, corrected from the `count` samples before it."""
    return LagAlgorithm(
        1,
        count,
        f"previous-{count}",
        f"every sample, with {count} earlier sample{'s' if count > 1 else ''}",
        "Ignagni 1996, class of previous-interval algorithms",
    )


def optimal(count: int, earlier: int = 0) -> LagAlgorithm:
    """Build one update per `count` samples with Miller's coning-optimal coefficients.

    With `earlier` it uses as many samples from before the update too, as Ignagni does
    (``optimal-N-previous-P``).
    """
    return LagAlgorithm(
        count,
        earlier,
        f"optimal-{count}" + (f"-previous-{earlier}" if earlier else ""),
        f"{count} samples per update"
        + (f" and {earlier} earlier" if earlier else "")
        + ", optimal for pure coning",
        "Miller 1983; Ignagni 1996",
    )


@kernel()
def lag_kernel(
    x: FloatArray, first: int, samples: int, weights: FloatArray, out: FloatArray
) -> None:
    """Updates of `samples` increments; row h of `weights` is for h earlier ones."""
    most = weights.shape[0] - 1
    for update in range(out.shape[0]):
        start = first + update * samples
        last = start + samples - 1
        history = min(start, most)
        sx, sy, sz = row(x, start)
        for k in range(start + 1, last + 1):
            sx += x[k, 0]
            sy += x[k, 1]
            sz += x[k, 2]
        lags = samples - 1 + history
        ax, ay, az = weighted_sum(x, last - 1, -1, weights, history, lags)
        bx, by, bz = row(x, last)
        cx, cy, cz = cross(ax, ay, az, bx, by, bz)
        put(out, update, sx + cx, sy + cy, sz + cz)


@cache
def lag_coefficients(samples: int, previous: int = 0) -> tuple[Fraction, ...]:
    """Weights of the increments 1, 2, .. M before the last one of an update.

    Parameters
    ----------
    samples : int
        Increments per update, N >= 1.
    previous : int, optional
        Increments before the update that may be used, P >= 0.

    Returns
    -------
    tuple of Fraction
        ``x_1 .. x_M``, ``M = N - 1 + P``, exact.

    Raises
    ------
    ValueError
        If `samples` is less than 1 or `previous` negative.

    Notes
    -----
    In coning the last component of the missing rotation and that of a product of two
    increments m apart are, up to the same factor,

        (N l - sin N l) / 2   and   2 sin(m l) - sin((m+1) l) - sin((m-1) l),

    and equal powers ``l**3, l**5, .. l**(2M+1)`` give the linear equations

        sum over m of x_m (2 m**k - (m+1)**k - (m-1)**k) = -N**k / 2,   k = 3, 5, .. 2M+1.
    """
    if samples < 1 or previous < 0:
        raise ValueError(f"No update has {samples} samples and {previous} previous ones.")
    lags = range(1, samples + previous)
    powers = [2 * m + 1 for m in lags]
    matrix = [[Fraction(2 * m**k - (m + 1) ** k - (m - 1) ** k) for m in lags] for k in powers]
    return solve(matrix, [Fraction(-(samples**k), 2) for k in powers])


def solve(matrix: list[list[Fraction]], right: list[Fraction]) -> tuple[Fraction, ...]:
    """Exact solution of a small square system of linear equations.

    Parameters
    ----------
    matrix : list of n lists of n Fraction
        Rows of the matrix.
    right : list of n Fraction
        Right-hand side.

    Returns
    -------
    tuple of n Fraction
        The solution.

    Raises
    ------
    ValueError
        If the matrix is singular.
    """
    n = len(right)
    rows = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    for column in range(n):
        pivot = next((i for i in range(column, n) if rows[i][column]), None)
        if pivot is None:
            raise ValueError("The matrix is singular.")
        rows[column], rows[pivot] = rows[pivot], rows[column]
        head = rows[column]
        rows[column] = head = [value / head[column] for value in head]
        for i in range(n):
            if i != column and rows[i][column]:
                scale = rows[i][column]
                rows[i] = [a - scale * b for a, b in zip(rows[i], head, strict=True)]
    return tuple(row[n] for row in rows)
