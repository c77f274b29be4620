"""Figures of an INS/GNSS filter: innovations within bounds, biases, events."""

from __future__ import annotations

import numpy as np

from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.ins_gnss.results import GnssDiagnostics
from sinstool.pipelines.process.summary import FilterCourse
from sinstool.report.figure import Figure, Series
from sinstool.report.figures.parts import AXES, BODY, both_sides
from sinstool.report.figures.process import BOUND, TIME

# Epochs drawn; of more, every so many.
MOST = 3000
MARKS = 50


def filter_figures(course: FilterCourse) -> list[Figure]:
    """Figures of a run that has come to its end."""
    gnss, first, marks = course.gnss, course.first_ns, _events(course)
    return [*_innovations(gnss, first, marks), _squares(gnss, first, marks), *_biases(course)]


def _thinned(rows: np.ndarray) -> np.ndarray:
    """Thin the values to a number that can be drawn."""
    step = max(1, -(-len(rows) // MOST))
    return np.asarray(rows[::step])


def _innovations(
    gnss: GnssDiagnostics, first: int, marks: tuple[tuple[str, float], ...]
) -> list[Figure]:
    figures = []
    for start, what, unit in ((0, "position", "m"), (3, "velocity", "m/s")):
        rows = _thinned(np.flatnonzero(np.isfinite(gnss.innovation[:, start])))
        if not len(rows):
            continue
        seconds = (gnss.time_ns[rows] - first) / SECOND
        columns = slice(start, start + 3)
        values = gnss.innovation[rows, columns]
        bound = BOUND * np.nanmax(gnss.innovation_sigma[rows, columns], axis=1)
        series = [Series(axis, values[:, k], style="points") for k, axis in enumerate(AXES)]
        series.append(both_sides("3 sigma of the worst axis", seconds, bound, -bound))
        notes = [
            "Navigation minus fix, less the estimated errors of both; all"
            " but 0.3 % should lie within the dashed bounds. Withheld and rejected fixes are"
            " shown too."
        ]
        figures.append(
            Figure(
                f"innovation-{what}",
                f"Innovations of {what}",
                seconds,
                tuple(series),
                TIME,
                f"innovation, {unit}",
                notes=tuple(notes),
                marks=marks,
            )
        )
    return figures


def _squares(gnss: GnssDiagnostics, first: int, marks: tuple[tuple[str, float], ...]) -> Figure:
    """Normalised innovation squared over its number of rows, by use of the fix."""
    seconds = (gnss.time_ns - first) / SECOND
    value = np.sqrt(gnss.nis / np.maximum(gnss.rows, 1))
    series = []
    for name, mask in (
        ("used", gnss.used),
        ("rejected", gnss.gated),
        ("restarted", gnss.restarted),
        ("withheld", gnss.withheld),
    ):
        rows = _thinned(np.flatnonzero(mask & np.isfinite(value)))
        if len(rows):
            series.append(Series(name, value[rows], x=seconds[rows], style="points"))
    return Figure(
        "nis",
        "Innovations over their expected size",
        seconds[:1],
        tuple(series),
        TIME,
        "size over expected size",
        levels=(("expected", 1.0),),
        notes=(
            "The root of the normalised innovation squared (NIS) over its number of rows: about 1"
            " where noise is as assumed. It does not show slowly varying errors of the fixes: a"
            " filter that treats them as white noise shows less than 1 and is over-confident.",
        ),
        marks=marks,
    )


def _biases(course: FilterCourse) -> list[Figure]:
    """Biases as the filter knew them."""
    rows = _thinned(np.arange(len(course.bias_ns)))
    seconds = (course.bias_ns[rows] - course.first_ns) / SECOND
    figures = []
    for key, title, values, size, unit in (
        ("gyro-bias", "Gyro bias", course.gyro_bias, DEGREE / 3600.0, "deg/h"),
        ("accel-bias", "Accelerometer bias", course.accel_bias, 1.0, "m/s²"),
    ):
        series = tuple(Series(n, values[rows, k] / size) for k, n in enumerate(BODY))
        note = "As the filter estimated it, along the IMU's Forward-Right-Down axes."
        figures.append(Figure(key, title, seconds, series, TIME, f"bias, {unit}", notes=(note,)))
    return figures


def _events(course: FilterCourse) -> tuple[tuple[str, float], ...]:
    """Restarts, gaps and other events of a filter, except single rejected fixes."""
    return tuple(
        (event.kind, (event.time_ns - course.first_ns) / SECOND)
        for event in course.events
        if event.kind != "gated"
    )[:MARKS]
