"""Exact polynomials of the angular rate through increments or point rates.

Time within an update is ``tau``, -1 at its start and +1 at its end, and the rate is

    omega(tau) d tau = sum over k of c_k tau**k d tau,

so that the coefficients are angles in rad whatever the interval. They are linear in the
samples; the matrices here are rational numbers, rounded once at the end. Samples outside the
update (history, look-ahead) are at their places before -1 or after +1.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import cache
from itertools import pairwise

import numpy as np

from sinstool.core.arrays import FloatArray

Matrix = tuple[tuple[Fraction, ...], ...]

_Polynomial = list[Fraction]


@cache
def through_increments(rows: int, first: int, count: int) -> Matrix:
    """Coefficients of the rate polynomial that reproduces every increment.

    Parameters
    ----------
    rows : int
        Increments, all of equal duration; the polynomial has degree ``rows - 1``.
    first, count : int
        The update consists of the increments ``first .. first + count - 1``.

    Returns
    -------
    tuple of `rows` tuples of `rows` Fraction
        Row k: weights of the increments in ``c_k``.

    Raises
    ------
    ValueError
        If the update is empty or not among the rows.

    Notes
    -----
    The cumulative angle is the Lagrange polynomial through its ``rows + 1`` values; the rate
    is its derivative, and increment j is in all values from ``j + 1`` on.
    """
    _check(rows, first, count)
    nodes = [Fraction(2 * (i - first) - count, count) for i in range(rows + 1)]
    derivatives = [_derivative(p) for p in _lagrange(nodes)]
    columns = []
    total = [Fraction(0)] * rows
    for derivative in reversed(derivatives[1:]):
        total = [a + b for a, b in zip(total, derivative, strict=True)]
        columns.append(total)
    return tuple(zip(*reversed(columns), strict=True))


@cache
def through_rates(points: int, interval: int) -> Matrix:
    """Coefficients of the rate polynomial through point rates, for one sample interval.

    Parameters
    ----------
    points : int
        Rates, equally spaced; the polynomial has degree ``points - 1``.
    interval : int
        The update is the interval between the rates ``interval`` and ``interval + 1``.

    Returns
    -------
    tuple of `points` tuples of `points` Fraction
        Row k: weights of ``rate * interval's duration`` in ``c_k``.

    Raises
    ------
    ValueError
        If the interval does not lie between the points.
    """
    _check(points - 1, interval, 1)
    nodes = [Fraction(2 * (i - interval) - 1) for i in range(points)]
    # d t = (duration / 2) d tau
    columns = [[c / 2 for c in p] for p in _lagrange(nodes)]
    return tuple(zip(*columns, strict=True))


@cache
def reduction(degree: int, parts: int) -> Matrix:
    """Cut an update into parts, and take the polynomial through their increments instead.

    Parameters
    ----------
    degree : int
        Of the polynomial there is.
    parts : int
        Equal parts; the polynomial that comes back has degree ``parts - 1`` and the same
        integral over every part.

    Returns
    -------
    tuple of `parts` tuples of ``degree + 1`` Fraction
        Takes the coefficients of the one to those of the other.
    """
    edges = [Fraction(2 * i - parts, parts) for i in range(parts + 1)]
    integrals = tuple(
        tuple((b ** (k + 1) - a ** (k + 1)) / (k + 1) for k in range(degree + 1))
        for a, b in pairwise(edges)
    )
    return product(through_increments(parts, 0, parts), integrals)


@cache
def chebyshev(terms: int) -> Matrix:
    """Powers of tau to Chebyshev polynomials of the first kind.

    Parameters
    ----------
    terms : int
        Coefficients of a polynomial, 1 or more.

    Returns
    -------
    tuple of `terms` tuples of `terms` Fraction
        Column k: coefficients of ``T_0, T_1, ..`` in ``tau**k``.

    Notes
    -----
    ``tau T_0 = T_1`` and ``tau T_n = (T_(n+1) + T_(n-1)) / 2``.
    """
    column = [Fraction(1), *[Fraction(0)] * (terms - 1)]
    columns = [column]
    for _ in range(terms - 1):
        raised = [Fraction(0)] * terms
        for n, c in enumerate(column):
            if not c:
                continue
            if n == 0:
                raised[1] += c
            else:
                raised[n + 1] += c / 2
                raised[n - 1] += c / 2
        column = raised
        columns.append(column)
    return tuple(zip(*columns, strict=True))


def product(left: Matrix, right: Matrix) -> Matrix:
    """Exact product of two matrices."""
    columns = tuple(zip(*right, strict=True))

    def along(row: tuple[Fraction, ...], column: tuple[Fraction, ...]) -> Fraction:
        return sum((a * b for a, b in zip(row, column, strict=True)), Fraction(0))

    return tuple(tuple(along(row, column) for column in columns) for row in left)


def table(matrices: Sequence[Matrix]) -> FloatArray:
    """Matrices rounded to float64, one behind the other, smaller ones filled up with zeros."""
    rows = max(len(m) for m in matrices)
    columns = max(len(m[0]) for m in matrices)
    out = np.zeros((len(matrices), rows, columns))
    for i, matrix in enumerate(matrices):
        out[i, : len(matrix), : len(matrix[0])] = [[float(c) for c in row] for row in matrix]
    return out


def _check(rows: int, first: int, count: int) -> None:
    if first < 0 or count < 1 or first + count > rows:
        raise ValueError(f"No update of {count} intervals from {first} lies in {rows} intervals.")


def _lagrange(nodes: Sequence[Fraction]) -> list[_Polynomial]:
    """Polynomials, lowest power first, that are 1 at one node each and 0 at the others."""
    whole: _Polynomial = [Fraction(1)]
    for node in nodes:
        raised = [Fraction(0), *whole]
        lowered = [*whole, Fraction(0)]
        whole = [a - node * b for a, b in zip(raised, lowered, strict=True)]
    basis = []
    for node in nodes:
        # whole / (tau - node) by Horner's scheme, and its value at the node
        quotient = [Fraction(0)] * (len(whole) - 1)
        carry = Fraction(0)
        for k in range(len(whole) - 1, 0, -1):
            carry = whole[k] + node * carry
            quotient[k - 1] = carry
        value = Fraction(0)
        for c in reversed(quotient):
            value = value * node + c
        basis.append([c / value for c in quotient])
    return basis


def _derivative(polynomial: _Polynomial) -> _Polynomial:
    return [k * c for k, c in enumerate(polynomial)][1:]
