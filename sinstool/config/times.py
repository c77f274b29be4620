"""Times as users give them."""

from __future__ import annotations

from datetime import UTC, datetime
from decimal import Decimal, InvalidOperation


def parse_time(text: str, first_ns: int) -> int:
    """A time as --start and --end take it.

    Parameters
    ----------
    text : str
        Seconds from the first sample (``12.5``), an RFC 3339 date (``2024-05-01T10:00:00Z``), or
        nanoseconds on the log's clock (an integer of more than 12 digits, or with ``ns``).
    first_ns : int
        Time of the first sample.

    Returns
    -------
    int
        Nanoseconds.

    Raises
    ------
    ValueError
        The text is none of these.
    """
    text = text.strip()
    digits = text.removesuffix("ns").strip()
    if digits.lstrip("+-").isdigit() and (text.endswith("ns") or len(digits.lstrip("+-")) > 12):
        return _in_range(int(digits), text)
    try:
        seconds = Decimal(text)
        if seconds.is_finite():
            return _in_range(first_ns + int(seconds * 1_000_000_000), text)
    except InvalidOperation:
        pass
    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        raise ValueError(
            f"'{text}' is not a time: give seconds from the log's start, RFC 3339, or ns"
        ) from None
    if when.tzinfo is None:
        when = when.replace(tzinfo=UTC)
    delta = when - datetime(1970, 1, 1, tzinfo=UTC)
    return (delta.days * 86400 + delta.seconds) * 1_000_000_000 + delta.microseconds * 1000


def _in_range(time_ns: int, text: str) -> int:
    if not -(2**63) <= time_ns < 2**63:
        raise ValueError(f"'{text}' is no time that a log can hold")
    return time_ns
