"""Heading by a field, as a measurement of the filter over epochs, compiled."""

from __future__ import annotations

from math import atan2, pi

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import part
from sinstool.methods.attitude_smoother.state import XA, update

# Columns of the field at an epoch: in navigation axes before the correction, T; its azimuth, rad;
# variance of the heading that it shows (rad^2; 0: none), and that which its gate goes by
FIELD, AZIMUTH, FIELD_VARIANCE, FIELD_GATE = 0, 3, 4, 5
FIELD_WIDTH = 6
FIELD_GATE_SIGMAS = 3.0
NO_FIELD: FloatArray = np.empty((0, FIELD_WIDTH))


@part()
def measure_heading(
    field: FloatArray, n: int, x: FloatArray, p: FloatArray, gain: FloatArray, dx: FloatArray
) -> None:
    """Hold the heading against the horizontal direction of the field."""
    if not field[FIELD_VARIANCE] > 0.0:
        return
    north = x[0] * field[0] + x[1] * field[1] + x[2] * field[2]
    east = x[3] * field[0] + x[4] * field[1] + x[5] * field[2]
    down = x[6] * field[0] + x[7] * field[1] + x[8] * field[2]
    square = north * north + east * east
    if not square > 0.0:
        return
    off = field[AZIMUTH] - atan2(east, north)
    off -= 2.0 * pi * np.floor(off / (2.0 * pi) + 0.5)
    # A tilt turns part of the vertical field into the horizontal one.
    a, b = -north * down / square, -east * down / square
    left = off - (a * dx[0] + b * dx[1] + dx[2])
    s = a * (a * p[0, 0] + 2.0 * (b * p[0, 1] + p[0, 2])) + b * (b * p[1, 1] + 2.0 * p[1, 2])
    if left * left > FIELD_GATE_SIGMAS**2 * (s + p[2, 2] + field[FIELD_GATE]):
        return
    update(p, n, XA, a, XA + 1, b, XA + 2, 1.0, off, field[FIELD_VARIANCE], gain, dx)
