"""A comparison on a log as plain values, for ``--json``, terminal, tables and pages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.finding import Finding
from sinstool.core.result import Result, fields_in
from sinstool.methods.coning.increments import GyroKind
from sinstool.methods.coning.registry import algorithm
from sinstool.methods.coning.response import ConingSpectrum, predicted_drift, pseudo_coning
from sinstool.pipelines.compare_coning.alias import Alias
from sinstool.pipelines.compare_coning.divergence import IN_DEG_H, DriftStatistics, Row
from sinstool.pipelines.compare_coning.log import SP, Checks, LogComparison
from sinstool.pipelines.compare_coning.runs import Candidate
from sinstool.pipelines.compare_coning.verdict import Verdict

# What a candidate is fed with, where that is not what the log holds
KINDS: dict[str, GyroKind] = {"sums": "increment", "points": "rate"}


@dataclass(frozen=True)
class Prediction:
    """Drift of one candidate as predicted from the spectrum.

    Attributes
    ----------
    pred_dph : ndarray, shape (3,)
        Predicted drift against the true attitude. The difference of two candidates is how they
        part from each other; what is held to be motion does not enter there.
    pseudo_dph : ndarray, shape (3,) or None
        Of it, what is noise if nothing moves above the stopband; None without one.
    pred_exception : str
        Why the prediction cannot hold for this candidate; '' where it should.
    """

    pred_dph: FloatArray
    pseudo_dph: FloatArray | None
    pred_exception: str


def predict(
    candidate: Candidate, spectrum: ConingSpectrum, passband: float | None, stopband: float | None
) -> Prediction:
    """Predict a candidate's drift.

    Parameters
    ----------
    spectrum : ConingSpectrum
        Of the log as it is.
    passband, stopband : float or None
        Hz.

    """
    kind = KINDS.get(candidate.input)
    interval = spectrum.interval * candidate.decimate

    drift = IN_DEG_H * predicted_drift(
        spectrum, candidate.algorithm, passband=passband, interval=interval, gyro_kind=kind
    )
    pseudo = None
    if stopband is not None:
        pseudo = IN_DEG_H * pseudo_coning(
            spectrum, candidate.algorithm, stopband, interval=interval, gyro_kind=kind
        )
    return Prediction(drift, pseudo, _exception(candidate))


def _exception(candidate: Candidate) -> str:
    """Known reasons for which the spectrum cannot predict a run."""
    if candidate.algorithm.takes == "rates":
        return "takes rates: its skew in time moves the ends of a run"
    if candidate.algorithm.samples > 1:
        return "several samples an update: frequencies fold at the update rate"
    if candidate.decimate > 1:
        return "decimated: frequencies fold at the lower rate"
    return ""


@dataclass(frozen=True)
class Input:
    """The log."""

    path: str


@dataclass(frozen=True)
class Pair:
    """Two algorithms, and the largest angle between them."""

    first: str
    second: str
    largest_deg: float


@dataclass(frozen=True)
class Meta:
    """Log and settings of the comparison.

    Attributes
    ----------
    widest_pair : Pair or None
        The two that part most; None where no two have instants in common.
    """

    log: str
    imu_topic: str
    samples: int
    duration_s: float
    gyro_kind: str
    window_s: float
    passband_hz: float | None
    stopband_hz: float | None
    tolerance_dph: float
    widest_pair: Pair | None


@dataclass(frozen=True)
class Reference:
    """Reference of the comparison.

    Attributes
    ----------
    resolution_dph : float or None
        What it is good to; None for a truth, and where the log is too short to say.
    pred_dph : ndarray or None
        Its own drift as the spectrum predicts it.
    below_resolution : tuple of str
        Candidates whose drift is not well above its resolution.
    """

    name: str
    is_truth: bool
    resolution_dph: float | None
    pred_dph: FloatArray | None
    below_resolution: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class AlgorithmResult:
    """One algorithm at one rate.

    Attributes
    ----------
    input : {'none', 'sums', 'points'}
        How samples were thinned.
    pred_dph, pred_parting_dph, beyond_pred_dph : ndarray or None
        As the spectrum predicts: drift from the true motion, and from the reference; and what
        the measured mean has beyond the latter.
    pred_exception : str
        Why the prediction cannot hold; '' where it should.
    pseudo_dph : ndarray or None
        Of ``pred_dph``, what is noise if nothing moves above the stopband.
    """

    name: str
    summary: str
    caveat: str
    update_hz: float
    decimate: int
    input: str
    drift_dph: DriftStatistics | None
    slope_dph: FloatArray
    end_deg: FloatArray
    largest_deg: float
    resolved: bool
    pred_dph: FloatArray | None = None
    pred_parting_dph: FloatArray | None = None
    beyond_pred_dph: FloatArray | None = None
    pred_exception: str = ""
    pseudo_dph: FloatArray | None = None
    ns_per_sample: float

    @property
    def drift(self) -> float | None:
        """Root mean square of the slope over windows, deg/h."""
        return None if self.drift_dph is None else self.drift_dph.slope_rms


@dataclass(frozen=True)
class SpectrumResult:
    """Coning in the longest stretch."""

    coning_rate_dph: FloatArray
    highest_hz: float
    resolution_hz: float


@dataclass(frozen=True)
class SpTuningResult:
    """Parameters of singular-perturbation tuned to the passband."""

    status: str
    q: float
    epsilon_s: float
    beta_gain: float
    drift_best_dph: FloatArray
    drift_tuned_dph: FloatArray


@dataclass(frozen=True)
class SpBoundsResult:
    """The paper's bounds (13) and (15) on this log."""

    status: str
    windows: int
    noise_limited: int
    epsilon_upper_s: tuple[float, ...]
    gain_lower: tuple[float, ...]
    band_hz: tuple[float, ...]


@dataclass(frozen=True)
class SpResult:
    """Singular perturbation on this log."""

    compared: bool
    equivalent: str
    tuning: SpTuningResult
    bounds: SpBoundsResult


@dataclass(frozen=True)
class ComparisonResult(Result):
    """A comparison on a log; fields are the keys of ``--json``."""

    SCHEMA = "sinstool.compare-coning/1"

    input: Input
    meta: Meta
    checks: Checks
    reference: Reference
    algs: tuple[AlgorithmResult, ...]
    pairs: tuple[Pair, ...]
    spectrum: SpectrumResult | None
    alias: tuple[Alias, ...]
    sp: SpResult | None
    verdict: Verdict
    lost: tuple[str, ...]
    findings: tuple[Finding, ...]


def summarise(log: LogComparison) -> ComparisonResult:
    """Everything that is printed of a comparison."""
    c = log.comparison
    pairs = tuple(Pair(a, b, float(np.degrees(angle))) for (a, b), angle in c.pairs.items())
    comparable = [p for p in pairs if p.largest_deg == p.largest_deg]
    own = _reference_prediction(log)
    base = own.pred_dph if own is not None else np.zeros(3) if c.reference == "truth" else None
    return ComparisonResult(
        Input(str(log.path)),
        Meta(
            log=str(log.path),
            imu_topic=log.topic,
            samples=c.samples,
            duration_s=c.duration_s,
            gyro_kind=log.gyro_kind,
            window_s=c.settings.window_s,
            passband_hz=log.passband,
            stopband_hz=log.stopband,
            tolerance_dph=c.settings.tolerance * IN_DEG_H,
            widest_pair=max(comparable, key=lambda p: p.largest_deg, default=None),
        ),
        log.checks,
        Reference(
            name=log.truth or c.reference,
            is_truth=bool(log.truth),
            resolution_dph=None
            if c.reference_resolution is None
            else c.reference_resolution * IN_DEG_H,
            pred_dph=None if own is None else own.pred_dph,
            below_resolution=tuple(
                r.candidate.label for r in c.rows if r.drift_dph is not None and not r.resolved
            ),
        ),
        tuple(_algorithm(row, _prediction(row.candidate, log), base) for row in c.rows),
        pairs,
        None
        if log.spectrum is None
        else SpectrumResult(
            log.spectrum.coning_rate() * IN_DEG_H, 0.5 / log.spectrum.interval, log.spectrum.step
        ),
        tuple(Alias(**fields_in(exposure, Alias)) for exposure in c.exposures),
        _sp(log),
        c.verdict,
        log.lost,
        log.findings,
    )


def _reference_prediction(log: LogComparison) -> Prediction | None:
    """Predicted drift of the reference itself; None for a truth, or without a spectrum."""
    name = log.comparison.reference
    if name in ("truth", "none"):
        return None
    options = log.comparison.settings.options.get(name, {})
    return _prediction(Candidate(name, algorithm(name, **options)), log)


def _prediction(candidate: Candidate, log: LogComparison) -> Prediction | None:
    if log.spectrum is None:
        return None
    return predict(candidate, log.spectrum, log.passband, log.stopband)


def _algorithm(
    row: Row, prediction: Prediction | None, reference_drift: np.ndarray | None
) -> AlgorithmResult:
    c, d = row.candidate, row.drift_dph
    values: dict[str, Any] = {}
    for source in (c.algorithm, c, row, prediction):
        values |= fields_in(source, AlgorithmResult)
    if prediction is not None and reference_drift is not None:
        parting = prediction.pred_dph - reference_drift
        values["pred_parting_dph"] = parting
        values["beyond_pred_dph"] = None if d is None else d.mean - parting
    return AlgorithmResult(**values)


def _sp(log: LogComparison) -> SpResult | None:
    tuning, limits = log.tuning, log.bounds
    if tuning is None or limits is None:
        return None
    return SpResult(
        SP in log.comparison.settings.algorithms,
        "phi = p w1 + (T - p) w2 + kappa w1 x w2",
        SpTuningResult(
            **fields_in(tuning, SpTuningResult),
            epsilon_s=tuning.epsilon,
            drift_best_dph=tuning.drift_best * IN_DEG_H,
            drift_tuned_dph=tuning.drift_tuned * IN_DEG_H,
        ),
        SpBoundsResult(
            **fields_in(limits, SpBoundsResult),
            epsilon_upper_s=limits.epsilon_upper,
            band_hz=limits.band,
        ),
    )
