"""Numbers with their uncertainties, as metrology writes them."""

from __future__ import annotations

from math import floor, isfinite, log10

# Digits of an uncertainty that mean something: GUM 7.2.6
DIGITS = 2
# Without an uncertainty so many digits are shown
PLAIN_DIGITS = 4


def measured(value: float, sigma: float | None, unit: str = "") -> str:
    """A value and its standard uncertainty, rounded to two digits of the latter.

    Parameters
    ----------
    sigma : float or None
        None where it is not known.
    unit : str
        Of both.

    Examples
    --------
    >>> measured(-669.563, 14.617, "arcsec")
    '-670 +- 15 arcsec'
    """
    after = f" {unit}" if unit else ""
    if sigma is None or not isfinite(sigma) or sigma <= 0.0 or not isfinite(value):
        return f"{value:.{PLAIN_DIGITS}g}{after}"
    places = _places(sigma)
    shown = max(0, places)
    return f"{round(value, places):.{shown}f} +- {round(sigma, places):.{shown}f}{after}"


def places_of(sigma: float) -> int:
    """Decimal places of a value with this uncertainty."""
    return max(0, _places(sigma))


def _places(sigma: float) -> int:
    places = DIGITS - 1 - floor(log10(sigma))
    # 0.0999 rounds to 0.10, which has one digit more than its logarithm says
    return places - 1 if round(sigma, places) >= 10.0 ** (DIGITS - places) else places
