"""Tables as CSV and Parquet: every number of a result, with its unit in the name."""

from __future__ import annotations

from typing import Any, BinaryIO

from sinstool.core.errors import ConfigurationError
from sinstool.core.table import Table, attitude_columns, table_of
from sinstool.core.version import VERSION
from sinstool.io.readers.results import ResultBlock
from sinstool.io.writers.export.rows import Value, text_rows
from sinstool.io.writers.export.target import Described, Writer

# Decimals by the end of a column's name: finer than any sensor, and no finer than float64 resolves
DECIMALS = {"_deg": 10, "_rad_s": 12, "_m_s": 9, "_m_s2": 9, "_m": 6}
QUATERNION_DECIMALS = 15
# Angular rates and specific forces, which a result may lack
RATES = ("omega_ib_b", "specific_force_b")
LATE = ("vehicle", "sigma", "damp", *RATES)
# Rows of a Parquet file that are stored together
GROUP_ROWS = 2**17


def columns_of(block: ResultBlock, first_ns: int) -> Table:
    """Columns of a block, in the order of importance to a reader.

    Parameters
    ----------
    first_ns : int
        Time from which ``time_s`` counts.

    Returns
    -------
    dict of str to ndarray, shape (n,)
        ``time_ns`` is int64, all others are float64.
    """
    table = table_of(block.solution)
    del table["log_time_ns"]
    time_ns = table.pop("time_ns")
    if block.local_n is not None:
        axes = ("north", "east", "down")
        table |= {f"position_{axis}_m": block.local_n[:, k] for k, axis in enumerate(axes)}
    if block.q_nv is not None:
        angles = {k: v for k, v in attitude_columns(block.q_nv).items() if k.endswith("_deg")}
        table |= {f"vehicle_{name}": column for name, column in angles.items()}
    # not by their values, which may be missing in one block and present in the next
    names = [name for name in table if block.has_rates or not name.startswith(RATES)]
    names.sort(key=_place)
    seconds = (time_ns - first_ns) / 1e9
    return {"time_ns": time_ns, "time_s": seconds, **{name: table[name] for name in names}}


def _place(name: str) -> int:
    """Sort key of a column: the state first, then its sigmas, then its inputs."""
    return next((k for k, stem in enumerate(LATE, 1) if name.startswith(stem)), 0)


def decimals_of(name: str) -> int:
    """Number of decimals with which a column is written."""
    if name.startswith("q_nb"):
        return QUATERNION_DECIMALS
    return next(count for end, count in DECIMALS.items() if name.endswith(end))


class CsvWriter(Writer):
    """Comma-separated values: a line of names, then a line for each instant.

    Unknown values are empty fields.
    """

    def push(self, block: ResultBlock) -> None:
        """Write rows."""
        columns = columns_of(block, self.about.first_ns)
        if not self.columns:
            self.columns = tuple(columns)
            self.stream.write((",".join(columns) + "\n").encode())
        # seconds from integers, exact to the nanosecond
        time_ns = columns.pop("time_ns")
        del columns["time_s"]
        parts: list[str | Value] = [Value(time_ns), ",", Value(time_ns - self.about.first_ns, 9)]
        for name, column in columns.items():
            parts += [",", Value(column, decimals_of(name))]
        for text in text_rows([*parts, "\n"]):
            self.stream.write(text)


class ParquetWriter(Writer):
    """Apache Parquet, by pyarrow; unknown values are null.

    Raises
    ------
    ConfigurationError
        If pyarrow is not installed.
    """

    def __init__(self, stream: BinaryIO, about: Described) -> None:
        super().__init__(stream, about)
        self._arrow, self._parquet = _pyarrow()
        self._file: Any = None
        self._held: list[Any] = []
        self._rows = 0

    def push(self, block: ResultBlock) -> None:
        """Keep rows until there are enough of them to be stored together."""
        columns = columns_of(block, self.about.first_ns)
        self.columns = tuple(columns)
        arrays = {name: self._arrow.array(column, from_pandas=True)
                  for name, column in columns.items()}  # fmt: skip
        self._held.append(self._arrow.table(arrays))
        self._rows += len(block)
        if self._rows >= GROUP_ROWS:
            self._store()

    def finish(self) -> None:
        """Write the remaining rows and the file's index."""
        self._store()
        self._file.close()

    def _store(self) -> None:
        if not self._held:
            return
        table = self._arrow.concat_tables(self._held).combine_chunks()
        if self._file is None:
            about = {
                "sinstool.version": VERSION,
                "sinstool.result": self.about.name,
                "sinstool.reference_frame": self.about.reference,
            }
            schema = table.schema.with_metadata(about)
            # pyarrow would close our stream
            sink = self._arrow.PythonFile(_KeptOpen(self.stream), mode="w")
            self._file = self._parquet.ParquetWriter(sink, schema, compression="zstd")
        self._file.write_table(table.replace_schema_metadata(self._file.schema.metadata))
        self._held, self._rows = [], 0


class _KeptOpen:
    """A stream that its user cannot close."""

    closed = False

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._position = 0

    def write(self, data: bytes) -> int:
        self._stream.write(data)
        self._position += len(data)
        return len(data)

    def tell(self) -> int:
        return self._position

    def flush(self) -> None:
        self._stream.flush()

    def close(self) -> None:
        self.flush()


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as exc:
        raise ConfigurationError(
            "Parquet needs pyarrow", "pip install 'sinstool[tables]', or write .csv"
        ) from exc
    return pyarrow, pyarrow.parquet
