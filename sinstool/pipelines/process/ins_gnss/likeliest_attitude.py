"""Whether another first attitude makes a log's fixes likelier than that of a filter's start.

An attitude found in motion may be a wrong one of several that explain a few velocity changes about
as well, one that options state may be wrong altogether, and their sigmas do not tell. The minutes
that follow do: a filter that begins elsewhere, with large sigmas, is then likelier (Schweppe 1965),
whatever it is worth at the start. So filters are run from eight headings around the first (a bank
of filters, Magill 1965), each with sigmas that reach to the next.

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
from sinstool.core.streams import take_rows
from sinstool.core.units import DEGREE
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.fix_velocity import outlying
from sinstool.methods.ins_gnss.settings import Start
from sinstool.methods.strapdown.joined_updates import JOINED_S, joined_updates
from sinstool.methods.strapdown.velocity import Increments
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.imu_fit import LEAST_EPOCHS, unlikely
from sinstool.pipelines.process.ins_gnss.iterated_start import iterated
from sinstool.pipelines.process.ins_gnss.timing import motion_from
from sinstool.survey.source import Source

# Headings around a circle, and the sigma of each, and of tilt, rad: one that motion shows is less
# wrong than one that is stated may be.
HEADINGS, HEADING_SIGMA = 8, 20.0 * DEGREE
TILT_SIGMA, STATED_TILT_SIGMA = 5.0 * DEGREE, 20.0 * DEGREE
# A heading that motion shows to better than this, rad, is not one of several.
PLAIN = 3.0 * DEGREE
# By how much -2 log likelihood must fall: four sigmas of one that motion shows, as what is taken
# instead claims less; five of one that is stated, before it is denied.
LEAST_GAIN, DENIED = 16.0, 25.0


def with_likeliest(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    start: FilterStart,
    judged: FilterStart,
) -> FilterStart:
    """A start with the likeliest first attitude; where options state it, with what denies that.

    Parameters
    ----------
    judged : FilterStart
        The same with the latency and the lever arm that fixes are to be judged with.
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
    """A first attitude by an option that the fixes of the minutes after it deny."""
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
        Of the other attitudes, rad.

    Returns
    -------
    best : Start
        The same unless another is clearly likelier.
    gain : float
        By how much -2 log likelihood is less; 0 where none is clearly likelier.
    """
    if motion is None:
        return start.start, 0.0
    joined = joined_updates(motion, JOINED_S)
    own = _cost(joined, start)
    best, least = start, own - LEAST_GAIN
    for other in _others(start, tilt_sigma) if np.isfinite(own) else ():
        cost = _cost(joined, other)
        if cost < least:
            best, least = other, cost
    return best.start, 0.0 if best is start else own - least


def _others(start: FilterStart, tilt_sigma: float) -> Iterator[FilterStart]:
    """The same start with other headings, and with sigmas that reach from each to the next."""
    first, bias = start.start, start.settings.imu.gyro_bias
    sigma = np.array([tilt_sigma, tilt_sigma, HEADING_SIGMA])
    covariance = np.diag(np.maximum(np.diag(first.covariance_attitude_n), sigma**2))
    if first.gyro_bias_sigma is not None:
        bias = max(bias, first.gyro_bias_sigma)
    for k in range(HEADINGS):
        nav = first.nav.copy()
        nav[6:10] = multiply(exp([0.0, 0.0, 2.0 * np.pi * k / HEADINGS]), nav[6:10])
        other = replace(first, nav=nav, covariance_attitude_n=covariance, gyro_bias_sigma=bias)
        yield replace(start, start=other)


def _cost(motion: Increments, start: FilterStart) -> float:
    """-2 log likelihood of the innovations; infinite with too few."""
    # A gate would leave out the fixes that contradict
    control = replace(start.settings.control, gate_probability=1.0, adaptive="off")
    settings = replace(start.settings, network=None, control=control)
    fixes = start.used_until(int(motion.time_ns[-1]))
    run = InsGnssFilter(start.start, settings, with_baro=False, output=False)
    epochs = run.push(motion, fixes.rows(~outlying(fixes))).gnss
    epochs = take_rows(epochs, np.isfinite(epochs.nis))
    return float(np.sum(unlikely(epochs))) if len(epochs) >= LEAST_EPOCHS else np.inf
