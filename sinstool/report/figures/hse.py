"""Figures of a calibration of heading-sensitive error, without how they are drawn.

The first is the calibration itself: heading against rate, eq. (15) of Yu et al., J. NUDT 35(4),
2013, 161-165, with what the fit allows. The others are what an operator looks at when it is bad.
"""

from __future__ import annotations

import numpy as np
from scipy import special

from sinstool.core.arrays import BoolArray, FloatArray
from sinstool.core.earth import EARTH_RATE
from sinstool.core.rotation import wrapped
from sinstool.core.units import ARCSEC, DEGREE, DEGREE_PER_HOUR
from sinstool.methods.hse.axial import earth_rate_along_axis
from sinstool.methods.hse.fit_result import HseFit
from sinstool.methods.hse.statistics import Column
from sinstool.pipelines.calibrate_hse.result import Calibration
from sinstool.report.figure import Figure, Series, Style
from sinstool.report.figures.hse_turns import east_rate_allan, heading_by_turn, rates_over_time
from sinstool.report.figures.parts import both_sides

_GRID = 101
_OUTSTANDING = 2.0
# The last of the colours
_GREY = 9


def figures(calibration: Calibration) -> tuple[Figure, ...]:
    """All figures of a calibration, the main one first.

    Returns
    -------
    tuple of Figure
        Those for which there is something to show.
    """
    turning = [run for run in calibration.runs if run.per_turn_heading is not None]
    made = [
        heading_against_rate(calibration.fit),
        residuals_against_rate(calibration.fit),
        residuals_by_run(calibration.fit),
        azimuth_figure(calibration),
        axial_rate(calibration.fit),
        heading_by_turn(turning) if turning else None,
        rates_over_time(calibration.logs),
        east_rate_allan(turning),
    ]
    return tuple(one for one in made if one is not None)


def heading_against_rate(result: HseFit) -> Figure:
    """Heading of each run against rate, the fit at each position, and its 95 % band.

    Headings are those less the heading free of heading-sensitive error of their position. The
    band is that of the fitted mean, at the position that leans most to the east.
    """
    rate = np.array([run.rate for run in result.runs])
    offset = _headings_at_rest(result)
    used = np.array([one.used for one in result.run_fits])
    series = []
    if result.K is not None:
        grid = _grid(rate)
        lines = _Lines(result)
        for k in lines.positions:
            line = lines.at(k, grid) / ARCSEC
            series.append(Series(f"fit, {lines.name(k)}", line, grid / DEGREE, colour=k))
        series += _band(lines, grid, lines.at(lines.lead, grid))
        axial = lines.by_axial(grid, rate, offset, used)
        if axial is not None:
            series.append(
                Series("slope by the axial rate", axial / ARCSEC, grid / DEGREE, "dashed")
            )
    series += _by_position(result, rate / DEGREE, offset / ARCSEC, used)
    return Figure(
        "heading",
        "Heading against rate of the table",
        np.sort(rate) / DEGREE,
        tuple(series),
        "Rate of the table, deg/s",
        "Heading, arcsec",
        notes=(
            "Headings are shown relative to that which the fit gives each position without the"
            " error.",
        ),
    )


def _grid(rate: FloatArray) -> FloatArray:
    span = 0.04 * max(float(np.ptp(rate)), 0.1)
    return np.linspace(rate.min() - span, rate.max() + span, _GRID)


def _band(lines: _Lines, rate: FloatArray, middle: FloatArray) -> list[Series]:
    """The 95 % band about the line of the position that leans most; none where nothing tells it."""
    half = lines.band(lines.lead, rate)
    if half is None:
        return []
    edges = (middle - half) / ARCSEC, (middle + half) / ARCSEC
    name = f"95 % band, {lines.name(lines.lead)}"
    return [both_sides(name, rate / DEGREE, *edges, colour=lines.lead)]


def _points(x: FloatArray, y: FloatArray, used: BoolArray) -> list[Series]:
    """A point for each run, those in use and those left out apart."""
    parts = (("runs in use", used), ("runs left out", ~used))
    return [Series(name, y[rows], x[rows], "points") for name, rows in parts if rows.any()]


def _by_position(result: HseFit, x: FloatArray, y: FloatArray, used: BoolArray) -> list[Series]:
    """A point for each run, in the colour of its position; those left out apart."""
    position = np.array([one.position for one in result.run_fits])
    psi0 = _psi0(result)
    parts = []
    for k in np.unique(position[used]).tolist():
        rows = used & (position == k)
        at = f"base at {psi0[k] / DEGREE:.2f} deg" if k in psi0 else f"position {k + 1}"
        parts.append(Series(f"runs, {at}", y[rows], x[rows], "points", colour=k))
    if not used.all():
        parts.append(Series("runs left out", y[~used], x[~used], "points", colour=_GREY))
    return parts


def _headings_at_rest(result: HseFit) -> FloatArray:
    """Headings less psi0 of their position, or less the position's mean where there is no fit."""
    heading = np.array([run.heading for run in result.runs])
    position = np.array([one.position for one in result.run_fits])
    offset = np.empty(len(heading))
    psi0 = _psi0(result)
    for k in np.unique(position):
        here = position == k
        from_first = wrapped(heading[here] - heading[here][0])
        if k in psi0:
            offset[here] = wrapped(heading[here] - psi0[k])
        else:
            offset[here] = from_first - from_first.mean()
    return offset


def _psi0(result: HseFit) -> dict[int, float]:
    """Fitted heading free of error, rad, by position."""
    fitted = sorted({one.position for one in result.run_fits if one.used})
    return dict(zip(fitted, result.psi0, strict=True)) if result.psi0 else {}


class _Lines:
    """The fitted headings as functions of rate, position by position.

    A position's line is drawn with the mean lean of its runs: psi0, which is the origin here,
    plus ``lambda2 (Omega - w sin L) C23 / (3 w cos L)`` plus ``tau Omega``.
    """

    def __init__(self, result: HseFit) -> None:
        self.result = result
        self.psi0 = _psi0(result)
        self.positions = sorted(self.psi0)
        self.lean = {k: self._mean_lean(k) for k in self.positions}
        self.lead = max(self.positions, key=lambda k: abs(self.lean[k]))
        self.north = 3.0 * EARTH_RATE * np.cos(result.latitude)
        self.down = EARTH_RATE * np.sin(result.latitude)
        names = result.parameters
        self.slope = next((n for n in ("lambda2", "K") if n in names), None)

    def _mean_lean(self, k: int) -> float:
        mine = zip(self.result.runs, self.result.run_fits, strict=True)
        return float(np.mean([run.C23 for run, one in mine if one.used and one.position == k]))

    def name(self, k: int) -> str:
        return f"base at {self.psi0[k] / DEGREE:.2f} deg"

    def _columns(self, k: int, rate: FloatArray) -> dict[str, FloatArray]:
        """Derivatives of heading by the parameters but for headings themselves."""
        lambda1 = rate - self.down
        columns = {"lambda2": lambda1 * self.lean[k] / self.north, "tau": rate}
        # the published line goes through Omega itself
        columns["K"] = rate if self.result.form == "paper" else lambda1
        return columns

    def at(self, k: int, rate: FloatArray) -> FloatArray:
        columns = self._columns(k, rate)
        lambda2, K = self.result.lambda2_heading, self.result.K or 0.0
        if self.slope == "lambda2" and lambda2 is not None:
            line = lambda2 * columns["lambda2"]
        else:
            line = K * columns["K"]
        return np.asarray(line + (self.result.delay or 0.0) * columns["tau"])

    def band(self, k: int, rate: FloatArray) -> FloatArray | None:
        """Half of the 95 % interval of the line, rad; None where nothing tells it."""
        covariance = self.result.covariance
        if not covariance.size or not np.isfinite(covariance).all():
            return None
        columns = self._columns(k, rate)
        nothing = np.zeros_like(rate)
        rows = np.stack([columns.get(n, nothing) for n in self.result.parameters], axis=1)
        # headings come first among the parameters, in the order of the positions
        rows[:, self.positions.index(k)] = 1.0
        variance = np.einsum("ij,jk,ik->i", rows, covariance, rows)
        student = self.result.distribution == "t" and self.result.dof > 0
        quantile = special.stdtrit(self.result.dof, 0.975) if student else special.ndtri(0.975)
        return np.asarray(quantile * np.sqrt(np.maximum(variance, 0.0)))

    def by_axial(
        self, grid: FloatArray, rate: FloatArray, offset: FloatArray, used: BoolArray
    ) -> FloatArray | None:
        """The line that the axial coefficient has, through the middle of the runs in use."""
        position = np.array([one.position for one in self.result.run_fits])
        here = used & (position == self.lead)
        if not here.any():
            return None
        slope = self.result.axial.lambda2 * self.lean[self.lead] / self.north
        slope += self.result.delay or 0.0
        middle = offset[here].mean() - slope * rate[here].mean()
        return np.asarray(middle + slope * grid)


def residuals_against_rate(result: HseFit) -> Figure | None:
    """Residual of each heading after the fit, in the band of the position that leans most."""
    if result.K is None:
        return None
    rate = np.array([run.rate for run in result.runs])
    left = np.array([np.nan if one.residual is None else one.residual for one in result.run_fits])
    used = np.array([one.used for one in result.run_fits])
    grid = _grid(rate)
    series = _band(_Lines(result), grid, np.zeros_like(grid))
    series += _by_position(result, rate / DEGREE, left / ARCSEC, used)
    return Figure(
        "residuals",
        "Residuals against rate",
        np.sort(rate) / DEGREE,
        tuple(series),
        "Rate of the table, deg/s",
        "Residual of heading, arcsec",
        notes=(
            "The band is the uncertainty of the fitted line, not the scatter"
            " of the runs. Residuals that curve with rate are not heading-sensitive error.",
        ),
    )


def residuals_by_run(result: HseFit) -> Figure | None:
    """Residual of each run over its own standard deviation."""
    if result.K is None:
        return None
    rows = [
        (run.id, one.studentised)
        for run, one in zip(result.runs, result.run_fits, strict=True)
        if one.used and one.studentised is not None
    ]
    if not rows:
        return None
    return Figure(
        "studentised",
        "Residuals by run, studentised",
        tuple(name for name, _ in rows),
        (Series("residual", np.array([value for _, value in rows]), style="bars"),),
        "Run",
        "Residual, standard deviations",
        levels=(("2 sigma", _OUTSTANDING), ("-2 sigma", -_OUTSTANDING)),
        notes=(
            "Each residual divided by its standard deviation, by the other runs. One in twenty good"
            " runs is beyond 2.",
        ),
    )


def azimuth_figure(calibration: Calibration) -> Figure | None:
    """Headings before and after correction against azimuth, with sinusoids through them."""
    table, spread = calibration.table, calibration.spread
    if table is not None:
        azimuth = table.azimuth
        before, after = table.before, table.after
        grid = np.linspace(0.0, 2.0 * np.pi, 4 * 90 + 1)
        series = [
            _headings("before", azimuth, before.values),
            _headings("after", azimuth, after.values),
        ]
        styles: tuple[tuple[str, Column, Style], ...] = (
            ("before", before, "line"),
            ("after", after, "dashed"),
        )
        for name, column, style in styles:
            if (s := column.sinusoid) is not None:
                y = (s.offset + s.cosine * np.cos(grid) + s.sine * np.sin(grid)) / ARCSEC
                series.append(Series(f"sinusoid, {name}", y, grid / DEGREE, style))
        title = "Heading less azimuth, before and after correction"
        label = "Azimuth of the stand, deg"
        notes = ("Less its mean. Sinusoids are fitted where there are three azimuths or more.",)
    elif spread:
        azimuth = np.array([a for one in spread for a in [one.heading] * len(one.before)])
        series = [
            _headings("before", azimuth, np.concatenate([one.before for one in spread])),
            _headings("after", azimuth, np.concatenate([one.after for one in spread])),
        ]
        title = "Heading at each position, before and after correction"
        label = "Mean corrected heading of the position, deg"
        notes = (
            "No azimuths were given (--azimuth LOG=DEG): headings are shown less the mean corrected"
            " heading of their own position. An error common to all runs"
            " of a position does not show.",
        )
    else:
        return None
    return Figure(
        "azimuth",
        title,
        np.sort(azimuth % (2.0 * np.pi)) / DEGREE,
        tuple(series),
        label,
        "Heading, arcsec",
        x_range=(-5.0, 365.0),
        notes=notes,
    )


def _headings(name: str, azimuth: FloatArray, values: FloatArray) -> Series:
    return Series(name, values / ARCSEC, azimuth % (2.0 * np.pi) / DEGREE, "points")


def axial_rate(result: HseFit) -> Figure:
    """Difference of gyros and encoder along the axis, and the line whose slope is lambda2."""
    total = np.array([run.rate + earth_rate_along_axis(run) for run in result.runs])
    error = np.array([run.c_axial for run in result.runs]) * total
    used = np.array([one.used for one in result.run_fits])
    axial = result.axial
    grid = np.linspace(min(0.0, total.min()), max(0.0, total.max()), _GRID)
    line = axial.c * grid + (axial.bias or 0.0)
    series = [Series("fit", line / DEGREE_PER_HOUR, grid / DEGREE)]
    series += _points(total / DEGREE, error / DEGREE_PER_HOUR, used)
    return Figure(
        "axial",
        "Gyro rate less encoder rate along the axis",
        np.sort(total) / DEGREE,
        tuple(series),
        "Rate about the axis, Earth rate included, deg/s",
        "Rate error along the axis, deg/h",
        notes=(
            "The slope is c = -lambda2/3; an intercept is the gyros' bias along the axis. Headings"
            " are not in this figure: it is an independent measurement of the same coefficient.",
        ),
    )
