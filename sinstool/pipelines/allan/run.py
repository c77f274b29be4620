"""Noise of the sensors of a log: find its rests, read their samples, fit the terms, judge them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.choices import log_choice
from sinstool.core.errors import DataError
from sinstool.core.progress import share
from sinstool.core.streams import Imu
from sinstool.core.timeline import SECOND
from sinstool.io.readers import open_log
from sinstool.methods.allan.coefficients import AXES, SENSORS, coefficients
from sinstool.methods.allan.fit import NoiseData
from sinstool.methods.allan.likelihood import NoiseFit
from sinstool.methods.allan.model import allan_terms, covariance_of_variances
from sinstool.pipelines.allan.collect import Collected, collect
from sinstool.pipelines.allan.judge import findings
from sinstool.pipelines.allan.result import AllanResult, Axis, Rest, RestStretch, Status
from sinstool.pipelines.log_used import ImuTime, LogFile, Lost
from sinstool.survey.quiet import QuietStretches, quiet_stretches, sway
from sinstool.survey.source import Source, prepare

# A rest that is shorter says nothing worth a file.
LEAST_S = 10.0
# So many levels, and an axis with more than this share of its samples at one end of them is cut
# off there: noise has few at its ends.
LEVELS = 8.0
CLIPPED = 0.02


@dataclass(frozen=True)
class LogNoise:
    """The result with the fits behind it, for figures.

    Attributes
    ----------
    fits : tuple of (NoiseFit or None)
        Of the gyro's axes, then of the accelerometer's; in units of samples.
    lags : ndarray of int64, shape (k,)
        Averaging times of the result in samples.
    lengths : tuple of int
        Samples of each stretch.
    """

    result: AllanResult
    fits: tuple[NoiseFit | None, ...]
    lags: IntArray
    lengths: tuple[int, ...]

    def band(self, axis: Axis) -> tuple[FloatArray, FloatArray]:
        """Edges of the 95 % interval of each Allan deviation of an axis.

        A variance counts as chi-squared with the freedom that its mean and its variance by the
        fitted terms give it (Riley, NIST SP 1065, section 5.3).
        """
        from scipy.special import chdtri

        fit = self.fits[self.result.axes.index(axis)]
        assert fit is not None
        octaves = 1 << np.arange(int(self.lags[-1]).bit_length())
        octaves = octaves[octaves <= self.lags[-1]]
        covariance = covariance_of_variances(octaves, self.lengths)
        variances = np.maximum(fit.variances, 0.0)
        expected = allan_terms(octaves) @ variances
        scatter = np.einsum("iikl,k,l->i", covariance, variances, variances)
        logarithm = np.interp(
            np.log(self.lags), np.log(octaves), np.log(2.0 * expected**2 / scatter)
        )
        freedom = np.maximum(np.exp(logarithm), 1.0)
        low, high = (np.sqrt(freedom / chdtri(freedom, tail)) for tail in (0.025, 0.975))
        return axis.deviation * low, axis.deviation * high


def measure(
    path: Path, config: ProcessConfig, progress: Callable[[float], None] | None = None
) -> LogNoise:
    """Measure the noise of a log's IMU where it rests.

    Parameters
    ----------
    config : ProcessConfig
        Group ``input``.
    progress : callable, optional
        Called with the fraction done.

    Raises
    ------
    SinstoolError
        The log cannot be read, or does not rest for long enough.
    """
    with open_log(path, config.input.salvage) as log:
        source = prepare(log, config, share(progress, log.size, 0.0, 0.6))
        _forget_log_times(source)
        quiet = quiet_stretches(source.survey, source.aiding.gnss)
        if sum(s.duration_s for s in quiet.stretches) < LEAST_S:
            raise _no_rest(source, quiet)
        at_rest = collect(source, config, quiet.stretches, share(progress, log.size, 0.6, 0.3))
        lost = Lost.of(source)
    statuses = [_status(at_rest, column) for column in range(6)]
    if "measured" not in statuses:
        raise DataError(
            path,
            f"no axis of {source.imu_topic.topic} shows noise where it rests: each never changes or"
            " is cut off",
            "look at its values: the log may be simulated without noise, or rounded off",
        )
    data = NoiseData(at_rest.variances, at_rest.lengths, at_rest.phases, at_rest.block)
    fits = [
        data.fit(column, float(at_rest.step[column])) if status == "measured" else None
        for column, status in enumerate(statuses)
    ]
    axes = tuple(
        _axis(at_rest, column, fits[column], status) for column, status in enumerate(statuses)
    )
    rest = _rest(source, quiet, at_rest)
    starts = ", ".join(f"{one.start_s:.1f} s" for one in rest.stretches[:10])
    log_choice("rests", f"{rest.total_s:.1f} s in all, from {starts}")
    lags = at_rest.variances.terms > 0
    force = float(np.median([np.linalg.norm(s.accel) for s in quiet.stretches]))
    judged = findings(axes, fits, data, rest, at_rest, force)
    # A finding about the rest includes that of the survey of the same kind
    said = {finding.kind for finding in judged}
    survey = (finding for finding in source.findings if finding.kind not in said)
    result = AllanResult(
        input=LogFile(str(path), source.log.size),
        imu=ImuTime.of(source),
        rest=rest,
        averaging_s=at_rest.variances.lags[lags] * at_rest.interval,
        terms=at_rest.variances.terms[lags],
        axes=axes,
        findings=(*survey, *judged, *lost.findings()),
    )
    return LogNoise(result, tuple(fits), at_rest.variances.lags[lags], at_rest.lengths)


def _forget_log_times(source: Source) -> None:
    """Let go of the times of the recorder, which nobody asks for again: a sixth of all samples."""
    blocks = source.samples.blocks
    for k, block in enumerate(blocks or ()):
        assert blocks is not None
        blocks[k] = Imu(block.time_ns, block.time_ns, block.gyro, block.accel)


def _no_rest(source: Source, quiet: QuietStretches) -> DataError:
    """Error for a log without a usable rest, with advice."""
    longest = max((s.duration_s for s in quiet.stretches), default=0.0)
    why = f"it rests for {longest:.1f} s at most" if longest else "it never rests for 5 s"
    if quiet.moving_s > LEAST_S:
        why += f", and where the IMU seems at rest for {quiet.moving_s:.0f} s, GNSS moves"
    if quiet.shaken_s > LEAST_S:
        why += f", and {quiet.shaken_s:.0f} s of rest are left out for knocks or shaking"
    windows = source.survey.windows
    answer = "record it lying still for some minutes at least, better for hours"
    if len(windows) and float(np.median(windows.accel_std)) < 0.5 * float(
        np.median(windows.gyro_std)
    ):
        answer += "; if it did lie still, the gyro may be in deg/s: --gyro-unit deg/s"
    return DataError(
        source.path,
        f"the noise of {source.imu_topic.topic} can only be measured where the IMU rests, for"
        f" {LEAST_S:g} s at least: {why}",
        answer,
    )


def _status(at_rest: Collected, column: int) -> Status:
    """Whether noise can be measured on an axis."""
    low, high = at_rest.range[column]
    if not high > low:
        return "dead"
    levels = (high - low) / at_rest.step[column]
    if levels >= LEVELS and float(np.max(at_rest.at_ends[column])) > CLIPPED:
        return "clipped"
    return "measured"


def _axis(at_rest: Collected, column: int, fit: NoiseFit | None, status: Status) -> Axis:
    lags = at_rest.variances.terms > 0
    deviation = np.sqrt(at_rest.variances.allan[lags, column])
    hadamard = np.sqrt(at_rest.variances.hadamard[lags, column])
    if fit is None and status == "measured":
        status = "too-short"
    return Axis(
        sensor=SENSORS[column // 3],
        axis=AXES[column % 3],
        status=status,
        coefficients={} if fit is None else coefficients(fit, at_rest.interval),
        from_s=(1 if fit is None else fit.from_lag) * at_rest.interval,
        misfit=1.0 if fit is None else fit.misfit,
        deviation=deviation,
        hadamard=hadamard,
    )


def _rest(source: Source, quiet: QuietStretches, at_rest: Collected) -> Rest:
    durations = [n * at_rest.interval for n in at_rest.lengths]
    first = source.survey.first_ns
    return Rest(
        samples=at_rest.samples,
        interval_s=at_rest.interval,
        total_s=sum(durations),
        longest_s=max(durations),
        shaken_s=quiet.shaken_s,
        moving_s=quiet.moving_s,
        sway_rad_s=sway(source.survey, quiet.stretches),
        stretches=tuple(
            RestStretch((start - first) / SECOND, duration)
            for start, duration in zip(at_rest.starts_ns, durations, strict=True)
        ),
    )
