"""Whether another first attitude makes a log's fixes likelier than that of a filter's start.

Several attitudes may explain a few velocity changes about equally well, and the one found in motion
may be the wrong one; a configured attitude may be wrong altogether. Their sigmas do not show this,
but the minutes that follow do: a filter that starts with another attitude and large sigmas is then
likelier (Schweppe 1965). So filters are run from eight headings around the first (a bank of
filters, Magill 1965), each with a sigma that reaches to the next.

References
----------
.. [1] F. C. Schweppe, "Evaluation of likelihood functions for Gaussian signals", IEEE Trans.
   Information Theory 11(1), 1965, 61-70.
.. [2] D. T. Magill, "Optimal adaptive estimation of sampled stochastic processes", IEEE Trans.
   Automatic Control 10(4), 1965, 434-439.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.config.align import IN_FLIGHT
from sinstool.core.finding import Finding, Severity
from sinstool.core.rotation import exp, multiply
from sinstool.core.units import DEGREE
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.ins_gnss.settings import Start
from sinstool.methods.sensor_errors import LOW_COST
from sinstool.methods.strapdown.joined_updates import JOINED_S, joined_updates
from sinstool.methods.strapdown.velocity import Increments
from sinstool.pipelines.align.in_motion import UNKNOWN_BIAS
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.innovation_cost import innovation_cost, innovations
from sinstool.pipelines.process.ins_gnss.iterated_start import iterated
from sinstool.pipelines.process.ins_gnss.timing import motion_from
from sinstool.survey.source import Source

# Number of headings around a circle, and the sigma of each, rad; sigma of tilt, rad, of an attitude
# found in motion and of a configured one, which may be more wrong.
HEADINGS, HEADING_SIGMA = 8, 20.0 * DEGREE
TILT_SIGMA, STATED_TILT_SIGMA = 5.0 * DEGREE, 20.0 * DEGREE
# A heading found in motion with a sigma below this, rad, has no alternatives.
PLAIN = 3.0 * DEGREE
# By how much -2 log likelihood must fall: four sigmas to replace an attitude found in motion, as
# the new one has larger sigmas; five to report that the log contradicts a configured one.
LEAST_GAIN, DENIED = 16.0, 25.0


def with_likeliest(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    start: FilterStart,
    judged: FilterStart,
) -> FilterStart:
    """A start with the likeliest first attitude; a configured one stays, with `denied` set.

    Parameters
    ----------
    judged : FilterStart
        The same start, with the latency and lever arm to use for the fixes.
    """
    stated = config.align.align not in (*IN_FLIGHT, "auto")
    if not stated and start.start.covariance_attitude_n[2, 2] < PLAIN**2:
        return start
    motion = motion_from(source, config, algorithm, start.time_ns)
    best, gain = likeliest(judged, motion, STATED_TILT_SIGMA if stated else TILT_SIGMA)
    if stated:
        return replace(start, denied=gain if gain > DENIED else 0.0)
    how = start.how
    if gain:
        how += "; replaced by another that fits the fixes of the first minutes better"
    return replace(start, start=iterated(replace(judged, start=best), motion), how=how)


def denied_attitude(start: FilterStart) -> list[Finding]:
    """A finding if the fixes of the first minutes contradict a configured first attitude."""
    if not start.denied:
        return []
    return [
        Finding(
            "stated-attitude",
            "the fixes of the first minutes fit another first attitude clearly better than that of"
            f" --align (by {start.denied:.0f} in twice the log likelihood): do not trust the"
            " attitude and its sigmas",
            Severity.LOST,
            "leave --align and --initial-attitude out, or correct them",
            numbers={"twice_log_likelihood": start.denied},
        )
    ]


def likeliest(
    start: FilterStart, motion: Increments | None, tilt_sigma: float
) -> tuple[Start, float]:
    """The first attitude that makes the fixes likeliest.

    Parameters
    ----------
    motion : Increments or None
        From the start on, for some minutes.
    tilt_sigma : float
        Sigma of tilt of the other attitudes, rad.

    Returns
    -------
    best : Start
        Unchanged unless another is clearly likelier.
    gain : float
        Decrease of -2 log likelihood; 0 if none is clearly likelier.
    """
    if motion is None:
        return start.start, 0.0
    joined = joined_updates(motion, JOINED_S, start.valid_ns)
    own = _cost(joined, start)
    best, least = start, own - LEAST_GAIN
    sigmas = _bias_sigmas(start)
    for bias_sigma in sigmas if np.isfinite(own) else ():
        for other in _others(start, tilt_sigma, bias_sigma):
            cost = _cost(joined, other)
            if cost < least:
                best, least = other, cost
        if best is not start:
            return replace(best.start, gyro_bias_sigma=sigmas[0]), own - least
    return start.start, 0.0


def _bias_sigmas(start: FilterStart) -> list[float]:
    """Sigmas of the gyro bias, rad/s, to try other attitudes with; the first is to be used.

    The bias of low-cost gyros that a wrong attitude has shown is as wrong. But a filter that knows
    neither heading nor bias may be too far from linear to find a heading.
    """
    usual = max(start.settings.imu.gyro_bias, start.start.gyro_bias_sigma or 0.0)
    shown = start.alignment.bias_source == "alignment" and start.grade.grade in LOW_COST
    return [UNKNOWN_BIAS, usual] if shown and usual < UNKNOWN_BIAS else [usual]


def _others(start: FilterStart, tilt_sigma: float, bias_sigma: float) -> Iterator[FilterStart]:
    """The same start with other headings, and with sigmas that reach from each to the next."""
    first = start.start
    sigma = np.array([tilt_sigma, tilt_sigma, HEADING_SIGMA])
    covariance = np.diag(np.maximum(np.diag(first.covariance_attitude_n), sigma**2))
    for k in range(HEADINGS):
        nav = first.nav.copy()
        nav[6:10] = multiply(exp([0.0, 0.0, 2.0 * np.pi * k / HEADINGS]), nav[6:10])
        other = replace(
            first, nav=nav, covariance_attitude_n=covariance, gyro_bias_sigma=bias_sigma
        )
        yield replace(start, start=other)


def _cost(motion: Increments, start: FilterStart) -> float:
    # Without a gate, which would reject the fixes that contradict an attitude
    fixes = start.believable_until(int(motion.time_ns[-1]))
    return innovation_cost(innovations(start.start, start.settings.ungated, motion, fixes))
