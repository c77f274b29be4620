"""Whether the orientations of an IMU topic agree with its own gravity and gyro.

Numbers in another order, other axes, or another world all make unit quaternions. In the first
seconds gravity and the gyro tell, whether the vehicle moves or not; but on one heading numbers in
another order may be those of a level vehicle on another, until it has turned.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sinstool.core.rotation import conjugate, log, multiply, rotate
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE, STANDARD_GRAVITY
from sinstool.methods.alignment.still import WINDOW_NS, Windows

# Windows show gravity where the specific force has its size to this share, and the rate is lower
# than this, rad/s; at least this many are needed.
OF_SIZE, SLOW, LEAST = 0.1, 0.5, 2
# A tilt, as the mean over so many windows, that no acceleration explains: a level one that leaves
# the specific force its size to OF_SIZE tilts it by 25 deg at most. At least this share of them
# must show gravity: in a steep turn a few do by chance.
TILT, TOGETHER, SHARE = 25.0 * DEGREE, 40, 0.25
# Turns between windows are compared where their rms is at least this and none exceeds this, rad; at
# least this many. They disagree if this share of the squares of both remains.
LEAST_TURN, MOST_TURN, TURNS, LEFT = 0.05, 1.0, 6, 0.5
LIKELY = "other axes, or its numbers are in another order"


@dataclass(frozen=True)
class OrientationFault:
    """A fault of orientations: their axes, or the order of their components.

    Attributes
    ----------
    tilt_deg : float or None
        Angle between their vertical and gravity's, where that is what is wrong.
    """

    text: str
    tilt_deg: float | None = None


def orientation_fault(
    orientations: Mapping[int, np.ndarray], first_ns: int, windows: Windows
) -> OrientationFault | None:
    """Compare orientations with the specific force and the rates of the same windows.

    Parameters
    ----------
    orientations : mapping of int to ndarray, shape (4,)
        q_nb at the start of windows, by their number from `first_ns` on. Those of the first
        `TOGETHER` windows are compared with the gyro, too.
    """
    numbers = (windows.start_ns - first_ns) // WINDOW_NS
    rows = np.flatnonzero([int(number) in orientations for number in numbers])
    if len(rows) < LEAST:
        return None
    q_nb = np.array([orientations[int(number)] for number in numbers[rows]])
    gyro, accel, force = windows.gyro[rows], windows.accel[rows], windows.force[0, rows]
    turn = windows.turn[0, rows]
    size = np.linalg.norm(accel, axis=1)
    telling = np.abs(size / STANDARD_GRAVITY - 1.0) < OF_SIZE
    telling &= np.linalg.norm(gyro, axis=1) < SLOW
    groups = (numbers[rows] - numbers[rows[0]]) // TOGETHER
    for group in np.unique(groups[telling]).tolist():
        of_group = telling & (groups == group)
        if np.count_nonzero(of_group) < max(LEAST, SHARE * np.count_nonzero(groups == group)):
            continue
        up = rotate(q_nb[of_group], force[of_group] / size[of_group, None]).mean(axis=0)
        tilt = float(np.arccos(np.clip(-up[2] / np.linalg.norm(up), -1.0, 1.0)))
        if tilt > TILT:
            angle, at = tilt / DEGREE, group * TOGETHER * WINDOW_NS / SECOND
            when = f"from {at:.0f} s on" if group else "in the first seconds"
            reason = f"is tilted by {angle:.0f} deg from the vertical of the accelerometer"
            return OrientationFault(f"{reason} {when}: {LIKELY}", angle)
    first = groups == 0
    rows, q_nb, turn = rows[first], q_nb[first], turn[first]
    follow = np.diff(numbers[rows]) == 1
    turned = log(multiply(conjugate(q_nb[:-1]), q_nb[1:]))[follow]
    said = log(turn[:-1])[follow]
    small = np.linalg.norm(said, axis=1) < MOST_TURN
    if np.count_nonzero(small) < TURNS:
        return None
    # A bias of the gyro is the same in all of them
    turned, said = (turns[small] - turns[small].mean(axis=0) for turns in (turned, said))
    power = float(np.sum(said**2))
    if power < LEAST_TURN**2 * len(said):
        return None
    left = float(np.sum((turned - said) ** 2)) / (power + float(np.sum(turned**2)))
    if left > LEFT:
        return OrientationFault(f"turns differently from the gyro in the first seconds: {LIKELY}")
    return None
