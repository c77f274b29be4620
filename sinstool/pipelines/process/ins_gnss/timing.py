"""When the fixes of a log were valid, estimated where the user does not say.

An epoch is valid ``latency`` before its stamp. Position and velocity of one message need not be
of one instant: some receivers difference positions, or average over the interval that ends at
the fix. Their lag is how much later velocities are stamped than positions; the latency is then
the mean of both, so that positions are valid at ``stamp - latency + lag/2`` and velocities at
``stamp - latency - lag/2``.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from sinstool.config import ProcessConfig
from sinstool.core.errors import AlignmentError
from sinstool.core.rotation import skew, to_dcm
from sinstool.core.streams import GnssEpochs, concatenate, take_rows
from sinstool.core.timeline import SECOND
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.ins_gnss import latency as latencies
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.fix_velocity import velocity_lag
from sinstool.methods.ins_gnss.latency import Latency
from sinstool.methods.ins_gnss.settings import GnssModel, Settings
from sinstool.methods.strapdown.velocity import Increments
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.survey.increments import SegmentIncrements
from sinstool.survey.source import Source

# Latency is looked for in the first part of a log: this much by velocities, and less by the
# likelihood, which runs the filter many times.
VELOCITY_NS = 400 * SECOND
LIKELIHOOD_NS = 240 * SECOND
GAP_NS = 5 * SECOND
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
# For the white noise of fixes: epochs that show it; median of the square of a unit normal.
LEAST_EPOCHS = 40
MEDIAN_SQUARE = 0.4549


def significant_lag(gnss: GnssEpochs) -> float:
    """How much later velocities are stamped than positions, s; 0 where no lag stands out."""
    lag = velocity_lag(gnss.rows(gnss.time_ns <= gnss.time_ns[0] + VELOCITY_NS))
    stands_out = lag.status == "found" and lag.differs_from(0.0, LEAST_LAG_S, LAG_SIGMAS)
    return lag.latency_s if stands_out else 0.0


def with_latency(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    start: FilterStart,
    begin: Callable[[float], FilterStart],
) -> FilterStart:
    """A start whose latency is that of the receiver, as the log shows it.

    By its velocities, which depend on attitude and time alone; where there are none, or none that
    change, by the likelihood of what the filter does. On recorded drives the latter, which
    depends on every noise that is assumed too, is off by several times what it says.

    Parameters
    ----------
    start : FilterStart
        Without a latency.
    begin : callable
        Finds a start with a latency, s.
    """
    motion = _motion(source, config, algorithm, start.time_ns)
    latency = _correlated(motion, start)
    for _ in range(ROUNDS):
        if not latency.differs_from(start.settings.gnss_latency, LEAST_S, SIGMAS):
            break
        before = start
        try:
            start = begin(latency.latency_s)
        except AlignmentError:  # with the fixes moved so far no start is seen: they stay
            break
        if start.time_ns != before.time_ns:
            motion = _motion(source, config, algorithm, start.time_ns)
        latency = _correlated(motion, start)
    if latency.status == "not observable":
        latency = _likeliest(motion, start)
        if latency.differs_from(start.settings.gnss_latency, LEAST_S, SIGMAS):
            with suppress(AlignmentError):
                start = begin(latency.latency_s)
    return replace(start, latency=latency)


def _motion(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start_ns: int
) -> list[Increments]:
    """Increments of the log's first part from a start on, up to a gap."""
    parts: list[Increments] = []
    steps = SegmentIncrements(source, config, algorithm)
    for increments, _, opening in steps.from_time(start_ns, start_ns + VELOCITY_NS):
        # what a filter does in a gap is not what correlations are made of
        away = int(increments.time_ns[0] - parts[-1].time_ns[-1]) if parts else 0
        if opening is not None and away > GAP_NS:
            break
        parts.append(increments)
    return parts


def _until(parts: list[Increments], end_ns: int) -> list[Increments]:
    """Increments up to a time."""
    rows = [int(np.searchsorted(part.time_ns, end_ns, "right")) for part in parts]
    return [take_rows(part, slice(0, n)) for part, n in zip(parts, rows, strict=True) if n]


def _correlated(motion: list[Increments], start: FilterStart) -> Latency:
    """Latency by which the Imu's velocity and that of GNSS run alike."""
    settings, gnss = start.settings, start.used
    if not gnss.has_velocity.any() or not motion:
        return latencies.NOT_OBSERVABLE
    end = start.time_ns + VELOCITY_NS
    # Loosely: fixes at the wrong time must not spoil the biases that are taken off.
    run = InsGnssFilter(start.start, _loose(settings), with_baro=False)
    fixes: GnssEpochs | None = _unsized(gnss)
    columns: list[tuple[np.ndarray, ...]] = []
    last_q = start.start.nav[6:10]
    for increments in motion:
        out = run.push(increments, fixes).updates
        fixes = None
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
    rows = gnss.rows((gnss.time_ns >= start.time_ns) & (gnss.time_ns <= end))
    # A lever arm that is not known looks like a latency in turns
    return latencies.correlate(time_ns, inertial, rows.time_ns, rows.velocity_n, swing_n=swing)


def white_noise(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> tuple[float, float] | None:
    """White noise of positions, horizontal and vertical, m; None where too few fixes show it.

    From second differences of the innovations of a filter that hardly believes the fixes: what
    lasts in them, errors of the fixes and of the navigation alike, is nearly straight over three
    epochs and drops out. Medians leave single bad fixes aside.
    """
    gnss = start.used
    gnss = gnss.rows(gnss.has_position)
    parts = _motion(source, config, algorithm, start.time_ns)
    if not parts or len(gnss) < LEAST_EPOCHS:
        return None
    run = InsGnssFilter(start.start, _loose(start.settings), with_baro=False, output=False)
    fixes: GnssEpochs | None = _unsized(gnss)
    rows = []
    for part in parts:
        rows.append(run.push(part, fixes).gnss)
        fixes = None
    epochs = concatenate(rows)
    steps = np.diff(epochs.time_ns)
    even = np.abs(np.diff(steps)) < 0.5 * np.median(steps) if len(steps) > 1 else np.zeros(0, bool)
    bend = np.diff(epochs.innovation[:, :3], 2, axis=0)[even]
    if len(bend) < LEAST_EPOCHS:
        return None
    # Of independent unit normals 1, -2 and 1 times make a variance of 6
    variance = np.nanmedian(bend**2, axis=0) / (MEDIAN_SQUARE * 6.0)
    return float(np.sqrt(np.mean(variance[:2]))), float(np.sqrt(variance[2]))


def _loose(settings: Settings) -> Settings:
    """Of a filter that hardly believes the fixes."""
    return replace(
        settings,
        filter="plain-15",
        network=None,
        gnss=GnssModel(position_white=LOOSE_POSITION, velocity_white=LOOSE_VELOCITY),
        control=replace(settings.control, gate_probability=1.0),
    )


def _unsized(gnss: GnssEpochs) -> GnssEpochs:
    """Fixes without what they say of their own noise."""
    return replace(
        gnss,
        sigma_position_n=np.full_like(gnss.sigma_position_n, np.nan),
        sigma_velocity_n=np.full_like(gnss.sigma_velocity_n, np.nan),
    )


def _likeliest(motion: list[Increments], start: FilterStart) -> Latency:
    """Latency at which the filter finds its innovations most likely."""
    settings, gnss = start.settings, start.used
    parts = _until(motion, start.time_ns + LIKELIHOOD_NS)
    if not parts:
        return latencies.NOT_OBSERVABLE
    end = int(parts[-1].time_ns[-1])
    first = settings.gnss_latency
    margin = round((abs(first) + 4.0 * SPAN_S) * SECOND)
    inside = (gnss.time_ns > start.time_ns + margin) & (gnss.time_ns < end - margin)
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
            start.start, replace(plain, gnss_latency=latency), with_baro=False, output=False
        )
        total, squares, count = 0.0, 0.0, 0
        fixes: GnssEpochs | None = rows
        for part in parts:
            epochs = run.push(part, fixes).gnss
            fixes = None
            log_det = 2.0 * np.nansum(np.log(epochs.innovation_sigma), axis=1)
            total += latencies.likelihood_cost(epochs.nis, log_det, epochs.used, GATE)
            squares += float(np.nansum(np.minimum(epochs.nis, GATE)))
            count += int(epochs.rows.sum())
        sizes.append(squares / max(count, 1))
        return total

    if len(rows) < 20:
        return latencies.NOT_OBSERVABLE
    cost(first)
    return latencies.refine(cost, first, SPAN_S, TOLERANCE_S, max(1.0, sizes[0]), EVALUATIONS)
