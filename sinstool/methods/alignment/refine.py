"""Refinement of an attitude from pairs: a Kalman filter over the same integrals.

It starts from the attitude found and runs over the fixes from the first, with the errors of
the sensors as states; no reference to where the vehicle points is needed, as all is in
``ib0``. With ``C_true = C_0 (I - [theta x]) C`` for the chain ``C`` as integrated, the velocity
that the IMU misses is ``s' = [C f x] theta - C b_a - C diag(f) k_a`` and ``theta' = C b_g +
C diag(omega) k_g``; ``C_0^T beta - alpha`` measures s, plus what is wrong with lever arm and
time of the fixes.

A fix that does not fit gets more noise; it is not rejected, for a filter that rejects by its
own wrong covariance never returns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray
from sinstool.core.parts import kernel
from sinstool.core.rotation import exp, to_dcm
from sinstool.methods.alignment.accumulation import InertialRows
from sinstool.methods.alignment.pairs import cross_columns
from sinstool.methods.sensor_errors import SensorGrade

STATES = 22
THETA, S, BA, BG, KA, KG, LEVER, TAU = 0, 3, 6, 9, 12, 15, 18, 21
INFLATE_FROM = 25.0
"""Squared innovation by its covariance beyond which the noise of a fix is inflated."""

STRETCH_S = 15.0
"""Errors of fixes that last for less are distinguished from white noise."""

START_SIGMA = float(np.deg2rad(5.0))
PASSES = 2


@dataclass(frozen=True)
class Refined:
    """Answer of the filter after its last fix.

    Attributes
    ----------
    dcm : ndarray, shape (3, 3)
        ``C_0``: ``C_ib0^i`` before the correction of `state`.
    state : ndarray, shape (22,)
        theta, s, accelerometer bias, gyro bias, accelerometer scale, gyro scale, lever arm,
        latency.
    covariance : ndarray, shape (22, 22)
    row : int
        At which they hold.
    inflated : int
        Fixes that did not fit.
    chi2 : float
        Mean squared innovation by its covariance, over 3: about 1 where the errors are as
        large as assumed. A fix that was inflated counts as one at the limit.
    lasting : float
        The same of innovations that are summed up over `STRETCH_S`: more where they follow one
        another.
    """

    dcm: FloatArray
    state: FloatArray
    covariance: FloatArray
    row: int
    inflated: int
    chi2: float
    lasting: float = 1.0


class Refiner:
    """A filter over all rows, from any attitude: what does not depend on that is made once.

    Parameters
    ----------
    rows : InertialRows
        At the antenna, as far as the lever arm is known.
    beta : ndarray, shape (n, 3)
    sigma : ndarray, shape (n,)
        Velocity noise, m/s.
    use : ndarray of bool, shape (n,)
        Rows whose fix is taken.
    start_sigma : float
        How far an attitude to start from may be off, rad per axis.
    lever_sigma, latency_sigma : float
        How far lever arm, m, and latency, s, may be off; 0 where they are exact.
    backward : bool
        From the last row to the first, to answer there.
    """

    def __init__(
        self,
        rows: InertialRows,
        beta: FloatArray,
        sigma: FloatArray,
        use: BoolArray,
        grade: SensorGrade,
        start_sigma: float = START_SIGMA,
        lever_sigma: float = 0.0,
        latency_sigma: float = 0.0,
        backward: bool = False,
    ) -> None:
        order = np.arange(len(rows))[::-1] if backward else np.arange(len(rows))
        run = rows.rows(order)
        c = to_dcm(run.q)
        step = np.abs(np.diff(run.time_s, prepend=run.time_s[0]))
        prior = np.zeros(STATES)
        prior[THETA:S] = start_sigma**2
        prior[S:BA] = (10.0 * sigma[order[0]]) ** 2
        prior[BA:BG] = grade.accel_bias**2
        prior[BG:KA] = grade.gyro_bias**2
        prior[KA:KG] = grade.accel_scale**2
        prior[KG:LEVER] = grade.gyro_scale**2
        prior[LEVER:TAU] = lever_sigma**2
        prior[TAU] = latency_sigma**2
        self._begin, self._end = run.rows(slice(0, 1)), run.rows(slice(-1, None))
        self._last, self._used = int(order[-1]), max(int(use.sum()), 1)
        self._prior, self._start_sigma = prior, start_sigma
        self._beta, self._alpha = (beta - beta[order[0]])[order], run.alpha - run.alpha[0]
        self._transition = _transitions(run)
        number = np.floor(np.abs(run.time_s - run.time_s[0]) / STRETCH_S)
        self._stretches = np.unique(number, return_index=True)[1]
        self._rows = (
            np.einsum("nij,nj->ni", c, run.force_b),
            np.ascontiguousarray(run.swing),
            step,
            np.exp(-step / grade.bias_time_s),
            prior,
            np.array([grade.angle_random_walk, grade.velocity_random_walk]) ** 2,
            sigma[order] ** 2,
            use[order],
        )

    def __call__(self, dcm: FloatArray, held: FloatArray | None = None) -> Refined:
        """Filter.

        Parameters
        ----------
        dcm : ndarray, shape (3, 3)
            ``C_ib0^i`` to start from.
        held : ndarray, shape (3,), optional
            Unit vector in ib0: about this axis `dcm` is exact at the row where the filter begins.

        Notes
        -----
        Two passes: the second is linearised about what the first one found for its start.
        """
        room = np.zeros((6, 22)), np.zeros((22, 3)), np.zeros((3, 3)), np.zeros(3), np.zeros((3, 4))
        off = np.zeros((len(self._alpha), 3))
        for repeat in range(PASSES):
            state, covariance = np.zeros(STATES), np.diag(self._prior)
            if held is not None:
                covariance[THETA:S, THETA:S] -= self._start_sigma**2 * np.outer(held, held)
            z = self._beta @ dcm - self._alpha
            inflated, total = _filter_kernel(
                self._transition, z, *self._rows, state, covariance, *room, off
            )
            if repeat < PASSES - 1:
                turned = theta_at(state, self._end, self._begin)[0]
                if held is not None:
                    turned = turned - (turned @ held) * held
                dcm = dcm @ to_dcm(exp(-turned))
        chi2 = total / (3.0 * self._used)
        sums = np.add.reduceat(off, self._stretches)
        lasting = float(np.sum(sums**2)) / (3.0 * self._used)
        return Refined(dcm, state, covariance, self._last, inflated, chi2, lasting)


def theta_at(state: FloatArray, reference: InertialRows, rows: InertialRows) -> FloatArray:
    """Theta at other rows, from the estimated gyro errors.

    Parameters
    ----------
    state : ndarray, shape (22,)
    reference : InertialRows
        The one row at which it holds.
    rows : InertialRows
        n rows.

    Returns
    -------
    ndarray, shape (n, 3)
        rad.
    """
    gain_b = rows.gyro_bias_attitude - reference.gyro_bias_attitude
    gain_k = rows.gyro_scale_attitude - reference.gyro_scale_attitude
    return np.asarray(state[THETA:S] + gain_b @ state[BG:KA] + gain_k @ state[KG:LEVER])


def theta_covariance(
    covariance: FloatArray, reference: InertialRows, rows: InertialRows, grade: SensorGrade
) -> FloatArray:
    """Covariance of :func:`theta_at` at one row.

    Between the two rows the angle walks at random, and the gyro bias was not all the time what
    it is at the end: as much as it can have wandered since counts for all the time.

    Parameters
    ----------
    covariance : ndarray, shape (22, 22)
    reference, rows : InertialRows
        One row each.

    Returns
    -------
    ndarray, shape (3, 3)
        rad^2.
    """
    gain = np.zeros((3, STATES))
    gain[:, THETA:S] = np.eye(3)
    gain[:, BG:KA] = (rows.gyro_bias_attitude - reference.gyro_bias_attitude)[0]
    gain[:, KG:LEVER] = (rows.gyro_scale_attitude - reference.gyro_scale_attitude)[0]
    between = abs(float(rows.time_s[0] - reference.time_s[0]))
    wandered = grade.gyro_bias**2 * -np.expm1(-2.0 * between / grade.bias_time_s)
    drift = gain[:, BG:KA]
    noise = wandered * drift @ drift.T + grade.angle_random_walk**2 * between * np.eye(3)
    return np.asarray(gain @ covariance @ gain.T + noise)


def _transitions(rows: InertialRows) -> FloatArray:
    """Rows theta and s of the transition from each row to the next, shape (n, 6, 22)."""
    out = np.zeros((len(rows), 6, STATES))
    out[:, :, :6] = np.eye(6)
    alpha = np.diff(rows.alpha, axis=0)
    eye = np.broadcast_to(np.eye(3), (len(alpha), 3, 3))
    attitude_b = rows.gyro_bias_attitude
    attitude_k = rows.gyro_scale_attitude
    step_a = np.diff(attitude_b, axis=0)
    out[1:, :3, BG:KA] = step_a
    out[1:, :3, KG:LEVER] = np.diff(attitude_k, axis=0)
    out[1:, 3:, THETA:S] = cross_columns(alpha, eye)
    out[1:, 3:, BA:BG] = -step_a
    out[1:, 3:, KA:KG] = -np.diff(rows.accel_scale_velocity, axis=0)
    # What the gyro errors did before this step is in theta already.
    out[1:, 3:, BG:KA] = np.diff(rows.gyro_bias_velocity, axis=0) - cross_columns(
        alpha, attitude_b[:-1]
    )
    out[1:, 3:, KG:LEVER] = np.diff(rows.gyro_scale_velocity, axis=0) - cross_columns(
        alpha, attitude_k[:-1]
    )
    return out


@kernel(vectorizes=False)
def _filter_kernel(  # type: ignore[no-untyped-def]
    transition,
    z,
    force,
    lever,
    step,
    decay,
    prior,
    noise,
    variance,
    use,
    x,
    p,
    moved,
    gain,
    s,
    y,
    h,
    off,
):
    """Run over all rows; `x` and `p` are the prior and become the answer; the rest is room."""
    n = 22
    inflated = 0
    squares = 0.0
    for k in range(z.shape[0]):
        if k > 0:
            # Only theta and s move; with R the other states, P_mm, P_mr are F P.
            f = transition[k]
            for i in range(6):
                total = 0.0
                for col in range(n):
                    moved[i, col] = 0.0
                for j in range(18):
                    g = f[i, j]
                    if g != 0.0:
                        total += g * x[j]
                        for col in range(n):
                            moved[i, col] += g * p[j, col]
                gain[i, 0] = total
            for i in range(6):
                x[i] = gain[i, 0]
                for col in range(6, n):
                    p[i, col] = moved[i, col]
                    p[col, i] = moved[i, col]
                for col in range(i + 1):
                    total = 0.0
                    for j in range(18):
                        total += moved[i, j] * f[col, j]
                    p[i, col] = total
                    p[col, i] = total
            for i in range(3):
                p[i, i] += noise[0] * step[k]
                p[3 + i, 3 + i] += noise[1] * step[k]
            d = decay[k]
            for i in range(6, 12):
                x[i] *= d
                for col in range(n):
                    p[i, col] *= d
                    p[col, i] *= d
                p[i, i] += prior[i] * (1.0 - d * d)
        if not use[k]:
            continue
        for i in range(3):
            for j in range(3):
                h[i, j] = lever[k, i, j]
            h[i, 3] = -force[k, i]
        for i in range(n):
            for j in range(3):
                total = p[i, 3 + j]
                for m in range(4):
                    total += p[i, 18 + m] * h[j, m]
                gain[i, j] = total
        for i in range(3):
            y[i] = z[k, i] - x[3 + i]
            for m in range(4):
                y[i] -= h[i, m] * x[18 + m]
            for j in range(3):
                s[i, j] = gain[3 + i, j]
                for m in range(4):
                    s[i, j] += h[i, m] * gain[18 + m, j]
        nis = 0.0
        for attempt in range(2):
            r = variance[k]
            if attempt == 1:
                r *= (nis / INFLATE_FROM) ** 2 - 1.0  # on top of what is in s already
            s[0, 0] += r
            s[1, 1] += r
            s[2, 2] += r
            a00 = s[1, 1] * s[2, 2] - s[1, 2] * s[2, 1]
            a01 = s[0, 2] * s[2, 1] - s[0, 1] * s[2, 2]
            a02 = s[0, 1] * s[1, 2] - s[0, 2] * s[1, 1]
            a11 = s[0, 0] * s[2, 2] - s[0, 2] * s[2, 0]
            a12 = s[0, 2] * s[1, 0] - s[0, 0] * s[1, 2]
            a22 = s[0, 0] * s[1, 1] - s[0, 1] * s[1, 0]
            det = (
                s[0, 0] * a00
                + s[0, 1] * (s[1, 2] * s[2, 0] - s[1, 0] * s[2, 2])
                + s[0, 2] * (s[1, 0] * s[2, 1] - s[1, 1] * s[2, 0])
            )
            w0 = (a00 * y[0] + a01 * y[1] + a02 * y[2]) / det
            w1 = (a01 * y[0] + a11 * y[1] + a12 * y[2]) / det
            w2 = (a02 * y[0] + a12 * y[1] + a22 * y[2]) / det
            nis = y[0] * w0 + y[1] * w1 + y[2] * w2
            if attempt == 0:
                squares += min(nis, INFLATE_FROM)
                share = min(1.0, np.sqrt(INFLATE_FROM / nis)) if nis > 0.0 else 1.0
                for i in range(3):
                    off[k, i] = share * y[i] / np.sqrt(s[i, i])
            if attempt == 0 and nis > INFLATE_FROM:
                inflated += 1
            else:
                break
        for i in range(n):
            g0 = gain[i, 0]
            g1 = gain[i, 1]
            g2 = gain[i, 2]
            x[i] += g0 * w0 + g1 * w1 + g2 * w2
            k0 = (g0 * a00 + g1 * a01 + g2 * a02) / det
            k1 = (g0 * a01 + g1 * a11 + g2 * a12) / det
            k2 = (g0 * a02 + g1 * a12 + g2 * a22) / det
            for j in range(i + 1):
                value = p[i, j] - (k0 * gain[j, 0] + k1 * gain[j, 1] + k2 * gain[j, 2])
                p[i, j] = value
                p[j, i] = value
    return inflated, squares
