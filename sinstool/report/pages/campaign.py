"""The table of all logs of a campaign: a page that links to theirs, and the same as CSV."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

from sinstool.core.english import counted
from sinstool.core.errors import OutputError
from sinstool.core.whole_file import write_table, write_whole
from sinstool.report.markup import markup
from sinstool.report.sections import Column, Fact, Link, Page, Prose, Section, Table
from sinstool.report.text.account import distance, duration
from sinstool.report.text.status import ORDER, shown_status

INDEX, TABLE = "index.html", "summary.csv"
TITLE = "Many logs"
COLUMNS = (
    "log",
    "status",
    "duration_s",
    "distance_m",
    "mean_speed_m_s",
    "largest_speed_m_s",
    "findings",
    "output",
    "page",
    "error",
)


@dataclass(frozen=True)
class Entry:
    """A log and its result.

    Attributes
    ----------
    name : PurePath
        Among the others.
    row : mapping
        Its line of ``--json``.
    page : Path or None
        Of its figures.
    """

    name: PurePath
    path: Path
    row: Mapping[str, Any]
    page: Path | None

    @property
    def status(self) -> str:
        """Status, as in the table on the terminal."""
        return shown_status(self.row)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of findings beyond notes; of an output that was there, those that it records."""
        if "findings" not in self.row:
            return tuple(self.row.get("kinds", ()))
        kinds = (one["kind"] for one in self.row["findings"] if one["severity"] != "note")
        return tuple(dict.fromkeys(kinds))

    def travelled(self, key: str) -> float | None:
        """A figure of ``travel``, None where there is none."""
        value = (self.row.get("travel") or {}).get(key)
        return None if value is None else float(value)


def check_index(folder: Path) -> None:
    """Refuse a folder that has files of the index' names which are not ours.

    Raises
    ------
    OutputError
    """
    for name, ours in ((INDEX, f"<title>{TITLE}</title>"), (TABLE, ",".join(COLUMNS))):
        path = folder / name
        try:
            same = not path.exists() or ours in path.read_text(encoding="utf-8", errors="replace")
        except OSError as exc:
            raise OutputError(f"{path}: cannot be read ({exc.strerror})") from exc
        if not same:
            raise OutputError(
                f"{path} exists and is no table of logs", "move it, or choose another -o"
            )


def write_index(folder: Path, entries: Sequence[Entry], seconds: float) -> None:
    """Write the page and the CSV, each whole, in place of those of an earlier run.

    Parameters
    ----------
    folder : Path
        Of the outputs.
    entries : sequence of Entry
        All logs.
    seconds : float
        How long the run took.

    Raises
    ------
    OutputError
    """
    write_whole(folder / INDEX, markup(index_page(folder, entries, seconds)))
    write_table(folder / TABLE, COLUMNS, [_line(folder, one) for one in entries])


def index_page(folder: Path, entries: Sequence[Entry], seconds: float) -> Page:
    """All logs of a campaign, the worst first."""
    ordered = sorted(entries, key=lambda one: ORDER.index(one.status))
    sections: list[Section] = [
        Prose((throughput(entries, seconds),), "Summary", _facts(entries)),
        _findings(entries),
        _logs(folder, ordered),
    ]
    failed = _failures(ordered)
    if failed.rows:
        sections.insert(1, failed)
    shown = [one for one in sections if not isinstance(one, Table) or one.rows]
    return Page(TITLE, folder.absolute().name, tuple(shown))


def throughput(entries: Sequence[Entry], seconds: float) -> str:
    """Logs and bytes processed in a time, as a line."""
    done = [one for one in entries if one.status in ("done", "lost")]
    logs = "log" if len(entries) == 1 else "logs"
    text = f"This run took {duration(float(f'{seconds:.3g}'))} for {len(entries)} {logs}"
    data = sum(one.travelled("duration_s") or 0.0 for one in done)
    if not done or seconds <= 0.0:
        rest = all(one.status == "complete" for one in entries) and not done
        return f"{text}; none of them had to be computed." if rest else f"{text}."
    were = "was" if len(done) == 1 else "were"
    of = "" if len(done) == len(entries) else f", of which {len(done)} {were} computed"
    return (
        f"{text}{of}: {len(done) / seconds:.3g} logs/s, {duration(data)} of data at"
        f" {data / seconds:.3g} times the speed at which it was recorded."
    )


def _facts(entries: Sequence[Entry]) -> tuple[Fact, ...]:
    counts = [f"{n} {word}" for word in ORDER if (n := sum(one.status == word for one in entries))]
    facts = [Fact("Logs", str(len(entries)), ", ".join(counts))]
    lengths = [one.travelled("duration_s") for one in entries]
    ways = [one.travelled("distance_m") for one in entries]
    for name, values, shown in (("Duration", lengths, duration), ("Distance", ways, distance)):
        numbers = [value for value in values if value is not None]
        if numbers:
            facts.append(Fact(name, shown(sum(numbers)), f"of {counted(len(numbers), 'log')}"))
    warned = sum(bool(one.kinds) for one in entries)
    facts.append(Fact("Logs with findings", str(warned), "beyond notes"))
    return tuple(facts)


def _failures(entries: Sequence[Entry]) -> Table:
    rows = tuple((str(one.name), one.row["error"]) for one in entries if "error" in one.row)
    return Table("What failed, and why", (Column("Log"), Column("Error")), rows)


def _findings(entries: Sequence[Entry]) -> Table:
    """Number of logs for each kind of finding, with the text of the first."""
    logs: dict[str, list[Entry]] = {}
    texts: dict[str, str] = {}
    for one in entries:
        for kind in one.kinds:
            logs.setdefault(kind, []).append(one)
        for finding in one.row.get("findings", ()):
            said = ": ".join(filter(None, (finding["text"], finding["answer"])))
            texts.setdefault(finding["kind"], said)
    rows = tuple(
        (kind, len(about), str(about[0].name), texts.get(kind, ""))
        for kind, about in sorted(logs.items(), key=lambda item: (-len(item[1]), item[0]))
    )
    columns = (Column("Kind"), Column("logs"), Column("first"), Column("what it says there"))
    return Table("Findings by kind", columns, rows)


def _logs(folder: Path, entries: Sequence[Entry]) -> Table:
    rows = tuple(
        (
            str(one.name) if one.page is None or not one.page.is_file()
            else Link(str(one.name), _relative(one.page, folder)),
            one.status,
            one.travelled("duration_s"),
            one.travelled("distance_m"),
            one.travelled("mean_speed_m_s"),
            one.travelled("largest_speed_m_s"),
            ", ".join(one.kinds) or "none" if one.status not in ("failed", "missing") else None,
        )
        for one in entries
    )  # fmt: skip
    columns = (
        Column("Log"),
        Column("status"),
        Column("duration", "s", ".1f"),
        Column("distance", "m", ".0f"),
        Column("mean speed", "m/s", ".2f"),
        Column("top speed", "m/s", ".2f"),
        Column("findings"),
    )
    # A column in which no log has anything says nothing
    shown = [k for k in range(len(columns)) if k < 2 or any(row[k] is not None for row in rows)]
    return Table(
        "Logs",
        tuple(columns[k] for k in shown),
        tuple(tuple(row[k] for k in shown) for row in rows),
        (f"The same is in {TABLE}, for a spreadsheet.",),
    )


def _line(folder: Path, one: Entry) -> tuple[Any, ...]:
    """A log's line of the CSV: the figures of the page."""
    page = one.page is not None and one.page.is_file()
    output = (one.row.get("output") or {}).get("path")
    written = "" if output is None or "error" in one.row else _relative(Path(output), folder)
    figures = [one.travelled(key) for key in COLUMNS[2:6]]
    return (
        str(one.path),
        one.status,
        *("" if value is None else f"{value:.9g}" for value in figures),
        " ".join(one.kinds),
        written,
        _relative(one.page, folder) if page and one.page is not None else "",
        one.row.get("error", ""),
    )


def _relative(path: Path, folder: Path) -> str:
    return Path(os.path.relpath(path.absolute(), folder.absolute())).as_posix()
