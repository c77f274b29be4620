"""The colours of the report: one list for light paper and one for dark screens."""

from __future__ import annotations

# Pairs of one hue: a curve keeps its name when the theme changes. Neighbours differ in lightness
# as well as in hue, and each has a contrast of at least 3 to its page.
LIGHT_CURVES = (
    "#1f5fa8",
    "#cf5318",
    "#16805a",
    "#9146ab",
    "#946800",
    "#0f8298",
    "#bd2f6b",
    "#667419",
    "#7c4a30",
    "#59636f",
)
DARK_CURVES = (
    "#6fb0f5",
    "#ff9363",
    "#54cc9f",
    "#cf9ce8",
    "#e5b748",
    "#53c8dd",
    "#f587b4",
    "#b9c94f",
    "#cf9f84",
    "#a9b3be",
)

# Beyond the tenth curve the colours come again, with another dash. A dash of its own is left to
# series that ask for one.
DASHES = ("solid", "dot", "dashdot", "longdashdot")

LIGHT = {
    "page": "#ffffff",
    "panel": "#f6f7f9",
    "ink": "#1a1e23",
    "muted": "#59636e",
    "rule": "#dde1e6",
    "grid": "#e8ebee",
    "accent": "#1f5fa8",
    "warning": "#8a5a00",
    "warning-page": "#fff7e3",
    "warning-rule": "#e0a400",
} | {f"curve-{k}": colour for k, colour in enumerate(LIGHT_CURVES)}

DARK = {
    "page": "#14171b",
    "panel": "#1c2025",
    "ink": "#e4e8ec",
    "muted": "#9da7b2",
    "rule": "#333a42",
    "grid": "#262c33",
    "accent": "#7db7f5",
    "warning": "#f0c869",
    "warning-page": "#2b2413",
    "warning-rule": "#b98d1e",
} | {f"curve-{k}": colour for k, colour in enumerate(DARK_CURVES)}
