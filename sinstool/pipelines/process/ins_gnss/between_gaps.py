"""Starts of a filter before and after an IMU gap that is too long to bridge.

How far a vehicle turned in such a gap is unknown, so the attitude is aligned from the data that
follow, as at the start of a log. The estimated sensor errors are carried over. If a log's best
start lies behind a gap, the part before the gap gets a start of its own in the same way, also
before short gaps, which a filter bridges. Latency and noise are estimated where the log shows most
of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.config.align import IN_FLIGHT
from sinstool.core.choices import log_choice
from sinstool.core.errors import AlignmentError, DataError
from sinstool.core.finding import Finding
from sinstool.core.timeline import SECOND
from sinstool.io.readers.frames import turn_body
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.height import layout as height_layout
from sinstool.methods.ins_gnss.filter import FilterSummary, InsGnssFilter
from sinstool.methods.ins_gnss.results import FilterEvent
from sinstool.methods.ins_gnss.settings import Settings, Start
from sinstool.methods.ins_gnss.states import ACCEL_BIAS, GYRO_BIAS
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.initial_state import StartFixes, find_start
from sinstool.pipelines.process.ins_gnss.likeliest_attitude import with_likeliest
from sinstool.pipelines.process.ins_gnss.start_over_gaps import start_over_gaps
from sinstool.pipelines.process.ins_gnss.vehicle import VehicleAssumptions
from sinstool.pipelines.process.vehicle_used import VehicleUsed
from sinstool.survey.grade import to_align_as
from sinstool.survey.imu import Survey
from sinstool.survey.oddities import found_gaps
from sinstool.survey.source import Source, part_of

# Sigma of heading after a gap, rad, beyond which a start is searched for.
LEAST_LOST = 0.5
# Fixes up to this long before a gap's end are used for the start after it.
JUST_BEFORE_NS = 5 * SECOND
# A start is searched for in this part of the log after a gap.
SEARCHED_NS = 600 * SECOND
# A stretch of ENOUGH_S shows latency and noise; if less follows the best start up to a gap, a
# stretch LONGER times as long is used.
ENOUGH_S, LONGER = 400.0, 2.0


@dataclass(frozen=True)
class Stretch:
    """A filter's run from a start to the log's end, or to a gap that it cannot cross.

    Attributes
    ----------
    source : Source
        The log, or its part from the gap on.
    start : FilterStart
        Of the filter.
    filter : InsGnssFilter
        The filter that runs over it.
    vehicle : VehicleAssumptions
        Constraints of the vehicle in it.
    gap : FilterEvent or None
        The gap before.
    """

    source: Source
    start: FilterStart
    filter: InsGnssFilter
    vehicle: VehicleAssumptions
    gap: FilterEvent | None = None


def longest_carried(settings: Settings) -> float:
    """Duration of a gap, s, beyond which a start is searched for after it."""
    return LEAST_LOST / settings.gap_rate if settings.gap_rate > 0.0 else np.inf


def gap_findings(survey: Survey, settings: Settings) -> list[Finding]:
    """Which gaps of the IMU a filter bridges, and which it does not."""
    across_ns = round(settings.max_gap * SECOND)
    if not survey.gap_count or across_ns <= survey.max_gap_ns:
        return []
    return [replace(found_gaps(survey, across_ns), topic=survey.topic)]


def start_before_gaps(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, planned: FilterStart
) -> FilterStart:
    """Start of a filter before the gaps that lie before a log's best start.

    Parameters
    ----------
    planned : FilterStart
        The best start.

    Returns
    -------
    FilterStart
        The first that is found; the best one if there is no such gap, if nothing before it shows an
        attitude, or if options say where to align.
    """
    if _place_configured(config):
        return planned
    first_ns, found = source.survey.first_ns, None
    for last_ns, next_ns in _gaps(source, planned.settings):
        if next_ns > planned.time_ns:
            break
        found = _start_within(source, config, planned, first_ns, last_ns)
        if found is not None:
            break
        first_ns = next_ns
    if found is None:
        return planned
    start = _over_short_gaps(source, config, algorithm, found, first_ns)
    # The filter runs on from there: a wrong attitude would cost what follows, too
    return found if start is found else with_likeliest(source, config, algorithm, start, start)


def before_short_gaps(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, first: FilterStart
) -> FilterStart:
    """A first start before the short gaps that precede it, so that all that follows is judged.

    Parameters
    ----------
    first : FilterStart
        By :func:`~sinstool.pipelines.process.ins_gnss.first_start.first_start`.

    Returns
    -------
    FilterStart
        With `placed` set if it is another.
    """
    if _place_configured(config):
        return first
    behind = [next_ns for _, next_ns in _gaps(source, first.settings) if next_ns <= first.time_ns]
    begin_ns = max([source.survey.first_ns, *behind])
    start = _over_short_gaps(source, config, algorithm, first, begin_ns)
    return first if start is first else replace(start, placed=True)


def _over_short_gaps(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    start: FilterStart,
    first_ns: int,
) -> FilterStart:
    """A start, or an earlier one if it lies behind gaps that a filter bridges.

    Parameters
    ----------
    first_ns : int
        No earlier than this.
    """
    ends = [(ns, ns + round(s * SECOND)) for ns, s in source.survey.gaps if ns > first_ns]
    while before := [last_ns for last_ns, next_ns in ends if next_ns <= start.time_ns]:
        earlier = _start_within(source, config, start, first_ns, before[-1])
        if earlier is None:
            return start_over_gaps(source, config, algorithm, start, first_ns)
        start = earlier
    return start


def start_in_longest(source: Source, config: ProcessConfig, best: FilterStart) -> FilterStart:
    """A start in the stretch of a log that shows most of its receiver and IMU: the longest one.

    Parameters
    ----------
    best : FilterStart
        The best start. It stays if the stretch that follows it is long enough, or if no other start
        is found.
    """
    gaps = _gaps(source, best.settings)
    begins = [source.survey.first_ns, *(next_ns for _, next_ns in gaps)]
    ends = [*(last_ns for last_ns, _ in gaps), source.survey.last_ns]
    own_s = (next(end for end in ends if end >= best.time_ns) - best.time_ns) / SECOND
    first_ns, last_ns = max(zip(begins, ends, strict=True), key=lambda span: span[1] - span[0])
    if (
        own_s > ENOUGH_S
        or last_ns - first_ns < LONGER * own_s * SECOND
        or _place_configured(config)
    ):
        return best
    return _start_within(source, config, best, first_ns, last_ns) or best


def _place_configured(config: ProcessConfig) -> bool:
    """Whether options say where to align, or choose a method that needs no motion."""
    options, method = config.in_flight, config.align.align
    times = (options.align_start, options.align_end, options.lift_off)
    return any(x is not None for x in times) or method not in (*IN_FLIGHT, "auto")


def _start_within(
    source: Source, config: ProcessConfig, like: FilterStart, first_ns: int, last_ns: int
) -> FilterStart | None:
    """A start with the settings of another, in a part of a log; None if that shows no attitude."""
    valid_ns = like.valid_ns
    fixes = like.used.rows((valid_ns >= first_ns) & (valid_ns <= last_ns))
    try:
        part = part_of(source, config, first_ns, last_ns + 1)
        found = find_start(
            part,
            to_align_as(config, like.grade),
            like.settings,
            StartFixes.of(fixes, like.settings.gnss),
            near=like.alignment,
        )
    except (AlignmentError, DataError) as exc:
        log_choice("start between gaps", f"none found: {exc}")
        return None
    log_choice("start between gaps", found.how)
    return like.at(found)


def _gaps(source: Source, settings: Settings) -> list[tuple[int, int]]:
    """Times of the last sample before, and the first after, each gap that is too long, ns."""
    longest = longest_carried(settings)
    return [(ns, ns + round(s * SECOND)) for ns, s in source.survey.gaps if s >= longest]


def start_after_gap(
    source: Source,
    config: ProcessConfig,
    before: Stretch,
    begin_ns: int,
    gap_s: float,
    planned: FilterStart,
) -> tuple[Source, FilterStart] | None:
    """Start of a filter after a gap.

    Parameters
    ----------
    source : Source
        The whole log.
    before : Stretch
        The stretch that ends with the gap.
    begin_ns : int
        Start of the first increment after it.
    gap_s : float
        Its duration, s.
    planned : FilterStart
        The log's best start, which is used if it lies before the next such gap.

    Returns
    -------
    source, start : Source, FilterStart
        The part of the log from there on, and its start. None if that shows no attitude.
    """
    first, run = before.start, before.filter
    trusted = run.summary.restarts == 0
    align = config.align.align
    # A configured attitude holds at the log's first instant only
    options: dict[str, Any] = {"align": align if align in IN_FLIGHT or align == "log" else "auto"}
    if trusted:
        bias = turn_body(run.summary.gyro_bias, config.input.body_axes)
        options["gyro_bias"] = tuple(bias.tolist())
    whole = {"align_start": None, "align_end": None, "lift_off": None}
    here = to_align_as(config, first.grade).model_copy(
        update={
            "align": config.align.model_copy(update=options),
            "in_flight": config.in_flight.model_copy(update=whole),
        }
    )
    following = [last_ns for last_ns, _ in _gaps(source, first.settings) if last_ns >= begin_ns]
    end_ns = min([*following, source.survey.last_ns])
    valid_ns = first.gnss.time_ns - first.late_ns
    try:
        part = part_of(source, config, begin_ns, begin_ns + SEARCHED_NS)
        if begin_ns <= planned.time_ns <= end_ns:
            # With its own noise of fixes: the slow errors by rests are not added twice
            first, start, time_ns, how = planned, planned.start, planned.time_ns, planned.how
        else:
            # Fixes may return later than the IMU; those just before the gap's end show velocities
            after = first.gnss.rows((valid_ns >= begin_ns - JUST_BEFORE_NS) & ~first.withheld)
            found = find_start(
                part, here, first.settings, StartFixes.of(after, first.settings.gnss)
            )
            start, time_ns, how = found.start, found.time_ns, found.how
            if trusted:
                start = _with_sensors(start, run, first.settings, gap_s)
    except (AlignmentError, DataError) as exc:
        log_choice("start after a gap", f"none found: {exc}")
        return None
    log_choice("start after a gap", how)
    later = first.gnss.time_ns - first.late_ns >= time_ns
    return part, replace(
        first,
        start=start,
        time_ns=time_ns,
        how=how,
        gnss=first.gnss.rows(later),
        withheld=first.withheld[later],
    )


def _with_sensors(start: Start, run: InsGnssFilter, settings: Settings, gap_s: float) -> Start:
    """A start with the sensors' biases as a filter knew them before a gap."""
    summary, variance = run.summary, np.diag(run.covariance)
    imu = settings.imu

    def sigma(block: int, instability: float) -> float:
        first = run.kind.first(block)
        walk = 2.0 * instability**2 * gap_s / imu.bias_time_s
        return float(np.sqrt(variance[first : first + 3].max() + walk))

    return replace(
        start,
        gyro_bias=summary.gyro_bias,
        accel_bias=summary.accel_bias,
        gyro_bias_sigma=sigma(GYRO_BIAS, imu.gyro_instability),
        accel_bias_sigma=sigma(ACCEL_BIAS, imu.accel_instability),
    )


def summed(stretches: list[Stretch]) -> FilterSummary:
    """Summary over the filters of all stretches; estimates are those of the last."""
    parts = [stretch.filter.summary for stretch in stretches]
    if len(parts) == 1:
        return parts[0]
    counts = (
        *("updates", "epochs_used", "epochs_gated", "epochs_before_start", "restarts"),
        *("rests", "held", "wheels", "slides", "wheel_slips"),
    )
    rated = [part for part in parts if np.isfinite(part.mean_nis) and part.epochs_used]
    nis = (
        np.average([part.mean_nis for part in rated], weights=[part.epochs_used for part in rated])
        if rated
        else np.nan
    )
    channels = [part.channel for part in parts]
    return replace(
        parts[-1],
        **{name: sum(getattr(part, name) for part in parts) for name in counts},
        mean_nis=float(nis),
        channel=replace(
            channels[-1],
            samples=_added([channel.samples for channel in channels]),
            seconds=_added([channel.seconds for channel in channels]),
        ),
    )


def vehicle_of(stretches: list[Stretch]) -> tuple[VehicleAssumptions, VehicleUsed]:
    """The vehicle by the stretch with most constraints, and its results over all stretches."""
    main = max(stretches, key=lambda s: (s.filter.summary.held, s.filter.summary.rests))
    summary = replace(summed(stretches), land_vehicle=main.filter.summary.land_vehicle)
    used = main.vehicle.used(summary)
    rest_s = sum(stretch.vehicle.rest_s for stretch in stretches)
    return main.vehicle, replace(used, rest_s=rest_s)


def _added(tables: list[dict[str, int]] | list[dict[str, float]]) -> dict[str, Any]:
    return {name: sum(table[name] for table in tables) for name in tables[0]}


def events_of(stretches: list[Stretch]) -> list[FilterEvent]:
    """Events of the filters, including the gaps between them, in order."""
    return [
        event
        for stretch in stretches
        for event in (*([stretch.gap] if stretch.gap else []), *stretch.filter.events)
    ]


def channel_events_of(stretches: list[Stretch]) -> list[height_layout.Event]:
    """Events of the vertical channels; times count from the first start."""
    first_ns = stretches[0].start.time_ns
    return [
        replace(event, time=event.time + (stretch.start.time_ns - first_ns) / SECOND)
        for stretch in stretches
        for event in stretch.filter.channel_events
    ]
