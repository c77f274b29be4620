"""Sums over whole turns of the table: all of a log that alignment needs, in a few numbers.

With ``v_b0 = Rz(alpha) v_b`` the mean of any vector in ``b0`` follows from the time integrals
of ``v``, ``v cos alpha`` and ``v sin alpha``. Taken of the samples as they are in the log they
hold no calibration at all, so that another calibration, bias or latitude needs no other pass
over the log; another sign or delay of the encoder does.

Whole turns matter: what is fixed to ``b`` (biases, misalignments times the rate of the table)
drops out of them, and a quarter of a turn too many in ten minutes makes 80 arcsec of heading. A
turn ends inside a sample, which is then shared out by the angle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from sinstool.core.errors import AlignmentError
from sinstool.methods.hse.encoder import TableAngle
from sinstool.methods.hse.segments import Segment

FloatArray = NDArray[np.float64]

_TURN = 2.0 * np.pi


@dataclass(frozen=True)
class TurnStatistics:
    """Integrals over N whole turns that follow one another.

    Attributes
    ----------
    S : ndarray, shape (N, 3, 6)
        Integrals over each turn of cos alpha, sin alpha and 1 (rows) times the gyros' and the
        accelerometers' samples (columns): rad and m/s. What is fixed to ``b0`` is smaller
        in them by ``(Omega dt)**2 / 12``, as cosines and sines are means over samples, and once
        more, as samples are.
    circle : ndarray, shape (N, 2)
        Integrals of cos alpha and sin alpha, s; not 0 where the rate varies within a turn.
    duration : ndarray, shape (N,)
        s.
    direction : int
        1 where alpha grows, else -1.
    start_s : float
        Start of the first turn, s after the first gyro stamp of the log.
    interval_s : float
        Of the samples, s.
    jitter_s, wander_s : float
        Of the gyro stamps; see :class:`~sinstool.methods.hse.encoder.TimeGrid`.
    """

    S: FloatArray
    circle: FloatArray
    duration: FloatArray
    direction: int
    start_s: float
    interval_s: float
    jitter_s: float = 0.0
    wander_s: float = 0.0

    def __len__(self) -> int:
        return len(self.duration)

    @property
    def rate(self) -> float:
        """Mean rate of the table over all turns, rad/s, with its sign."""
        return self.direction * _TURN * len(self) / float(self.duration.sum())


def turn_statistics(
    piece: TableAngle, segment: Segment, gyro: ArrayLike, accel: ArrayLike
) -> TurnStatistics:
    """Sums over the whole turns of a segment; what is left at its end is not used.

    Parameters
    ----------
    piece : TableAngle
        The one that the segment lies in.
    segment : Segment
        From :func:`~sinstool.methods.hse.segments.find_segments`.
    gyro, accel : array_like, shape (n, 3)
        All samples of the log as they are in it, rad/s and m/s^2: rows are those that the
        piece counts in.

    Raises
    ------
    AlignmentError
        If there is no whole turn, the angle does not advance at every sample or does so by
        half a turn and more, or a sample is not finite.
    """
    rows = slice(piece.first + segment.first, piece.first + segment.stop)
    g = np.ascontiguousarray(np.asarray(gyro, dtype=np.float64)[rows])
    a = np.ascontiguousarray(np.asarray(accel, dtype=np.float64)[rows])
    n = segment.stop - segment.first
    if g.shape != (n, 3) or a.shape != (n, 3):
        raise ValueError(f"Expected {n} rows of three, got {g.shape} and {a.shape}.")
    alpha = np.ascontiguousarray(piece.alpha[segment.first : segment.stop + 1])
    where = f"from {segment.start_s:.3f} s for {segment.duration_s:.3f} s"
    turned = float(alpha[-1] - alpha[0])
    # an angle that was read a rounding short of a whole turn is a whole turn
    whole = int(np.floor(abs(turned) / _TURN + 1e-12))
    if whole < 1:
        raise AlignmentError(f"no whole turn of the table {where}", "record for longer")
    direction = 1 if turned > 0.0 else -1
    sums = np.zeros((whole, 21))
    fault = _sum_turns(alpha, float(direction), g, a, sums)
    if fault >= 0:
        raise AlignmentError(
            f"the table's angle does not advance steadily at sample {rows.start + fault} ({where})",
            "look at the encoder; readings must grow or fall all along, and come more than "
            "twice in a turn",
        )
    if not np.isfinite(sums).all():
        raise AlignmentError(f"gyro or accelerometer samples are not finite {where}", "drop them")
    sums *= piece.interval_s
    return TurnStatistics(
        S=sums[:, :18].reshape(whole, 3, 6),
        circle=sums[:, 18:20].copy(),
        duration=sums[:, 20].copy(),
        direction=direction,
        start_s=segment.start_s,
        interval_s=piece.interval_s,
        jitter_s=piece.jitter_s,
        wander_s=piece.wander_s,
    )


@njit(cache=True, nogil=True)
def _sum_turns(alpha, direction, gyro, accel, sums):  # type: ignore[no-untyped-def]
    """One pass; columns of ``sums``: six with cos, six with sin, six alone, cos, sin, 1.

    Returns the sample at which the angle stands still, runs back or leaps, else -1.
    """
    half_turn = np.pi
    turn = 0
    turns = sums.shape[0]
    ends = alpha[0] + direction * 2.0 * np.pi
    for k in range(gyro.shape[0]):
        at, to = alpha[k], alpha[k + 1]
        step = (to - at) * direction
        if not 0.0 < step < half_turn:
            return k
        rest = 1.0
        # at most one turn ends here; then the sample is shared out
        for _ in range(2):
            crosses = (to - ends) * direction >= 0.0
            weight = rest
            middle = 0.5 * (at + to)
            if crosses:
                weight = min(rest, (ends - at) * direction / step)
                middle = 0.5 * (at + ends)
            # mean over the part, not the value in its middle: then what is fixed to the body
            # drops out to rounding, however many samples there are in a turn
            h2 = (0.5 * weight * step) ** 2
            mean = weight * (1.0 - h2 / 6.0 * (1.0 - h2 / 20.0 * (1.0 - h2 / 42.0)))
            c = mean * np.cos(middle)
            s = mean * np.sin(middle)
            for j in range(3):
                g = gyro[k, j]
                a = accel[k, j]
                sums[turn, j] += c * g
                sums[turn, 3 + j] += c * a
                sums[turn, 6 + j] += s * g
                sums[turn, 9 + j] += s * a
                sums[turn, 12 + j] += weight * g
                sums[turn, 15 + j] += weight * a
            sums[turn, 18] += c
            sums[turn, 19] += s
            sums[turn, 20] += weight
            if not crosses:
                break
            turn += 1
            if turn == turns:
                return -1
            at = ends
            rest -= weight
            ends = alpha[0] + direction * 2.0 * np.pi * (turn + 1)
    # the last turn ended with the last sample, but for a rounding
    return -1
