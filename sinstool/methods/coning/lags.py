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

import numba
import numpy as np
from numpy.typing import NDArray

from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.coning.coefficients import lag_coefficients

FloatArray = NDArray[np.float64]


class LagAlgorithm(ConingAlgorithm):
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


@numba.njit(cache=True, nogil=True)
def lag_kernel(
    x: FloatArray, first: int, samples: int, weights: FloatArray, out: FloatArray
) -> None:
    """Updates of `samples` increments; row h of `weights` is for h earlier ones."""
    most = weights.shape[0] - 1
    for update in range(out.shape[0]):
        start = first + update * samples
        last = start + samples - 1
        history = min(start, most)
        sx = x[start, 0]
        sy = x[start, 1]
        sz = x[start, 2]
        for row in range(start + 1, last + 1):
            sx += x[row, 0]
            sy += x[row, 1]
            sz += x[row, 2]
        ax = 0.0
        ay = 0.0
        az = 0.0
        for lag in range(1, samples + history):
            weight = weights[history, lag - 1]
            ax += weight * x[last - lag, 0]
            ay += weight * x[last - lag, 1]
            az += weight * x[last - lag, 2]
        bx = x[last, 0]
        by = x[last, 1]
        bz = x[last, 2]
        out[update, 0] = sx + (ay * bz - az * by)
        out[update, 1] = sy + (az * bx - ax * bz)
        out[update, 2] = sz + (ax * by - ay * bx)
