"""Gain of a gyro over frequency: low-pass filters with unit gain at rest.

References
----------
.. [1] A. V. Oppenheim, R. W. Schafer, "Discrete-time signal processing", 3rd ed., 2010,
   appendix B (Butterworth and Chebyshev filters of the first kind).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sinstool.errors import ConfigurationError

FloatArray = NDArray[np.float64]
Kind = Literal["none", "cheb", "butter"]

RIPPLE_DB = 0.2
BANDWIDTH_HZ = 200.0
MAX_ORDER = 40
_DROP = 10.0**0.3  # power lost at the bandwidth: 3 dB


@dataclass(frozen=True)
class GyroResponse:
    """Gain of a gyro, without its phase.

    Attributes
    ----------
    kind : {"none", "cheb", "butter"}
        No filter, Chebyshev of the first kind, Butterworth.
    order : int
        Of the filter, N.
    ripple_db : float
        Of a Chebyshev filter's pass band, dB.
    bandwidth_hz : float
        Where the gain is 3 dB below the largest of the pass band, Hz.
    """

    kind: Kind
    order: int = 0
    ripple_db: float = RIPPLE_DB
    bandwidth_hz: float = BANDWIDTH_HZ

    def __post_init__(self) -> None:
        if self.kind == "none":
            return
        if not 1 <= self.order <= MAX_ORDER:
            raise ConfigurationError(
                f"a gyro response of order {self.order}", f"give an order from 1 to {MAX_ORDER}"
            )
        if not 0.0 < self.ripple_db < 3.0 or not 0.0 < self.bandwidth_hz < np.inf:
            raise ConfigurationError(
                f"a gyro response of {self.ripple_db} dB ripple and {self.bandwidth_hz} Hz",
                "give a ripple above 0 and below 3 dB, and a bandwidth above 0 Hz",
            )

    @property
    def name(self) -> str:
        """As :func:`parse_response` takes it, without what is as usual."""
        if self.kind == "none":
            return "none"
        unusual = "" if self.bandwidth_hz == BANDWIDTH_HZ else f",{self.bandwidth_hz:g}"
        if self.kind == "cheb" and (unusual or self.ripple_db != RIPPLE_DB):
            unusual = f",{self.ripple_db:g}{unusual}"
        return f"{self.kind}:{self.order}{unusual}"

    def gain(self, frequency: ArrayLike) -> FloatArray:
        """Amplitude out over amplitude in.

        Parameters
        ----------
        frequency : array_like
            Hz.

        Returns
        -------
        ndarray
            1 at 0 Hz. A Chebyshev filter of even order has its ripple above that, one of odd
            order below: ``G**2 = (1 + e**2 T_N(0)**2) / (1 + e**2 T_N(f / f_p)**2)`` with
            ``e**2 = 10**(ripple / 10) - 1`` and ``f_p`` so that the ratio of its largest
            value to that at the bandwidth is 3 dB.
        """
        f = np.abs(np.asarray(frequency, dtype=np.float64))
        if self.kind == "none":
            return np.ones_like(f)
        if self.kind == "butter":
            loss = (_DROP - 1.0) * (f / self.bandwidth_hz) ** (2 * self.order)
            return np.asarray(1.0 / np.sqrt(1.0 + loss))
        e = np.sqrt(10.0 ** (0.1 * self.ripple_db) - 1.0)
        edge = self.bandwidth_hz / np.cosh(np.arccosh(np.sqrt(_DROP - 1.0) / e) / self.order)
        at_rest = 1.0 + (e * _chebyshev(self.order, np.zeros(1))[0]) ** 2
        return np.sqrt(at_rest / (1.0 + (e * _chebyshev(self.order, f / edge)) ** 2))


def parse_response(text: str) -> GyroResponse:
    """Gyro response from its short form on the command line.

    Parameters
    ----------
    text : str
        ``none``, ``cheb:N``, ``cheb:N,ripple dB,bandwidth Hz``, ``butter:N`` or
        ``butter:N,bandwidth Hz``.

    Returns
    -------
    GyroResponse

    Raises
    ------
    ConfigurationError
        If it is none of these or a number is impossible.
    """
    number = r"(\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)"
    if text == "none":
        return GyroResponse("none")
    if found := re.fullmatch(rf"cheb:(\d+)(?:,{number}(?:,{number})?)?", text):
        return GyroResponse(
            "cheb",
            int(found[1]),
            float(found[2] or RIPPLE_DB),
            float(found[3] or BANDWIDTH_HZ),
        )
    if found := re.fullmatch(rf"butter:(\d+)(?:,{number})?", text):
        return GyroResponse("butter", int(found[1]), bandwidth_hz=float(found[2] or BANDWIDTH_HZ))
    raise ConfigurationError(
        f"unknown gyro response {text!r}",
        "one of none, cheb:N, cheb:N,ripple dB,bandwidth Hz, butter:N, butter:N,bandwidth Hz",
    )


def _chebyshev(order: int, x: FloatArray) -> FloatArray:
    """Chebyshev polynomial of the first kind for x >= 0."""
    inside = np.cos(order * np.arccos(np.minimum(x, 1.0)))
    return np.where(x <= 1.0, inside, np.cosh(order * np.arccosh(np.maximum(x, 1.0))))
