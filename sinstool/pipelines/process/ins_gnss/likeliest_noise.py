"""The likeliest noise of an IMU, by the errors of its navigation in several runs.

A run takes a thousand times as long as everything else here, so few are made: the variance of an
error is a sum of parts, each proportional to the square of one factor, and four runs give these
parts. They predict the likelihood of all factors, and runs are repeated where it is highest.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sinstool.core.arrays import FloatArray

# Squares of unit normals hardly ever exceed this.
MOST_SQUARE = 50.0
# Prior of a factor: standard deviation of its logarithm; the mean of its square is 1.
PRIOR_SIGMA = 1.0
# Range of the factors on gyros, accelerometers and scale factors, as powers of 2; the search begins
# at the maximum of the prior.
LEAST_POWERS, MOST_POWERS = np.full(3, -4), np.full(3, 3)
FIRST_POWERS = np.full(3, -1)
AXES = np.eye(3, dtype=int)
# Most repetitions about the likeliest factors; least predicted variance, over that of a run.
ROUNDS, LEAST_VARIANCE = 5, 1e-3

Errors = Callable[[float, float, float], tuple[FloatArray, FloatArray]]


def cost(error: FloatArray, sigma: FloatArray) -> float:
    """-2 log likelihood of errors as if they were independent, without those that are NaN."""
    square = np.minimum((error / sigma) ** 2, MOST_SQUARE)
    return float(np.nansum(square + 2.0 * np.log(sigma)))


def likeliest(
    errors: Errors, weight: float, guess: FloatArray | None = None
) -> tuple[float, float, float]:
    """Root mean squares of the factors under their posterior.

    Parameters
    ----------
    errors : callable
        Takes the factors on gyros, accelerometers and scale factors, and returns errors and sigmas,
        always of the same shape.
    weight : float
        Of each error, less than 1 as errors of a window are correlated.
    guess : ndarray, shape (2,), optional
        Factors on gyros and accelerometers, above 0, at which the search begins: near the likeliest
        ones this saves half of the runs.
    """
    runs: dict[tuple[int, ...], tuple[FloatArray, FloatArray]] = {}

    def run(powers: np.ndarray) -> tuple[FloatArray, FloatArray]:
        at = tuple(powers.tolist())
        if at not in runs:
            runs[at] = errors(*(2.0**powers).tolist())
        return runs[at]

    def total(powers: np.ndarray) -> float:
        return weight * cost(*run(powers)) + _prior(powers)

    def about(powers: np.ndarray, ways: tuple[int, ...]) -> Callable[[np.ndarray], float]:
        near = _Near(run, powers, ways)
        return lambda at: weight * near.cost(at) + _prior(at)

    best: np.ndarray = FIRST_POWERS.copy()
    if guess is not None:
        powers = np.round(np.log2(guess)).astype(int)
        best[:2] = np.clip(powers, LEAST_POWERS[:2] + 1, MOST_POWERS[:2] - 1)
    ways: tuple[int, ...] = (1,)
    for _ in range(ROUNDS):
        near = about(best, ways)
        steps = [best + way * axis for axis in AXES for way in ways]
        nearest = min(steps, key=total)
        for ahead in (_lowest(near), nearest):
            ahead = np.clip(ahead, LEAST_POWERS + 1, MOST_POWERS - 1)
            if total(ahead) < total(best):
                best, ways = ahead, (1, -1)
                break
        else:
            if len(ways) > 1:
                break
            ways = (1, -1)
    gyro, accel, scale = _mean(about(best, (1, -1)), best).tolist()
    return gyro, accel, scale


def _prior(powers: np.ndarray) -> float:
    """-2 log of the prior density, less a constant."""
    return float(np.sum(((np.log(2.0) * powers + PRIOR_SIGMA**2) / PRIOR_SIGMA) ** 2))


class _Near:
    """Errors and variances predicted about some powers, from runs there and a step away.

    Parameters
    ----------
    ways : tuple of int
        Signs of the steps along each axis for which there are runs.
    """

    def __init__(
        self,
        run: Callable[[np.ndarray], tuple[FloatArray, FloatArray]],
        powers: np.ndarray,
        ways: tuple[int, ...],
    ) -> None:
        self._powers = powers
        self._error, sigma = run(powers)
        self._variance = sigma**2
        # Changes of errors and variances, by axis and sign of the step
        self._changes: list[dict[int, tuple[FloatArray, FloatArray]]] = []
        for axis in AXES:
            here = {}
            for way in ways:
                error, sigma = run(powers + way * axis)
                here[way] = error - self._error, sigma**2 - self._variance
            self._changes.append(here)

    def cost(self, powers: np.ndarray) -> float:
        """-2 log likelihood, with the changes along the axes added.

        Variances change with the squares of the factors; errors as much as with one step.
        """
        error, variance = self._error.copy(), self._variance.copy()
        for away, here in zip((powers - self._powers).tolist(), self._changes, strict=True):
            if away:
                sign = 1 if away > 0 else -1
                way = sign if sign in here else -sign
                of_error, of_variance = here[way]
                error += sign * way * of_error
                variance += (4.0**away - 1.0) / (4.0**way - 1.0) * of_variance
        return cost(error, np.sqrt(np.maximum(variance, LEAST_VARIANCE * self._variance)))


def _lowest(total: Callable[[np.ndarray], float]) -> np.ndarray:
    """Powers at which a function is lowest, by steps along the axes."""
    best = np.zeros(len(AXES), int)
    for step in (2, 1):
        before = None
        # Once around in steps of 2, then in steps of 1 until none leads lower
        while before is None or (step == 1 and (best != before).any()):
            before = best
            for way in step * AXES:
                best = _along(total, _along(total, best, way), -way)
    return best


def _along(total: Callable[[np.ndarray], float], powers: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Powers after steps of one direction, up to the last that leads lower within bounds."""
    while True:
        ahead = np.clip(powers + way, LEAST_POWERS, MOST_POWERS)
        if not total(ahead) < total(powers):
            return powers
        powers = ahead


def _mean(total: Callable[[np.ndarray], float], middle: np.ndarray) -> FloatArray:
    """Root mean squares of the factors under a posterior, from -2 its log about some powers."""
    # By a paraboloid through the points
    ahead, behind = ([total(middle + sign * axis) for axis in AXES] for sign in (1, -1))
    slope = 0.5 * np.subtract(ahead, behind)
    bend = np.diag(np.add(ahead, behind) - 2.0 * total(middle))
    for i, j in zip(*np.triu_indices(len(AXES), 1), strict=True):
        both = total(middle + AXES[i] + AXES[j]) + total(middle - AXES[i] - AXES[j])
        apart = total(middle + AXES[i] - AXES[j]) + total(middle - AXES[i] + AXES[j])
        bend[i, j] = bend[j, i] = 0.25 * (both - apart)
    # The curvature is at least that of the prior: the drift adds information, if anything
    values, vectors = np.linalg.eigh(bend)
    values = np.maximum(values, 2.0 * (np.log(2.0) / PRIOR_SIGMA) ** 2)
    inverse = (vectors / values) @ vectors.T
    powers = middle + np.clip(-inverse @ slope, -1.0, 1.0)
    # Root mean square of a log-normal factor
    powers = powers + 2.0 * np.log(2.0) * np.diag(inverse)
    return np.asarray(2.0 ** np.clip(powers, LEAST_POWERS, MOST_POWERS))
