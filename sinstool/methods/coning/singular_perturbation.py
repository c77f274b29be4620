"""Coning compensation by singular perturbation: two rates and a boundary layer.

Between two samples the rate is modelled as ``a exp(-t/epsilon) - b t + c`` (eq. 10 of
[1]_) with ``b = beta``, ``c = beta T + w2``, ``a = w1 - c``: a slow part and a boundary
layer of duration epsilon. Its integral and the integral of ``alpha x omega / 2`` are the
rotation vector. The four variants differ only in the three numbers A, K1 and K2 of

    phi = A a - b T**2 / 2 + c T + (K1 a x b + K2 c x a + T**3 / 6 b x c) / 2 :

=========== ============= ============================== ========================
variant     A             K1                             K2
=========== ============= ============================== ========================
printed     epsilon       2 epsilon**3 + epsilon T**2/2  2 epsilon**3 - epsilon T
truncated   epsilon       2 epsilon**3 - epsilon T**2/2  2 epsilon**2 - epsilon T
exact       T g0          T**3 g1                        T**2 g2
bvp         T (1 - L) / 2 T**3 (h1 - 1/6)                T**2 h2
=========== ============= ============================== ========================

``printed`` is eq. 11 of the paper as printed: one sign and one power in it are wrong, so that it
depends on the unit of time (seconds here). ``truncated`` corrects both and
drops ``exp(-T/epsilon)`` as the paper does; ``exact`` keeps it; ``bvp`` solves eq. 3 for
both of its boundary values, where the paper's boundary layer misses the second one.

With ``beta = n (w1 - w2) / T`` (eq. 14) every variant is ``p w1 + (T - p) w2 + kappa w1 x w2``.
Of the last three variants none with 0 <= n <= 1 does better in coning than no compensation
at all; the preset ``best`` (n = 2) does.

With ``x = T / epsilon`` and ``E = exp(-x)`` the exact integrals of the rate model are

    g0 = (1 - E) / x
    g1 = -1/(2x) - E/(2x) - 2E/x**2 + 2(1 - E)/x**3
    g2 = 2(1 - E)/x**2 - (1 + E)/x

and those of the two-point solution of eq. 3

    L  = coth(x/2) - 2/x = -g2/g0,     h1 = (g1 + 1/6)/(1 - E),     h2 = -L/x.

As written they lose all digits for small x (g2 is off by 7 % at x = 1e-5); below x = 1 their
power series are summed instead, in functions that take x >= 0 and numbers only.

References
----------
.. [1] L. Fu, Z. Luo, "A singular perturbation-based algorithm for compensation of
   pseudo-coning error for strapdown inertial navigation" (in Chinese), 2011.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import factorial, isfinite
from typing import Literal, cast

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.errors import ConfigurationError
from sinstool.core.parts import njit
from sinstool.core.quaternion_kernels import cross, row
from sinstool.methods.coning.algorithm import ConingAlgorithm

Variant = Literal["exact", "bvp", "truncated", "printed"]

VARIANTS = ("exact", "bvp", "truncated", "printed")
_EXACT, _BVP, _TRUNCATED, _PRINTED = range(4)

# name: (epsilon, is it in units of T, n of eq. 14). "paper" is section 4 of [1]; the sign
# of its beta is ambiguous there and that of eq. 14 is taken. "best" has the coning error
# of fourth order that two rates can have, and weighs both rates alike.
PRESETS = {"best": (0.5, True, 2.0), "paper": (2e-4, False, 0.001)}


class SingularPerturbation(ConingAlgorithm):
    """The singular-perturbation algorithm, one update per interval of point rates.

    Parameters
    ----------
    variant : {"exact", "bvp", "truncated", "printed"}, optional
        By default ``truncated`` with a preset, for which both presets were chosen, and
        ``exact`` with an explicit `epsilon`.
    preset : {"best", "paper"}, optional
        ``best`` (epsilon = T/2, n = 2) unless `epsilon` is given; ``paper`` (2e-4 s,
        n = 0.001).
    epsilon : float, optional
        Duration of the boundary layer, s; needs `beta_gain` or `beta`.
    beta_gain : float, optional
        n of eq. 14: beta follows each pair of rates.
    beta : sequence of 3 float, optional
        One constant beta, rad/s^2. It acts as a rate bias ``(T/2 - A) beta``.

    Raises
    ------
    ConfigurationError
        If options are unknown, contradict each other or have impossible values.
    """

    takes = "rates"
    before = 1
    name = "singular-perturbation"
    summary = "two point rates with a boundary layer between them"
    source = "Fu and Luo 2011, eqs. 3, 9-12, 14"

    def __init__(
        self,
        *,
        variant: str | None = None,
        preset: str | None = None,
        epsilon: float | None = None,
        beta_gain: float | None = None,
        beta: Sequence[float] | None = None,
    ) -> None:
        self.relative = False
        if epsilon is None:
            if beta_gain is not None or beta is not None:
                raise ConfigurationError(
                    "singular-perturbation got beta without epsilon", "give epsilon in seconds too"
                )
            preset = preset or "best"
            if preset not in PRESETS:
                raise ConfigurationError(
                    f"unknown singular-perturbation preset {preset!r}",
                    f"give one of {', '.join(PRESETS)}",
                )
            epsilon, self.relative, beta_gain = PRESETS[preset]
            variant = variant or "truncated"
        elif preset is not None:
            raise ConfigurationError(
                f"singular-perturbation got preset {preset!r} and epsilon", "give one of them"
            )
        elif (beta_gain is None) == (beta is None):
            raise ConfigurationError(
                "singular-perturbation with epsilon needs either a beta gain or a beta",
                "give exactly one of them",
            )
        variant = variant or "exact"
        if variant not in VARIANTS:
            raise ConfigurationError(
                f"unknown singular-perturbation variant {variant!r}",
                f"give one of {', '.join(VARIANTS)}",
            )
        vector = None if beta is None else tuple(float(value) for value in beta)
        if vector is not None and len(vector) != 3:
            raise ConfigurationError(
                f"singular-perturbation beta has {len(vector)} components", "give three, rad/s^2"
            )
        if not isfinite(epsilon) or epsilon < 0.0:
            raise ConfigurationError(
                f"singular-perturbation epsilon is {epsilon}",
                "give a duration of 0 s or more",
            )
        if not all(isfinite(value) for value in vector or (cast(float, beta_gain),)):
            raise ConfigurationError("singular-perturbation beta is not finite", "give numbers")
        self.variant = cast(Variant, variant)
        self.epsilon = float(epsilon)
        self.beta_gain = None if beta_gain is None else float(beta_gain)
        self.beta = vector

    def _fill(self, x: FloatArray, dt: FloatArray, first: int, out: FloatArray) -> None:
        code = VARIANTS.index(self.variant)
        if self.beta_gain is not None:
            _gain_kernel(x, dt, first, code, self.epsilon, self.relative, self.beta_gain, out)
        elif self.beta is not None:
            _vector_kernel(x, dt, first, code, self.epsilon, self.relative, *self.beta, out)

    def two_rate_form(self, interval: float) -> tuple[float, float]:
        """Weights of ``phi = p w1 + (T - p) w2 + kappa w1 x w2``, to which eq. 14 leads.

        Parameters
        ----------
        interval : float
            T, s.

        Returns
        -------
        p : float
            s.
        kappa : float
            s^2. The drift in coning depends on ``Q = 2 kappa / T**2 - p/T (1 - p/T)`` only: 0 is
            no compensation, 1/12 the optimum.

        Raises
        ------
        ValueError
            If beta is a constant vector: there is no such form then.
        """
        if self.beta_gain is None:
            raise ValueError("A constant beta has no two-rate form.")
        p, kappa = _two_rate_form(
            VARIANTS.index(self.variant), interval, self._epsilon(interval), self.beta_gain
        )
        return float(p), float(kappa)

    def _epsilon(self, interval: float) -> float:
        return self.epsilon * interval if self.relative else self.epsilon


@njit(cache=True, nogil=True)
def _model(variant: int, t: float, epsilon: float) -> tuple[float, float, float]:
    """Return A, K1 and K2 of the module's table for one interval."""
    if variant == _PRINTED:
        cube = 2.0 * epsilon * epsilon * epsilon
        return epsilon, cube + 0.5 * epsilon * t * t, cube - epsilon * t
    if variant == _TRUNCATED:
        return (
            epsilon,
            epsilon * (2.0 * epsilon * epsilon - 0.5 * t * t),
            epsilon * (2.0 * epsilon - t),
        )
    if epsilon == 0.0:  # no boundary layer: x is infinite and every kernel at its limit
        return 0.0, 0.0, 0.0
    x = t / epsilon
    if variant == _EXACT:
        return t * g0(x), t * t * t * g1(x), t * t * g2(x)
    return 0.5 * t * (1.0 - langevin(x)), t * t * t * (h1(x) - 1.0 / 6.0), t * t * h2(x)


@njit(cache=True, nogil=True)
def _two_rate_form(variant: int, t: float, epsilon: float, n: float) -> tuple[float, float]:
    """Return p and kappa under eq. 14: a x b = 0, c x a = -(1-n) w1 x w2, b x c = n/T w1 x w2."""
    a, _, k2 = _model(variant, t, epsilon)
    m = 1.0 - n
    return m * a + 0.5 * n * t, 0.5 * (n * t * t / 6.0 - m * k2)


@njit(cache=True, nogil=True)
def _gain_kernel(
    x: FloatArray,
    dt: FloatArray,
    first: int,
    variant: int,
    epsilon: float,
    relative: bool,
    n: float,
    out: FloatArray,
) -> None:
    computed = -1.0  # the interval that p and kappa belong to: most are equal
    p = 0.0
    kappa = 0.0
    for update in range(out.shape[0]):
        k = first + update
        t = dt[k]
        if t != computed:
            p, kappa = _two_rate_form(variant, t, epsilon * t if relative else epsilon, n)
            computed = t
        ux, uy, uz = row(x, k - 1)
        vx, vy, vz = row(x, k)
        cx, cy, cz = cross(ux, uy, uz, vx, vy, vz)
        rest = t - p
        out[update, 0] = p * ux + rest * vx + kappa * cx
        out[update, 1] = p * uy + rest * vy + kappa * cy
        out[update, 2] = p * uz + rest * vz + kappa * cz


@njit(cache=True, nogil=True)
def _vector_kernel(
    x: FloatArray,
    dt: FloatArray,
    first: int,
    variant: int,
    epsilon: float,
    relative: bool,
    bx: float,
    by: float,
    bz: float,
    out: FloatArray,
) -> None:
    computed = -1.0
    weight = 0.0
    k1 = 0.0
    k2 = 0.0
    for update in range(out.shape[0]):
        k = first + update
        t = dt[k]
        if t != computed:
            weight, k1, k2 = _model(variant, t, epsilon * t if relative else epsilon)
            computed = t
        cx, cy, cz = bx * t + x[k, 0], by * t + x[k, 1], bz * t + x[k, 2]
        ax, ay, az = x[k - 1, 0] - cx, x[k - 1, 1] - cy, x[k - 1, 2] - cz
        ux, uy, uz = cross(ax, ay, az, bx, by, bz)
        vx, vy, vz = cross(cx, cy, cz, ax, ay, az)
        wx, wy, wz = cross(bx, by, bz, cx, cy, cz)
        k3 = t * t * t / 6.0
        half = 0.5 * t * t
        out[update, 0] = weight * ax - half * bx + t * cx + 0.5 * (k1 * ux + k2 * vx + k3 * wx)
        out[update, 1] = weight * ay - half * by + t * cy + 0.5 * (k1 * uy + k2 * vy + k3 * wy)
        out[update, 2] = weight * az - half * bz + t * cz + 0.5 * (k1 * uz + k2 * vz + k3 * wz)


# The series are cut where their terms fall below 1e-19 of the first at x = 1.
_TERMS = 18

# (g1 + 1/6) / x**2 in powers of x: coefficients -(-1)**m (m-1)(m-4) / (2 m!), m = 5, 6, ..
_G1_SERIES = np.array(
    [-((-1) ** m) * (m - 1) * (m - 4) / (2 * factorial(m)) for m in range(5, 5 + _TERMS)]
)
# g2 / x in powers of x: coefficients (-1)**m (m-2) / m!, m = 3, 4, ..
_G2_SERIES = np.array([(-1) ** m * (m - 2) / factorial(m) for m in range(3, 3 + _TERMS)])


@njit(cache=True, nogil=True)
def _series(coefficients: FloatArray, x: float) -> float:
    """Sum of a power series for x < 1, the highest power first."""
    total = 0.0
    for i in range(_TERMS - 1, -1, -1):
        total = total * x + coefficients[i]
    return total


@njit(cache=True, nogil=True)
def g0(x: float) -> float:
    """Integral of the boundary layer, in units of T: ``(1 - E) / x``."""
    if x == 0.0:
        return 1.0
    return -np.expm1(-x) / x


@njit(cache=True, nogil=True)
def g1(x: float) -> float:
    """Coning of the boundary layer with the slope, in units of T**3."""
    if x < 1.0:
        return x * x * _series(_G1_SERIES, x) - 1.0 / 6.0
    e = np.exp(-x)
    return (-0.5 * (1.0 + e) + (-2.0 * e - 2.0 * np.expm1(-x) / x) / x) / x


@njit(cache=True, nogil=True)
def g2(x: float) -> float:
    """Coning of the constant with the boundary layer, in units of T**2."""
    if x < 1.0:
        return x * _series(_G2_SERIES, x)
    return (-2.0 * np.expm1(-x) / x - (1.0 + np.exp(-x))) / x


@njit(cache=True, nogil=True)
def langevin(x: float) -> float:
    """Return ``L = coth(x/2) - 2/x``, the asymmetry of the two-point solution."""
    if x < 1.0:
        return -g2(x) / g0(x)
    return (1.0 + np.exp(-x)) / -np.expm1(-x) - 2.0 / x


@njit(cache=True, nogil=True)
def h1(x: float) -> float:
    """Coning of the two-point boundary layer with the slope, in units of T**3."""
    if x < 1.0:
        return x * _series(_G1_SERIES, x) / g0(x)
    return (g1(x) + 1.0 / 6.0) / -np.expm1(-x)


@njit(cache=True, nogil=True)
def h2(x: float) -> float:
    """Coning of the first rate with the two-point boundary layer, in units of T**2."""
    if x < 1.0:
        return _series(_G2_SERIES, x) / g0(x)
    return -langevin(x) / x
