"""Figures of a run of `process`, from the curves of its recorder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sinstool.pipelines.process.errors_against_truth import KINDS
from sinstool.pipelines.process.hse_used import HseCorrection
from sinstool.report.figure import Figure, FloatArray, Series, heading_curve
from sinstool.report.figures.parts import AXES, both_sides, length, positive

Marks = tuple[tuple[str, float], ...]

TIME = "time since the first sample, s"
# Smaller errors of attitude than this, deg, are shown in arc seconds.
SMALL_ANGLE_DEG = 0.1
# Of a normal distribution: 99.7 % lie within.
BOUND = 3.0


@dataclass(frozen=True)
class Curves:
    """Columns over time.

    Attributes
    ----------
    seconds : ndarray, shape (n,)
    of : mapping
        Name to values, shape (n,).
    """

    seconds: FloatArray
    of: Mapping[str, FloatArray]

    def figure(
        self, key: str, title: str, ylabel: str, names: Sequence[str], note: str, marks: Marks = ()
    ) -> Figure:
        """Some of the columns against time."""
        series = tuple(Series(name, self.of[name]) for name in names)
        notes = (note,) if note else ()
        return Figure(key, title, self.seconds, series, TIME, ylabel, notes=notes, marks=marks)


# Roll and pitch share an axis unless they are so many of their own spreads apart, and so far, deg.
APART, LEAST_APART = 2.0, 10.0


def tilt(curves: Curves, note: str) -> list[Figure]:
    """Roll and pitch, each with an axis of its own where one axis would flatten both."""
    middles, spreads = [], []
    for name in ("roll", "pitch"):
        low, middle, high = np.nanpercentile(curves.of[name], (2.0, 50.0, 98.0))
        middles.append(float(middle))
        spreads.append(float(high - low))
    if abs(middles[0] - middles[1]) < max(APART * sum(spreads), LEAST_APART):
        both = ("roll", "pitch")
        return [curves.figure("tilt", "Roll and pitch", "angle, deg", both, note)]
    return [
        curves.figure(name, name.capitalize(), f"{name}, deg", (name,), note)
        for name in ("roll", "pitch")
    ]


def heading(curves: Curves, axes: str, origin: str = "true north") -> Figure:
    """Heading from 0 to 360 deg, with a hole where it passes the end of that range.

    Parameters
    ----------
    axes : str
        A sentence that says whose heading it is.
    origin : str, optional
        The north from which it counts; '' if that is unknown.
    """
    seconds, within = heading_curve(curves.seconds, curves.of["heading"])
    note = f"Clockwise from above, from {origin}."
    if not origin:
        note = "Clockwise from above. Nothing in the log shows north: only its changes count."
    line = (Series("heading", within),)
    notes = (f"{note} {axes}",)
    return Figure("heading", "Heading", seconds, line, TIME, "heading, deg", notes=notes)


def vertical(
    curves: Curves, reference: tuple[str, FloatArray, FloatArray] | None, marks: Marks
) -> list[Figure]:
    """Height, its difference to the reference, and the reference.

    Parameters
    ----------
    reference : tuple or None
        Name, seconds, and its height and the computed one less that, shape (m, 2).
    marks : tuple
        Events.
    """
    if "height" not in curves.of:
        return []
    series = [Series("computed", curves.of["height"])]
    if reference is not None:
        name, at, values = reference
        series.append(Series(name, values[:, 0], x=at, style="dashed"))
    note = ("Above the ellipsoid.",)
    figures = [
        Figure("height", "Height", curves.seconds, tuple(series), TIME, "height, m", notes=note,
               marks=marks)
    ]  # fmt: skip
    if reference is not None:
        off = (Series("computed less reference", values[:, 1], x=at),)
        notes = (
            "It includes the reference's own slow error, so with a"
            " barometer it is not the error of the height.",
        )
        figures.append(
            Figure("difference", f"Difference from the height of {name}", at, off, TIME,
                   "difference, m", notes=notes, marks=marks)
        )  # fmt: skip
    if "up" in curves.of:
        figures.append(
            curves.figure(
                "up", "Vertical velocity", "velocity up, m/s", ("up",), "Positive is up.", marks
            )
        )
        text = (
            "The correction by the damping. A steady value is"
            " the accelerometer's vertical bias plus the error of gravity."
        )
        title = "Correction of the vertical accelerometer"
        figures.append(
            curves.figure("correction", title, "correction, m/s²", ("correction",), text, marks)
        )
    return figures


def errors(off: Mapping[str, tuple[FloatArray, FloatArray]], curves: Curves) -> list[Figure]:
    """Errors against the truth, within the bounds that a filter gives.

    Parameters
    ----------
    off : mapping
        Kind to seconds, shape (n,), and errors, shape (n, 3).
    curves : Curves
        With the sigmas, where there are any.
    """
    figures = []
    for kind, unit, size in KINDS:
        if kind not in off:
            continue
        seconds, error = off[kind]
        finite = error[np.isfinite(error)] / size
        if not len(finite):
            continue
        scale = 1.0 / size
        if unit == "deg" and np.abs(finite).max() < SMALL_ANGLE_DEG:
            unit, scale = "arcsec", scale * 3600.0
        if unit == "m":
            least, unit = length(finite)
            scale /= least
        notes = ["Computed less true."]
        if kind == "attitude":
            notes = [
                "The small rotation, about these axes, from the true attitude to the one"
                " computed: about down it is an error of heading."
            ]
        series = [Series(axis, error[:, k] * scale) for k, axis in enumerate(AXES)]
        if f"{kind} {AXES[0]}" in curves.of:
            series += bounds(kind, curves, size * scale)
            notes.append(
                "Dashed: three of the filter's own standard deviations to either side; all but"
                " 0.3 % of the errors belong within."
            )
        figures.append(
            Figure(f"error-{kind}", f"Error of {kind}", seconds, tuple(series), TIME,
                   f"error, {unit}", notes=tuple(notes))
        )  # fmt: skip
    return figures


def bounds(kind: str, curves: Curves, scale: float = 1.0) -> list[Series]:
    """Three sigma to either side, in the colour of each axis."""
    edges = {axis: BOUND * scale * curves.of[f"{kind} {axis}"] for axis in AXES}
    return [
        both_sides(f"3 sigma, {axis}", curves.seconds, edge, -edge, colour=k)
        for k, (axis, edge) in enumerate(edges.items())
    ]


def sigmas(curves: Curves, without: Sequence[str]) -> list[Figure]:
    """Standard deviations, where a run has covariances and no errors to draw them about.

    Parameters
    ----------
    without : sequence of str
        Kinds whose errors are drawn.
    """
    figures = []
    for kind, unit, _ in KINDS:
        if f"{kind} {AXES[0]}" not in curves.of or kind in without:
            continue
        columns = [(axis, curves.of[f"{kind} {axis}"]) for axis in AXES]
        series = tuple(Series(axis, positive(values)) for axis, values in columns)
        if not any(np.isfinite(one.y).any() for one in series):
            continue
        note = (
            "One standard deviation, by the run's own estimate. A reference given with --truth"
            " shows the errors themselves."
        )
        figures.append(
            Figure(f"sigma-{kind}", f"Accuracy of {kind}", curves.seconds, series, TIME,
                   f"sigma, {unit}", log_y=True, notes=(note,))
        )  # fmt: skip
    return figures


def stretches(hse: HseCorrection) -> Figure:
    """Heading of every stretch at constant rate, before and after its correction."""
    rates = np.array([s.rate_deg_s for s in hse.segments])
    raw = np.array([s.heading_raw_deg for s in hse.segments])
    corrected = np.array([s.heading_deg for s in hse.segments])
    middle = float(np.median(corrected))
    sigmas = [s.sigma_heading_arcsec for s in hse.segments]
    sigma = None if any(s is None for s in sigmas) else np.array(sigmas, dtype=np.float64)

    def shown(values: FloatArray) -> FloatArray:
        return np.asarray(((values - middle + 180.0) % 360.0 - 180.0) * 3600.0)

    return Figure(
        "stretches",
        "Heading of each stretch at constant rate",
        rates,
        (
            Series("as aligned", shown(raw), style="points"),
            Series("corrected", shown(corrected), style="points", error=sigma),
        ),
        "rate, deg/s",
        "heading, arcsec",
        notes=(
            f"Less {middle:.6f} deg, the median of the corrected ones. Heading-sensitive error"
            " is a slope over rate; corrected headings should have none."
            + ("" if sigma is None else " Bars: one standard deviation to either side."),
        ),
    )
