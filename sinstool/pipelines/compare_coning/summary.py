"""A comparison on a log as plain values: what ``--json``, the terminal, tables and pages show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sinstool.core.result import as_json
from sinstool.methods.coning.registry import algorithm
from sinstool.pipelines.compare_coning.divergence import DEG_H
from sinstool.pipelines.compare_coning.predictions import Prediction, predict
from sinstool.pipelines.compare_coning.row import Row
from sinstool.pipelines.compare_coning.runs import Candidate

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from sinstool.pipelines.compare_coning.log import LogComparison

SCHEMA = "sinstool.compare-coning/1"
SP = "singular-perturbation"
Vector = tuple[float, ...]


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
    """What was compared, and how.

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
class SampleChecks:
    """The log's samples before anything is computed."""

    rate_hz: float
    segments: int
    interval_range_s: Vector
    gaps: int
    gap_total_s: float
    not_finite: int
    repeated_stamps: int
    largest_rate_deg_s: float


@dataclass(frozen=True)
class Reference:
    """What the algorithms are held against.

    Attributes
    ----------
    resolution_dph : float or None
        What it is good to; None for a truth, and where the log is too short to say.
    pred_dph : tuple of float or None
        Its own drift as the spectrum predicts it.
    below_resolution : tuple of str
        Candidates whose drift is not well above its resolution.
    """

    name: str
    is_truth: bool
    resolution_dph: float | None
    pred_dph: Vector | None
    below_resolution: tuple[str, ...]


@dataclass(frozen=True)
class Drift:
    """Drift over windows, deg/h, by axis; ``norm_rms`` and ``slope_rms`` of its size."""

    windows: int
    mean: Vector
    confidence: Vector
    rms: Vector
    p95: Vector
    max: Vector
    norm_rms: float
    slope_rms: float


@dataclass(frozen=True)
class AlgorithmResult:
    """One algorithm at one rate.

    Attributes
    ----------
    input : {'none', 'sums', 'points'}
        How samples were thinned.
    pred_dph, pred_parting_dph, beyond_pred_dph : tuple of float or None
        As the spectrum predicts: drift from the true motion, and from the reference; and what
        the measured mean has beyond the latter.
    pred_exception : str
        Why the prediction cannot hold; '' where it should.
    pseudo_dph : tuple of float or None
        Of ``pred_dph``, what is noise if nothing moves above the stopband.
    """

    name: str
    summary: str
    caveat: str
    update_hz: float
    decimate: int
    input: str
    drift_dph: Drift | None
    slope_dph: Vector
    end_deg: Vector
    largest_deg: float
    resolved: bool
    pred_dph: Vector | None
    pred_parting_dph: Vector | None
    beyond_pred_dph: Vector | None
    pred_exception: str
    pseudo_dph: Vector | None
    ns_per_sample: float

    @property
    def drift(self) -> float | None:
        """Root mean square of the slope over windows, deg/h."""
        return None if self.drift_dph is None else self.drift_dph.slope_rms


@dataclass(frozen=True)
class SpectrumResult:
    """Coning in the longest stretch."""

    coning_rate_dph: Vector
    highest_hz: float
    resolution_hz: float


@dataclass(frozen=True)
class Alias:
    """What a lower rate would fold onto rest."""

    decimate: int
    input: str
    rate_hz: float
    dc_alias_deg: float
    lines_hz: Vector


@dataclass(frozen=True)
class SpTuningResult:
    """Parameters of singular-perturbation tuned to the passband."""

    status: str
    q: float
    epsilon_s: float
    beta_gain: float
    drift_best_dph: Vector
    drift_tuned_dph: Vector


@dataclass(frozen=True)
class SpBoundsResult:
    """The paper's bounds (13) and (15) on this log."""

    status: str
    windows: int
    noise_limited: int
    epsilon_upper_s: Vector
    gain_lower: Vector
    band_hz: Vector


@dataclass(frozen=True)
class SpResult:
    """Singular perturbation on this log."""

    compared: bool
    equivalent: str
    tuning: SpTuningResult
    bounds: SpBoundsResult


@dataclass(frozen=True)
class Choice:
    """Which algorithm to use; see :class:`sinstool.pipelines.compare_coning.verdict.Verdict`."""

    algorithm: str | None
    text: str
    agree: bool
    limit_dph: float | None


@dataclass(frozen=True)
class ComparisonResult:
    """A comparison on a log; fields are the keys of ``--json``."""

    input: Input
    meta: Meta
    checks: SampleChecks
    reference: Reference
    algs: tuple[AlgorithmResult, ...]
    pairs: tuple[Pair, ...]
    spectrum: SpectrumResult | None
    alias: tuple[Alias, ...]
    sp: SpResult | None
    verdict: Choice
    lost: tuple[str, ...]
    warnings: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain values, with the version of their layout."""
        return {"schema": SCHEMA, **as_json(self)}


def summarise(log: LogComparison) -> ComparisonResult:
    """Everything that is printed of a comparison."""
    c = log.comparison
    pairs = tuple(Pair(a, b, float(np.degrees(angle))) for (a, b), angle in c.pairs.items())
    comparable = [p for p in pairs if p.largest_deg == p.largest_deg]
    own = _reference_prediction(log)
    base = own.drift if own is not None else np.zeros(3) if c.reference == "truth" else None
    limit = c.verdict.limit
    return ComparisonResult(
        Input(str(log.path)),
        Meta(
            log=str(log.path),
            imu_topic=log.topic,
            samples=c.samples,
            duration_s=c.duration_s,
            gyro_kind=c.kind,
            window_s=c.settings.window_s,
            passband_hz=log.passband,
            stopband_hz=log.stopband,
            tolerance_dph=c.settings.tolerance * DEG_H,
            widest_pair=max(comparable, key=lambda p: p.largest_deg, default=None),
        ),
        SampleChecks(
            rate_hz=c.rate_hz,
            segments=c.segments,
            interval_range_s=log.checks.interval_range_s,
            gaps=log.checks.gaps,
            gap_total_s=log.checks.gap_total_s,
            not_finite=log.checks.not_finite,
            repeated_stamps=log.checks.repeated_stamps,
            largest_rate_deg_s=float(np.degrees(log.checks.largest_rate)),
        ),
        Reference(
            name=log.truth or c.reference,
            is_truth=bool(log.truth),
            resolution_dph=None
            if c.reference_resolution is None
            else c.reference_resolution * DEG_H,
            pred_dph=None if own is None else _vector(own.drift),
            below_resolution=tuple(
                r.candidate.label for r in c.rows if r.drift is not None and not r.resolved
            ),
        ),
        tuple(_algorithm(row, _prediction(row.candidate, log), base) for row in c.rows),
        pairs,
        None
        if log.spectrum is None
        else SpectrumResult(
            _vector(log.spectrum.coning_rate() * DEG_H),
            0.5 / log.spectrum.interval,
            log.spectrum.step,
        ),
        tuple(
            Alias(e.decimate, e.thinning, e.rate_hz, float(np.degrees(e.dc_alias)), tuple(e.lines))
            for e in c.exposures
        ),
        _sp(log),
        Choice(
            c.verdict.algorithm,
            c.verdict.text,
            c.verdict.agree,
            None if limit is None else limit * DEG_H,
        ),
        log.lost,
        log.warnings,
    )


def _vector(values: ArrayLike) -> Vector:
    return tuple(np.asarray(values, np.float64).tolist())


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
    d = row.drift
    parting = beyond = None
    if prediction is not None and reference_drift is not None:
        parting = prediction.drift - reference_drift
        beyond = None if d is None else _vector(d.mean - parting)
    pseudo = None if prediction is None else prediction.pseudo
    return AlgorithmResult(
        name=row.candidate.name,
        summary=row.candidate.algorithm.summary,
        caveat=row.candidate.algorithm.caveat,
        update_hz=row.update_hz,
        decimate=row.candidate.decimate,
        input=row.candidate.thinning,
        drift_dph=None
        if d is None
        else Drift(
            d.windows,
            _vector(d.mean),
            _vector(d.confidence),
            _vector(d.rms),
            _vector(d.p95),
            _vector(d.largest),
            d.norm_rms,
            d.slope_rms,
        ),
        slope_dph=_vector(row.slope * DEG_H),
        end_deg=_vector(np.degrees(row.end)),
        largest_deg=float(np.degrees(row.largest)),
        resolved=row.resolved,
        pred_dph=None if prediction is None else _vector(prediction.drift),
        pred_parting_dph=None if parting is None else _vector(parting),
        beyond_pred_dph=beyond,
        pred_exception="" if prediction is None else prediction.exception,
        pseudo_dph=None if pseudo is None else _vector(pseudo),
        ns_per_sample=row.ns_per_sample,
    )


def _sp(log: LogComparison) -> SpResult | None:
    tuning, limits = log.tuning, log.bounds
    if tuning is None or limits is None:
        return None
    return SpResult(
        SP in log.comparison.settings.algorithms,
        "phi = p w1 + (T - p) w2 + kappa w1 x w2",
        SpTuningResult(
            tuning.status,
            tuning.q,
            tuning.epsilon,
            tuning.beta_gain,
            _vector(tuning.drift_best * DEG_H),
            _vector(tuning.drift_tuned * DEG_H),
        ),
        SpBoundsResult(
            limits.status,
            limits.windows,
            limits.noise_limited,
            tuple(limits.epsilon_upper),
            tuple(limits.gain_lower),
            tuple(limits.band),
        ),
    )
