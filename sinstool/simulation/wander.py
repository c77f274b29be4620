"""First-order recursion: what is left of the value before, and something new."""

from __future__ import annotations

import numba

from sinstool.simulation.truth import FloatArray


# scipy.signal.lfilter does the same, but takes longer to import than most logs to simulate.
@numba.njit(cache=True, nogil=True)
def carry_over(decay: FloatArray, driven: FloatArray) -> None:
    """Turn what drives first-order processes into the processes, ``x[k] = decay[k] x[k-1] + w[k]``.

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
