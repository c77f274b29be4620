"""Parameters of the singular-perturbation algorithm from a log.

With eq. (14) of the paper every variant is ``phi = p w1 + (T - p) w2 + kappa w1 x w2``, and its
long-term response to coning of ``l = 2 pi f T`` depends on one number,
``Q = 2 kappa / T**2 - p/T (1 - p/T)``:

    rho = D**2 / l (cot(l/2) / 2 + Q sin l),                                               (a)

with D = l for point rates and 2 sin(l/2) for mean rates. For a coning spectrum K(f) the drift
``sum of K (rho - 1)`` is therefore zero at

    Q* = sum of K (1 - rho_0) / sum of K D**2 / l sin l,   rho_0 = rho at Q = 0,           (b)

and ``epsilon = T/2, n = 6 Q* + 3/2`` of the truncated variant has that Q and weighs both rates
alike. Other criteria do harm: where the paper's per-interval error (18) is smallest the drift is
larger, and a fit to rotation vectors is swamped by interpolation errors.

The paper's bounds on its parameters are given as information, in the one reading of them that
is consistent in its units:

    (13)  epsilon <= |w'| / |w''|,        (15)  n >= T |w'| / |w|.

The derivatives are not taken from the data, where noise would decide (white noise alone gives
``T / sqrt 3`` and ``sqrt 2``), but from the moments ``m_k = integral of (2 pi f)**k S df`` of
the spectrum S above its noise floor: ``sqrt(m_2 / m_4)`` and ``T sqrt(m_2 / m_0)``.

References
----------
.. [1] L. Fu, Z. Luo, "A singular perturbation-based algorithm for compensation of
   pseudo-coning error for strapdown inertial navigation" (in Chinese), 2011.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import signal

from sinstool.core.arrays import ArrayLike, FloatArray
from sinstool.methods.coning.algorithm import GyroKind
from sinstool.methods.coning.response import ConingSpectrum, coning_spectrum

SEGMENT_S = 10.0
LOWEST_HZ = 0.2
HIGHEST_SHARE = 0.4  # of the sampling rate
FLOOR_SHARE = 0.2  # of the band, its top: where the spectrum is taken for noise
SIGNAL_TO_NOISE = 3.0
EPSILON_RANGE = (1e-3, 100.0)  # of the interval

# Fraction of the coning that the motion in the passband would have if all of it coned one way
# round; noise alone gives less than this by chance.
_LEAST_COHERENT = 0.01


@dataclass(frozen=True)
class SpTuning:
    """The parameters that ``--sp-preset auto`` chooses.

    Attributes
    ----------
    status : {"tuned", "no-passband", "noise-limited", "no-coning"}
        With anything but ``tuned`` the parameters are those of the preset ``best``.
    q : float
        Q of eq. (a).
    epsilon : float
        T/2, s.
    beta_gain : float
        n of the paper's eq. (14), for the variant ``truncated``.
    interval : float
        T, s.
    passband : float or None
        Hz.
    drift_best, drift_tuned : ndarray, shape (3,)
        Predicted drift with the preset ``best`` and with these parameters, rad/s about the
        body's axes.
    """

    status: Literal["tuned", "no-passband", "noise-limited", "no-coning"]
    q: float
    epsilon: float
    beta_gain: float
    interval: float
    passband: float | None
    drift_best: FloatArray
    drift_tuned: FloatArray

    def options(self) -> dict[str, float | str]:
        """Options of the algorithm ``singular-perturbation``."""
        return {"variant": "truncated", "epsilon": self.epsilon, "beta_gain": self.beta_gain}


@dataclass(frozen=True)
class SpBounds:
    """The paper's bounds (13) and (15) on a log: median, 10th and 90th percentile of windows.

    Attributes
    ----------
    status : {"ok", "noise-limited"}
        ``noise-limited`` where at least half of the windows hold little but noise; the bounds are
        then those of the noise and mean nothing.
    windows, noise_limited : int
        Number of windows, and of those that hold little but noise.
    epsilon_upper : tuple of 3 float
        s, within 1e-3 and 100 intervals.
    gain_lower : tuple of 3 float
        Of n.
    band : tuple of 2 float
        Hz.
    """

    status: Literal["ok", "noise-limited"]
    windows: int
    noise_limited: int
    epsilon_upper: tuple[float, float, float]
    gain_lower: tuple[float, float, float]
    band: tuple[float, float]


def coning_answer(turn: ArrayLike, q: float, gyro_kind: GyroKind = "rate") -> FloatArray:
    """Fraction of the true coning rate that the two-rate form reproduces, eq. (a).

    Parameters
    ----------
    turn : array_like
        ``l``, rad, not 0.
    q : float
        Q.
    gyro_kind : {"rate", "mean-rate", "increment"}, optional
        What the samples are.

    Returns
    -------
    ndarray
    """
    turns = np.asarray(turn, dtype=np.float64)
    return np.asarray(_scale(turns, gyro_kind) * (0.5 / np.tan(0.5 * turns) + q * np.sin(turns)))


def best_q(turn: float, gyro_kind: GyroKind = "rate") -> float:
    """Q that makes the response to coning at one frequency exact.

    Parameters
    ----------
    turn : float
        ``l`` of the line, rad, below pi; 0 gives the limit of slow coning.
    gyro_kind : {"rate", "mean-rate", "increment"}, optional
        What the samples are.

    Returns
    -------
    float
        At 0 it is 1/12 for point rates and 1/6 for mean rates and increments.
    """
    if turn < 1e-3:
        return 1.0 / 12.0 if gyro_kind == "rate" else 1.0 / 6.0
    scale = float(_scale(np.array(turn), gyro_kind))
    return float((1.0 / scale - 0.5 / np.tan(0.5 * turn)) / np.sin(turn))


def tune(
    gyro: ArrayLike, interval: float, gyro_kind: GyroKind = "rate", *, passband: float | None = None
) -> SpTuning:
    """Choose epsilon and n so that the log's own coning does not drift.

    Parameters
    ----------
    gyro : array_like, shape (n, 3)
        Equally spaced samples, rad/s, or rad for increments.
    interval : float
        T, s.
    gyro_kind : {"rate", "mean-rate", "increment"}, optional
        What the samples are.
    passband : float, optional
        Hz, up to which coning is motion. Without one nothing tells motion from noise, and
        the preset ``best`` is returned.

    Returns
    -------
    SpTuning
        Of the three axes together: Q* minimises the square of the drift vector.

    Raises
    ------
    ValueError
        If the shape is wrong, or the passband not below half the sampling rate.

    Notes
    -----
    ``best`` is also returned where the passband holds little but noise (as in :func:`bounds`),
    where the coning at different frequencies cancels, and where Q* is outside the range that single
    frequencies in the passband give: such a Q* is due to chance.
    """
    if passband is not None and not 0.0 < passband * interval < 0.5:
        raise ValueError(
            f"Expected `passband` between 0 and {0.5 / interval:g} Hz, got {passband}."
        )
    spectrum = coning_spectrum(gyro, interval, gyro_kind, segment=SEGMENT_S)
    usual = 1.0 / 12.0
    used = (spectrum.frequency > 0.0) & (
        spectrum.frequency <= (0.5 / interval if passband is None else passband)
    )
    used[-1] = False  # half the sampling rate itself has no quadrature
    turn = 2.0 * np.pi * spectrum.frequency[used] * interval
    k = spectrum.density[used] * spectrum.step
    missing = (1.0 - coning_answer(turn, 0.0, gyro_kind)) @ k
    per_q = (_scale(turn, gyro_kind) * np.sin(turn)) @ k

    status: Literal["tuned", "no-passband", "noise-limited", "no-coning"] = "tuned"
    q = usual
    if passband is None:
        status = "no-passband"
    elif bounds(gyro, interval, gyro_kind, highest=passband).status == "noise-limited":
        status = "noise-limited"
    else:
        most = most_coning(gyro, spectrum)[used] * spectrum.step
        amount = float(np.sum(most * _scale(turn, gyro_kind) * np.sin(turn)))
        square = float(per_q @ per_q)
        low = best_q(0.0, gyro_kind)
        high = best_q(2.0 * np.pi * passband * interval, gyro_kind)
        fitted = float(missing @ per_q) / square if square else usual
        if np.sqrt(square) < _LEAST_COHERENT * amount or not 0.98 * low <= fitted <= 1.02 * high:
            status = "no-coning"
        else:
            q = fitted
    return SpTuning(
        status,
        q,
        0.5 * interval,
        6.0 * q + 1.5,
        interval,
        passband,
        np.asarray(usual * per_q - missing),
        np.asarray(q * per_q - missing),
    )


def bounds(
    gyro: ArrayLike, interval: float, gyro_kind: GyroKind = "rate", *, highest: float | None = None
) -> SpBounds:
    """Evaluate the paper's bounds (13) and (15) from spectra of a log's windows.

    Parameters
    ----------
    gyro : array_like, shape (n, 3)
        Equally spaced samples, rad/s, or rad for increments.
    interval : float
        T, s.
    gyro_kind : {"rate", "mean-rate", "increment"}, optional
        What the samples are.
    highest : float, optional
        End of the band, Hz, which begins at 0.2 Hz; by default 0.4 of the sampling rate. Give the
        gyro's bandwidth if that is less.

    Returns
    -------
    SpBounds
        The noise floor is the median of the spectrum in the top fifth of the frequencies up to
        half the sampling rate.

    Raises
    ------
    ValueError
        If the shape is wrong, or the band or the log too short.
    """
    rate = np.asarray(gyro, dtype=np.float64)
    if rate.ndim != 2 or rate.shape[1] != 3 or len(rate) < 8:
        raise ValueError(f"Expected `gyro` to have shape (n, 3) with n >= 8, got {rate.shape}.")
    if gyro_kind == "increment":
        rate = rate / interval
    top = HIGHEST_SHARE / interval if highest is None else highest
    length = min(len(rate), max(8, round(SEGMENT_S / interval)))
    frequency, _, windows = signal.spectrogram(
        rate,
        fs=1.0 / interval,
        window="hann",
        nperseg=length,
        noverlap=length // 2,
        detrend="constant",
        axis=0,
    )
    trace = windows.sum(axis=1).T  # window, frequency
    used = (frequency >= LOWEST_HZ) & (frequency <= top)
    if np.count_nonzero(used) < 2:
        raise ValueError(f"No frequencies of the log lie between {LOWEST_HZ} and {top:g} Hz.")
    floor = np.median(trace[:, frequency >= (1.0 - FLOOR_SHARE) * frequency[-1]], axis=1)
    above = np.maximum(trace[:, used] - floor[:, np.newaxis], 0.0)
    step = frequency[1] - frequency[0]
    w = 2.0 * np.pi * frequency[used]
    m0, m2, m4 = (above @ w**power * step for power in (0, 2, 4))
    width = float(np.count_nonzero(used) * step)
    limited = ~(m0 >= SIGNAL_TO_NOISE * floor * width) | (m0 == 0.0)

    # The bounds of the windows that hold motion; of all where none does.
    informative = ~limited if not limited.all() else m0 > 0.0
    if not informative.any():
        epsilon = np.array([np.nan])
        gain = np.array([np.nan])
    else:
        low, high = (share * interval for share in EPSILON_RANGE)
        epsilon = np.clip(np.sqrt(m2[informative] / m4[informative]), low, high)
        gain = interval * np.sqrt(m2[informative] / m0[informative])
    return SpBounds(
        "noise-limited" if 2 * np.count_nonzero(limited) >= len(limited) else "ok",
        len(limited),
        int(np.count_nonzero(limited)),
        _percentiles(epsilon),
        _percentiles(gain),
        (LOWEST_HZ, float(top)),
    )


def most_coning(gyro: ArrayLike, spectrum: ConingSpectrum) -> FloatArray:
    """Coning density that a circular motion with the same spectrum would have."""
    rate = np.asarray(gyro, dtype=np.float64)
    if spectrum.gyro_kind == "increment":
        rate = rate / spectrum.interval
    length = 2 * (len(spectrum.frequency) - 1)
    _, power = signal.welch(
        rate, fs=1.0 / spectrum.interval, nperseg=min(length, len(rate)), nfft=length, axis=0
    )
    mean = 0.0 if spectrum.gyro_kind == "rate" else spectrum.interval
    response = np.sinc(spectrum.frequency * mean) ** 2
    turns = np.maximum(2.0 * np.pi * spectrum.frequency, 2.0 * np.pi * spectrum.step)
    return np.asarray(0.5 * power.sum(axis=1) / response / turns)


def _percentiles(values: FloatArray) -> tuple[float, float, float]:
    middle, low, high = np.percentile(values, [50.0, 10.0, 90.0])
    return float(middle), float(low), float(high)


def _scale(turn: FloatArray, gyro_kind: GyroKind) -> FloatArray:
    """``D**2 / l``."""
    if gyro_kind == "rate":
        return turn
    return np.asarray(4.0 * np.sin(0.5 * turn) ** 2 / turn)
