from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sinstool.report.draw import plotly_figure, unit
from sinstool.report.figure import Figure, Series, heading_curve
from sinstool.report.page import FORMATS, write_report
from sinstool.report.sections import Page
from tests.report.pages import figures, page


def one(key: str) -> Figure:
    return next(figure for figure in figures() if figure.key == key)


@pytest.mark.parametrize("figure", figures(), ids=lambda figure: figure.key)
def test_plotly_accepts_each_figure(figure):
    from plotly import graph_objects

    graph_objects.Figure(plotly_figure(figure))


@pytest.mark.parametrize("figure", figures(), ids=lambda figure: figure.key)
def test_every_series_is_there_with_its_values(figure):
    data = plotly_figure(figure, limit=10_000)["data"]
    assert len(data) == len(figure.series)
    for trace, series in zip(data, figure.series, strict=True):
        np.testing.assert_allclose(trace["y"], series.y, rtol=1e-6, atol=1e-6)
        assert trace["visible"] == series.shown


def test_axes_and_lines():
    layout = plotly_figure(one("spectrum"))["layout"]
    assert layout["xaxis"]["type"] == layout["yaxis"]["type"] == "log"
    assert layout["xaxis"]["range"] == [-1.0, 2.0]
    # Lines stand at values, text at exponents
    assert [shape["y0"] for shape in layout["shapes"][:2]] == [1e-9, 1e-3]
    assert [text["y"] for text in layout["annotations"][:2]] == [-9.0, -3.0]
    assert [text["x"] for text in layout["annotations"][2:]] == [2.0, -1.0]
    assert [text["xanchor"] for text in layout["annotations"][2:]] == ["right", "left"]


def test_words_make_categories():
    spec = plotly_figure(one("means"))
    assert spec["layout"]["xaxis"]["type"] == "category"
    assert spec["data"][0]["x"] == ["consistent, cheb:6", "literal, cheb:6"]
    assert spec["data"][0]["type"] == "bar"


def test_styles():
    data = plotly_figure(one("spectrum"))["data"]
    assert [trace["line"]["dash"] for trace in data] == ["solid", "dash"]
    assert plotly_figure(one("cost"))["data"][0]["mode"] == "markers"
    again = plotly_figure(one("sweep"))["data"]
    looks = {(trace["meta"]["colour"], trace["line"]["dash"]) for trace in again}
    assert len(looks) == len(again), "two curves look the same"


def test_numbers_are_short_only_where_nobody_can_see_it():
    latitude = 48.0 + 1e-7 * np.arange(9.0)
    tiny = np.geomspace(1e-60, 1e-50, 9)
    huge = np.array([1e-3, 1e300] + [np.nan] * 7)
    even = np.linspace(0.0, 3600.0, 9)
    for y, kind in ((latitude, "f8"), (tiny, "f8"), (huge, "f8"), (even, "f4")):
        figure = Figure("k", "t", np.arange(9.0), (Series("s", y),), "x", "y")
        packed = plotly_figure(figure)["data"][0]["y"]
        assert packed.dtype == kind
        np.testing.assert_allclose(packed, y, rtol=1e-7)


def test_thinned_to_the_limit():
    data = plotly_figure(one("walk"), limit=100)["data"]
    assert all(len(trace["x"]) <= 100 for trace in data)


def test_unit():
    assert unit("time, s") == "s"
    assert unit("density, of all, (rad/s)²/Hz") == "(rad/s)²/Hz"
    assert unit("number") == ""


@pytest.mark.slow
@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("figure", figures(), ids=lambda figure: figure.key)
def test_figure_for_a_paper(tmp_path, figure, suffix):
    path = tmp_path / f"figure{suffix}"
    alone = Page("t", "", (figure,))
    write_report(path, alone)
    head = path.read_bytes()
    assert head.startswith({".png": b"\x89PNG", ".pdf": b"%PDF", ".svg": b"<?xml"}[suffix])
    write_report(path, alone, overwrite=True)
    assert path.read_bytes() == head, "the same figure gives other bytes"


def test_report_by_suffix(tmp_path):
    write_report(tmp_path / "a.PNG", page())
    assert (tmp_path / "a.PNG").read_bytes().startswith(b"\x89PNG")


def test_page_without_figures_has_no_script(tmp_path):
    write_report(tmp_path / "bare.html", Page("Bare"))
    assert "<script" not in (tmp_path / "bare.html").read_text()


def test_heading_is_cut_where_it_is_cut_least():
    t = np.arange(6.0)
    # about north: cut at 180 deg, where it never comes
    at, curve = heading_curve(t, np.array([350.0, 355.0, 0.0, 5.0, 725.0, -3.0]))
    assert list(curve) == [-10.0, -5.0, 0.0, 5.0, 5.0, -3.0] and list(at) == list(t)
    # about south: cut at 0 deg
    _, curve = heading_curve(t, np.array([170.0, 190.0, -170.0, 175.0, 185.0, np.nan]))
    np.testing.assert_array_equal(curve, [170.0, 190.0, 190.0, 175.0, 185.0, np.nan])
    # a whole turn has one hole
    at, curve = heading_curve(t, np.array([10.0, 100.0, 190.0, 280.0, 370.0, 460.0]))
    assert np.isnan(curve).sum() == 1 and len(at) == 7 and at[np.isnan(curve)][0] in t


def test_bound_has_the_colour_of_its_curve():
    y = np.ones(3)
    both = (Series("a", y), Series("b", y), Series("bound", y, style="dashed", colour=1))
    drawn = plotly_figure(Figure("k", "t", np.arange(3.0), both, "x", "y"))["data"]
    assert [trace["meta"]["colour"] for trace in drawn] == [0, 1, 1]
    assert drawn[2]["line"]["dash"] == "dash"


def test_map_has_one_scale():
    line = Figure("k", "t", np.arange(3.0), (Series("a", np.ones(3)),), "x", "y", equal=True)
    assert plotly_figure(line)["layout"]["yaxis"]["scaleanchor"] == "x"
    assert "scaleanchor" not in plotly_figure(replace(line, equal=False))["layout"]["yaxis"]
