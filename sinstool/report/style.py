"""The page's style sheet."""

from __future__ import annotations

from collections.abc import Mapping

from sinstool.report.palette import DARK, LIGHT


def style_sheet() -> str:
    """Return the style sheet, with the colours of both themes.

    Returns
    -------
    str
    """
    return (
        f":root {{ color-scheme: light dark; {_variables(LIGHT)} }}\n"
        # The script sets the class before it draws figures for the printer
        f"@media screen and (prefers-color-scheme: dark) {{ :root:not(.printing) {{"
        f" {_variables(DARK)} }} }}\n" + _RULES
    )


def _variables(colours: Mapping[str, str]) -> str:
    return " ".join(f"--{name}: {colour};" for name, colour in colours.items())


_RULES = """\
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; scroll-behavior: smooth; scroll-padding-top: 1rem; }
body { margin: 0 auto; max-width: 68rem; padding: 2rem 1.5rem 3rem; background: var(--page);
  color: var(--ink); font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Liberation Sans",
  Arial, sans-serif; overflow-wrap: break-word; }
h1 { margin: 0; font-size: 1.85rem; line-height: 1.2; letter-spacing: -0.01em; }
h2 { margin: 0 0 0.6rem; font-size: 1.2rem; line-height: 1.3; }
p { margin: 0 0 0.7rem; max-width: 46rem; }
a { color: var(--accent); }
:focus-visible { outline: 2px solid var(--accent); outline-offset: 2px; }
header { margin-bottom: 1.6rem; }
header p { margin: 0.35rem 0 0; color: var(--muted); }
header p.made { font-size: 0.85rem; }
main > section, main > nav { margin: 0 0 2.4rem; }

.warnings { padding: 0.9rem 1.1rem; background: var(--warning-page);
  border-left: 4px solid var(--warning-rule); border-radius: 3px; }
.warnings h2 { color: var(--warning); font-size: 1rem; margin-bottom: 0.3rem; }
.warnings ul { margin: 0; padding-left: 1.1rem; }
.warnings li { margin: 0.2rem 0; }

.facts { display: grid; grid-template-columns: repeat(auto-fill, minmax(10.5rem, 1fr));
  gap: 1rem 1.5rem; margin: 1rem 0 0; }
.facts > div { border-top: 2px solid var(--accent); padding-top: 0.4rem; }
.facts dt { color: var(--muted); font-size: 0.85rem; line-height: 1.3; }
.facts dd { margin: 0.1rem 0 0; font-size: 1.15rem; font-weight: 600; line-height: 1.3;
  font-variant-numeric: tabular-nums; }
.facts .note { display: block; color: var(--muted); font-size: 0.82rem; font-weight: 400; }

nav h2 { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); }
nav ul { margin: 0; padding: 0; list-style: none; display: flex; flex-wrap: wrap;
  gap: 0.25rem 1.25rem; font-size: 0.92rem; }
nav a { text-decoration: none; }
nav a:hover { text-decoration: underline; }

/* The shades at the sides tell that there is more to scroll to; the covers hide them at the ends */
.wide { overflow-x: auto; margin: 0 0 0.6rem; background:
  linear-gradient(to right, var(--page) 40%, transparent) 0 0 / 2.5rem 100% local,
  linear-gradient(to left, var(--page) 40%, transparent) 100% 0 / 2.5rem 100% local,
  linear-gradient(to right, var(--rule), transparent) 0 0 / 0.9rem 100% scroll,
  linear-gradient(to left, var(--rule), transparent) 100% 0 / 0.9rem 100% scroll;
  background-repeat: no-repeat; }
table { border-collapse: collapse; font-size: 0.92rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; color: var(--muted); padding: 0 0 0.4rem; }
th, td { padding: 0.34rem 1.5rem 0.34rem 0; text-align: left; vertical-align: top; }
thead th { vertical-align: bottom; font-weight: 600; border-bottom: 2px solid var(--rule); }
tbody th, tbody td { border-bottom: 1px solid var(--rule); }
tbody th { font-weight: 500; }
th:last-child, td:last-child { padding-right: 0.25rem; }
th.number, td.number { text-align: right; }
td.number { white-space: nowrap; }
.unit { display: block; color: var(--muted); font-weight: 400; font-size: 0.85em; }
.settings tbody th, .rows th { color: var(--muted); font-weight: 400; white-space: nowrap; }
.settings td, .rows td { overflow-wrap: anywhere; }
.rows th { min-width: 9rem; max-width: 24rem; white-space: normal; overflow-wrap: anywhere; }
.settings td { min-width: 5.5rem; }
.settings .meaning { color: var(--muted); max-width: 34rem; overflow-wrap: break-word; }
.rows tr:first-child > * { border-top: 1px solid var(--rule); }

figure { margin: 0; }
/* It reaches down into the plot's margin, whose right end holds the buttons */
.ylabel { position: relative; z-index: 1; max-width: none; margin: 0 0 -0.8rem;
  font-size: 0.82rem; pointer-events: none; }
.drawing { height: clamp(300px, 40vw, 420px); width: 100%; overflow: hidden; }
.legend { margin: 0.3rem -0.5rem 0.5rem; padding: 0; list-style: none; display: flex;
  flex-wrap: wrap; gap: 0.15rem 0.35rem; font-size: 0.88rem; }
.legend button { display: flex; align-items: center; gap: 0.5rem; padding: 0.18rem 0.5rem;
  font: inherit; text-align: left; color: inherit; background: none; border: 0; border-radius: 3px;
  cursor: pointer; }
.legend button:hover:enabled { background: var(--panel); }
.legend button:disabled { cursor: default; }
.legend [aria-pressed="false"] { color: var(--muted); text-decoration: line-through; }
.legend [aria-pressed="false"] svg { opacity: 0.3; }
.legend svg { flex: none; }
figcaption { font-size: 0.92rem; }
figcaption p { margin: 0 0 0.3rem; }
figcaption .thinned { max-width: none; }
figcaption .thinned, .hint { color: var(--muted); font-size: 0.85rem; }
details { font-size: 0.92rem; margin-top: 0.4rem; }
summary { cursor: pointer; color: var(--muted); font-size: 0.88rem; }
details[open] summary { margin-bottom: 0.4rem; }
footer { border-top: 1px solid var(--rule); padding-top: 0.9rem; color: var(--muted);
  font-size: 0.85rem; }
footer p { max-width: none; margin: 0 0 0.3rem; }

@media (max-width: 40rem) {
  body { padding: 1.1rem 0.9rem 2rem; }
  h1 { font-size: 1.45rem; }
  h2 { font-size: 1.1rem; }
  table { font-size: 0.86rem; }
  th, td { padding-right: 1rem; }
  .settings, .settings tbody { display: block; }
  .settings thead { display: none; }
  .settings tr { display: grid; grid-template-columns: minmax(0, 3fr) minmax(0, 2fr);
    border-bottom: 1px solid var(--rule); }
  .settings tr > * { border: 0; min-width: 0; white-space: normal; overflow-wrap: anywhere; }
  .settings .meaning { grid-column: 1 / -1; padding-top: 0; }
  .rows { width: 100%; }
  .rows th { min-width: 5.5rem; width: 30%; }
  .facts { grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 0.9rem 1rem; }
  .facts dd { font-size: 1.02rem; }
  /* One line to be pushed along: a list of twenty would stand between a reader and the answer */
  nav ul { flex-wrap: nowrap; overflow-x: auto; white-space: nowrap; margin: 0 -0.9rem;
    padding: 0 0.9rem 0.35rem; }
}
@media (pointer: coarse) {
  .legend button { padding: 0.45rem 0.6rem; }
}
@media (prefers-reduced-motion: reduce) {
  html { scroll-behavior: auto; }
}
@media print {
  @page { margin: 15mm; }
  body { max-width: none; padding: 0; font-size: 10.5pt; }
  main > section { margin-bottom: 1.4rem; }
  h2 { break-after: avoid; }
  figure, tr, .warnings, .facts > div { break-inside: avoid; }
  thead { display: table-header-group; }
  .wide { overflow: visible; background: none; }
  .warnings { border: 1px solid var(--warning-rule); border-left-width: 4px; }
  nav, details:not(.kept), .hint, .modebar-container, .legend li:has([aria-pressed="false"]) {
    display: none; }
  .drawing { height: 320px; }
  a { color: inherit; text-decoration: none; }
}
:root.printing .drawing { height: 320px; }
"""
