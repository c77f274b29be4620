"""Attitude at any time of a segment, once ``C_ib0^i`` is known; eq. (1) of Qu et al."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sinstool.core.rotation import exp, from_dcm, to_dcm
from sinstool.methods.alignment.accumulation import InertialRows, accumulate
from sinstool.methods.alignment.inflight_types import GnssFixes, ImuIncrements
from sinstool.methods.alignment.reference import dcm_ni
from sinstool.methods.alignment.refine import theta_at

FloatArray = NDArray[np.float64]


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
