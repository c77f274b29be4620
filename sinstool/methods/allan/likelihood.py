"""Likelihood of the noise terms behind one axis' data, and their intervals by it.

Intervals are of profile likelihood (Venzon and Moolgavkar 1988, Applied Statistics 37, 87), which
no term leaves below zero. A term counts as visible where the data denies its absence and where it
is a fair part of some Allan variance; of any other only an upper bound is given.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import isfinite, log, sqrt

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.methods.allan.model import TERMS, BlockModel, allan_terms
from sinstool.methods.allan.profile import between, chance_above, edge, least_squares

NAMES = (*TERMS, "ramp")
# Deviance of 95 % of one coefficient; and that which denies its absence: 1 in 10 000 by chance.
INTERVAL = 3.8415
SURE = 14.0
# Deviance up to which a random walk may hide in a ramp.
WALK_RISE = 1.0
# The least share of the Allan variance that a visible term has at some averaging time.
SHARE = 0.05
# A fit is rejected if its misfit has a smaller probability than this.
SELDOM = 1e-4
# Averaging times are left out while the misfit of the others has a smaller probability than this;
# that costs little where it is chance. Where any were left out, one more is, as it is not quite
# free of the cause.
DOUBTFUL = 3e-3
# Weight of the inner of two edges of an interval, by term, calibrated by simulated logs. A random
# walk that is just too small to be seen is taken for flicker noise by a fit without it.
INWARD = {"quantisation": 0.5, "white": 0.55, "flicker": 0.0, "random_walk": 0.0}
# Of flicker noise alone the frequencies of blocks are not quite independent: more deviance is due.
FLICKER_INTERVAL = 1.1
# Repetitions of a fit, each weighted by the one before.
ROUNDS = 3


@dataclass(frozen=True)
class Term:
    """One coefficient in the units of samples.

    Attributes
    ----------
    value : float or None
        Square root of the term's variance; None where it is not visible.
    low, high : float
        The 95 % interval; where it is not visible, 0 and a bound that the truth is below with
        97.5 %.
    """

    value: float | None
    low: float
    high: float


@dataclass(frozen=True)
class NoiseFit:
    """The terms of one axis in the units of samples.

    Attributes
    ----------
    terms : dict of str to Term
        By the names in `TERMS`, and ``ramp``, whose value is its size.
    variances : ndarray, shape (4,)
        The likeliest of all terms, visible or not.
    ramp : float
        The likeliest, with its sign.
    from_lag : int
        Shortest averaging time, in samples, from which on the terms describe the curve.
    misfit : float
        By how much more than the terms allow the data scatters about them, as a variance; 1 where
        they describe it. Intervals are widened by its root.
    """

    terms: dict[str, Term]
    variances: FloatArray
    ramp: float
    from_lag: int
    misfit: float


@dataclass(frozen=True)
class NoiseModel:
    """What each term of unit size adds to data that axes have in common: all but the data itself.

    Attributes
    ----------
    lags : ndarray of int, shape (n,)
        Averaging times of the Allan variances that are fitted, in samples.
    curve : ndarray of int
        All averaging times of the curve, in samples.
    design : ndarray, shape (n, 4)
        Allan variance of each term.
    covariance : ndarray, shape (n, n, 4, 4)
        Of the Allan variances, by pairs of terms.
    blocks : BlockModel
        Variances of the differences of phases that are a block apart.
    block : int
        Samples of a block.
    counted : bool
        Samples are counts, so that quantisation is in them.
    """

    lags: IntArray
    curve: IntArray
    design: FloatArray
    covariance: FloatArray
    blocks: BlockModel
    block: int
    counted: bool


class Likelihood:
    """Deviance of one column, in units in which its white noise is about 1.

    Parameters
    ----------
    z : ndarray, shape (m,)
        Its second differences of phases a block apart, by frequency.
    y : ndarray, shape (n,)
        Its Allan variances at the lags of the model.
    """

    def __init__(self, model: NoiseModel, z: FloatArray, y: FloatArray) -> None:
        self._model = model
        # The variance of white noise if all were white, as the blocks see it or the first lag
        white = model.blocks.variance[:, 1]
        self._unit = float(y[0]) if len(y) else float(np.mean(z**2 / white))
        self._z = z / sqrt(self._unit)
        self._y = y / self._unit
        self._v, self._m = model.blocks.variance, model.blocks.ramp
        self._first = 0
        self._weight = np.zeros((0, 0))
        self._scale = self._scales()

    def _scales(self) -> FloatArray:
        """Variances at which each term is about as much as all the data shows."""
        z2 = np.maximum(self._z**2, 1e-300)
        most = np.array([np.mean(z2 / v) for v in np.maximum(self._v, 1e-300).T])
        if len(self._y):
            most = np.maximum(most, np.max(self._y[:, None] / self._model.design, axis=0))
        return most

    def fit(self) -> NoiseFit:
        """The likeliest terms from the shortest lag on that they describe, and intervals."""
        count = len(self._y)
        p = self.settle()
        misfit, chance = self._misfit(p)
        while chance < DOUBTFUL and self._first < count - 2:
            self._first += 1
            p = self.settle()
            misfit, chance = self._misfit(p)
        if 0 < self._first < count - 2:
            self._first += 1
            p = self.settle()
            misfit, chance = self._misfit(p)
        if chance > SELDOM:
            misfit = 1.0
        there = [self._there(k, p, misfit) for k in range(len(TERMS))]
        terms = {name: self._term(k, p, misfit, there) for k, name in enumerate(TERMS)}
        terms["ramp"] = self._ramp_term(p, misfit)
        ramp = self._ramp_of(p)[0]
        from_lag = self._shortest()
        unit = sqrt(self._unit)
        return NoiseFit(
            {
                name: Term(None if t.value is None else t.value * unit, t.low * unit, t.high * unit)
                for name, t in terms.items()
            },
            p * self._unit,
            ramp * unit,
            from_lag,
            misfit,
        )

    def _shortest(self) -> int:
        """The shortest averaging time, in samples, that is fitted."""
        some = self._first < len(self._y)
        return int(self._model.lags[self._first]) if some else self._model.block

    def settle(self) -> FloatArray:
        """The likeliest terms, with the covariance that they themselves give the variances."""
        p = self._begin()
        for _ in range(ROUNDS):
            self._weigh(p)
            p = self._minimise(p)[0]
        self._weigh(p)
        return self._minimise(p)[0]

    def deviance(self, p: FloatArray) -> float:
        """Minus twice the logarithm of the likelihood."""
        return self._deviance(p)[0]

    def again(self, z: FloatArray, p: FloatArray) -> tuple[FloatArray, float]:
        """The likeliest terms, and their deviance, where blocks are others, in units of samples."""
        own, self._z = self._z, z / sqrt(self._unit)
        fit = self._minimise(p)
        self._z = own
        return fit

    def _begin(self) -> FloatArray:
        """Terms that follow the curve, each lag and each frequency by its share."""
        y = self._y[self._first :]
        parts = [self._model.design[self._first :] / y[:, None]] if len(y) else []
        edges = [0, *(1 << k for k in range(1, 20) if 1 << k < len(self._z)), len(self._z)]
        for a, b in pairwise(edges):
            parts.append(np.mean(self._v[a:b], axis=0)[None] / np.mean(self._z[a:b] ** 2))
        rows = np.concatenate(parts)
        return least_squares(rows)

    def _weigh(self, p: FloatArray) -> None:
        rows = slice(self._first, None)
        g = self._model.covariance[rows, rows]
        covariance = np.einsum("ijkl,k,l->ij", g, p, p)
        self._weight = np.linalg.pinv(covariance, hermitian=True) if len(g) else np.zeros((0, 0))

    def _ramp_of(self, p: FloatArray) -> tuple[float, float]:
        """The likeliest ramp and its weight, the inverse of its variance."""
        v = self._v @ p
        weight = float(np.sum(self._m**2 / v))
        return float(np.sum(self._m * self._z / v)) / weight, weight

    def _residual(self, p: FloatArray, ramp: float) -> FloatArray:
        lags = self._model.lags[self._first :].astype(np.float64)
        expected = self._model.design[self._first :] @ p + 0.5 * ramp**2 * lags**2
        return self._y[self._first :] - expected

    def _deviance(self, p: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Minus twice the logarithm of the likelihood, half its gradient, and the information.

        The ramp is the likeliest, and the likelihood the restricted one that then is due.
        """
        v = self._v @ p
        if not np.all(v > 0.0):
            return np.inf, np.zeros(4), np.eye(4)
        ramp, weight = self._ramp_of(p)
        off = self._z - ramp * self._m
        relative = self._v / v[:, None]
        square = off**2 / v
        value = float(np.sum(np.log(v) + square)) + log(weight)
        slope = 0.5 * relative.T @ (1.0 - square)
        information = 0.5 * relative.T @ relative
        slope -= 0.5 * relative.T @ (self._m**2 / v) / weight
        residual = self._residual(p, ramp)
        weighted = self._weight @ residual
        design = self._model.design[self._first :]
        value += float(residual @ weighted)
        slope -= design.T @ weighted
        information += design.T @ self._weight @ design
        return value, slope, information

    def _minimise(self, p: FloatArray, fixed: tuple[int, ...] = ()) -> tuple[FloatArray, float]:
        """Fisher scoring within p >= 0, some terms fixed as they are.

        A filter takes from the variance of white noise as quantisation adds, by the square of the
        averaging time: where the shortest ones are left out, that may be negative.

        Returns
        -------
        p : ndarray, shape (4,)
        deviance : float
        """
        scale = self._scale
        lowest = np.array([-np.inf if self._first else 0.0, 0.0, 0.0, 0.0])
        p = p.copy()
        value, slope, information = self._deviance(p)
        if not isfinite(value):
            p[1] = max(p[1], 1e-6 * scale[1])
            if 1 in fixed:
                p[2:] = np.maximum(p[2:], 1e-9 * scale[2:])
            value, slope, information = self._deviance(p)
        for _ in range(60):
            free = (p > lowest) | (slope < 0.0)
            free[list(fixed)] = False
            if not free.any():
                break
            # In units of their own sigmas: a random walk that hardly shows would hide all others
            unit = 1.0 / np.sqrt(np.diagonal(information)[free])
            matrix = information[np.ix_(free, free)] * np.outer(unit, unit)
            matrix[np.diag_indices(len(matrix))] *= 1.0 + 1e-9
            step = np.zeros(4)
            step[free] = -unit * np.linalg.lstsq(matrix, unit * slope[free], rcond=1e-14)[0]
            size, better = 1.0, False
            for _ in range(30):
                tried = np.maximum(p + size * step, lowest)
                new = self._deviance(tried)
                if new[0] < value:
                    better = True
                    break
                size *= 0.5
            if not better:
                break
            gained = value - new[0]
            p, (value, slope, information) = tried, new
            if gained < 1e-6:
                break
        return p, value

    def _misfit(self, p: FloatArray) -> tuple[float, float]:
        """Largest ratio of scatter to its expectation, and its chance if the terms are right."""
        ramp = self._ramp_of(p)[0]
        residual = self._residual(p, ramp)
        short = float(residual @ self._weight @ residual)
        square = (self._z - ramp * self._m) ** 2 / (self._v @ p)
        tests = [(short, max(len(residual) - 2, 1))]
        # Octaves of the blocks' frequencies, each as a whole
        edges = [0, *(1 << k for k in range(2, 20) if 1 << k < len(square)), len(square)]
        pairs = pairwise(edges)
        tests += [(float(square[a:b].sum()), b - a) for a, b in pairs]
        chance = min(chance_above(total, freedom) for total, freedom in tests)
        worst = max(total / freedom for total, freedom in tests)
        return max(worst, 1.0), min(len(tests) * chance, 1.0)

    def _there(self, k: int, p: FloatArray, misfit: float) -> bool:
        """Whether the data denies the absence of a term."""
        without = p.copy()
        without[k] = 0.0
        risen = self._minimise(without, (k,))[1] - self._minimise(p)[1]
        return risen > SURE * misfit

    def _term(self, k: int, p: FloatArray, misfit: float, there: list[bool]) -> Term:
        """A term's interval: between that with all others and that with those alone that are there.

        Others that cannot be negative move the likeliest value of this one where they are small,
        or nothing: the first interval alone then holds the truth too seldom, the second where they
        are just too small to be seen.
        """
        name = TERMS[k]
        target = INTERVAL * (FLICKER_INTERVAL if name == "flicker" else 1.0)
        high = self._edge(k, p, (), misfit, +1.0, target)
        if not (there[k] and self._share(k, p) > SHARE):
            return Term(None, 0.0, sqrt(max(high, 0.0)))
        low, value = self._edge(k, p, (), misfit, -1.0, target), float(p[k])
        # White noise is in every sensor, whether or not another term hides it, and so is
        # quantisation where a sensor counts, or filters
        always = TERMS[:2] if self._model.counted or self._first else ("white",)
        hidden = tuple(j for j, n in enumerate(TERMS) if not there[j] and n not in always)
        if hidden:
            alone = p.copy()
            alone[list(hidden)] = 0.0
            alone = self._minimise(alone, hidden)[0]
            inward = INWARD[name]
            high = between(high, self._edge(k, alone, hidden, misfit, +1.0, target), max, inward)
            low = between(low, self._edge(k, alone, hidden, misfit, -1.0, target), min, inward)
            # Nor is the value that without terms that are not visible, nor that with all of them
            value = min(max(value + inward * (float(alone[k]) - value), low), high)
        return Term(sqrt(value), sqrt(low), sqrt(high))

    def _edge(
        self,
        k: int,
        p: FloatArray,
        fixed: tuple[int, ...],
        misfit: float,
        side: float,
        target: float = INTERVAL,
    ) -> float:
        """Where the deviance of a term has risen by `target` above that of the likeliest terms.

        Parameters
        ----------
        p : ndarray, shape (4,)
            The likeliest, with those in `fixed` as they are.
        side : {-1.0, 1.0}
        """
        best = self._minimise(p, fixed)[1]

        def rise(value: float, start: FloatArray) -> tuple[float, FloatArray]:
            begin = start.copy()
            begin[k] = value
            fitted, deviance = self._minimise(begin, (k, *fixed))
            return (deviance - best) / misfit, fitted

        return edge(rise, p, float(p[k]), self._spread(k, p, fixed), side, sqrt(target))

    def _spread(self, k: int, p: FloatArray, fixed: tuple[int, ...]) -> float:
        """About the standard deviation of a term."""
        free = [j for j in range(len(TERMS)) if j not in fixed]
        information = self._deviance(p)[2][np.ix_(free, free)]
        unit = 1.0 / np.sqrt(np.diagonal(information))
        information = information * np.outer(unit, unit) + 1e-12 * np.eye(len(free))
        at = free.index(k)
        return float(unit[at] * sqrt(np.linalg.inv(information)[at, at]))

    def _share(self, k: int, p: FloatArray) -> float:
        """The largest share of a term in the Allan variance at the lags that are fitted."""
        lags = self._model.curve
        lags = lags[lags >= self._shortest()]
        parts = allan_terms(lags) * p
        return float(np.max(parts[:, k] / parts.sum(axis=1)))

    def _ramp_term(self, p: FloatArray, misfit: float) -> Term:
        """Interval of the ramp's size.

        A random walk of which little is known makes a ramp less certain than the likeliest one
        does, which often is none at all: it is taken at the upper edge of 1 sigma.
        """
        walk = TERMS.index("random_walk")
        less_sure = p.copy()
        less_sure[walk] = self._edge(walk, p, (), 1.0, +1.0, WALK_RISE)
        ramp, weight = self._ramp_of(self._minimise(less_sure, (walk,))[0])
        size, spread = abs(ramp), sqrt(misfit / weight)
        half = sqrt(INTERVAL) * spread
        if size < sqrt(SURE) * spread:
            return Term(None, 0.0, size + half)
        return Term(size, size - half, size + half)
