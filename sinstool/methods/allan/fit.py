"""Noise terms behind Allan variances: maximum likelihood, with intervals and with bounds.

Short averaging times come in as overlapping Allan variances an octave apart, Gaussian with their
own covariance. Long ones, of which there are few and skewed, come in as what makes them up: second
differences of phases that are a block apart, whose likelihood is exact.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from math import sqrt

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.methods.allan.deviation import Variances
from sinstool.methods.allan.likelihood import ROUNDS, Likelihood, NoiseFit, NoiseModel, Term
from sinstool.methods.allan.model import (
    LEAST_BLOCKS,
    TERMS,
    BlockModel,
    allan_terms,
    block_model,
    covariance_of_variances,
    sine_transform,
)


class NoiseData:
    """Data shared by axes that were sampled together, for the fit of each axis.

    Parameters
    ----------
    variances : Variances
        With the powers of two up to half a block among its lags.
    lengths : sequence of int
        Samples of each segment.
    phases : sequence of ndarray, shape (n_i, c)
        Phases of each segment, a block apart.
    block : int
        Samples of a block.
    shortest : int, optional
        The shortest averaging time of the fit, in samples.
    """

    def __init__(
        self,
        variances: Variances,
        lengths: Sequence[int],
        phases: Sequence[FloatArray],
        block: int,
        shortest: int = 1,
    ) -> None:
        self._parts = variances, lengths, phases, block
        self._coarser: dict[int, NoiseData] = {}
        octaves = [1 << k for k in range(block.bit_length() - 1) if 1 << k >= shortest]
        at = np.flatnonzero(np.isin(variances.lags, octaves))
        lags = variances.lags[at]
        self.allan: FloatArray = variances.allan[at]
        differences = [np.diff(p, 2, axis=0) for p in phases if len(p) > 2]
        columns = variances.allan.shape[1]
        self.coefficients = np.concatenate(
            [sine_transform(d) for d in differences] or [np.empty((0, columns))]
        )
        models = {n: block_model(n, block) for n in Counter(map(len, differences))}
        parts = [models[len(d)] for d in differences]
        blocks = BlockModel(
            np.concatenate([m.variance for m in parts] or [np.empty((0, 4))]),
            np.concatenate([m.ramp for m in parts] or [np.empty(0)]),
        )
        covariance = covariance_of_variances(lags, lengths)
        self.model = NoiseModel(
            lags, variances.lags, allan_terms(lags), covariance, blocks, block, shortest > 1
        )

    def fit(self, column: int, step: float = 0.0) -> NoiseFit | None:
        """Fit the terms to one column.

        Counts of an angle that grows evenly beat with the samples, and what rounds them is no noise
        until the white noise has moved the angle by a count. Shorter averaging times are left out.

        Parameters
        ----------
        step : float, optional
            The least step from one value to another: a count.

        Returns
        -------
        NoiseFit or None
            None where it has no noise at all, or too few samples.
        """
        fit = self._fit(column)
        while fit is not None and step > 0.0:
            white, lag = float(fit.variances[TERMS.index("white")]), fit.from_lag
            if white * lag >= step**2:
                return fit
            # What white noise seems to be where it hardly shows is too much
            longer = self._from(2 << (lag.bit_length() - 1))._fit(column)
            if longer is None:
                hidden = max(fit.terms["white"].high, step / sqrt(lag))
                return replace(fit, terms=fit.terms | {"white": Term(None, 0.0, hidden)})
            fit = longer
        return fit

    def _from(self, shortest: int) -> NoiseData:
        """The same data, from an averaging time on, a power of two."""
        if shortest not in self._coarser:
            variances, lengths, phases, block = self._parts
            every = max(shortest // block, 1)
            self._coarser[shortest] = NoiseData(
                variances, lengths, [p[::every] for p in phases], block * every, shortest
            )
        return self._coarser[shortest]

    def _fit(self, column: int) -> NoiseFit | None:
        z, y = self.coefficients[:, column], self.allan[:, column]
        if len(z) < LEAST_BLOCKS - 2 or not np.all(y > 0.0) or not np.any(z):
            return None
        return Likelihood(self.model, z, y).fit()

    def gain(self, column: int, curve: Sequence[FloatArray]) -> float:
        """Decrease of the deviance when a multiple of a curve is removed from the data.

        Parameters
        ----------
        curve : sequence of ndarray, shape (n_i,)
            Its phases in each segment, a block apart.
        """
        z, y = self.coefficients[:, column], self.allan[:, column]
        shape = np.concatenate(
            [sine_transform(np.diff(c, 2)[:, None])[:, 0] for c in curve if len(c) > 2]
        )
        whole = Likelihood(self.model, z, y)
        p = whole.settle()
        before, v = whole.deviance(p), self.model.blocks.variance
        for _ in range(ROUNDS):
            weight = shape / (v @ p)
            without = z - shape * float(weight @ z) / float(weight @ shape)
            p, after = whole.again(without, p)
        return before - after
