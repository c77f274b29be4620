"""Tables of `compare-coning` for the terminal, the CSV and the page."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from sinstool.core.english import counted
from sinstool.core.whole_file import make_folder, write_table
from sinstool.pipelines.compare_coning import summary
from sinstool.report.text.table import aligned

Column = tuple[str, str, "Get"]

Get = Callable[[summary.AlgorithmResult], Any]


def _axes(
    name: str, unit: str, get: Callable[[summary.AlgorithmResult], summary.FloatArray | None]
) -> list[Column]:
    """A column for each component of a vector that may be missing."""

    def component(k: int) -> Get:
        return lambda alg: None if (vector := get(alg)) is None else vector[k]

    return [(f"{name} {axis}", unit, component(k)) for k, axis in enumerate("xyz")]


def _rate(alg: summary.AlgorithmResult) -> str:
    return "all" if alg.decimate == 1 else f"1/{alg.decimate} {alg.input}"


def _of_drift(name: str) -> Get:
    """A figure of the drift, where there is one."""
    return lambda alg: None if alg.drift_dph is None else getattr(alg.drift_dph, name)


_mean = _of_drift("mean")
# Of the report and the CSV; what each is: docs/compare-coning.md
COLUMNS: tuple[Column, ...] = (
    ("algorithm", "", lambda a: a.name),
    ("kept", "", _rate),
    ("updates", "Hz", lambda a: a.update_hz),
    ("drift", "deg/h rms", lambda a: a.drift),
    ("window end", "deg/h rms", _of_drift("norm_rms")),
    *_axes("mean", "deg/h", _mean),
    *_axes("2 sigma", "deg/h", _of_drift("confidence")),
    *_axes("predicted", "deg/h", lambda a: a.pred_parting_dph),
    *_axes("expected", "deg/h", lambda a: a.pred_dph),
    *_axes("pseudo", "deg/h", lambda a: a.pseudo_dph),
    ("largest", "deg", lambda a: a.largest_deg),
    ("cost", "ns/sample", lambda a: a.ns_per_sample),
    ("below resolution", "", lambda a: a.drift_dph is not None and not a.resolved),
    ("prediction does not hold", "", lambda a: a.pred_exception),
)


def size(vector: summary.FloatArray | None) -> float | None:
    """Length of a vector that may be missing."""
    return None if vector is None else float(sum(v * v for v in vector) ** 0.5)


# The terminal has room for sizes; components are in --json, --csv and --report.
TERMINAL: tuple[Column, ...] = (
    ("algorithm", "", lambda a: a.name),
    ("rate", "Hz", lambda a: a.update_hz),
    ("drift", "deg/h", lambda a: a.drift),
    ("end", "deg/h", _of_drift("norm_rms")),
    ("mean", "deg/h", lambda a: size(_mean(a))),
    ("+/-", "deg/h", lambda a: a.drift_dph and max(a.drift_dph.confidence)),
    ("predict", "deg/h", lambda a: size(a.pred_parting_dph)),
    ("expect", "deg/h", lambda a: size(a.pred_dph)),
    ("pseudo", "deg/h", lambda a: size(a.pseudo_dph)),
    ("largest", "deg", lambda a: a.largest_deg),
    ("cost", "ns", lambda a: a.ns_per_sample),
)
LEGEND = (
    "drift: slope of the angle from the reference within {window:g} s windows, rms over windows;"
    " end: angle at a window's end over its length, rms; mean: mean of end, +/- two sigma;"
    " predict: that mean, predicted from the log's coning spectrum; expect: predicted drift from"
    " the true motion{brackets}.{pseudo}"
)
BRACKETS = " (in brackets where the prediction does not hold, see below)"
PSEUDO = " pseudo: the part of expect that is noise, if nothing moves above the stopband."
WIDTH = 118
LINE_END = "\r\n"  # of tables: RFC 4180
# Angles that far below rounding are none
_NOTHING = 1e-9


def shown(value: Any) -> str:
    """Write a number with three digits, and a dash where there is no number."""
    if isinstance(value, str):
        return value
    if value is None or value != value:
        return "-"
    if abs(value) >= 1e3:
        return f"{value:.0f}" if abs(value) < 1e5 else f"{value:.2g}"
    return f"{value:.3g}" if abs(value) >= _NOTHING else "0"


def _say(text: str) -> None:
    """Print a paragraph, folded."""
    click.echo(
        "\n".join(textwrap.wrap(text, WIDTH, subsequent_indent="  ", break_on_hyphens=False))
    )


def print_comparison(result: summary.ComparisonResult, verbose: bool = False) -> None:
    """Print a comparison as the terminal has room for.

    Parameters
    ----------
    verbose : bool
        With tables of lower rates, and singular perturbation on this log.
    """
    meta, reference, checks = result.meta, result.reference, result.checks
    stretches = checks.segments
    gaps = f" in {stretches} stretches between gaps" if stretches > 1 else ""
    _say(
        f"{meta.imu_topic}: {counted(meta.samples, 'sample')}, {meta.duration_s:.1f} s{gaps}, at"
        f" {checks.rate_hz:.3f} Hz, taken as {meta.gyro_kind}"
    )
    _say(about_reference(reference, meta))
    algs = [a for a in result.algs if verbose or a.decimate == 1]
    _print_table(result, algs)
    brackets = BRACKETS if any(a.pred_exception for a in algs) else ""
    pseudo = PSEUDO if meta.stopband_hz is not None else ""
    if reference.name != "none":
        click.echo()
        _say(LEGEND.format(window=meta.window_s, brackets=brackets, pseudo=pseudo))
    if reference.below_resolution:
        _say("* less than ten times the uncertainty of the reference.")
    for exception in dict.fromkeys(a.pred_exception for a in algs):
        if exception:
            names = {a.name for a in algs if a.pred_exception == exception}
            _say(f"The prediction does not hold for {', '.join(sorted(names))}: {exception}.")
    for alg in algs:
        if alg.caveat and alg.decimate == 1:
            _say(alg.caveat)
    click.echo()
    if verbose:
        _print_sp(result.sp)
    _print_slower(result)
    _say(f"Verdict: {result.verdict.text}.")


def about_reference(reference: summary.Reference, meta: summary.Meta) -> str:
    """One line on the reference of the comparison, and how far it can be trusted."""
    name = reference.name
    if name == "none":
        widest = meta.widest_pair
        between = ""
        if widest is not None:
            between = (
                f"; {widest.first} and {widest.second} differ most, by"
                f" {shown(widest.largest_deg)} deg"
            )
        return f"No reference{between} (all pairs: --json, --csv)"
    if reference.is_truth:
        return (
            f"Reference: {name}; every drift holds the sensor's errors, which all algorithms share"
        )
    text = f"Reference: {name}"
    if reference.resolution_dph is not None:
        resolution = shown(reference.resolution_dph)
        text += f", which algorithms of other kinds confirm to {resolution} deg/h"
    if reference.pred_dph is not None:
        text += f"; its own predicted drift is {shown(size(reference.pred_dph))} deg/h"
    return text


def _print_table(result: summary.ComparisonResult, algs: Sequence[summary.AlgorithmResult]) -> None:
    columns = [
        c
        for c in TERMINAL
        if c[0] in ("algorithm", "rate", "cost") or any(c[2](a) is not None for a in algs)
    ]
    if result.reference.name == "none":
        columns = [c for c in columns if c[0] != "largest"]
    table = []
    for alg in algs:
        row = [shown(get(alg)) for _, _, get in columns]
        row[0] += " *" if alg.drift_dph is not None and not alg.resolved else ""
        for k, (name, _, _) in enumerate(columns):
            if name in ("predict", "expect") and alg.pred_exception:
                row[k] = f"({row[k]})"
        table.append(row)
    heads = [[name for name, _, _ in columns], [unit for _, unit, _ in columns]]
    first, second, *lines = aligned([*heads, *table])
    group = None
    for line, alg in zip(lines, algs, strict=True):
        if (alg.decimate, alg.input) != group:
            group = (alg.decimate, alg.input)
            click.echo()
            click.echo(_group(alg, result.checks.rate_hz))
            if alg.decimate == 1:
                click.echo(f"{first}\n{second}")
        click.echo(line)


def _group(alg: summary.AlgorithmResult, rate_hz: float) -> str:
    m = alg.decimate
    if m == 1:
        return f"The log as it is, {rate_hz:.4g} Hz"
    how = "increments summed" if alg.input == "sums" else "rates picked"
    return f"As if logged at {rate_hz / m:.4g} Hz, {how} (one of {m})"


def _print_sp(sp: summary.SpResult | None) -> None:
    if sp is None or not sp.compared:
        return
    tuning, limits = sp.tuning, sp.bounds
    epsilon, gain = limits.epsilon_upper_s[0], limits.gain_lower[0]
    text = f"singular-perturbation is the same as {sp.equivalent}."
    if epsilon == epsilon:
        noise = " (set by noise here)" if limits.status == "noise-limited" else ""
        text += (
            f" The paper's bounds on this log{noise}: (13) epsilon at most {shown(epsilon)} s,"
            f" (15) n at least {shown(gain)}."
        )
    _say(text)
    if tuning.status == "tuned":
        _say(
            f"Tuned to the passband: epsilon {tuning.epsilon_s:.4g} s, n"
            f" {tuning.beta_gain:.4f}; expected drift {shown(size(tuning.drift_tuned_dph))}"
            f" deg/h instead of {shown(size(tuning.drift_best_dph))} (--sp-preset auto)."
        )
    else:
        why = {
            "no-passband": "motion and noise cannot be separated without --passband",
            "noise-limited": "the passband holds little but noise",
            "no-coning": "the passband holds no coning to tune to",
        }[tuning.status]
        _say(f"Not tuned, as {why}: epsilon = T/2 and n = 2 are best without it.")


def _print_slower(result: summary.ComparisonResult) -> None:
    """Aliasing at lower rates, and the algorithms that would still suffice."""
    meta, limit = result.meta, result.verdict.limit_dph
    folded = {(a.decimate, a.input): a for a in result.alias}
    groups: dict[tuple[int, str], list[str]] = {}
    for alg in result.algs:
        if alg.decimate > 1:
            sufficient = groups.setdefault((alg.decimate, alg.input), [])
            if limit is not None and alg.drift is not None and alg.drift <= limit:
                sufficient.append(alg.name)
    for (m, how), names in groups.items():
        text = f"Logged at {result.checks.rate_hz / m:.4g} Hz,"
        text += " increments summed:" if how == "sums" else " rates picked:"
        alias = folded.get((m, how))
        if alias is not None:
            text += (
                f" aliasing to zero frequency adds {shown(alias.dc_alias_deg)} deg rms in"
                f" {meta.window_s:g} s to every algorithm;"
            )
            if alias.lines_hz:
                near = ", ".join(f"{f:.4g} Hz" for f in alias.lines_hz)
                text += f" lines aliased to slow motion: {near};"
        if limit is not None:
            text += f" algorithms still within {shown(limit)} deg/h: {', '.join(names) or 'none'};"
        _say(text[:-1] + ".")
    if groups:
        click.echo()


def write_csv(folder: Path, result: summary.ComparisonResult) -> None:
    """Write the tables of a comparison into a folder."""
    make_folder(folder)
    names = [f"{n} [{u}]" if u else n for n, u, _ in COLUMNS]
    cells = [tuple(get(a) for _, _, get in COLUMNS) for a in result.algs]
    write_table(folder / "algorithms.csv", names, cells, LINE_END)
    pairs = [(p.first, p.second, p.largest_deg) for p in result.pairs]
    write_table(folder / "pairs.csv", ("first", "second", "largest angle [deg]"), pairs, LINE_END)
