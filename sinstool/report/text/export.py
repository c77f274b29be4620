"""The result of an export, as rows."""

from __future__ import annotations

from sinstool.core.english import counted
from sinstool.pipelines.export.result import ExportResult


def summary_rows(result: ExportResult, verbose: bool) -> list[tuple[str, str]]:
    """The summary as pairs of label and text.

    Parameters
    ----------
    verbose : bool
        Name the columns too.
    """
    source, file = result.input, result.output
    span = (source.last_ns - source.first_ns) / 1e9
    frame = f" in frame {source.frame}" if source.frame else ""
    number = counted(source.rows, "attitude")
    rows = [("result", f"{source.path}: {number} over {span:.3f} s{frame}")]
    if result.rate_hz is not None and file.rows < source.rows:
        rows.append(("thinned", f"to {result.rate_hz:g} rows per second at most (--rate)"))
    if note := _note(result):
        rows.append(note)
    columns = f", {len(file.columns)} columns" if file.columns else ""
    what = "point" if file.format in ("kml", "gpx", "geojson") else "row"
    rows.append(("written", f"{file.path}: {counted(file.rows, what)}{columns}"))
    if verbose and file.columns:
        rows.append(("columns", ", ".join(file.columns)))
    return rows


def _note(result: ExportResult) -> tuple[str, str] | None:
    """Remark on positions and heights that a user may not expect."""
    kind = result.output.format
    if kind == "tum" and not result.position:
        return "position", "none in the result: x, y and z are 0"
    if kind == "kml" and result.geoid_height_m is None:
        return "height", "the track is drawn on the ground; --geoid-height M puts it in the air"
    if kind == "gpx" and result.geoid_height_m is None:
        return "height", "above the ellipsoid; --geoid-height M makes it height above the geoid"
    return None
