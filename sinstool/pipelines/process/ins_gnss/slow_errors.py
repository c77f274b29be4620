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

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.methods.ins_gnss.states import GNSS_POSITION
from sinstool.methods.land_vehicle.shaking import Shaking
from sinstool.methods.sensor_errors import Triple
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
# Slow errors of positions last so long at most, s: beyond that they count as constant here.
MOST_LASTING_S = 3200.0
# Innovations whose squares are less than so many times those expected are too small for any time
# that errors last: the longest then only looks likeliest. White noise is measured to this share.
TOO_SMALL, LEAST_WHITE = 0.5, 0.01
# Whether velocities are off shows better with the time that errors of positions last.
ROUNDS = 2
SLOW = "; slow errors"
# Steps of the sizes: of positions, horizontal and vertical, and of velocities.
Steps = tuple[int, int, int, int]
NONE: Steps = (0, 0, 0, 0)
# Horizontal and vertical together first, then each by itself
POSITION_WAYS: tuple[Steps, ...] = (
    (1, 1, 0, 0),
    (0, 1, 0, 0),
    (0, -1, 0, 0),
    (1, 0, 0, 0),
    (-1, 0, 0, 0),
)
VELOCITY_WAYS: tuple[Steps, ...] = (
    (0, 0, 1, 1),
    (0, 0, 1, 0),
    (0, 0, -1, 0),
    (0, 0, 0, 1),
    (0, 0, 0, -1),
    (-1, -1, 0, 0),
    *POSITION_WAYS,
)


def with_expected_slow_errors(start: FilterStart) -> FilterStart:
    """A start with the slow errors to expect where the log hardly shows how large they are.

    Parameters
    ----------
    start : FilterStart
        By :func:`with_slow_errors`.
    """
    level, vertical, *velocity = start.expected_slow_errors
    if max(start.expected_slow_errors) == 1.0:
        return start
    larger = start.with_slow_position(level, vertical, "").with_slow_velocity(*velocity)
    larger = replace(larger, slow_velocity=_times(start.slow_velocity, *velocity))
    return _described(larger, "", start.unseen_m)


def as_stated(start: FilterStart) -> FilterStart:
    """A start with slow errors as large as they follow from what the receiver states.

    Its own state, which was that of fixes with larger ones, stays as uncertain as it is.
    """
    (level, vertical), (level_v, vertical_v) = start.slow_errors, start.slow_velocity
    smaller = start.with_slow_position(1.0 / level, 1.0 / vertical, "")
    smaller = smaller.with_slow_velocity(1.0 / level_v, 1.0 / vertical_v)
    return replace(smaller, slow_errors=(1.0, 1.0), slow_velocity=(1.0, 1.0))


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
    fits: dict[Steps, tuple[float, float]] = {}

    def cost(steps: Steps) -> float:
        if steps not in fits:
            if not 0 <= min(steps) <= max(steps) <= MOST_STEPS:
                return np.inf
            fits[steps] = _fit(increments, _with(judged, steps), shaken)
        return fits[steps][0]

    if not np.isfinite(cost(NONE)):
        return start
    best = _search(cost, NONE, POSITION_WAYS)
    if fits[best][1] > DIVERGES:
        # The likelihood of a filter that diverges rises and falls by chance
        sizes = [(n, n, 0, 0) for n in range(MOST_STEPS + 1)]
        best = _search(cost, min(sizes, key=cost), POSITION_WAYS)
    if cost(best) >= cost(NONE) - LEAST_GAIN:
        best = NONE
    known = bool(judged.used.has_velocity.any())
    for _ in range(ROUNDS):
        best = _beside_velocities(cost, best) if known else best
        if best[:2] != NONE[:2]:
            break
        scattered = _as_scattered(_with(judged, best))
        longer = _lasting(scattered, lambda one: _fit(increments, one, shaken))
        if longer == judged.settings.gnss.position_time:
            break
        judged, start = judged.lasting(longer), start.lasting(longer)
        fits.clear()

    def larger(way: Steps) -> list[float]:
        """Costs of slow errors 1, `STEP`, `STEP`² ... times as large, until they would show."""
        costs, ahead = [cost(best)], best
        while costs[-1] < costs[0] + NOT_SHOWN:
            ahead = _ahead(ahead, way)
            costs.append(cost(ahead))
        return costs

    positions = larger((1, 1, 0, 0))
    made = _with(start, best)
    model, unseen = made.settings.gnss, len(positions) - 2
    most = model.position_markov[0] * STEP**unseen if unseen else 0.0
    expected = [1.0, 1.0, 1.0, 1.0]
    if best[:2] == NONE[:2]:
        north, _, down = expected_factors(model.position_markov, model.position_white, positions)
        expected[:2] = north, down
    ways: tuple[Steps, Steps] = (0, 0, 1, 0), (0, 0, 0, 1)
    for which, way in enumerate(ways, start=2):
        if best[which] == 0 and known:
            shown = expected_factors(model.velocity_markov, model.velocity_white, larger(way))
            expected[which] = shown[2 * (which - 2)]
    return replace(
        _described(made, ", by all innovations" * any(best), most),
        expected_slow_errors=(expected[0], expected[1], expected[2], expected[3]),
    )


def _beside_velocities(cost: Callable[[Steps], float], best: Steps) -> Steps:
    """Steps of positions and velocities, which follow each other for a minute, from some on."""
    both = _search(cost, best, VELOCITY_WAYS)
    alone = (0, 0, *both[2:])
    both = alone if cost(alone) < cost(both) + LEAST_GAIN else both
    return both if cost(both) < cost(best) - LEAST_GAIN else best


def _lasting(start: FilterStart, fit: Callable[[FilterStart], tuple[float, float]]) -> float:
    """How long slow errors of positions last, s, by all innovations of a start with these.

    A receiver states how large they are. If they change by less within minutes, they last longer,
    and no filter averages them out.
    """
    lasts = start.settings.gnss.position_time
    first, square = fit(start)
    least, longest = first, lasts
    while longest * STEP <= MOST_LASTING_S:
        shown, squares = fit(start.lasting(longest * STEP))
        if shown >= least:
            break
        longest, least, square = longest * STEP, shown, squares
    return longest if least < first - LEAST_GAIN and square > TOO_SMALL else lasts


def _as_scattered(start: FilterStart) -> FilterStart:
    """A start whose fixes have no more white noise than they show, to judge how long others last.

    That of a receiver that smooths its fixes is taken for more. All innovations are then smaller
    than expected, and errors that hardly change, which leave the least to expect, look likeliest.
    """
    if start.white is None:
        return start
    model, gnss = start.settings.gnss, start.gnss

    def less(shown: tuple[float, float], usual: Triple) -> tuple[Triple, FloatArray]:
        most = np.array(usual)
        north, east, down = np.fmin(
            np.fmax(np.array(shown)[[0, 0, 1]], LEAST_WHITE * most), most
        ).tolist()
        return (north, east, down), np.square([north, east, down]) - np.square(most)

    position, by = less(start.white.position, model.position_white)
    velocity, by_v = less(start.white.velocity, model.velocity_white)
    return replace(
        start,
        settings=replace(
            start.settings,
            gnss=replace(model, position_white=position, velocity_white=velocity),
        ),
        gnss=replace(
            gnss,
            sigma_position_n=_changed(gnss.sigma_position_n, by),
            sigma_velocity_n=_changed(gnss.sigma_velocity_n, by_v),
        ),
    )


def _changed(sigma: FloatArray, by: FloatArray) -> FloatArray:
    """Sigmas of single fixes, with another white variance."""
    return np.sqrt(np.maximum(np.square(sigma) + by, np.square(LEAST_WHITE * sigma)))


def _search(cost: Callable[[Steps], float], best: Steps, ways: Sequence[Steps]) -> Steps:
    """The steps from which none of the ways goes down, from some on."""
    begun = None
    while begun != best:
        begun = best
        for way in ways:
            while cost(ahead := _ahead(best, way)) < cost(best):
                best = ahead
    return best


def _ahead(steps: Steps, way: Steps) -> Steps:
    return steps[0] + way[0], steps[1] + way[1], steps[2] + way[2], steps[3] + way[3]


def expected_factors(slow: Triple, white: Triple, costs: Sequence[float]) -> Triple:
    """Slow errors to expect over those of a start, north, east and down.

    Parameters
    ----------
    slow, white : tuple of float
        Sigmas of the slow and of the white errors.
    costs : sequence of float
        -2 log likelihood with slow errors 1, `STEP`, `STEP`² ... times as large.

    Notes
    -----
    The root of the mean square under the posterior. A priori all these sizes are equally likely, up
    to the whole error that the receiver states. 1 unless larger ones are likelier than by chance.
    """
    times = STEP ** np.arange(float(len(costs)))[:, None]
    possible = times * np.array(slow) <= np.hypot(slow, white)
    possible[0] = True
    # Where the filter diverges with all of these, a far larger size may be likelier by hundreds
    each = np.where(possible, np.array(costs)[:, None], np.inf)
    if costs[0] < each.min() + BY_CHANCE:
        return 1.0, 1.0, 1.0
    weight = np.exp(0.5 * (each.min(axis=0) - each))
    north, east, down = np.sqrt((weight * times**2).sum(axis=0) / weight.sum(axis=0)).tolist()
    return north, east, down


def _with(start: FilterStart, steps: Steps) -> FilterStart:
    """A start with slow errors larger by steps."""
    level, vertical, *velocity = (STEP**step for step in steps)
    if any(steps[2:]):
        larger = _times(start.slow_velocity, *velocity)
        start = replace(start.with_slow_velocity(*velocity), slow_velocity=larger)
    if not any(steps[:2]):
        return start
    larger = _times(start.slow_errors, level, vertical)
    return replace(start.with_slow_position(level, vertical, ""), slow_errors=larger)


def _times(errors: tuple[float, float], level: float, vertical: float) -> tuple[float, float]:
    """Factors on slow errors, horizontal and vertical, times others."""
    return errors[0] * level, errors[1] * vertical


def _described(start: FilterStart, how: str, unseen_m: float) -> FilterStart:
    """A start that says how large its slow errors are, and up to which size none would show."""
    model = start.settings.gnss
    north, _, down = model.position_markov
    text = f"{start.gnss_why.split(SLOW)[0]}{SLOW} {north:.3g} m, in height {down:.3g} m"
    text += f" over {model.position_time:.0f} s"
    if max(start.slow_velocity) > 1.0:
        text += f", of velocities {model.velocity_markov[0]:.2g} m/s"
    text += how
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
