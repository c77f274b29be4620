"""Slow errors of fixes, estimated with an IMU that drifts less than they wander.

A receiver states the size of its errors, not their correlation; often it states their white part
only. Errors that last for minutes move the navigation with them, and single innovations hardly show
that. All innovations together do: they are most likely with the right size of the slow errors
(Schweppe 1965). Whether the fixes wander or the IMU drifts follows from the same likelihood, so
pairs of both are compared.

References
----------
.. [1] F. C. Schweppe, "Evaluation of likelihood functions for Gaussian signals", IEEE Trans.
   Information Theory 11(1), 1965, 61-70.
.. [2] H. Chernoff, "On the distribution of the likelihood ratio", Annals of Mathematical Statistics
   25(3), 1954, 573-578.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.methods.ins_gnss.states import GNSS_POSITION
from sinstool.methods.land_vehicle.shaking import Shaking
from sinstool.methods.strapdown.velocity import Increments
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.innovation_cost import (
    innovation_cost,
    innovations,
    mean_square,
)

# Factors on the sigmas are powers of STEP, up to MOST_STEPS.
STEP, MOST_STEPS = 2.0, 10
# By how much -2 log likelihood must fall before slow errors are enlarged: four sigmas of one
# parameter, as no model of an IMU is quite right. Larger errors that raise it by less than the
# second would not show.
LEAST_GAIN, NOT_SHOWN = 16.0, 4.0
# A filter whose squared innovations are more than so many times those expected diverges.
DIVERGES = 2.0
# By chance larger ones lower it by this in one log of 20: half of a chi-square of one degree, as
# slow errors are not less than none (Chernoff 1954).
BY_CHANCE = 2.7
LEAST_EPOCHS = 100
SLOW = "; slow errors"


def with_expected_slow_errors(start: FilterStart) -> FilterStart:
    """A start with the slow errors to expect where the log hardly shows how large they are.

    Parameters
    ----------
    start : FilterStart
        By :func:`with_slow_errors`.
    """
    level, vertical = start.expected_slow_errors
    if max(level, vertical) == 1.0:
        return start
    return _described(start.with_slow_position(level, vertical, ""), "", start.unseen_m)


def with_slow_errors(
    start: FilterStart,
    judged: FilterStart,
    increments: Increments | None,
    shaken: Shaking | None = None,
) -> FilterStart:
    """A start with slow errors of fixes as large as all innovations show them.

    Parameters
    ----------
    judged : FilterStart
        The same start, with the latency and lever arm to use for the innovations.
    increments : Increments or None
        From the start on, for some minutes.
    shaken : Shaking, optional
        Noise of an IMU that is shaken while its vehicle stands, so that it is not attributed to the
        fixes.

    Returns
    -------
    FilterStart
        Unchanged unless larger slow errors are clearly likelier.
    """
    if increments is None:
        return start
    if judged.settings.kind.first(GNSS_POSITION) < 0:
        # Without states for slow errors no size of them is likelier than another
        judged = replace(judged, settings=replace(judged.settings, filter="markov-27"))
    fits: dict[tuple[int, int], tuple[float, float]] = {}

    def cost(steps: tuple[int, int]) -> float:
        if steps not in fits:
            if not 0 <= min(steps) <= max(steps) <= MOST_STEPS:
                return np.inf
            fits[steps] = _fit(increments, _with(judged, steps), shaken)
        return fits[steps][0]

    def likelier(best: tuple[int, int]) -> tuple[int, int]:
        # Horizontal and vertical together first, then each by itself
        for way in ((1, 1), (0, 1), (0, -1), (1, 0), (-1, 0)):
            while cost(ahead := (best[0] + way[0], best[1] + way[1])) < cost(best):
                best = ahead
        return best

    if not np.isfinite(cost((0, 0))):
        return start
    best = likelier((0, 0))
    if fits[best][1] > DIVERGES:
        # The likelihood of a filter that diverges rises and falls by chance
        best = likelier(min(((n, n) for n in range(MOST_STEPS + 1)), key=cost))
    if cost(best) >= cost((0, 0)) - LEAST_GAIN:
        best = (0, 0)
    larger = [cost(best)]
    while larger[-1] < larger[0] + NOT_SHOWN:
        larger.append(cost((best[0] + len(larger), best[1] + len(larger))))
    made = _with(start, best)
    most = made.settings.gnss.position_markov[0] * STEP ** (len(larger) - 2)
    return replace(
        _described(made, ", by all innovations" * any(best), most if len(larger) > 2 else 0.0),
        expected_slow_errors=expected_factors(made, np.array(larger))
        if best == (0, 0)
        else (1.0, 1.0),
    )


def expected_factors(start: FilterStart, costs: FloatArray) -> tuple[float, float]:
    """Slow errors to expect over those of a start, horizontal and vertical.

    Parameters
    ----------
    costs : ndarray, shape (n,)
        -2 log likelihood with slow errors 1, `STEP`, `STEP`² ... times as large.

    Notes
    -----
    The root of the mean square under the posterior. A priori all these sizes are equally likely, up
    to the whole error that the receiver states. 1 unless larger ones are likelier than by chance.
    """
    model = start.settings.gnss
    slow, white = np.array(model.position_markov), np.array(model.position_white)
    times = STEP ** np.arange(float(len(costs)))[:, None]
    possible = times * slow <= np.hypot(slow, white)
    possible[0] = True
    # Where the filter diverges with all of these, a far larger size may be likelier by hundreds
    each = np.where(possible, costs[:, None], np.inf)
    if costs[0] < each.min() + BY_CHANCE:
        return 1.0, 1.0
    weight = np.exp(0.5 * (each.min(axis=0) - each))
    north, _, down = np.sqrt((weight * times**2).sum(axis=0) / weight.sum(axis=0)).tolist()
    return north, down


def _with(start: FilterStart, steps: tuple[int, int]) -> FilterStart:
    """A start with slow errors larger by steps, horizontal and vertical."""
    if not any(steps):
        return start
    level, vertical = (STEP**step for step in steps)
    times = start.slow_errors[0] * level, start.slow_errors[1] * vertical
    return replace(start.with_slow_position(level, vertical, ""), slow_errors=times)


def _described(start: FilterStart, how: str, unseen_m: float) -> FilterStart:
    """A start that says how large its slow errors are, and up to which size none would show."""
    north, _, down = start.settings.gnss.position_markov
    text = f"{start.gnss_why.split(SLOW)[0]}{SLOW} {north:.3g} m, in height {down:.3g} m{how}"
    if unseen_m:
        text += f" (slow errors up to {unseen_m:.2g} m would not show)"
    return replace(start, gnss_why=text, unseen_m=unseen_m)


def _fit(increments: Increments, start: FilterStart, shaken: Shaking | None) -> tuple[float, float]:
    """-2 log likelihood of the innovations, and their squares over those expected.

    Infinite with too few.
    """
    settings = replace(start.settings, network=None)
    stands = None if shaken is None else shaken.constraints(settings.imu)
    fixes = start.used_until(int(increments.time_ns[-1]))
    epochs = innovations(start.start, settings, increments, fixes, stands)
    return innovation_cost(epochs, LEAST_EPOCHS), mean_square(epochs)
