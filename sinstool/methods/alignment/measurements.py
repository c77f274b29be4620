"""Fixes made of GNSS epochs, and increments made of samples, for alignment in motion."""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.errors import AlignmentError
from sinstool.core.order_statistics import median
from sinstool.core.streams import DerivedEpochs, GnssEpochs, Imu
from sinstool.core.timeline import SECOND
from sinstool.methods.alignment.inflight_types import GnssFixes, ImuIncrements

# Vertical velocity is the slope of heights over this time before and after, s.
CLIMB_S = 2.0


def gnss_fixes(
    gnss: GnssEpochs | None, first_ns: int, last_ns: int, latency_s: float = 0.0
) -> tuple[GnssFixes, tuple[str, ...]]:
    """Epochs with velocity; their positions are interpolated where they have none.

    Parameters
    ----------
    gnss : GnssEpochs or None
        As stamped.
    first_ns, last_ns : int
        Span of the samples.
    latency_s : float
        By which a fix is older than its stamp; decides which are as old as the samples.

    Returns
    -------
    fixes : GnssFixes
        Without any velocity: those with a position.
    warnings : tuple of str

    Raises
    ------
    AlignmentError
        There are none within the span of the samples.
    """
    if gnss is None or not gnss.has_position.any():
        raise AlignmentError(
            "alignment in motion needs GNSS fixes, and there are none",
            "use --align level, gyrocompass, log or fixed",
        )
    valid_ns = gnss.time_ns - round(latency_s * SECOND)
    inside = (valid_ns >= first_ns) & (valid_ns <= last_ns)
    placed = gnss.rows(gnss.has_position)
    rows = gnss.rows(inside & (gnss.has_velocity if gnss.has_velocity.any() else gnss.has_position))
    if not len(rows):
        raise AlignmentError(
            f"no GNSS fix lies within the span of the IMU's samples{_beside(valid_ns, first_ns)}",
            "choose another span with --start and --end, use --align level or log, or, if the"
            " receiver has another clock, give --gnss-clock-offset",
        )
    seconds = (rows.time_ns - placed.time_ns[0]) / SECOND
    at = (placed.time_ns - placed.time_ns[0]) / SECOND
    high = np.isfinite(placed.height)
    height = np.zeros(len(rows))
    if high.any():
        height = np.interp(seconds, at[high], placed.height[high])
    sigma = rows.sigma_velocity_n
    stated = np.isfinite(sigma).all(axis=1)
    usual = float(median(sigma[stated])) if stated.any() else 0.0
    sigma_v = None
    if usual > 0.0:
        sigma_v = np.where(stated, np.sqrt(np.mean(sigma**2, axis=1)), usual)
    velocity, warnings = with_vertical(rows.velocity_n, seconds, at[high], placed.height[high])
    longitude = np.interp(seconds, at, np.unwrap(placed.longitude))
    fixes = GnssFixes(
        rows.time_ns,
        np.interp(seconds, at, placed.latitude),
        (longitude + np.pi) % (2.0 * np.pi) - np.pi,
        height,
        velocity,
        sigma_v,
        rows.derived_s if isinstance(rows, DerivedEpochs) else None,
    )
    return fixes, warnings


def _beside(fixes_ns: IntArray, first_ns: int) -> str:
    """Where fixes are that lie outside the samples."""
    if fixes_ns[-1] < first_ns:
        return f": the last is {(first_ns - fixes_ns[-1]) / SECOND:.1f} s before the first sample"
    if fixes_ns[0] > first_ns:
        return f": the first is {(fixes_ns[0] - first_ns) / SECOND:.1f} s after the first sample"
    return ""


def with_vertical(
    velocity_n: FloatArray, seconds: FloatArray, height_s: FloatArray, height: FloatArray
) -> tuple[FloatArray, tuple[str, ...]]:
    """Velocity with a vertical part from height, where most fixes have none.

    Where few have none, these are better left out than guessed.

    Parameters
    ----------
    velocity_n : ndarray, shape (n, 3)
        m/s; its vertical part may be NaN.
    seconds : ndarray, shape (n,)
        Times of the velocities.
    height_s, height : ndarray, shape (k,)
        Times and heights, s and m.

    Returns
    -------
    velocity_n : ndarray, shape (n, 3)
    warnings : tuple of str
    """
    flat = np.isfinite(velocity_n[:, :2]).all(axis=1) & ~np.isfinite(velocity_n[:, 2])
    if np.count_nonzero(flat) < 0.5 * len(flat):
        return velocity_n, ()
    filled = velocity_n.copy()
    if len(height_s) < 2:
        filled[flat, 2] = 0.0
        return filled, (
            "the fixes have no vertical velocity and no height: level motion is assumed",
        )
    ends = [np.interp(seconds[flat] + half, height_s, height) for half in (-CLIMB_S, CLIMB_S)]
    filled[flat, 2] = (ends[0] - ends[1]) / (2.0 * CLIMB_S)
    return filled, (
        f"the fixes have no vertical velocity: it is derived from height over {2 * CLIMB_S:g} s",
    )


def increments(imu: Imu, gyro_kind: str, interval_s: float, gyro_bias: FloatArray) -> ImuIncrements:
    """Samples as increments: point rates by the trapezoidal rule.

    Parameters
    ----------
    imu : Imu
        Increments of the log as mean rates.
    gyro_kind : {'rate', 'mean-rate', 'increment'}
        Of these only ``rate`` are values at an instant.
    interval_s : float
        Of the first sample.
    gyro_bias : ndarray, shape (3,)
        Taken off, rad/s.
    """
    step = np.diff(imu.time_ns, prepend=imu.time_ns[0]) / SECOND
    step[0] = interval_s
    gyro, accel = imu.gyro - gyro_bias, imu.accel
    if gyro_kind == "rate":
        gyro, accel = _between(gyro), _between(accel)
    return ImuIncrements(imu.time_ns, gyro * step[:, None], accel * step[:, None])


def _between(samples: FloatArray) -> FloatArray:
    """Means of each sample and the one before it."""
    mean = samples.copy()
    mean[1:] = 0.5 * (samples[1:] + samples[:-1])
    return mean
