"""Angular rates smoothed as a receiver's tracking loops smooth the motion of its antenna.

The carrier loops of a receiver have a bandwidth of 10 to 25 Hz, and do not follow the vibration of
an engine [1]_. A gyro sample holds the turning of the vehicle and all of the vibration: with a
lever arm of a metre, 20 deg/s of vibration would be taken for 0.3 m/s that the receiver does not
measure.

References
----------
.. [1] E. D. Kaplan, C. J. Hegarty, "Understanding GPS/GNSS: Principles and Applications", 3rd ed.,
   2017, section 8.5.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import TypeVar

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.parts import kernel, part
from sinstool.core.streams import concatenate, take_rows
from sinstool.methods.strapdown.velocity import Increments

# Half-width of the window of the means, s, and the distance beyond which updates are not needed, ns
FOLLOWED_S = 0.05
_BEYOND_NS = 200_000_000
# Relative difference up to which two updates count as equally long
LIKE = 1e-6

T = TypeVar("T")


def _integral(u):  # type: ignore[no-untyped-def]
    """Integral of (1 - 3 u^2) (1 - u^2)^2 from 0 to u, a number or an array."""
    square = u * u
    return u * (1.0 - square * (5.0 / 3.0 - square * (1.4 - square * 3.0 / 7.0)))


_until = part()(_integral)


def followed_rates(
    time_ns: IntArray, interval: FloatArray, rotation_vector: FloatArray, rows: slice = slice(None)
) -> FloatArray:
    """Mean rates about the ends of updates, shape (k, 3), rad/s.

    Parameters
    ----------
    time_ns, interval, rotation_vector : ndarray, shape (n,), (n,), (n, 3)
        Of updates that follow each other, or leave gaps.
    rows : slice, optional
        Updates at whose ends the rates are computed.

    Returns
    -------
    ndarray
        Means over `FOLLOWED_S` before and after, as far as there are updates, with the weight
        (1 - 3 u^2) (1 - u^2)^2 at a distance of u `FOLLOWED_S`. Of a vibration at 6 Hz they keep
        0.985, at 14 Hz 0.7, and above 24 Hz at most 0.07.
    """
    first, last, _ = rows.indices(len(time_ns))
    out = np.empty((last - first, 3))
    if len(out):
        # Nearly all updates are as long as one, for which weights are known beforehand
        usual = float(interval[first])
        edges = np.minimum(np.arange(int(FOLLOWED_S / usual) + 2) * (usual / FOLLOWED_S), 1.0)
        _followed(
            np.ascontiguousarray(time_ns),
            np.ascontiguousarray(interval),
            np.ascontiguousarray(rotation_vector),
            first,
            usual,
            np.diff(_integral(edges)),
            out,
        )
    return out


def with_followed(parts: Iterable[tuple[Increments, T]]) -> Iterator[tuple[Increments, T]]:
    """Increments with followed rates, which are the same wherever parts end.

    Parameters
    ----------
    parts : iterable of tuple
        Increments, and what goes with them.
    """
    before: Increments | None = None
    waiting: list[tuple[Increments, T]] = []

    def answer() -> tuple[Increments, T]:
        nonlocal before
        made, beside = waiting.pop(0)
        near = [made] if before is None else [before, made]
        first = 0 if before is None else len(before.time_ns)
        last_ns = int(made.time_ns[-1])
        for later, _ in waiting:
            few = np.searchsorted(later.time_ns, last_ns + _BEYOND_NS)
            near.append(take_rows(later, slice(0, int(few))))
        all_of = concatenate(near)
        rate = followed_rates(
            all_of.time_ns,
            all_of.interval,
            all_of.rotation_vector,
            slice(first, first + len(made.time_ns)),
        )
        upto = first + len(made.time_ns)
        few = np.searchsorted(all_of.time_ns, last_ns - _BEYOND_NS)
        before = take_rows(all_of, slice(int(few), upto))
        return replace(made, followed_rate=rate), beside

    for one in parts:
        waiting.append(one)
        while waiting[-1][0].time_ns[-1] - waiting[0][0].time_ns[-1] > _BEYOND_NS:
            yield answer()
    while waiting:
        yield answer()


@kernel()
def _followed(
    time_ns: IntArray,
    interval: FloatArray,
    turned: FloatArray,
    first: int,
    usual: float,
    known: FloatArray,
    out: FloatArray,
) -> None:
    """Set means of turns over their time, about the ends of updates from the first asked for on.

    Parameters
    ----------
    usual : float
        An interval, s.
    known : ndarray
        Weights of updates that are that long, from the middle on.
    """
    for i in range(len(out)):
        k = first + i
        x, y, z, weight = 0.0, 0.0, 0.0, 0.0
        for way in (-1, 1):
            away, even, many = 0.0, True, 0
            j = k if way < 0 else k + 1
            while away < FOLLOWED_S and 0 <= j < len(time_ns):
                if way > 0 and _apart(time_ns, interval, j):
                    break
                even = even and abs(interval[j] - usual) < LIKE * usual
                if even:
                    share = known[many]
                else:
                    share = _within(away / FOLLOWED_S, (away + interval[j]) / FOLLOWED_S)
                of = share / interval[j]
                x += of * turned[j, 0]
                y += of * turned[j, 1]
                z += of * turned[j, 2]
                weight += share
                away += interval[j]
                many += 1
                if way < 0 and (j == 0 or _apart(time_ns, interval, j)):
                    break
                j += way
        out[i, 0], out[i, 1], out[i, 2] = x / weight, y / weight, z / weight


@part()
def _apart(time_ns: IntArray, interval: FloatArray, k: int) -> bool:
    """Whether an update does not follow the one before."""
    return (time_ns[k] - time_ns[k - 1]) * 1e-9 > 1.5 * interval[k]


@part()
def _within(near: float, far: float) -> float:
    """Weight between two distances from the middle, of half a window each."""
    return _until(min(far, 1.0)) - _until(near)
