"""Coning algorithms compared on a recorded log: from the file to the comparison.

Unlike `process` this holds the whole gyro record (24 bytes a sample): every algorithm runs over
it, and windows of all of them are compared.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sinstool.config import ComparisonOptions, ConingOptions, ProcessConfig
from sinstool.core.choices import log_choice
from sinstool.core.english import in_seconds
from sinstool.core.errors import DataError
from sinstool.core.finding import Finding, Severity
from sinstool.core.timeline import SECOND, segments
from sinstool.io.readers import open_log
from sinstool.io.readers.truth import at_times, read_truth
from sinstool.methods.coning.algorithm import of_rates
from sinstool.methods.coning.response import ConingSpectrum, coning_spectrum
from sinstool.methods.coning.sp_tuning import SpBounds, SpTuning, bounds, tune
from sinstool.pipelines.compare_coning.compare import (
    DEFAULT_ALGORITHMS,
    JUDGES,
    REFERENCE,
    Comparison,
    Settings,
    compare,
)
from sinstool.pipelines.compare_coning.divergence import IN_DEG_H
from sinstool.pipelines.compare_coning.runs import Attitudes, Segment
from sinstool.survey.imu import Survey
from sinstool.survey.source import Source, nominal_interval, prepare, rate_blocks

# Fewer than these in every stretch, and nothing can be said of frequencies
MIN_SPECTRUM = 256
# Intervals of a truth longer than so many of its median ones are not interpolated across
TRUTH_GAP = 3.5
SP = "singular-perturbation"
TUNED = "gyro-tuned"


@dataclass(frozen=True)
class Checks:
    """The log's samples before anything is computed.

    Attributes
    ----------
    interval_range_s : tuple of float
        Shortest and longest interval.
    not_finite, repeated_stamps : int
        Samples dropped because a value is no number, or the stamp was there already.
    largest_rate_deg_s : float
        Largest magnitude on any axis.
    """

    rate_hz: float
    segments: int
    interval_range_s: tuple[float, float]
    gaps: int
    gap_total_s: float
    not_finite: int
    repeated_stamps: int
    largest_rate_deg_s: float


@dataclass(frozen=True)
class LogComparison:
    """A comparison on a log, with its spectrum, checks and findings.

    Attributes
    ----------
    gyro_kind : {'rate', 'mean-rate', 'increment'}
        Of the samples in the log.
    spectrum : ConingSpectrum or None
        Of the longest stretch.
    passband, stopband : float or None
        Hz.
    truth : str
        Where the truth came from, '' without one.
    """

    path: Path
    topic: str
    gyro_kind: str
    comparison: Comparison
    spectrum: ConingSpectrum | None
    passband: float | None
    stopband: float | None
    tuning: SpTuning | None
    bounds: SpBounds | None
    truth: str
    checks: Checks
    findings: tuple[Finding, ...]
    lost: tuple[str, ...]


def compare_log(
    path: Path, config: ProcessConfig, progress: Callable[[float], None] | None = None
) -> LogComparison:
    """Compare coning algorithms on a log.

    Parameters
    ----------
    config : ProcessConfig
        Groups ``input`` and ``comparison``; of ``coning`` the bands, the gyro's response and the
        preset of ``singular-perturbation``.
    progress : callable, optional
        Called with the fraction done.

    Raises
    ------
    SinstoolError
    """
    options, bands = config.comparison, config.coning
    with open_log(path, config.input.salvage) as log:
        source = prepare(log, config, gyro_only=True)
        stretches, interval = gyro_segments(source, config)
        truth = _read_truth(source, stretches, config)
    kind = of_rates(config.input.sample_kind)
    algorithms = options.algorithms or DEFAULT_ALGORITHMS
    log_choice("algorithms", ", ".join(algorithms))
    log_choice("reference", _reference(options))
    log_choice(
        "stretches",
        f"{len(stretches)} without a gap, gyro samples taken as {config.input.sample_kind}",
    )
    _check_bands(path, bands, interval)
    longest = max(stretches, key=len).gyro
    long_enough = len(longest) >= MIN_SPECTRUM
    tuning = tune(longest, interval, kind, passband=bands.passband) if long_enough else None
    limits = None
    if long_enough:
        # Samples may be too far apart for their band
        with suppress(ValueError):
            limits = bounds(longest, interval, kind)
    settings = Settings(
        algorithms,
        options.reference,
        options.decimate,
        options.window,
        options.tolerance / IN_DEG_H,
        _algorithm_options(bands, tuning, interval),
    )
    try:
        comparison = compare(stretches, kind, interval, settings, truth, progress)
    except ValueError as exc:
        raise DataError(path, str(exc), "choose a longer span with --start and --end") from exc
    lost = tuple(map(str, log.lost))
    findings = [*source.findings, *comparison.findings]
    findings += [Finding("lost-part", f"lost: {part}", Severity.LOST) for part in lost]
    findings += _limits_of(comparison, config, stretches, interval)
    return LogComparison(
        path,
        source.imu_topic.topic,
        config.input.sample_kind,
        _with_caution(comparison, limits),
        coning_spectrum(longest, interval, kind) if long_enough else None,
        bands.passband,
        bands.stopband,
        tuning,
        limits,
        options.truth or "",
        _checks(comparison, source.survey),
        tuple(findings),
        lost,
    )


def _with_caution(comparison: Comparison, limits: SpBounds | None) -> Comparison:
    """The same, with what its verdict holds for if most of the log is as noise is."""
    if limits is None or limits.status != "noise-limited":
        return comparison
    verdict = comparison.verdict
    text = (
        f"{verdict.text}. Most of the log is as noise is, up to half its rate, so this holds"
        " only for rest; if it is vibration, it is sampled too slowly for any algorithm"
    )
    return replace(comparison, verdict=replace(verdict, text=text))


def _checks(comparison: Comparison, survey: Survey) -> Checks:
    low, high = survey.interval_range_ns
    return Checks(
        comparison.rate_hz,
        comparison.segments,
        (low / SECOND, high / SECOND),
        survey.gap_count,
        survey.gap_total_s,
        survey.losses.nonfinite,
        survey.order.duplicates,
        float(np.degrees(np.max(survey.gyro_max))),
    )


def _limits_of(
    comparison: Comparison, config: ProcessConfig, stretches: Sequence[Segment], interval: float
) -> Iterator[Finding]:
    """What this log, by its length and rate, cannot show."""
    window = config.comparison.window
    if comparison.duration_s < window:
        text = (
            f"the log holds {comparison.duration_s:.3g} s, less than one window of"
            f" {window:g} s, so drift is measured over all of it"
        )
        yield Finding("short-log", text, answer="choose a shorter --window")
    longest = max(map(len, stretches))
    if longest < MIN_SPECTRUM:
        text = f"no stretch holds {MIN_SPECTRUM} samples: no spectrum and no predicted drift"
        yield Finding("no-spectrum", text)
    elif len(stretches) > 1:
        text = (
            "the spectrum and the predicted drift come from the longest stretch only"
            f" ({in_seconds(longest * interval)})"
        )
        yield Finding("longest-stretch", text)
    if config.coning.stopband is None:
        text = "pseudo-coning cannot be told from coning without --stopband"
        yield Finding("no-stopband", text, Severity.NOTE)
    text = f"the log shows nothing above half its sampling rate ({0.5 / interval:.4g} Hz)"
    yield Finding("sampling-limit", text, Severity.NOTE)


def _reference(options: ComparisonOptions) -> str:
    """Reference for the drift, and why it was chosen."""
    if options.truth is not None:
        return f"{options.truth}, as specified"
    if options.reference == "auto":
        return f"{REFERENCE}, as there is no --truth; {' and '.join(JUDGES)} judge it"
    return f"{options.reference}, as specified"


def _read_truth(
    source: Source, stretches: list[Segment], config: ProcessConfig
) -> list[Attitudes] | None:
    """True attitude of each stretch, where there is a truth."""
    topic_or_file = config.comparison.truth
    if topic_or_file is None:
        return None
    times, q_nb = read_truth(source.log, topic_or_file, config.input.body_axes)
    truth = [truth_at(times, q_nb, stretch) for stretch in stretches]
    if max(len(t.sample) for t in truth) < 2:
        raise DataError(
            source.path,
            f"--truth {topic_or_file} has no two instants within the samples of"
            f" {source.imu_topic.topic}",
            "its times have to be in the clock of the IMU's header stamps",
        )
    return truth


def gyro_segments(source: Source, config: ProcessConfig) -> tuple[list[Segment], float]:
    """The whole gyro record, cut at gaps, and its nominal interval in seconds.

    Returns
    -------
    list of Segment
        Increments have become mean rates.
    float
    """
    survey = source.survey
    nominal = nominal_interval(source, config)
    blocks = rate_blocks(source, config, survey.first_ns)
    times: list[list[np.ndarray]] = []
    gyro: list[list[np.ndarray]] = []
    for piece in segments(blocks, survey.max_gap_ns):
        if piece.starts:
            times.append([])
            gyro.append([])
        times[-1].append(piece.imu.time_ns)
        gyro[-1].append(piece.imu.gyro)
    stretches = []
    for t, g in zip(times, gyro, strict=True):
        time_ns = np.concatenate(t)
        if config.input.imu_rate is not None:
            time_ns = time_ns[0] + np.rint(np.arange(len(time_ns)) * nominal).astype(np.int64)
        stretches.append(Segment(time_ns, np.concatenate(g)))
    return stretches, nominal / SECOND


def _check_bands(path: Path, bands: ConingOptions, interval: float) -> None:
    half = 0.5 / interval
    for flag, band in (("--passband", bands.passband), ("--stopband", bands.stopband)):
        if band is not None and not band < half:
            raise DataError(
                path,
                f"{flag} {band:g} Hz is not between 0 and half the sampling rate ({half:.4g} Hz)",
                "choose another",
            )
    low, high = bands.passband, bands.stopband
    if low is not None and high is not None and high <= low:
        raise DataError(path, "--stopband is not above --passband", "choose another")


def _algorithm_options(
    coning: ConingOptions, tuning: SpTuning | None, interval: float
) -> dict[str, dict[str, Any]]:
    """Options of the algorithms that take any."""
    preset = coning.sp_preset or "best"
    if preset == "auto" and tuning is not None:
        sp = dict(tuning.options())
    else:
        sp = {"preset": "best" if preset == "auto" else preset}
    response = {name: getattr(coning, name) for name in ("passband", "stopband", "gyro_response")}
    tuned = {name: value for name, value in response.items() if value is not None}
    return {SP: sp, TUNED: tuned | {"interval": interval}}


def truth_at(time_ns: np.ndarray, q_nb: np.ndarray, segment: Segment) -> Attitudes:
    """True attitude at the samples of a segment that the truth covers.

    Parameters
    ----------
    time_ns : ndarray of int64, shape (k,)
        Of the truth, increasing.
    q_nb : ndarray, shape (k, 4)

    Returns
    -------
    Attitudes
        Nothing is said where the truth itself has a gap of more than three of its intervals.
    """
    place = np.searchsorted(time_ns, segment.time_ns)
    inside = (place > 0) & (place < len(time_ns))
    before, after = np.clip(place - 1, 0, None), np.clip(place, None, len(time_ns) - 1)
    widest = TRUTH_GAP * float(np.median(np.diff(time_ns)))
    inside &= time_ns[after] - time_ns[before] <= widest
    inside |= time_ns[after] == segment.time_ns
    rows = np.flatnonzero(inside)
    return Attitudes(rows, at_times(time_ns, q_nb, segment.time_ns[rows]), 0.0, len(rows))
