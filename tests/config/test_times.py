"""Times that ``--start`` and ``--end`` accept."""

import tomllib

import pytest

from sinstool.config import InputOptions
from sinstool.config.logs import parse_time

FIRST = 1_700_000_000_000_000_000


@pytest.mark.parametrize(
    ("text", "time_ns"),
    [
        ("12.5", FIRST + 12_500_000_000),
        ("-3", FIRST - 3_000_000_000),
        ("1e2", FIRST + 100_000_000_000),
        ("5 ns", 5),
        # up to 12 digits seconds from the first sample, from 13 on the log's clock
        ("123456789", FIRST + 123_456_789_000_000_000),
        ("1234567890123", 1_234_567_890_123),
        ("-1234567890123", -1_234_567_890_123),
        ("2023-11-14T22:13:20Z", FIRST),
        ("2023-11-14T22:13:20", FIRST),
        ("2023-11-14T23:13:20.5+01:00", FIRST + 500_000_000),
    ],
)
def test_times_have_three_forms(text, time_ns):
    assert parse_time(text, FIRST) == time_ns


@pytest.mark.parametrize("text", ["123456789012", "9223372036854775808", "1e9999999"])
def test_times_beyond_any_log_are_refused(text):
    with pytest.raises(ValueError, match="no log can hold"):
        parse_time(text, FIRST)


@pytest.mark.parametrize("text", ["soon", "", "nan", "inf", "12 s", "25:00"])
def test_other_texts_are_refused(text):
    with pytest.raises(ValueError, match="is not a time"):
        parse_time(text, FIRST)


@pytest.mark.parametrize("text", ["2023-11-14", "2023-11-14T22:13:20Z", "2023-11-14 22:13:20"])
def test_dates_of_toml_are_those_of_the_command_line(text):
    options = InputOptions(start=tomllib.loads(f"start = {text}")["start"])
    assert parse_time(options.start, 0) == parse_time(text, 0)
