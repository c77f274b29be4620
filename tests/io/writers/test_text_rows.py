"""Numbers as text: read back by other programs they are what they were, to the last digit kept."""

from decimal import Decimal

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from sinstool.io.writers.export.rows import ROWS, Value, text_rows


def text(*parts):
    return b"".join(bytes(rows) for rows in text_rows(parts)).decode()


INT64 = st.integers(-(2**63), 2**63 - 1)


@given(st.lists(INT64, min_size=1, max_size=20), st.integers(0, 9))
def test_times_are_exact(times, decimals):
    lines = text(Value(np.array(times), decimals), "\n").split("\n")
    assert [Decimal(line) for line in lines[:-1]] == [
        Decimal(one).scaleb(-decimals) for one in times
    ]


@given(st.lists(st.floats(-360.0, 360.0), min_size=1, max_size=20))
def test_angles_are_kept_to_the_digits_asked_for(angles):
    lines = text(Value(np.array(angles), 10), "\n").split("\n")
    # half of the last digit, and what a number of that size is rounded by
    assert np.abs(np.array(lines[:-1], float) - angles).max() <= 0.5e-10 + np.spacing(360.0)


@given(st.floats(allow_nan=False, allow_infinity=False), st.integers(0, 15))
def test_any_number_is_a_number_with_no_more_digits_than_asked_for(value, decimals):
    (line, _) = text(Value(np.array([value]), decimals), "\n").split("\n")
    behind = line.partition(".")[2]
    assert len(behind) <= decimals and (bool(behind) == ("." in line))
    if abs(value) < 1e15:
        # where so many digits are more than a float64 has, fewer are written
        scale = max(10.0**-decimals, abs(value) * 2e-15)
        assert abs(float(line) - value) <= scale


def test_what_is_not_finite_is_empty():
    column = np.array([1.5, np.nan, np.inf, -np.inf, -0.0])
    assert text("<", Value(column, 3), ">") == "<1.5><><><><0.0>"


def test_whole_numbers_have_no_point_unless_decimals_are_asked_for():
    assert text(Value(np.array([7, -12])), ";") == "7;-12;"
    assert text(Value(np.array([7.0, -12.0]), 4), ";") == "7.0;-12.0;"


def test_texts_stand_among_numbers():
    words = np.array([b"a", b"", b"longer"])
    assert text(Value(words), "=", Value(np.arange(3)), ",") == "a=0,=1,longer=2,"


def test_rows_go_on_where_the_buffer_ends():
    count = 2 * ROWS + 3
    lines = text(Value(np.arange(count)), "\n").split()
    assert [int(line) for line in lines] == list(range(count))
