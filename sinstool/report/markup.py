"""A page as HTML.

The figures lie in the page as JSON without colours, their numbers in one block beside it. The
script draws them again, from the same dictionaries, when the theme or the width changes or the page
is printed; what the reader has zoomed to and switched off stays.
"""

from __future__ import annotations

import base64
import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from html import escape
from importlib.resources import files
from urllib.parse import quote

import numpy as np

from sinstool.core import version
from sinstool.core.english import counted
from sinstool.core.errors import visible
from sinstool.report import sections
from sinstool.report.draw import (
    POINTS_PER_CURVE,
    SHADES,
    colour_of,
    dash_of,
    places,
    plotly_figure,
    unit,
)
from sinstool.report.figure import Figure, Series
from sinstool.report.library import packed_library, page_script
from sinstool.report.packing import Numbers
from sinstool.report.palette import DARK, LIGHT

# All points of a page: 16 bytes each at most, a third more as base64, so 0.7 MB beside the 0.5 MB
# of the drawing library.
POINTS_PER_PAGE = 34_000
FEWEST_POINTS = 50

# The page may run what stands in it, or lies beside it, and load nothing else: no host is asked
# for anything, whatever a library would like to.
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'{beside}; style-src 'unsafe-inline';"
    " img-src data: blob:; font-src data:"
)
# Height over width of a map: no flatter, and no narrower
_ASPECTS = (0.4, 2.5)
# From so many curves on their names stand beside the figure.
_MANY = 6
_DASH_PATTERNS = {
    "solid": "",
    "dash": "6 4",
    "dot": "2 3",
    "dashdot": "6 3 2 3",
    "longdashdot": "9 3 2 3",
}


def markup(page: sections.Page, script: str | None = None) -> str:
    """Return the page as HTML.

    Parameters
    ----------
    script : str, optional
        Link to the script that the page shares with others, relative to the page; by default the
        page carries its own.
    """
    limit = points_per_curve(page.figures)
    numbers = Numbers()
    shown = [_section(one, f"section-{k}", limit, numbers)
             for k, one in enumerate(page.sections, start=1)]  # fmt: skip
    scripts = _scripts(script, numbers) if page.figures else []
    shared = script is not None and bool(page.figures)
    policy = _POLICY.format(beside=" 'self' file:" if shared else "")
    parts = (
        "<!DOCTYPE html>",
        '<html lang="en">',
        "<head>",
        '<meta charset="utf-8">',
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<meta name="color-scheme" content="light dark">',
        f'<meta name="generator" content="sinstool {escape(version.VERSION)}">',
        f"<title>{escape(page.title)}</title>",
        f"<style>\n{style_sheet()}</style>",
        "</head>",
        "<body>",
        "<header>",
        f"<h1>{escape(page.title)}</h1>",
        f"<p>{escape(page.subtitle)}</p>" if page.subtitle else "",
        f'<p class="made">sinstool {escape(version.VERSION)}</p>',
        "</header>",
        "<main>",
        _warnings(tuple(dict.fromkeys(page.warnings))),
        _contents(page.sections),
        *shown,
        "</main>",
        _footer(bool(page.figures), script),
        *scripts,
        "</body>",
        "</html>\n",
    )
    return visible("\n".join(part for part in parts if part))


def _scripts(script: str | None, numbers: Numbers) -> list[str]:
    """The script that draws the figures, and their data."""
    data = f'<script type="application/gzip" id="numbers">{numbers.packed()}</script>'
    if script is not None:
        return [data, f'<script src="{escape(quote(os.fsencode(script)))}"></script>']
    library = base64.b64encode(packed_library()).decode("ascii")
    return [
        data,
        f'<script type="application/gzip" id="library">{library}</script>',
        f"<script>\n{page_script()}</script>",
    ]


def points_per_curve(figures: Sequence[Figure]) -> int:
    """Number of points of each curve that a page can hold."""
    sizes = sorted(one.y.size for figure in figures for one in figure.series)
    left, limit = POINTS_PER_PAGE, POINTS_PER_CURVE
    # What short curves do not need is left to the long ones
    for k, size in enumerate(sizes):
        share = left // (len(sizes) - k)
        if size > share:
            limit = min(POINTS_PER_CURVE, share)
            break
        left -= size
    return max(FEWEST_POINTS, limit)


def _warnings(messages: Sequence[str]) -> str:
    if not messages:
        return ""
    heading = "Warning" if len(messages) == 1 else f"{len(messages)} warnings"
    items = "".join(f"<li>{escape(one)}</li>" for one in messages)
    return (
        '<section class="warnings" aria-labelledby="warnings">'
        f'<h2 id="warnings">{heading}</h2><ul>{items}</ul></section>'
    )


def _contents(shown: Sequence[sections.Section]) -> str:
    titles = [(f"section-{k}", one.title) for k, one in enumerate(shown, start=1)]
    items = [f'<li><a href="#{key}">{escape(title)}</a></li>' for key, title in titles if title]
    if len(items) < 4:
        return ""
    return (
        '<nav aria-labelledby="contents"><h2 id="contents">Contents</h2>'
        f"<ul>{''.join(items)}</ul></nav>"
    )


def _section(section: sections.Section, key: str, limit: int, numbers: Numbers) -> str:
    match section:
        case Figure():
            inside = _figure(section, key, limit, numbers)
        case sections.Table():
            inside = _table(section, key)
        case sections.Settings():
            inside = _settings(section)
        case sections.Rows():
            inside = _rows(section)
        case sections.Prose():
            inside = _paragraphs(section.paragraphs) + _facts(section.facts)
    if not section.title:
        return f'<section id="{key}">{inside}</section>'
    return (
        f'<section id="{key}" aria-labelledby="{key}-title">'
        f'<h2 id="{key}-title">{escape(section.title)}</h2>\n{inside}</section>'
    )


def _paragraphs(paragraphs: Sequence[str], kind: str = "") -> str:
    mark = f' class="{kind}"' if kind else ""
    return "".join(f"<p{mark}>{escape(one)}</p>" for one in paragraphs)


def _facts(facts: Sequence[sections.Fact]) -> str:
    if not facts:
        return ""
    items = "".join(
        f"<div><dt>{escape(one.name)}</dt><dd>{escape(one.value)}"
        + (f'<span class="note">{escape(one.note)}</span>' if one.note else "")
        + "</dd></div>"
        for one in facts
    )
    return f'<dl class="facts">{items}</dl>'


def _rows(rows: sections.Rows) -> str:
    """Return a table without a head, which wraps where the page is narrow."""
    items = "".join(
        f'<tr><th scope="row">{escape(what)}</th><td>{escape(how)}</td></tr>'
        for what, how in rows.pairs
    )
    return f'<table class="rows"><tbody>{items}</tbody></table>'


def _table(table: sections.Table, key: str) -> str:
    table = _without_empty_columns(table)
    numeric = [
        any(_is_number(row[k]) for row in table.rows)
        and all(_is_number(row[k]) or row[k] is None for row in table.rows)
        for k in range(len(table.columns))
    ]
    head = "".join(_heading(*both) for both in zip(table.columns, numeric, strict=True))
    rows = []
    for row in table.rows:
        cells = []
        for k, (cell, column) in enumerate(zip(row, table.columns, strict=True)):
            tag = 'th scope="row"' if k == 0 else "td"
            kind = ' class="number"' if numeric[k] else ""
            cells.append(f"<{tag}{kind}>{_cell(cell, column.form)}</{tag[:2]}>")
        rows.append(f"<tr>{''.join(cells)}</tr>")
    # It scrolls by itself where the page is narrow, and by the keyboard too
    made = (
        f'<div class="wide" tabindex="0" role="region" aria-labelledby="{key}-title"><table>'
        f"<thead><tr>{head}</tr></thead>\n<tbody>{''.join(rows)}</tbody></table></div>"
        f"{_paragraphs(table.notes)}"
    )
    if not table.folded:
        return made
    return f'<details class="kept"><summary>{counted(len(rows), "row")}</summary>{made}</details>'


def _without_empty_columns(table: sections.Table) -> sections.Table:
    """Leave out columns in which no row has a value; the first names the rows."""
    shown = [
        k for k in range(len(table.columns))
        if not k or not table.rows or any(_value(row[k]) != "–" for row in table.rows)
    ]  # fmt: skip
    rows = tuple(tuple(row[k] for k in shown) for row in table.rows)
    return replace(table, columns=tuple(table.columns[k] for k in shown), rows=rows)


def _cell(cell: sections.Cell, form: str | Callable[[float], str]) -> str:
    if isinstance(cell, sections.Link):
        return f'<a href="{escape(quote(os.fsencode(cell.target)))}">{escape(cell.text)}</a>'
    return escape(_value(cell, form))


def _heading(column: sections.Column, numeric: bool) -> str:
    kind = ' class="number"' if numeric else ""
    of = f'<span class="unit">{escape(column.unit)}</span>' if column.unit else ""
    return f'<th scope="col"{kind}>{escape(column.name)}{" " if of else ""}{of}</th>'


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _value(value: object, form: str | Callable[[float], str] = ".10g") -> str:
    """Write a value for reading, and for copying into a spreadsheet; no value is a dash."""
    if value is None or (isinstance(value, str) and not value):
        return "–"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, float | np.floating):
        if math.isnan(value):
            return "–"
        if not isinstance(form, str):
            return form(float(value))
        # 1.2e-05 as 1.2e-5
        text = re.sub(r"e([+-])0+(?=\d)", r"e\1", format(float(value), form))
        # What is rounded to zero has no sign
        return text if re.search("[1-9]", text) else text.removeprefix("-")
    if isinstance(value, list | tuple | np.ndarray):
        return ", ".join(_value(one, form) for one in value) or "–"
    return str(value)


def _count(n: int) -> str:
    return f"{n:,}".replace(",", "\N{NARROW NO-BREAK SPACE}")


def _settings(settings: sections.Settings) -> str:
    """Return the settings that were changed, and the defaults to be unfolded."""
    changed = [one for one in settings.items if one.changed]
    defaults = [one for one in settings.items if not one.changed]
    shown = _setting_table(changed) if changed else "<p>All settings are the defaults.</p>"
    if not defaults:
        return shown
    count = f"{len(defaults)} settings" if len(defaults) > 1 else "1 setting"
    # The printed page has them too: the script unfolds it
    return (
        f'{shown}<details class="kept"><summary>{count} at the default</summary>'
        f"{_setting_table(defaults)}</details>"
    )


def _setting_table(items: Sequence[sections.Setting]) -> str:
    meant = any(one.meaning for one in items)
    rows = "".join(
        f'<tr><th scope="row">{escape(one.name)}</th><td>{escape(_value(one.value))}</td>'
        + (f'<td class="meaning">{escape(one.meaning)}</td>' if meant else "")
        + "</tr>"
        for one in items
    )
    head = '<th scope="col">Setting</th><th scope="col">Value</th>'
    if meant:
        head += '<th scope="col">Meaning</th>'
    return f'<table class="settings"><thead><tr>{head}</tr></thead>\n<tbody>{rows}</tbody></table>'


def _figure(figure: Figure, key: str, limit: int, numbers: Numbers) -> str:
    spec = numbers.as_json(plotly_figure(figure, limit))
    above = f"{figure.ylabel}, over {figure.xlabel}" if figure.equal else figure.ylabel
    names = ", ".join(one.name for one in figure.series)
    described = f"{figure.title}: {figure.ylabel} against {figure.xlabel}. Curves: {names}."
    curves = (one for one in figure.series if not isinstance(places(figure, one), tuple))
    longest = max((one.y.size for one in curves), default=0)
    if figure.equal:
        limit *= 2
    extremes = (
        "in even steps" if figure.equal else "the lowest and the highest of each stretch among them"
    )
    thinned = f"Drawn with at most {_count(limit)} of {_count(longest)} points a curve, {extremes}."
    return (
        f'<figure{_shape(figure)}><p class="ylabel">{escape(above)}</p>\n'
        f'<div class="drawing" role="img" data-key="{escape(figure.key)}"'
        f' data-title="{escape(escape(figure.title, quote=False))}"'
        f' aria-label="{escape(described)}"></div>\n'
        # Within a script, < can only begin its end
        f'<script type="application/json">{spec.replace("<", chr(92) + "u003c")}</script>\n'
        f"{_legend(figure)}"
        f"<figcaption>{_paragraphs(figure.notes)}"
        f"{_paragraphs((thinned,), 'thinned') if longest > limit else ''}</figcaption>"
        f"{_numbers(figure, key)}</figure>"
    )


def _shape(figure: Figure) -> str:
    """Aspect of a figure; that of a map follows its content."""
    if not figure.equal:
        return ' class="many"' if len(figure.series) >= _MANY else ""
    xs = [np.asarray(places(figure, one), dtype=np.float64) for one in figure.series]
    spans = [
        float(np.nanmax(all_) - np.nanmin(all_))
        for all_ in (np.concatenate([one.y for one in figure.series]), np.concatenate(xs))
    ]
    aspect = float(np.clip(spans[0] / max(spans[1], 1e-9), *_ASPECTS))
    kind = "map portrait" if aspect > 1.0 else "map"
    return f' class="{kind}" style="--aspect: {aspect:.2f}"'


def _legend(figure: Figure) -> str:
    """Return the keys of the curves; a single one that stands for the title needs none."""
    if len(figure.series) == 1:
        return ""
    keys = "".join(f"<li>{_key(figure, k)}</li>" for k in range(len(figure.series)))
    return f'<ul class="legend" aria-label="Curves of {escape(figure.title)}">{keys}</ul>\n'


def _key(figure: Figure, k: int) -> str:
    """Return the legend's entry: a button, dead until the script gives it its meaning."""
    series = figure.series[k]
    colour = f"var(--curve-{colour_of(figure, k)})"
    if series.style == "bars":
        sign = f'<rect x="6" y="1" width="14" height="10" style="fill:{colour}"/>'
    elif series.style == "halo":
        sign = '<circle cx="13" cy="6" r="5" style="fill:var(--halo)"/>'
    elif series.shade is not None:
        steps = enumerate(shade for _, shade in SHADES)
        sign = "".join(f'<path d="M{6.5 * k} 6h6.5" style="stroke:{of};stroke-width:3"/>'
                       for k, of in steps)  # fmt: skip
    elif series.style == "points":
        sign = f'<circle cx="13" cy="6" r="4" style="fill:{colour}"/>'
    else:
        again = dash_of(figure, k)
        dashes = _DASH_PATTERNS[again]
        sign = (
            f'<path d="M0 6H26" style="stroke:{colour};stroke-width:2.5"'
            f' stroke-dasharray="{dashes or "none"}"/>'
        )
    return (
        f'<button type="button" disabled aria-pressed="{str(series.shown).lower()}">'
        f'<svg width="26" height="12" aria-hidden="true">{sign}</svg>{escape(series.name)}</button>'
    )


def _numbers(figure: Figure, key: str) -> str:
    """Describe the figure in words: each curve's range, from all its points."""
    of = unit(figure.ylabel)
    columns = (
        sections.Column("Curve"),
        sections.Column("points"),
        *(sections.Column(one, of) for one in _RANGE),
    )
    rows = tuple((one.name, int(np.isfinite(one.y).sum()), *_range(one)) for one in figure.series)
    lines = (
        _places("Levels", figure.levels, of),
        _places("Marks", figure.marks, unit(figure.xlabel)),
    )
    table = _table(sections.Table(figure.title, columns, rows, tuple(filter(None, lines))), key)
    return f"<details><summary>In numbers</summary>{table}</details>"


def _places(kind: str, lines: Sequence[tuple[str, float]], of: str) -> str:
    places = ", ".join(f"{name} ({_value(value)} {of})" for name, value in lines)
    return f"{kind}: {places}." if places else ""


_RANGE = ("lowest", "median", "highest", "last")


def _range(series: Series) -> tuple[float | None, ...]:
    finite = series.y[np.isfinite(series.y)]
    if not finite.size:
        return (None,) * len(_RANGE)
    return (float(finite.min()), float(np.median(finite)), float(finite.max()), float(finite[-1]))


def _footer(figures: bool, script: str | None) -> str:
    hint = (
        '<p class="hint">Drag over a figure to zoom, double-click to return. A click on a curve'
        "’s name hides or shows it; with Shift, it shows that one alone. The camera saves"
        " the figure.</p>"
        f'<p class="undrawn">{_undrawn(script)}</p>'
    )
    holds = " This file holds all that it shows and asks no host for anything."
    if figures and script is not None:
        holds = (
            f" This file and {escape(script)} hold all that it shows, and ask no host for anything."
        )
    return (
        f"<footer>{hint if figures else ''}<p>Made by sinstool {escape(version.VERSION)}."
        f"{holds}</p></footer>"
    )


def _undrawn(script: str | None) -> str:
    """Text shown until the script has drawn the figures."""
    where = "in this page" if script is None else f"in {escape(script)}, which belongs beside it"
    return (
        f"The figures are drawn by a script {where}. They do not appear if scripts are disabled,"
        " or in a browser from before 2023; the tables hold their numbers."
    )


def style_sheet() -> str:
    """The style sheet, with the colours of both themes."""
    css = (files("sinstool.report") / "assets" / "page.css").read_text(encoding="utf-8")
    return (
        f":root {{ color-scheme: light dark; {_variables(LIGHT)} }}\n"
        # The script sets the class before it draws figures for the printer
        f"@media screen and (prefers-color-scheme: dark) {{ :root:not(.printing) {{"
        f" {_variables(DARK)} }} }}\n" + css
    )


def _variables(colours: Mapping[str, str]) -> str:
    return " ".join(f"--{name}: {colour};" for name, colour in colours.items())
