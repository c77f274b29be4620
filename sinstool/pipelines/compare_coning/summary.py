"""A comparison on a log as plain values, and as figures."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sinstool.methods.coning.registry import algorithm
from sinstool.pipelines.compare_coning.divergence import DEG_H
from sinstool.pipelines.compare_coning.predictions import Prediction, predict
from sinstool.pipelines.compare_coning.row import Row
from sinstool.pipelines.compare_coning.runs import Candidate

if TYPE_CHECKING:
    from sinstool.pipelines.compare_coning.log import LogComparison

AXES = ("x", "y", "z")
SP = "singular-perturbation"
# Curves of the gain are drawn up to where the sampled motion ceases to be one
HIGHEST_SHARE = 0.49


def reference_prediction(found: LogComparison) -> Prediction | None:
    """Predicted drift of the reference itself; None for a truth, or without a spectrum."""
    c = found.comparison
    if found.spectrum is None or c.reference in ("truth", "none"):
        return None
    options = c.settings.options.get(c.reference, {})
    reference = Candidate(c.reference, algorithm(c.reference, **options))
    return predict(reference, found.spectrum, found.passband, found.stopband)


def predictions(found: LogComparison) -> list[Prediction | None]:
    """Predicted drift of each row; None without a spectrum."""
    if found.spectrum is None:
        return [None] * len(found.comparison.rows)
    return [
        predict(row.candidate, found.spectrum, found.passband, found.stopband)
        for row in found.comparison.rows
    ]


def as_object(found: LogComparison) -> dict[str, Any]:
    """Everything that is printed, as plain values.

    Returns
    -------
    dict
        Keys ``meta, checks, reference, algs, pairs, spectrum, alias, sp, verdict, lost,
        warnings``.
    """
    c = found.comparison
    resolution = None if c.reference_resolution is None else c.reference_resolution * DEG_H
    pairs: list[dict[str, Any]] = [
        {"first": a, "second": b, "largest_deg": float(np.degrees(angle))}
        for (a, b), angle in c.pairs.items()
    ]
    own = reference_prediction(found)
    base = own.drift if own is not None else np.zeros(3) if c.reference == "truth" else None
    return {
        "meta": {
            "log": str(found.path),
            "imu_topic": found.topic,
            "samples": c.samples,
            "duration_s": c.duration_s,
            "gyro_kind": c.kind,
            "window_s": c.settings.window_s,
            "passband_hz": found.passband,
            "stopband_hz": found.stopband,
            "tolerance_dph": c.settings.tolerance * DEG_H,
            "widest_pair": max(
                (p for p in pairs if p["largest_deg"] == p["largest_deg"]),
                key=lambda p: p["largest_deg"],
                default=None,
            ),
        },
        "checks": {
            "rate_hz": c.rate_hz,
            "segments": c.segments,
            "interval_range_s": list(found.checks.interval_range_s),
            "gaps": found.checks.gaps,
            "gap_total_s": found.checks.gap_total_s,
            "not_finite": found.checks.not_finite,
            "repeated_stamps": found.checks.repeated_stamps,
            "largest_rate_deg_s": float(np.degrees(found.checks.largest_rate)),
        },
        "reference": {
            "name": found.truth or c.reference,
            "is_truth": bool(found.truth),
            "resolution_dph": resolution,
            "pred_dph": None if own is None else own.drift.tolist(),
            "below_resolution": [
                r.candidate.label for r in c.rows if r.drift is not None and not r.resolved
            ],
        },
        "algs": [_row(r, p, base) for r, p in zip(c.rows, predictions(found), strict=True)],
        "pairs": pairs,
        "spectrum": _spectrum(found),
        "alias": [
            {
                "decimate": e.decimate,
                "input": e.thinning,
                "rate_hz": e.rate_hz,
                "dc_alias_deg": float(np.degrees(e.dc_alias)),
                "lines_hz": list(e.lines),
            }
            for e in c.exposures
        ],
        "sp": _sp(found),
        "verdict": {
            "algorithm": c.verdict.algorithm,
            "text": c.verdict.text,
            "agree": c.verdict.agree,
            "limit_dph": None if c.verdict.limit is None else c.verdict.limit * DEG_H,
        },
        "lost": list(found.lost),
        "warnings": list(found.warnings),
    }


def _row(row: Row, prediction: Prediction | None, base: np.ndarray | None) -> dict[str, Any]:
    d = row.drift
    parting = None if prediction is None or base is None else prediction.drift - base
    return {
        "name": row.candidate.name,
        "summary": row.candidate.algorithm.summary,
        "caveat": row.candidate.algorithm.caveat,
        "update_hz": row.update_hz,
        "decimate": row.candidate.decimate,
        "input": row.candidate.thinning,
        "drift_dph": None
        if d is None
        else {
            "windows": d.windows,
            "mean": d.mean.tolist(),
            "confidence": d.confidence.tolist(),
            "rms": d.rms.tolist(),
            "p95": d.p95.tolist(),
            "max": d.largest.tolist(),
            "norm_rms": d.norm_rms,
            "slope_rms": d.slope_rms,
        },
        "slope_dph": (row.slope * DEG_H).tolist(),
        "end_deg": np.degrees(row.end).tolist(),
        "largest_deg": float(np.degrees(row.largest)),
        "resolved": row.resolved,
        "pred_dph": None if prediction is None else prediction.drift.tolist(),
        "pred_parting_dph": None if parting is None else parting.tolist(),
        "beyond_pred_dph": None if d is None or parting is None else (d.mean - parting).tolist(),
        "pred_exception": "" if prediction is None else prediction.exception,
        "pseudo_dph": None
        if prediction is None or prediction.pseudo is None
        else prediction.pseudo.tolist(),
        "ns_per_sample": row.ns_per_sample,
    }


def _spectrum(found: LogComparison) -> dict[str, Any] | None:
    s = found.spectrum
    if s is None:
        return None
    return {
        "coning_rate_dph": (s.coning_rate() * DEG_H).tolist(),
        "highest_hz": 0.5 / s.interval,
        "resolution_hz": s.step,
    }


def _sp(found: LogComparison) -> dict[str, Any] | None:
    tuning, limits = found.tuning, found.bounds
    if tuning is None or limits is None:
        return None
    return {
        "compared": SP in found.comparison.settings.algorithms,
        "equivalent": "phi = p w1 + (T - p) w2 + kappa w1 x w2",
        "tuning": {
            "status": tuning.status,
            "q": tuning.q,
            "epsilon_s": tuning.epsilon,
            "beta_gain": tuning.beta_gain,
            "drift_best_dph": (tuning.drift_best * DEG_H).tolist(),
            "drift_tuned_dph": (tuning.drift_tuned * DEG_H).tolist(),
        },
        "bounds": {
            "status": limits.status,
            "windows": limits.windows,
            "noise_limited": limits.noise_limited,
            "epsilon_upper_s": list(limits.epsilon_upper),
            "gain_lower": list(limits.gain_lower),
            "band_hz": list(limits.band),
        },
    }
