"""The page's style sheet and script, from the package's data.

The figures lie in the page as JSON without colours. The script draws them again, from the same
dictionaries, when the theme or the width changes or the page is printed; what the reader has
zoomed to and switched off stays.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files

from sinstool.report.palette import DARK, LIGHT


def script() -> str:
    """The script that draws the figures in the theme of the moment and answers the legend."""
    return _asset("page.js")


def style_sheet() -> str:
    """The style sheet, with the colours of both themes."""
    return (
        f":root {{ color-scheme: light dark; {_variables(LIGHT)} }}\n"
        # The script sets the class before it draws figures for the printer
        f"@media screen and (prefers-color-scheme: dark) {{ :root:not(.printing) {{"
        f" {_variables(DARK)} }} }}\n" + _asset("page.css")
    )


def _asset(name: str) -> str:
    return (files("sinstool.report") / "assets" / name).read_text(encoding="utf-8")


def _variables(colours: Mapping[str, str]) -> str:
    return " ".join(f"--{name}: {colour};" for name, colour in colours.items())
