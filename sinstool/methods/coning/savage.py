"""Savage's two-speed coning algorithm: a fast recursion inside each update.

References
----------
.. [1] P. G. Savage, "Strapdown inertial navigation integration algorithm design part 1:
   attitude algorithms", J. Guidance, Control, and Dynamics 21(1), 1998, 19-28.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from sinstool.core.errors import ConfigurationError
from sinstool.methods.coning.algorithm import ConingAlgorithm

FloatArray = NDArray[np.float64]


class SavageTwoSpeed(ConingAlgorithm):
    """Coning integral by recursion over the samples of an update, rate linear in each.

    Parameters
    ----------
    samples : int
        Increments per update.
    name : str, optional
        By default ``savage-two-speed-N``.
    """

    def __init__(self, samples: int, name: str = "") -> None:
        self.name = name or f"savage-two-speed-{samples}"
        self.summary = f"{samples} samples per update, summed at the sample rate"
        self.source = "Savage 1998 (part 1), coning integral by recursion"
        self.samples = samples
        self.before = 1

    def _fill(self, x: FloatArray, dt: FloatArray, first: int, out: FloatArray) -> None:
        _two_speed_kernel(x, first, self.samples, out)

    def _of_samples(self, samples: int) -> ConingAlgorithm:
        return SavageTwoSpeed(samples)


def two_speed(samples: int | None = None) -> SavageTwoSpeed:
    """Build ``savage-two-speed`` (4 samples per update) or ``savage-two-speed-N``.

    Parameters
    ----------
    samples : int, optional
        N.

    Returns
    -------
    SavageTwoSpeed
        The algorithm.

    Raises
    ------
    ConfigurationError
        If N is 0.
    """
    if samples is None:
        return SavageTwoSpeed(4, "savage-two-speed")
    if samples < 1:
        raise ConfigurationError(
            "savage-two-speed-0 has no samples per update", "N in savage-two-speed-N is 1 or more"
        )
    return SavageTwoSpeed(samples)


@numba.njit(cache=True, nogil=True)
def _two_speed_kernel(x: FloatArray, first: int, samples: int, out: FloatArray) -> None:
    for update in range(out.shape[0]):
        start = first + update * samples
        if start > 0:
            px = x[start - 1, 0]
            py = x[start - 1, 1]
            pz = x[start - 1, 2]
        elif samples > 1:
            # No earlier sample: where the algorithm would put a straight line through two
            # increments, that through the next two gives the one before.
            px = 2.0 * x[start, 0] - x[start + 1, 0]
            py = 2.0 * x[start, 1] - x[start + 1, 1]
            pz = 2.0 * x[start, 2] - x[start + 1, 2]
        else:
            px = 0.0
            py = 0.0
            pz = 0.0
        ax = 0.0
        ay = 0.0
        az = 0.0
        bx = 0.0
        by = 0.0
        bz = 0.0
        for row in range(start, start + samples):
            tx = x[row, 0]
            ty = x[row, 1]
            tz = x[row, 2]
            ux = ax + px / 6.0
            uy = ay + py / 6.0
            uz = az + pz / 6.0
            bx += 0.5 * (uy * tz - uz * ty)
            by += 0.5 * (uz * tx - ux * tz)
            bz += 0.5 * (ux * ty - uy * tx)
            ax += tx
            ay += ty
            az += tz
            px = tx
            py = ty
            pz = tz
        out[update, 0] = ax + bx
        out[update, 1] = ay + by
        out[update, 2] = az + bz
