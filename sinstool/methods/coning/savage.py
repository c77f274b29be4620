"""Savage's two-speed coning algorithm: a fast recursion inside each update.

References
----------
.. [1] P. G. Savage, "Strapdown inertial navigation integration algorithm design part 1:
   attitude algorithms", J. Guidance, Control, and Dynamics 21(1), 1998, 19-28.
"""

from __future__ import annotations

from sinstool.core.arrays import FloatArray
from sinstool.core.errors import ConfigurationError
from sinstool.core.parts import njit
from sinstool.core.quaternion_kernels import cross, put, row
from sinstool.methods.coning.algorithm import ConingAlgorithm, MultiSampleAlgorithm


class SavageTwoSpeed(MultiSampleAlgorithm):
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


@njit(cache=True, nogil=True)
def _two_speed_kernel(x: FloatArray, first: int, samples: int, out: FloatArray) -> None:
    for update in range(out.shape[0]):
        start = first + update * samples
        if start > 0:
            px, py, pz = row(x, start - 1)
        elif samples > 1:
            # No earlier sample: where the algorithm would put a straight line through two
            # increments, that through the next two gives the one before.
            tx, ty, tz = row(x, start)
            ux, uy, uz = row(x, start + 1)
            px, py, pz = 2.0 * tx - ux, 2.0 * ty - uy, 2.0 * tz - uz
        else:
            px = py = pz = 0.0
        ax = ay = az = bx = by = bz = 0.0
        for k in range(start, start + samples):
            tx, ty, tz = row(x, k)
            cx, cy, cz = cross(ax + px / 6.0, ay + py / 6.0, az + pz / 6.0, tx, ty, tz)
            bx += 0.5 * cx
            by += 0.5 * cy
            bz += 0.5 * cz
            ax += tx
            ay += ty
            az += tz
            px, py, pz = tx, ty, tz
        put(out, update, ax + bx, ay + by, az + bz)
