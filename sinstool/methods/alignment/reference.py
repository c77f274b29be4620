"""The GNSS side: what velocity and position say about the integrated specific force.

And the attitude at any time of a segment, once ``C_ib0^i`` is known; eq. (1) of Qu et al.

``i`` is the Earth frame ECEF frozen at the origin of time. The specific force integrated in
``i`` follows from velocity, the Earth's rate and gravity alone; no transport rate is needed,
and no pole and no date line is special.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sinstool.core import earth
from sinstool.core.rotation import exp, from_dcm, to_dcm
from sinstool.methods.alignment.accumulation import InertialRows, accumulate
from sinstool.methods.alignment.inflight_types import GnssFixes, ImuIncrements
from sinstool.methods.alignment.refine import theta_at

FloatArray = NDArray[np.float64]


def to_inertial(vectors_e: FloatArray, time_s: FloatArray) -> FloatArray:
    """Vectors of ECEF in ``i``: ``C_e^i(t) = R_z(omega_ie t)``, eq. (2) of Qu et al.

    Parameters
    ----------
    vectors_e : ndarray, shape (n, 3)
    time_s : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n, 3)
    """
    c, s = np.cos(earth.EARTH_RATE * time_s), np.sin(earth.EARTH_RATE * time_s)
    x, y = vectors_e[..., 0], vectors_e[..., 1]
    return np.stack([c * x - s * y, s * x + c * y, vectors_e[..., 2]], axis=-1)


def dcm_ni(latitude: FloatArray, longitude: FloatArray, time_s: FloatArray) -> FloatArray:
    """Inertial to NED, ``C_i^n(t) = C_e^n C_i^e(t)``; eq. (1) of Qu et al.

    Parameters
    ----------
    latitude, longitude, time_s : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n, 3, 3)
    """
    return earth.dcm_ne(latitude, np.asarray(longitude) + earth.EARTH_RATE * np.asarray(time_s))


def velocity_reference(
    time_s: FloatArray,
    latitude: FloatArray,
    longitude: FloatArray,
    height: FloatArray,
    velocity_n: FloatArray,
) -> FloatArray:
    """Specific force integrated from the first fix, in ``i``.

    ``d/dt (C_e^i v^e) = C_b^i f + C_e^i (g^e - omega_ie x v^e)``, integrated by the trapezoid
    rule between fixes; eq. (4) of Qu et al. in its integrated form.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Since the origin, increasing.
    latitude, longitude, height : ndarray, shape (n,)
    velocity_n : ndarray, shape (n, 3)
        Without gaps: leave out fixes that have none.

    Returns
    -------
    ndarray, shape (n, 3)
        m/s; zero at the very first fix.
    """
    c_en = np.swapaxes(earth.dcm_ne(latitude, longitude), -1, -2)
    velocity_e = np.einsum("nij,nj->ni", c_en, velocity_n)
    gravity_e = np.einsum("nij,nj->ni", c_en, earth.gravity_n(latitude, height))
    coriolis = np.stack(
        [-earth.EARTH_RATE * velocity_e[:, 1], earth.EARTH_RATE * velocity_e[:, 0], 0.0 * time_s],
        axis=-1,
    )
    velocity_i = to_inertial(velocity_e, time_s)
    integrand = to_inertial(coriolis - gravity_e, time_s)
    before = np.concatenate([integrand[:1], integrand[:-1]])
    step = np.diff(time_s, prepend=time_s[:1])
    integral = np.cumsum(0.5 * step[:, None] * (before + integrand), axis=0)
    return np.asarray(velocity_i - velocity_i[:1] + integral)


def acceleration_reference(
    time_s: FloatArray,
    latitude: FloatArray,
    longitude: FloatArray,
    height: FloatArray,
    velocity_n: FloatArray,
    central: bool,
) -> tuple[FloatArray, NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Specific force at fixes, from differentiated velocity, in ``i``; eq. (4) of Qu et al.

    Parameters
    ----------
    time_s, latitude, longitude, height, velocity_n
        As for :func:`velocity_reference`.
    central : bool
        Difference of the neighbours on both sides, else of the fix and the one before.

    Returns
    -------
    force_i : ndarray, shape (n, 3)
        m/s^2.
    at, newer, older : ndarray of int64, shape (n,)
        Fix at which it stands, and the two whose velocities were differenced.
    """
    count = len(time_s)
    span = 2 if central else 1
    newer = np.arange(span, count)
    older = newer - span
    at = newer - 1 if central else newer
    step = time_s[newer] - time_s[older]
    usual = np.median(np.diff(time_s)) if count > 1 else 0.0
    close = step <= 1.5 * span * usual  # a difference over a gap is no derivative
    at, newer, older, step = at[close], newer[close], older[close], step[close]
    rate = (velocity_n[newer] - velocity_n[older]) / step[:, None]
    lat, h, v = latitude[at], height[at], velocity_n[at]
    turning = 2.0 * earth.earth_rate_n(lat) + earth.transport_rate_n(lat, h, v)
    force_n = rate + np.cross(turning, v) - earth.gravity_n(lat, h)
    c_in = np.swapaxes(dcm_ni(lat, longitude[at], time_s[at]), -1, -2)
    return np.einsum("nij,nj->ni", c_in, force_n), at, newer, older


def position_reference(
    time_s: FloatArray, latitude: FloatArray, longitude: FloatArray, height: FloatArray
) -> FloatArray:
    """Specific force integrated twice from positions alone, in ``i``.

    ``r_i(t) - r_i(0)`` less the double integral of gravitation; what start position and start
    velocity add is a constant and a slope, which the caller takes out.

    Parameters
    ----------
    time_s, latitude, longitude, height : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n, 3)
        m.
    """
    r_e = earth.ecef(latitude, longitude, height)
    c_en = np.swapaxes(earth.dcm_ne(latitude, longitude), -1, -2)
    gravitation_e = np.einsum("nij,nj->ni", c_en, earth.gravity_n(latitude, height))
    gravitation_e[:, :2] -= earth.EARTH_RATE**2 * r_e[:, :2]  # gravity less its centrifugal part
    r_i = to_inertial(r_e, time_s)
    gravitation = to_inertial(gravitation_e, time_s)
    step = np.diff(time_s)[:, None]
    once = np.zeros_like(r_i)
    np.cumsum(0.5 * step * (gravitation[1:] + gravitation[:-1]), axis=0, out=once[1:])
    twice = np.zeros_like(r_i)
    # Exact where gravitation is linear between fixes.
    inner = step * once[:-1] + step**2 * (gravitation[:-1] / 3.0 + gravitation[1:] / 6.0)
    np.cumsum(inner, axis=0, out=twice[1:])
    return np.asarray(r_i - r_i[0] - twice)


def position_between(fixes: GnssFixes, time_ns: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """Latitude and longitude between fixes, and a little beyond them.

    Parameters
    ----------
    time_ns : ndarray of int64, shape (n,)

    Returns
    -------
    latitude, longitude : ndarray, shape (n,)
        rad.

    Notes
    -----
    Interpolates the normal of the ellipsoid, which knows no date line and no pole. Beyond the
    ends it goes on as over the outermost second, for a second; then it stays.
    """
    cl = np.cos(fixes.latitude)
    normal = np.stack(
        [cl * np.cos(fixes.longitude), cl * np.sin(fixes.longitude), np.sin(fixes.latitude)]
    )
    origin = fixes.time_ns[0]
    x = (time_ns - origin) * 1e-9
    fix_s = (fixes.time_ns - origin) * 1e-9
    if len(fix_s) > 1:
        near = min(int(np.searchsorted(fix_s, 1.0)), len(fix_s) - 1)
        far = max(int(np.searchsorted(fix_s, fix_s[-1] - 1.0, side="right")) - 1, 0)
        before = 2.0 * normal[:, :1] - normal[:, near : near + 1]
        after = 2.0 * normal[:, -1:] - normal[:, far : far + 1]
        normal = np.concatenate([before, normal, after], axis=1)
        fix_s = np.concatenate([[-fix_s[near]], fix_s, [2.0 * fix_s[-1] - fix_s[far]]])
    n0, n1, n2 = (np.interp(x, fix_s, part) for part in normal)
    return np.arctan2(n2, np.hypot(n0, n1)), np.arctan2(n1, n0)


@dataclass(frozen=True)
class AttitudeChain:
    """All that carries an attitude through its stretch of the log.

    Attributes
    ----------
    origin_ns : int
        At which ``i`` is frozen.
    dcm : ndarray, shape (3, 3)
        ``C_ib0^i``.
    fixes : GnssFixes
        All of the stretch.
    refined : tuple of (ndarray, InertialRows) or None
        State of the refinement and the one row at which it holds.
    """

    imu: ImuIncrements
    origin_ns: int
    dcm: FloatArray
    fixes: GnssFixes
    refined: tuple[FloatArray, InertialRows] | None = None

    def rows_at(self, time_ns: ArrayLike) -> InertialRows:
        """Inertial side at increasing times.

        Raises
        ------
        ValueError
            If a time lies outside the stretch.
        """
        times = np.atleast_1d(np.asarray(time_ns, dtype=np.int64))
        inside = (times >= self.imu.time_ns[0]) & (times <= self.imu.time_ns[-1])
        if not inside.all():
            raise ValueError(
                "Expected times within the samples of the segment,"
                f" {self.imu.time_ns[0]} to {self.imu.time_ns[-1]} ns."
            )
        imu = self.imu
        return accumulate(imu.time_ns, imu.delta_theta, imu.delta_velocity, times, self.origin_ns)

    def attitude(self, time_ns: ArrayLike) -> FloatArray:
        """Attitude at any times of the stretch.

        Parameters
        ----------
        time_ns : array_like of int64, shape (n,)
            In any order.

        Returns
        -------
        ndarray, shape (n, 4)
            q_nb with ``w >= 0``.

        Raises
        ------
        ValueError
            If a time lies outside the stretch.
        """
        times = np.atleast_1d(np.asarray(time_ns, dtype=np.int64))
        order = np.argsort(times, kind="stable")
        rows = self.rows_at(times[order])
        q = np.empty((len(times), 4))
        q[order] = from_dcm(self.dcm_ni(times[order]) @ self.dcm_ib(rows))
        return q

    def dcm_ni(self, time_ns: NDArray[np.int64]) -> FloatArray:
        """``C_i^n`` at given times."""
        latitude, longitude = position_between(self.fixes, time_ns)
        return dcm_ni(
            latitude, longitude, np.asarray((time_ns - self.origin_ns) * 1e-9, dtype=np.float64)
        )

    def dcm_ib(self, rows: InertialRows) -> FloatArray:
        """``C_b^i`` at given rows."""
        chain = to_dcm(rows.q)
        if self.refined is not None:
            state, reference = self.refined
            chain = to_dcm(exp(-theta_at(state, reference, rows))) @ chain
        return np.asarray(self.dcm @ chain)


def carried(
    imu: ImuIncrements, fixes: GnssFixes, time_ns: int, q_nb: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """An attitude at the last sample, carried back to the first.

    Parameters
    ----------
    imu : ImuIncrements
        Without gaps, gyro bias taken off.
    fixes : GnssFixes
        Positions around these times.
    time_ns : int
        At which the attitude holds: up to the last sample.
    q_nb : ndarray, shape (4,)

    Returns
    -------
    q_nb : ndarray, shape (4,)
        At the first sample.
    per_bias, per_scale : ndarray, shape (3, 3)
        By how much gyro biases (s) and scale factors (rad) turn it, in NED, up to sign.
    """
    origin = int(imu.time_ns[0])
    chain = AttitudeChain(imu, origin, np.eye(3), fixes)
    at = np.array([origin, min(time_ns, int(imu.time_ns[-1]))])
    rows, turn = chain.rows_at(at), chain.dcm_ni(at)
    start = turn[1].T @ to_dcm(q_nb) @ to_dcm(rows.q[1]).T
    c_nb = turn[0] @ start
    return (
        from_dcm(c_nb @ to_dcm(rows.q[0])),
        c_nb @ (rows.gyro_bias_attitude[1] - rows.gyro_bias_attitude[0]),
        c_nb @ (rows.gyro_scale_attitude[1] - rows.gyro_scale_attitude[0]),
    )
