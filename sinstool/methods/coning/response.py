"""Response of coning algorithms to classical coning, in closed form; coning of a log.

In classical coning every update is the one before it, turned about the cone's axis. The
product of any number of them is therefore known from one: no simulation, no accumulated
rounding, valid for large cone angles and beyond half the sample rate.

Components of the rate in phase quadrature turn the body about the third axis. Per frequency
that is the cross spectrum of two axes [2]_,

    K_z(f) = -Im S_xy(f) / (2 pi f),   S_xy one-sided, of conj(X) Y,                       (1)

cyclically for the other axes; its integral is the rate of coning about z, the mean of
``(alpha x omega)_z / 2``. An algorithm that reproduces the fraction rho(f) of it and should
reproduce D(f) (1 for motion, 0 for noise) drifts by

    integral of K(f) (rho(f) - D(f)) df,                                                  (2)

the way the vector points, in the body frame. No simulation is needed, and frequency alone
separates real coning from noise. Not in it: products of two frequencies that an update of several
samples folds to zero; a difference from the drift of a run points to those.

References
----------
.. [1] L. E. Goodman, A. R. Robinson, "Effect of finite rotations on gyroscopic sensing
   devices", J. Applied Mechanics 25, 1958, 210-213 (the solid angle of a cone).
.. [2] P. G. Savage, "Strapdown Analytics", 2nd ed., 2007, section 10 (coning response from
   vibration spectra).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sin
from typing import Literal

import numpy as np
from scipy import signal

from sinstool.core.arrays import ArrayLike, FloatArray
from sinstool.methods.coning.algorithm import ConingAlgorithm, GyroKind
from sinstool.methods.coning.increments import DEFAULT_POINTS, RateIntegrator, convert

# A cone this narrow has no terms beyond theta**2 left in float64's relative 1e-8.
_NARROW = 1e-4


def drifts_from_phi(phi: FloatArray, duration: float, frequency: FloatArray) -> FloatArray:
    """Long-term drifts of an algorithm from its rotation vectors in classical coning.

    Parameters
    ----------
    phi : ndarray, shape (n, 3)
        Rotation vectors of any one update, rad, of coning about the body's z axis whose rate vector
        turns about +z (as in :func:`coning_samples`).
    duration : float
        Of the update, s.
    frequency : ndarray, shape (n,)
        Of the coning, Hz.

    Returns
    -------
    ndarray, shape (n,)
        rad/s, positive where the computed attitude drifts the way the mean of the gyro's z
        axis points, as it does with too little compensation.

    Notes
    -----
    With ``e = exp(phi)`` of the first update and ``r`` the turn of the pattern about z over
    one update, the product of K updates is ``(e r)**K r**-K``. True updates give an ``e r``
    that turns by exactly as much as ``r``; the drift is the difference of the two angles
    per update. The difference is formed from ``cos(A) - cos(h)`` of the half angles, which
    does not cancel, so the result is good to about 1e-13 of the coning rate.
    """
    angle = np.linalg.norm(phi, axis=1)
    e_z = 0.5 * phi[:, 2] * np.sinc(angle / (2.0 * pi))
    e_w = np.cos(0.5 * angle)
    h = pi * frequency * duration
    cos_h, sin_h = np.cos(h), np.sin(h)
    # cos A = cos h + delta, with e_w - 1 = -2 sin(angle/4)**2
    delta = -2.0 * np.sin(0.25 * angle) ** 2 * cos_h - e_z * sin_h
    square = sin_h * sin_h - 2.0 * delta * cos_h - delta * delta
    sin_a = np.copysign(np.sqrt(np.maximum(square, 0.0)), e_w * sin_h + e_z * cos_h)
    cos_a = cos_h + delta
    alike = sin_a * sin_h > 0.0
    total = np.where(alike, sin_a + sin_h, 1.0)
    sine = np.where(
        alike,
        cos_h * (-2.0 * delta * cos_h - delta * delta) / total - sin_h * delta,
        sin_a * cos_h - cos_a * sin_h,
    )
    difference = np.arctan2(sine, cos_a * cos_h + sin_a * sin_h)
    return np.asarray(-2.0 * difference / duration)


def coning_samples(
    half_angle: float, frequency: FloatArray, interval: float, count: int, gyro_kind: GyroKind
) -> FloatArray:
    """Exact gyro samples of classical coning about the body's z axis.

    Parameters
    ----------
    half_angle : float
        Of the cone, rad.
    frequency : ndarray, shape (n,)
        Of the coning, Hz.
    interval : float
        Between samples, s.
    count : int
        Number of samples; the first is at time 0.
    gyro_kind : {"rate", "mean-rate", "increment"}
        See `sinstool.core.conventions`.

    Returns
    -------
    ndarray, shape (n, count, 3)
        rad/s or rad. Attitude ``q = [cos(a/2), sin(a/2) cos Wt, sin(a/2) sin Wt, 0]``
        has the rate ``W [-sin a sin Wt, sin a cos Wt, -2 sin(a/2)**2]``.
    """
    turn = 2.0 * pi * frequency[:, np.newaxis]
    k = np.arange(count)
    # Whole turns are taken off in units of turns: beyond half the sample rate too.
    late = 2.0 * pi * np.mod(frequency[:, np.newaxis] * interval * k, 1.0)
    z = -2.0 * turn * sin(0.5 * half_angle) ** 2
    if gyro_kind == "rate":
        scale, gain, phase = 1.0, turn * sin(half_angle), late
    else:
        # Over an interval: the rate at its middle times sin(lambda/2) / (lambda/2).
        scale = interval if gyro_kind == "increment" else 1.0
        gain = 2.0 * sin(half_angle) * np.sin(0.5 * turn * interval) / interval
        phase = late - 0.5 * turn * interval
    z = np.broadcast_to(z, phase.shape)
    return np.asarray(scale * np.stack([-gain * np.sin(phase), gain * np.cos(phase), z], axis=-1))


def coning_drifts(
    algorithm: ConingAlgorithm,
    half_angle: float,
    frequency: ArrayLike,
    interval: float,
    gyro_kind: GyroKind = "mean-rate",
    *,
    points: int = DEFAULT_POINTS,
) -> FloatArray:
    """Long-term drift of an algorithm at many frequencies at once.

    Parameters
    ----------
    algorithm : ConingAlgorithm
        It gets all the history and look-ahead that it uses.
    half_angle : float
        Of the cone, rad.
    frequency : array_like, shape (n,)
        Of the coning, Hz.
    interval : float
        Between gyro samples, s.
    gyro_kind : {"rate", "mean-rate", "increment"}, optional
        What the samples are; converted to the algorithm's input as those of a log are.
    points : int, optional
        Samples of the rate interpolation.

    Returns
    -------
    ndarray, shape (n,)
        rad/s; positive for too little compensation.
    """
    algorithm = algorithm.for_kind(gyro_kind)
    at = np.atleast_1d(np.asarray(frequency, dtype=np.float64))
    # one row of history at least: increments from rates begin at row 1
    before = max(algorithm.before, 1)
    rows = before + algorithm.samples + algorithm.after
    integrate = gyro_kind == "rate" and algorithm.takes == "increments"
    pad = points if integrate else 0  # so that no stencil is off its centre
    gyro = coning_samples(half_angle, at, interval, rows + 2 * pad, gyro_kind)
    dt = np.full(gyro.shape[:2], interval)
    if integrate:
        # all frequencies one behind the other: only what is near the seams is wrong
        x = np.zeros_like(gyro)
        flat = RateIntegrator(points).increments(gyro.reshape(-1, 3), dt.ravel(), 1, dt.size - 1)
        x.reshape(-1, 3)[1:] = flat
    else:
        x = convert(gyro.reshape(-1, 3), dt.ravel(), gyro_kind, algorithm.takes).reshape(gyro.shape)
    windows = np.ascontiguousarray(x[:, pad : pad + rows])
    phi = [algorithm.rotation_vectors(one, dt[0, :rows], before, 1)[0] for one in windows]
    return drifts_from_phi(np.array(phi).reshape(-1, 3), algorithm.samples * interval, at)


def coning_gains(
    algorithm: ConingAlgorithm,
    frequency: ArrayLike,
    interval: float,
    gyro_kind: GyroKind = "mean-rate",
) -> FloatArray:
    """Fraction of the true coning rate that an algorithm reproduces, at many frequencies.

    Parameters
    ----------
    algorithm, interval, gyro_kind
        See :func:`coning_drifts`.
    frequency : array_like, shape (n,)
        Of the coning, Hz; not a multiple of the update rate, where the sampled motion is a
        constant rate and the fraction unbounded. 1 is returned for frequency 0.

    Returns
    -------
    ndarray, shape (n,)
        1 for a perfect algorithm, 0 for one that sees no coning at all.
    """
    at = np.atleast_1d(np.asarray(frequency, dtype=np.float64))
    still = at == 0.0
    safe = np.where(still, 1.0, at)
    drift = coning_drifts(algorithm, _NARROW, safe, interval, gyro_kind)
    return np.where(still, 1.0, 1.0 - drift / (2.0 * pi * safe * 2.0 * sin(0.5 * _NARROW) ** 2))


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
        What the samples are, on which the response of an algorithm depends.
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
        """Rate of all coning, rad/s, by axis."""
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
        That processes them.
    passband : float, optional
        Hz, above which nothing is motion; by default everything is.
    interval, gyro_kind : optional
        Of the algorithm's samples, if they differ from those of the spectrum: for its drift on a
        log at a lower rate.

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
