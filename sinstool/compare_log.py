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

from sinstool.comparison.compare import Comparison, Settings, compare
from sinstool.comparison.runs import Attitudes, Segment
from sinstool.config import ProcessConfig
from sinstool.coning.increments import GyroKind
from sinstool.coning.sp_tuning import SpBounds, SpTuning, bounds, tune
from sinstool.coning.spectrum import ConingSpectrum, coning_spectrum
from sinstool.errors import DataError
from sinstool.readers import open_log
from sinstool.source import Source, imu_blocks, prepare
from sinstool.timeline import SECOND, mean_rates, segments
from sinstool.truth import at_times, read_truth

# Fewer than these in every stretch, and nothing can be said of frequencies
MIN_SPECTRUM = 256
SP = "singular-perturbation"
TUNED = "gyro-tuned"


@dataclass(frozen=True)
class LogComparison:
    """A comparison with what is particular to logs.

    Attributes
    ----------
    path : Path
    topic : str
    comparison : Comparison
    spectrum : ConingSpectrum or None
        Of the longest stretch.
    passband, stopband : float or None
        Hz.
    tuning : SpTuning or None
    bounds : SpBounds or None
    truth : str
        Where the truth came from, '' without one.
    warnings : tuple of str
    lost : tuple of str
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
    path : Path
    config : ProcessConfig
        Topic, axes and units, as for `process`.
    settings : Settings
    passband, stopband : float, optional
        Hz; up to which coning is motion, and from which it is noise.
    gyro_response : str, optional
        For ``gyro-tuned``, see :func:`sinstool.coning.gyro_response.gyro_response`.
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
    with open_log(path, config.input.salvage) as log:
        source = prepare(log, config)
        stretches, interval = gyro_segments(source, config)
        kind: GyroKind = "rate" if config.input.gyro_kind == "rate" else "mean-rate"
        _check_bands(path, passband, stopband, interval)
        true, where = None, ""
        if truth is not None:
            times, q_nb, where = read_truth(log, truth, config.input.body_axes)
            true = [_truth_at(times, q_nb, stretch) for stretch in stretches]
    longest = max(stretches, key=len).gyro
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
            stretches, kind, interval, replace(settings, options=options), true, progress
        )
    except ValueError as exc:
        raise DataError(path, str(exc), "choose a longer span with --start and --end") from exc
    warnings = [*source.warnings, *found.warnings]
    if stopband is None:
        warnings.append("no --stopband is given, so pseudo-coning is not told from coning")
    warnings.append(
        f"content above half the sampling rate ({0.5 / interval:.4g} Hz) is unobservable in this"
        " log: nothing is said of it"
    )
    return LogComparison(
        path,
        source.topic.topic,
        found,
        coning_spectrum(longest, interval, kind) if long_enough else None,
        passband,
        stopband,
        tuning,
        limits,
        where,
        tuple(warnings),
        tuple(source.log.lost),
    )


def gyro_segments(source: Source, config: ProcessConfig) -> tuple[list[Segment], float]:
    """The whole gyro record, cut at gaps, and its nominal interval in seconds.

    Parameters
    ----------
    source : Source
    config : ProcessConfig

    Returns
    -------
    list of Segment
        Increments have become mean rates.
    float
    """
    found = source.survey
    rate = config.input.imu_rate
    nominal = found.interval_ns if rate is None else SECOND / rate
    blocks = imu_blocks(source, config, found.first_ns)
    if config.input.gyro_kind == "increment":
        blocks = mean_rates(blocks, nominal, found.max_gap_ns)
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


def _truth_at(time_ns: np.ndarray, q_nb: np.ndarray, segment: Segment) -> Attitudes:
    """True attitude at the samples of a segment that lie within the truth."""
    inside = np.flatnonzero((segment.time_ns >= time_ns[0]) & (segment.time_ns <= time_ns[-1]))
    return Attitudes(inside, at_times(time_ns, q_nb, segment.time_ns[inside]), 0.0, len(inside))
