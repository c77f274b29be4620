"""Content that a slower log would alias to slow motion: noise and lines.

Sampled at fs', content near a multiple of fs' becomes a slowly varying rate that no algorithm can
tell from motion. The log at hand shows it up to half its own rate; above that it shows nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage, signal

from sinstool.core.arrays import FloatArray

WELCH_S = 10.0
LINE_DB = 10.0
LINE_SHARE = 0.02
# Lines that turn the body by less than this in a window are rounding, or might as well be, rad
LEAST_LINE = 1e-8


@dataclass(frozen=True)
class RateSpectrum:
    """Power of the angular rate, all axes together.

    Attributes
    ----------
    frequency : ndarray, shape (m,)
        Hz, up to half the log's rate.
    density : ndarray, shape (m,)
        One-sided, (rad/s)^2/Hz.
    """

    frequency: FloatArray
    density: FloatArray


@dataclass(frozen=True)
class Alias:
    """Noise and lines that a lower rate would alias to slow motion.

    Attributes
    ----------
    input : {'sums', 'points'}
        How samples are thinned.
    rate_hz : float
        The lower rate.
    dc_alias_deg : float
        Root mean square of the angle that noise about multiples of the lower rate builds up in a
        window.
    lines_hz : tuple of float
        Frequencies of lines that fold to slow motion: within 2 % of the lower rate of one of its
        multiples, and strong enough to matter after the thinning.
    """

    decimate: int
    input: str
    rate_hz: float
    dc_alias_deg: float
    lines_hz: tuple[float, ...]


@dataclass(frozen=True)
class Exposure(Alias):
    """Aliasing at a lower rate, with its folded spectrum.

    Attributes
    ----------
    folded : ndarray, shape (k,)
        Density folded onto [0, rate_hz / 2], (rad/s)^2/Hz, at `frequency`.
    frequency : ndarray, shape (k,)
        Hz.
    """

    folded: FloatArray
    frequency: FloatArray


def rate_spectrum(
    segments: Sequence[FloatArray], interval_s: float, window_s: float = WELCH_S
) -> RateSpectrum | None:
    """Welch spectrum of the rate, averaged over segments by their length.

    Parameters
    ----------
    segments : sequence of ndarray, shape (n, 3)
        Rates, rad/s.
    window_s : float, optional
        Window over which angles will be judged: pieces are at least as long, so that what is
        constant within a window has a bin of its own.

    Returns
    -------
    RateSpectrum or None
        None where no segment holds 64 samples.
    """
    rate = 1.0 / interval_s
    samples = round(max(WELCH_S, window_s) * rate)
    length = min(samples, max((len(s) for s in segments), default=0))
    if length < 64:
        return None
    total, weight = np.zeros(length // 2 + 1), 0.0
    frequency = np.fft.rfftfreq(length, interval_s)
    for gyro in segments:
        if len(gyro) < length:
            continue
        _, density = signal.welch(gyro, rate, "hann", length, length // 2, axis=0)
        total += density.sum(axis=1) * len(gyro)
        weight += len(gyro)
    return RateSpectrum(np.asarray(frequency, dtype=np.float64), total / weight)


def lines(spectrum: RateSpectrum) -> FloatArray:
    """Frequencies of narrow peaks, 10 dB above the median of their surroundings, Hz."""
    density = np.maximum(spectrum.density, np.finfo(float).tiny)
    level = 10.0 * np.log10(density)
    width = max(11, len(level) // 50 | 1)
    floor = ndimage.median_filter(level, width, mode="nearest")
    peaks, _ = signal.find_peaks(level - floor, height=LINE_DB)
    return np.asarray(spectrum.frequency[peaks], dtype=np.float64)


def exposure(
    spectrum: RateSpectrum, native_rate: float, decimate: int, thinning: str, window_s: float
) -> Exposure:
    """Aliasing if the log had been recorded at a lower rate.

    Parameters
    ----------
    spectrum : RateSpectrum
        Of the log as it is.
    native_rate : float
        Hz.
    decimate : int
        At least 2.
    thinning : {'sums', 'points'}
        Sums weaken content at f by sinc^2(f / rate) before it folds.
    """
    f, s = spectrum.frequency, spectrum.density.copy()
    if 2.0 * f[-1] > native_rate * (1.0 - 1e-9):
        # A one-sided spectrum has half the density at half the rate itself.
        s[-1] *= 2.0
    rate = native_rate / decimate
    if thinning == "sums":
        # A sum of m samples, over m: Dirichlet's kernel.
        ratio = np.where(
            np.abs(np.sin(np.pi * f / native_rate)) > 1e-9,
            np.sin(np.pi * f / rate)
            / (decimate * np.where(f > 0, np.sin(np.pi * f / native_rate), 1.0)),
            1.0,
        )
        s = s * ratio**2
    at = f[f <= 0.5 * rate]
    folded = np.zeros(len(at))
    for k in range(decimate // 2 + 1):
        for sign in (1.0, -1.0):
            image = k * rate + sign * at
            # Slow motion itself is there once, and so is half the log's own rate.
            if (k == 0 and sign < 0) or (2 * k == decimate and sign > 0):
                continue
            inside = (image >= 0) & (image <= f[-1])
            folded += np.where(inside, np.interp(image, f, s), 0.0)
    half = max(0.5 / window_s, 0.5 * (f[1] - f[0]))
    power = 0.0
    candidates = lines(spectrum)
    turned = window_s * np.sqrt(np.interp(candidates, f, s) * (f[1] - f[0]))
    visible = candidates[turned > LEAST_LINE].tolist()
    near: list[float] = []
    for k in range(1, decimate // 2 + 1):
        centre = k * rate
        band = np.abs(f - centre) <= half
        # At least the bin that holds the multiple, over the band's own width.
        level = s[band].mean() if band.any() else float(np.interp(centre, f, s))
        # At half the log's own rate the band has one side only.
        power += level * half * (1.0 if 2 * k == decimate else 2.0)
        near += [x for x in visible if abs(x - centre) <= LINE_SHARE * rate]
    angle = float(np.degrees(window_s * float(np.sqrt(power))))
    return Exposure(decimate, thinning, rate, angle, tuple(near), folded, at)
