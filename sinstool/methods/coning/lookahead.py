"""Coning with later samples as well, which only a recorded log allows.

The polynomial through P consecutive values of the cumulative angle, centred on a sample interval,
is far more accurate there than one through earlier values only. So long updates are not needed:
every sample ends one. The interval is cut into eight sub-increments, the rate polynomial of degree
7 that reproduces them is integrated exactly (as :mod:`~sinstool.methods.coning.picard` does), and
the linear part of this is one constant matrix.

The sum of the sub-increments is the increment, so noise accumulates as without any correction.

At the ends of a segment the polynomial is used off its centre. With increments this affects the
small correction only. With point rates it affects the angle itself, and there the one-sided
polynomial through P rates multiplies the noise by ten. So the first and the last intervals take
P + 4 rates, with weights that

* integrate polynomials of degree 5 exactly,
* and, within that condition, have the least mean square error for all sinusoids up to 1/7 of the
  sampling rate, with noise of 3e-6 of the signal,

which leaves a smaller error than the polynomial and a quarter of its noise.

Like every sharp interpolation it assumes that the samples hold motion below half the sampling rate
only, which a log that was subsampled without a filter violates.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.errors import ConfigurationError
from sinstool.core.parts import njit
from sinstool.methods.coning import polynomial
from sinstool.methods.coning.algorithm import ConingAlgorithm, GyroKind
from sinstool.methods.coning.picard import fit, room_for, rotate_polynomial

PARTS = 8
TAPS = (4, 6, 8, 10, 12, 14, 16)

_EXTRA_RATES = 4
_EXACT_DEGREE = 5
_BAND = 0.9  # rad per sample
_NOISE = 3e-6


class Lookahead(ConingAlgorithm):
    """One update per sample from samples on both sides of it.

    Parameters
    ----------
    taps : int
        P, even: cumulative angles, or point rates, that the polynomial passes through.
    takes : {"increments", "rates"}, optional
        The form for increments and mean rates, or that for point rates.

    Raises
    ------
    ConfigurationError
        If `taps` is odd, too few or too many.
    """

    source = "polynomial through later samples too, sub-increments, Picard to convergence"

    def __init__(self, taps: int, takes: str = "increments") -> None:
        if taps not in TAPS:
            raise ConfigurationError(
                f"lookahead-{taps} cannot be centred on an interval"
                if taps % 2
                else f"lookahead-{taps} is not available",
                f"P in lookahead-P is one of {', '.join(map(str, TAPS))}",
            )
        self.name = f"lookahead-{taps}"
        self.summary = f"every sample, with {taps // 2} samples on either side"
        self.taps = taps
        if takes == "rates":
            self.takes = "rates"
            # row k is the end of interval k: off centre up to the last but one
            self._rows, self._most = taps, taps + _EXTRA_RATES
            self.before, self.after = self._most - 1, self._most - 2
        else:
            self._rows = self._most = taps - 1
            self.before = self.after = taps - 2
        centre = _fits(self.takes, self._rows)
        self._centre = centre[len(centre) // 2]

    def for_kind(self, gyro_kind: GyroKind) -> ConingAlgorithm:
        """See :meth:`ConingAlgorithm.for_kind`: point rates are interpolated as such."""
        takes = "rates" if gyro_kind == "rate" else "increments"
        return self if takes == self.takes else Lookahead(self.taps, takes)

    def _fill(self, x: FloatArray, dt: FloatArray, first: int, out: FloatArray) -> None:
        available = min(self._most, len(x))
        rates = self.takes == "rates"
        ends = _end_rates(available) if rates else _fits("increments", available)
        _kernel(x, dt, first, rates, self._centre, ends, out)


@cache
def _fits(takes: str, rows: int) -> FloatArray:
    """Samples to coefficients of the rate, for every interval that the rows contain."""
    if takes == "rates":
        fits = [polynomial.through_rates(rows, i) for i in range(rows - 1)]
    else:
        fits = [polynomial.through_increments(rows, i, 1) for i in range(rows)]
    if rows > PARTS:
        cut = polynomial.reduction(rows - 1, PARTS)
        fits = [polynomial.product(cut, one) for one in fits]
    return polynomial.table(fits)


@cache
def _end_rates(points: int) -> FloatArray:
    """Point rates to coefficients of the rate, where the stencil is off its centre.

    The weights minimise the mean over ``0 < l < _BAND`` of ``|error of exp(i l t)|**2`` plus
    ``_NOISE**2`` times the sum of their squares, among those that are exact for polynomials:
    the free part of the weights is in the null space of that condition.
    """
    edges = np.arange((points - 1) * PARTS + 1) / PARTS - 0.5 * (points - 1)
    nodes = np.arange(points) - 0.5 * (points - 1)

    # polynomials up to the exact degree, orthogonal enough in Legendre's form
    degree = min(_EXACT_DEGREE, points - 1)
    scale = 0.5 * (points - 1)
    values = np.polynomial.legendre.legvander(nodes / scale, degree)
    integrals = np.empty((degree + 1, len(edges) - 1))
    for k in range(degree + 1):
        primitive = np.polynomial.Legendre.basis(k).integ()
        integrals[k] = scale * np.diff(primitive(edges / scale))
    q, r = np.linalg.qr(values, mode="complete")
    weights = q[:, : degree + 1] @ np.linalg.solve(r[: degree + 1].T, integrals)

    free = q[:, degree + 1 :]
    if free.shape[1]:
        at, share = np.polynomial.legendre.leggauss(8 * points)
        turn = 0.5 * _BAND * (at + 1.0)[:, np.newaxis]
        share = np.sqrt(0.5 * share)[:, np.newaxis]
        response = np.concatenate([share * np.cos(turn * nodes), share * np.sin(turn * nodes)])
        target = np.concatenate(
            [
                share * np.diff(np.sin(turn * edges), axis=1) / turn,
                share * np.diff(-np.cos(turn * edges), axis=1) / turn,
            ]
        )
        system = np.concatenate([response @ free, _NOISE * free])
        right = np.concatenate([target - response @ weights, -_NOISE * weights])
        weights = weights + free @ np.linalg.lstsq(system, right, rcond=None)[0]

    to_rate = polynomial.table([polynomial.through_increments(PARTS, 0, PARTS)])[0]
    parts = weights.reshape(points, points - 1, PARTS)
    return np.ascontiguousarray(np.einsum("kp,jip->ikj", to_rate, parts))


@njit(cache=True, nogil=True)
def _kernel(
    x: FloatArray,
    dt: FloatArray,
    first: int,
    rates: bool,
    centre: FloatArray,
    ends: FloatArray,
    out: FloatArray,
) -> None:
    count = x.shape[0]
    rows = centre.shape[1]
    end_rows = ends.shape[2]
    terms = max(centre.shape[0], ends.shape[1])
    c = np.empty((terms, 3))
    room = room_for(terms)
    offset = 1 if rates else 0  # rate k is at the end of interval k
    for update in range(out.shape[0]):
        row = first + update
        scale = 0.5 * dt[row] if rates else 0.5
        start = row - rows // 2
        if start >= 0 and start + rows <= count:
            terms = centre.shape[0]
            size = fit(x, start, centre, terms, rows, scale, c)
        else:
            start = min(max(row - end_rows // 2, 0), count - end_rows)
            terms = ends.shape[1]
            size = fit(x, start, ends[row - start - offset], terms, end_rows, scale, c)
        rotate_polynomial(c, terms, size, room, out, update)
