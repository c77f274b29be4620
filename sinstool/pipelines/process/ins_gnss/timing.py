"""When the fixes of a log were valid: looked for where nobody says.

An epoch is valid ``latency`` before its stamp. Position and velocity of one message need not be
of one instant: some receivers difference positions, or average over the interval that ends at
the fix. Their lag is how much later velocities are stamped than positions; the latency is then
the mean of both, so that positions are valid at ``stamp - latency + lag/2`` and velocities at
``stamp - latency - lag/2``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from sinstool.config import ProcessConfig
from sinstool.core.rotation import skew, to_dcm
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.methods.ins_gnss import latency as latencies
from sinstool.methods.ins_gnss import velocity_lag as lags
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.latency import Latency
from sinstool.methods.ins_gnss.noise import GnssModel
from sinstool.methods.ins_gnss.settings import Settings
from sinstool.methods.ins_gnss.start import Beginning
from sinstool.methods.strapdown.velocity import Increments
from sinstool.survey.increments import SegmentIncrements
from sinstool.survey.source import Source

# Latency is looked for in the first part of a log: this much by velocities, and less by the
# likelihood, which runs the filter many times.
VELOCITY_NS = 400 * SECOND
LIKELIHOOD_NS = 240 * SECOND
# Taken where it is more than this, and than so many of its sigmas.
LEAST_S = 0.01
LEAST_LAG_S = 0.02
SIGMAS = 3.0
LAG_SIGMAS = 6.0
ROUNDS = 4
# By likelihood: half the range looked through at first, runs of the filter, s.
SPAN_S = 0.25
EVALUATIONS = 14
TOLERANCE_S = 5e-3
# Assumed while positions at wrong times must not spoil the biases.
LOOSE_POSITION = (5.0, 5.0, 8.0)
LOOSE_VELOCITY = (0.3, 0.3, 0.5)
GATE = float(chdtri(6, 1e-4))

Begin = Callable[[Settings, GnssEpochs], Beginning]


@dataclass(frozen=True)
class Timing:
    """When fixes were valid, and how that is known.

    Attributes
    ----------
    latency : Latency
        Mean of those of position and velocity.
    lag : float
        How much later velocities are stamped than positions, s; 0 where they are taken for
        simultaneous.
    taken : float
        The latency that is used: 0 where none stands out.
    """

    latency: Latency
    lag: float
    taken: float


def velocity_lag(gnss: GnssEpochs) -> float:
    """How much later velocities are stamped than positions, where that stands out, s."""
    part = gnss.rows(gnss.time_ns <= gnss.time_ns[0] + VELOCITY_NS)
    found = lags.velocity_lag(part)
    if found.status != "found":
        return 0.0
    least = max(LEAST_LAG_S, LAG_SIGMAS * found.sigma_s)
    return found.latency_s if abs(found.latency_s) > least else 0.0


def separate(gnss: GnssEpochs, lag: float) -> GnssEpochs:
    """Epochs whose velocities and positions have rows of their own, half a lag to either side.

    Parameters
    ----------
    lag : float
        s; with 0 the epochs stay as they are.

    Returns
    -------
    GnssEpochs
        All of them valid `latency` before their stamps.
    """
    if lag == 0.0:
        return gnss
    apart = lags.separate(gnss, lag)
    return replace(apart, time_ns=apart.time_ns + round(0.5 * lag * SECOND))


def message_times(gnss: GnssEpochs, lag: float) -> np.ndarray:
    """Stamps of the messages that separated epochs come from, ns."""
    half = round(0.5 * lag * SECOND)
    whole = round(lag * SECOND)
    return np.asarray(gnss.time_ns - half + np.where(gnss.has_position, 0, whole))


def find_timing(
    source: Source,
    config: ProcessConfig,
    settings: Settings,
    gnss: GnssEpochs,
    lag: float,
    begin: Begin,
) -> tuple[Timing, Settings, Beginning]:
    """Look for the latency of a receiver.

    By its velocities, which depend on attitude and time alone; where there are none, or none that
    change, by the likelihood of what the filter does. On recorded drives the latter, which
    depends on every noise that is assumed too, is off by several times what it says.

    Parameters
    ----------
    settings : Settings
        Of the filter; its latency is where the search begins.
    gnss : GnssEpochs
        Separated, if they are to be.
    lag : float
        By which they were.
    begin : callable
        Finds a start with settings.

    Returns
    -------
    Timing
    Settings
        With the latency that was found, where it stands out.
    Beginning

    Raises
    ------
    AlignmentError
        There is no start.
    """
    beginning = begin(settings, gnss)
    motion = _Motion(source, config, beginning.time_ns)
    found = _correlated(motion, settings, beginning, gnss)
    for _ in range(ROUNDS):
        if not _stands_out(found, settings.gnss_latency):
            break
        settings = replace(settings, gnss_latency=found.latency_s)
        beginning = begin(settings, gnss)
        found = _correlated(motion.since(beginning.time_ns), settings, beginning, gnss)
    if found.status == "not observable":
        found = _likeliest(motion.since(beginning.time_ns), settings, beginning, gnss)
        if _stands_out(found, settings.gnss_latency):
            settings = replace(settings, gnss_latency=found.latency_s)
            beginning = begin(settings, gnss)
    return Timing(found, lag, settings.gnss_latency), settings, beginning


def _stands_out(found: Latency, known: float) -> bool:
    if found.status == "not observable":
        return False
    return abs(found.latency_s - known) > max(LEAST_S, SIGMAS * found.sigma_s)


class _Motion:
    """Increments of the log's first part, made once."""

    def __init__(self, source: Source, config: ProcessConfig, start_ns: int) -> None:
        steps = SegmentIncrements(source, config)
        self._start_ns = start_ns
        self._again: Callable[[int], _Motion] = lambda time_ns: _Motion(source, config, time_ns)
        self.parts: list[Increments] = []
        end = start_ns + VELOCITY_NS
        for increments, _, opening in steps.from_time(start_ns, end):
            # what a filter does in a gap is not what correlations are made of
            if opening is not None and self.parts and _gap(self.parts[-1], increments):
                break
            self.parts.append(increments)

    def since(self, time_ns: int) -> _Motion:
        """The motion from a start on."""
        return self if time_ns == self._start_ns else self._again(time_ns)

    def until(self, span_ns: int) -> list[Increments]:
        """Its first part."""
        end = self._start_ns + span_ns
        kept = []
        for part in self.parts:
            rows = int(np.searchsorted(part.time_ns, end, "right"))
            if rows:
                kept.append(Increments(*(v[:rows] for v in vars(part).values())))
            if rows < len(part.time_ns):
                break
        return kept


def _gap(before: Increments, after: Increments) -> bool:
    away = int(after.time_ns[0]) - int(before.time_ns[-1])
    return away > 5 * SECOND


def _correlated(
    motion: _Motion, settings: Settings, beginning: Beginning, gnss: GnssEpochs
) -> Latency:
    """Latency by which the Imu's velocity and that of GNSS run alike."""
    if not gnss.has_velocity.any() or not motion.parts:
        return Latency(0.0, float("inf"), "not observable", 0)
    end = beginning.time_ns + VELOCITY_NS
    # Loosely: fixes at the wrong time must not spoil the biases that are taken off.
    plain = replace(
        settings,
        filter="plain-15",
        network=None,
        gnss=GnssModel(position_white=LOOSE_POSITION, velocity_white=LOOSE_VELOCITY),
        control=replace(settings.control, gate_probability=1.0),
    )
    loose = replace(
        gnss,
        sigma_position_n=np.full_like(gnss.sigma_position_n, np.nan),
        sigma_velocity_n=np.full_like(gnss.sigma_velocity_n, np.nan),
    )
    run = InsGnssFilter(beginning.start, plain, with_baro=False)
    given: GnssEpochs | None = loose
    columns: list[tuple[np.ndarray, ...]] = []
    last_q = beginning.start.nav[6:10]
    for increments in motion.parts:
        out = run.push(increments, given).updates
        given = None
        assert out is not None
        columns.append(
            (
                out.time_ns,
                np.concatenate([last_q[None, :], out.q_nb[:-1]]),
                increments.velocity_increment
                - run.summary.accel_bias * increments.interval[:, None],
                increments.interval,
                out.latitude,
                out.height,
                out.velocity_n,
                to_dcm(out.q_nb) @ skew(out.omega_ib_b),
            )
        )
        last_q = out.q_nb[-1]
    time_ns, q, dv, dt, latitude, height, velocity, swing = (
        np.concatenate(column) for column in zip(*columns, strict=True)
    )
    inertial = latencies.inertial_velocity(q, dv, dt, latitude, height, velocity)
    inertial = inertial + swing @ np.asarray(settings.lever_arm_b)
    rows = gnss.rows((gnss.time_ns >= beginning.time_ns) & (gnss.time_ns <= end))
    # A lever arm that is not known looks like a latency in turns
    return latencies.correlate(time_ns, inertial, rows.time_ns, rows.velocity_n, swing_n=swing)


def _likeliest(
    motion: _Motion,
    settings: Settings,
    beginning: Beginning,
    gnss: GnssEpochs,
) -> Latency:
    """Latency at which the filter finds its innovations most likely."""
    parts = motion.until(LIKELIHOOD_NS)
    if not parts:
        return Latency(0.0, float("inf"), "not observable", 0)
    end = int(parts[-1].time_ns[-1])
    first = settings.gnss_latency
    margin = round((abs(first) + 4.0 * SPAN_S) * SECOND)
    inside = (gnss.time_ns > beginning.time_ns + margin) & (gnss.time_ns < end - margin)
    rows = gnss.rows(inside)
    plain = replace(
        settings,
        filter="markov-21",
        network=None,
        control=replace(settings.control, gate_probability=1.0, adaptive="off"),
    )
    sizes: list[float] = []

    def cost(latency: float) -> float:
        run = InsGnssFilter(
            beginning.start, replace(plain, gnss_latency=latency), with_baro=False, output=False
        )
        total, squares, count = 0.0, 0.0, 0
        given: GnssEpochs | None = rows
        for part in parts:
            found = run.push(part, given).gnss
            given = None
            log_det = 2.0 * np.nansum(np.log(found.innovation_sigma), axis=1)
            total += latencies.likelihood_cost(found.nis, log_det, found.used, GATE)
            squares += float(np.nansum(np.minimum(found.nis, GATE)))
            count += int(found.rows.sum())
        sizes.append(squares / max(count, 1))
        return total

    if len(rows) < 20:
        return Latency(0.0, float("inf"), "not observable", 0)
    cost(first)
    return latencies.refine(cost, first, SPAN_S, TOLERANCE_S, max(1.0, sizes[0]), EVALUATIONS)
