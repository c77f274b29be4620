"""Exact coefficients of cross products of angular increments, optimal for pure coning.

For the last increment of an update crossed with weighted earlier ones,

    correction = (sum over m = 1..M of x_m * increment[N-m]) x increment[N],

the weights follow from demanding that in classical coning of small angle the error of the
update vanish to as many orders of ``lambda = coning rate * interval`` as there are weights.
With N increments per update and P previous ones, M = N - 1 + P and the drift falls as
``lambda**(2 M + 2)``.

References
----------
.. [1] R. B. Miller, "A new strapdown attitude algorithm", J. Guidance 6(4), 1983, 287-291.
.. [2] M. B. Ignagni, "Efficient class of optimized coning compensation algorithms",
   J. Guidance, Control, and Dynamics 19(2), 1996, 424-429.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache


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
