"""Coning algorithms side by side on one log.

The reference is the sharpest thing the log's own samples allow. Everything is reported as the
rate at which a candidate leaves it, window by window, so that sensor errors, which every
algorithm sees alike, cancel. How far the reference itself can be trusted is what it parts by from
two algorithms as sharp that err in other ways, one of another family and one that interpolates
the samples otherwise: where those disagree, the log does not tell which is right.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any

import numpy as np

from sinstool.core.english import counted_clause
from sinstool.core.finding import Finding
from sinstool.core.threads import executor
from sinstool.methods.coning.increments import GyroKind
from sinstool.methods.coning.registry import algorithm
from sinstool.pipelines.compare_coning.alias import Exposure, RateSpectrum, exposure, rate_spectrum
from sinstool.pipelines.compare_coning.divergence import (
    IN_DEG_H,
    CandidateDivergence,
    Row,
    part,
    statistics,
    widest_gap,
)
from sinstool.pipelines.compare_coning.runs import (
    Attitudes,
    Candidate,
    Segment,
    candidates,
    increments_of,
    run,
)
from sinstool.pipelines.compare_coning.verdict import Verdict, verdict

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
# Judge the reference: of another family, and of another interpolation.
JUDGES = ("quatfiter-4", "previous-3", "lookahead-12")
# Interpolates otherwise than the others. Where one of them is so much closer to it than the third,
# which is no chance, the third errs.
OTHERWISE, CLOSER = "lookahead-12", 0.1
SELF_CHECK = 0.1
# Runs that are kept to be compared in pairs have about this many instants in each segment
_MOST_ROWS = 1 << 18
# Two updates of the reference and the sample they begin at
LEAST_SAMPLES = 9


@dataclass(frozen=True)
class Settings:
    """Settings of a comparison.

    Attributes
    ----------
    reference : str
        An algorithm, ``auto`` (quatfiter-4) or ``none`` (candidates against each other only).
    tolerance : float
        Drift that does not matter, rad/s.
    options : dict
        Options of algorithms that take any, by name.
    """

    algorithms: tuple[str, ...] = DEFAULT_ALGORITHMS
    reference: str = "auto"
    decimate: tuple[int, ...] = (1, 2, 4)
    window_s: float = 10.0
    tolerance: float = 0.01 / IN_DEG_H
    options: dict[str, dict[str, Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class Comparison:
    """Result of a comparison.

    Attributes
    ----------
    kind : str
        What the log's samples are.
    reference : str
        Name of the algorithm, or ``none``.
    reference_resolution : float or None
        Largest root mean square drift between the reference and one of `JUDGES`, rad/s, but for
        one of them that is far off where the other two agree.
    rows : tuple of Row
        Candidates as the log is, then decimated.
    pairs : dict
        Largest angle between native candidates, rad, by pair of names.
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
    findings: tuple[Finding, ...]


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
    kind : {'rate', 'mean-rate'}
    interval_s : float
        Nominal sample interval, s.
    truth : list of Attitudes, optional
        True attitude of each segment, to be the reference.
    progress : callable, optional
        Called with the fraction done.

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
    native = [c for c in todo if c.decimate == 1]
    findings: list[Finding] = []
    truths: list[Attitudes] | None = None
    judges: list[Candidate] = []
    if truth is not None:
        name = "truth"
        truths = [t for t, enough in zip(truth, long, strict=True) if enough]
    elif name != "none":
        reference = Candidate(name, algorithm(name, **settings.options.get(name, {})))
        truths = run(reference, usable, kind, interval_s)
        native_names = {c.name for c in native}
        judges = [Candidate(j, algorithm(j)) for j in JUDGES if j != name and j not in native_names]
    summed = any(c.input == "sums" for c in todo)
    increments = [increments_of(s, kind, interval_s) if summed else None for s in usable]
    every = math.lcm(*(c.stride for c in native))
    sparse: dict[str, list[Attitudes]] = {}

    def work(candidate: Candidate) -> Row:
        made = run(candidate, usable, kind, interval_s, increments)
        if candidate.decimate == 1:
            sparse[candidate.name] = [_sparse(a, every) for a in made]
        return _row(candidate, made, truths, usable, interval_s, settings)

    rows: list[Row] = []
    # The compiled loops let others run: two threads take half as long, and memory for two runs.
    with executor(min(2, os.cpu_count() or 1), "sinstool-compare") as pool:
        for number, row in enumerate(pool.map(work, [*todo, *judges])):
            rows.append(row)
            if progress:
                progress((number + 1) / (len(todo) + len(judges) + 1))
    resolution = None
    if truth is None and truths is not None:
        resolution = _resolution(rows, name)
        if resolution is None:
            text = "the log is too short to judge the reference"
            findings.append(Finding("reference-unknown", text))
    rows = [_resolved(row, resolution) for row in rows[: len(todo)]]
    pairs = {
        (a, b): float(
            np.fmax.reduce(
                [widest_gap(x, y) for x, y in zip(sparse[a], sparse[b], strict=True)],
                initial=np.nan,
            )
        )
        for a, b in combinations([c.name for c in native], 2)
    }
    spectrum = rate_spectrum([s.gyro for s in usable], interval_s, settings.window_s)
    exposures = []
    if spectrum is not None:
        for m in settings.decimate:
            for thinning in ("sums", "points") if m > 1 else ():
                exposures.append(exposure(spectrum, 1 / interval_s, m, thinning, settings.window_s))
    if len(usable) < len(segments):
        left = sum(len(s) for s in segments) - sum(len(s) for s in usable)
        short = counted_clause(len(segments) - len(usable), "stretch", "is", "are")
        text = f"{short} too short, between gaps, to compare on:"
        text = f"{text} {counted_clause(left, 'sample', 'is', 'are')} left out"
        findings.append(Finding("short-stretches", text, numbers={"samples": left}))
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
        verdict(rows, name, resolution, settings.tolerance, covered < settings.window_s),
        tuple(findings),
    )


def _sparse(made: Attitudes, every: int) -> Attitudes:
    """Run with fewer instants, that every other thinned one has too."""
    step = every * -(-int(made.sample[-1]) // (_MOST_ROWS * every))
    if step <= every:
        return made
    few = made.sample % step == 0
    few[-1] = True
    return Attitudes(made.sample[few], made.q[few], made.seconds, made.samples)


def _resolution(rows: Sequence[Row], reference: str) -> float | None:
    """Resolution of the reference: its drift against algorithms with other errors."""
    drifts = {
        r.candidate.name: r.drift_dph.slope_rms / IN_DEG_H
        for r in rows
        if r.candidate.decimate == 1
        and r.candidate.name in JUDGES
        and r.candidate.name != reference
        and r.drift_dph is not None
    }
    if not drifts:
        return None
    least, largest = min(drifts, key=drifts.__getitem__), max(drifts.values())
    if OTHERWISE in (least, reference) and reference in JUDGES:
        return drifts[least] if drifts[least] < CLOSER * largest else largest
    return largest


def _resolved(row: Row, resolution: float | None) -> Row:
    above_resolution = row.drift_dph is not None and (
        resolution is None or resolution < SELF_CHECK * row.drift_dph.slope_rms / IN_DEG_H
    )
    return replace(row, resolved=above_resolution)


def _row(
    candidate: Candidate,
    made: list[Attitudes],
    truths: list[Attitudes] | None,
    segments: Sequence[Segment],
    interval_s: float,
    settings: Settings,
) -> Row:
    fed = sum(a.samples for a in made)
    cost = 1e9 * sum(a.seconds for a in made) / max(fed, 1)
    curves: list[CandidateDivergence] = []
    if truths is not None:
        partings = (
            part(a, t, s.time_ns, settings.window_s)
            for a, t, s in zip(made, truths, segments, strict=True)
        )
        curves = [p for p in partings if p is not None]
    drift = None
    if curves:
        rates = np.concatenate([p.window_rate for p in curves])
        slopes = np.concatenate([p.window_slope for p in curves])
        # A stretch shorter than half a window says little of drift; it counts if there is no other.
        length = np.concatenate([p.window_length_s for p in curves])
        full = length >= 0.5 * min(settings.window_s, length.max())
        drift = statistics(rates[full], slopes[full])
    longest = max(curves, key=lambda p: p.time_s[-1], default=None)
    return Row(
        candidate,
        1.0 / (interval_s * candidate.stride),
        drift,
        np.degrees(np.sum([p.end for p in curves], axis=0) if curves else np.full(3, np.nan)),
        (longest.slope if longest is not None else np.full(3, np.nan)) * IN_DEG_H,
        float(np.degrees(max((p.largest for p in curves), default=float("nan")))),
        cost,
        False,
        tuple(curves),
    )
