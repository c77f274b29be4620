"""The backward recursion of the smoother over packed rows, compiled.

A row of a filter of n states has three matrices of n x n, of which less than half says anything:
covariances are symmetric, and states that do not move only decay. A smoother that has more of them
than memory should hold writes and reads all that it keeps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray, zeros_on_lines
from sinstool.core.parts import kernel, part
from sinstool.methods import products
from sinstool.methods.ins_gnss.results import StoredEpochs
from sinstool.methods.ins_gnss.states import ATTITUDE, I_MOVING, POSITION, FilterKind
from sinstool.methods.rts import COLUMNS, ROWS, smoothed_change, smoother_gain

CORNER = ATTITUDE + 3
"""Of position, velocity and attitude, which come first among the states."""


class Packed(NamedTuple):
    """Matrices of stored rows without what follows from the rest of them.

    Attributes
    ----------
    moving : ndarray, shape (m, moving states, n)
        Rows of the transitions; of the others the diagonal says all.
    decay : ndarray, shape (m, n - moving states)
        That diagonal.
    before : ndarray, shape (m, n (n + 1) / 2)
        Lower triangles of the covariances before the measurements.
    corner : ndarray, shape (m, CORNER, CORNER)
        Of the covariances after them, the states that come first.
    rest : ndarray, shape (m, n (n + 1) / 2 - CORNER (CORNER + 1) / 2)
        What their lower triangles have below that.
    """

    moving: FloatArray
    decay: FloatArray
    before: FloatArray
    corner: FloatArray
    rest: FloatArray

    def rows(self, part: slice) -> Packed:
        """Some of the rows."""
        return Packed(*(column[part] for column in self))

    def first_transition(self) -> FloatArray:
        """The transition to the first row, shape (n, n)."""
        still = self.moving.shape[1]
        whole = np.diag(np.concatenate([np.zeros(still), self.decay[0]]))
        whole[:still] = self.moving[0]
        return whole


def pack(stored: StoredEpochs, kind: FilterKind) -> Packed:
    """Pack the matrices of stored rows.

    Raises
    ------
    ValueError
        If they are those of a filter with another number of states.
    """
    m, n, moving = len(stored), kind.size, int(kind.index[I_MOVING])
    if stored.correction.shape[1] != n:
        raise ValueError(f"Expected {n} states of {kind.name}, got {stored.correction.shape[1]}.")
    triangle, first = n * (n + 1) // 2, CORNER * (CORNER + 1) // 2
    shapes = ((moving, n), (n - moving,), (triangle,), (CORNER, CORNER), (triangle - first,))
    packed = Packed(*(np.empty((m, *shape)) for shape in shapes))
    _pack(stored.transition, stored.covariance_before, stored.covariance_after, *packed)
    return packed


@kernel()
def _pack(
    transition: FloatArray,
    p_minus: FloatArray,
    p_plus: FloatArray,
    moving: FloatArray,
    decay: FloatArray,
    before: FloatArray,
    corner: FloatArray,
    rest: FloatArray,
) -> None:
    rows, n, _ = transition.shape
    moves = moving.shape[1]
    for k in range(rows):
        for i in range(moves):
            for j in range(n):
                moving[k, i, j] = transition[k, i, j]
        for i in range(moves, n):
            decay[k, i - moves] = transition[k, i, i]
        at = 0
        for i in range(n):
            for j in range(i + 1):
                before[k, at + j] = p_minus[k, i, j]
            at += i + 1
        for i in range(CORNER):
            for j in range(CORNER):
                corner[k, i, j] = p_plus[k, i, j]
        at = 0
        for i in range(CORNER, n):
            for j in range(i + 1):
                rest[k, at + j] = p_plus[k, i, j]
            at += i + 1


@part()
def _unpack(packed: FloatArray, first: int, n: int, out: FloatArray) -> None:
    """Symmetric matrix of `n` rows by its lower triangle, from a row on."""
    at = 0
    for i in range(first, n):
        for j in range(i + 1):
            out[i, j] = packed[at + j]
            out[j, i] = packed[at + j]
        at += i + 1


@part()
def _unpack_after(corner: FloatArray, rest: FloatArray, n: int, out: FloatArray) -> None:
    """Covariance after the measurements of a row."""
    for i in range(CORNER):
        for j in range(CORNER):
            out[i, j] = corner[i, j]
    _unpack(rest, CORNER, n, out)


@part()
def _keep(after: FloatArray, corner: FloatArray) -> None:
    for i in range(len(corner)):
        for j in range(len(corner)):
            corner[i, j] = after[i, j]


@part()
def _compare(after: FloatArray, slow: int, variance: FloatArray) -> None:
    """Variance of the position's error less the slow one of fixes."""
    for i in range(3):
        p = POSITION + i
        variance[i] = after[p, p]
        if slow >= 0:
            variance[i] += after[slow + i, slow + i] - 2.0 * after[p, slow + i]


@part()
def _driven_first(plus: FloatArray, minus: FloatArray, decay: FloatArray, order: IntArray) -> int:
    """Put states that noise drives before others, whose errors stay as they are; how many."""
    n = len(order)
    moves = n - len(decay)
    count, other = 0, n
    for i in range(n):
        if i >= moves and decay[i - moves] == 1.0 and plus[i, i] == minus[i, i]:
            other -= 1
            order[other] = i
        else:
            order[count] = i
            count += 1
    return count


def room(n: int) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
    """Scratch of :func:`smooth_backward` for so many states."""
    even, width = n + -n % ROWS, n + -n % COLUMNS
    shapes = (6, even, width), (width, width), (2, width)
    work, change, lines = (zeros_on_lines(shape) for shape in shapes)
    return work, change, lines, np.empty(n, dtype=np.int64)


@kernel()
def smooth_backward(
    moving: FloatArray,
    decay: FloatArray,
    before: FloatArray,
    corner: FloatArray,
    rest: FloatArray,
    correction: FloatArray,
    starts: np.ndarray,
    begins: bool,
    after: FloatArray,
    work: FloatArray,
    change: FloatArray,
    lines: FloatArray,
    order: IntArray,
    d: FloatArray,
    slow: int,
    fix_variance: FloatArray,
    whole: FloatArray,
) -> None:
    """Smooth from the last row to the first.

    Parameters
    ----------
    moving, decay, before, corner, rest : ndarray
        Of :class:`Packed`; `corner` becomes that of the smoothed covariances.
    correction : ndarray, shape (m, n)
        What the measurements of the row added to the estimate.
    starts : ndarray of bool, shape (m,)
        Nothing may be taken across from this row to the one before.
    begins : bool
        The last row is that of the run; otherwise it is smoothed already.
    after : ndarray, shape (n, n)
        Smoothed covariance of the last row, unless it is that of the run; becomes the first's.
    work, change, lines, order : ndarray
        Of :func:`room`.
    d : ndarray, shape (m, n)
        Gets what later rows add to the estimate of each.
    slow : int
        First of the states of the fixes' slow errors; negative where there are none.
    fix_variance : ndarray, shape (m, 3)
        Gets the variance of the position less the slow error, which is what a fix compares, but
        for that of a last row that is smoothed already.
    whole : ndarray, shape (m, n, n), or without rows
        Gets the smoothed covariances, but for that of a last row that is smoothed already.
    """
    n, moves = d.shape[1], moving.shape[1]
    last = d.shape[0] - 1
    gain, some, product, minus, plus, up = work[0], work[1], work[2], work[3], work[4], work[5]
    scale, x = lines[0, : len(gain)], lines[1]
    for i in range(n):
        d[last, i] = 0.0
    if begins:
        _unpack_after(corner[last], rest[last], n, after)
        _compare(after, slow, fix_variance[last])
        if len(whole) > 0:
            _keep(after, whole[last])
    for k in range(last - 1, -1, -1):
        following = k + 1
        if starts[following]:
            for i in range(n):
                d[k, i] = 0.0
            _unpack_after(corner[k], rest[k], n, after)
        else:
            _unpack(before[following], 0, n, minus)
            _unpack_after(corner[k], rest[k], n, plus)
            count = _driven_first(plus, minus, decay[following], order)
            columns = count + -count % COLUMNS
            count = min(columns, n)
            for i in range(n):
                for j in range(count):
                    some[i, j] = plus[i, order[j]]
            products.product(moving[following], some, moves, n, columns, gain)
            for i in range(moves, n):
                for j in range(columns):
                    gain[i, j] = decay[following, i - moves] * some[i, j]
            smoother_gain(minus, columns, gain, up, scale)
            for j in range(columns):
                x[j] = 0.0
            for i in range(n):
                f = d[following, i] + correction[following, i]
                d[k, i] = f
                for j in range(columns):
                    x[j] += f * gain[i, j]
            for j in range(count):
                d[k, order[j]] = x[j]
            smoothed_change(minus, after, columns, gain, product, change)
            for i in range(n):
                at = order[i]
                for j in range(min(i + 1, count)):
                    to = order[j]
                    by = change[i, j] if i < count else -product[at, j]
                    after[at, to] = plus[at, to] + by
                    after[to, at] = after[at, to]
            _keep(after, corner[k])
        _compare(after, slow, fix_variance[k])
        if len(whole) > 0:
            _keep(after, whole[k])
