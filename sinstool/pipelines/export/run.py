"""Export of a result to a table, a trajectory or a track."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.config.logs import parse_time
from sinstool.core.earth import local_position_n
from sinstool.core.english import counted
from sinstool.core.errors import ConfigurationError, SinstoolError
from sinstool.core.finding import Finding, Severity
from sinstool.core.progress import Progress, share
from sinstool.core.rotation import conjugate, multiply
from sinstool.core.streams import Solution
from sinstool.core.suggest import nearest
from sinstool.core.timeline import clock_time
from sinstool.core.units import DEGREE
from sinstool.core.whole_file import WholeFile, check_output
from sinstool.io.readers import open_log
from sinstool.io.readers.results import ResultBlock, ResultReader
from sinstool.io.writers.export.maps import GeoJsonWriter, GpxWriter, KmlWriter
from sinstool.io.writers.export.tables import CsvWriter, ParquetWriter
from sinstool.io.writers.export.target import Described, Writer
from sinstool.io.writers.export.trajectory import TumWriter
from sinstool.pipelines.export.result import ExportedFile, ExportedFrom, ExportResult
from sinstool.pipelines.provenance import read_record

if TYPE_CHECKING:
    from sinstool.pipelines.process.result import ProcessResult

WRITERS: dict[str, type[Writer]] = {
    "csv": CsvWriter,
    "parquet": ParquetWriter,
    "tum": TumWriter,
    "kml": KmlWriter,
    "gpx": GpxWriter,
    "geojson": GeoJsonWriter,
}
# Maps grow slow with more points, and show no more
MAP_RATE = 10.0


def format_of(output: Path, config: ProcessConfig) -> str:
    """The format of an output: as configured, or as its suffix says.

    Raises
    ------
    ConfigurationError
        Neither says one.
    """
    if config.export.format is not None:
        return config.export.format
    suffix = output.suffix.lower().removeprefix(".")
    if suffix in WRITERS:
        return suffix
    what = f"its suffix .{suffix} is no format" if suffix else "it has no suffix"
    names = ", ".join(f".{name}" for name in WRITERS)
    near = nearest(suffix, WRITERS) if suffix else ""
    raise ConfigurationError(
        f"-o {output}: {what} of sinstool export", near or f"the suffix is one of {names}"
    )


def export(
    path: Path, output: Path, config: ProcessConfig, progress: Progress | None = None
) -> ExportResult:
    """Export a result that ``sinstool process`` wrote.

    Parameters
    ----------
    path : Path
        The result.
    output : Path
        The file, which appears when it is complete; its suffix is the format.
    progress : callable, optional
        Called with the fraction done.

    Raises
    ------
    SinstoolError
        With one line that says what was wrong and what to do; no output is left behind.
    """
    kind = format_of(output, config)
    check_output(output, [path], config.output.overwrite)
    with open_log(path, config.input.salvage) as log:
        findings = []
        made = _axes(path)
        if made is None:
            text = f"{path} does not say how it was made: its axes are taken as FLU in ENU"
            findings.append(Finding("no-record", text))
        reader = ResultReader(
            log, *(made or ("flu", "enu")), progress=share(progress, log.size, 0.0, 1.0)
        )
        if WRITERS[kind].needs_position and "fix" not in reader.topics:
            raise no_position(str(path), kind)
        exported = export_blocks(reader.blocks(), str(path), reader.reference, output, config)
        lost = log.account()
    if bad := reader.losses.malformed:
        text = f"{path}: left out, as they do not fit their definition: {counted(bad, 'message')}"
        findings.append(Finding("malformed", text, Severity.LOST))
    if bad := reader.losses.nonfinite:
        text = f"{path}: left out, as they hold no attitude or no position: {counted(bad, 'row')}"
        findings.append(Finding("not-finite", text, Severity.LOST))
    if progress:
        progress(1.0)
    return replace(exported, lost=lost, findings=(*findings, *lost.findings()))


def export_solution(
    solution: Solution, summary: ProcessResult, output: Path, config: ProcessConfig
) -> ExportResult:
    """Export a solution that a run of `process` has in memory.

    Parameters
    ----------
    summary : ProcessResult
        Of the run.

    Raises
    ------
    SinstoolError
        As `export`.
    """
    kind, name = format_of(output, config), Path(summary.input.path).name
    check_output(output, [], config.output.overwrite)
    local = None
    if solution.position is not None and summary.output.origin is not None:
        origin = summary.output.origin
        place = (origin.latitude_deg * DEGREE, origin.longitude_deg * DEGREE, origin.height_m)
        local = local_position_n(place, solution.position)
    if WRITERS[kind].needs_position and solution.position is None:
        raise no_position(name, kind)
    # as a file has it: of the two quaternions of an attitude the one whose scalar part is positive
    upright = np.where(solution.q_nb[:, :1] < 0.0, -solution.q_nb, solution.q_nb)
    mount = solution.q_vb
    q_nv = None if mount is None else multiply(solution.q_nb, conjugate(mount))
    block = ResultBlock(replace(solution, q_nb=upright), local, q_nv)
    return export_blocks([block], name, summary.output.frame, output, config)


def _axes(path: Path) -> tuple[str, str] | None:
    """Axes of body and world of a result, by its own record; None where it has none."""
    record = read_record(path) if path.is_file() else None
    if record is None:
        return None
    try:
        made = tomllib.loads(record["config"])
        # The rig of a turntable is described in FRD, and so are its results.
        body = "frd" if "hse" in made.get("hse", {}) else made["input"]["body_axes"]
        return str(body), str(made["output"]["world"])
    except (KeyError, TypeError, AttributeError, ValueError, RecursionError):
        return None  # written by something else, or damaged


def no_position(name: str, kind: str) -> SinstoolError:
    """Error for a result without positions in a format that consists of them."""
    return SinstoolError(
        f"{name} has no position, and .{kind} is made of positions",
        "process the log with --mode ins or ins-gnss, or export .csv, .parquet or .tum",
    )


def export_blocks(
    blocks: Iterable[ResultBlock], name: str, frame: str, output: Path, config: ProcessConfig
) -> ExportResult:
    """Write blocks of a result.

    Parameters
    ----------
    name : str
        Of the result.
    frame : str
        Frame id of its attitudes.
    output : Path
        Checked already.

    Raises
    ------
    SinstoolError
        Nothing is left after ``--start`` and ``--end``, or the output cannot be written.
    """
    kind = format_of(output, config)
    writer_of = WRITERS[kind]
    rate = config.export.rate
    if rate is None and writer_of.needs_position:
        rate = MAP_RATE
    course = iter(blocks)
    first = next(course)
    first_ns = int(first.solution.time_ns[0])
    span = _span(config, first_ns)
    about = Described(Path(name).name, frame, first_ns, config.export.geoid_height)
    counted = _Counted(chain([first], course))
    thinned = _thinned(_within(counted, span), None if rate is None else 1e9 / rate)
    rows, begin, end = 0, 0, 0
    with WholeFile(output) as file:
        writer = writer_of(file.stream, about)
        for block in thinned:
            begin = begin if rows else int(block.solution.time_ns[0])
            end = int(block.solution.time_ns[-1])
            rows += len(block)
            writer.push(block)
        if not rows:
            seconds = (counted.last_ns - first_ns) / 1e9
            raise SinstoolError(
                f"{name} has no row between --start and --end",
                f"it covers {seconds:.3f} s, from {clock_time(first_ns)}",
            )
        writer.finish()
    return ExportResult(
        input=ExportedFrom(name, counted.rows, first_ns, counted.last_ns, frame),
        output=ExportedFile(str(output), kind, rows, begin, end, writer.columns),
        rate_hz=rate,
        position=first.local_n is not None or first.solution.position is not None,
        geoid_height_m=config.export.geoid_height,
        lost=None,
        findings=(),
    )


def _span(config: ProcessConfig, first_ns: int) -> tuple[int, int]:
    """Times between which rows are exported.

    Raises
    ------
    SinstoolError
        The last is before the first.
    """
    limits = np.iinfo(np.int64)
    start, end = config.input.start, config.input.end
    begin_ns = int(limits.min) if start is None else parse_time(start, first_ns)
    end_ns = int(limits.max) if end is None else parse_time(end, first_ns)
    if end_ns < begin_ns:
        raise SinstoolError("--end is not after --start", "choose a longer span")
    return begin_ns, end_ns


class _Counted:
    """Iterate over blocks and count their rows."""

    def __init__(self, blocks: Iterable[ResultBlock]) -> None:
        self._blocks = blocks
        self.rows = 0
        self.last_ns = 0

    def __iter__(self) -> Iterator[ResultBlock]:
        for block in self._blocks:
            self.rows += len(block)
            self.last_ns = int(block.solution.time_ns[-1])
            yield block


def _within(blocks: Iterable[ResultBlock], span: tuple[int, int]) -> Iterator[ResultBlock]:
    for block in blocks:
        begin = int(np.searchsorted(block.solution.time_ns, span[0], side="left"))
        end = int(np.searchsorted(block.solution.time_ns, span[1], side="right"))
        if begin < end:
            yield block.rows(slice(begin, end))


def _thinned(blocks: Iterable[ResultBlock], period_ns: float | None) -> Iterator[ResultBlock]:
    """The first row of each period, counted from the first row of all.

    A row that comes up to half an interval early counts to the next period, so that stamps which
    are rounded or jitter do not leave one out.
    """
    if period_ns is None:
        yield from blocks
        return
    origin: int | None = None
    before, latest = 0, -1
    for block in blocks:
        times = block.solution.time_ns
        if origin is None:
            origin = before = int(times[0])
        steps = np.diff(times, prepend=before)
        number = np.floor((times - origin + 0.5 * np.minimum(steps, period_ns)) / period_ns)
        reached = np.maximum.accumulate(np.concatenate(([latest], number)))
        keep = reached[1:] > reached[:-1]
        before, latest = int(times[-1]), int(reached[-1])
        if keep.any():
            yield block.rows(keep)
