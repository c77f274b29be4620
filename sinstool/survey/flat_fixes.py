"""Fixes and velocities without a vertical part of their own, as of a receiver in 2-D mode."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sinstool.core.arrays import BoolArray
from sinstool.core.finding import Finding
from sinstool.core.order_statistics import median, quantile
from sinstool.core.streams import Gnss, Velocity

# Heights must move by this much, m, before a vertical velocity that is always 0 is held to be none.
FLAT_HEIGHT_M = 5.0
# A row of equal heights is no chance if, with the share of equal neighbours in the nine tenths of
# all rows that are shorter (at least so many), it is less likely than this.
SHORTER, LEAST_EQUAL, CHANCE = 0.9, 0.05, 1e-6
# Receivers that round heights do so to this, m, or more, which shows in their steps. Other equal
# heights are held; one that holds rounded ones leaps as it lets go, by so many of the smallest and
# of the usual steps.
DIGIT_M, ON_DIGIT, LEAP_DIGITS, LEAP_STEPS = 0.01, 0.01, 5.0, 3.0


def held_heights(fixes: Gnss) -> BoolArray:
    """Heights that are an earlier one though the receiver measures on, shape (n,).

    Parameters
    ----------
    fixes : Gnss
        By time.

    Returns
    -------
    ndarray of bool
        The first height of a row is a measured one. Rounded ones that are alike up to the end of
        the log are not told from a level way.
    """
    held = np.zeros(len(fixes), np.bool_)
    step = np.abs(np.diff(fixes.height))
    steps = step[step > 0.0]
    if not len(steps):
        return held
    first = np.flatnonzero(np.append(True, ~(step == 0.0)))
    begin, after = first, np.append(first[1:], len(fixes))
    count = after - begin
    short = count[count <= quantile(count.astype(np.float64), SHORTER)]
    equal = max(1.0 - len(short) / float(short.sum()), LEAST_EQUAL)
    holds = (count - 1) * np.log(equal) < np.log(CHANCE)
    digits = steps / DIGIT_M
    if np.mean(np.abs(digits - np.round(digits)) < ON_DIGIT) > 0.5:
        leap = max(LEAP_DIGITS * float(steps.min()), LEAP_STEPS * float(median(steps)))
        holds &= np.append(step, 0.0)[after - 1] > leap
    for a, b in zip(begin[holds], after[holds], strict=True):
        held[a + 1 : b] = True
    # One that repeats all of a fix rests, or hangs
    same = (np.diff(fixes.latitude) == 0.0) & (np.diff(fixes.longitude) == 0.0)
    held[1:] &= ~same
    return held


def without_held(
    fixes: Gnss, velocity: Velocity | None, topic: str
) -> tuple[Gnss, Velocity | None, list[Finding]]:
    """Take out heights that the receiver holds, and vertical velocities of zero beside them.

    Parameters
    ----------
    fixes, velocity : Gnss, Velocity or None
        By time.
    """
    held = held_heights(fixes)
    count = int(np.count_nonzero(held))
    if not count:
        return fixes, velocity, []
    at = np.flatnonzero(held)
    seconds = float((fixes.time_ns[at] - fixes.time_ns[at - 1]).sum() * 1e-9)
    if velocity is not None:
        before = np.searchsorted(fixes.time_ns, velocity.time_ns, side="right") - 1
        flat = (velocity.velocity_n[:, 2] == 0.0) & (before >= 0) & held[np.maximum(before, 0)]
        columns = velocity.velocity_n.copy()
        columns[flat, 2] = np.nan
        velocity = replace(velocity, velocity_n=columns)
    text = (
        f"topic {topic}: the receiver holds its height for {seconds:.1f} s in all, as {count} fixes"
        " repeat an earlier height to the last digit while they move on; only their horizontal part"
        " is used"
    )
    finding = Finding(
        "held-height",
        text,
        topic=topic,
        start_ns=int(fixes.time_ns[at[0]]),
        end_ns=int(fixes.time_ns[at[-1]]),
        numbers={"messages": count, "seconds": seconds},
    )
    height = np.where(held, np.nan, fixes.height)
    return replace(fixes, height=height), velocity, [finding]


def without_flat(fixes: Gnss, velocity: Velocity, topic: str) -> tuple[Velocity, list[Finding]]:
    """Take out down velocities that are all exactly zero although height moves."""
    heights = fixes.height[np.isfinite(fixes.height)]
    down = velocity.velocity_n[:, 2]
    if len(heights) < 2 or np.any(down != 0.0) or np.ptp(heights) <= FLAT_HEIGHT_M:
        return velocity, []
    text = (
        f"topic {topic}: its vertical velocity is always zero while height moves by"
        f" {np.ptp(heights):.0f} m; only the horizontal part is used"
    )
    columns = velocity.velocity_n.copy()
    columns[:, 2] = np.nan
    return replace(velocity, velocity_n=columns), [
        Finding("flat-velocity", text, topic=topic, numbers={"height_m": float(np.ptp(heights))})
    ]
