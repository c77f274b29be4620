"""Fixes that are sent again: by a receiver that hangs, or by a driver that is faster than it."""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.earth import horizontal_metres
from sinstool.core.order_statistics import quantile
from sinstool.core.rotation import wrapped
from sinstool.core.streams import Gnss, Velocity
from sinstool.survey.velocity import usual_noise

# So many fixes alike to the last bit in a row may be a fix that is sent again.
LEAST_ALIKE = 3
# A receiver that holds its position at rest lets go of it by a few of its sigmas, and slowly; one
# that hangs leaps: so many sigmas, so many times what it then moves from fix to fix, and so fast in
# the mean, m/s. A leap by so many sigmas, and so many m, is none of a receiver that knew its place,
# however long it held it.
LEAP_SIGMAS, LEAP_STEPS, LEAP_SPEED = 5.0, 3.0, 0.3
FAR_SIGMAS, FAR_M = 50.0, 5.0
# A velocity is not the one that it repeats if the way is another by such a share of it.
OFF_SHARE = 0.25
# What a clock makes is nearly always equally far apart, to one fix or this share: the tenth and the
# nine tenths of so many distances.
LEAST_APART, UNEVEN, TENTHS = 10, 0.25, (0.1, 0.5, 0.9)


def sent_again(fixes: Gnss) -> tuple[BoolArray, float]:
    """Fixes of a driver that sends its latest one more often than the receiver measures.

    A fix that is alike to the last bit is no measurement of its own, and its stamp is wrong. A
    receiver that holds its position at rest, or rounds it, sends alike ones as well, but now for a
    long time and then not at all.

    Parameters
    ----------
    fixes : Gnss
        By time.

    Returns
    -------
    again : ndarray of bool, shape (n,)
        All but one of those that a driver sends of a measurement.
    times : float
        How often it usually sends one.
    """
    again = np.zeros(len(fixes), dtype=np.bool_)
    alike = _alike(fixes.latitude, fixes.longitude, fixes.height)
    first = np.flatnonzero(np.append(True, ~alike))
    # A driver that sends its latest fix by a clock of its own sends nearly all equally often
    apart = evenly_apart(first)
    if apart is None or apart[2] < 2.0:
        return again, 1.0
    high = apart[2]
    count = np.arange(len(fixes)) - np.repeat(first, np.diff(np.append(first, len(fixes))))
    again[:] = count % (int(high) + 1) > 0
    return again, len(fixes) / float(np.count_nonzero(~again))


def evenly_apart(rows: IntArray) -> tuple[float, float, float] | None:
    """Distances of rows that are about equally far apart: small, usual and large ones.

    Parameters
    ----------
    rows : ndarray of int, shape (n,)
        Ascending. The first and the last distance may be of what is not whole.

    Returns
    -------
    tuple of float or None
        None if they are not, or too few.
    """
    if len(rows) < LEAST_APART + 2:
        return None
    low, usual, high = (float(quantile(np.diff(rows)[1:-1], p)) for p in TENTHS)
    return None if high - low > max(1.0, UNEVEN * usual) else (low, usual, high)


def stuck_fixes(fixes: Gnss) -> BoolArray:
    """Fixes that are an earlier one sent again though the receiver had moved on, shape (n,).

    Parameters
    ----------
    fixes : Gnss
        By time.

    Returns
    -------
    ndarray of bool
        The first of a row of fixes at the same place is a fix, and so are all in a row at whose end
        the receiver goes on from where it was, which is how one at rest behaves. What is alike up
        to the end of the log is not told from rest. Heights may change, as those of a receiver that
        has them from elsewhere do.
    """
    stuck = np.zeros(len(fixes), dtype=np.bool_)
    if len(fixes) < LEAST_ALIKE + 1:
        return stuck
    first = np.flatnonzero(np.append(True, ~_alike(fixes.latitude, fixes.longitude)))
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
        & (leap > np.minimum(LEAP_SPEED * seconds, max(FAR_SIGMAS * usual_noise(fixes), FAR_M)))
    )
    for a, b in zip(begin[hangs], after[hangs], strict=True):
        stuck[a + 1 : b] = True
    return stuck


def stuck_velocities(fixes: Gnss, stuck: BoolArray, velocity: Velocity) -> BoolArray:
    """Velocities that are sent again while the fixes are, shape (m,), whatever their vertical."""
    again = np.append(False, _alike(velocity.velocity_n[:, 0], velocity.velocity_n[:, 1]))
    before = np.searchsorted(fixes.time_ns, velocity.time_ns, side="right") - 1
    return np.asarray(again & (before >= 0) & stuck[np.maximum(before, 0)])


def stale_velocities(fixes: Gnss, velocity: Velocity) -> BoolArray:
    """Velocities that are an earlier one sent again, or zero, though the fixes move otherwise.

    Parameters
    ----------
    fixes, velocity : Gnss, Velocity
        By time.

    Returns
    -------
    ndarray of bool, shape (m,)
        Of velocities that are alike to the last bit all but the first, and all of them if they are
        zero, if some fixes meanwhile are where it does not lead: by so many sigmas, and by a way
        that takes such a speed. At rest they are alike, too, and right.
    """
    v = velocity.velocity_n
    again = (v[1:] == v[:-1]) | (np.isnan(v[1:]) & np.isnan(v[:-1]))
    first = np.flatnonzero(np.append(True, ~again.all(axis=1)))
    counts = np.diff(np.append(first, len(v)))
    stale = np.zeros(len(v), np.bool_)
    least = LEAP_SIGMAS * np.sqrt(2.0) * usual_noise(fixes)
    north, east = horizontal_metres(
        fixes.latitude - fixes.latitude[0],
        wrapped(fixes.longitude - fixes.longitude[0]),
        fixes.latitude[0],
    )
    place = north + 1j * east
    for a, count in zip(first.tolist(), counts.tolist(), strict=True):
        if count < LEAST_ALIKE:
            continue
        begin = int(np.searchsorted(fixes.time_ns, velocity.time_ns[a]))
        end = int(np.searchsorted(fixes.time_ns, velocity.time_ns[a + count - 1], "right"))
        seconds = (fixes.time_ns[begin:end] - fixes.time_ns[begin : begin + 1]) * 1e-9
        off = place[begin:end] - place[begin : begin + 1] - seconds * (v[a, 0] + 1j * v[a, 1])
        other = max(LEAP_SPEED, OFF_SHARE * float(np.hypot(v[a, 0], v[a, 1])))
        denied = np.abs(off) > np.maximum(least, other * seconds)
        if np.count_nonzero(denied) >= LEAST_ALIKE:
            stale[a + bool(v[a, :2].any()) : a + count] = True
    return stale


def _alike(*columns: FloatArray) -> BoolArray:
    """Whether each row but the first is the one before it, to the last bit."""
    same = np.ones(max(len(columns[0]) - 1, 0), dtype=np.bool_)
    for column in columns:
        same &= (column[1:] == column[:-1]) | (np.isnan(column[1:]) & np.isnan(column[:-1]))
    return same
