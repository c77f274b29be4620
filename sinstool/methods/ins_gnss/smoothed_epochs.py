"""Smoothed errors at the rows that a closed-loop error-state filter stored.

The filter of Rauch, Tung and Striebel [1]_ in the form for errors that are fed back. After epoch
`k` the filter has taken its estimate `dx[k]` out of the navigation and expects no error any more.
What all later measurements say of the error that is left is then

    d[k] = G (d[k+1] + dx[k+1]),   G = P+[k] Phi[k+1]^T (P-[k+1])^-1,   d[last] = 0,
    Ps[k] = P+[k] + G (Ps[k+1] - P-[k+1]) G^T,

and the smoothed navigation is that of the filter less `d`. `dx` is the sum of all measurements of
the epoch. Without feedback the same holds for the outputs, of which the estimate is taken off.
Where a filter began anew, what comes later says nothing about what was before: a segment ends
there with d = 0.

References
----------
.. [1] H. E. Rauch, F. Tung, C. T. Striebel, "Maximum likelihood estimates of linear dynamic
   systems", AIAA Journal 3(8), 1965, 1445-1450.
.. [2] P. D. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
   Systems", 2nd ed., 2013, section 3.4.5.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.methods.ins_gnss.rts import Packed, room, smooth_backward
from sinstool.methods.ins_gnss.states import GNSS_POSITION, FilterKind

# Bytes of rows that are smoothed before their memory is given back.
AT_ONCE = 16 << 20
# Of a row, what is kept as it is
OF_ROWS = ("time_ns", "update", "correction", "estimate", "nav", "restart")


@dataclass(frozen=True)
class SmoothedEpochs:
    """Smoothed answers at the rows that a filter stored.

    Attributes
    ----------
    time_ns, update : ndarray of int64, shape (m,)
        As stored.
    error : ndarray, shape (m, n)
        `d`: what the filter's answer after the row still has of error.
    error_before : ndarray, shape (m, n)
        The same just before the row's measurements; zeros where the row starts a segment.
    covariance : ndarray, shape (m, n, n) or (m, CORNER, CORNER)
        A smoother of updates keeps those of position, velocity and attitude alone.
    fix_error, fix_variance : ndarray, shape (m, 3)
        The slow error of fixes, NED, m (zeros where the filter has no such states), and the
        variance of the position less it, m^2: with the white noise of a fix, that of its distance.
    starts : ndarray of bool, shape (m,)
        The row starts a segment.
    first_error, first_covariance : ndarray, shape (n,), (n, n)
        At the start of the run, carried back from row 0 without process noise.
    start_ns : int
        Of the run.
    """

    time_ns: IntArray
    update: IntArray
    error: FloatArray
    error_before: FloatArray
    covariance: FloatArray
    fix_error: FloatArray
    fix_variance: FloatArray
    starts: np.ndarray
    first_error: FloatArray
    first_covariance: FloatArray
    start_ns: int
    kind: FilterKind

    def __len__(self) -> int:
        return len(self.time_ns)


def smooth_columns(
    columns: dict[str, Any],
    packed: Packed,
    kind: FilterKind,
    start_ns: int | None,
    release: Callable[[], None] = lambda: None,
    whole: FloatArray | None = None,
) -> SmoothedEpochs:
    """Smooth packed rows in place: `error` is written over ``estimate``, and so on.

    Parameters
    ----------
    columns : dict of str to ndarray
        Those of :class:`StoredEpochs` that `OF_ROWS` names.
    release : callable, optional
        Called after each few rows, to give back the memory of those.
    whole : ndarray, shape (m, n, n), optional
        Gets the covariances of all states.
    """
    m, n = len(columns["time_ns"]), kind.size
    # As plain arrays, of which there is a slice for each few rows
    packed = Packed(*(np.asarray(column) for column in packed))
    error, error_before = (np.asarray(columns[name]) for name in ("estimate", "correction"))
    starts = np.array(columns["restart"])
    error_before[starts] = 0.0
    after = np.empty((n, n))
    work, change, lines, order = room(n)
    none = np.empty((0, n, n))
    slow, fix_variance = kind.first(GNSS_POSITION), np.empty((m, 3))
    fix_error = np.zeros((m, 3)) if slow < 0 else error[:, slow : slow + 3].copy()
    rows = max(1, AT_ONCE // (8 * sum(int(column[0].size) for column in packed)))
    end = m
    while end > 0:
        begin = max(0, end - rows)
        # The row behind, which is smoothed already, ends the rows of the loop as the log's last
        # does. All that it has to say is its covariance, and its error before its measurements.
        piece = slice(begin, min(end + 1, m))
        d = np.empty((piece.stop - begin, n))
        smooth_backward(
            *packed.rows(piece),
            error_before[piece],
            starts[piece],
            end == m,
            after,
            work,
            change,
            lines,
            order,
            d,
            slow,
            fix_variance[piece],
            none if whole is None else whole[piece],
        )
        d = d[: end - begin]
        error[begin:end] = d
        if slow >= 0:
            fix_error[begin:end] += d[:, slow : slow + 3]
        error_before[begin:end] = np.where(
            starts[begin:end, None], 0.0, d + error_before[begin:end]
        )
        release()
        end = begin
    if starts[0]:
        first, first_covariance = np.zeros(n), after
    else:
        # Decaying states cannot vanish, so that a transition can always be taken back.
        back = np.linalg.inv(packed.first_transition())
        first, first_covariance = back @ error_before[0], back @ after @ back.T
    return SmoothedEpochs(
        np.array(columns["time_ns"]),
        np.array(columns["update"]),
        error,
        error_before,
        packed.corner if whole is None else whole,
        fix_error,
        fix_variance,
        starts,
        first,
        first_covariance,
        int(columns["time_ns"][0]) if start_ns is None else start_ns,
        kind,
    )
