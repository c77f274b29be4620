from __future__ import annotations

import base64
import gzip
import hashlib
import importlib
import json
import re
import subprocess
import sys
import tomllib
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

import sinstool
from sinstool.core.errors import ConfigurationError, OutputError
from sinstool.report.draw import plotly_figure
from sinstool.report.figure import Figure, Series
from sinstool.report.library import PLOTLY, packed_library, page_script, share_script
from sinstool.report.markup import POINTS_PER_PAGE, markup, points_per_curve, style_sheet
from sinstool.report.page import check_report, write_report
from sinstool.report.palette import DARK, LIGHT
from sinstool.report.sections import Column, Page, Prose, Setting, Settings, Table
from tests.report.pages import NASTY, figures, page

VOID = {"meta", "link", "br", "img", "input", "hr", "rect", "circle", "path"}


class Outline(HTMLParser):
    """Elements with their attributes and the text in them; complains of bad nesting."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, str]] = []
        self.open: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append((self.open[-1] if self.open else "", data))

    def all(self, tag, **attributes):
        return [
            attrs
            for one, attrs in self.elements
            if one == tag and all(attrs.get(k.rstrip("_")) == v for k, v in attributes.items())
        ]

    def said(self, *tags):
        return [text for tag, text in self.texts if tag in tags]


@pytest.fixture(scope="module")
def text() -> str:
    return markup(page())


@pytest.fixture(scope="module")
def outline(text) -> Outline:
    return Outline(text)


def test_nothing_from_elsewhere(outline):
    for tag, attrs in outline.elements:
        assert "src" not in attrs and tag not in ("link", "iframe", "object", "embed", "base")
        assert all(not name.startswith("on") for name in attrs)
        if "href" in attrs:
            assert attrs["href"].startswith("#")
    (policy,) = outline.all("meta", **{"http-equiv": "Content-Security-Policy"})
    assert "default-src 'none'" in policy["content"] and "http" not in policy["content"]
    assert "file:" not in policy["content"]
    assert not re.search(r"@import|url\((?!data:)", style_sheet())


def test_links_lead_somewhere(outline):
    names = [attrs["id"] for _, attrs in outline.elements if "id" in attrs]
    assert len(set(names)) == len(names)
    links = outline.all("a")
    assert len(links) == 11
    assert {attrs["href"][1:] for attrs in links} <= set(names)
    for _, attrs in outline.elements:
        assert attrs.get("aria-labelledby", names[0]) in names


def test_all_figures_with_captions_and_legends(outline):
    plots = outline.all("div", class_="drawing")
    assert [attrs["data-key"] for attrs in plots] == [one.key for one in figures()]
    assert len(outline.all("figure")) == len(outline.all("figcaption")) == len(figures())
    for attrs, figure in zip(plots, figures(), strict=True):
        assert attrs["role"] == "img"
        assert figure.title in attrs["aria-label"] and figure.ylabel in attrs["aria-label"]
    buttons = outline.all("button")
    # A single curve needs no key
    keyed = [figure for figure in figures() if len(figure.series) > 1]
    shown = [one.shown for figure in keyed for one in figure.series]
    assert [attrs["aria-pressed"] == "true" for attrs in buttons] == shown
    assert all(note in outline.said("p") for figure in figures() for note in figure.notes)


def test_figure_data_can_be_read(text):
    specs = [
        json.loads(one)
        for one in re.findall(r'<script type="application/json">(.*?)</script>', text)
    ]
    titles = [one["layout"]["yaxis"]["title"]["text"] for one in specs]
    assert len(titles) == 6 and titles[0] == "difference, arcsec"
    (packed,) = re.findall(r'<script type="application/gzip" id="numbers">(.*?)</script>', text)
    block = gzip.decompress(base64.b64decode(packed))
    for spec, figure in zip(specs, figures(), strict=True):
        given = plotly_figure(figure, points_per_curve(figures()))
        for trace, expected in zip(spec["data"], given["data"], strict=True):
            place = trace["y"]
            size = int(place["type"][1:])
            raw = np.frombuffer(block, np.uint8)[place["at"] :][: place["n"] * size]
            values = raw.reshape(size, -1).T.copy().view(f"<u{size}")[:, 0]
            if place["steps"]:
                values = np.cumsum(values, dtype=values.dtype)
            np.testing.assert_array_equal(values.view(f"<f{size}"), expected["y"])


def test_many_pages_share_one_script(tmp_path):
    script = share_script(tmp_path / "pages")
    assert share_script(tmp_path / "pages") == script
    assert script.read_bytes() == gzip.decompress(packed_library()) + b"\n" + page_script().encode()
    below = tmp_path / "pages" / "a b#"
    below.mkdir()
    alone, shared = tmp_path / "alone.html", below / "shared.html"
    write_report(alone, page())
    write_report(shared, page(), script=script)
    text = shared.read_text()
    assert f'<script src="../{script.name}"></script>' in text
    assert f"This file and ../{script.name} hold all" in text
    saved = alone.stat().st_size - shared.stat().st_size
    assert saved > len(packed_library()), "the page carries the library too"
    outline = Outline(text)
    (policy,) = outline.all("meta", **{"http-equiv": "Content-Security-Policy"})
    assert "script-src 'unsafe-inline' 'self' file:;" in policy["content"]
    assert "http" not in policy["content"]


def test_the_library_is_what_its_readme_says():
    assets = Path(sinstool.__file__).parent / "report" / "assets"
    said = (assets / "README.md").read_text()
    library = gzip.decompress(packed_library())
    (digest,) = re.findall(r"^ {4}([0-9a-f]{64})$", said, re.MULTILINE)
    assert hashlib.sha256(library).hexdigest() == digest
    (version,) = set(re.findall(r"\d+\.\d+\.\d+", PLOTLY))
    assert f"(basic - minified) v{version}".encode() in library[:100]
    assert f"`{PLOTLY}`" in said and f"plotly.js-basic-dist-min) {version}" in said
    assert "MIT License" in (assets / "plotly-basic.LICENSE").read_text()


def test_tables(outline):
    # two of data, one of rows, two of settings, one for the numbers of each figure
    assert len(outline.all("table")) == 5 + len(figures())
    assert all(attrs["scope"] in ("col", "row") for attrs in outline.all("th"))
    cells = outline.said("td", "th")
    assert {"1.2e-5", "1440000", "–", "coning.algorithms", "a, b"} <= set(cells)
    assert "deg/h" in outline.said("span")


def test_defaults_are_marked_and_printed(text, outline):
    changed, defaults = text.index(">coning.algorithms<"), text.index(">kept<")
    assert changed < text.index("1 setting at the default") < defaults
    folded = outline.all("details", class_="kept")
    assert len(folded) == 2, "the long table and the defaults"
    assert "details:not(.kept)" in style_sheet()
    bare = markup(Page("t", "", (Settings((Setting("a", 1, False),)),)))
    assert "All settings are the defaults." in bare


def test_key_figures(outline):
    assert outline.said("dt")[0] == "Drift" and outline.said("dd")[0] == "1.2 deg/h"
    assert f"note {NASTY}" in outline.said("span")


def test_warnings_come_first_and_once(text, outline):
    assert text.index("late warning") < text.index('id="section-1"')
    assert outline.said("li").count("late warning") == 1
    assert "2 warnings" in outline.said("h2")
    assert 'class="warnings"' not in markup(Page("t"))


def test_escaped_everywhere(outline, text):
    said = outline.said("h1", "h2", "p", "li", "td", "th", "button", "title", "a")
    assert sum(NASTY in one for one in said) >= 12
    # plotly's and ours, the numbers, and the six figures
    assert len(outline.all("script")) == 3 + len(figures())
    assert "alert" not in "".join(
        one
        for one in outline.said("script")
        if "application/json" not in one and "u003c" not in one
    )
    assert "<script>alert" not in text


def test_version_and_language(outline):
    assert any(sinstool.__version__ in one for one in outline.said("p"))
    assert outline.all("html", lang="en") and outline.all("meta", charset="utf-8")
    assert outline.all("meta", name="viewport")
    for tag in ("header", "main", "nav", "footer"):
        assert len(outline.all(tag)) == 1


def test_the_package_carries_what_is_not_code():
    package = Path(sinstool.__file__).parent
    settings = tomllib.loads((package.parent / "pyproject.toml").read_text())
    carried = {
        file
        for name, patterns in settings["tool"]["setuptools"]["package-data"].items()
        for pattern in patterns
        for file in package.parent.joinpath(*name.split(".")).glob(pattern)
    }
    files = {p for p in package.rglob("*") if p.is_file() and "__pycache__" not in p.parts}
    assert {p for p in files if p.suffix != ".py"} == carried != set()


def test_both_themes_and_print():
    css = style_sheet()
    assert set(LIGHT) == set(DARK)
    dark = css.index("prefers-color-scheme: dark")
    for name in LIGHT:
        assert css.index(f"--{name}: {LIGHT[name]};") < dark < css.index(f"--{name}: {DARK[name]};")
    # "aspect" is of each map
    assert set(re.findall(r"var\(--([\w-]+)\)", css)) <= {*LIGHT, "aspect"}
    assert "@media print" in css and "break-inside: avoid" in css
    assert css.count("{") == css.count("}")


@pytest.mark.parametrize("theme", [LIGHT, DARK], ids=["light", "dark"])
def test_contrast(theme):
    def light(colour):
        parts = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        return float(linear @ (0.2126, 0.7152, 0.0722))

    def contrast(a, b):
        low, high = sorted((light(theme[a]), light(theme[b])))
        return (high + 0.05) / (low + 0.05)

    assert contrast("ink", "page") > 10.0
    for name in ("muted", "accent"):
        assert contrast(name, "page") > 4.5
    assert contrast("warning", "warning-page") > 4.5
    assert all(contrast(f"curve-{k}", "page") > 3.0 for k in range(10))


@pytest.mark.slow
def test_the_worst_hour_stays_below_a_megabyte_and_a_half(tmp_path):
    rng = np.random.default_rng(5)
    n = 3600 * 400
    # Random in every bit, so that nothing can be written short or compressed; 60 curves
    drawn = tuple(
        Figure(
            f"f{k}",
            "t",
            np.cumsum(rng.random(n)),
            tuple(Series(f"s{j}", 1e8 + rng.random(n)) for j in range(10)),
            "time, s",
            "y, m",
        )
        for k in range(6)
    )
    write_report(tmp_path / "hour.html", page(drawn))
    size = (tmp_path / "hour.html").stat().st_size
    print(f"an hour at 400 Hz, 60 curves of noise: {size / 1e6:.2f} MB")
    assert size < 1.5e6


def test_points_of_many_curves():
    few, many = figures(10), figures(10) * 40
    assert points_per_curve(few) == 4000
    limit = points_per_curve(many)
    drawn = [min(one.y.size, limit) for figure in many for one in figure.series]
    assert 0.9 * POINTS_PER_PAGE < sum(drawn) <= POINTS_PER_PAGE
    assert points_per_curve(()) == 4000
    # Seven long curves beside many short ones share what those leave
    t = np.arange(1e5)
    long = Figure("k", "t", t, tuple(Series(f"s{k}", t) for k in range(40)), "x", "y")
    short = Figure("s", "t", t[:50], tuple(Series(f"s{k}", t[:50]) for k in range(100)), "x", "y")
    assert points_per_curve((long, short)) == (POINTS_PER_PAGE - 100 * 50) // 40


def test_refusals_of_the_page():
    figure = figures()[0]
    with pytest.raises(ValueError, match="one key"):
        Page("t", "", (figure, figure))
    with pytest.raises(ValueError, match="2 cells for 1"):
        Table("t", (Column("a"),), ((1, 2),))


def test_existing_file_and_missing_folder(tmp_path):
    path = tmp_path / "page.html"
    bare = Page("Bare", "", (Prose(("text",)),))
    write_report(path, bare)
    before = path.read_bytes()
    with pytest.raises(OutputError, match="exists already"):
        write_report(path, Page("Other"))
    assert path.read_bytes() == before
    write_report(path, bare, overwrite=True)
    assert path.read_bytes() == before, "the same page gives other bytes"
    with pytest.raises(OutputError, match="is the input itself"):
        write_report(path, bare, inputs=[path], overwrite=True)
    with pytest.raises(OutputError, match="does not exist"):
        write_report(tmp_path / "no" / "page.html", bare)
    assert [one.name for one in tmp_path.iterdir()] == ["page.html"]


def test_failure_leaves_nothing(tmp_path, monkeypatch):
    def fails(*_):
        raise RuntimeError

    monkeypatch.setattr("sinstool.report.markup.markup", fails)
    with pytest.raises(RuntimeError):
        write_report(tmp_path / "page.html", Page("Bare"))
    assert list(tmp_path.iterdir()) == []


def test_suffixes(tmp_path):
    with pytest.raises(ConfigurationError, match=r"one of \.html, .png, .pdf, .svg"):
        check_report(tmp_path / "page.docx")
    with pytest.raises(OutputError, match="there is no figure"):
        write_report(tmp_path / "page.png", Page("Bare"))


def test_missing_extra(tmp_path, monkeypatch):
    import_module = importlib.import_module

    def missing(module, *args):
        if module.startswith("matplotlib"):
            raise ModuleNotFoundError("No module named 'matplotlib'", name="matplotlib")
        return import_module(module, *args)

    monkeypatch.setattr(importlib, "import_module", missing)
    message = re.escape("the report needs matplotlib: pip install 'sinstool[report]'")
    for write in (write_report, lambda path, _: check_report(path)):
        with pytest.raises(ConfigurationError, match=f"^{message}$"):
            write(tmp_path / "a.pdf", page())
    assert list(tmp_path.iterdir()) == []
    # A page needs none
    write_report(tmp_path / "a.html", page())


def test_nothing_is_imported_before_it_draws():
    script = (
        "import sys, sinstool.report.page\n"
        "print([m for m in ('sinstool.report.markup', 'matplotlib') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_zero_has_no_sign_and_points_are_those_drawn():
    """A page printed "-0", and of 2301 samples 2302 points."""
    y = np.array([-0.0, -1e-9, np.nan, 0.0])
    figure = Figure("f", "Zero", np.arange(4.0), (Series("s", y),), "time, s", "rate, deg/s")
    columns = (Column("row"), Column("a", "", ".3f"), Column("b"))
    table = Table("T", columns, (("one", -0.0004, -0.0), ("two", -0.0006, -1.0)))
    made = Page("Title", "log", (figure, table))
    text = markup(made)
    numbers = re.findall(r'<td class="number">([^<]*)</td>', text)
    assert numbers == ["3", "-1e-9", "0", "0", "0", "0.000", "0", "-0.001", "-1"]
