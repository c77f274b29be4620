"""Figures of the contents of a log, collected in bounded memory by `info`."""

from __future__ import annotations

import numpy as np

from sinstool.core.english import counted_clause
from sinstool.core.timeline import SECOND
from sinstool.pipelines.info.collect import INCREMENTS, MESSAGES, POINTS, Sampling, Traffic
from sinstool.pipelines.info.result import InspectedImu, Inspection
from sinstool.report.figure import Figure, Series
from sinstool.report.figures.parts import LOG_TIME, positive

AXES = ("x", "y", "z")


def figures(
    inspection: Inspection, samplings: list[Sampling], traffic: Traffic
) -> tuple[Figure, ...]:
    """All figures of an inspection, the main one first.

    Parameters
    ----------
    samplings : list of Sampling
        Of the IMU topics.
    """
    imus = {imu.topic: imu for imu in inspection.usable}
    good = [one for one in samplings if one.topic in imus]
    made: list[Figure | None] = []
    if good:
        origin = min(imus[one.topic].first_ns for one in good)
        made += [_intervals(good, imus, origin), _histogram(good), _delays(good, imus, origin)]
        for number, one in enumerate(good):
            of = f", {one.topic}" if len(good) > 1 else ""
            made += _values(one, number, of, origin)
    made.append(_rates(traffic))
    return tuple(one for one in made if one is not None)


def _intervals(good: list[Sampling], imus: dict[str, InspectedImu], origin: int) -> Figure:
    series = []
    for k, one in enumerate(good):
        seconds, values = one.curves(origin)
        series.append(Series(one.topic, positive(values[:, 0]), x=seconds))
        if one.back:
            at = np.array([(t - origin) / SECOND for t, _ in one.back])
            by = np.array([size for _, size in one.back])
            name = "a stamp steps back by" + (f", {one.topic}" if len(good) > 1 else "")
            series.append(Series(name, by, x=at, style="points", colour=k + len(good)))
    sizes = np.concatenate([one.y[np.isfinite(one.y)] for one in series])
    low, high = (sizes.min(), sizes.max()) if len(sizes) else (1.0, 10.0)
    rows = max(one.rows_per_group for one in good)
    notes = [
        "From each sample's stamp to the next one's, in the order of the file. A peak is a gap:"
        " samples are missing, or the clock was set."
    ]
    if rows > 1:
        notes.append(
            f"The curve goes through the shortest and the longest of every {rows}, of which the"
            " median in the table is."
        )
    medians = tuple(
        (f"median {imus[one.topic].interval_ms[1]:.4g} ms", imus[one.topic].interval_ms[1])
        for one in good[:2]
    )
    return Figure(
        "interval",
        "Interval between samples",
        np.zeros(0),
        tuple(series),
        LOG_TIME,
        "interval, ms",
        log_y=True,
        y_range=(0.5 * float(low), 2.0 * float(high)),
        notes=tuple(notes),
        levels=medians,
    )


def _histogram(good: list[Sampling]) -> Figure | None:
    one = good[0]
    middles, counts, outside = one.shares()
    if not len(middles):
        return None
    of = f", {one.topic}" if len(good) > 1 else ""
    notes = ["One narrow column is a steady clock; several are a clock that ticks too coarsely."]
    if outside:
        notes.append(f"{counted_clause(outside, 'interval', 'lies', 'lie')} beyond the axis.")
    return Figure(
        "histogram",
        f"Histogram of the sample intervals{of}",
        middles,
        (Series("samples", positive(counts), style="bars"),),
        "interval, ms",
        "samples, number",
        log_y=True,
        y_range=(0.5, 2.0 * max(float(counts.max()), 1.0)),
        notes=tuple(notes),
    )


def _delays(good: list[Sampling], imus: dict[str, InspectedImu], origin: int) -> Figure | None:
    """Delay of samples from stamp to recording."""
    series, notes = [], []
    for one in good:
        if imus[one.topic].time_source != "stamp" or one.least_delay_ns is None:
            continue
        seconds, values = one.curves(origin)
        series.append(Series(one.topic, values[:, 1] - one.least_delay_ns / 1e6, x=seconds))
        notes.append(f"of {one.topic} {one.least_delay_ns / 1e9:+.6f} s")
    if not any(np.nanmax(one.y, initial=0.0) > 0.0 for one in series):
        return None
    return Figure(
        "delay",
        "Recorded later than stamped",
        np.zeros(0),
        tuple(series),
        LOG_TIME,
        "delay, ms",
        notes=(
            f"Log time minus stamp, above its minimum ({'; '.join(notes)}). Steps and peaks are"
            " the recorder's load; a slope is two clocks that run apart.",
        ),
    )


def _values(one: Sampling, number: int, of: str, origin: int) -> list[Figure | None]:
    seconds, values = one.values.curves(origin)
    gyro = [Series(axis, values[:, k]) for k, axis in enumerate(AXES)]
    force = [Series(axis, values[:, 3 + k]) for k, axis in enumerate(AXES)]
    force.append(Series("norm", values[:, 6], style="dashed"))
    more = (INCREMENTS,) if one.values.increments else ()
    rows = one.values.rows_per_group
    if rows > 1:
        thinned = (
            f"Curves go through the lowest and the highest of every {rows}, of which the median in"
            " the table is."
        )
        more = (*more, thinned)
    about_force = (
        "Along the log's own axes. At rest the norm is gravity, about 9.8 m/s², and the axis that"
        " has it points up."
    )
    about_gyro = "About the log's own axes, as read with the units below."
    return [
        Figure(f"{key}-{number}", title + of, seconds, tuple(series), LOG_TIME, label,
               notes=(note, *more))
        for key, title, series, label, note in (
            ("gyro", "Angular rate", gyro, "rate, deg/s", about_gyro),
            ("force", "Specific force", force, "specific force, m/s²", about_force),
        )
    ]  # fmt: skip


def _rates(traffic: Traffic) -> Figure | None:
    series = tuple(Series(topic, rate, x=seconds) for topic, seconds, rate in traffic.rates())
    if not series:
        return None
    every = np.concatenate([one.y[np.isfinite(one.y)] for one in series])
    # Whole decades: within one, ticks would crowd
    low, high = np.floor(np.log10(0.9 * every.min())), np.ceil(np.log10(1.1 * every.max()))
    return Figure(
        "traffic",
        "Messages of each topic",
        np.zeros(0),
        series,
        LOG_TIME,
        "rate, Hz",
        log_y=True,
        y_range=(float(10.0**low), float(10.0**high)),
        notes=(
            f"By log time. A point is the mean over the time of {MESSAGES:g} messages at least,"
            f" or over 1/{POINTS} of the log. A topic that is silent all that time has a hole"
            " there, a shorter silence only lowers its rate. Topics of one rate lie on one"
            " another.",
        ),
    )
