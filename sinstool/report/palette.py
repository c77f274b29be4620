"""The colours of the report, each in a shade for light and one for dark pages."""

from __future__ import annotations

# A curve keeps its hue when the theme changes. Neighbours differ in lightness as well as in hue,
# and each has a contrast of at least 3 to its page.
CURVES = (
    ("#1f5fa8", "#6fb0f5"),
    ("#cf5318", "#ff9363"),
    ("#16805a", "#54cc9f"),
    ("#9146ab", "#cf9ce8"),
    ("#946800", "#e5b748"),
    ("#0f8298", "#53c8dd"),
    ("#bd2f6b", "#f587b4"),
    ("#667419", "#b9c94f"),
    ("#7c4a30", "#cf9f84"),
    ("#59636f", "#a9b3be"),
)
LIGHT_CURVES = tuple(light for light, _ in CURVES)

# Beyond the tenth curve the colours come again, with another dash. A dash of its own is left to
# series that ask for one.
DASHES = ("solid", "dot", "dashdot", "longdashdot")

_COLOURS = {
    "page": ("#ffffff", "#14171b"),
    "panel": ("#f6f7f9", "#1c2025"),
    "ink": ("#1a1e23", "#e4e8ec"),
    "muted": ("#59636e", "#9da7b2"),
    "rule": ("#dde1e6", "#333a42"),
    "grid": ("#e8ebee", "#262c33"),
    "halo": ("#c4cad2", "#4b545f"),
    "accent": ("#1f5fa8", "#7db7f5"),
    "warning": ("#8a5a00", "#f0c869"),
    "warning-page": ("#fff7e3", "#2b2413"),
    "warning-rule": ("#e0a400", "#b98d1e"),
} | {f"curve-{k}": pair for k, pair in enumerate(CURVES)}
LIGHT = {name: light for name, (light, _) in _COLOURS.items()}
DARK = {name: dark for name, (_, dark) in _COLOURS.items()}
