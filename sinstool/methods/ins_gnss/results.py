"""Results of an INS/GNSS filter.

A run gives, for each block of IMU updates, a :class:`FilterBlock`: columns at the IMU updates, what
happened at the GNSS epochs, and, where asked for, what a smoother needs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.streams import Solution

EVENT_NAMES = (
    "gated",
    "restart",
    "imu-gap",
    "imu-gap-restart",
    "baro-jump",
    "baro-frozen",
    "far-from-gnss",
    "covariance-lost",
)
"""Kinds of event: an epoch was not used; the filter began anew; an IMU gap was bridged; after a
gap the filter began anew; the barometer jumped; it hung; without feedback, the navigation is too
far off for a linear filter; the covariance was none any more, and the filter began anew."""


@dataclass(frozen=True)
class UpdateColumns:
    """Columns at the end of each IMU update.

    Attributes
    ----------
    time_ns : ndarray of int64, shape (n,)
    latitude, longitude : ndarray, shape (n,)
        rad.
    height : ndarray, shape (n,)
        m; without the steps of a vertical channel that engages again.
    velocity_n : ndarray, shape (n, 3)
        m/s.
    q_nb : ndarray, shape (n, 4)
    omega_ib_b, specific_force_b : ndarray, shape (n, 3)
        Means over the update, sensor errors taken off, rad/s and m/s^2.
    correction : ndarray, shape (n,)
        A of the damping network, m/s^2; 0 without one.
    covariance_position_n, covariance_velocity_n, covariance_attitude_n : ndarray, (n, 3, 3)
        Of the errors of the above, NED; m^2, (m/s)^2, rad^2. They are those of the latest
        multiple of the filter's substep or measurement, at most a substep (0.25 s) ago; those of
        positions are carried on by the velocities.
    """

    time_ns: IntArray
    latitude: FloatArray
    longitude: FloatArray
    height: FloatArray
    velocity_n: FloatArray
    q_nb: FloatArray
    omega_ib_b: FloatArray
    specific_force_b: FloatArray
    correction: FloatArray
    covariance_position_n: FloatArray
    covariance_velocity_n: FloatArray
    covariance_attitude_n: FloatArray

    def __len__(self) -> int:
        return len(self.time_ns)

    def as_solution(self, log_time_ns: IntArray, height_damped: bool) -> Solution:
        """The same as a solution.

        Parameters
        ----------
        log_time_ns : ndarray of int64, shape (n,)
            When the samples at the ends of the updates were recorded.
        height_damped : bool
            Whether a network damps the height, whose state is then given too.
        """
        vertical = None
        if height_damped:
            vertical = np.stack([self.height, -self.velocity_n[:, 2], self.correction], axis=1)
        return Solution(
            self.time_ns,
            log_time_ns,
            self.q_nb,
            self.omega_ib_b,
            self.specific_force_b,
            np.stack([self.latitude, self.longitude, self.height], axis=1),
            self.velocity_n,
            vertical,
            self.covariance_position_n,
            self.covariance_velocity_n,
            self.covariance_attitude_n,
        )


@dataclass(frozen=True)
class GnssDiagnostics:
    """Columns at each GNSS epoch that lies within the IMU updates.

    Attributes
    ----------
    time_ns : ndarray of int64, shape (m,)
        At which the epoch is valid: its stamp less the latency.
    innovation : ndarray, shape (m, 6)
        Navigation less fix, the filter's estimate of the errors of both taken off: position and
        velocity, NED, m and m/s; NaN where the fix has none.
    innovation_sigma : ndarray, shape (m, 6)
        What it should be.
    measurement_sigma : ndarray, shape (m, 6)
        Of the white noise that was assumed: adapted, measured by the gate, or given.
    noise_ratio : ndarray, shape (m, 6)
        Its variance over the given one.
    nis : ndarray, shape (m,)
        Normalised innovation squared.
    rows : ndarray of int64, shape (m,)
        How many numbers the fix had, which is what `nis` should be in the mean.
    used, gated, restarted, withheld : ndarray of bool, shape (m,)
        The fix corrected the filter; was too far off; made it begin anew; was to be scored only.
    """

    time_ns: IntArray
    innovation: FloatArray
    innovation_sigma: FloatArray
    measurement_sigma: FloatArray
    noise_ratio: FloatArray
    nis: FloatArray
    rows: IntArray
    used: BoolArray
    gated: BoolArray
    restarted: BoolArray
    withheld: BoolArray

    def __len__(self) -> int:
        return len(self.time_ns)


@dataclass(frozen=True)
class StoredEpochs:
    """Data for a smoother, one row for each instant with a measurement of any kind.

    Where nothing is measured there is a row about every second all the same.

    With ``x`` the filter's estimate of the error states, of the navigation in row k:

    * before the measurements, ``x_minus[k] = transition[k] x_plus[k-1]`` (and known inputs),
    * they add ``correction[k]``,
    * then, with feedback, nav and sensors are corrected by what was estimated, and
      ``estimate[k] = x_plus[k]`` is what is left: 0 but for the GNSS errors.

    So with ``G = covariance_after[k] transition[k+1].T inv(covariance_before[k+1])`` the smoothed
    error of row k is ``estimate[k] + d[k]``, where ``d[k] = G (d[k+1] + correction[k+1])`` and
    ``d[last] = 0``. The smoothed navigation is ``nav[k]`` less that, by the signs of
    :mod:`~sinstool.methods.ins_gnss.states`; the smoothed covariance
    ``covariance_after[k] + G (smoothed[k+1] - covariance_before[k+1]) G.T``.

    Attributes
    ----------
    time_ns : ndarray of int64, shape (m,)
    update : ndarray of int64, shape (m,)
        Number, from the start of the run, of the IMU update at whose end it is.
    transition : ndarray, shape (m, n, n)
        Of the error states from the row before (or the start) to this one, corrections of the
        damping network included. In the rows of states that do not move only the diagonal, their
        decay, is not 0.
    covariance_before, covariance_after : ndarray, shape (m, n, n)
        Of all measurements at the instant.
    correction : ndarray, shape (m, n)
        Sum of all updates of the estimate at the instant.
    estimate : ndarray, shape (m, n)
    nav : ndarray, shape (m, 10)
        State of :mod:`sinstool.methods.strapdown.navigation` after feedback, in closed loop;
        without feedback, uncorrected.
    sensors : ndarray, shape (m, 26)
        Estimates fed back so far: gyro bias, accelerometer scale and bias, A, baro bias,
        gyro scale, misalignment of the axes of gyros and accelerometers.
    restart : ndarray of bool, shape (m,)
        The filter began anew between the row before and this one, or here: a smoother must not
        go across from this row to the one before. This row's `correction` is meaningless.
    """

    time_ns: IntArray
    update: IntArray
    transition: FloatArray
    covariance_before: FloatArray
    covariance_after: FloatArray
    correction: FloatArray
    estimate: FloatArray
    nav: FloatArray
    sensors: FloatArray
    restart: BoolArray

    def __len__(self) -> int:
        return len(self.time_ns)


@dataclass(frozen=True)
class FilterEvent:
    """Something that happened to the filter.

    Attributes
    ----------
    kind : str
        One of ``EVENT_NAMES``, or ``imu-gap-new-start``: after a gap another filter was started
        from the data that follow.
    size : float
        gated, restart: normalised innovation squared; gaps: their length, s; baro: metres;
        far-from-gnss: metres.
    """

    kind: str
    time_ns: int
    size: float


@dataclass(frozen=True)
class FilterBlock:
    """Answers for a block of IMU updates.

    Attributes
    ----------
    updates : UpdateColumns or None
        None if no output was asked for.
    stored : StoredEpochs or None
        None unless asked for.
    """

    updates: UpdateColumns | None
    gnss: GnssDiagnostics
    stored: StoredEpochs | None
