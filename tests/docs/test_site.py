"""The site builds without a warning, its pages ask no other host, and equations are MathML."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from html.parser import HTMLParser

import pytest

import sinstool
from docsite.json_keys import RESULTS, json_keys, rows
from docsite.mathml import equations
from docsite.python_api import python_api
from docsite.reference import options
from tests.docs.examples import scratch
from tests.report.browser import BROWSER, FLAGS, needs_browser

REMOTE = re.compile(r"^(?:https?:)?//")


def build(folder):
    # --quiet would keep warnings from being counted as errors
    return subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict"],
        cwd=folder,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = scratch(tmp_path_factory.mktemp("site"))
    done = build(folder)
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    return folder / "site"


class Loaded(HTMLParser):
    """What a browser fetches of itself to show a page; links that a reader may follow are none."""

    def __init__(self):
        super().__init__()
        self.urls = []

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        if tag == "link" and values.get("rel") not in ("canonical", "next", "prev"):
            self.urls.append(values.get("href"))
        self.urls += [values[key] for key in ("src", "srcset", "data", "poster") if key in values]


@pytest.mark.slow
def test_pages_ask_no_other_host(site):
    pages = list(site.rglob("*.html"))
    assert len(pages) > 20
    for page in pages:
        loaded = Loaded()
        loaded.feed(page.read_text())
        assert loaded.urls
        assert not [url for url in loaded.urls if url and REMOTE.match(url)], page
    for style in site.rglob("*.css"):
        result = re.findall(r"url\(([^)]*)\)", style.read_text())
        assert not [url for url in result if REMOTE.match(url.strip("'\""))], style


@pytest.mark.slow
def test_every_option_of_every_command_is_there(site):
    import click

    from sinstool.cli.main import COMMANDS, cli

    context = click.Context(cli, **cli.context_settings)
    for name in COMMANDS:
        command = cli.get_command(context, name)
        page = site / "commands" / f"{name}.html"
        members = list(command.commands.items()) if isinstance(command, click.Group) else []
        for path, one in [(name, command), *((f"{name} {k}", v) for k, v in members)]:
            text = page.read_text() if page.exists() else ""
            shown = [p for p in one.params if isinstance(p, click.Option) and not p.hidden]
            for option in shown:
                anchor = f'id="{path.replace(" ", "-")}{option.opts[-1]}"'
                assert anchor in text, f"{path} {option.opts}"


@pytest.mark.slow
def test_equations_are_mathml(site):
    text = (site / "coning.html").read_text()
    assert text.count("<math") > 20
    for page in site.rglob("*.html"):
        assert 'class="arithmatex"' not in page.read_text(), page


# Types a word as a reader would; the title then tells what was found
TYPING = """<script>
const waits = setInterval(() => {
  const query = document.querySelector("[data-md-component=search-query]");
  const found = document.querySelectorAll(".md-search-result__item").length;
  if (found) { clearInterval(waits); document.title = `found ${found}`; return; }
  query.focus();
  query.value = "sculling";
  query.dispatchEvent(new Event("keyup", { bubbles: true }));
}, 500);
</script></body>"""


@pytest.mark.slow
@needs_browser
def test_search_works_from_a_folder(site, tmp_path):
    page = site / "typing.html"
    page.write_text((site / "index.html").read_text().replace("</body>", TYPING))
    try:
        shown = subprocess.run(
            [str(BROWSER), *FLAGS, f"--user-data-dir={tmp_path}", "--dump-dom", page.as_uri()],
            capture_output=True,
            text=True,
            timeout=120,
        )
    finally:
        page.unlink()
    assert re.search(r"<title>found \d+</title>", shown.stdout), shown.stderr[-2000:]
    assert "Uncaught" not in shown.stderr


def keys_of(value, prefix=""):
    """Keys of an object and of the objects in it, as the documentation writes them."""
    if isinstance(value, dict):
        for key, part in value.items():
            yield prefix + key
            yield from keys_of(part, f"{prefix}{key}.")
    elif isinstance(value, list):
        for part in value:
            yield from keys_of(part, f"{prefix.removesuffix('.')}[].")


@pytest.mark.parametrize(
    "words",
    [("process", "-o", "out.mcap", "--height-damping", "baro"), ("info",), ("align",)],
    ids=["process", "info", "align"],
)
def test_every_key_of_json_is_listed(words, sinstool, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sinstool("simulate", "drive", "-o", "log.mcap", "--duration", "60", "--seed", "1")
    command, *options_ = words
    printed = json.loads(sinstool(command, "log.mcap", *options_, "--json")[1])
    described = {key: word for key, word, _ in rows(RESULTS[command])}
    # Of dictionaries, choices and findings the keys are not repeated
    below = {"choice": ".", "object": ".", "list of findings": "[].", "list of objects": "[]."}
    whole = {key + below[word] for key, word in described.items() if word in below}
    whole = tuple(key for key in whole if not any(one.startswith(key) for one in described))
    unlisted = {k for k in keys_of(printed) if k not in described and not k.startswith(whole)}
    assert unlisted == ({"schema"} if command == "info" else {"schema", "warnings"})


def test_json_without_a_description_is_refused():
    class Result(RESULTS["export"]):
        """Nothing is said of its key."""

        unexplained: int

    Result = dataclass(frozen=True, kw_only=True)(Result)
    with pytest.raises(ValueError, match=r"Result\.unexplained has no description"):
        list(rows(Result))
    with pytest.raises(ValueError, match="no result of simulate"):
        json_keys("simulate")
    assert all(len(json_keys(name)) > 500 for name in RESULTS)


def test_equation_with_its_number():
    made = equations(r'<div class="arithmatex">\[ a &lt; \frac{b}{2} \tag{14} \]</div>')
    assert "<mfrac>" in made and '<span class="number">(14)</span>' in made
    assert "tag" not in made
    with pytest.raises(ValueError, match="not understood"):
        equations(r'<span class="arithmatex">\(\nosuchthing{b}\)</span>')


def test_unknown_parts_are_refused():
    with pytest.raises(ValueError, match="no command"):
        options("process nothing")
    assert "--gyro-kind" in options("process")


@pytest.mark.parametrize(
    "wrong", ["[x](nowhere.md)", "[x](coning.md#nowhere)", "<!-- options: nothing -->"]
)
@pytest.mark.slow
def test_what_is_wrong_with_a_page_fails_the_build(wrong, tmp_path):
    folder = scratch(tmp_path)
    with (folder / "docs" / "formats.md").open("a") as page:
        page.write(f"\n{wrong}\n")
    assert build(folder).returncode != 0


def test_the_api_page_describes_every_name():
    text = python_api()
    for name in sinstool.__all__:
        if name != "__version__":
            assert f"{{#{name.lower()}}}" in text or f"## {name}\n" in text, name
    for name in ("Log.imu", "Imu.to_pandas", "Result.to_json", "Simulated.write"):
        assert f"### {name} " in text
    assert "::" not in text and ":class:" not in text
    # sections of docstrings have become lists
    assert "----" not in text and "Parameters\n" not in text
