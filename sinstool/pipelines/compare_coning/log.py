"""Coning algorithms compared on a recorded log: from the file to the comparison.

Unlike `process` this holds the whole gyro record (24 bytes a sample): every algorithm runs over
it, and windows of all of them are compared.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.choices import log_choice
from sinstool.core.errors import DataError
from sinstool.core.timeline import SECOND, segments
from sinstool.io.readers import open_log
from sinstool.io.readers.truth import at_times, read_truth
from sinstool.methods.coning.algorithm import of_rates
from sinstool.methods.coning.sp_tuning import SpBounds, SpTuning, bounds, tune
from sinstool.methods.coning.spectrum import ConingSpectrum, coning_spectrum
from sinstool.pipelines.compare_coning.compare import (
    JUDGES,
    REFERENCE,
    Comparison,
    Settings,
    compare,
)
from sinstool.pipelines.compare_coning.runs import Attitudes, Segment
from sinstool.survey.source import Source, prepare, rate_blocks

# Fewer than these in every stretch, and nothing can be said of frequencies
MIN_SPECTRUM = 256
# Intervals of a truth longer than so many of its median ones are not interpolated across
TRUTH_GAP = 3.5
SP = "singular-perturbation"
TUNED = "gyro-tuned"


@dataclass(frozen=True)
class Checks:
    """What was found of the samples before anything was computed.

    Attributes
    ----------
    interval_range_s : tuple of float
        Shortest and longest interval.
    not_finite, repeated_stamps : int
        Samples dropped because a value is no number, or the stamp was there already.
    largest_rate : float
        Largest magnitude on any axis, rad/s.
    """

    interval_range_s: tuple[float, float]
    gaps: int
    gap_total_s: float
    not_finite: int
    repeated_stamps: int
    largest_rate: float


@dataclass(frozen=True)
class LogComparison:
    """A comparison with what is particular to logs.

    Attributes
    ----------
    spectrum : ConingSpectrum or None
        Of the longest stretch.
    passband, stopband : float or None
        Hz.
    tuning : SpTuning or None
    bounds : SpBounds or None
    truth : str
        Where the truth came from, '' without one.
    """

    path: Path
    topic: str
    comparison: Comparison
    spectrum: ConingSpectrum | None
    passband: float | None
    stopband: float | None
    tuning: SpTuning | None
    bounds: SpBounds | None
    truth: str
    checks: Checks
    warnings: tuple[str, ...]
    lost: tuple[str, ...]


def compare_log(
    path: Path,
    config: ProcessConfig,
    settings: Settings,
    *,
    passband: float | None = None,
    stopband: float | None = None,
    gyro_response: str | None = None,
    sp_preset: str = "best",
    truth: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> LogComparison:
    """Compare coning algorithms on a log.

    Parameters
    ----------
    config : ProcessConfig
        Topic, axes and units, as for `process`.
    passband, stopband : float, optional
        Hz; up to which coning is motion, and from which it is noise.
    gyro_response : str, optional
        For ``gyro-tuned``, see :func:`sinstool.methods.coning.gyro_response.gyro_response`.
    sp_preset : {'best', 'paper', 'auto'}
        Of the candidate ``singular-perturbation``.
    truth : str, optional
        A topic of the log or a CSV file with the true attitude, to be the reference.
    progress : callable, optional
        Called with the fraction done.

    Returns
    -------
    LogComparison

    Raises
    ------
    SinstoolError
    """
    log = _read(path, config, truth)
    kind = of_rates(config.input.gyro_kind)
    interval = log.interval
    log_choice("algorithms", ", ".join(settings.algorithms))
    log_choice("reference", _reference(settings, truth))
    log_choice(
        "stretches",
        f"{len(log.stretches)} without a gap, gyro samples taken as {config.input.gyro_kind}",
    )
    _check_bands(path, passband, stopband, interval)
    longest = max(log.stretches, key=len).gyro
    long_enough = len(longest) >= MIN_SPECTRUM
    tuning = tune(longest, interval, kind, passband=passband) if long_enough else None
    limits = bounds(longest, interval, kind) if long_enough else None
    options: dict[str, dict[str, Any]] = dict(settings.options)
    if SP in settings.algorithms:
        options[SP] = _sp_options(sp_preset, tuning)
    if TUNED in settings.algorithms:
        given = {"passband": passband, "stopband": stopband, "gyro_response": gyro_response}
        options[TUNED] = {k: v for k, v in given.items() if v is not None} | {"interval": interval}
    try:
        found = compare(
            log.stretches, kind, interval, replace(settings, options=options), log.truth, progress
        )
    except ValueError as exc:
        raise DataError(path, str(exc), "choose a longer span with --start and --end") from exc
    if limits is not None and limits.status == "noise-limited":
        told = found.verdict
        text = f"{told.text}. Most of the log is little but noise: of motion it tells nothing"
        found = replace(found, verdict=replace(told, text=text))
    warnings = [*log.warnings, *found.warnings]
    if found.duration_s < settings.window_s:
        warnings.append(
            f"the log holds {found.duration_s:.3g} s, less than a window of"
            f" {settings.window_s:g} s: drift is that of its own length"
        )
    if not long_enough:
        warnings.append(
            f"no stretch holds {MIN_SPECTRUM} samples: no spectrum, and no prediction from it"
        )
    elif len(log.stretches) > 1:
        warnings.append(
            f"the spectrum, and so the prediction, is of the longest stretch"
            f" ({len(longest) * interval:.4g} s) only"
        )
    if stopband is None:
        warnings.append("no --stopband is given, so pseudo-coning is not told from coning")
    warnings.append(
        f"content above half the sampling rate ({0.5 / interval:.4g} Hz) is unobservable in this"
        " log: nothing is said of it"
    )
    return LogComparison(
        path,
        log.topic,
        found,
        coning_spectrum(longest, interval, kind) if long_enough else None,
        passband,
        stopband,
        tuning,
        limits,
        log.where,
        log.checks,
        tuple(warnings),
        log.lost,
    )


def _reference(settings: Settings, truth: str | None) -> str:
    """What drift is measured from, and why."""
    if truth is not None:
        return f"{truth}, as told"
    if settings.reference == "auto":
        return f"{REFERENCE}, as there is no --truth; {' and '.join(JUDGES)} judge it"
    return f"{settings.reference}, as told"


@dataclass(frozen=True)
class _Read:
    """What is taken from a log."""

    topic: str
    stretches: list[Segment]
    interval: float
    truth: list[Attitudes] | None
    where: str
    checks: Checks
    warnings: tuple[str, ...]
    lost: tuple[str, ...]


def _read(path: Path, config: ProcessConfig, truth: str | None) -> _Read:
    with open_log(path, config.input.salvage) as log:
        source = prepare(log, config, gyro_only=True)
        stretches, interval = gyro_segments(source, config)
        true, where = None, ""
        if truth is not None:
            times, q_nb, where = read_truth(log, truth, config.input.body_axes)
            true = [truth_at(times, q_nb, stretch) for stretch in stretches]
            if max(len(t.sample) for t in true) < 2:
                raise DataError(
                    path,
                    f"--truth {truth} has no two instants within the samples of"
                    f" {source.imu_topic.topic}",
                    "its times have to be in the clock of the Imu's header stamps",
                )
        survey = source.survey
        low, high = survey.interval_range_ns
        checks = Checks(
            (low / SECOND, high / SECOND),
            survey.gap_count,
            survey.gap_total_s,
            survey.losses.nonfinite,
            survey.order.duplicates,
            float(np.max(survey.gyro_max)),
        )
        return _Read(
            source.imu_topic.topic,
            stretches,
            interval,
            true,
            where,
            checks,
            tuple(map(str, source.findings)),
            tuple(map(str, log.lost)),
        )


def gyro_segments(source: Source, config: ProcessConfig) -> tuple[list[Segment], float]:
    """The whole gyro record, cut at gaps, and its nominal interval in seconds.

    Returns
    -------
    list of Segment
        Increments have become mean rates.
    float
    """
    found = source.survey
    rate = config.input.imu_rate
    nominal = found.interval_ns if rate is None else SECOND / rate
    blocks = rate_blocks(source, config, found.first_ns, nominal)
    times: list[list[np.ndarray]] = []
    gyro: list[list[np.ndarray]] = []
    for piece in segments(blocks, found.max_gap_ns):
        if piece.starts:
            times.append([])
            gyro.append([])
        times[-1].append(piece.imu.time_ns)
        gyro[-1].append(piece.imu.gyro)
    stretches = []
    for t, g in zip(times, gyro, strict=True):
        time_ns = np.concatenate(t)
        if rate is not None:
            time_ns = time_ns[0] + np.rint(np.arange(len(time_ns)) * nominal).astype(np.int64)
        stretches.append(Segment(time_ns, np.concatenate(g)))
    return stretches, nominal / SECOND


def _check_bands(
    path: Path, passband: float | None, stopband: float | None, interval: float
) -> None:
    half = 0.5 / interval
    for flag, band in (("--passband", passband), ("--stopband", stopband)):
        if band is not None and not 0.0 < band < half:
            raise DataError(
                path,
                f"{flag} {band:g} Hz is not between 0 and half the sampling rate ({half:.4g} Hz)",
                "choose another",
            )
    if passband is not None and stopband is not None and stopband <= passband:
        raise DataError(path, "--stopband is not above --passband", "choose another")


def _sp_options(preset: str, tuning: SpTuning | None) -> dict[str, Any]:
    if preset == "auto" and tuning is not None:
        return dict(tuning.options())
    return {"preset": "best" if preset == "auto" else preset}


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
