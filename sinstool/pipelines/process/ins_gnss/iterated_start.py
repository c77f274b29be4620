"""A first attitude about which a filter is nearly linear: that of its own smoother.

A filter that begins with an attitude tens of degrees off is linearised about that wrong attitude.
As it turns to the true one, it gains information about tilts and biases that the motion does not
hold, and its sigmas are too small from then on. The smoothed attitude at the start is nearer to the
truth, and a filter that begins there, with the same sigmas, is linearised about the truth. That is
the iterated smoother of Bell (1994), a Gauss-Newton method, which ends where a step changes little.
The attitude that was there first counts once more with each step; it is worth less than a minute of
fixes.

References
----------
.. [1] B. M. Bell, "The iterated Kalman smoother as a Gauss-Newton method", SIAM Journal on
   Optimization 4(3), 1994, 626-636.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sinstool.core.rotation import conjugate, log, multiply
from sinstool.core.streams import take_rows
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.settings import Start
from sinstool.methods.ins_gnss.smoother import Smoother
from sinstool.methods.strapdown.joined_updates import JOINED_S, joined_updates
from sinstool.methods.strapdown.navigation import Q_W, Q_Z
from sinstool.methods.strapdown.velocity import Increments
from sinstool.pipelines.process.ins_gnss.before_start import corrected_start
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.innovation_cost import LEAST_EPOCHS, innovation_cost

# Fixes that come faster than this tell little more, and what a smoother stores grows with them.
APART_NS = SECOND // 2
# Errors of second order of an attitude that is off by this are half a milliradian.
NEARLY_LINEAR, MOST_STEPS = 2.0 * DEGREE, 4
# Steps that lead away make the fixes less likely by more than this, in -2 log likelihood.
ASTRAY = 10.0


def iterated(begun: FilterStart, motion: Increments | None) -> Start:
    """The start with the attitude at which an iterated smoother ends.

    Parameters
    ----------
    begun : FilterStart
        With the latency and the lever arm that its fixes are to be used with.
    motion : Increments or None
        From the start on, for some minutes.

    Returns
    -------
    Start
        With the same sigmas. It is the start that was given where the smoothed attitude is close to
        it, where too few fixes follow, or where the steps make the fixes clearly less likely.
    """
    start = begun.start
    if motion is None:
        return start
    joined = joined_updates(motion, JOINED_S, begun.valid_ns)
    least = np.inf
    for _ in range(MOST_STEPS):
        smoothed = smoothed_over(replace(begun, start=start), joined)
        if smoothed is None:
            break
        cost, nav = smoothed.cost, smoothed.start.nav
        if cost > least + ASTRAY:
            return begun.start
        least = min(least, cost)
        turned = log(multiply(nav[Q_W : Q_Z + 1], conjugate(start.nav[Q_W : Q_Z + 1])))
        if float(np.linalg.norm(turned)) < NEARLY_LINEAR:
            break
        attitude = np.concatenate([start.nav[:Q_W], nav[Q_W : Q_Z + 1]])
        start = replace(start, nav=attitude)
    return start


@dataclass(frozen=True)
class SmoothedStart:
    """A start corrected by smoothing, with the sigmas of the smoother.

    Attributes
    ----------
    cost : float
        -2 log likelihood of the innovations.
    epochs : int
        Number of fixes compared.
    """

    start: Start
    cost: float
    epochs: int


def smoothed_over(begun: FilterStart, motion: Increments) -> SmoothedStart | None:
    """A start corrected by smoothing over what follows.

    Parameters
    ----------
    begun : FilterStart
        With the latency and the lever arm that its fixes are to be used with.
    motion : Increments
        From the start on, for some minutes.

    Returns
    -------
    SmoothedStart or None
        None with too few fixes, or from a start so wrong that the filter diverges.
    """
    # A gate would leave out fixes that a wrong attitude contradicts
    settings = begun.settings.ungated
    fixes = begun.believable_until(int(motion.time_ns[-1]))
    apart = np.unique(fixes.time_ns // APART_NS, return_index=True)[1]
    run = InsGnssFilter(begun.start, settings, with_baro=False, output=False, store=True)
    block = run.push(motion, fixes.rows(apart))
    epochs = take_rows(block.gnss, np.isfinite(block.gnss.nis))
    if len(epochs) < LEAST_EPOCHS:
        return None
    with Smoother(run.kind, outputs=False) as smoother:
        smoother.push(block)
        smoothed = smoother.epochs()
        error, covariance = smoothed.first_error.copy(), smoothed.first_covariance.copy()
    if not (np.isfinite(error).all() and np.isfinite(covariance).all()):
        return None
    corrected = corrected_start(begun.start, error, covariance, smoothed.kind)
    return SmoothedStart(corrected, innovation_cost(epochs), len(epochs))
