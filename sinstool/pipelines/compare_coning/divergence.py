"""Angle between two attitudes: per window, with confidence, and over the run."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, sqrt

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.parts import njit
from sinstool.core.quaternion_kernels import product, to_rotation_vector
from sinstool.pipelines.compare_coning.runs import Attitudes, Candidate

IN_DEG_H = float(np.degrees(1.0)) * 3600.0  # of a rate in rad/s
# More instants in common than this are thinned evenly: slopes and extremes gain nothing.
_MOST = 1 << 19


@dataclass(frozen=True)
class CandidateDivergence:
    """Divergence of one candidate from the reference, in the reference's own frame.

    Attributes
    ----------
    window_rate : ndarray, shape (w, 3)
        psi at the end of each window over its length, rad/s.
    window_slope : ndarray, shape (w, 3)
        Least-squares slope of psi in each window, rad/s: the same as `window_rate` where psi
        grows evenly, but hardly moved by what only swings to and fro, such as the noise that
        two interpolations place differently within a sample.
    window_start_s, window_length_s : ndarray, shape (w,)
        From the segment's start.
    slope : ndarray, shape (3,)
        Least-squares slope of psi over the whole run, rad/s.
    end : ndarray, shape (3,)
        psi at the end of the run, rad.
    largest : float
        Largest norm of psi during the run, rad.
    time_s, norm : ndarray, shape (k,)
        Norm of psi against time, for the figure, thinned.
    """

    window_rate: FloatArray
    window_slope: FloatArray
    window_start_s: FloatArray
    window_length_s: FloatArray
    slope: FloatArray
    end: FloatArray
    largest: float
    time_s: FloatArray
    norm: FloatArray


def part(
    candidate: Attitudes,
    reference: Attitudes,
    time_ns: IntArray,
    window_s: float,
    points: int = 2000,
) -> CandidateDivergence | None:
    """Divergence at the instants that both have.

    Parameters
    ----------
    candidate, reference : Attitudes
        Of the same segment.
    time_ns : ndarray of int64
        Times of the segment's native samples.
    window_s : float
        The candidate is set to the reference at the start of each window of this length.
    points : int
        Most points kept for the figure.

    Returns
    -------
    CandidateDivergence or None
        None where they have fewer than two instants in common.

    Notes
    -----
    ``psi = log(q_i q_ref^-1)`` with ``q_i`` restarted: restarting at t0 is the left product
    with ``q_ref(t0) q_i(t0)^-1``, so one run of each serves every window.
    """
    mine, theirs = _shared(candidate.sample, reference.sample)
    if len(mine) < 2:
        return None
    if len(mine) > _MOST:
        rows_shown = np.arange(0, len(mine), -(-len(mine) // _MOST))
        if rows_shown[-1] != len(mine) - 1:
            rows_shown = np.append(rows_shown, len(mine) - 1)
        mine, theirs = mine[rows_shown], theirs[rows_shown]
    at = time_ns[candidate.sample[mine]]
    seconds = (at - at[0]) / 1e9
    edges = _edges(seconds, window_s)
    rows = np.array([0, len(seconds) - 1])
    whole = np.empty((len(seconds), 3))
    _psi(candidate.q, reference.q, mine, theirs, rows, whole)
    norm = np.sqrt(np.einsum("ij,ij->i", whole, whole))
    slope = _slopes(seconds, whole, rows)[0]
    end, largest = whole[-1].copy(), float(norm.max())
    keep = np.unique(np.linspace(0, len(seconds) - 1, min(points, len(seconds))).astype(int))
    windows = np.empty_like(whole)
    _psi(candidate.q, reference.q, mine, theirs, edges, windows)
    length = np.diff(seconds[edges])
    return CandidateDivergence(
        windows[edges[1:]] / length[:, None],
        _slopes(seconds, windows, edges),
        seconds[edges[:-1]],
        length,
        slope,
        end,
        largest,
        seconds[keep],
        norm[keep],
    )


@njit(cache=True, nogil=True)
def _merge(first: IntArray, second: IntArray, mine: IntArray, theirs: IntArray) -> int:
    """Places of equal numbers in two increasing columns; how many there are."""
    i = j = count = 0
    while i < first.shape[0] and j < second.shape[0]:
        if first[i] == second[j]:
            mine[count] = i
            theirs[count] = j
            count += 1
            i += 1
            j += 1
        elif first[i] < second[j]:
            i += 1
        else:
            j += 1
    return count


def _shared(first: IntArray, second: IntArray) -> tuple[IntArray, IntArray]:
    """Places of the instants that two runs share."""
    size = min(len(first), len(second))
    mine, theirs = np.empty(size, np.int64), np.empty(size, np.int64)
    count = _merge(first, second, mine, theirs)
    return mine[:count], theirs[:count]


@njit(cache=True, nogil=True)
def _relative(p: FloatArray, q: FloatArray) -> tuple[float, float, float, float]:
    """``p q^-1``."""
    return (
        p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3],
        p[1] * q[0] - p[0] * q[1] - p[2] * q[3] + p[3] * q[2],
        p[2] * q[0] - p[0] * q[2] - p[3] * q[1] + p[1] * q[3],
        p[3] * q[0] - p[0] * q[3] - p[1] * q[2] + p[2] * q[1],
    )


@njit(cache=True, nogil=True)
def _psi(
    q: FloatArray, r: FloatArray, mine: IntArray, theirs: IntArray, edges: IntArray, out: FloatArray
) -> None:
    """``log(q r^-1)``, `q` set to `r` at each edge; an edge itself belongs to the window it ends.

    The first edge is 0.
    """
    out[edges[0], :] = 0.0
    for w in range(edges.shape[0] - 1):
        a = edges[w]
        # r_a q_a^-1 q_k r_k^-1: the turn at the edge on the left of that at k
        tw, tx, ty, tz = _relative(r[theirs[a]], q[mine[a]])
        for k in range(a + 1, edges[w + 1] + 1):
            dw, dx, dy, dz = _relative(q[mine[k]], r[theirs[k]])
            c, x, y, z = product(tw, tx, ty, tz, dw, dx, dy, dz)
            sign = -1.0 if c < 0.0 else 1.0
            to_rotation_vector(sign * c, sign * x, sign * y, sign * z, out, k)


@njit(cache=True, nogil=True)
def _widest(q: FloatArray, r: FloatArray, mine: IntArray, theirs: IntArray) -> float:
    """Largest angle of ``q r^-1`` against its first."""
    tw, tx, ty, tz = _relative(r[theirs[0]], q[mine[0]])
    sine, cosine = 0.0, 1.0
    for k in range(mine.shape[0]):
        dw, dx, dy, dz = _relative(q[mine[k]], r[theirs[k]])
        w, x, y, z = product(tw, tx, ty, tz, dw, dx, dy, dz)
        norm = sqrt(x * x + y * y + z * z)
        # of two half angles up to a quarter turn, the larger has the larger tangent
        if norm * cosine > sine * abs(w):
            sine, cosine = norm, abs(w)
    return 2.0 * atan2(sine, cosine)


def _slopes(seconds: FloatArray, psi: FloatArray, edges: IntArray) -> FloatArray:
    """Least-squares slope of psi in each window, psi being 0 where the window begins."""
    out = np.empty((len(edges) - 1, 3))
    for w, (a, b) in enumerate(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)):
        centred = seconds[a : b + 1] - seconds[a : b + 1].mean()
        out[w] = centred[1:] @ psi[a + 1 : b + 1] / (centred @ centred)
    return out


def _edges(seconds: FloatArray, window_s: float) -> IntArray:
    """Indices of window edges: the first instant at or after each multiple of the window.

    A remainder shorter than half a window is left out, unless it is all there is.
    """
    count = int(seconds[-1] // window_s)
    edges_s = np.arange(count + 1) * window_s
    edges = np.unique(np.searchsorted(seconds, edges_s - 1e-9))
    edges = edges[edges < len(seconds)]
    if len(edges) < 2 or seconds[-1] - seconds[edges[-1]] >= 0.5 * window_s:
        edges = np.unique(np.append(edges, len(seconds) - 1))
    return edges.astype(np.int64)


@dataclass(frozen=True)
class DriftStatistics:
    """Drift of all windows of all segments together, deg/h.

    Attributes
    ----------
    mean, confidence, rms, p95, max : ndarray, shape (3,)
        Per axis, of the window-end rate; the confidence is two standard deviations of the mean.
    norm_rms : float
        Root mean square of the length of the window-end rate.
    slope_rms : float
        Root mean square of the length of the slope in each window.
    """

    windows: int
    mean: FloatArray
    confidence: FloatArray
    rms: FloatArray
    p95: FloatArray
    max: FloatArray
    norm_rms: float
    slope_rms: float


@dataclass(frozen=True)
class Row:
    """One candidate's result.

    Attributes
    ----------
    drift_dph : DriftStatistics or None
        None where it has no instants in common with the reference.
    end_deg, slope_dph : ndarray, shape (3,)
        psi at the run's end (all segments added), and its slope over the longest segment.
    largest_deg : float
        Largest norm of psi in any segment.
    ns_per_sample : float
        Processor time for each sample it was fed.
    resolved : bool
        Its divergence is well above what the reference itself can be trusted to.
    curves : tuple of CandidateDivergence
        Per segment, for figures.
    """

    candidate: Candidate
    update_hz: float
    drift_dph: DriftStatistics | None
    end_deg: FloatArray
    slope_dph: FloatArray
    largest_deg: float
    ns_per_sample: float
    resolved: bool
    curves: tuple[CandidateDivergence, ...]


def statistics(window_rates: FloatArray, window_slopes: FloatArray) -> DriftStatistics:
    """Statistics of the drift in windows.

    Parameters
    ----------
    window_rates, window_slopes : ndarray, shape (w, 3)
        rad/s.
    """
    d = window_rates * IN_DEG_H
    n = len(d)
    # With one window nothing is known of the spread.
    spread = d.std(axis=0, ddof=1) if n > 1 else np.full(3, np.nan)
    size = np.abs(d)
    return DriftStatistics(
        n,
        d.mean(axis=0),
        2.0 * spread / np.sqrt(n),
        np.sqrt(np.mean(d**2, axis=0)),
        np.percentile(size, 95, axis=0),
        size.max(axis=0),
        float(np.sqrt(np.mean(np.sum(d**2, axis=1)))),
        float(np.sqrt(np.mean(np.sum((window_slopes * IN_DEG_H) ** 2, axis=1)))),
    )


def widest_gap(first: Attitudes, second: Attitudes) -> float:
    """Largest angle between two runs of a segment, rad; NaN without two common instants."""
    mine, theirs = _shared(first.sample, second.sample)
    if len(mine) < 2:
        return float("nan")
    return float(_widest(first.q, second.q, mine, theirs))
