"""The page of figures of `sinstool compare-coning`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from sinstool.config import ProcessConfig
from sinstool.config.coning import COMPARISON_OPTIONS
from sinstool.core.english import counted, in_seconds
from sinstool.pipelines.compare_coning.paper import Reproduction
from sinstool.pipelines.compare_coning.summary import AlgorithmResult, ComparisonResult
from sinstool.report.figure import Figure
from sinstool.report.figures.paper import figures
from sinstool.report.pages.settings import config_settings, input_rows, read_file
from sinstool.report.sections import Column, Fact, Page, Prose, Section, Settings, Table, table_of
from sinstool.report.text.coning import COLUMNS, LEGEND, PSEUDO, TERMINAL, about_reference, shown
from sinstool.report.text.coning import Column as ColumnOf

PAPER_OPTIONS = ("comparison.algorithms", "comparison.phase", "coning.gyro_response")


def comparison_page(
    log: Path, figures: Sequence[Figure], config: ProcessConfig, result: ComparisonResult
) -> Page:
    """The page of a comparison on a log.

    Parameters
    ----------
    config : ProcessConfig
        Effective.
    """
    sizes, *tables = _tables(result)
    text = result.verdict.text
    # A name stays as it is written
    if not text.startswith(tuple(row.name for row in result.algs)):
        text = f"{text[:1].upper()}{text[1:]}"
    verdict = Prose((f"{text}.",), "Result", _facts(result))
    last = (Settings(config_settings(config, *COMPARISON_OPTIONS)), input_rows([read_file(log)]))
    sections: tuple[Section, ...] = (verdict, sizes, *figures, *tables, *last)
    warnings = result.warnings
    return Page("Coning algorithms compared", log.name, sections, warnings)


def reproduction_page(reproduction: Reproduction, config: ProcessConfig) -> Page:
    """The page of the published experiment: its claims beside our numbers, and figures."""
    columns = ("source", "claim", "paper", "ours", "unit", "verdict", "why")
    rows = tuple(
        (c.source, c.statement, c.paper, c.ours, c.unit, c.verdict, c.why)
        for c in reproduction.claims
    )
    agreeing = f"{reproduction.agreeing} of {len(rows)} printed claims reproduce"
    verdict = Prose((f"{agreeing}; the table below says why.",), "Result")
    table = Table("The paper's claims", tuple(Column(n, "", ".3g") for n in columns), rows)
    sections: tuple[Section, ...] = (
        verdict,
        *figures(reproduction.experiment),
        table,
        Settings(config_settings(config, *PAPER_OPTIONS)),
        input_rows(()),
    )
    return Page("The published coning experiment, re-run", "", sections)


def _facts(result: ComparisonResult) -> tuple[Fact, ...]:
    meta, checks = result.meta, result.checks
    best = result.verdict.algorithm
    facts = [Fact("Choice", best)] if best else []
    resolution = result.reference.resolution_dph
    note = "" if resolution is None else f"confirmed to {resolution:.2g} deg/h"
    facts += [
        Fact("Reference", result.reference.name, note),
        Fact("Drift that does not matter", f"{meta.tolerance_dph:g} deg/h", "--tolerance"),
        Fact("Log", f"{in_seconds(meta.duration_s)} at {checks.rate_hz:.4g} Hz",
             f"{counted(checks.gaps, 'gap')}, read as {meta.gyro_kind}"),
        Fact("Fastest rotation", f"{shown(checks.largest_rate_deg_s)} deg/s"),
    ]  # fmt: skip
    return tuple(facts)


def _tables(result: ComparisonResult) -> list[Table]:
    """Sizes of the log as it is, then of lower rates, then everything by axis."""
    native = [a for a in result.algs if a.decimate == 1]
    slower = [a for a in result.algs if a.decimate != 1]
    about = about_reference(result.reference, result.meta)
    pseudo = PSEUDO if result.meta.stopband_hz is not None else ""
    legend = LEGEND.format(window=result.meta.window_s, brackets="", pseudo=pseudo)
    exceptions: dict[str, dict[str, None]] = {}
    for alg in result.algs:
        if alg.pred_exception:
            exceptions.setdefault(alg.pred_exception, {})[alg.name] = None
    notes = tuple(
        f"The prediction does not hold for {', '.join(names)}: {reason}."
        for reason, names in exceptions.items()
    )
    tables = [_table("Algorithms on the log as it is", TERMINAL, native, (about, legend))]
    if slower:
        columns = (TERMINAL[0], COLUMNS[1], *TERMINAL[1:])
        tables.append(
            _table(
                "As if the log had been recorded at lower rates", columns, slower, (), folded=True
            )
        )
    # The reasons would make every row as high as a sentence; they stand below.
    tables.append(_table("By axis", COLUMNS[:-1], result.algs, notes, folded=True))
    return tables


def _table(
    title: str,
    columns: Sequence[ColumnOf],
    rows: Sequence[AlgorithmResult],
    notes: tuple[str, ...],
    folded: bool = False,
) -> Table:
    # Numbers as on the terminal: no powers of ten where none are needed
    cells = [(Column(name, unit, shown), get) for name, unit, get in columns]
    return table_of(title, rows, cells, notes, folded)
