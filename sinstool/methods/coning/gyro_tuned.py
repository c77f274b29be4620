"""Coning coefficients tuned to a gyro's response: little pseudo-coning, true coning unchanged.

Noise of two axes in phase quadrature (vibration of the gyro's parts or of its mount, or what its
filter lets through) looks like coning, and every algorithm that compensates coning at its frequency
turns it into drift. Where the motion is known to end at a passband fp, the response above a
stopband fs can be made zero; and where the gyro's response G is known, the response below fp can be
made exact for the motion instead of for the gyro's output.

Every sample has an update from the M samples before it,

    phi_j = d_j + (sum over m = 1..M of y_m d_(j-m)) x d_j,

whose long-term response to coning of l = 2 pi f T is, as a fraction of the true rate,

    rho = D**2 (cot(l/2) / 2 + 2 sum over m of y_m sin(m l)) / l,                         (1)

where D/l is the amplitude of an increment over that of rate times interval: ``D = 2 sin(l/2)``
for true increments, l times the interpolation's response for point rates. The y
minimise the squares of ``G**2 rho - 1`` in the passband, weighted 100 times as much as
``G**2 rho`` in the stopband, and make ``G**2 rho = 1`` exactly near 0 and in the middle of the
passband. Longer updates would fold frequencies about the update rate's multiples; N = 1 has
none below the sampling rate.

References
----------
.. [1] J. G. Mark, D. A. Tazartes, "Tuning of coning algorithms to gyro data frequency response
   characteristics", J. Guidance, Control, and Dynamics 24(4), 2001, 641-647.
"""

from __future__ import annotations

from math import isfinite

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.errors import ConfigurationError
from sinstool.methods.coning import gyro_response as responses
from sinstool.methods.coning.algorithm import ConingAlgorithm, GyroKind
from sinstool.methods.coning.gyro_response import GyroResponse
from sinstool.methods.coning.increments import DEFAULT_POINTS, integration_stencils
from sinstool.methods.coning.lags import lag_kernel

DEFAULT_LAGS = 12
MOST_LAGS = 32

# Of the sampling rate, where no band is given: 60 and 110 Hz at 400 Hz.
DEFAULT_PASSBAND = 0.15
DEFAULT_STOPBAND = 0.275

_PASS_WEIGHT = 100.0
_GRID = 200
_MIDDLE = DEFAULT_POINTS // 2 - 1


class GyroTuned(ConingAlgorithm):
    """One update per sample with coefficients for a gyro's response and two bands.

    Parameters
    ----------
    passband : float, optional
        Hz, up to which coning is motion. Without any band it is 0.15 of the sampling rate;
        with a stopband only, 6/11 of it.
    stopband : float, optional
        Hz, above which nothing is motion. Without any band it is 0.275 of the sampling rate;
        with a passband only, there is none.
    gyro_response : str or GyroResponse, optional
        See :func:`~sinstool.methods.coning.gyro_response.gyro_response`; by default ``none``.
    interval : float, optional
        Between samples, s. Needed wherever a frequency is given, here or in the response.
    lags : int, optional
        Earlier samples, M, 2 to 32.
    gyro_kind : {"increment", "mean-rate", "rate"}, optional
        What the samples were before they became increments; :meth:`for_kind` sets it.

    Attributes
    ----------
    weights : ndarray, shape (lags,)
        ``y_1 .. y_M``.
    caveat : str
        Its limits, for the user.

    Raises
    ------
    ConfigurationError
        If a value is impossible, or a frequency comes without an interval.
    """

    name = "gyro-tuned"
    source = "Mark and Tazartes 2001"

    def __init__(
        self,
        *,
        passband: float | None = None,
        stopband: float | None = None,
        gyro_response: str | GyroResponse | None = None,
        interval: float | None = None,
        lags: int = DEFAULT_LAGS,
        gyro_kind: GyroKind = "increment",
    ) -> None:
        self.response = responses.gyro_response(gyro_response)
        if interval is not None and not (isfinite(interval) and interval > 0.0):
            raise ConfigurationError(
                f"gyro-tuned got an interval of {interval} s", "give a positive number of seconds"
            )
        if interval is None and not (passband is None and stopband is None and self.response.flat):
            raise ConfigurationError(
                "gyro-tuned got a frequency without the sample interval",
                "give interval in s, or neither bands nor a gyro response",
            )
        if not (isinstance(lags, int) and 2 <= lags <= MOST_LAGS):
            raise ConfigurationError(f"gyro-tuned got {lags} lags", f"give 2 to {MOST_LAGS}")
        self.interval = interval
        self.gyro_kind: GyroKind = gyro_kind
        self.before = self.lags = lags
        # without an interval everything is relative to the sampling rate
        step = interval or 1.0
        self.passband, self.stopband = _bands(passband, stopband, 1.0 / step)
        self._options = (passband, stopband)
        self._table = np.zeros((lags + 1, lags))
        for history in range(1, lags + 1):
            self._table[history, :history] = design(
                history, self.passband, self.stopband, self.response, step, gyro_kind
            )
        self.weights: FloatArray = self._table[lags].copy()
        unit = "Hz" if interval else "of the sampling rate"
        stop = f", nothing above {self.stopband:g}" if self.stopband else ""
        self.summary = (
            f"every sample, with {lags} earlier ones: coning up to {self.passband:g}{stop} {unit}"
        )
        above = (
            f"real coning above {self.stopband:g} {unit} is deliberately ignored and becomes drift,"
            " more of it than with other algorithms"
            if self.stopband
            else "above that its response is not controlled, and real coning there may become drift"
        )
        self.caveat = (
            f"gyro-tuned compensates coning up to {self.passband:g} {unit} only: {above}. Content"
            " above half the sampling rate is folded into the samples, and no algorithm can"
            " separate it."
        )

    def for_kind(self, gyro_kind: GyroKind) -> ConingAlgorithm:
        """See :meth:`ConingAlgorithm.for_kind`: point rates have coefficients of their own."""
        if (gyro_kind == "rate") == (self.gyro_kind == "rate"):
            return self
        passband, stopband = self._options
        return GyroTuned(
            passband=passband,
            stopband=stopband,
            gyro_response=self.response,
            interval=self.interval,
            lags=self.lags,
            gyro_kind=gyro_kind,
        )

    def _fill(self, x: FloatArray, dt: FloatArray, first: int, out: FloatArray) -> None:
        lag_kernel(x, first, 1, self._table, out)


def design(
    lags: int,
    passband: float,
    stopband: float | None,
    response: GyroResponse | None = None,
    interval: float = 1.0,
    gyro_kind: GyroKind = "increment",
) -> FloatArray:
    """Coefficients ``y_1 .. y_M`` of the form with all lags, see the module.

    Parameters
    ----------
    lags : int
        M.
    passband : float
        Hz.
    stopband : float or None
        Hz.
    response : GyroResponse, optional
        Of the gyro; none by default.
    interval : float, optional
        Between samples, s.
    gyro_kind : {"rate", "mean-rate", "increment"}, optional
        Point rates are meant to go through the usual interpolation
        (:class:`~sinstool.methods.coning.increments.RateIntegrator`), whose response is
        compensated.

    Returns
    -------
    ndarray, shape (lags,)
    """
    response = response or responses.none()
    at = passband * np.arange(1, _GRID + 1) / _GRID
    matrix, constant = _rows(at, lags, response, interval, gyro_kind)
    system, right = [_PASS_WEIGHT * matrix], [_PASS_WEIGHT * (1.0 - constant)]
    if stopband is not None:
        at = stopband + (0.5 / interval - stopband) * np.arange(_GRID) / _GRID
        matrix, constant = _rows(at, lags, response, interval, gyro_kind)
        system.append(matrix)
        right.append(-constant)
    # Exact near 0, where the largest angles are, and in the middle: with what is left of the
    # weights (the null space of these two conditions), least squares.
    exact = np.array([1e-3, 0.5])[: min(2, lags)] * passband
    matrix, constant = _rows(exact, lags, response, interval, gyro_kind)
    q, r = np.linalg.qr(matrix.T, mode="complete")
    count = len(exact)
    fixed = q[:, :count] @ np.linalg.solve(r[:count].T, 1.0 - constant)
    free = q[:, count:]
    if not free.shape[1]:
        return np.asarray(fixed)
    whole, target = np.concatenate(system), np.concatenate(right)
    rest = np.linalg.lstsq(whole @ free, target - whole @ fixed, rcond=None)[0]
    return np.asarray(fixed + free @ rest)


def _rows(
    frequency: FloatArray, lags: int, response: GyroResponse, interval: float, kind: GyroKind
) -> tuple[FloatArray, FloatArray]:
    """``G**2 rho`` of eq. (1) as matrix times y plus a constant, one row a frequency."""
    turn = 2.0 * np.pi * frequency * interval
    if kind == "rate":
        stencil = np.array([float(w) for w in integration_stencils(DEFAULT_POINTS)[_MIDDLE]])
        places = np.arange(DEFAULT_POINTS) - 0.5 * (DEFAULT_POINTS - 1)
        amplitude = turn * (np.cos(np.outer(turn, places)) @ stencil)
    else:
        amplitude = 2.0 * np.sin(0.5 * turn)
    scale = response(frequency) ** 2 * amplitude**2 / turn
    matrix = 2.0 * np.sin(np.outer(turn, np.arange(1, lags + 1)))
    return scale[:, np.newaxis] * matrix, scale * 0.5 / np.tan(0.5 * turn)


def _bands(
    passband: float | None, stopband: float | None, rate: float
) -> tuple[float, float | None]:
    if passband is None and stopband is None:
        return DEFAULT_PASSBAND * rate, DEFAULT_STOPBAND * rate
    if passband is None:
        assert stopband is not None
        passband = stopband * DEFAULT_PASSBAND / DEFAULT_STOPBAND
    limit = 0.5 * rate if stopband is None else stopband
    if not 0.0 < passband < limit <= 0.5 * rate or stopband == 0.5 * rate:
        stop = "" if stopband is None else f" and a stopband from {stopband:g} Hz"
        raise ConfigurationError(
            f"gyro-tuned got a passband to {passband:g} Hz{stop}",
            f"give 0 < passband < stopband < {0.5 * rate:g} Hz, half the sampling rate",
        )
    return passband, stopband
