"""Figures of the input of a calibration of heading-sensitive error: turns, rates, noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sinstool.core.arrays import ArrayLike, FloatArray
from sinstool.core.earth import EARTH_RATE
from sinstool.core.rotation import wrapped
from sinstool.core.units import ARCSEC, DEGREE, DEGREE_PER_HOUR
from sinstool.methods.hse.run import HseRun, rate_groups
from sinstool.methods.hse.segments import Segment
from sinstool.report.figure import Figure, Series, Style
from sinstool.survey.rig import RigTurns

# Marks with the names of more logs than this would cover each other.
_NAMED_LOGS = 12
# Allan deviations of fewer differences than this say nothing.
_FEWEST_DIFFERENCES = 3


def _by_rate(runs: Sequence[HseRun]) -> Iterator[tuple[str, list[HseRun]]]:
    """The runs at each rate of the table, with the rate's name."""
    group = rate_groups(np.array([run.rate for run in runs]))
    for k in np.unique(group).tolist():
        mine = [run for run, g in zip(runs, group, strict=True) if g == k]
        yield f"{np.mean([run.rate for run in mine]) / DEGREE:+.1f} deg/s", mine


def heading_by_turn(runs: Sequence[HseRun]) -> Figure:
    """Heading of every turn less that of its run, against time, a curve for each rate."""
    series = []
    for name, mine in _by_rate(runs):
        x, y = [], []
        for run in mine:
            assert run.per_turn_heading is not None
            turn = run.duration_s / run.n_turns
            x.append(run.t_start_s + turn * (np.arange(run.n_turns) + 0.5))
            y.append(wrapped(run.per_turn_heading - run.heading) / ARCSEC)
            # a hole between runs
            x.append(x[-1][-1:])
            y.append(np.array([np.nan]))
        series.append(Series(name, np.concatenate(y), np.concatenate(x) / 60.0))
    return Figure(
        "turns",
        "Heading of every turn, less that of its run",
        np.array([0.0]),
        tuple(series),
        "Time since the start of the log, min",
        "Heading, arcsec",
        notes=("A slope within runs is a system that warms up, or a base that moves.",),
    )


def rates_over_time(logs: Sequence[RigTurns]) -> Figure:
    """Rate of the table with the stretches that are used and those that are not."""
    offsets, marks, end = [], [], 0.0
    for log in logs:
        offsets.append(end)
        if 1 < len(logs) <= _NAMED_LOGS:
            marks.append((log.source, end / 60.0))
        times = log.segmentation.block_time_s
        end += float(times[-1]) if len(times) else 0.0
    table = [(log.segmentation.block_time_s, log.segmentation.block_rate) for log in logs]
    used = [_within(log, log.segmentation.used) for log in logs]
    rejected = [_within(log, log.segmentation.rejected) for log in logs]
    series = [_rates("table", table, offsets, "line"), _rates("used", used, offsets, "points")]
    if any(len(t) for t, _ in rejected):
        series.append(_rates("not used", rejected, offsets, "points"))
    return Figure(
        "rates",
        "Rate of the table, and the stretches used",
        np.array([0.0]),
        tuple(series),
        "Time, logs end to end, min" if len(logs) > 1 else "Time since the start of the log, min",
        "Rate of the table, deg/s",
        marks=tuple(marks),
        notes=("The table of stretches gives the reasons why some are not used.",)
        if any(len(t) for t, _ in rejected)
        else (),
    )


def _within(log: RigTurns, segments: Sequence[Segment]) -> tuple[FloatArray, FloatArray]:
    """Blocks of rate that lie in segments."""
    time, rate = log.segmentation.block_time_s, log.segmentation.block_rate
    inside = np.zeros(len(time), dtype=bool)
    for one in segments:
        inside |= (time >= one.start_s) & (time <= one.start_s + one.duration_s)
    return time[inside], rate[inside]


def _rates(
    name: str, parts: list[tuple[FloatArray, FloatArray]], offsets: list[float], style: Style
) -> Series:
    x = [np.append(time + at, at + time[-1:]) for (time, _), at in zip(parts, offsets, strict=True)]
    y = [np.append(rate, np.full(len(rate[-1:]), np.nan)) for _, rate in parts]
    return Series(name, np.concatenate(y) / DEGREE, np.concatenate(x) / 60.0, style)


def allan_deviation(values: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Overlapping Allan deviation of rates that are means over equal intervals.

    Parameters
    ----------
    values : array_like, shape (n,)

    Returns
    -------
    m : ndarray, shape (k,)
        Intervals averaged over: 1, 2, 4, ... up to n/2, as long as three differences are left.
    variance : ndarray, shape (k,)
        In the unit of the values, squared. IEEE Std 952-1997, annex C.
    """
    x = np.asarray(values, dtype=np.float64)
    angle = np.concatenate([[0.0], np.cumsum(x - (x.mean() if len(x) else 0.0))])
    m, variances = 1, []
    while len(angle) - 2 * m >= _FEWEST_DIFFERENCES:
        second = angle[2 * m :] - 2.0 * angle[m:-m] + angle[: -2 * m]
        variances.append((m, float(np.mean(second**2)) / (2.0 * m * m)))
        m *= 2
    columns = np.array(variances, dtype=np.float64).reshape(-1, 2)
    return columns[:, 0], columns[:, 1]


def east_rate_allan(runs: Sequence[HseRun]) -> Figure | None:
    """Allan deviation of the East rate of the turns, a curve for each rate of the table."""
    series: list[Series] = []
    walks: list[float] = []
    for name, mine in _by_rate(runs):
        tau, deviation = _pooled(mine)
        if not len(tau) or not (deviation > 0.0).all():
            continue
        style: Style = "line" if len(tau) > 1 else "points"
        series.append(Series(name, deviation / DEGREE_PER_HOUR, tau, style))
        walks.append(float(deviation[0] * np.sqrt(tau[0])))
    if not series:
        return None
    walk = float(np.median(walks))
    ends = [np.asarray(one.x, dtype=np.float64) for one in series]
    tau = np.array([min(x[0] for x in ends), max(x[-1] for x in ends)])
    if tau[1] > tau[0]:
        name = f"random walk, {walk / DEGREE * 60.0:.2g} deg/sqrt(h)"
        series.append(Series(name, walk / np.sqrt(tau) / DEGREE_PER_HOUR, tau, "dashed"))
    return Figure(
        "allan",
        "Allan deviation of the East rate of the turns",
        tau,
        tuple(series),
        "Averaging time, s",
        "Allan deviation of the East rate, deg/h",
        log_x=True,
        log_y=True,
        notes=(
            "White noise of the gyros falls along the dashed line, drawn through the median of the"
            " single turns; its random walk is the --arw of --plan. Where"
            " the curve turns up, longer runs do not help.",
        ),
    )


def _pooled(runs: Sequence[HseRun]) -> tuple[FloatArray, FloatArray]:
    """Averaging times, s, and Allan deviations, rad/s, of runs at one rate together."""
    total: dict[float, list[tuple[float, int]]] = {}
    turn = float(np.mean([run.duration_s / run.n_turns for run in runs]))
    for run in runs:
        assert run.per_turn_heading is not None
        heading = wrapped(run.per_turn_heading - run.heading)
        m, variance = allan_deviation(-heading * EARTH_RATE * np.cos(run.latitude))
        for size, value in zip(m.tolist(), variance.tolist(), strict=True):
            total.setdefault(size, []).append((value, run.n_turns + 1 - 2 * int(size)))
    sizes = sorted(total)
    deviation = [
        np.sqrt(sum(v * n for v, n in total[size]) / sum(n for _, n in total[size]))
        for size in sizes
    ]
    return turn * np.array(sizes), np.array(deviation)
