"""Rows of exported tables, block by block."""

import io

import numpy as np
import pytest

from sinstool.core.streams import Solution
from sinstool.io.readers.results import ResultBlock
from sinstool.io.writers.export.tables import CsvWriter, ParquetWriter
from sinstool.io.writers.export.target import Described

ABOUT = Described("log.mcap", "map", 0)


def block(first, rates, has_rates=True):
    times = np.arange(first, first + 3) * 10_000_000
    q_nb = np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
    solution = Solution(times, times, q_nb, np.full((3, 3), rates), np.full((3, 3), rates))
    return ResultBlock(solution, has_rates=has_rates)


def csv_of(*blocks):
    stream = io.BytesIO()
    writer = CsvWriter(stream, ABOUT)
    for one in blocks:
        writer.push(one)
    writer.finish()
    return [line.split(",") for line in stream.getvalue().decode().splitlines()]


@pytest.mark.parametrize("rates", [(1.0, np.nan), (np.nan, 1.0)])
def test_rates_that_one_block_lacks_keep_their_columns(rates):
    names, *rows = csv_of(block(0, rates[0]), block(3, rates[1]))
    assert {len(row) for row in rows} == {len(names)}
    column = [row[names.index("omega_ib_b_y_rad_s")] for row in rows]
    assert column == [text for rate in rates for text in 3 * ["" if rate != rate else "1.0"]]
    pyarrow = pytest.importorskip("pyarrow.parquet")
    stream = io.BytesIO()
    writer = ParquetWriter(stream, ABOUT)
    for k in (0, 1):
        writer.push(block(3 * k, rates[k]))
        writer._store()
    writer.finish()
    table = pyarrow.read_table(io.BytesIO(stream.getvalue()))
    assert table.column_names == names
    assert table["omega_ib_b_y_rad_s"].null_count == 3


def test_a_result_without_rates_has_no_columns_for_them():
    names, *_ = csv_of(block(0, np.nan, has_rates=False))
    assert names == [
        "time_ns", "time_s", "q_nb_w", "q_nb_x", "q_nb_y", "q_nb_z",
        "roll_deg", "pitch_deg", "heading_deg",
    ]  # fmt: skip
