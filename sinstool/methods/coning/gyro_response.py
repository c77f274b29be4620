"""Magnitude response of a gyro to vibration of each frequency."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator

from sinstool.core.arrays import ArrayLike, FloatArray
from sinstool.core.errors import ConfigurationError
from sinstool.core.small_file import read_text

_FORMS = "give none, cheb:ORDER,RIPPLE_DB,HZ, butter:ORDER,HZ or a file with lines of HZ,GAIN"


@dataclass(frozen=True)
class GyroResponse:
    """Gain of a gyro against frequency, 1 at frequency 0.

    Attributes
    ----------
    name : str
        As in ``--gyro-response``.
    gain : callable
        Frequencies in Hz to gains.
    """

    name: str
    gain: Callable[[FloatArray], FloatArray]

    @property
    def flat(self) -> bool:
        """Whether the gain is 1 everywhere."""
        return self.name == "none"

    def __call__(self, frequency: ArrayLike) -> FloatArray:
        """Gain at frequencies in Hz."""
        return np.asarray(self.gain(np.abs(np.asarray(frequency, dtype=np.float64))))


def none() -> GyroResponse:
    """A gyro that passes every frequency alike."""
    return GyroResponse("none", np.ones_like)


def butterworth(order: int, frequency: float) -> GyroResponse:
    """Butterworth low-pass filter.

    Parameters
    ----------
    order : int
        1 or more.
    frequency : float
        Half-power (-3 dB) frequency, Hz.

    Returns
    -------
    GyroResponse
        ``1 / sqrt(1 + (f / frequency)**(2 order))``.

    Raises
    ------
    ConfigurationError
        If a value is impossible.
    """
    _check("Butterworth", order, frequency)

    def gain(f: FloatArray) -> FloatArray:
        return np.asarray(1.0 / np.sqrt(1.0 + (f / frequency) ** (2 * order)))

    return GyroResponse(f"butter:{order},{frequency:g}", gain)


def chebyshev(order: int, ripple_db: float, frequency: float) -> GyroResponse:
    """Chebyshev low-pass filter of type I, scaled to gain 1 at frequency 0.

    Parameters
    ----------
    order : int
        1 or more. The passband gain of an even order lies between 1 and 1 plus the ripple, as
        frequency 0 is a minimum of its ripple; that of an odd order between 1 less the ripple
        and 1.
    ripple_db : float
        Ripple of the passband, dB, between 0 and 3.
    frequency : float
        Frequency at which the power is half of the passband's maximum, Hz.

    Returns
    -------
    GyroResponse
        ``sqrt(d / (1 + e**2 T_n(x)**2))`` with ``e**2 = 10**(ripple/10) - 1``, ``x`` the
        frequency over that of the ripple's edge, and d = 1 or, for an even order, 1 + e**2.

    Raises
    ------
    ConfigurationError
        If a value is impossible.
    """
    _check("Chebyshev", order, frequency)
    if not 0.0 < ripple_db < 3.0:
        raise ConfigurationError(
            f"a Chebyshev gyro response has a ripple of {ripple_db} dB",
            "the ripple must be between 0 and 3 dB",
        )
    square = 10.0 ** (0.1 * ripple_db) - 1.0
    edge = frequency / np.cosh(np.arccosh(1.0 / np.sqrt(square)) / order)
    at_zero = 1.0 if order % 2 else 1.0 + square

    def gain(f: FloatArray) -> FloatArray:
        x = f / edge
        inside = np.cos(order * np.arccos(np.minimum(x, 1.0)))
        outside = np.cosh(order * np.arccosh(np.maximum(x, 1.0)))
        return np.asarray(np.sqrt(at_zero / (1.0 + square * np.where(x < 1, inside, outside) ** 2)))

    return GyroResponse(f"cheb:{order},{ripple_db:g},{frequency:g}", gain)


def measured(frequency: ArrayLike, gain: ArrayLike, name: str = "table") -> GyroResponse:
    """Response from a table of measured gains, interpolated without overshoot.

    Parameters
    ----------
    frequency : array_like, shape (n,)
        Hz, increasing.
    gain : array_like, shape (n,)
        Positive. Divided by the first gain, so that the gain is 1 at frequency 0; constant below
        the first and above the last frequency.
    name : str, optional
        Shown in messages and reports.

    Raises
    ------
    ConfigurationError
        If there are fewer than two lines, or they are not as above.
    """
    f = np.asarray(frequency, dtype=np.float64)
    g = np.asarray(gain, dtype=np.float64)
    if f.ndim != 1 or f.shape != g.shape or len(f) < 2:
        raise ConfigurationError(
            f"the gyro response {name} is not a table", "give two or more lines of HZ,GAIN"
        )
    if not (np.all(np.diff(f) > 0) and f[0] >= 0 and np.all(g > 0) and np.all(np.isfinite(f + g))):
        raise ConfigurationError(
            f"the gyro response {name} has frequencies that do not increase or gains that are"
            " not positive",
            "check the table",
        )
    curve = PchipInterpolator(f, g / g[0])
    return GyroResponse(name, lambda at: np.asarray(curve(np.clip(at, f[0], f[-1]))))


def gyro_response(text: str | GyroResponse | None) -> GyroResponse:
    """Response from the text of ``--gyro-response``.

    Parameters
    ----------
    text : str, GyroResponse or None
        ``none``, ``cheb:ORDER,RIPPLE_DB,HZ``, ``butter:ORDER,HZ``, or a text file with lines
        of frequency and gain separated by a comma or blanks (``#`` starts a comment).

    Raises
    ------
    ConfigurationError
        If the text cannot be understood or the file cannot be read.
    """
    if isinstance(text, GyroResponse):
        return text
    if text is None or text == "none":
        return none()
    kind, colon, rest = text.partition(":")
    counts = {"cheb": 3, "butter": 2}
    if colon and kind in counts:
        try:
            order, *others = (float(part) for part in rest.split(","))
        except ValueError:
            raise ConfigurationError(f"unknown gyro response {text!r}", _FORMS) from None
        if len(others) + 1 != counts[kind] or not order.is_integer():
            raise ConfigurationError(f"unknown gyro response {text!r}", _FORMS)
        return (chebyshev if kind == "cheb" else butterworth)(int(order), *others)
    path = Path(text)
    if not path.is_file():
        raise ConfigurationError(f"unknown gyro response {text!r}, and no such file", _FORMS)
    try:
        lines = [line.partition("#")[0].replace(",", " ") for line in read_text(path).splitlines()]
        rows = np.array([[float(v) for v in line.split()] for line in lines if line.strip()])
        f, g = rows.T
    except ValueError:
        raise ConfigurationError(f"{path} is not a table of frequency and gain", _FORMS) from None
    return measured(f, g, str(path))


def _check(what: str, order: int, frequency: float) -> None:
    if order < 1 or not 0.0 < frequency < np.inf:
        raise ConfigurationError(
            f"a {what} gyro response of order {order} at {frequency} Hz is impossible",
            "the order must be 1 or more and the frequency above 0 Hz",
        )
