"""QuatFIter: functional iteration of the attitude in Chebyshev polynomials.

The rate polynomial of an update that reproduces its N increments is written in Chebyshev
polynomials of ``tau`` in [-1, 1], and so is every iterate of

    q_(l+1) = 1 + 1/2 integral from -1 of q_l o omega d tau                              (1)

which needs no more than the rules for products and integrals of Chebyshev polynomials,

    2 T_i T_j = T_(i+j) + T_|i-j|,
    integral of T_k = T_(k+1) / (2 (k+1)) - T_(k-1) / (2 (k-1))     (k > 1).

The iteration is linear in q, so it is run on its increments ``d_l = q_l - q_(l-1)``: they
shrink like ``|phi/2|**l / l!``, and only the coefficients of each that still matter are kept.
The paper truncates every iterate at order N + 4 or N + 5 and iterates 12 to 15 times. For smooth
motion the result is the same to rounding. For noisy increments it is not (a product of three rates
of degree N - 1 has coefficients of order 3 N). Here the order and the number of iterations follow
from the data: nothing is lost, and in usual motion both are smaller.

References
----------
.. [1] Y. Wu, G. Yan, "Attitude reconstruction from inertial measurements: QuatFIter and its
   comparison with RodFIter", IEEE Trans. Aerospace and Electronic Systems 55(6), 2019,
   3629-3639.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import njit
from sinstool.core.quaternion_kernels import to_rotation_vector
from sinstool.methods.coning import polynomial
from sinstool.methods.coning.algorithm import ConingAlgorithm, MultiSampleAlgorithm
from sinstool.methods.coning.picard import check_samples, fit, times_vector

# Bounds that no real data reach: a whole turn needs 25 iterations.
_MOST_ITERATIONS = 64
_MOST_ORDER = 96


class QuatFIter(MultiSampleAlgorithm):
    """Functional iteration of the quaternion in Chebyshev polynomials.

    Parameters
    ----------
    samples : int
        Increments per update.
    before : int, optional
        Earlier increments through which the polynomial passes too, where they exist.
    name : str, optional
        By default ``quatfiter-N``.

    Raises
    ------
    ConfigurationError
        If there are no samples or too many.
    """

    source = "Wu and Yan 2019, QuatFIter; Chebyshev functional iteration"

    def __init__(self, samples: int, before: int = 0, name: str = "") -> None:
        check_samples("quatfiter", samples + before, 1)
        self.name = name or f"quatfiter-{samples}"
        self.summary = f"{samples} samples per update, Chebyshev functional iteration"
        self.samples = samples
        self.before = before
        self._fits = _chebyshev_fits(samples, before)

    def _fill(self, x: FloatArray, dt: FloatArray, first: int, out: FloatArray) -> None:
        _iteration_kernel(x, first, self.samples, self._fits, out)

    def _of_samples(self, samples: int) -> ConingAlgorithm:
        before = self.before + self.samples - samples  # the same degree
        return QuatFIter(samples, before, f"{self.name}[{samples}]")


def quatfiter(samples: int) -> QuatFIter:
    """Build ``quatfiter-N``.

    Parameters
    ----------
    samples : int
        N, from 2 to 10.

    Returns
    -------
    QuatFIter
        The algorithm.

    Raises
    ------
    ConfigurationError
        If N is out of range.
    """
    check_samples("quatfiter", samples, 2)
    return QuatFIter(samples)


@cache
def _chebyshev_fits(samples: int, before: int) -> FloatArray:
    """Increments to Chebyshev coefficients of the rate, by the number of earlier ones."""
    return polynomial.table(
        [
            polynomial.product(
                polynomial.chebyshev(h + samples),
                polynomial.through_increments(h + samples, h, samples),
            )
            for h in range(before + 1)
        ]
    )


@njit(cache=True, nogil=True)
def _iteration_kernel(
    x: FloatArray, first: int, samples: int, fits: FloatArray, out: FloatArray
) -> None:
    most = fits.shape[0] - 1
    width = fits.shape[1]
    quarter = np.empty((width, 3))
    d = np.empty((_MOST_ORDER + 1, 4))
    rate = np.zeros((_MOST_ORDER + width + 3, 4))
    for update in range(out.shape[0]):
        start = first + update * samples
        history = min(start, most)
        terms = history + samples
        # 1/2 of the equation and 1/2 of the product of two Chebyshev polynomials
        size = fit(x, start - history, fits[history], terms, terms, 0.25, quarter)
        limit = 1e-17 * size
        # the integral of the rate itself, then the integrals of its products
        for k in range(terms):
            rate[k, 0] = 0.0
            for i in range(3):
                rate[k, 1 + i] = 2.0 * quarter[k, i]
        length = _integrate(rate, terms, limit, d)
        qw, qx, qy, qz = 1.0, 0.0, 0.0, 0.0
        for _ in range(_MOST_ITERATIONS):
            for k in range(length):  # every T_k is 1 at tau = 1
                qw += d[k, 0]
                qx += d[k, 1]
                qy += d[k, 2]
                qz += d[k, 3]
            if length == 0:
                break
            _multiply(d, length, quarter, terms, rate)
            length = _integrate(rate, length + terms - 1, limit, d)
        to_rotation_vector(qw, qx, qy, qz, out, update)


@njit(cache=True, nogil=True)
def _multiply(
    d: FloatArray, length: int, quarter: FloatArray, terms: int, rate: FloatArray
) -> None:
    """Chebyshev coefficients of ``d o omega / 2``."""
    rate[: length + terms - 1] = 0.0
    for i in range(terms):
        for j in range(length):
            w, x, y, z = times_vector(d, j, quarter, i)
            high = i + j
            low = abs(i - j)
            rate[high, 0] += w
            rate[high, 1] += x
            rate[high, 2] += y
            rate[high, 3] += z
            rate[low, 0] += w
            rate[low, 1] += x
            rate[low, 2] += y
            rate[low, 3] += z


@njit(cache=True, nogil=True)
def _integrate(rate: FloatArray, length: int, limit: float, d: FloatArray) -> int:
    """Integrate `length` coefficients from -1 into `d`; return how many of them count."""
    order = min(length, _MOST_ORDER)
    for component in range(4):
        rate[length, component] = 0.0
        rate[length + 1, component] = 0.0
        rate[length + 2, component] = 0.0
        d[1, component] = rate[0, component] - 0.5 * rate[2, component]
        for k in range(2, order + 1):
            d[k, component] = (rate[k - 1, component] - rate[k + 1, component]) * (0.5 / k)
    while order > 0 and (
        abs(d[order, 0]) + abs(d[order, 1]) + abs(d[order, 2]) + abs(d[order, 3]) <= limit
    ):
        order -= 1
    if order == 0:
        return 0
    for component in range(4):
        at_start = 0.0  # T_k is (-1)**k at tau = -1
        sign = -1.0
        for k in range(1, order + 1):
            at_start += sign * d[k, component]
            sign = -sign
        d[0, component] = -at_start
    return order + 1
