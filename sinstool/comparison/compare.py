"""Coning algorithms side by side on one log: what each would have made of it.

The reference is the sharpest thing the log's own samples allow. Everything is reported as the
rate at which a candidate leaves it, window by window, so that sensor errors, which every
algorithm sees alike, cancel.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sinstool.comparison.alias import Exposure, RateSpectrum, exposure, rate_spectrum
from sinstool.comparison.divergence import (
    DEG_H,
    DriftStatistics,
    Parting,
    part,
    statistics,
    widest_gap,
)
from sinstool.comparison.runs import Attitudes, Candidate, Segment, candidates, run
from sinstool.coning.increments import GyroKind
from sinstool.coning.registry import algorithm

FloatArray = NDArray[np.float64]

DEFAULT_ALGORITHMS = (
    "uncompensated",
    "previous-1",
    "previous-3",
    "optimal-2",
    "optimal-4",
    "savage-two-speed",
    "picard-4",
    "quatfiter-4",
    "lookahead-12",
    "singular-perturbation",
)
REFERENCE = "quatfiter-4"
# Judges the reference: another algorithm of high order that errs in other ways.
JUDGE = "previous-3"
SELF_CHECK = 0.1
# Two updates of the reference and the sample they begin at
LEAST_SAMPLES = 9


@dataclass(frozen=True)
class Settings:
    """What is compared, and how.

    Attributes
    ----------
    algorithms : tuple of str
    reference : str
        An algorithm, ``auto`` (quatfiter-4) or ``none`` (candidates against each other only).
    decimate : tuple of int
    window_s : float
    tolerance : float
        Drift that does not matter, rad/s.
    options : dict
        Options of algorithms that take any, by name.
    """

    algorithms: tuple[str, ...] = DEFAULT_ALGORITHMS
    reference: str = "auto"
    decimate: tuple[int, ...] = (1, 2, 4)
    window_s: float = 10.0
    tolerance: float = 0.01 / DEG_H
    options: dict[str, dict[str, Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class Row:
    """One candidate's result.

    Attributes
    ----------
    candidate : Candidate
    update_hz : float
    drift : DriftStatistics or None
        None where it has no instants in common with the reference.
    end, slope : ndarray, shape (3,)
        psi at the run's end (all segments added), rad, and its slope, rad/s.
    largest : float
        Largest norm of psi in any segment, rad.
    ns_per_sample : float
        Processor time for each sample it was fed.
    resolved : bool
        Its divergence is well above what the reference itself can be trusted to.
    curves : tuple of Parting
        Per segment, for figures.
    """

    candidate: Candidate
    update_hz: float
    drift: DriftStatistics | None
    end: FloatArray
    slope: FloatArray
    largest: float
    ns_per_sample: float
    resolved: bool
    curves: tuple[Parting, ...]


@dataclass(frozen=True)
class Comparison:
    """All that a comparison found.

    Attributes
    ----------
    settings : Settings
    kind : str
        What the log's samples are.
    rate_hz, duration_s : float
    samples, segments : int
    reference : str
        Name of the algorithm, or ``none``.
    reference_resolution : float or None
        Root mean square drift between the reference and `JUDGE`, rad/s.
    rows : tuple of Row
        Candidates as the log is, then decimated.
    pairs : dict
        Largest angle between native candidates, rad, by pair of names.
    spectrum : RateSpectrum or None
    exposures : tuple of Exposure
    verdict : Verdict
    warnings : tuple of str
    """

    settings: Settings
    kind: GyroKind
    rate_hz: float
    duration_s: float
    samples: int
    segments: int
    reference: str
    reference_resolution: float | None
    rows: tuple[Row, ...]
    pairs: dict[tuple[str, str], float]
    spectrum: RateSpectrum | None
    exposures: tuple[Exposure, ...]
    verdict: Verdict
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class Verdict:
    """Which algorithm to use on this log.

    Attributes
    ----------
    algorithm : str or None
        None where the log cannot tell.
    text : str
    agree : bool
        All candidates agree to the tolerance: it does not matter.
    """

    algorithm: str | None
    text: str
    agree: bool


def compare(
    segments: Sequence[Segment],
    kind: GyroKind,
    interval_s: float,
    settings: Settings,
    truth: list[Attitudes] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Comparison:
    """Run all candidates over a log and compare them.

    Parameters
    ----------
    segments : sequence of Segment
    kind : {'rate', 'mean-rate'}
    interval_s : float
        Nominal sample interval, s.
    settings : Settings
    truth : list of Attitudes, optional
        True attitude of each segment, to be the reference.
    progress : callable, optional
        Called with the fraction done.

    Returns
    -------
    Comparison

    Raises
    ------
    ValueError
        No segment holds enough samples for the reference to take one update.
    """
    name = REFERENCE if settings.reference == "auto" else settings.reference
    long = [len(s) >= LEAST_SAMPLES for s in segments]
    usable = [s for s, enough in zip(segments, long, strict=True) if enough]
    if not usable:
        raise ValueError("no stretch without gaps is long enough to compare algorithms on")
    todo = candidates(settings.algorithms, settings.decimate, kind, settings.options)
    truths = None
    resolution = None
    warnings: list[str] = []
    if truth is not None:
        name = "truth"
        truths = [t for t, enough in zip(truth, long, strict=True) if enough]
    elif name != "none":
        reference = _reference(name, settings)
        truths = [run(reference, s, kind, interval_s) for s in usable]
        resolution = _resolution(usable, truths, kind, interval_s, name, settings)
        if resolution is None:
            warnings.append("the log is too short to judge the reference")
    rows: list[Row] = []
    native: dict[str, list[Attitudes]] = {}
    for number, candidate in enumerate(todo):
        made = [run(candidate, s, kind, interval_s) for s in usable]
        if candidate.decimate == 1:
            native[candidate.name] = made
        rows.append(_row(candidate, made, truths, usable, interval_s, settings, resolution))
        if progress:
            progress((number + 1) / (len(todo) + 1))
    pairs = {
        (a, b): max(
            (widest_gap(x, y) for x, y in zip(native[a], native[b], strict=True)),
            default=float("nan"),
        )
        for a, b in combinations(native, 2)
    }
    spectrum = rate_spectrum([s.gyro for s in usable], interval_s)
    exposures = []
    if spectrum is not None:
        for m in settings.decimate:
            for thinning in ("sums", "points") if m > 1 else ():
                exposures.append(exposure(spectrum, 1 / interval_s, m, thinning, settings.window_s))
    if len(usable) < len(segments):
        warnings.append(f"{len(segments) - len(usable)} stretches are too short to compare on")
    samples = sum(len(s) for s in usable)
    covered = sum(float(s.time_ns[-1] - s.time_ns[0]) for s in usable) / 1e9
    return Comparison(
        settings,
        kind,
        1.0 / interval_s,
        covered,
        samples,
        len(usable),
        name,
        resolution,
        tuple(rows),
        pairs,
        spectrum,
        tuple(exposures),
        _verdict(rows, resolution, settings),
        tuple(warnings),
    )


def _reference(name: str, settings: Settings) -> Candidate:
    return Candidate(name, algorithm(name, **settings.options.get(name, {})))


def _resolution(
    segments: Sequence[Segment],
    truths: list[Attitudes],
    kind: GyroKind,
    interval_s: float,
    name: str,
    settings: Settings,
) -> float | None:
    """How far the reference can be trusted: its drift against an algorithm of another family."""
    judge = JUDGE if name != JUDGE else REFERENCE
    other = Candidate(judge, algorithm(judge))
    parts = [
        part(run(other, s, kind, interval_s), t, s.time_ns, settings.window_s)
        for s, t in zip(segments, truths, strict=True)
    ]
    rates = [p.window_rate for p in parts if p is not None]
    if not rates:
        return None
    return float(np.sqrt(np.mean(np.sum(np.concatenate(rates) ** 2, axis=1))))


def _row(
    candidate: Candidate,
    made: list[Attitudes],
    truths: list[Attitudes] | None,
    segments: Sequence[Segment],
    interval_s: float,
    settings: Settings,
    resolution: float | None,
) -> Row:
    fed = sum(a.samples for a in made)
    cost = 1e9 * sum(a.seconds for a in made) / max(fed, 1)
    curves: list[Parting] = []
    if truths is not None:
        found = (
            part(a, t, s.time_ns, settings.window_s)
            for a, t, s in zip(made, truths, segments, strict=True)
        )
        curves = [p for p in found if p is not None]
    drift = statistics(np.concatenate([p.window_rate for p in curves])) if curves else None
    longest = max(curves, key=lambda p: p.time_s[-1], default=None)
    resolved = drift is not None and (
        resolution is None or resolution < SELF_CHECK * drift.norm_rms / DEG_H
    )
    return Row(
        candidate,
        1.0 / (interval_s * candidate.stride),
        drift,
        np.sum([p.end for p in curves], axis=0) if curves else np.full(3, np.nan),
        longest.slope if longest is not None else np.full(3, np.nan),
        max((p.largest for p in curves), default=float("nan")),
        cost,
        resolved,
        tuple(curves),
    )


def _verdict(rows: Sequence[Row], resolution: float | None, settings: Settings) -> Verdict:
    """The cheapest native algorithm that cannot be told from the reference."""
    native = [(r, r.drift) for r in rows if r.candidate.decimate == 1 and r.drift is not None]
    if not native:
        return Verdict(None, "the log is too short, or without a reference, to choose by", False)
    tolerance = settings.tolerance * DEG_H
    names = [r.candidate.name for r, _ in native]
    cheapest = min(native, key=lambda one: one[0].ns_per_sample)[0].candidate.name
    if all(d.norm_rms <= tolerance for _, d in native):
        text = (
            f"all agree to {tolerance:g} deg/h: on this log the choice does not matter;"
            f" {cheapest} is the cheapest"
        )
        return Verdict(cheapest, text, True)
    # What the reference is good to is itself known to a factor of two at best.
    limit = max(tolerance, 2.0 * DEG_H * (resolution or 0.0))
    good = [r for r, d in native if d.norm_rms <= limit and _unbiased(d, limit)]
    if not good:
        closest, d = min(native, key=lambda one: one[1].norm_rms)
        text = (
            f"none agrees with the reference to {limit:.3g} deg/h; {closest.candidate.name} comes"
            f" closest with {d.norm_rms:.3g} deg/h"
        )
        return Verdict(closest.candidate.name, text, False)
    best = min(good, key=lambda r: r.ns_per_sample).candidate.name
    same = [r.candidate.name for r in good if r.candidate.name != best]
    worse = [name for name in names if name != best and name not in same]
    text = f"{best} is the cheapest that cannot be told from the reference at {limit:.3g} deg/h"
    text += f"; nor can {', '.join(same)}" if same else ""
    text += f"; {', '.join(worse)} can" if worse else ""
    return Verdict(best, text, False)


def _unbiased(drift: DriftStatistics, limit: float) -> bool:
    """Mean within two sigma of none on every axis, or below what can be told."""
    size = np.abs(drift.mean)
    # One window has no spread; its mean is judged by the limit alone.
    return bool(np.all((size <= np.nan_to_num(drift.confidence)) | (size <= limit)))
