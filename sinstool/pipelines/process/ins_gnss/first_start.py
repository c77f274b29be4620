"""The first start of an INS/GNSS filter: before a run of it shows latency, noise and drift."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.errors import AlignmentError, ConfigurationError, TopicError
from sinstool.core.options import span
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.methods.height.reference import HeightReference
from sinstool.methods.ins_gnss.fix_velocity import message_times, split_position_velocity
from sinstool.methods.ins_gnss.returning_fixes import leaps
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
from sinstool.survey.source import Source

# Latencies with which a start is tried one after the other, s.
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
        Instead of the one that the log shows at rest.
    lag : float, optional
        By which velocities are taken to be stamped later than positions, s, where that has been
        found out already.

    Raises
    ------
    ConfigurationError
        Another rate than the stamps' is to be believed.
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
            "--mode ins-gnss: the log has no GNSS fixes",
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
    """What a filter gets beside the Imu, whatever that is taken for.

    Attributes
    ----------
    fixes : StartFixes
        Of those that are not withheld.
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
        """Of a log; with a lag that was found out already, if it was."""
        model, gnss_why = gnss_model(gnss, config)
        if lag is None:
            lag = config.filter.gnss_velocity_lag
        if lag is None:
            lag = significant_lag(gnss)
        epochs = split_position_velocity(inflate_sigmas(gnss, config), lag)
        withheld = _withheld(message_times(epochs, lag), config, source.survey.first_ns)
        fixes = StartFixes.of(epochs.rows(~withheld), model)
        reference, remarks = barometer(source, config)
        remarks = [*remarks, *_leapt(gnss)]
        return cls(model, gnss_why, lag, epochs, withheld, fixes, reference, remarks)


def _start_as(
    grade: ImuGrade,
    source: Source,
    aligned_by: ProcessConfig,
    config: ProcessConfig,
    aiding: _Aiding,
) -> FilterStart:
    """A first start with an Imu of a grade, which `aligned_by` has where rests show another."""
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
    # Many a log shows no start, and needs nothing of the filter then
    from sinstool.pipelines.process.ins_gnss.between_gaps import start_in_longest

    return start_in_longest(source, config, best)


def _leapt(gnss: GnssEpochs) -> list[str]:
    """Warning about bad first fixes after an outage."""
    off = leaps(gnss)
    bad = int(np.count_nonzero(off))
    if not bad:
        return []
    fixes, lie = ("the first fix", "lies") if bad == 1 else (f"{bad} first fixes", "lie up to")
    return [
        f"{fixes} after an outage {lie} {off.max():.0f} m off the line through the next ones:"
        " this distance is used as the sigma"
    ]


def regraded(
    source: Source, config: ProcessConfig, first: FilterStart, grade: ImuGrade
) -> FilterStart:
    """A first start with an Imu of another grade that is aligned as the one before.

    Parameters
    ----------
    first : FilterStart
        Of :func:`first_start`.
    grade : ImuGrade
        Aligned as that of `first`: the first attitude is the same.
    """
    settings = filter_settings(source, config, grade, first.settings.gnss, first.reference)
    settings = replace(settings, gnss_latency=first.settings.gnss_latency)
    fixes = StartFixes.of(first.used, settings.gnss)
    found = find_start(source, config, settings, fixes, first.alignment)
    return replace(first.at(found), settings=settings, grade=grade)


def as_graded(
    source: Source, config: ProcessConfig, start: FilterStart, grade: ImuGrade
) -> FilterStart:
    """A start with the Imu of another grade, all else as it is."""
    settings = filter_settings(source, config, grade, start.settings.gnss, start.reference)
    settings = replace(start.settings, imu=settings.imu, control=settings.control)
    return replace(start, settings=replace(settings, grade=grade.grade), grade=grade)


def _first_latency(
    source: Source, config: ProcessConfig, settings: Settings, fixes: StartFixes
) -> tuple[float, FoundStart]:
    """The configured latency, else zero, else the first usual latency with which a start succeeds.

    In rough air no attitude fits velocities that are a fifth of a second off. One that fits, but is
    not known well enough, is not known better at another time.
    """
    by_option = config.gnss.gnss_latency
    refused: AlignmentError | None = None
    for latency in FIRST_LATENCIES if by_option is None else (by_option,):
        try:
            timed = replace(settings, gnss_latency=latency)
            return latency, find_start(source, config, timed, fixes)
        except AlignmentError as exc:
            refused = refused or exc
            if exc.uncertain and exc.consistent:
                break  # which another latency makes no better
    assert refused is not None
    try:
        raise refused
    finally:
        del refused  # which holds this frame, with all that was tried, and would be held by it


def _withheld(time_ns: np.ndarray, config: ProcessConfig, first_ns: int) -> np.ndarray:
    """Messages that the user withholds from the filter, to score it."""
    seconds = (time_ns - first_ns) / SECOND
    mask = np.zeros(len(time_ns), np.bool_)
    for text in config.filter.withhold_gnss:
        begin, end = span(text)
        mask |= (seconds >= begin) & (seconds < end)
    return mask
