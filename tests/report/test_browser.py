"""The page in a browser: drawn without a complaint and without a request, wide and narrow."""

from __future__ import annotations

import pytest

from sinstool.report.library import share_script
from sinstool.report.page import write_report
from tests.report.browser import DARK, WIDTHS, needs_browser, opened
from tests.report.pages import figures, page

pytestmark = [pytest.mark.slow, needs_browser]


# In the dark with the script beside the page
@pytest.fixture(scope="module", params=["light", "dark"])
def seen(request, tmp_path_factory):
    path = tmp_path_factory.mktemp(request.param) / "page.html"
    script = share_script(path.parent) if request.param == "dark" else None
    write_report(path, page(), script=script)
    state, console = opened(path, *([DARK] if request.param == "dark" else []))
    assert set(state) == {str(width) for width in WIDTHS}
    return request.param, state, console


def test_no_complaint_and_no_request(seen):
    _, state, console = seen
    assert console == []
    for one in state.values():
        assert one["heard"] == []
        assert all(name.startswith("file:") for name in one["loaded"])
        assert one["undrawn"] == 0


@pytest.mark.parametrize("width", WIDTHS)
def test_all_figures_drawn(seen, width):
    _, state, _ = seen
    plots = state[str(width)]["plots"]
    assert [one["key"] for one in plots] == [figure.key for figure in figures()]
    for one, figure in zip(plots, figures(), strict=True):
        assert one["svg"] >= 1
        # a curve without a single number is not drawn
        drawn = sum(series.shown and series.name != "nothing" for series in figure.series)
        assert one["curves"] in (drawn, sum(series.shown for series in figure.series))


@pytest.mark.parametrize("width", WIDTHS)
def test_fits_the_width(seen, width):
    _, state, _ = seen
    one = state[str(width)]
    assert one["inner"] == width and one["scroll"] <= width
    assert all(abs(plot["width"] - plot["room"]) < 1.0 for plot in one["plots"])


def test_theme(seen):
    theme, state, _ = seen
    page_colour = {"light": "#ffffff", "dark": "#14171b"}[theme]
    for one in state.values():
        assert {plot["page"] for plot in one["plots"]} == {page_colour}


def test_legend_hides_and_shows(seen):
    _, state, _ = seen
    for one in state.values():
        assert one["pressed"] == [[1, "false"], [2, "true"], [1, "true"], [2, "true"]]


def test_printed_in_light_at_the_paper_s_width(seen):
    _, state, _ = seen
    for one in state.values():
        assert {plot["page"] for plot in one["printed"]} == {"#ffffff"}
        assert {plot["width"] for plot in one["printed"]} == {660}
        assert one["after"] == one["plots"]
