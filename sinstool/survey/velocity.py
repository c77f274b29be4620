"""Whether a velocity is over ground, along east, north and up.

Wheel odometry has the same message types as a receiver, in axes of the vehicle or of a frame that
begins wherever it was switched on, and drivers mix up axes and units. The fixes show it: over some
way they move by the integral of the velocity. Where they show nothing, names of frames do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.earth import horizontal_metres
from sinstool.core.order_statistics import median, quantile
from sinstool.core.rotation import wrapped
from sinstool.core.streams import Gnss, Velocity
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.survey.rest import UNKNOWN_SIGMA_M

# Displacements of at least this length, m, and so many sigmas of a fix are compared; a velocity
# contradicts the fixes if a quarter of them differ by this share of their length. Noise and stamps
# explain less of long ones.
LONG, SHORT = (100.0, 100.0, 0.25), (10.0, 20.0, 0.5)
QUARTILE = 0.75
# Displacements take at most this time, s, and there are at least so many.
LONGEST_S, LEAST = 120.0, 5
# A velocity that differs by this, m/s, and by this share of its size from the median of those
# around it is a wild one, which says nothing of axes and units.
WILD_M_S, WILD_SHARE = 5.0, 0.5
# Samples further apart than this, s, are not integrated across; where most are, each is compared
# with the way of the fixes over so long a time about it.
APART_S = 2.0
# Fixes on either side for the running median of fix less integrated velocity.
AROUND = 2
# Share of the squares that an explanation of a misfit may leave.
EXPLAINED = 0.1
BODY_FRAMES = ("base_link", "base_footprint", "base", "body")
WORLD_FRAMES = ("map", "world", "earth", "enu", "utm")


@dataclass(frozen=True)
class Agreement:
    """Agreement of a velocity with fixes.

    Attributes
    ----------
    misfit : float or None
        Difference of displacements over their length, the upper quartile; None if the vehicle
        moved too little.
    contradicts : bool
        Whether it cannot be the velocity of the fixes.
    likeness : str
        What a velocity that contradicts looks like, in words.
    """

    misfit: float | None = None
    contradicts: bool = False
    likeness: str = ""


def agreement(fixes: Gnss, velocity: Velocity) -> Agreement:
    """Compare the integral of a velocity with the displacements of fixes.

    Parameters
    ----------
    velocity : Velocity
        Both by time.
    """
    # A fix a second is enough, whatever the receiver's rate
    first = np.unique(fixes.time_ns // SECOND, return_index=True)[1]
    inside = (fixes.time_ns >= velocity.time_ns[0]) & (fixes.time_ns <= velocity.time_ns[-1])
    fixes = fixes.rows(first[inside[first]])
    if len(velocity) < 2 or len(fixes) < LEAST:
        return Agreement()
    north, east = horizontal_metres(
        fixes.latitude - fixes.latitude[0],
        wrapped(fixes.longitude - fixes.longitude[0]),
        fixes.latitude[0],
    )
    seconds = (fixes.time_ns - fixes.time_ns[0]) / SECOND
    place = north + 1j * east
    t = (velocity.time_ns - fixes.time_ns[0]) / SECOND
    rate = velocity.velocity_n[:, 0] + 1j * velocity.velocity_n[:, 1]
    usual = _middle(rate)
    tame = np.abs(rate - usual) <= np.maximum(WILD_M_S, WILD_SHARE * np.abs(usual))
    t, rate = t[tame], rate[tame]
    step = np.diff(t)
    way = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * step)])
    holes = np.concatenate([[0], np.cumsum(step > max(APART_S, 3.0 * float(median(step))))])
    run = np.interp(seconds, t, way.real) + 1j * np.interp(seconds, t, way.imag)
    hole = holes[np.maximum(np.searchsorted(t, seconds, "right") - 1, 0)]
    sigma = usual_noise(fixes)
    place = run + _middle(place - run)
    seldom = float(median(step)) > APART_S
    around = _around(seconds, place, t, rate)
    for metres, sigmas, most in (LONG, SHORT):
        length = max(metres, sigmas * sigma)
        if seldom:
            moved, said = around[:, np.abs(around).max(axis=0) >= length]
        else:
            ends = _windows(seconds, place, run, length)
            begin, end = ends[hole[ends[:, 0]] == hole[ends[:, 1]]].T
            moved, said = place[end] - place[begin], run[end] - run[begin]
        if len(moved) < LEAST:
            continue
        share = np.abs(moved - said) / np.maximum(np.abs(moved), np.abs(said))
        misfit = float(quantile(share, QUARTILE))
        if misfit > most:
            return Agreement(misfit, True, _likeness(moved, said, velocity))
        return Agreement(misfit)
    return Agreement()


def _around(
    seconds: FloatArray, place: NDArray[np.complex128], t: FloatArray, rate: NDArray[np.complex128]
) -> NDArray[np.complex128]:
    """Ways of the fixes over `APART_S` about each velocity, and those of the velocity, (2, n)."""
    ends = t[:, None] + 0.5 * APART_S * np.array([-1.0, 1.0])
    near = np.searchsorted(seconds, ends)
    inside = (near[:, 0] > 0) & (near[:, 1] < len(seconds))
    inside[inside] = seconds[near[inside, 1]] - seconds[near[inside, 0] - 1] < 3.0 * APART_S
    at = np.interp(ends[inside], seconds, place)
    return np.array([at[:, 1] - at[:, 0], APART_S * rate[inside]])


def _middle(off: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Running median, north and east, shape (n,), which no single bad fix or velocity moves.

    A wrong velocity makes a difference that grows; a bad fix is off by itself. Left in, bad fixes
    are ways that no velocity explains, and where a vehicle hardly moves the only long ones.
    """
    padded = np.pad(off, AROUND, "edge")
    near = np.lib.stride_tricks.sliding_window_view(padded, 2 * AROUND + 1)
    return np.asarray(median(near.real, axis=1) + 1j * median(near.imag, axis=1))


def usual_noise(fixes: Gnss) -> float:
    """Usual horizontal standard deviation of fixes, as they say, m."""
    variance = np.einsum("nii->ni", fixes.covariance_n)[:, :2].mean(axis=1)
    stated = (fixes.covariance_type > 0) & np.isfinite(variance) & (variance > 0.0)
    return float(np.sqrt(median(variance[stated]))) if stated.any() else UNKNOWN_SIGMA_M


def _windows(
    seconds: FloatArray, place: NDArray[np.complex128], run: NDArray[np.complex128], length: float
) -> IntArray:
    """First and last fix of ways of a length by fixes or by velocity, one after the other."""
    ends, begin = [], 0
    while begin < len(seconds) - 1:
        last = int(np.searchsorted(seconds, seconds[begin] + LONGEST_S, "right"))
        ahead = slice(begin + 1, last)
        far = np.maximum(np.abs(place[ahead] - place[begin]), np.abs(run[ahead] - run[begin]))
        reached = np.flatnonzero(far >= length)
        if len(reached):
            ends.append((begin, begin + 1 + int(reached[0])))
            begin = ends[-1][1]
        else:
            begin += max(1, (last - begin) // 4)
    return np.array(ends, np.int64).reshape(-1, 2)


def _likeness(
    moved: NDArray[np.complex128], said: NDArray[np.complex128], velocity: Velocity
) -> str:
    """Describe a velocity that does not fit the fixes: north is real, east imaginary."""
    power, all_ = float(np.sum(np.abs(said) ** 2)), float(np.sum(np.abs(moved) ** 2))
    if not power > 0.0 or not all_ > 0.0:
        return "it is zero while the fixes move, or moves while they stand still"
    for mirrored, ways in ((False, said), (True, said.conj())):
        factor = complex(np.sum(moved * ways.conj())) / power
        if float(np.sum(np.abs(moved - factor * ways) ** 2)) > EXPLAINED * all_:
            continue
        angle = float(np.angle(factor)) / DEGREE
        if mirrored:
            if abs(angle - 90.0) < 15.0:
                return (
                    "its axes seem to be north, east, down, or the fixes have latitude and"
                    " longitude exchanged"
                )
            return "its axes seem to be mirrored"
        if abs(angle) < 15.0:
            return f"it is {1.0 / abs(factor):.2g} times as large as the fixes'"
        return f"its axes are turned by {angle:.0f} deg from east and north, as in a local frame"
    forward, left = np.sqrt(np.mean(velocity.velocity_n[:, [1, 0]] ** 2, axis=0))
    if left < 0.2 * forward:
        return "its axes seem to be the vehicle's own axes, forward and left"
    usual, fixed = (float(median(np.abs(each))) for each in (said, moved))
    if 0.8 * fixed < usual < 1.25 * fixed:
        return "its speed matches the fixes, its course does not"
    return ""


def odd_frame(frame: str, child: str | None) -> str:
    """Reason why a velocity's frame is not east, north, up; '' where it may be.

    Parameters
    ----------
    frame : str
        `header.frame_id`.
    child : str or None
        `child_frame_id` of an Odometry, in whose axes its twist is by definition of the message.
    """
    name = (child or frame).strip("/").rsplit("/")[-1].lower()
    if child and name not in WORLD_FRAMES:
        return f"an Odometry's velocity is along the axes of its child_frame_id, {child}"
    if name in BODY_FRAMES or name.endswith(("odom", "_body")) or name.startswith("wheel"):
        return f"its frame_id is {frame}"
    return ""
