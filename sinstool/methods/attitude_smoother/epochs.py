"""Epochs: samples at full rate condensed for a filter at 5 Hz.

Integrated attitudes turn the specific force into navigation axes; its sums over an epoch, and what
a bias of the gyros would do to the attitude meanwhile, are all that the filter sees of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.memory import joined
from sinstool.core.parts import kernel, part
from sinstool.core.quaternion_kernels import dcm, to_unit
from sinstool.core.streams import Solution
from sinstool.core.timeline import SECOND
from sinstool.methods.attitude_smoother.model import EPOCH_S

# Columns of an epoch
DURATION, GAP, JB, W2, SATURATED, REST = 0, 1, 8, 17, 18, 19
# Not literals: each would be a type of its own to numba where it is passed on
DV: Any
DP: Any
DV, DP = map(np.int64, (2, 5))
GYRO, ACCEL, GYRO_VARIANCE, ACCEL_VARIANCE, COUNT = 20, 23, 26, 29, 32
OWN_RATE, SWAY_RATE, SWAY_FORCE, RATE_DOUBT = 33, 34, 35, 36
TURNED: Any = np.int64(37)
TURN_DOUBT, FORCE_DOUBT, UNEVEN, OWN_VARIANCE = 40, 41, 42, 43
WIDTH = 44
# Kinds of epochs: a quiet one does not turn, a steady one does not accelerate either, and one at
# rest does not move.
MOVING, QUIET, STEADY, AT_REST = range(4)
# This many consecutive samples at the largest rate of an axis are a saturated gyro.
STOP_RUN = 3
# The noise of filtered samples is alike for some of them, but hardly for as long as this part of an
# epoch: means over such parts show how well the mean of the epoch is known.
PART_S = 0.25 * EPOCH_S
# The path of a vehicle turns with its axes averaged over this many epochs, without their wobble.
WAY_TURNS = 25
# A turn as long and as fast as this (s, rad/s) looks like a gyro's bias, unless a rest shows that.
TURN_S, TURN_RATE = 30.0, 0.01


@dataclass(frozen=True)
class Epochs:
    """Epochs of a log, in order; a gap is an epoch of its own.

    Attributes
    ----------
    time_ns : ndarray of int64, shape (n + 1,)
        Where each begins, and the end of the last.
    values : ndarray, shape (n, WIDTH)
        Duration (s), length of the gap (s; 0: none); in navigation axes the velocity (m/s) and
        position (m) that the specific force adds and the integral of the attitude matrix (s);
        integral of the squared rate (rad^2/s), seconds with a gyro at its stop, whether at rest
        (see `rest`); in body axes means and variances of rate against NED and specific force; how
        many samples; at rest, the variance of an axis' mean rate by its noise, and those of the
        mean rate and the mean specific force from epoch to epoch; where a rest is to be confirmed,
        how far sway may have left the mean rate from the bias, as a variance; in navigation axes
        the angle turned (rad), a mean over `WAY_TURNS` epochs; variances of a turn about the
        vertical that looks like none, and of an acceleration that does; square of the angle by
        which uneven stamps and an even clock differ (rad^2); the variance of an axis' mean rate by
        noise that lasts for less than `PART_S`.
    omega_in_n : ndarray, shape (3,)
        What the integration took for the rate of NED, rad/s.
    """

    time_ns: np.ndarray
    values: FloatArray
    omega_in_n: FloatArray = field(default_factory=lambda: np.zeros(3))

    def __len__(self) -> int:
        return len(self.values)

    @property
    def rest(self) -> np.ndarray:
        """Which do not turn, so that the bias shows, shape (n,)."""
        return self.values[:, REST] > MOVING

    @property
    def at_rest(self) -> np.ndarray:
        """Which stand still, shape (n,)."""
        return self.values[:, REST] == AT_REST

    @property
    def gap(self) -> np.ndarray:
        """Which are gaps, shape (n,)."""
        return self.values[:, GAP] > 0.0


class EpochStage:
    """Epochs from blocks of integrated attitude; what it gives does not depend on the blocks.

    Parameters
    ----------
    max_gap_ns : int
        Longest interval that is no gap.
    stops : ndarray, shape (2, 3) or (3,)
        Rates from which on the gyros are at their stops, rad/s, positive and negative or both;
        infinite where they have none.
    sample_rate : float, optional
        Of the solutions, Hz, whatever their stamps say; but for gaps.
    point_samples : bool, optional
        A specific force is that at its stamp, not the mean since the sample before.
    omega_in_n : ndarray, shape (3,), optional
        What the integration took for the rate of NED, rad/s. It is taken off the body's rate too,
        or a rest would show it as bias.
    """

    def __init__(
        self,
        max_gap_ns: int,
        stops: FloatArray,
        sample_rate: float | None = None,
        point_samples: bool = False,
        omega_in_n: FloatArray | None = None,
    ) -> None:
        self._point_samples = point_samples
        self._max_gap_s = max_gap_ns / SECOND
        self._interval = 0.0 if sample_rate is None else 1.0 / sample_rate
        self._stops = np.array(np.broadcast_to(stops, (2, 3)), np.float64)
        self._omega_in_n = np.zeros(3) if omega_in_n is None else np.asarray(omega_in_n, np.float64)
        self._origin: int | None = None
        self._open = np.zeros(WIDTH)
        # of the sample before: attitude, time, epoch, runs at the stops and their length, force; of
        # its part of the epoch: number, samples, sum of rates; parts that are closed
        self._state = np.zeros(22)
        self._closed: list[FloatArray] = []
        self._ends: list[np.ndarray] = []

    def push(self, solution: Solution) -> None:
        """Take the next solutions.

        Parameters
        ----------
        solution : Solution
            Its rate is that of the body, corrected for the bias, its specific force as measured.
        """
        times = solution.time_ns
        begins = self._origin is None
        if self._origin is None:
            self._origin = int(times[0])
        seconds = (times - self._origin) / SECOND
        rows = np.empty((2 * len(times) + 2, WIDTH))
        ends = np.empty(len(rows))
        made = _accumulate(
            seconds,
            solution.q_nb,
            solution.omega_ib_b,
            solution.specific_force_b,
            begins,
            self._max_gap_s,
            self._interval,
            self._point_samples,
            self._stops,
            self._omega_in_n,
            self._open,
            self._state,
            rows,
            ends,
        )
        if made:
            self._closed.append(rows[:made].copy())
            self._ends.append(ends[:made].copy())

    def finish(self) -> Epochs:
        """All epochs, the open one included; the stage has none of them any more."""
        rows, ends = self._closed, self._ends
        self._closed, self._ends = [], []
        if self._open[COUNT] > 0.0:
            row = self._open.copy()
            _close(row, self._state)
            rows.append(row[None, :])
            ends.append(np.array([self._state[4]]))
        values = joined(rows) if rows else np.empty((0, WIDTH))
        _note_turns(values)
        seconds = np.concatenate([[0.0], *ends])
        times = (self._origin or 0) + np.rint(seconds * SECOND).astype(np.int64)
        return Epochs(times, values, self._omega_in_n)


def _note_turns(values: FloatArray) -> None:
    """Set the angles turned, without turns to and fro within some seconds."""
    turned = values[:, JB : JB + 9].reshape(-1, 3, 3)
    angle = np.einsum("nij,nj->ni", turned, values[:, GYRO : GYRO + 3])
    piece = np.cumsum(values[:, GAP] > 0.0)
    for rows in np.split(np.arange(len(values)), np.flatnonzero(np.diff(piece)) + 1):
        values[rows, TURNED : TURNED + 3] = turns_of_way(angle[rows])


def turns_of_way(angle: FloatArray) -> FloatArray:
    """Angles turned in consecutive epochs, averaged over `WAY_TURNS`, shape (n, m): the path's."""
    wide = min(WAY_TURNS, len(angle))
    if not wide:
        return angle
    before = wide // 2
    padded = np.pad(angle, ((before, wide - 1 - before), (0, 0)), "symmetric")
    sums = np.cumsum(np.vstack([np.zeros(angle.shape[1]), padded]), axis=0)
    return np.asarray((sums[wide:] - sums[:-wide]) / wide)


@part()
def _close_part(row: FloatArray, state: FloatArray) -> None:
    """Add what the mean of a part of the epoch is to the sum of their squares."""
    if state[17] > 0.0:
        for a in range(3):
            row[OWN_VARIANCE] += state[18 + a] ** 2 / state[17]
            state[18 + a] = 0.0
        state[17] = 0.0
        state[21] += 1.0


@part()
def _close(row: FloatArray, state: FloatArray) -> None:
    """Turn sums of squares into variances, and compare the stamps with an even clock.

    Sensors sample evenly, whatever the stamps say: those of receipt jitter and come in bursts, and
    where samples are lost the next one does not show the turn meanwhile. The difference of the
    integrated angle from that at equal intervals over an epoch is the error that this may cause.
    """
    for a in range(6):
        row[GYRO_VARIANCE + a] /= max(row[COUNT] - 1.0, 1.0)
    _close_part(row, state)
    for a in range(3):
        row[OWN_VARIANCE] -= row[COUNT] * row[GYRO + a] ** 2
    row[OWN_VARIANCE] /= 3.0 * max(state[21] - 1.0, 1.0) * max(row[COUNT], 1.0)
    state[21] = 0.0
    for a in range(3):
        off = row[TURNED + a] - row[GYRO + a] * row[DURATION]
        row[UNEVEN] += off * off
        row[TURNED + a] = 0.0


@part()
def _end(row: FloatArray, state: FloatArray, rows: FloatArray, ends: FloatArray, made: int) -> None:
    """Give out the open epoch and begin the next."""
    _close(row, state)
    ends[made] = state[4]
    for a in range(WIDTH):
        rows[made, a] = row[a]
        row[a] = 0.0


@part()
def _turned(q_nb: FloatArray, i: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A vector of the body in the navigation axes of sample i."""
    c00, c01, c02, c10, c11, c12, c20, c21, c22 = dcm(
        q_nb[i, 0], q_nb[i, 1], q_nb[i, 2], q_nb[i, 3]
    )
    return (
        c00 * x + c01 * y + c02 * z,
        c10 * x + c11 * y + c12 * z,
        c20 * x + c21 * y + c22 * z,
    )


@kernel()
def _accumulate(
    seconds: FloatArray,
    q_nb: FloatArray,
    omega: FloatArray,
    force: FloatArray,
    begins: bool,
    max_gap: float,
    interval: float,
    point: bool,
    stops: FloatArray,
    omega_in_n: FloatArray,
    row: FloatArray,
    state: FloatArray,
    rows: FloatArray,
    ends: FloatArray,
) -> int:
    """Add samples, each the mean since the one before; give out the epochs that end."""
    made = 0
    for i in range(len(seconds)):
        t = seconds[i]
        dt = t - state[4]
        first = begins and i == 0
        # The 1e-6 lets samples that are due at an epoch's end, but for jitter, still belong to it
        number = np.ceil((t - 1e-6) / EPOCH_S)
        if not first and dt > max_gap:
            if row[COUNT] > 0.0:
                _end(row, state, rows, ends, made)
                made += 1
            for a in range(WIDTH):
                rows[made, a] = 0.0
            rows[made, DURATION], rows[made, GAP], ends[made] = dt, dt, t
            made += 1
        elif not first:
            if interval > 0.0:
                dt = interval
            if row[COUNT] > 0.0 and number != state[5]:
                _end(row, state, rows, ends, made)
                made += 1
            # attitude half way
            sign = 1.0
            if (
                state[0] * q_nb[i, 0]
                + state[1] * q_nb[i, 1]
                + state[2] * q_nb[i, 2]
                + state[3] * q_nb[i, 3]
                < 0.0
            ):
                sign = -1.0
            w, x, y, z = to_unit(
                0.5 * (q_nb[i, 0] + sign * state[0]),
                0.5 * (q_nb[i, 1] + sign * state[1]),
                0.5 * (q_nb[i, 2] + sign * state[2]),
                0.5 * (q_nb[i, 3] + sign * state[3]),
            )
            c00, c01, c02, c10, c11, c12, c20, c21, c22 = dcm(w, x, y, z)
            ax, ay, az = force[i, 0], force[i, 1], force[i, 2]
            if point:
                # Half at either end, each with the attitude there
                ex, ey, ez = _turned(q_nb, i, ax, ay, az)
                fx, fy, fz = 0.5 * (state[12] + ex), 0.5 * (state[13] + ey), 0.5 * (state[14] + ez)
            else:
                fx = c00 * ax + c01 * ay + c02 * az
                fy = c10 * ax + c11 * ay + c12 * az
                fz = c20 * ax + c21 * ay + c22 * az
            half = 0.5 * dt * dt
            row[DP] += row[DV] * dt + fx * half
            row[DP + 1] += row[DV + 1] * dt + fy * half
            row[DP + 2] += row[DV + 2] * dt + fz * half
            row[DV] += fx * dt
            row[DV + 1] += fy * dt
            row[DV + 2] += fz * dt
            row[JB] += c00 * dt
            row[JB + 1] += c01 * dt
            row[JB + 2] += c02 * dt
            row[JB + 3] += c10 * dt
            row[JB + 4] += c11 * dt
            row[JB + 5] += c12 * dt
            row[JB + 6] += c20 * dt
            row[JB + 7] += c21 * dt
            row[JB + 8] += c22 * dt
            row[DURATION] += dt
            row[COUNT] += 1.0
            piece = np.ceil((t - 1e-6) / PART_S)
            if piece != state[16]:
                _close_part(row, state)
            state[16] = piece
            state[17] += 1.0
            stopped = False
            nx, ny, nz = omega_in_n[0], omega_in_n[1], omega_in_n[2]
            turned = (
                c00 * nx + c10 * ny + c20 * nz,
                c01 * nx + c11 * ny + c21 * nz,
                c02 * nx + c12 * ny + c22 * nz,
            )
            for a in range(3):
                rate = omega[i, a] - turned[a]
                row[W2] += rate * rate * dt
                state[18 + a] += rate
                row[TURNED + a] += rate * dt  # until the epoch ends
                delta = rate - row[GYRO + a]
                row[GYRO + a] += delta / row[COUNT]
                row[GYRO_VARIANCE + a] += delta * (rate - row[GYRO + a])
                delta = force[i, a] - row[ACCEL + a]
                row[ACCEL + a] += delta / row[COUNT]
                row[ACCEL_VARIANCE + a] += delta * (force[i, a] - row[ACCEL + a])
                if omega[i, a] >= stops[0, a] or -omega[i, a] >= stops[1, a]:
                    state[6 + a] += 1.0
                    state[9 + a] += dt
                    if state[6 + a] >= STOP_RUN:
                        stopped = True
                else:
                    state[6 + a] = 0.0
                    state[9 + a] = 0.0
            if stopped:
                # the samples that began the run count too
                longest = 0.0
                for a in range(3):
                    if state[6 + a] >= STOP_RUN:
                        longest = max(longest, state[9 + a])
                        state[9 + a] = 0.0
                row[SATURATED] += longest
        state[5] = number
        for a in range(4):
            state[a] = q_nb[i, a]
        state[4] = t
        if point:
            ax, ay, az = force[i, 0], force[i, 1], force[i, 2]
            state[12], state[13], state[14] = _turned(q_nb, i, ax, ay, az)
    return made


def merged(epochs: Epochs, length: int, by_kind: bool = False) -> Epochs:
    """Epochs of several times the length; gaps, and what is left before them, stay shorter.

    Parameters
    ----------
    epochs : Epochs
    length : int
        How many become one.
    by_kind : bool, optional
        Only those that are alike at rest or moving; else a part of a rest is none.
    """
    rows, gap = epochs.values, epochs.gap
    parted = gap | np.concatenate(([False], gap[:-1]))
    if by_kind:
        parted |= np.diff(rows[:, REST], prepend=rows[:1, REST]) != 0.0
    number = np.arange(len(gap))
    start = np.maximum.accumulate(np.where(parted, number, 0))
    first = np.flatnonzero((number - start) % length == 0)
    together = rows[first].copy()
    for columns in (
        slice(DURATION, DURATION + 1),
        slice(DV, DV + 3),
        slice(JB, SATURATED + 1),
        slice(TURNED, TURNED + 3),
        slice(UNEVEN, UNEVEN + 1),
    ):
        together[:, columns] = np.add.reduceat(rows[:, columns], first, axis=0)
    many = np.diff(first, append=len(rows))
    group = np.repeat(np.arange(len(first)), many)
    # position: velocity gained before each epoch goes on through it
    gained = np.cumsum(rows[:, DV : DV + 3], axis=0) - rows[:, DV : DV + 3]
    gained -= gained[first][group]
    way = rows[:, DP : DP + 3] + gained * rows[:, DURATION, None]
    together[:, DP : DP + 3] = np.add.reduceat(way, first, axis=0)
    weight = np.maximum(rows[:, COUNT], 1e-9)
    together[:, COUNT] = np.add.reduceat(rows[:, COUNT], first)
    for columns in (slice(GYRO, GYRO + 3), slice(ACCEL, ACCEL + 3)):
        summed = np.add.reduceat(rows[:, columns] * weight[:, None], first, axis=0)
        together[:, columns] = summed / np.add.reduceat(weight, first)[:, None]
    together[:, REST] = np.minimum.reduceat(rows[:, REST], first)
    # variances of means, each of an epoch
    for column in (OWN_RATE, SWAY_RATE, RATE_DOUBT, TURN_DOUBT, FORCE_DOUBT, OWN_VARIANCE):
        together[:, column] /= many
    return replace(
        epochs, time_ns=np.append(epochs.time_ns[first], epochs.time_ns[-1]), values=together
    )


def mean_force(epochs: Epochs, seconds: float) -> FloatArray:
    """Mean specific force of the first seconds in navigation axes, m/s^2, gaps left out.

    Returns
    -------
    ndarray, shape (3,)
    """
    inside = ~epochs.gap & (epochs.time_ns[:-1] < epochs.time_ns[0] + round(seconds * SECOND))
    rows = epochs.values[inside]
    time = rows[:, DURATION].sum()
    return rows[:, DV : DV + 3].sum(axis=0) / time if time > 0.0 else np.zeros(3)


def steady_turning(epochs: Epochs) -> float:
    """Share of a log's time that is spent in turns of `TURN_S` and more.

    A turn is steady where the rate's mean over so long is `TURN_RATE` off the median of such means,
    which is that of straight travel and of the bias.

    Returns
    -------
    float
        0 to 1.
    """
    wide = round(TURN_S / EPOCH_S)
    rate = epochs.values[~epochs.gap, GYRO : GYRO + 3]
    if len(rate) < wide:
        return 0.0
    sums = np.cumsum(np.vstack([np.zeros(3), rate]), axis=0)
    means = (sums[wide:] - sums[:-wide]) / wide
    turning = np.linalg.norm(means - np.median(means, axis=0), axis=1) > TURN_RATE
    return float(np.count_nonzero(np.convolve(turning, np.ones(wide)) > 0.5) / len(rate))
