"""How far two attitudes part: per window, with confidence, and over the whole run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sinstool.comparison.runs import Attitudes
from sinstool.rotation import conjugate, log, multiply

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

DEG_H = np.degrees(1.0) * 3600.0


@dataclass(frozen=True)
class Parting:
    """Divergence of one candidate from the reference, in the reference's own frame.

    Attributes
    ----------
    window_rate : ndarray, shape (w, 3)
        psi at the end of each window over its length, rad/s.
    window_start_s : ndarray, shape (w,)
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
    window_start_s: FloatArray
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
) -> Parting | None:
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
    Parting or None
        None where they have fewer than two instants in common.

    Notes
    -----
    ``psi = log(q_i q_ref^-1)`` with ``q_i`` restarted: restarting at t0 is the left product
    with ``q_ref(t0) q_i(t0)^-1``, so one run of each serves every window.
    """
    common, mine, theirs = np.intersect1d(
        candidate.sample, reference.sample, assume_unique=True, return_indices=True
    )
    if len(common) < 2:
        return None
    q, r = candidate.q[mine], reference.q[theirs]
    seconds = (time_ns[common] - time_ns[common[0]]) / 1e9
    whole = _psi(q, r, 0)
    norm = np.linalg.norm(whole, axis=1)
    edges = _edges(seconds, window_s)
    a, b = edges[:-1], edges[1:]
    turn = multiply(r[a], conjugate(q[a]))
    ends = log(multiply(multiply(turn, q[b]), conjugate(r[b])))
    length = seconds[b] - seconds[a]
    centred = seconds - seconds.mean()
    slope = centred @ whole / (centred @ centred)
    keep = np.unique(np.linspace(0, len(seconds) - 1, min(points, len(seconds))).astype(int))
    return Parting(
        ends / length[:, None],
        seconds[a],
        slope,
        whole[-1],
        float(norm.max()),
        seconds[keep],
        norm[keep],
    )


def _psi(q: FloatArray, r: FloatArray, start: int) -> FloatArray:
    turn = multiply(r[start], conjugate(q[start]))
    return np.asarray(log(multiply(multiply(turn, q), conjugate(r))))


def _edges(seconds: FloatArray, window_s: float) -> IntArray:
    """Indices of window edges: the first instant at or after each multiple of the window.

    A remainder shorter than half a window is left out, unless it is all there is.
    """
    count = int(seconds[-1] // window_s)
    wanted = np.arange(count + 1) * window_s
    edges = np.unique(np.searchsorted(seconds, wanted - 1e-9))
    edges = edges[edges < len(seconds)]
    if len(edges) < 2 or seconds[-1] - seconds[edges[-1]] >= 0.5 * window_s:
        edges = np.unique(np.append(edges, len(seconds) - 1))
    return edges.astype(np.int64)


@dataclass(frozen=True)
class DriftStatistics:
    """Window-end drift rates of all segments together, deg/h.

    Attributes
    ----------
    windows : int
    mean, confidence, rms, p95, largest : ndarray, shape (3,)
        Per axis; the confidence is two standard deviations of the mean.
    norm_rms : float
        Of the vector.
    """

    windows: int
    mean: FloatArray
    confidence: FloatArray
    rms: FloatArray
    p95: FloatArray
    largest: FloatArray
    norm_rms: float


def statistics(window_rates: FloatArray) -> DriftStatistics:
    """Statistics of window-end drift rates.

    Parameters
    ----------
    window_rates : ndarray, shape (w, 3)
        rad/s.
    """
    d = window_rates * DEG_H
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
    )


def widest_gap(first: Attitudes, second: Attitudes) -> float:
    """Largest angle between two runs of a segment, rad; NaN without two common instants."""
    common, mine, theirs = np.intersect1d(
        first.sample, second.sample, assume_unique=True, return_indices=True
    )
    if len(common) < 2:
        return float("nan")
    psi = _psi(first.q[mine], second.q[theirs], 0)
    return float(np.linalg.norm(psi, axis=1).max())
