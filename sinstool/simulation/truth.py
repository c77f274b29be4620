"""The truth of a simulated motion: exact samples of an IMU, attitude, and position."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from sinstool.core import earth, rotation
from sinstool.core.arrays import ArrayLike, FloatArray, IntArray
from sinstool.core.units import STANDARD_GRAVITY

STANDARD_GRAVITY_N = (0.0, 0.0, STANDARD_GRAVITY)


@dataclass(frozen=True)
class ImuTruth:
    """Samples without sensor errors, and the attitude they belong to.

    Mean values and increments of row k are over (t[k-1], t[k]]; for row 0 that is an
    interval before the first instant as long as the first one after it.

    Attributes
    ----------
    time_ns : ndarray of int64, shape (n,)
        Instants t[k].
    interval : ndarray, shape (n,)
        Length of the interval over which the means of each row are taken, s.
    gyro_rate : ndarray, shape (n, 3)
        ``omega_ib_b`` at the instants, rad/s.
    gyro_mean_rate : ndarray, shape (n, 3)
        Its mean over each interval, rad/s.
    gyro_increment : ndarray, shape (n, 3)
        Its integral over each interval, rad.
    specific_force : ndarray, shape (n, 3)
        ``f_b`` at the instants, m/s^2.
    mean_specific_force : ndarray, shape (n, 3)
        Its mean over each interval, m/s^2.
    q_nb : ndarray, shape (n, 4)
        Attitude at the instants.
    """

    time_ns: IntArray
    interval: FloatArray
    gyro_rate: FloatArray
    gyro_mean_rate: FloatArray
    gyro_increment: FloatArray
    specific_force: FloatArray
    mean_specific_force: FloatArray
    q_nb: FloatArray


@dataclass(frozen=True)
class Trajectory:
    """Motion over the Earth at the instants of the IMU samples.

    Attributes
    ----------
    imu : ImuTruth
        Exact samples and attitude. ``gyro_increment`` and ``mean_specific_force * interval``
        are the exact integrals of angular rate and specific force over (t[k-1], t[k]].
    latitude, longitude : ndarray, shape (n,)
        WGS-84, rad. Longitude is within (-pi, pi].
    height : ndarray, shape (n,)
        Ellipsoidal, m.
    velocity_n : ndarray, shape (n, 3)
        Relative to the Earth, in NED, m/s.
    """

    imu: ImuTruth
    latitude: FloatArray
    longitude: FloatArray
    height: FloatArray
    velocity_n: FloatArray

    @property
    def time_ns(self) -> IntArray:
        """Instants, shape (n,)."""
        return self.imu.time_ns


def turned(trajectory: Trajectory, q_vb: ArrayLike) -> Trajectory:
    """The trajectory of an IMU whose axes are turned against those of a given trajectory.

    Parameters
    ----------
    trajectory : Trajectory
        Trajectory of axes ``v`` at the same point.
    q_vb : array_like, shape (4,)
        From the IMU's axes ``b`` to ``v``.

    Returns
    -------
    Trajectory
        Same positions and velocities; samples and attitudes are those of ``b``.
    """
    imu = trajectory.imu
    q_bv = rotation.conjugate(q_vb)
    own = replace(
        imu,
        gyro_rate=rotation.rotate(q_bv, imu.gyro_rate),
        gyro_mean_rate=rotation.rotate(q_bv, imu.gyro_mean_rate),
        gyro_increment=rotation.rotate(q_bv, imu.gyro_increment),
        specific_force=rotation.rotate(q_bv, imu.specific_force),
        mean_specific_force=rotation.rotate(q_bv, imu.mean_specific_force),
        q_nb=rotation.multiply(imu.q_nb, q_vb),
    )
    return replace(trajectory, imu=own)


def sample_times(rate_hz: float, duration_s: float, start_ns: int = 0) -> IntArray:
    """Instants of equal spacing; each is rounded to a nanosecond, so that no error accumulates.

    Parameters
    ----------
    rate_hz : float
        Samples per second.
    duration_s : float
        From the first instant to the last; a remaining part of an interval is dropped.
    start_ns : int, optional
        First instant.

    Returns
    -------
    ndarray of int64, shape (n,)
        Two instants at least.

    Raises
    ------
    ValueError
        If the rate is not positive or the duration holds no interval.
    """
    if not rate_hz > 0.0:
        raise ValueError(f"Expected a positive `rate_hz`, got {rate_hz}.")
    # A millionth of an interval forgives the rounding of duration times rate.
    count = int(np.floor(duration_s * rate_hz + 1e-6))
    if count < 1:
        raise ValueError(f"{duration_s} s at {rate_hz} Hz hold no interval.")
    return start_ns + np.round(np.arange(count + 1) * (1e9 / rate_hz)).astype(np.int64)


def check_times(time_ns: ArrayLike) -> tuple[IntArray, FloatArray]:
    """Instants of a simulation and the interval that ends at each.

    Parameters
    ----------
    time_ns : array_like of int64, shape (n,)
        Instants, strictly increasing, two at least.

    Returns
    -------
    time_ns : ndarray of int64, shape (n,)
        The same.
    interval : ndarray, shape (n,)
        s; that of row 0 equals that of row 1.

    Raises
    ------
    ValueError
        If they are fewer, of another type or not increasing.
    """
    times = np.asarray(time_ns)
    if times.ndim != 1 or len(times) < 2 or not np.issubdtype(times.dtype, np.integer):
        raise ValueError(
            f"Expected `time_ns` to be two or more integers, got {times.shape} of {times.dtype}."
        )
    steps = np.diff(times.astype(np.int64))
    if np.any(steps <= 0):
        raise ValueError("Expected `time_ns` to increase.")
    return times.astype(np.int64), np.concatenate([steps[:1], steps]) * 1e-9


def after_rest(motion: ImuTruth, rest: ImuTruth) -> ImuTruth:
    """A motion with a rest before it.

    Parameters
    ----------
    motion : ImuTruth
        Of its first row only the angular rate and the specific force at the instant are used,
        because the interval before it belongs to the rest.
    rest : ImuTruth
        Its last instant and attitude are the motion's first.

    Raises
    ------
    ValueError
        If the two do not meet.
    """
    if rest.time_ns[-1] != motion.time_ns[0]:
        raise ValueError("the rest does not end where the motion begins")
    if not np.allclose(np.abs(rest.q_nb[-1] @ motion.q_nb[0]), 1.0, atol=1e-12):
        raise ValueError("the attitude of the rest is not the first of the motion")
    joined = {}
    for f in fields(ImuTruth):
        joined[f.name] = np.concatenate([getattr(rest, f.name), getattr(motion, f.name)[1:]])
    at = len(rest.time_ns) - 1
    joined["gyro_rate"][at] = motion.gyro_rate[0]
    joined["specific_force"][at] = motion.specific_force[0]
    return ImuTruth(**joined)


def static(time_ns: ArrayLike, q_nb: ArrayLike, latitude: float, height: float = 0.0) -> ImuTruth:
    """Exact samples of a body at rest: Earth rate and the reaction to gravity.

    Parameters
    ----------
    time_ns : array_like of int64, shape (n,)
        Instants, increasing, two at least; see
        :func:`~sinstool.simulation.truth.sample_times`.
    q_nb : array_like, shape (4,)
        Attitude of FRD in NED.
    latitude : float
        Geodetic, rad.
    height : float, optional
        Ellipsoidal, m.

    Returns
    -------
    ImuTruth
        ``omega_ib_b = C_bn omega_ie_n`` and ``f_b = -C_bn g_n``, the same in every row.

    Raises
    ------
    ValueError
        If a shape is wrong, the quaternion zero or time not increasing.
    """
    times, interval = check_times(time_ns)
    attitude = rotation.normalise(q_nb)
    if attitude.shape != (4,):
        raise ValueError(f"Expected `q_nb` to have shape (4,), got {attitude.shape}.")
    q_bn = rotation.conjugate(attitude)
    rows = (len(times), 1)
    rate = np.tile(rotation.rotate(q_bn, earth.earth_rate_n(latitude)), rows)
    force = np.tile(rotation.rotate(q_bn, -earth.gravity_n(latitude, height)), rows)
    return ImuTruth(
        time_ns=times,
        interval=interval,
        gyro_rate=rate,
        gyro_mean_rate=rate.copy(),
        gyro_increment=rate * interval[:, np.newaxis],
        specific_force=force,
        mean_specific_force=force.copy(),
        q_nb=np.tile(attitude, rows),
    )
