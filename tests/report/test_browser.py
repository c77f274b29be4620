"""The page in a browser: drawn without a complaint and without a request, wide and narrow."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from sinstool.report.page import write_page
from tests.report.pages import figures, page

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
BROWSER = next((path for name in BROWSERS if (path := shutil.which(name))), None)
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-extensions",
    "--enable-logging=stderr",
    "--virtual-time-budget=60000",
    "--window-size=1400,1000",
)
WIDTHS = (1280, 400)

pytestmark = pytest.mark.skipif(
    BROWSER is None, reason=f"no browser here: none of {', '.join(BROWSERS)} is on the path"
)

# Stands before everything else in the page, so that it hears of every complaint
EAR = """<script>
window.heard = [];
addEventListener("error", e => heard.push("error: " + e.message));
addEventListener("unhandledrejection", e => heard.push("rejection: " + e.reason));
addEventListener("securitypolicyviolation", e => heard.push("refused: " + e.blockedURI));
for (const kind of ["error", "warn"]) {
  const before = console[kind];
  console[kind] = (...words) => { heard.push(kind + ": " + words.join(" ")); before(...words); };
}
</script>"""

# Looks when all is drawn, then uses the legend as a reader would
EYE = """<script>
const root = document.documentElement;
const count = (plot, what) => plot.querySelectorAll(what).length;
const look = () => [...document.querySelectorAll(".drawing")].map(plot => ({
  key: plot.dataset.key,
  svg: count(plot, "svg.main-svg"),
  curves: count(plot, ".scatterlayer .trace, .barlayer .trace"),
  width: plot.querySelector("svg.main-svg").getBoundingClientRect().width,
  room: plot.getBoundingClientRect().width,
  page: plot._fullLayout.paper_bgcolor,
}));
const waits = setInterval(async () => {
  if (root.dataset.figures !== "drawn") return;
  clearInterval(waits);
  const seen = { plots: look(), inner: innerWidth, scroll: root.scrollWidth };
  const press = async (k, how) => {
    const button = document.querySelectorAll("figure")[0].querySelectorAll(".legend button")[k];
    button.dispatchEvent(new MouseEvent("click", how));
    await new Promise(done => setTimeout(done, 500));
    return [look()[0].curves, button.getAttribute("aria-pressed")];
  };
  seen.pressed = [await press(0, {}), await press(0, {}), await press(1, { shiftKey: true }),
                  await press(1, { shiftKey: true })];
  dispatchEvent(new Event("beforeprint"));
  await new Promise(done => setTimeout(done, 500));
  seen.printed = look();
  dispatchEvent(new Event("afterprint"));
  await new Promise(done => setTimeout(done, 500));
  seen.after = look();
  seen.loaded = performance.getEntriesByType("resource").map(one => one.name);
  seen.heard = heard;
  parent.postMessage(JSON.stringify(seen), "*");
}, 50);
</script>"""

# A window cannot be as narrow as a telephone, a frame can
FRAMES = """<!DOCTYPE html><body><script>
const told = {};
addEventListener("message", e => {
  for (const frame of document.querySelectorAll("iframe"))
    if (frame.contentWindow === e.source) told[frame.width] = JSON.parse(e.data);
  document.querySelector("pre").textContent = JSON.stringify(told);
});
</script><pre></pre>""" + "".join(
    f'<iframe src="page.html" width="{width}" height="900" style="border:0"></iframe>'
    for width in WIDTHS
)


def opened(folder: Path, *flags: str) -> tuple[dict, list[str]]:
    """Open the page at both widths; what it said of itself, and the browser's console."""
    write_page(folder / "page.html", page(), overwrite=True)
    text = (folder / "page.html").read_text()
    text = text.replace('<meta charset="utf-8">', f'<meta charset="utf-8">{EAR}', 1)
    text = text.replace("</body>", f"{EYE}</body>")
    (folder / "page.html").write_text(text)
    (folder / "frames.html").write_text(FRAMES)
    profile = folder / "profile"
    done = subprocess.run(
        [
            str(BROWSER),
            *FLAGS,
            *flags,
            f"--user-data-dir={profile}",
            "--dump-dom",
            (folder / "frames.html").as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=180,
    )
    shutil.rmtree(profile, ignore_errors=True)
    said = re.search(r"<pre>(.+?)</pre>", done.stdout, re.DOTALL)
    assert said, f"the page said nothing; the browser: {done.stderr[-2000:]}"
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return json.loads(html.unescape(said[1])), console


@pytest.fixture(scope="module", params=["light", "dark"])
def seen(request, tmp_path_factory):
    pytest.importorskip("plotly", reason="the page's figures are drawn by plotly")
    dark = ("--blink-settings=preferredColorScheme=0",) if request.param == "dark" else ()
    told, console = opened(tmp_path_factory.mktemp(request.param), *dark)
    assert set(told) == {str(width) for width in WIDTHS}
    return request.param, told, console


def test_no_complaint_and_no_request(seen):
    _, told, console = seen
    assert console == []
    for one in told.values():
        assert one["heard"] == [] and one["loaded"] == []


@pytest.mark.parametrize("width", WIDTHS)
def test_all_figures_drawn(seen, width):
    _, told, _ = seen
    plots = told[str(width)]["plots"]
    assert [one["key"] for one in plots] == [figure.key for figure in figures()]
    for one, figure in zip(plots, figures(), strict=True):
        assert one["svg"] >= 1
        # a curve without a single number is not drawn
        drawn = sum(series.shown and series.name != "nothing" for series in figure.series)
        assert one["curves"] in (drawn, sum(series.shown for series in figure.series))


@pytest.mark.parametrize("width", WIDTHS)
def test_fits_the_width(seen, width):
    _, told, _ = seen
    one = told[str(width)]
    assert one["inner"] == width and one["scroll"] <= width
    assert all(abs(plot["width"] - plot["room"]) < 1.0 for plot in one["plots"])


def test_theme(seen):
    theme, told, _ = seen
    page_colour = {"light": "#ffffff", "dark": "#14171b"}[theme]
    for one in told.values():
        assert {plot["page"] for plot in one["plots"]} == {page_colour}


def test_legend_hides_and_shows(seen):
    _, told, _ = seen
    for one in told.values():
        assert one["pressed"] == [[1, "false"], [2, "true"], [1, "true"], [2, "true"]]


def test_printed_in_light_at_the_paper_s_width(seen):
    _, told, _ = seen
    for one in told.values():
        assert {plot["page"] for plot in one["printed"]} == {"#ffffff"}
        assert {plot["width"] for plot in one["printed"]} == {660}
        assert one["after"] == one["plots"]
