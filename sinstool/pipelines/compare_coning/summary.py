"""A comparison on a log as plain values, and as figures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from sinstool.methods.coning.registry import algorithm
from sinstool.methods.coning.response import coning_gains
from sinstool.pipelines.compare_coning.compare import SELF_CHECK, Row
from sinstool.pipelines.compare_coning.divergence import DEG_H
from sinstool.pipelines.compare_coning.predictions import Prediction, predict
from sinstool.pipelines.compare_coning.runs import Candidate
from sinstool.report.figure import Figure, Series

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

    Parameters
    ----------
    found : LogComparison

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


def figures(found: LogComparison) -> tuple[Figure, ...]:
    """The figures of a comparison on a log.

    Parameters
    ----------
    found : LogComparison

    Returns
    -------
    tuple of Figure
        Six where the log is long enough for a spectrum and decimation was asked for.
    """
    return tuple(_figures(found))


def _figures(found: LogComparison) -> Iterator[Figure]:
    c = found.comparison
    native = [r for r in c.rows if r.candidate.decimate == 1 and r.curves]
    yield _parting(native, found)
    yield _bars(native, bool(found.truth))
    if found.spectrum is not None:
        yield _coning(found)
        yield _gains(native, found)
    if c.spectrum is not None:
        yield _density(found)
    if len(c.settings.decimate) > 1:
        yield _decimation(found)


def _parting(rows: list[Row], found: LogComparison) -> Figure:
    series = []
    for row in rows:
        curve = max(row.curves, key=lambda p: p.time_s[-1])
        norm = np.degrees(np.maximum(curve.norm, 1e-16))
        series.append(Series(row.candidate.label, norm, curve.time_s))
    # Attitudes are equal where they start; from the smallest that lasts on, there is a curve
    usual = [float(np.nanpercentile(one.y, 5.0)) for one in series]
    most = max((float(np.nanmax(one.y)) for one in series), default=1.0)
    shared = (
        "The truth has no sensor errors, so that these are in every curve."
        if found.truth
        else "Sensor errors cancel, as all see the same."
    )
    return Figure(
        "divergence",
        f"Divergence from {found.truth or found.comparison.reference}",
        series[0].x if series and series[0].x is not None else np.zeros(1),
        tuple(series),
        "time, s",
        "angle between attitudes, deg",
        log_y=True,
        y_range=(min(*usual, 0.1 * most) / 2.0, 2.0 * most) if usual else None,
        notes=(f"The longest stretch without gaps. {shared}",),
    )


def _bars(rows: list[Row], truth: bool) -> Figure:
    names = tuple(r.candidate.label for r in rows)
    drifts = [r.drift for r in rows if r.drift is not None]
    series = tuple(
        Series(f"{axis}", np.array([d.mean[k] for d in drifts]), names, "bars")
        for k, axis in enumerate(AXES)
    )
    widest = max((float(np.nanmax(d.confidence)) for d in drifts if d.windows > 1), default=0.0)
    return Figure(
        "drift",
        "Mean drift by axis",
        names,
        series,
        "algorithm",
        "drift, deg/h",
        notes=(
            f"Two standard deviations of the mean are at most {widest:.3g} deg/h.",
            "Axes are those of the truth: north, east, down, unless its world is another."
            if truth
            else "Axes are front, right, down of the body where each stretch of the log begins.",
        ),
    )


def _coning(found: LogComparison) -> Figure:
    s = found.spectrum
    assert s is not None
    cumulative = s.cumulative() * DEG_H
    return Figure(
        "coning",
        "Coning in the log up to each frequency",
        s.frequency,
        tuple(Series(f"about {axis}", cumulative[:, k]) for k, axis in enumerate(AXES)),
        "frequency, Hz",
        "rate of coning up to there, deg/h",
        marks=_bands(found),
        notes=("What an algorithm without compensation misses, and a perfect one answers to.",),
    )


def _gains(rows: list[Row], found: LogComparison) -> Figure:
    s = found.spectrum
    assert s is not None
    f = np.geomspace(0.01, HIGHEST_SHARE, 200) / s.interval
    series = []
    for row in rows:
        # With several samples an update the answer has no meaning at multiples of their rate.
        highest = HIGHEST_SHARE / (s.interval * row.candidate.algorithm.samples)
        at = f[f <= highest]
        gain = coning_gains(row.candidate.algorithm, at, s.interval, found.comparison.kind)
        series.append(Series(row.candidate.label, gain, at))
    return Figure(
        "gain",
        "Fraction of the true coning that each algorithm answers to",
        f,
        tuple(series),
        "frequency, Hz",
        "fraction of the coning rate",
        log_x=True,
        marks=_bands(found),
        notes=(
            "1 is right. Where it falls below, coning is missed; what is answered to above the"
            " motion's own frequencies is noise taken for coning.",
        ),
    )


def _density(found: LogComparison) -> Figure:
    s = found.comparison.spectrum
    assert s is not None
    keep = s.frequency > 0
    unit = np.degrees(1.0) ** 2
    series = [Series("the log as it is", np.maximum(s.density[keep] * unit, 1e-30))]
    for e in found.comparison.exposures:
        inside = e.frequency > 0
        label = f"at {e.rate_hz:.4g} Hz, {e.thinning}, folded"
        folded = np.maximum(e.folded[inside] * unit, 1e-30)
        series.append(Series(label, folded, e.frequency[inside], "dashed"))
    return Figure(
        "density",
        "Power of the angular rate, and what a slower log would fold",
        s.frequency[keep],
        tuple(series),
        "frequency, Hz",
        "density, (deg/s)²/Hz",
        log_x=True,
        log_y=True,
        marks=_bands(found),
        notes=("Content above half the log's own rate is folded into it and cannot be seen.",),
    )


def _decimation(found: LogComparison) -> Figure:
    c = found.comparison
    curves: dict[str, tuple[list[float], list[float]]] = {}
    for row in c.rows:
        if row.drift is None or row.drift.norm_rms <= 0.0:
            continue
        thinnings = [row.candidate.thinning]
        if row.candidate.decimate == 1:
            thinnings = ["sums", "points"] if c.kind == "rate" else ["sums"]
        for thinning in thinnings:
            x, y = curves.setdefault(f"{row.candidate.name}, {thinning}", ([], []))
            x.append(row.candidate.decimate)
            y.append(row.drift.norm_rms)
    colours = {
        name: k for k, name in enumerate(dict.fromkeys(n.rpartition(",")[0] for n in curves))
    }
    series = tuple(
        Series(
            name,
            np.array(y),
            np.array(x, dtype=np.float64),
            style="line" if name.endswith("sums") else "dashed",
            shown=name.endswith("sums"),
            colour=colours[name.rpartition(",")[0]],
        )
        for name, (x, y) in curves.items()
    )
    return Figure(
        "decimation",
        "Drift if the log had been taken at a lower rate",
        np.array(c.settings.decimate, dtype=np.float64),
        series,
        "one sample kept of so many",
        "rms drift, deg/h",
        log_x=True,
        log_y=True,
        notes=(
            "On coning alone a scheme of order 2N climbs by 2N decades in a decade.",
            f"Below {1 / SELF_CHECK:.0f} times the reference's own resolution the curves tell"
            " of the reference.",
        ),
    )


def _bands(found: LogComparison) -> tuple[tuple[str, float], ...]:
    marks = (("passband", found.passband), ("stopband", found.stopband))
    return tuple((name, at) for name, at in marks if at is not None)
