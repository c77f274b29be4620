"""A receiver that hangs: it sends its last fix again while the vehicle goes on."""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import BoolArray
from sinstool.core.earth import horizontal_metres
from sinstool.core.rotation import wrapped
from sinstool.core.streams import Gnss, Velocity
from sinstool.survey.velocity import usual_noise

# So many fixes alike to the last bit in a row may be a fix that is sent again.
LEAST_ALIKE = 3
# A receiver that holds its position at rest lets go of it by a few of its sigmas, and slowly; one
# that hangs leaps: so many sigmas, so many times what it then moves from fix to fix, and so fast in
# the mean, m/s.
LEAP_SIGMAS, LEAP_STEPS, LEAP_SPEED = 5.0, 3.0, 0.3


def stuck_fixes(fixes: Gnss) -> BoolArray:
    """Fixes that are an earlier one sent again though the receiver had moved on, shape (n,).

    Parameters
    ----------
    fixes : Gnss
        By time.

    Returns
    -------
    ndarray of bool
        The first of a row of fixes that are alike is a fix, and so are all in a row at whose end
        the receiver goes on from where it was, which is how one at rest behaves. What is alike up
        to the end of the log is not told from rest.
    """
    stuck = np.zeros(len(fixes), dtype=np.bool_)
    if len(fixes) < LEAST_ALIKE + 1:
        return stuck
    first = np.flatnonzero(np.append(True, ~_alike(fixes)))
    after = first[1:]  # a row of fixes that are alike ends before each of these
    begin, count = first[:-1], np.diff(first)
    steps = np.hypot(
        *horizontal_metres(
            np.diff(fixes.latitude), wrapped(np.diff(fixes.longitude)), fixes.latitude[1:]
        )
    )
    leap = steps[after - 1]
    step = np.append(steps, 0.0)[after]
    seconds = (fixes.time_ns[after] - fixes.time_ns[begin]) * 1e-9
    hangs = (
        (count >= LEAST_ALIKE)
        & (leap > LEAP_SIGMAS * usual_noise(fixes))
        & (leap > LEAP_STEPS * step)
        & (leap > LEAP_SPEED * seconds)
    )
    for a, b in zip(begin[hangs], after[hangs], strict=True):
        stuck[a + 1 : b] = True
    return stuck


def stuck_velocities(fixes: Gnss, stuck: BoolArray, velocity: Velocity) -> BoolArray:
    """Velocities that are sent again while the fixes are, shape (m,)."""
    again = np.append(False, (velocity.velocity_n[1:] == velocity.velocity_n[:-1]).all(axis=1))
    before = np.searchsorted(fixes.time_ns, velocity.time_ns, side="right") - 1
    return np.asarray(again & (before >= 0) & stuck[np.maximum(before, 0)])


def _alike(fixes: Gnss) -> BoolArray:
    """Whether each fix but the first is the one before it, to the last bit."""
    same = np.ones(len(fixes) - 1, dtype=np.bool_)
    for column in (fixes.latitude, fixes.longitude, fixes.height):
        same &= (column[1:] == column[:-1]) | (np.isnan(column[1:]) & np.isnan(column[:-1]))
    return same
