"""Velocities that a receiver smooths: for how long, compared with a navigation, and undone.

Many receivers pass their velocities through a low-pass of first order, as they look steadier then:
they are flattened and late, which a latency cannot make good. With time constant tau and interval
T, a smoothed velocity is

    v_k = a v_k-1 + (1 - a) u_k,    a = exp(-T / tau)

where u_k is the mean of the velocity over the interval that ends at the fix, later ones with more
weight. So u_k follows from two velocities (an inverse filter [1]_, section 2.8). It is late by
tau - T a / (1 - a), which tends to T / 2 for a long tau.

For how long velocities are smoothed shows beside those of an inertial navigation, which within
seconds has errors that hardly change.

References
----------
.. [1] A. V. Oppenheim, R. W. Schafer, "Discrete-time signal processing", 3rd ed., Pearson, 2010.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sinstool.core.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from sinstool.core.order_statistics import median
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND

# Time constants that are tried, s.
TIMES = np.geomspace(0.1, 2.5, 24)
# Delays of the stamps that are tried, s, and those about the best of them.
DELAYS, NEARER = np.arange(-0.3, 1.0, 0.05), np.arange(-0.04, 0.05, 0.01)
# Steps at which the navigation is compared, s, and the way back from its end to its beginning,
# which a transform takes as one cycle.
STEP_S, WAY_BACK_S = 0.02, 20.0
# Fixes this soon after the beginning may be smoothed over what was before it, s.
SETTLED_S = 10.0
# Fewest changes that are compared, of fixes that are at least about this far apart, s: from one to
# the next of a quick receiver noise is most of it.
LEAST_CHANGES, APART_S = 60, 0.5
# Velocities are smoothed if their changes then differ from those of the navigation by less than
# this share of the squares that they differ by otherwise, whatever the delay; and by less than the
# second of those by which means over the interval do, as of a receiver that differences positions.
SHARE, SHARE_OF_MEANS = 0.5, 0.8
# Changes that differ by more than so many times the median square are bad fixes.
FAR = 9.0
# A velocity this many usual intervals after another is no mean over one.
MOST_INTERVALS = 1.5


@dataclass(frozen=True)
class Smoothing:
    """How a receiver smooths its velocities.

    Attributes
    ----------
    time_s : float
        Time constant, s; 0 where it clearly does not smooth them.
    noise, bend : float
        Root mean squares of horizontal vectors, m/s: of the noise that velocities have when the
        smoothing is undone, and by how much means over an interval then differ from the velocity
        that the vehicle has at their delay.
    """

    time_s: float = 0.0
    noise: float = 0.0
    bend: float = 0.0

    @property
    def undoable(self) -> bool:
        """Whether what is left of the motion within an interval is less than the noise."""
        return self.bend < self.noise


def smoothing(
    time_ns: IntArray, velocity_n: FloatArray, fix_ns: IntArray, fix_velocity_n: FloatArray
) -> Smoothing:
    """How a receiver smooths its velocities.

    Parameters
    ----------
    time_ns, velocity_n : ndarray, shape (n,), (n, 3)
        Times and velocities of the antenna by a navigation that hardly follows the fixes, m/s.
    fix_ns, fix_velocity_n : ndarray, shape (m,), (m, 3)
        Those of the receiver. Horizontal ones are compared.
    """
    seconds, at = (time_ns - time_ns[0]) / SECOND, (fix_ns - time_ns[0]) / SECOND
    inside = (at > SETTLED_S) & (at < seconds[-1] + DELAYS[0])
    inside &= np.isfinite(fix_velocity_n[:, :2]).all(axis=1)
    at, shown = at[inside], _level(fix_velocity_n[inside])
    steps = np.diff(at)
    if len(steps) < LEAST_CHANGES:
        return Smoothing()
    interval = float(median(steps))
    apart = max(round(APART_S / interval), 1)
    near = at[apart:] - at[:-apart] < MOST_INTERVALS * apart * interval
    if np.count_nonzero(near) < LEAST_CHANGES:
        return Smoothing()
    even = np.arange(0.0, seconds[-1], STEP_S)
    moved = np.interp(even, seconds, _level(velocity_n))
    back = np.linspace(moved[-1], moved[0], round(WAY_BACK_S / STEP_S))
    wave = np.fft.fft(np.concatenate([moved, back]))
    turns = 2j * np.pi * np.fft.fftfreq(len(wave), STEP_S)

    def differ(response: ComplexArray | float) -> float:
        known = np.fft.ifft(wave * response)[: len(even)]
        return _least_square(at, shown, even, known, near, apart)

    with np.errstate(invalid="ignore", divide="ignore"):
        means = np.where(turns == 0.0, 1.0, (1.0 - np.exp(-turns * interval)) / (turns * interval))
    otherwise = min(SHARE * differ(1.0), SHARE_OF_MEANS * differ(means))

    def smoothed(times: FloatArray) -> list[float]:
        return [differ(1.0 / (1.0 + turns * time)) for time in times]

    # Most receivers do not smooth
    if min(smoothed(TIMES[::4])) >= otherwise:
        return Smoothing()
    squares = smoothed(TIMES)
    best = int(np.argmin(squares))
    if squares[best] >= otherwise or best == len(TIMES) - 1:
        return Smoothing()
    time_s = float(TIMES[best] * (TIMES[1] / TIMES[0]) ** _lowest(squares, best))
    kept = np.exp(-interval / time_s)
    undone = (1.0 - kept * np.exp(-turns * interval)) / (1.0 - kept) / (1.0 + turns * time_s)
    off = np.fft.ifft(wave * (undone - np.exp(-turns * _delay(time_s, interval))))[: len(even)]
    bend = float(np.sqrt(np.mean(np.abs(off[even > SETTLED_S]) ** 2)))
    # Changes have twice the variance of white noise
    noise = float(np.sqrt(0.5 * squares[best] * (1.0 + kept**2)) / (1.0 - kept))
    return Smoothing(time_s, noise, bend)


def _lowest(values: Sequence[float], least: int) -> float:
    """Where a parabola through the least of equally spaced values is lowest, from there, steps."""
    if not 0 < least < len(values) - 1:
        return 0.0
    before, here, behind = values[least - 1 : least + 2]
    bend = before - 2.0 * here + behind
    return 0.5 * (before - behind) / bend if bend > 0.0 else 0.0


def unsmoothed(gnss: GnssEpochs, time_s: float) -> GnssEpochs:
    """Epochs with velocities that are means over the interval before them, not smoothed ones.

    Parameters
    ----------
    time_s : float
        Time constant of the smoothing, s; 0 leaves them as they are.

    Returns
    -------
    GnssEpochs
        Without velocities where the one before is missing. Their sigmas stay as they are: a
        receiver may state those of what it smooths.
    """
    if time_s == 0.0:
        return gnss
    rows = np.flatnonzero(gnss.has_velocity)
    steps = np.diff(gnss.time_ns[rows]) / SECOND
    kept = np.exp(-steps / time_s)[:, None]
    before, after = gnss.velocity_n[rows[:-1]], gnss.velocity_n[rows[1:]]
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = (after - kept * before) / (1.0 - kept)
    mean[(steps <= 0.0) | (steps > MOST_INTERVALS * _interval(gnss))] = np.nan
    velocity_n = np.full_like(gnss.velocity_n, np.nan)
    velocity_n[rows[1:]] = mean
    return replace(gnss, velocity_n=velocity_n)


def delay(gnss: GnssEpochs, time_s: float) -> float:
    """By how much velocities made by :func:`unsmoothed` are later than their receiver's, s."""
    return _delay(time_s, _interval(gnss))


def _delay(time_s: float, interval: float) -> float:
    kept = float(np.exp(-interval / time_s))
    return time_s - interval * kept / (1.0 - kept)


def _interval(gnss: GnssEpochs) -> float:
    """Usual time between velocities, s."""
    return float(median(np.diff(gnss.time_ns[gnss.has_velocity]) / SECOND))


def _level(velocity_n: FloatArray) -> ComplexArray:
    """Horizontal velocities as complex numbers."""
    return np.asarray(velocity_n[:, 0] + 1j * velocity_n[:, 1])


def _least_square(
    at: FloatArray,
    shown: ComplexArray,
    even: FloatArray,
    known: ComplexArray,
    near: BoolArray,
    apart: int,
) -> float:
    """By what changes over some fixes differ from known ones, at the best delay, (m/s)^2."""

    def square(late: float) -> float:
        beside = shown - np.interp(at - late, even, known)
        off = (beside[apart:] - beside[:-apart])[near]
        squares = off.real**2 + off.imag**2
        return float(np.minimum(squares, FAR * median(squares)).mean())

    def least(delays: FloatArray) -> tuple[float, float]:
        return min((square(late), late) for late in delays.tolist())

    _, rough = least(DELAYS)
    return least(rough + NEARER)[0]
