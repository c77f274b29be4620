"""Figures for plotly: plain dictionaries; the page's theme sets the colours."""

from __future__ import annotations

import html
from collections.abc import Iterator, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sinstool.report.decimate import thin
from sinstool.report.figure import Figure, FloatArray, Series
from sinstool.report.palette import DASHES, LIGHT_CURVES

Side = Literal["left", "right"]

_LINE = {"type": "line", "line": {"dash": "dot", "width": 1.2}}
_NAME = {"showarrow": False}

# Dark to bright, both of them seen on light pages and on dark ones.
SHADES = [[0.0, "#3b6fd6"], [0.35, "#1f9e89"], [0.65, "#7ab51d"], [1.0, "#e8590c"]]
_BESIDE_MAP = {"thickness": 10, "outlinewidth": 0, "len": 0.9, "xpad": 8}

# Numbers on a shorter logarithmic axis are written out, decades.
SHORT_DECADES = 4.0

CROWD = 400  # from so many on, points of a series are drawn smaller
_BESIDE = 0.012  # room beside the outermost points, of the axis
POINTS_PER_CURVE = 4000  # two for each of the two thousand pixel columns of a wide screen


def plotly_figure(figure: Figure, limit: int = POINTS_PER_CURVE) -> dict[str, Any]:
    """Describe a figure in plotly's terms.

    Colours, fonts and margins are absent: the page's script adds those of its theme.

    Parameters
    ----------
    limit : int, optional
        Points of a curve at most; see :func:`~sinstool.report.decimate.thin`.

    Returns
    -------
    dict
        With ``data`` and ``layout``; numbers of traces are arrays of 4 or 8 bytes each. Each trace
        has its colour's number as ``meta.colour``.
    """
    straight = [*_levels(figure), *_marks(figure)]
    ys = [np.asarray(one.y, dtype=np.float64) for one in figure.series if one.shown]
    layout: dict[str, Any] = {
        "xaxis": _axis(figure.xlabel, figure.log_x, _x_range(figure), _xs(figure)),
        "yaxis": _axis(figure.ylabel, figure.log_y, figure.y_range, ys),
        "shapes": [line for line, _ in straight],
        "annotations": [name for _, name in straight],
        "barmode": "group",
    }
    if figure.equal:
        layout["yaxis"] |= {"scaleanchor": "x", "scaleratio": 1}
    data = [_trace(figure, k, one, limit) for k, one in enumerate(figure.series)]
    return {"data": data, "layout": layout}


def places(figure: Figure, series: Series) -> FloatArray | tuple[str, ...]:
    """Places of the points of a series: its own, or else its figure's.

    Returns
    -------
    ndarray, shape (n,), or tuple of str
    """
    x = figure.x if series.x is None else series.x
    if len(x) and isinstance(x[0], str):
        return tuple(str(word) for word in x)
    return np.asarray(x, dtype=np.float64)


def drawn(
    figure: Figure, series: Series, limit: int
) -> tuple[Any, FloatArray, NDArray[np.intp] | slice]:
    """Return the points of a series that are drawn.

    Parameters
    ----------
    limit : int
        How many at most. Words are never thinned: each is there to be read.

    Returns
    -------
    x : ndarray, shape (m,), or tuple of str
    y : ndarray, shape (m,)
    rows : ndarray of int, shape (m,), or slice
        Which points they are.
    """
    x = places(figure, series)
    y = np.asarray(series.y, dtype=np.float64)
    if isinstance(x, tuple) or y.size <= limit:
        return x, y, slice(None)
    if series.shade is not None or series.style == "halo":
        # Of a path in colours, and of dots about it, even steps look better than extremes
        chosen = np.unique(np.linspace(0, y.size - 1, min(y.size, 2 * limit)).astype(np.intp))
        return x[chosen], y[chosen], chosen
    chosen = thin(x, y, limit, figure.log_x)
    return x[chosen], y[chosen], chosen


def colour_of(figure: Figure, k: int) -> int:
    """Number of a series' colour.

    Parameters
    ----------
    k : int
        Number of the series.
    """
    own = figure.series[k].colour
    return (k if own is None else own) % len(LIGHT_CURVES)


def dash_of(figure: Figure, k: int) -> str:
    """Dash of the line of a series; arguments as for :func:`colour_of`."""
    series = figure.series[k]
    if series.style == "dashed":
        return "dash"
    return DASHES[k // len(LIGHT_CURVES) % len(DASHES)]


def unit(label: str) -> str:
    """The unit in an axis label: the part after its last comma.

    Returns
    -------
    str
        Empty where there is no comma.
    """
    return label.rpartition(", ")[2] if ", " in label else ""


def _xs(figure: Figure) -> list[FloatArray | tuple[str, ...]]:
    return [places(figure, one) for one in figure.series]


def _x_range(figure: Figure) -> tuple[float, float] | None:
    """Range of the x axis; plotly by itself leaves much room beside points."""
    styles = {one.style for one in figure.series}
    xs = [x for x in _xs(figure) if not isinstance(x, tuple)]
    plain = not (figure.log_x or figure.equal or "bars" in styles) and len(xs) == len(figure.series)
    if figure.x_range is not None or not plain or "points" not in styles:
        return figure.x_range
    good = [x[np.isfinite(x)] for x in xs]
    ends = [float(end) for x in good if x.size for end in (x.min(), x.max())]
    if not ends or max(ends) == min(ends):
        return None
    beside = _BESIDE * (max(ends) - min(ends))
    return min(ends) - beside, max(ends) + beside


def _text(text: str) -> str:
    """Escape text that plotly would read as markup."""
    return html.escape(text, quote=False)


def _axis(
    label: str,
    log: bool,
    shown: tuple[float, float] | None,
    values: Sequence[FloatArray | tuple[str, ...]],
) -> dict[str, Any]:
    numbers = [one for one in values if not isinstance(one, tuple)]
    words = len(numbers) < len(values)
    axis: dict[str, Any] = {
        "type": "category" if words else "log" if log else "linear",
        "title": {"text": _text(label)},
    }
    if shown is not None:
        # plotly takes the ends of a logarithmic axis as exponents
        axis["range"] = [float(v) for v in (np.log10(shown) if log else shown)]
    if log and not words:
        low, high = np.log10(shown) if shown is not None else _exponents(numbers)
        # One number a decade; with fewer ticks plotly leaves decades out, with more it crowds in
        # twos and fives
        if high - low < SHORT_DECADES:
            # Else plotly writes small twos and fives between the powers of ten
            axis["tickformat"] = "~g" if abs(low + high) < 8.0 else ".0e"
        axis["nticks"] = int(np.clip(np.ceil(1.1 * (high - low)) + 1.0, 5.0, 10.0))
    return axis


def _exponents(values: Sequence[FloatArray]) -> tuple[float, float]:
    good = [one[np.isfinite(one) & (one > 0.0)] for one in values]
    ends = [float(end) for one in good if one.size for end in (one.min(), one.max())] or [1.0, 10.0]
    return float(np.log10(min(ends))), float(np.log10(max(ends)))


def _levels(figure: Figure) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Yield the line and the name of each level."""
    for k, (name, value) in enumerate(figure.levels):
        place = float(value)
        line = {"xref": "paper", "x0": 0, "x1": 1, "y0": place, "y1": place}
        # By turns at either end: levels that lie close together do not write over each other
        text = {"xref": "paper", "x": 1 - k % 2, "xanchor": ("right", "left")[k % 2]}
        text |= {"y": _position(place, figure.log_y), "yanchor": "bottom"}
        yield _LINE | line, _NAME | {"text": _text(name)} | text


def _marks(figure: Figure) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Yield the line and the name of each mark, the name along the line within the plot."""
    sides = mark_sides(figure)
    for (name, value), side in zip(figure.marks, sides, strict=True):
        place = float(value)
        line = {"yref": "paper", "y0": 0, "y1": 1, "x0": place, "x1": place}
        text = {"yref": "paper", "y": 1, "yanchor": "top", "textangle": -90, "xanchor": side}
        text |= {"x": _position(place, figure.log_x)}
        yield _LINE | line, _NAME | {"text": _text(name)} | text


def mark_sides(figure: Figure) -> tuple[Side, ...]:
    """Choose which end of its name touches each mark.

    Returns
    -------
    tuple of {"right", "left"}
        Right, so that the name stands left of its line, except at the left end of the axis and
        where another mark stands close by on the left.
    """
    if not figure.marks:
        return ()
    at = [float(_position(value, figure.log_x)) for _, value in figure.marks]
    first, last = _ends(figure)
    near = 0.035 * (max(last, *at) - first)
    return tuple(
        "left"
        if any(0.0 <= place - other < near for other in (first, *at[:k], *at[k + 1 :]))
        else "right"
        for k, place in enumerate(at)
    )


def _ends(figure: Figure) -> tuple[float, float]:
    """Return the ends of the x axis, as exponents where it is logarithmic."""
    if figure.x_range is not None:
        first, last = figure.x_range
        return float(_position(first, figure.log_x)), float(_position(last, figure.log_x))
    numbers = [one for one in _xs(figure) if not isinstance(one, tuple)]
    if figure.log_x:
        return _exponents(numbers)
    good = [x[np.isfinite(x)] for x in numbers]
    ends = [float(end) for x in good if x.size for end in (x.min(), x.max())]
    return (min(ends), max(ends)) if ends else (0.0, 1.0)


def _position(value: Any, log: bool) -> Any:
    """Return where text stands: plotly wants the exponent where it takes lines by value."""
    return np.log10(value) if log else value


def _trace(figure: Figure, k: int, series: Series, limit: int) -> dict[str, Any]:
    x, y, rows = drawn(figure, series, limit)
    trace: dict[str, Any] = {
        "type": "bar" if series.style == "bars" else "scatter",
        "name": _text(series.name),
        "x": [_text(word) for word in x] if isinstance(x, tuple) else _packed(x, figure.log_x),
        "y": _packed(y, figure.log_y),
        "visible": series.shown,
        "meta": {"colour": colour_of(figure, k)},
        "hovertemplate": _hover(figure, series, isinstance(x, tuple)),
    }
    if series.error is not None:
        error = _packed(np.asarray(series.error, dtype=np.float64)[rows], False)
        trace["error_y"] = {"array": error, "thickness": 1.3, "width": 4}
    if series.shade is not None:
        trace |= {"mode": "markers+lines", "line": {"width": 2.5}}
        shade = _packed(np.asarray(series.shade, dtype=np.float64)[rows], False)
        trace["marker"] = {"size": 5, "color": shade, "colorscale": SHADES, "showscale": True}
        trace["marker"]["colorbar"] = _BESIDE_MAP | {"title": {"text": _text(figure.shade_label)}}
    elif series.style == "halo":
        # In a colour of its own: of pale points that cover each other the overlaps would be seen
        trace |= {"mode": "markers", "marker": {"size": 9}}
        trace["meta"]["halo"] = True
    elif series.style == "points":
        crowd = len(y) > CROWD
        size = 3.5 if crowd else 6 if len(y) > 1 else 10
        marker = {"size": size, "opacity": 0.6 if crowd else 1.0}
        trace |= {"mode": "markers", "marker": marker | {"symbol": k // len(LIGHT_CURVES)}}
    elif series.style in ("line", "dashed"):
        width = 1.2 if series.style == "dashed" else 1.6
        trace |= {"mode": "lines", "line": {"width": width, "dash": dash_of(figure, k)}}
    return trace


def _hover(figure: Figure, series: Series, words: bool) -> str:
    """Name, then both coordinates with their units."""
    # A name is no template, whatever signs it has
    name, x, y = (
        _text(text).replace("%{", "%\N{ZERO WIDTH SPACE}{")
        for text in (series.name, figure.xlabel, figure.ylabel)
    )
    x_unit, y_unit = unit(x), unit(y)
    x_name = x.removesuffix(f", {x_unit}") if x_unit else x
    y_name = y.removesuffix(f", {y_unit}") if y_unit else y
    x_place = "%{x}" if words else "%{x:.7~g}"
    finite = np.abs(series.y[np.isfinite(series.y)])
    small = figure.log_y or not bool(np.any(finite >= 1e-3))
    y_place = "%{y:.4~e}" if small else "%{y:.6~g}"
    return (
        f"<b>{name}</b><br>{x_name}: {x_place} {x_unit}<br>{y_name}: {y_place} {y_unit}"
        "<extra></extra>"
    )


def _packed(values: FloatArray, log: bool) -> NDArray[np.floating[Any]]:
    """Numbers in half the bytes where nobody could see it."""
    finite = values[np.isfinite(values)]
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        off = np.abs(finite.astype(np.float32).astype(np.float64) - finite)
        span = np.ptp(finite) if finite.size else 0.0
        short = bool(np.all(np.isfinite(off) & (off <= 1e-6 * span)))
        if log:
            short = short and bool(np.all(off <= 1e-6 * np.abs(finite)))
        return np.ascontiguousarray(values.astype("<f4" if short else "<f8"))
