"""The contents of a figure, independent of drawing: the report draws them, tests read them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sinstool.core.arrays import FloatArray

Style = Literal["line", "dashed", "points", "halo", "bars"]


@dataclass(frozen=True)
class Series:
    """One curve.

    Attributes
    ----------
    name : str
        For the legend.
    y : ndarray, shape (n,)
        In the unit of the figure's y axis; NaN leaves a hole.
    x : ndarray, shape (n,), or sequence of str, or None
        Where it differs from the figure's own `x`.
    style : {"line", "dashed", "points", "halo", "bars"}
        A halo is made of points that are larger than a line is wide, and pale, so that they are
        seen about one that covers them.
    shown : bool
        Whether it is drawn before the reader asks for it.
    colour : int or None
        The number of the series whose colour it has, as a bound has that of its curve; its own
        for None.
    error : ndarray, shape (n,), or None
        Half the length of a bar about each point, in the unit of the y axis.
    shade : ndarray, shape (n,), or None
        What the line is coloured by; the figure's `shade_label` says what it is.
    """

    name: str
    y: FloatArray
    x: FloatArray | Sequence[str] | None = None
    style: Style = "line"
    shown: bool = True
    colour: int | None = None
    error: FloatArray | None = None
    shade: FloatArray | None = None


@dataclass(frozen=True)
class Figure:
    """One figure.

    Attributes
    ----------
    key : str
        Short name, unique within a report.
    x : ndarray, shape (n,), or sequence of str
        Common to the series; words for bars.
    xlabel, ylabel : str
        With the unit.
    log_x, log_y : bool
        Logarithmic axes; series then hold positive numbers only.
    x_range, y_range : tuple of float or None
        What is shown at first.
    notes : tuple of str
        Sentences for below the figure.
    levels : tuple of (str, float)
        Horizontal lines: what each is, and where.
    marks : tuple of (str, float)
        Vertical lines.
    equal : bool
        Both axes have one scale, as a map has, and lengths for units: a bar shows the scale.
    shade_label : str
        Of what series are coloured by, with the unit.
    """

    key: str
    title: str
    x: FloatArray | Sequence[str]
    series: tuple[Series, ...]
    xlabel: str
    ylabel: str
    log_x: bool = False
    log_y: bool = False
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    notes: tuple[str, ...] = ()
    levels: tuple[tuple[str, float], ...] = field(default=())
    marks: tuple[tuple[str, float], ...] = field(default=())
    equal: bool = False
    shade_label: str = ""

    def __post_init__(self) -> None:
        names = [one.name for one in self.series]
        if len(set(names)) != len(names):
            raise ValueError(f"{self.key}: two series have one name.")
        for one in self.series:
            n = len(self.x if one.x is None else one.x)
            if one.y.shape != (n,):
                raise ValueError(f"{self.key}, {one.name}: {one.y.shape} values for {n} places.")
            for more in (one.error, one.shade):
                if more is not None and more.shape != (n,):
                    raise ValueError(f"{self.key}, {one.name}: {more.shape} values for {n} places.")
            if self.log_y and not np.all((one.y > 0.0) | np.isnan(one.y)):
                raise ValueError(f"{self.key}, {one.name}: not all values have a logarithm.")


def heading_curve(seconds: FloatArray, heading: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Heading within one turn, with a hole where it goes over the turn's end.

    Parameters
    ----------
    seconds : ndarray, shape (n,)
    heading : ndarray, shape (n,)
        deg, of any turn; NaN makes holes.

    Returns
    -------
    seconds : ndarray, shape (m,)
    heading : ndarray, shape (m,)
        From 0 to 360 deg, or from -180 to 180 where that cuts the curve less often.
    """
    chosen, over = min(
        (_within(heading, first) for first in (0.0, -180.0)), key=lambda one: len(one[1])
    )
    return np.insert(seconds, over, seconds[over]), np.insert(chosen, over, np.nan)


def _within(heading: FloatArray, first: float) -> tuple[FloatArray, NDArray[np.intp]]:
    """Heading in the turn that begins at `first`, and the rows before which it was cut."""
    within = (heading - first) % 360.0 + first
    return within, np.flatnonzero(np.abs(np.diff(within)) > 180.0) + 1
