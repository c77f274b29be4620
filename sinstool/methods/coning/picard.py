"""Picard iteration for an angular rate that is a polynomial over each update.

The N increments of an update determine a rate polynomial of degree N - 1. The attitude it
leads to is the limit of iterated integrals of ``q' = q o omega / 2``,

    q_0 = 1,   q_(l+1)(tau) = 1 + 1/2 integral from -1 to tau of q_l o omega,

and nothing else is approximated: no term of the rotation vector's equation is left out,
whatever the angle. In pure coning the fitted polynomial is a little worse than coefficients
that are optimal there; in manoeuvres it is better by orders of magnitude.

The limit is the solution of the differential equation, which is a power series in tau:
``(k + 1) q_(k+1) = 1/2 sum over i of q_(k-i) o c_i``. Summed from the middle of the update in
both directions, it is done in some fifteen terms and one pass.

References
----------
.. [1] Y. Wu, "RodFIter: Attitude reconstruction from inertial measurement by functional
   iteration", IEEE Trans. Aerospace and Electronic Systems 54(5), 2018, 2131-2142.
.. [2] G. Yan, J. Weng, X. Yang, Y. Qin, "An accurate numerical solution for strapdown attitude
   algorithm based on Picard iteration", J. Astronautics 38(12), 2017, 1307-1313 (in Chinese).
"""

from __future__ import annotations

from functools import cache

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.errors import ConfigurationError
from sinstool.core.parts import njit
from sinstool.core.quaternion_kernels import cross, put, row, to_rotation_vector, weighted_sum
from sinstool.methods.coning.algorithm import ConingAlgorithm, MultiSampleAlgorithm
from sinstool.methods.coning.polynomial import table, through_increments

# With more increments per update the polynomial through them is ill-conditioned: at its ends it
# amplifies white noise of the increments a thousandfold.
MOST_SAMPLES = 10

# Bounds that no real data reach: forty terms suffice for a whole turn, and a part turns by about a
# radian.
MOST_TERMS = 96
MOST_PARTS = 1024


class Picard(MultiSampleAlgorithm):
    """Rotation of a polynomial rate through the increments of an update, to the last bit.

    Parameters
    ----------
    samples : int
        Increments per update.
    before : int, optional
        Earlier increments through which the polynomial passes too, where they exist.
    iterations : int, optional
        Stop after this many integrals instead of at convergence, for comparison with algorithms
        that do.
    name : str, optional
        By default ``picard-N``.

    Raises
    ------
    ConfigurationError
        If there are no samples or too many, or no iterations.
    """

    source = "Yan et al. 2017; Picard iteration to convergence"

    def __init__(
        self, samples: int, before: int = 0, iterations: int | None = None, name: str = ""
    ) -> None:
        check_samples("picard", samples + before, 1)
        if iterations is not None and iterations < 1:
            raise ConfigurationError(
                f"picard with {iterations} iterations integrates nothing", "give 1 or more"
            )
        self.name = name or f"picard-{samples}"
        self.summary = f"{samples} samples per update, polynomial rate integrated exactly"
        self.samples = samples
        self.before = before
        self.iterations = iterations
        self._fits = _fits(samples, before)

    def _fill(self, x: FloatArray, dt: FloatArray, first: int, out: FloatArray) -> None:
        if self.iterations is None:
            _series_kernel(x, first, self.samples, self._fits, out)
        else:
            _iterated_kernel(x, first, self.samples, self._fits, self.iterations, out)

    def _of_samples(self, samples: int) -> ConingAlgorithm:
        before = self.before + self.samples - samples  # the same degree
        return Picard(samples, before, self.iterations, f"{self.name}[{samples}]")


@cache
def _fits(samples: int, before: int) -> FloatArray:
    """Increments to coefficients of the rate, by the number of earlier ones."""
    return table([through_increments(h + samples, h, samples) for h in range(before + 1)])


def picard(samples: int) -> Picard:
    """Build ``picard-N``.

    Parameters
    ----------
    samples : int
        N, from 2 to 10.

    Returns
    -------
    Picard
        The algorithm.

    Raises
    ------
    ConfigurationError
        If N is out of range.
    """
    check_samples("picard", samples, 2)
    return Picard(samples)


def check_samples(family: str, samples: int, least: int) -> None:
    """Refuse a number of samples per update that no polynomial of the family can take."""
    if not least <= samples <= MOST_SAMPLES:
        raise ConfigurationError(
            f"{family}-{samples} has {samples} samples per update",
            f"N in {family}-N is {least} to {MOST_SAMPLES}",
        )


@njit(cache=True, nogil=True)
def fit(
    x: FloatArray,
    start: int,
    weights: FloatArray,
    terms: int,
    rows: int,
    scale: float,
    c: FloatArray,
) -> float:
    """Coefficients `c` from samples `start` on; return the sum of their magnitudes."""
    size = 0.0
    for k in range(terms):
        sx, sy, sz = weighted_sum(x, start, 1, weights, k, rows)
        put(c, k, scale * sx, scale * sy, scale * sz)
        size += abs(c[k, 0]) + abs(c[k, 1]) + abs(c[k, 2])
    return size


@njit(cache=True, nogil=True)
def rotate_polynomial(
    c: FloatArray, terms: int, size: float, room: FloatArray, out: FloatArray, update: int
) -> None:
    """Rotation vector of a polynomial rate over tau from -1 to 1.

    `c` holds **half** the coefficients of the rate, `terms` of them, `size` the sum of their
    magnitudes; `room` is :func:`room_for`; the result goes to row `update` of `out`.
    """
    if not size > 2.0:
        w, x, y, z = _series(c, terms, size, room)
    else:
        # Large coefficients that cancel, as of noise through many samples: their series would
        # lose what cancels. Over a part of the update the same polynomial has small ones.
        parts = int(min(np.ceil(size), MOST_PARTS))
        moved = room[MOST_TERMS + 1 :]
        w, x, y, z = 1.0, 0.0, 0.0, 0.0
        for part in range(parts):
            part_size = _part(c, terms, (2.0 * part + 1.0) / parts - 1.0, 1.0 / parts, moved)
            bw, bx, by, bz = _series(moved, terms, part_size, room)
            aw, ax, ay, az = w, x, y, z
            w = aw * bw - (ax * bx + ay * by + az * bz)
            cx, cy, cz = cross(ax, ay, az, bx, by, bz)
            x = aw * bx + ax * bw + cx
            y = aw * by + ay * bw + cy
            z = aw * bz + az * bw + cz
    to_rotation_vector(w, x, y, z, out, update)


@njit(cache=True, nogil=True)
def room_for(terms: int) -> FloatArray:
    """Scratch memory of :func:`rotate_polynomial`: the series, and a part's coefficients."""
    return np.empty((MOST_TERMS + 1 + terms, 4))


@njit(cache=True, nogil=True)
def _part(c: FloatArray, terms: int, middle: float, half_width: float, moved: FloatArray) -> float:
    """Coefficients of the polynomial over a part of the update; return their size."""
    size = 0.0
    for component in range(3):
        for k in range(terms):
            moved[k, component] = c[k, component]
        # Taylor shift by repeated synthetic division
        for i in range(terms - 1):
            for k in range(terms - 2, i - 1, -1):
                moved[k, component] += middle * moved[k + 1, component]
        scale = half_width
        for k in range(terms):
            moved[k, component] *= scale
            size += abs(moved[k, component])
            scale *= half_width
    return size


@njit(cache=True, nogil=True)
def _series(
    c: FloatArray, terms: int, size: float, q: FloatArray
) -> tuple[float, float, float, float]:
    """Quaternion of a polynomial rate by its power series, stored in `q`."""
    q[0] = 0.0
    q[0, 0] = 1.0
    # The rotations from the middle of the update to its end and start are even +- odd.
    ew, ex, ey, ez = 1.0, 0.0, 0.0, 0.0
    ow = ox = oy = oz = 0.0
    limit = 1e-18 * size
    negligible = 0
    for k in range(1, MOST_TERMS + 1):
        w = x = y = z = 0.0
        for i in range(min(k, terms)):
            dw, dx, dy, dz = times_vector(q, k - 1 - i, c, i)
            w += dw
            x += dx
            y += dy
            z += dz
        share = 1.0 / k
        w, x, y, z = w * share, x * share, y * share, z * share
        q[k, 0], q[k, 1], q[k, 2], q[k, 3] = w, x, y, z
        if k % 2:
            ow += w
            ox += x
            oy += y
            oz += z
        else:
            ew += w
            ex += x
            ey += y
            ez += z
        # The next term comes from the last `terms` ones: once all of those are nothing, so
        # is everything that follows.
        if abs(w) + abs(x) + abs(y) + abs(z) > limit:
            negligible = 0
        else:
            negligible += 1
            if negligible == terms:
                break
    # conjugate of the one times the other, arranged so that nothing cancels when small
    cx, cy, cz = cross(ex, ey, ez, ox, oy, oz)
    return (
        ew * ew - ow * ow + (ex * ex + ey * ey + ez * ez) - (ox * ox + oy * oy + oz * oz),
        2.0 * (ew * ox - ow * ex - cx),
        2.0 * (ew * oy - ow * ey - cy),
        2.0 * (ew * oz - ow * ez - cz),
    )


@njit(cache=True, nogil=True, inline="always")
def times_vector(q: FloatArray, k: int, v: FloatArray, i: int) -> tuple[float, float, float, float]:
    """Product of the quaternion in row `k` of `q` and the vector in row `i` of `v`."""
    w, x, y, z = q[k, 0], q[k, 1], q[k, 2], q[k, 3]
    ax, ay, az = row(v, i)
    cx, cy, cz = cross(x, y, z, ax, ay, az)
    return -(x * ax + y * ay + z * az), w * ax + cx, w * ay + cy, w * az + cz


@njit(cache=True, nogil=True)
def _series_kernel(
    x: FloatArray, first: int, samples: int, fits: FloatArray, out: FloatArray
) -> None:
    most = fits.shape[0] - 1
    c = np.empty((fits.shape[1], 3))
    room = room_for(fits.shape[1])
    for update in range(out.shape[0]):
        start = first + update * samples
        history = min(start, most)
        terms = history + samples
        size = fit(x, start - history, fits[history], terms, terms, 0.5, c)
        rotate_polynomial(c, terms, size, room, out, update)


@njit(cache=True, nogil=True)
def _iterated_kernel(
    x: FloatArray, first: int, samples: int, fits: FloatArray, iterations: int, out: FloatArray
) -> None:
    """Picard's iteration as it is written: every integral from -1, `iterations` of them."""
    most = fits.shape[0] - 1
    c = np.empty((fits.shape[1], 3))
    term = np.empty((iterations * fits.shape[1] + 1, 4))
    raised = np.empty_like(term)
    for update in range(out.shape[0]):
        start = first + update * samples
        history = min(start, most)
        terms = history + samples
        fit(x, start - history, fits[history], terms, terms, 0.5, c)
        term[:] = 0.0
        term[0, 0] = 1.0
        length = 1
        total = np.zeros(4)
        total[0] = 1.0
        for _ in range(iterations):
            raised[:] = 0.0
            for j in range(length):
                for i in range(terms):
                    share = 1.0 / (i + j + 1)
                    ax, ay, az = row(c, i)
                    raised[i + j + 1, 0] -= share * (
                        term[j, 1] * ax + term[j, 2] * ay + term[j, 3] * az
                    )
                    raised[i + j + 1, 1] += share * (
                        term[j, 0] * ax + term[j, 2] * az - term[j, 3] * ay
                    )
                    raised[i + j + 1, 2] += share * (
                        term[j, 0] * ay + term[j, 3] * ax - term[j, 1] * az
                    )
                    raised[i + j + 1, 3] += share * (
                        term[j, 0] * az + term[j, 1] * ay - term[j, 2] * ax
                    )
            length += terms
            for component in range(4):
                at_start = 0.0
                at_end = 0.0
                sign = 1.0
                for k in range(length):
                    at_start += sign * raised[k, component]
                    at_end += raised[k, component]
                    sign = -sign
                raised[0, component] = -at_start
                total[component] += at_end - at_start
            term[:] = raised
        to_rotation_vector(total[0], total[1], total[2], total[3], out, update)
