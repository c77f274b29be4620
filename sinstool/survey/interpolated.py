"""Fixes that were interpolated between those of the receiver, as many converters make them.

They are no measurements: a filter that takes them for such believes each fix many times over.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.streams import Gnss
from sinstool.core.timeline import SECOND
from sinstool.survey.stuck import evenly_apart

# A value is on the straight line between its neighbours if it is off by less than this share of
# their distance. Noise and motion of a vehicle put hardly any there.
ON_LINE = 1e-3


def on_lines(time_ns: IntArray, values: FloatArray) -> BoolArray:
    """Which rows lie on the straight line between their neighbours in time, and move, shape (n,).

    Parameters
    ----------
    time_ns : ndarray of int64, shape (n,)
        In order.
    values : ndarray, shape (n, k)
        Of any unit.
    """
    between = np.zeros(len(values), np.bool_)
    if len(values) < 3:
        return between
    seconds = (time_ns - time_ns[0]) / SECOND
    share = (seconds[1:-1] - seconds[:-2]) / (seconds[2:] - seconds[:-2])
    way = values[2:] - values[:-2]
    off = values[1:-1] - values[:-2] - share[:, None] * way
    length = np.linalg.norm(way, axis=1)
    between[1:-1] = (length > 0.0) & (np.linalg.norm(off, axis=1) < ON_LINE * length)
    return between


def interpolated(fixes: Gnss) -> tuple[BoolArray, float]:
    """Fixes that were interpolated between others.

    Parameters
    ----------
    fixes : Gnss
        By time.

    Returns
    -------
    between : ndarray of bool, shape (n,)
        All but those at the corners of the track. Where the fixes that were interpolated are not
        among the results, these are the nearest to them.
    times : float
        How many fixes were usually made of one.
    """
    none = np.zeros(len(fixes), np.bool_)
    place = np.stack([fixes.latitude - fixes.latitude[0], fixes.longitude - fixes.longitude[0]], 1)
    straight = on_lines(fixes.time_ns, place)
    # A corner between two fixes bends the track at both
    corner = np.flatnonzero(~straight)
    corner = corner[np.append(True, np.diff(corner) > 1)]
    # A converter puts about the same number of fixes between two of the receiver, nearly always
    apart = evenly_apart(corner)
    if apart is None or apart[0] < 2.0:
        return none, 1.0
    between = ~none
    between[corner] = False
    return between, apart[1]
