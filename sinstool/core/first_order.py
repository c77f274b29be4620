"""Recursions of first order."""

from __future__ import annotations

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import kernel


@kernel()
def carry_over(decay: FloatArray, driven: FloatArray) -> None:
    """First-order processes from their driving noise, ``x[k] = decay[k] x[k-1] + w[k]``.

    `scipy.signal.lfilter` does the same, but takes longer to import than most logs to process.

    Parameters
    ----------
    decay : ndarray, shape (n,)
        The first is not used.
    driven : ndarray, shape (n, columns)
        `w`; `x` afterwards.
    """
    for k in range(1, driven.shape[0]):
        for i in range(driven.shape[1]):
            driven[k, i] += decay[k] * driven[k - 1, i]
