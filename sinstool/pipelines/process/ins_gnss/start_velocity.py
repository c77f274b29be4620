"""The velocity of a filter's start where the receiver gives none."""

from __future__ import annotations

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.arrays import FloatArray
from sinstool.core.earth import earth_rate_n, gravity_n, transport_rate_n
from sinstool.core.order_statistics import median
from sinstool.core.rotation import conjugate, multiply, rotate
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.methods.alignment.accumulation import InertialRows, accumulate
from sinstool.methods.alignment.initial import Alignment
from sinstool.methods.ins_gnss.fix_velocity import track_of
from sinstool.methods.ins_gnss.settings import Settings
from sinstool.methods.ins_gnss.start import TWICE_USED
from sinstool.methods.ins_gnss.velocity_at_start import velocity_by_positions
from sinstool.pipelines.align.in_motion import increments
from sinstool.survey.source import Source

# Positions within so many seconds, and so many fixes, before and after a start show its velocity.
AROUND_S, AROUND_FIXES = 5.0, 3.0


def velocity_around(
    source: Source,
    config: ProcessConfig,
    settings: Settings,
    gnss: GnssEpochs,
    alignment: Alignment,
    covariance_attitude_n: FloatArray,
    time_ns: int,
) -> tuple[FloatArray, FloatArray] | None:
    """Velocity of the IMU at a time, and its covariance, by the positions around it.

    Parameters
    ----------
    gnss : GnssEpochs
        With positions, `settings.gnss_latency` before their stamps.
    alignment : Alignment
        Attitude at that time, and the gyro bias.
    covariance_attitude_n : ndarray, shape (3, 3)
        Of that attitude, rad^2.
    time_ns : int
        Of a sample.

    Returns
    -------
    (ndarray, shape (3,), ndarray, shape (3, 3)) or None
        NED, m/s and (m/s)^2; None with too few positions between the gaps of the IMU before and
        after.
    """
    late, every = round(settings.gnss_latency * SECOND), np.diff(gnss.time_ns)
    reach = max(AROUND_S * SECOND, AROUND_FIXES * float(median(every)) if len(every) else 0.0)
    near = gnss.rows(np.abs(gnss.time_ns - late - time_ns) <= reach)
    shown = _shown(source, config, alignment.gyro_bias, near.time_ns - late, time_ns)
    if shown is None:
        return None
    inside, made, start = shown
    near, seconds = near.rows(inside), made.time_s
    _, place = track_of(near)
    place[:, 2] *= -1.0
    # From the frozen body axes
    q_n = multiply(alignment.q_nb, conjugate(start.q[0]))
    arm = rotate(multiply(q_n, made.q), np.asarray(settings.lever_arm_b))
    way = rotate(q_n, made.xi - start.xi - start.alpha * seconds[:, None])
    # Navigation axes turn meanwhile, and a velocity in them has a Coriolis acceleration
    latitude, height = float(near.latitude[0]), float(near.height[0])
    mean = (place[-1] - place[0]) / max(float(np.ptp(seconds)), 1e-9)
    earth_n, transport_n = earth_rate_n(latitude), transport_rate_n(latitude, height, mean)
    way -= np.cross(earth_n + transport_n, way) * seconds[:, None] / 3.0
    fixes, imu = settings.gnss, settings.imu
    found = velocity_by_positions(
        seconds,
        place - arm,
        way,
        gravity_n(latitude, height) - np.cross(2.0 * earth_n + transport_n, mean),
        np.asarray(fixes.position_white),
        covariance_attitude_n,
        imu.gyro_bias if alignment.gyro_bias_sigma is None else alignment.gyro_bias_sigma,
        float(np.hypot(imu.accel_bias, imu.accel_instability)),
    )
    if found is None:
        return None
    velocity, covariance = found
    # The filter uses the same fixes again, and fixes have slow errors
    slow = fixes.position_wander**2 / max(float(np.ptp(seconds)), 1.0)
    return velocity, TWICE_USED**2 * covariance + slow * np.eye(3)


def _shown(
    source: Source, config: ProcessConfig, gyro_bias: FloatArray, valid_ns: np.ndarray, time_ns: int
) -> tuple[np.ndarray, InertialRows, InertialRows] | None:
    """The inertial side at fixes around a time, as far as no gap of the IMU lies in between.

    Returns
    -------
    (ndarray of bool, InertialRows, InertialRows) or None
        Which of the fixes can be used, their rows, and that of the time itself; None if none can.
    """
    if not len(valid_ns):
        return None
    last_ns, first_ns = max(int(valid_ns[-1]), time_ns), min(int(valid_ns[0]), time_ns)
    imu = increments(source, config, gyro_bias, last_ns, first_ns)
    piece = np.cumsum(np.diff(imu.time_ns, prepend=time_ns) > source.survey.max_gap_ns)
    at = int(np.searchsorted(imu.time_ns, time_ns))
    if at == len(piece):
        return None
    imu = imu.rows(piece == piece[at])
    inside = (valid_ns >= imu.time_ns[0]) & (valid_ns <= imu.time_ns[-1])
    asked_ns = np.append(valid_ns[inside], time_ns)
    order = np.argsort(asked_ns, kind="stable")
    made = accumulate(imu.time_ns, imu.delta_theta, imu.delta_velocity, asked_ns[order], time_ns)
    if not inside.any() or len(made) < len(asked_ns):
        return None
    made = made.rows(np.argsort(order))
    return inside, made.rows(slice(0, -1)), made.rows(slice(-1, None))
