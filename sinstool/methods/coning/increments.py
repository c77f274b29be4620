"""Angular increments from point rates, and the other conversions between sample kinds.

A point rate is interpolated by the polynomial through `points` consecutive samples centred
on the interval, and that polynomial is integrated over the interval. At the ends of a
segment the same polynomial is used off its centre, so that the order stays the same; a
segment with fewer samples uses all it has.

On the number of points: with coning of 0.1 deg at 30 Hz, sampled at 400 Hz, ``previous-3`` drifts
by 2.2, 0.089, 4.2e-3 or 4.1e-4 deg/h with 2, 4, 6 or 8 points, and by 2.2e-4 deg/h with exact
increments; exact increments without any compensation drift by 2.2 deg/h. So 2 points, the
trapezoid, cancel the gain of any algorithm. More points cost noise, mostly at the ends: of the
power of white noise a centred stencil passes 0.50, 0.59, 0.63, 0.65, but the outermost one 0.50,
0.81, 1.53, 4.1. Hence the default of 6; 8 suits a quiet gyro that is sampled slowly.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache

import numpy as np

from sinstool.core.arrays import ArrayLike, FloatArray
from sinstool.core.parts import kernel
from sinstool.core.quaternion_kernels import put, weighted_sum
from sinstool.methods.coning.algorithm import GyroKind, Takes

GYRO_KINDS = ("rate", "mean-rate", "increment")
POINTS = (2, 4, 6, 8)
DEFAULT_POINTS = 6


def convert(samples: FloatArray, dt: FloatArray, gyro_kind: GyroKind, takes: Takes) -> FloatArray:
    """Convert gyro samples to an algorithm's input where no neighbouring samples are needed.

    Parameters
    ----------
    samples : ndarray, shape (n, 3)
        rad/s, or rad for increments.
    dt : ndarray, shape (n,)
        Interval that ends at each sample, s.
    gyro_kind : {"rate", "mean-rate", "increment"}
        What the samples are.
    takes : {"increments", "rates"}
        Input of the algorithm. The mean rate of an interval is used as the rate at its end.

    Returns
    -------
    ndarray, shape (n, 3)
        rad or rad/s.

    Raises
    ------
    ValueError
        For point rates where increments are needed: see :class:`RateIntegrator`.
    """
    if takes == "rates":
        return samples / dt[:, np.newaxis] if gyro_kind == "increment" else samples
    if gyro_kind == "rate":
        raise ValueError("Point rates have no increments of their own: integrate them.")
    return samples if gyro_kind == "increment" else samples * dt[:, np.newaxis]


@cache
def integration_stencils(points: int) -> tuple[tuple[Fraction, ...], ...]:
    """Weights that integrate the polynomial through equally spaced samples.

    Parameters
    ----------
    points : int
        Samples, at least 2.

    Returns
    -------
    tuple of tuple of Fraction
        Row ``i - 1``: weights, in units of the spacing, of the samples 0 .. points-1 for
        the integral from sample ``i - 1`` to sample ``i``. Exact.

    Raises
    ------
    ValueError
        If there are fewer than two samples.
    """
    if points < 2:
        raise ValueError(f"No interval lies between {points} samples.")
    rows = []
    basis = [_lagrange_integral(points, node) for node in range(points)]
    for end in range(1, points):
        rows.append(tuple(_value(b, end) - _value(b, end - 1) for b in basis))
    return tuple(rows)


def _lagrange_integral(points: int, node: int) -> list[Fraction]:
    """Coefficients of the integral of the polynomial that is 1 at `node`, 0 at the others."""
    polynomial = [Fraction(1)]
    for other in range(points):
        if other != node:
            scale = Fraction(1, node - other)
            raised = [Fraction(0), *polynomial]
            lowered = [*polynomial, Fraction(0)]
            polynomial = [scale * (a - other * b) for a, b in zip(raised, lowered, strict=True)]
    return [Fraction(0), *(c / (power + 1) for power, c in enumerate(polynomial))]


def _value(polynomial: list[Fraction], at: int) -> Fraction:
    return sum((c * at**power for power, c in enumerate(polynomial)), Fraction(0))


@cache
def _stencil_table(points: int) -> FloatArray:
    return np.array([[float(c) for c in row] for row in integration_stencils(points)])


class RateIntegrator:
    """Increments of intervals between point rates, with an algorithm's window contract.

    Parameters
    ----------
    points : int, optional
        Samples that the polynomial passes through: 2, 4, 6 or 8.

    Attributes
    ----------
    before, after : int
        Rows before and after an interval's own that are needed where they exist, as in
        :class:`~sinstool.methods.coning.algorithm.ConingAlgorithm`.

    Raises
    ------
    ValueError
        If `points` is none of these.
    """

    def __init__(self, points: int = DEFAULT_POINTS) -> None:
        if points not in POINTS:
            raise ValueError(f"Expected `points` to be one of {POINTS}, got {points}.")
        self.points = points
        # Off centre at the ends: the last interval reaches points-1 samples back from its
        # own, the first one points-2 ahead.
        self.before = points - 1
        self.after = points - 2

    def increments(self, rate: ArrayLike, dt: ArrayLike, first: int, count: int) -> FloatArray:
        """Integrate point rates over `count` consecutive intervals.

        Parameters
        ----------
        rate : array_like, shape (m, 3)
            Angular rates at the instants t[k], rad/s.
        dt : array_like, shape (m,)
            ``t[k] - t[k-1]``, s. The samples are taken to be equally spaced by the
            interval's own `dt`.
        first : int
            Row that ends the first interval, at least 1. Fewer than :attr:`before` rows
            before it mean that the segment starts with row 0.
        count : int
            Number of intervals. Fewer than :attr:`after` rows after them mean that the
            segment ends with the last row.

        Returns
        -------
        ndarray, shape (count, 3)
            rad.

        Raises
        ------
        ValueError
            If shapes do not fit or rows are missing.
        """
        rows = np.ascontiguousarray(rate, dtype=np.float64)
        intervals = np.ascontiguousarray(dt, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != 3 or intervals.shape != rows.shape[:1]:
            raise ValueError(
                f"Expected shapes (m, 3) and (m,), got {rows.shape} and {intervals.shape}."
            )
        if first < 1 or count < 0 or first + count > len(rows):
            raise ValueError(
                f"{count} intervals from row {first} do not fit into {len(rows)} rows."
            )
        out = np.empty((count, 3))
        if count:
            stencils = _stencil_table(min(self.points, len(rows)))
            _integrate_kernel(rows, intervals, first, stencils, out)
        return out


@kernel()
def _integrate_kernel(
    rate: FloatArray, dt: FloatArray, first: int, stencils: FloatArray, out: FloatArray
) -> None:
    points = stencils.shape[1]
    latest = rate.shape[0] - points
    for i in range(out.shape[0]):
        row = first + i
        start = min(max(row - points // 2, 0), latest)
        position = row - start - 1
        x, y, z = weighted_sum(rate, start, 1, stencils, position, points)
        put(out, i, x * dt[row], y * dt[row], z * dt[row])
