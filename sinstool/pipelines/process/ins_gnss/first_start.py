"""The first start of an INS/GNSS filter, before runs of it show latency, noise and drift."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.errors import AlignmentError, ConfigurationError, TopicError
from sinstool.core.options import span
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.io.readers.message_types import FIX_TYPES
from sinstool.io.readers.topics import unread_clause
from sinstool.methods.height.reference import HeightReference
from sinstool.methods.ins_gnss.fix_velocity import message_times, split_position_velocity
from sinstool.methods.ins_gnss.returning_fixes import leaps, unsettled
from sinstool.methods.ins_gnss.settings import GnssModel, Settings
from sinstool.pipelines.process.ins_gnss.filter_settings import (
    barometer,
    filter_settings,
    too_good,
)
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.initial_state import FoundStart, StartFixes, find_start
from sinstool.pipelines.process.ins_gnss.receiver import gnss_model, inflate_sigmas
from sinstool.pipelines.process.ins_gnss.timing import significant_lag
from sinstool.survey.grade import ImuGrade, sensor_grade, to_align_as
from sinstool.survey.rough_latency import rough_latency
from sinstool.survey.source import Source

# Latencies, s, tried in this order until one gives a start, and after them a rough estimate.
FIRST_LATENCIES = (0.0, 0.15, -0.15)


def first_start(
    source: Source,
    config: ProcessConfig,
    grade: ImuGrade | None = None,
    lag: float | None = None,
) -> FilterStart:
    """Settings, start and measurements of a filter run, with the configured latency or zero.

    Parameters
    ----------
    grade : ImuGrade, optional
        In place of the one that the log shows at rest.
    lag : float, optional
        By which velocities are stamped later than positions, s, if it was estimated already.

    Raises
    ------
    ConfigurationError
        With ``--imu-rate``, which ignores the stamps.
    TopicError, AlignmentError
        The log has no GNSS, or it shows no start.
    """
    if config.input.imu_rate is not None:
        raise ConfigurationError(
            f"{source.path}: --imu-rate with --mode ins-gnss: only stamps tell which fix belongs"
            " to which sample",
            "leave --imu-rate out, or give --mode ins or attitude",
        )
    gnss = source.aiding.gnss
    if gnss is None or not gnss.has_position.any():
        raise TopicError(
            source.path,
            "--mode ins-gnss: the log has no GNSS fixes" + unread_clause(source.log, *FIX_TYPES),
            "use --mode ins (with --height-damping), or attitude",
        )
    aiding = _Aiding.of(source, config, gnss, lag)
    if grade is not None:
        return _start_as(grade, source, to_align_as(config, grade), config, aiding)
    judged = sensor_grade(source, config)
    try:
        return _start_as(judged, source, config, config, aiding)
    except AlignmentError:
        if judged.grade != "mems" or config.navigation.imu_grade != "auto":
            raise
        bare = ImuGrade("consumer", "as no start fits the accelerometers of a calibrated one")
        with suppress(AlignmentError):
            return _start_as(bare, source, to_align_as(config, bare), config, aiding)
        raise


@dataclass(frozen=True)
class _Aiding:
    """Measurements of a filter beside the IMU, which do not depend on its grade.

    Attributes
    ----------
    model, gnss_why : GnssModel, str
        Noise of the fixes, and its source in words.
    lag : float
        By which velocities are stamped later than positions, s.
    epochs, withheld : GnssEpochs, ndarray of bool
        All epochs, and which are scored, not used.
    fixes : StartFixes
        Those that are not withheld.
    reference : HeightReference or None
        Barometer heights.
    remarks : list of str
        Warnings about barometer and fixes.
    """

    model: GnssModel
    gnss_why: str
    lag: float
    epochs: GnssEpochs
    withheld: np.ndarray
    fixes: StartFixes
    reference: HeightReference | None
    remarks: list[str]

    @classmethod
    def of(
        cls, source: Source, config: ProcessConfig, gnss: GnssEpochs, lag: float | None
    ) -> _Aiding:
        """Of a log; `lag` is estimated if it is None and not configured."""
        model, gnss_why = gnss_model(gnss, config)
        if lag is None:
            lag = config.filter.gnss_velocity_lag
        if lag is None:
            lag = significant_lag(gnss)
        epochs = split_position_velocity(inflate_sigmas(gnss, config), lag)
        withheld = _withheld(message_times(epochs, lag), config, source.survey.first_ns)
        fixes = StartFixes.of(epochs.rows(~withheld), model)
        reference, remarks = barometer(source, config)
        remarks = [*remarks, *_first_fix_warnings(gnss)]
        return cls(model, gnss_why, lag, epochs, withheld, fixes, reference, remarks)


def _start_as(
    grade: ImuGrade,
    source: Source,
    aligned_by: ProcessConfig,
    config: ProcessConfig,
    aiding: _Aiding,
) -> FilterStart:
    """A first start with a grade of the IMU; `aligned_by` is the configuration for alignment."""
    settings = filter_settings(source, config, grade, aiding.model, aiding.reference)
    latency, found = _first_latency(source, aligned_by, settings, aiding.fixes)
    best = FilterStart(
        replace(settings, gnss_latency=latency),
        found.start,
        found.time_ns,
        found.how,
        found.alignment,
        aiding.epochs,
        aiding.withheld,
        aiding.reference,
        None,
        "not observable",
        aiding.lag,
        grade,
        aiding.gnss_why,
        (*too_good(source, config, settings), *aiding.remarks),
    )
    # Imported here, as many logs show no start and then need no filter
    from sinstool.pipelines.process.ins_gnss.between_gaps import start_in_longest

    return start_in_longest(source, config, best)


def _first_fix_warnings(gnss: GnssEpochs) -> list[str]:
    """Warnings about bad first fixes, of the log or after an outage."""
    texts = []
    for off, where, used in (
        (leaps(gnss), "the line through the next ones", "this distance is used as the sigma"),
        (
            unsettled(gnss),
            "the track that later fixes and the receiver's velocities show",
            "together they count as one fix with this distance as its sigma",
        ),
    ):
        bad = int(np.count_nonzero(off))
        fixes, lie = ("the first fix", "lies") if bad == 1 else (f"{bad} first fixes", "lie up to")
        if bad:
            texts.append(
                f"{fixes} of the log or after an outage {lie} {off.max():.0f} m off {where}: {used}"
            )
    return texts


def regraded(
    source: Source, config: ProcessConfig, first: FilterStart, grade: ImuGrade
) -> FilterStart:
    """A first start with another grade of the IMU, but the first attitude of the one before.

    Parameters
    ----------
    first : FilterStart
        By :func:`first_start`, with that attitude.
    """
    settings = filter_settings(source, config, grade, first.settings.gnss, first.reference)
    settings = replace(settings, gnss_latency=first.settings.gnss_latency)
    other = replace(first, settings=settings, grade=grade)
    return other.from_attitude(source, config, first.alignment)


def as_graded(
    source: Source, config: ProcessConfig, start: FilterStart, grade: ImuGrade
) -> FilterStart:
    """A start with another grade of the IMU, everything else unchanged."""
    settings = filter_settings(source, config, grade, start.settings.gnss, start.reference)
    settings = replace(start.settings, imu=settings.imu, control=settings.control)
    return replace(start, settings=replace(settings, grade=grade.grade), grade=grade)


def _first_latency(
    source: Source, config: ProcessConfig, settings: Settings, fixes: StartFixes
) -> tuple[float, FoundStart]:
    """The configured latency, or the first one with a start; and that start.

    In rough air no attitude fits velocities that are late by a fifth of a second. An attitude that
    fits but is too uncertain would be as uncertain with another latency.
    """
    refused: AlignmentError | None = None
    for latency in _latencies(source, config):
        try:
            timed = replace(settings, gnss_latency=latency)
            return latency, find_start(source, config, timed, fixes)
        except AlignmentError as exc:
            refused = refused or exc
            if exc.uncertain and exc.consistent:
                break  # another latency makes it no more certain
    assert refused is not None
    try:
        raise refused
    finally:
        del refused  # it refers to this frame, which refers to it


def _latencies(source: Source, config: ProcessConfig) -> Iterator[float]:
    """The configured latency, or those to try, s."""
    if config.gnss.gnss_latency is not None:
        yield config.gnss.gnss_latency
        return
    yield from FIRST_LATENCIES
    rough = rough_latency(source.survey.windows, source.aiding.gnss)
    if rough is not None:
        yield rough


def _withheld(time_ns: np.ndarray, config: ProcessConfig, first_ns: int) -> np.ndarray:
    """Messages within ``--withhold-gnss``."""
    seconds = (time_ns - first_ns) / SECOND
    mask = np.zeros(len(time_ns), np.bool_)
    for text in config.filter.withhold_gnss:
        begin, end = span(text)
        mask |= (seconds >= begin) & (seconds < end)
    return mask
