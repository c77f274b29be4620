"""Means and covariances of Allan variances and of block means under each noise term.

All is in samples: time counts in sampling intervals, rates are as sampled, and phases are sums of
samples. A term has the generalised covariance K(t) of its phase (Matheron 1973, The intrinsic
random functions, gives the idea), of which the covariance of any two second differences is a
weighted sum. For a variance p of a term, per IEEE Std 952-1997, annex C:

==============  =======================  ==============================
term            Allan variance at m      K(t) of the phase
==============  =======================  ==============================
quantisation    3 p / m^2                p where t = 0, else 0
white           p / m                    -p |t| / 2
flicker         (2 ln 2 / pi) p          p t^2 ln|t| / (2 pi)
random walk     p m / 3                  p |t|^3 / 12
==============  =======================  ==============================

A ramp of rate r a sample adds r^2 m^2 / 2, and a mean to second differences.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from math import log, pi, sqrt

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray

TERMS = ("quantisation", "white", "flicker", "random_walk")
FLICKER = 2.0 * log(2.0) / pi
# Covariances of differences of phases are computed up to this many of the longer lag beyond where
# they overlap. Only those of flicker noise are correlated there, as the inverse square of the
# distance.
BEYOND = 2
# Two lags are compared at this many places of the shorter.
PLACES = 8
_SECOND = (1.0, -2.0, 1.0)
# From this lag on, samples, the series for flicker noise is exact to rounding.
FAR = 60
# Blocks that the samples of all segments make up, at most; the longest has at least so many.
BLOCKS, LEAST_BLOCKS = 512, 8


def block_length(lengths: Sequence[int]) -> int:
    """Samples of a block, a power of two, for segments of these lengths."""
    block = 1
    while sum(lengths) > BLOCKS * block and max(lengths) >= 2 * LEAST_BLOCKS * block:
        block *= 2
    return block


def allan_terms(lags: IntArray) -> FloatArray:
    """Allan variance of each term of variance 1, shape (k, 4)."""
    m = np.asarray(lags, np.float64)
    return np.stack([3.0 / m**2, 1.0 / m, np.full(len(m), FLICKER), m / 3.0], axis=1)


def covariance_of_phase(t: FloatArray, spike: float = 1.0) -> FloatArray:
    """Generalised covariances of the terms, shape (4, ...).

    Parameters
    ----------
    spike : float, optional
        What quantisation has at zero.
    """
    size = np.abs(t)
    logarithm = np.log(np.where(size > 0.0, size, 1.0))
    return np.stack(
        [
            np.where(size == 0.0, spike, 0.0),
            -0.5 * size,
            size**2 * logarithm / (2.0 * pi),
            size**3 / 12.0,
        ]
    )


def covariance_of_variances(lags: IntArray, lengths: Sequence[int]) -> FloatArray:
    """Covariances of overlapping Allan variances, pooled over segments.

    Of Gaussian noise the covariance of two squares is twice the square of their covariance, so
    that of two Allan variances is quadratic in the variances p of the terms: p G p.

    Parameters
    ----------
    lags : ndarray of int64, shape (k,)
        Powers of two.
    lengths : sequence of int
        Samples of each segment.

    Returns
    -------
    ndarray, shape (k, k, 4, 4)
        G.
    """
    count = len(lags)
    covariance = np.zeros((count, count, 4, 4))
    alike = Counter(lengths)
    terms = [sum(n * max(s - 2 * m + 1, 0) for s, n in alike.items()) for m in lags.tolist()]
    for i, a in enumerate(lags.tolist()):
        for j, b in enumerate(lags.tolist()[: i + 1]):
            step = max(1, b // PLACES)
            low, high = -(2 * a) - BEYOND * a, 2 * b + BEYOND * a
            apart = np.arange(low // step, high // step + 1) * step
            # d_b starts `apart` after... phases at u of d_a and at apart + v of d_b
            both = np.zeros((4, len(apart)))
            for u, first in zip((0, a, 2 * a), _SECOND, strict=True):
                for v, second in zip((0, b, 2 * b), _SECOND, strict=True):
                    t = (u + apart - v).astype(np.float64)
                    both += first * second * covariance_of_phase(t, step**-0.5)
            weight = np.zeros(len(apart))
            for length, n in alike.items():
                from_a, from_b = length - 2 * a + 1, length - 2 * b + 1
                if from_a > 0 and from_b > 0:
                    # starts of d_a less those of d_b are `apart`
                    end = np.minimum(from_a, from_b + apart)
                    weight += n * np.maximum(end - np.maximum(apart, 0), 0)
            scale = 2.0 * step / (4.0 * float(a) ** 2 * float(b) ** 2 * terms[i] * terms[j])
            covariance[i, j] = scale * np.einsum("kt,lt,t->kl", both, both, weight)
            covariance[j, i] = covariance[i, j]
    return covariance


@dataclass(frozen=True)
class BlockModel:
    """Second differences of phases that are a block apart, in a basis that parts them.

    The sine transform makes those of white noise and of a random walk independent, which have
    tridiagonal covariances, and those of the other terms nearly so.

    Attributes
    ----------
    variance : ndarray, shape (n, 4)
        Of each coefficient by term of variance 1.
    ramp : ndarray, shape (n,)
        Mean of each coefficient for a ramp of 1.
    """

    variance: FloatArray
    ramp: FloatArray


def sine_transform(differences: FloatArray) -> FloatArray:
    """Orthonormal sine transform (DST-I) of columns, shape (n, c)."""
    count, columns = differences.shape
    # Odd about both ends it is the imaginary part of a Fourier transform
    odd = np.zeros((2 * count + 2, columns))
    odd[1 : count + 1] = differences
    odd[count + 2 :] = -differences[::-1]
    transform = np.fft.rfft(odd, axis=0).imag[1 : count + 1]
    return np.asarray(-transform / sqrt(2.0 * (count + 1)))


def second_differences(count: int) -> FloatArray:
    """Covariances of second differences of phases one sample apart by distance, shape (4, n).

    The fourth differences of K; that of flicker noise by its series where its parts would cancel.
    """
    covariance = np.zeros((4, max(count, 3)))
    covariance[0, :3] = 6.0, -4.0, 1.0
    covariance[1, :2] = 2.0, -1.0
    covariance[3, :2] = 2.0 / 3.0, 1.0 / 6.0
    near = np.arange(min(count, FAR), dtype=np.float64)
    for shift, weight in zip((-2, -1, 0, 1, 2), (1.0, -4.0, 6.0, -4.0, 1.0), strict=True):
        covariance[2, : len(near)] += weight * covariance_of_phase(near + shift)[2]
    far = np.arange(FAR, count, dtype=np.float64) ** -2.0
    covariance[2, FAR:count] = -(far + far**2 + 1.5 * far**3) / pi
    return covariance[:, :count]


def block_model(count: int, block: int) -> BlockModel:
    """Covariances, under each term, of second differences of phases that are `block` apart."""
    distance = np.arange(count, dtype=np.float64)
    covariance = second_differences(count) * float(block) ** np.arange(4)[:, None]
    # The diagonal of S C S, of a Toeplitz C: each distance by the product of two sines so far apart
    omega = np.pi * np.arange(1, count + 1)[:, None] / (count + 1)
    product = (count - distance) * np.cos(omega * distance)
    product += np.sin(omega * (distance + 1)) / np.sin(omega)
    product *= np.where(distance > 0, 2.0, 1.0) / (count + 1)
    variance = product @ covariance.T
    ramp = sine_transform(np.full((count, 1), float(block) ** 2))[:, 0]
    return BlockModel(np.maximum(variance, 0.0), ramp)
