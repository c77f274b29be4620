"""Attitude from rotation vectors, and from ordered samples.

References
----------
.. [1] P. G. Savage, "Strapdown inertial navigation integration algorithm design part 1:
   attitude algorithms", J. Guidance, Control, and Dynamics 21(1), 1998, 19-28.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial

import numpy as np

from sinstool.core.arrays import ArrayLike, FloatArray
from sinstool.core.parts import kernel, part
from sinstool.core.quaternion_kernels import product, row, to_unit
from sinstool.core.rotation import normalise
from sinstool.core.streams import Imu, Solution
from sinstool.methods.coning.stage import RotationVectors
from sinstool.methods.strapdown.segment_samples import SampleSettings, SegmentRun

# cos(h) and sin(h)/h in powers of h**2; named, as a compiled loop wants them.
_C2, _C3, _C4, _C5, _C6, _C7, _C8 = ((-1) ** k / factorial(2 * k) for k in range(2, 9))
_S1, _S2, _S3, _S4, _S5, _S6, _S7, _S8 = ((-1) ** k / factorial(2 * k + 1) for k in range(1, 9))


class AttitudePropagator:
    """State of the attitude of a body against navigation axes.

    Every update is ``q_nb <- exp(-omega_in_n dt) q_nb exp(phi)``, exact for the rotation
    vector ``phi`` of the body against inertial space and navigation axes that turn at a
    constant rate; eqs. 4 and 5 of [1]_ of the module in quaternions.

    Parameters
    ----------
    q_nb : array_like, shape (4,)
        Attitude at the start; normalised here.
    omega_in_n : array_like, shape (3,), optional
        Angular rate of ``n`` against inertial space in ``n``, rad/s: the Earth rate
        :func:`sinstool.core.earth.earth_rate_n` for a vehicle that stays near one latitude.
        By default ``n`` does not rotate.

    Attributes
    ----------
    q_nb : ndarray, shape (4,)
        Attitude after the updates so far. It is the only state carried from block to block, and
        results are the same, bit for bit, wherever blocks end.

    Raises
    ------
    ValueError
        If a shape is wrong or the quaternion is zero.
    """

    def __init__(self, q_nb: ArrayLike, omega_in_n: ArrayLike | None = None) -> None:
        self.q_nb = normalise(q_nb)
        if self.q_nb.shape != (4,):
            raise ValueError(f"Expected `q_nb` to have shape (4,), got {self.q_nb.shape}.")
        rate = np.zeros(3) if omega_in_n is None else np.array(omega_in_n, dtype=np.float64)
        if rate.shape != (3,):
            raise ValueError(f"Expected `omega_in_n` to have shape (3,), got {rate.shape}.")
        self._omega_in_n = rate

    def push(self, rotation_vector: ArrayLike, interval: ArrayLike) -> FloatArray:
        """Propagate over the next updates.

        Parameters
        ----------
        rotation_vector : array_like, shape (n, 3)
            Of the body over each update against inertial space, in ``b``, rad.
        interval : array_like, shape (n,)
            Duration of each update, s.

        Returns
        -------
        ndarray, shape (n, 4)
            ``q_nb`` at the end of each update, of unit length to 1e-15.

        Raises
        ------
        ValueError
            If shapes do not fit.
        """
        phi = np.ascontiguousarray(rotation_vector, dtype=np.float64)
        dt = np.ascontiguousarray(interval, dtype=np.float64)
        if phi.ndim != 2 or phi.shape[1] != 3 or dt.shape != phi.shape[:1]:
            raise ValueError(f"Expected shapes (n, 3) and (n,), got {phi.shape} and {dt.shape}.")
        out = np.empty((len(phi), 4))
        if len(phi):
            rotating = bool(np.any(self._omega_in_n))
            _propagate_kernel(self.q_nb, phi, dt, self._omega_in_n, rotating, out)
            self.q_nb = out[-1].copy()
        return out


@dataclass(frozen=True, kw_only=True)
class AttitudeSettings(SampleSettings):
    """Settings of an attitude run.

    Attributes
    ----------
    omega_ie_n : ndarray, shape (3,) or None
        Earth rate to remove, rad/s in NED.
    """

    omega_ie_n: np.ndarray | None = None


class AttitudeRun(SegmentRun):
    """Attitude from ordered samples: the streaming heart of `process --mode attitude`.

    Parameters
    ----------
    q_nb : ndarray, shape (4,)
        Attitude at the first sample.

    Attributes
    ----------
    missed_rotation : float
        Angle by which the vehicle turned during gaps if it kept the mean rate of both sides, rad.
    """

    def __init__(self, q_nb: np.ndarray, settings: AttitudeSettings) -> None:
        super().__init__(settings)
        self.missed_rotation = 0.0
        self._propagator = AttitudePropagator(q_nb, settings.omega_ie_n)
        self._last_rate = np.zeros(3)

    def _begin(self, imu: Imu, gap_s: float) -> Solution:
        """The first sample has the attitude the last segment ended with."""
        if gap_s > 0.0:
            mean = 0.5 * (self._last_rate + imu.gyro[0])
            self.missed_rotation += float(np.linalg.norm(mean)) * gap_s
        self._stage = self.settings.stage()
        return _solution(imu.rows(slice(0, 1)), self._propagator.q_nb[None, :])

    def _push(self, imu: Imu, times: np.ndarray) -> RotationVectors:
        self._last_rate = imu.gyro[-1]
        return self._stage.push(imu.gyro, times)

    def _advance(self, updates: RotationVectors, taken: Imu) -> Solution:
        q = np.empty((len(updates.sample), 4))
        until = self.settings.still_until_ns
        still = 0 if until is None else int(np.searchsorted(updates.time_ns, until, "right"))
        q[:still] = self._propagator.q_nb
        q[still:] = self._propagator.push(updates.rotation_vector[still:], updates.interval[still:])
        return _solution(taken, q)


def _solution(imu: Imu, q_nb: np.ndarray) -> Solution:
    return Solution(imu.time_ns, imu.log_time_ns, q_nb, imu.gyro, imu.accel)


@part()
def _half_angle_terms(square: float) -> tuple[float, float]:
    """Return cos(a/2) and sin(a/2)/a of a squared angle a, rad^2."""
    if square < 1.0:
        # Taylor in the squared half angle (< 0.25): what follows is below 1e-20.
        u = 0.25 * square
        c = ((((_C8 * u + _C7) * u + _C6) * u + _C5) * u + _C4) * u + _C3
        c = ((c * u + _C2) * u - 0.5) * u + 1.0
        s = ((((_S8 * u + _S7) * u + _S6) * u + _S5) * u + _S4) * u + _S3
        s = ((s * u + _S2) * u + _S1) * u + 1.0
        return c, 0.5 * s
    angle = np.sqrt(square)
    return np.cos(0.5 * angle), np.sin(0.5 * angle) / angle


@kernel()
def _propagate_kernel(
    q_start: FloatArray,
    phi: FloatArray,
    dt: FloatArray,
    omega: FloatArray,
    rotating: bool,
    out: FloatArray,
) -> None:
    w, x, y, z = q_start[0], q_start[1], q_start[2], q_start[3]
    ox, oy, oz = omega[0], omega[1], omega[2]
    computed = -1.0  # the interval that exp(-omega_in_n dt) belongs to: most are equal
    ec, ex, ey, ez = 1.0, 0.0, 0.0, 0.0
    for k in range(out.shape[0]):
        px, py, pz = row(phi, k)
        c, s = _half_angle_terms(px * px + py * py + pz * pz)
        w, x, y, z = product(w, x, y, z, c, px * s, py * s, pz * s)
        if rotating:
            t = dt[k]
            if t != computed:
                ec, s = _half_angle_terms((ox * ox + oy * oy + oz * oz) * (t * t))
                ex = -ox * t * s
                ey = -oy * t * s
                ez = -oz * t * s
                computed = t
            w, x, y, z = product(ec, ex, ey, ez, w, x, y, z)
        w, x, y, z = to_unit(w, x, y, z)
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = w, x, y, z
