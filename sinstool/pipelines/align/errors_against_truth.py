"""What is wrong with an alignment, where a reference tells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.rotation import conjugate, log, multiply, rotate
from sinstool.core.timeline import SECOND
from sinstool.io.readers.truth import at_times
from sinstool.methods.alignment.inflight import InFlightAlignment


@dataclass(frozen=True)
class ErrorCourse:
    """Errors at the fixes that the reference covers.

    Attributes
    ----------
    seconds : ndarray, shape (n,)
        Since the log's start.
    series : ndarray, shape (n, 3)
        Of the solution from what came before each fix: about north, east, down, rad.
    final : ndarray, shape (n, 3)
        Of the final answer, carried to each fix; NaN where it cannot be.
    sigma_worst : ndarray, shape (n,)
        Of the series, rad.
    """

    seconds: np.ndarray
    series: np.ndarray
    final: np.ndarray
    sigma_worst: np.ndarray


def errors(answers: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Small rotations in NED by which attitudes are wrong.

    Parameters
    ----------
    answers, true : ndarray, shape (n, 4)
        q_nb.

    Returns
    -------
    ndarray, shape (n, 3)
        psi with ``answer = (I + [psi x]) true``, rad.
    """
    return np.asarray(log(multiply(answers, conjugate(true))))


def tilt_errors(answers: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Errors about north and east alone, whatever the headings are.

    Parameters
    ----------
    answers, true : ndarray, shape (n, 4)
        q_nb.

    Returns
    -------
    ndarray, shape (n, 2)
        rad.
    """
    down = np.broadcast_to([0.0, 0.0, 1.0], (len(answers), 3))
    seen = rotate(answers, rotate(conjugate(true), down))
    return np.stack([-seen[:, 1], seen[:, 0]], axis=1)


def error_course(
    answer: InFlightAlignment, time_ns: np.ndarray, q_nb: np.ndarray, first_ns: int
) -> ErrorCourse | None:
    """Errors of the series and of the final answer; None where the reference covers no fix.

    Parameters
    ----------
    answer : InFlightAlignment
        With its series.
    time_ns : ndarray of int64, shape (k,)
        Of the reference, increasing.
    q_nb : ndarray, shape (k, 4)
    first_ns : int
        Time of the log's first sample.
    """
    series = answer.series
    assert series is not None
    times = series.time_ns
    inside = (times >= time_ns[0]) & (times <= time_ns[-1]) & np.isfinite(series.sigma_worst)
    if not inside.any():
        return None
    true = at_times(time_ns, q_nb, times[inside])
    final = np.full((int(inside.sum()), 3), np.nan)
    if answer.status not in ("failed", "unobservable"):
        final = errors(answer.attitude_at(times[inside]), true)
    return ErrorCourse(
        (times[inside] - first_ns) / SECOND,
        errors(series.q_nb[inside], true),
        final,
        series.sigma_worst[inside],
    )
