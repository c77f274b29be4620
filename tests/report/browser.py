"""A page in headless Chromium, wide and as narrow as a telephone, and what is to be seen of it."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

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

DARK = "--blink-settings=preferredColorScheme=0"

needs_browser = pytest.mark.skipif(
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
const box = one => one.getBoundingClientRect();
const name = one => one.textContent.trim().slice(0, 40);
// Labels of a plot that stand beyond its edge, and labels of an axis that lie on their neighbours
const cut = plot => [...plot.querySelectorAll(
    ".xtick text, .ytick text, .xtitle, .annotation-text")].filter(one => {
  const [a, b] = [box(one), box(plot)];
  return one.textContent && (a.left < b.left - 1 || a.right > b.right + 1 ||
    a.top < b.top - 1 || a.bottom > b.bottom + 1);
}).map(name);
const crowded = plot => ["xtick", "ytick"].flatMap(kind => {
  const labels = [...plot.querySelectorAll(`.${kind} text`)].filter(one => one.textContent);
  if (labels.some(one => /rotate\\((?!0)/.test(one.getAttribute("transform") || ""))) return [];
  return labels.filter((one, k) => labels.slice(k + 1).some(other => {
    const [a, b] = [box(one), box(other)];
    return a.left < b.right - 1 && b.left < a.right - 1 &&
      a.top < b.bottom - 3 && b.top < a.bottom - 3;
  })).map(name);
});
// What sticks out of the page at the right; tables and contents have a scroll of their own
const wide = () => [...document.body.querySelectorAll("*")].filter(one =>
  box(one).width > 0 && box(one).right > innerWidth + 1 && !one.closest(".wide, nav, svg, script"))
  .map(one => one.tagName + " " + name(one));
const look = () => [...document.querySelectorAll(".drawing")].map(plot => ({
  key: plot.dataset.key,
  svg: count(plot, "svg.main-svg"),
  curves: count(plot, ".scatterlayer .trace, .barlayer .trace"),
  width: plot.querySelector("svg.main-svg").getBoundingClientRect().width,
  room: plot.getBoundingClientRect().width,
  page: plot._fullLayout.paper_bgcolor,
  cut: cut(plot),
  crowded: crowded(plot),
  apart: (legend => legend === null || box(legend).top >= box(plot).bottom - 1 ||
    box(legend).left >= box(plot).right - 1)(plot.closest("figure").querySelector(".legend")),
}));
const waits = setInterval(async () => {
  if (root.dataset.figures !== "drawn") return;
  clearInterval(waits);
  const folded = [...document.querySelectorAll("details:not([open])")];
  const seen = { plots: look(), inner: innerWidth };
  // What is folded has to fit too
  for (const one of folded) one.open = true;
  seen.scroll = root.scrollWidth;
  seen.wide = wide();
  for (const one of folded) one.open = false;
  const buttons = document.querySelectorAll("figure")[0].querySelectorAll(".legend button");
  const press = async (k, how) => {
    const button = buttons[k];
    button.dispatchEvent(new MouseEvent("click", how));
    await new Promise(done => setTimeout(done, 500));
    return [look()[0].curves, button.getAttribute("aria-pressed")];
  };
  if (buttons.length === 2)
    seen.pressed = [await press(0, {}), await press(0, {}), await press(1, { shiftKey: true }),
                    await press(1, { shiftKey: true })];
  dispatchEvent(new Event("beforeprint"));
  await new Promise(done => setTimeout(done, 500));
  seen.printed = look();
  seen.unfolded = [...document.querySelectorAll("details.kept")].every(one => one.open);
  dispatchEvent(new Event("afterprint"));
  await new Promise(done => setTimeout(done, 500));
  seen.after = look();
  seen.loaded = performance.getEntriesByType("resource").map(one => one.name);
  seen.heard = heard;
  seen.undrawn = document.querySelector(".undrawn").getBoundingClientRect().height;
  parent.postMessage(JSON.stringify(seen), "*");
}, 50);
</script>"""

# A window cannot be as narrow as a telephone, a frame can
FRAMES = """<!DOCTYPE html><body><script>
const states = {};
addEventListener("message", e => {
  for (const frame of document.querySelectorAll("iframe"))
    if (frame.contentWindow === e.source) states[frame.width] = JSON.parse(e.data);
  document.querySelector("pre").textContent = JSON.stringify(states);
});
</script><pre></pre>""" + "".join(
    f'<iframe src="page.html" width="{width}" height="900" style="border:0"></iframe>'
    for width in WIDTHS
)


def opened(page: Path, *flags: str) -> tuple[dict, list[str]]:
    """Open a page at both widths.

    Returns
    -------
    seen : dict
        What the page says of itself, by width.
    console : list of str
        Lines of the browser's console.
    """
    folder = page.parent / f"{page.stem}.opened"
    folder.mkdir()
    text = page.read_text(encoding="utf-8")
    text = text.replace('<meta charset="utf-8">', f'<meta charset="utf-8">{EAR}', 1)
    text = text.replace("</body>", f"{EYE}</body>")
    for script in page.parent.glob("figures-*.js"):
        shutil.copy(script, folder)
    (folder / "page.html").write_text(text, encoding="utf-8")
    (folder / "frames.html").write_text(FRAMES, encoding="utf-8")
    done = subprocess.run(
        [
            str(BROWSER),
            *FLAGS,
            *flags,
            f"--user-data-dir={folder / 'profile'}",
            "--dump-dom",
            (folder / "frames.html").as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=180,
    )
    shutil.rmtree(folder, ignore_errors=True)
    said = re.search(r"<pre>(.+?)</pre>", done.stdout, re.DOTALL)
    assert said, f"the page said nothing; the browser: {done.stderr[-2000:]}"
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    seen = json.loads(html.unescape(said[1]))
    assert set(seen) == {str(width) for width in WIDTHS}
    return seen, console
