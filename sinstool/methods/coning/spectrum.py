"""Coning spectrum of a log, and the drift that it predicts for any algorithm.

Components of the rate in phase quadrature turn the body about the third axis. Per frequency
that is the cross spectrum of two axes [1]_,

    K_z(f) = -Im S_xy(f) / (2 pi f),   S_xy one-sided, of conj(X) Y,                       (1)

cyclically for the other axes; its integral is the rate of coning about z, the mean of
``(alpha x omega)_z / 2``. An algorithm that reproduces the fraction rho(f) of it and should
reproduce D(f) (1 for motion, 0 for noise) drifts by

    integral of K(f) (rho(f) - D(f)) df,                                                  (2)

the way the vector points, in the body frame. No simulation is needed, and real coning is told
from noise by frequency alone. Not in it: products of two frequencies that an update of several
samples folds to zero; a difference from the drift of a run points to those.

References
----------
.. [1] P. G. Savage, "Strapdown Analytics", 2nd ed., 2007, section 10 (coning response from
   vibration spectra).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal

from sinstool.methods.coning.algorithm import ConingAlgorithm, GyroKind
from sinstool.methods.coning.response import coning_gains

FloatArray = NDArray[np.float64]
Taper = Literal["hann", "boxcar"]


@dataclass(frozen=True)
class ConingSpectrum:
    """Coning per frequency.

    Attributes
    ----------
    frequency : ndarray, shape (m,)
        Hz, equally spaced, from 0 to half the sampling rate.
    density : ndarray, shape (m, 3)
        Of the coning about the body's axes, rad/s per Hz; 0 at frequency 0.
    interval : float
        Between samples, s.
    gyro_kind : {"rate", "mean-rate", "increment"}
        What the samples are, which decides the answer of an algorithm.
    """

    frequency: FloatArray
    density: FloatArray
    interval: float
    gyro_kind: GyroKind

    @property
    def step(self) -> float:
        """Width of a frequency bin, Hz."""
        return float(self.frequency[1] - self.frequency[0])

    def coning_rate(self) -> FloatArray:
        """Rate of all the coning there is, rad/s, by axis."""
        return np.asarray(self.density.sum(axis=0) * self.step)

    def cumulative(self) -> FloatArray:
        """Rate of the coning up to and with each frequency, rad/s, shape (m, 3)."""
        return np.cumsum(self.density, axis=0) * self.step


def coning_spectrum(
    gyro: ArrayLike,
    interval: float,
    gyro_kind: GyroKind,
    *,
    segment: float | None = 10.0,
    taper: Taper = "hann",
) -> ConingSpectrum:
    """Coning spectrum of equally spaced gyro samples.

    Parameters
    ----------
    gyro : array_like, shape (n, 3)
        rad/s, or rad for increments.
    interval : float
        Between samples, s.
    gyro_kind : {"rate", "mean-rate", "increment"}
        What the samples are. Means and increments are divided by the response of the mean,
        ``sinc(f interval)``, as they stand for the rate's spectrum.
    segment : float, optional
        Duration of the pieces that are averaged, s; None takes the log as one.
    taper : {"hann", "boxcar"}, optional
        Window of each piece; pieces under ``hann`` overlap by half.

    Returns
    -------
    ConingSpectrum

    Raises
    ------
    ValueError
        If the shape is wrong or there are fewer than 8 samples.
    """
    rate = np.asarray(gyro, dtype=np.float64)
    if rate.ndim != 2 or rate.shape[1] != 3 or len(rate) < 8:
        raise ValueError(f"Expected `gyro` to have shape (n, 3) with n >= 8, got {rate.shape}.")
    if not interval > 0.0:
        raise ValueError(f"Expected a positive `interval`, got {interval}.")
    if gyro_kind == "increment":
        rate = rate / interval
    length = len(rate) if segment is None else min(len(rate), max(8, round(segment / interval)))
    options = {
        "fs": 1.0 / interval,
        "window": taper,
        "nperseg": length,
        "noverlap": length // 2 if taper == "hann" else 0,
        "detrend": "constant",
    }
    density = np.empty((length // 2 + 1, 3))
    frequency = np.empty(0)
    for axis in range(3):
        one, other = rate[:, (axis + 1) % 3], rate[:, (axis + 2) % 3]
        frequency, cross = signal.csd(one, other, **options)
        density[:, axis] = -cross.imag
    turn = 2.0 * np.pi * frequency[:, np.newaxis]
    density[0] = 0.0
    density[1:] /= turn[1:]
    if gyro_kind != "rate":
        density /= np.sinc(frequency * interval)[:, np.newaxis] ** 2
    return ConingSpectrum(np.asarray(frequency), density, interval, gyro_kind)


def predicted_drift(
    spectrum: ConingSpectrum,
    algorithm: ConingAlgorithm,
    *,
    passband: float | None = None,
    interval: float | None = None,
    gyro_kind: GyroKind | None = None,
) -> FloatArray:
    """Drift of an algorithm, by eq. (2).

    Parameters
    ----------
    spectrum : ConingSpectrum
        Of the log's samples.
    algorithm : ConingAlgorithm
        To be fed with them.
    passband : float, optional
        Hz, above which nothing is motion; by default everything is.
    interval, gyro_kind : optional
        Of the samples that the algorithm is fed with, if they are fewer or others than those
        that the spectrum is of: what it would do to a log at a lower rate.

    Returns
    -------
    ndarray, shape (3,)
        rad/s, of the computed attitude against the true one, about the body's axes.
    """
    motion = 1.0 if passband is None else np.where(spectrum.frequency <= passband, 1.0, 0.0)
    gain = _gain(spectrum, algorithm, interval, gyro_kind)
    return _sum(spectrum, gain - motion)


def pseudo_coning(
    spectrum: ConingSpectrum,
    algorithm: ConingAlgorithm,
    stopband: float,
    *,
    interval: float | None = None,
    gyro_kind: GyroKind | None = None,
) -> FloatArray:
    """Drift that is noise, if nothing real moves above a frequency.

    Parameters
    ----------
    spectrum, algorithm, interval, gyro_kind
        As in :func:`predicted_drift`.
    stopband : float
        Hz.

    Returns
    -------
    ndarray, shape (3,)
        ``integral of K rho df`` from `stopband` on, rad/s.
    """
    gain = _gain(spectrum, algorithm, interval, gyro_kind)
    return _sum(spectrum, np.where(spectrum.frequency > stopband, gain, 0.0))


def _gain(
    spectrum: ConingSpectrum,
    algorithm: ConingAlgorithm,
    interval: float | None,
    gyro_kind: GyroKind | None,
) -> FloatArray:
    return coning_gains(
        algorithm,
        spectrum.frequency,
        interval or spectrum.interval,
        gyro_kind or spectrum.gyro_kind,
    )


def _sum(spectrum: ConingSpectrum, weight: FloatArray) -> FloatArray:
    # Half the sampling rate itself has no quadrature: K is 0 there, whatever the gain.
    used = np.any(spectrum.density != 0.0, axis=1)
    return np.asarray(weight[used] @ spectrum.density[used] * spectrum.step)
