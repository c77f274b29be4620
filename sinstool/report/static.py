"""One figure as an image or a vector file, for a paper."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from sinstool.report.draw import CROWD, SHADES, colour_of, drawn, mark_sides, unit
from sinstool.report.extra import borrowed
from sinstool.report.figure import Figure, Series
from sinstool.report.palette import LIGHT, LIGHT_CURVES

SIZE_IN = (7.0, 4.0)  # over both columns of a page
RESOLUTION_DPI = 300
POINTS_PER_CURVE = 6000
SHORT_DECADES = 2.2
_FONT_PT = 9.0

_LINES = {"dashed": (0, (5, 2.5))}
_AGAIN: tuple[Any, ...] = ("-", ":", "-.", (0, (7, 2, 1.5, 2)))
_MARKERS = "osD^v"


def image(figure: Figure, suffix: str) -> bytes:
    """Draw one figure by itself; series that a reader would first have to ask for are left out.

    The notes are left to the paper's own caption.

    Parameters
    ----------
    suffix : {".png", ".pdf", ".svg"}
        What it is to be.

    Returns
    -------
    bytes
        The whole file.

    Raises
    ------
    ConfigurationError
        If the extra ``report`` is not installed.
    """
    canvas = borrowed("matplotlib.figure")
    matplotlib = borrowed("matplotlib")
    # The same figure gives the same bytes: no date, and no random names in the vector files
    undated = {".png": {}, ".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
    settings = {
        "font.size": _FONT_PT,
        "pdf.fonttype": 42,
        "svg.fonttype": "path",
        "svg.hashsalt": "sinstool",
        "axes.edgecolor": LIGHT["muted"],
        "axes.spines.top": False,
        "axes.spines.right": False,
        "grid.color": LIGHT["grid"],
    }
    content = io.BytesIO()
    with matplotlib.rc_context(settings):
        sheet = canvas.Figure(figsize=SIZE_IN, dpi=RESOLUTION_DPI, layout="constrained")
        _draw(sheet, figure)
        sheet.savefig(content, format=suffix[1:], metadata=undated[suffix])
    return content.getvalue()


def _draw(sheet: Any, figure: Figure) -> None:
    axes = sheet.add_subplot()
    axes.set_title(_text(figure.title), loc="left", fontsize=_FONT_PT + 1.5, pad=10)
    axes.set_xlabel(_text(figure.xlabel))
    axes.set_ylabel(_text(figure.ylabel))
    axes.grid(True, linewidth=0.6)
    axes.set_axisbelow(True)
    shown = [(k, one) for k, one in enumerate(figure.series) if one.shown]
    words = _all_words(figure, [one for _, one in shown])
    bars = [k for k, one in shown if one.style == "bars"]
    for k, series in shown:
        _series(axes, figure, k, series, words, bars)
    if words:
        axes.set_xticks(range(len(words)), [_text(one) for one in words])
        if sum(map(len, words)) > 80:
            axes.tick_params("x", rotation=20)
    elif figure.log_x:
        axes.set_xscale("log")
    if figure.log_y:
        axes.set_yscale("log")
    _lines(axes, figure)
    # Curves fill the width; points and bars would be cut at its ends
    axes.margins(x=0.0 if all(one.style in ("line", "dashed") for _, one in shown) else 0.03)
    if figure.equal:
        axes.set_aspect("equal", "datalim")
    if figure.x_range is not None:
        axes.set_xlim(*figure.x_range)
    if figure.y_range is not None:
        axes.set_ylim(*figure.y_range)
    if figure.equal:
        sheet.draw_without_rendering()
        _scale_bar(axes, figure)
    if figure.log_x and not words:
        _plain_numbers(axes.xaxis, axes.get_xlim())
    if figure.log_y:
        _plain_numbers(axes.yaxis, axes.get_ylim())
    if len(shown) > 1:
        columns = 3 if max(len(one.name) for _, one in shown) < 30 else 2
        sheet.legend(loc="outside lower left", ncols=columns, frameon=False)


def _plain_numbers(axis: Any, ends: tuple[float, float]) -> None:
    """Write 6 and 20 on a short logarithmic axis, where matplotlib has 6 x 10^0 and 2 x 10^1."""
    low, high = np.log10(ends)
    if high - low > SHORT_DECADES:
        return
    ticker = borrowed("matplotlib.ticker")
    axis.set_major_locator(ticker.LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(ticker.FuncFormatter(lambda value, _: f"{value:.4g}"))
    axis.set_minor_formatter(ticker.NullFormatter())


def _text(text: str) -> str:
    """Keep a dollar in a topic's name a dollar; matplotlib reads formulas between two."""
    return text.replace("$", r"\$")


def _all_words(figure: Figure, series: Sequence[Series]) -> tuple[str, ...]:
    labels: dict[str, None] = {}
    for one in series:
        x, _, _ = drawn(figure, one, POINTS_PER_CURVE)
        if isinstance(x, tuple):
            labels |= dict.fromkeys(x)
    return tuple(labels)


def _series(
    axes: Any, figure: Figure, k: int, series: Series, words: Sequence[str], bars: Sequence[int]
) -> None:
    x, y, rows = drawn(figure, series, POINTS_PER_CURVE)
    place = np.array([words.index(one) for one in x]) if isinstance(x, tuple) else x
    look: dict[str, Any] = {
        "color": LIGHT_CURVES[colour_of(figure, k)],
        "label": _text(series.name),
    }
    again = k // len(LIGHT_CURVES)
    if series.style == "bars":
        room = 0.8 * (float(np.min(np.diff(np.unique(place)))) if np.unique(place).size > 1 else 1)
        width = room / len(bars)
        offset = (bars.index(k) - (len(bars) - 1) / 2) * width
        axes.bar(place + offset, y, width, **look)
        place = place + offset
    elif series.shade is not None:
        _shaded(axes, figure, place, y, series.shade[rows])
    elif series.style == "halo":
        look["color"] = LIGHT["halo"]
        axes.plot(place, y, "o", markersize=5.0, markeredgewidth=0.0, **look)
    elif series.style == "points":
        size = 1.2 if len(y) > CROWD else 3.5
        axes.plot(place, y, _MARKERS[again % len(_MARKERS)], markersize=size, **look)
    else:
        line = _LINES.get(series.style, _AGAIN[again % len(_AGAIN)])
        axes.plot(place, y, linestyle=line, linewidth=1.1, **look)
    if series.error is not None:
        over = LIGHT["ink"] if series.style == "bars" else look["color"]
        half = series.error[rows]
        axes.errorbar(place, y, half, ecolor=over, fmt="none", capsize=2.5, elinewidth=0.9)


def _shaded(axes: Any, figure: Figure, x: Any, y: Any, shade: Any) -> None:
    """Draw a line in the colours of its values, with a bar that says what they mean."""
    colours = borrowed("matplotlib.colors").LinearSegmentedColormap.from_list("shades", SHADES)
    lines = borrowed("matplotlib.collections").LineCollection
    points = np.stack([x, y], axis=1)
    pieces = lines(np.stack([points[:-1], points[1:]], axis=1), cmap=colours, linewidth=2.0)
    pieces.set_array(0.5 * (shade[:-1] + shade[1:]))
    axes.add_collection(pieces)
    axes.plot(x, y, linewidth=0.0)
    bar = axes.figure.colorbar(pieces, ax=axes, fraction=0.04, pad=0.02, aspect=30)
    bar.set_label(_text(figure.shade_label))
    bar.outline.set_visible(False)


def _scale_bar(axes: Any, figure: Figure) -> None:
    """Draw a length on a map."""
    low, high = axes.get_xlim()
    size = round_length(0.2 * (high - low))
    bottom, top = axes.get_ylim()
    x, y = low + 0.03 * (high - low), bottom + 0.05 * (top - bottom)
    look = {"color": LIGHT["ink"], "linewidth": 1.6, "solid_capstyle": "butt"}
    axes.plot([x, x + size], [y, y], **look)
    name = f"{size:g} {unit(figure.xlabel)}"
    axes.annotate(name, (x + 0.5 * size, y), (0, 2.5), textcoords="offset points", ha="center",
                  fontsize=_FONT_PT - 1.0)  # fmt: skip


def round_length(most: float) -> float:
    """The largest length of 1, 2 or 5 with any power of ten that is not longer."""
    power = 10.0 ** np.floor(np.log10(most))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= most))


def _lines(axes: Any, figure: Figure) -> None:
    look = {"color": LIGHT["muted"], "linewidth": 0.8, "linestyle": (0, (1, 2))}
    behind = {"facecolor": LIGHT["page"], "alpha": 0.7, "edgecolor": "none", "pad": 0.6}
    text = {"color": LIGHT["muted"], "fontsize": _FONT_PT - 1.5, "bbox": behind}
    for k, (name, value) in enumerate(figure.levels):
        axes.axhline(value, **look)
        # By turns at either end, as levels may lie close together
        axes.text(
            (0.995, 0.005)[k % 2],
            value,
            _text(name),
            transform=axes.get_yaxis_transform(),
            ha=("right", "left")[k % 2],
            va="bottom",
            clip_on=True,
            **text,
        )
    for (name, value), side in zip(figure.marks, mark_sides(figure), strict=True):
        axes.axvline(value, **look)
        axes.text(
            value,
            0.99,
            f" {_text(name)} ",
            transform=axes.get_xaxis_transform(),
            ha=side,
            va="top",
            rotation=90,
            clip_on=True,
            **text,
        )
