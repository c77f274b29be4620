"""Is a gyro in deg/s? Is an accelerometer in g? What the data itself says."""

from __future__ import annotations

import numpy as np

from sinstool.alignment.still import Windows

DEGREE = np.pi / 180.0
# Two readings of the gyro are told apart where they predict tilts that differ by this much.
TELLING_RAD = 0.1
MAX_RATE_RAD_S = 100.0
TELLING_WINDOWS = 10
TELLING_SHARE = 0.8


def unit_evidence(windows: Windows) -> tuple[float, int]:
    """How much better deg/s than rad/s explains the turning of gravity in the body.

    In windows half a second apart the direction of the mean specific force turns by what the
    gyro measured, as far as the vehicle does not accelerate. Read in deg/s where rad/s is
    right, or the reverse, the predicted turn is 57 times off.

    Parameters
    ----------
    windows : Windows
        With rates read as rad/s.

    Returns
    -------
    share : float
        Of the telling pairs of windows, those that fit deg/s better.
    count : int
        Telling pairs: those in which the two readings predict clearly different directions.
    """
    if len(windows) < 2:
        return 0.0, 0
    size = np.linalg.norm(windows.accel, axis=1)
    step_s = np.diff(windows.start_ns) / 1e9
    usable = (step_s < 0.75) & (size[:-1] > 0) & (size[1:] > 0)
    direction = windows.accel / np.where(size > 0, size, 1.0)[:, None]
    turn = 0.5 * (windows.gyro[:-1] + windows.gyro[1:]) * step_s[:, None]
    before, after = direction[:-1], direction[1:]
    as_radians = _turned(before, turn)
    as_degrees = _turned(before, turn * DEGREE)
    telling = usable & (np.linalg.norm(as_radians - as_degrees, axis=1) > TELLING_RAD)
    count = int(np.count_nonzero(telling))
    if not count:
        return 0.0, 0
    error_radians = np.linalg.norm(after - as_radians, axis=1)[telling]
    error_degrees = np.linalg.norm(after - as_degrees, axis=1)[telling]
    return float(np.mean(error_degrees < error_radians)), count


def _turned(direction: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """A direction fixed in space, seen from a body that has turned: Rodrigues by -turn."""
    angle = np.linalg.norm(turn, axis=1, keepdims=True)
    axis = turn / np.where(angle > 0, angle, 1.0)
    along = np.einsum("ij,ij->i", axis, direction)[:, None] * axis
    return along + (direction - along) * np.cos(angle) - np.cross(axis, direction) * np.sin(angle)


def gyro_looks_like_degrees(share: float, count: int, gyro_max: np.ndarray) -> bool:
    """Whether rates read as rad/s must be deg/s.

    Parameters
    ----------
    share, count
        From `unit_evidence`.
    gyro_max : ndarray, shape (3,)
        Largest magnitudes.
    """
    if count >= TELLING_WINDOWS:
        return share >= TELLING_SHARE
    # No IMU measures 100 rad/s (5 700 deg/s); many reach 100 deg/s.
    return bool(gyro_max.max() > MAX_RATE_RAD_S)


def accel_looks_like_g(specific_force_median: float) -> bool:
    """Whether a specific force read as m/s^2 must be in g: its usual size is about one."""
    return 0.8 < specific_force_median < 1.25
