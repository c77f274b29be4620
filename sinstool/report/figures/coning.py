"""Figures of a comparison of coning algorithms on a log."""

from __future__ import annotations

import numpy as np

from sinstool.methods.coning.response import coning_gains
from sinstool.pipelines.compare_coning.compare import SELF_CHECK
from sinstool.pipelines.compare_coning.divergence import IN_DEG_H, Row
from sinstool.pipelines.compare_coning.log import LogComparison
from sinstool.report.figure import Figure, Series
from sinstool.report.figures.parts import positive

AXES = ("x", "y", "z")
# Divergences of less than this fraction of the largest are not drawn.
RANGE = 1e-6
# Curves of the gain are drawn up to where the sampled motion ceases to be one
HIGHEST_SHARE = 0.49


def figures(log: LogComparison) -> tuple[Figure, ...]:
    """The figures of a comparison on a log.

    Returns
    -------
    tuple of Figure
        Six where the log is long enough for a spectrum and decimation is among the options.
    """
    c = log.comparison
    native = [r for r in c.rows if r.candidate.decimate == 1 and r.curves]
    made = [_parting(native, log), _bars(native, bool(log.truth))]
    if log.spectrum is not None:
        made += [_coning(log), _gains(native, log)]
    if c.spectrum is not None:
        made.append(_density(log))
    if len(c.settings.decimate) > 1:
        made.append(_decimation(log))
    return tuple(made)


def _parting(rows: list[Row], log: LogComparison) -> Figure:
    """Angles from the reference, from the largest at the end to the smallest."""
    c = log.comparison
    curves = {}
    for row in rows:
        curve = max(row.curves, key=lambda p: p.time_s[-1])
        curves[row.candidate.label] = (np.degrees(curve.norm), curve.time_s)
    most = max((float(np.nanmax(angle)) for angle, _ in curves.values()), default=0.0) or 1.0
    floor = RANGE * most
    if c.reference_resolution is not None:
        # By what the reference itself may have turned within a window
        floor = max(floor, np.degrees(c.reference_resolution) * c.settings.window_s)
    floor = min(floor, 0.1 * most)
    # As they lie at the right end, beside their names
    order = sorted(curves, key=lambda name: -float(curves[name][0][-1]))
    hidden = [name for name in order if not np.nanmax(curves[name][0]) > floor]
    series = tuple(
        Series(name, positive(curves[name][0]), curves[name][1], colour=list(curves).index(name))
        for name in order
        if name not in hidden
    )
    notes = [
        "The longest stretch without gaps. "
        + (
            "The truth has no sensor errors, so every curve contains them."
            if log.truth
            else "Sensor errors cancel, as all algorithms get the same samples."
        )
    ]
    if hidden:
        notes.append(
            f"Not drawn, as they stay below {floor:.2g} deg, within what the reference can"
            f" resolve: {', '.join(hidden)}."
        )
    return Figure(
        "divergence",
        f"Divergence from {log.truth or c.reference}",
        series[0].x if series and series[0].x is not None else np.zeros(1),
        series,
        "time, s",
        "angle between attitudes, deg",
        log_y=True,
        y_range=(floor, 2.0 * most) if series else None,
        notes=tuple(notes),
    )


def _bars(rows: list[Row], truth: bool) -> Figure:
    all_drifts = [(r.candidate.label, r.drift_dph) for r in rows]
    drifts = [(name, d) for name, d in all_drifts if d is not None]
    names = tuple(name for name, _ in drifts)
    several = all(d.windows > 1 for _, d in drifts)
    series = tuple(
        Series(
            axis,
            np.array([d.mean[k] for _, d in drifts]),
            names,
            "bars",
            error=np.array([d.confidence[k] for _, d in drifts]) if several else None,
        )
        for k, axis in enumerate(AXES)
    )
    bars = "Lines: two standard deviations of the mean to either side. " if several else ""
    return Figure(
        "drift",
        "Mean drift by axis",
        names,
        series,
        "algorithm",
        "drift, deg/h",
        notes=(
            bars
            + (
                "Axes are those of the truth: north, east, down, unless its world is another."
                if truth
                else "Axes are front, right, down of the body where each stretch of the log begins."
            ),
        ),
    )


def _coning(log: LogComparison) -> Figure:
    s = log.spectrum
    assert s is not None
    cumulative = s.cumulative() * IN_DEG_H
    return Figure(
        "coning",
        "Coning in the log up to each frequency",
        s.frequency,
        tuple(Series(f"about {axis}", cumulative[:, k]) for k, axis in enumerate(AXES)),
        "frequency, Hz",
        "rate of coning up to there, deg/h",
        marks=_bands(log),
        notes=(
            "The coning that an algorithm without compensation misses, and that a perfect one"
            " reproduces.",
        ),
    )


def _gains(rows: list[Row], log: LogComparison) -> Figure:
    s = log.spectrum
    assert s is not None
    f = np.geomspace(0.01, HIGHEST_SHARE, 200) / s.interval
    series = []
    for row in rows:
        # With several samples an update the answer has no meaning at multiples of their rate.
        highest = HIGHEST_SHARE / (s.interval * row.candidate.algorithm.samples)
        at = f[f <= highest]
        gain = coning_gains(row.candidate.algorithm, at, s.interval, log.comparison.kind)
        series.append(Series(row.candidate.label, gain, at))
    return Figure(
        "gain",
        "Fraction of the true coning that each algorithm answers to",
        f,
        tuple(series),
        "frequency, Hz",
        "fraction of the coning rate",
        log_x=True,
        marks=_bands(log),
        notes=(
            "1 is right. Below 1 coning is missed; above the motion's"
            " own frequencies any response turns noise into drift.",
        ),
    )


def _density(log: LogComparison) -> Figure:
    s = log.comparison.spectrum
    assert s is not None
    keep = s.frequency > 0
    unit = np.degrees(1.0) ** 2
    series = [Series("the log as it is", np.maximum(s.density[keep] * unit, 1e-30))]
    for e in log.comparison.exposures:
        inside = e.frequency > 0
        label = f"at {e.rate_hz:.4g} Hz, {e.input}, folded"
        folded = np.maximum(e.folded[inside] * unit, 1e-30)
        series.append(Series(label, folded, e.frequency[inside], "dashed"))
    return Figure(
        "density",
        "Power of the angular rate, and the part that a slower log would alias",
        s.frequency[keep],
        tuple(series),
        "frequency, Hz",
        "density, (deg/s)²/Hz",
        log_x=True,
        log_y=True,
        marks=_bands(log),
        notes=(
            "Content above half the log's own rate is aliased into it and cannot be recognised.",
        ),
    )


def _decimation(log: LogComparison) -> Figure:
    c = log.comparison
    curves: dict[str, tuple[list[float], list[float]]] = {}
    sizes = [row.drift_dph.norm_rms for row in c.rows if row.drift_dph is not None]
    floor = RANGE * max(sizes, default=0.0)
    for row in c.rows:
        if row.drift_dph is None or row.drift_dph.norm_rms <= floor:
            continue
        thinnings = [row.candidate.input]
        if row.candidate.decimate == 1:
            thinnings = ["sums", "points"] if c.kind == "rate" else ["sums"]
        for thinning in thinnings:
            x, y = curves.setdefault(f"{row.candidate.name}, {thinning}", ([], []))
            x.append(row.candidate.decimate)
            y.append(row.drift_dph.norm_rms)
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
        "Drift if the log had been recorded at a lower rate",
        np.array(c.settings.decimate, dtype=np.float64),
        series,
        "one sample kept of so many",
        "rms drift, deg/h",
        log_x=True,
        log_y=True,
        notes=(
            "On coning alone a scheme of order 2N climbs by 2N decades in a decade.",
            f"Below {1 / SELF_CHECK:.0f} times the reference's own resolution the curves show the"
            " error of the reference.",
        ),
    )


def _bands(log: LogComparison) -> tuple[tuple[str, float], ...]:
    marks = (("passband", log.passband), ("stopband", log.stopband))
    return tuple((name, at) for name, at in marks if at is not None)
