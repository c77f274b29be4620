"""Steady travel of a vehicle, compared with an attitude that was smoothed without it.

The check of a rest knows only what came before. After a single turn its tilt can be so wrong that
straight flight looks like an acceleration; and a tilt that follows gentle braking hides it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sinstool.core.order_statistics import median
from sinstool.core.rotation import to_dcm
from sinstool.methods.attitude_smoother.correction import Correction
from sinstool.methods.attitude_smoother.epochs import (
    ACCEL_VARIANCE,
    AT_REST,
    DURATION,
    DV,
    FORCE_DOUBT,
    GYRO,
    JB,
    MOVING,
    QUIET,
    REST,
    STEADY,
    SWAY_FORCE,
    SWAY_RATE,
    Epochs,
)
from sinstool.methods.attitude_smoother.filter_step import ACCELERATES, DENIED, SWAY_LASTS
from sinstool.methods.attitude_smoother.model import GRAVITY, MotionModel, SensorModel
from sinstool.methods.attitude_smoother.motion import find_motion
from sinstool.methods.attitude_smoother.quiet_doubt import note_doubt, runs
from sinstool.methods.attitude_smoother.rest import (
    LONG_WINDOW,
    LULL,
    TRANSPORT_RATE,
    drop_lulls,
    mean_over,
)
from sinstool.methods.attitude_smoother.smoother import NO_PRIOR, smooth
from sinstool.methods.attitude_smoother.start import Prior

# At a stop the variance of specific force is below this share of that in motion.
CALM = 0.25
# The first smoothed attitude uses no steady travel, the second what agrees with the first. An
# accelerometer bias above this, m/s^2, hides too much for a second to help.
GOOD_ACCEL_BIAS = 0.02
# A tilt whose sigma exceeds this, as level specific force in m/s^2, leaves room for an
# acceleration; twice the effect of constant sensor errors is allowed on top.
KNOWN_TILT = 0.065
# If the density of acceleration is smaller by this factor without the bias of quiet times, their
# rate is far more likely that of a turn.
GENTLER = 1.5


def with_steady(
    epochs: Epochs,
    looks_at_rest: np.ndarray,
    motion: MotionModel,
    sensors: SensorModel,
    prior: Prior = NO_PRIOR,
    in_place: bool = False,
) -> Epochs:
    """The epochs of a vehicle, with steady ones marked anew.

    Parameters
    ----------
    epochs : Epochs
        With those rests marked that a filter confirmed.
    looks_at_rest : ndarray of bool, shape (n,)
        Which looked like rest before.
    motion : MotionModel
        A hand's is never steady.
    sensors : SensorModel
    prior : Prior, optional
    in_place : bool, optional
        See :func:`~sinstool.methods.attitude_smoother.rest.confirmed`.

    Returns
    -------
    Epochs
        Steady are those that looked like rest for `LULL` on end, where the smoothed tilt is known
        and their mean specific force and rate are those of gravity and of the bias. A rest in which
        the vehicle shakes as in motion may be a lull, which only shows the bias.
    """
    kinds = epochs.values[:, REST].copy()
    shake = epochs.values[:, ACCEL_VARIANCE : ACCEL_VARIANCE + 3].sum(axis=1)
    moving = shake[(kinds == MOVING) & ~epochs.gap]
    calm = CALM * float(median(moving)) if len(moving) >= LULL else np.inf
    lull = np.zeros(len(kinds), np.bool_)
    for begin, end in runs(looks_at_rest):
        rest = begin + np.flatnonzero(kinds[begin:end] == AT_REST)
        lull[rest] = len(rest) > 0 and float(median(shake[rest])) > calm
    doubted = looks_at_rest & ((kinds < AT_REST) | lull)
    long = any(end - begin >= LULL for begin, end in runs(doubted))
    if motion.c0 or not (long or lull.any()):
        return epochs
    values = epochs.values if in_place else epochs.values.copy()
    values[lull | (kinds == STEADY), REST] = QUIET
    note_doubt(values, looks_at_rest, sensors)
    alone = values[:, REST].copy()
    rounds = 2 if sensors.accel_bias < GOOD_ACCEL_BIAS else 1
    for _ in range(rounds if long else 0):
        smoothed = smooth(replace(epochs, values=values), motion, sensors, prior)
        smoothed = smoothed.at(epochs.time_ns)
        agrees, tilted = agrees_with_travel(epochs, looks_at_rest, sensors, smoothed)
        values[:, REST] = np.where(doubted & agrees, STEADY, alone)
        drop_lulls(values)
        note_doubt(values, looks_at_rest, sensors)
        # a constant acceleration, as large as the tilt could hide
        for begin, end in runs(values[:, REST] == STEADY):
            hidden = float(np.mean(tilted[begin:end]))
            values[begin:end, FORCE_DOUBT] = hidden * (end - begin)
    return replace(epochs, values=values)


def turning(
    epochs: Epochs, motion: MotionModel, sensors: SensorModel, prior: Prior = NO_PRIOR
) -> np.ndarray:
    """Quiet epochs of a vehicle that never rests whose rate is that of a turn, not of a bias.

    Before the first of them nothing has shown the bias, so the filter cannot refute it. The bias of
    an attitude smoothed with all of them as motion can.

    Parameters
    ----------
    epochs : Epochs
        As :func:`with_steady` leaves them.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    kinds = epochs.values[:, REST]
    turns = np.zeros(len(kinds), np.bool_)
    quiet = [run for run in runs(kinds == QUIET) if run[1] - run[0] >= LULL]
    if motion.c0 or not quiet or (kinds > QUIET).any():
        return turns
    values = epochs.values.copy()
    values[:, REST] = MOVING
    moving = replace(epochs, values=values)
    gentle = find_motion(moving, sensors, "vehicle").model
    alone = smooth(moving, gentle, sensors, prior).at(epochs.time_ns)
    # with a wrong bias the motion seems wilder than it is, in every epoch
    limit = ACCELERATES if GENTLER * gentle.density < motion.density else DENIED
    for begin, end in quiet:
        rate = values[begin:end, GYRO : GYRO + 3] - alone.gyro_bias[begin:end]
        sigma = alone.gyro_bias_sigma[begin:end].mean(axis=0)
        variance = sigma**2 + sensors.zero_rate**2 + TRANSPORT_RATE**2
        turns[begin:end] = np.any(rate.mean(axis=0) ** 2 > limit * variance)
    return turns


def agrees_with_travel(
    epochs: Epochs, still: np.ndarray, sensors: SensorModel, smoothed: Correction
) -> tuple[np.ndarray, np.ndarray]:
    """Where force and rate, as means over a window, are those of steady travel.

    Returns
    -------
    agrees : ndarray of bool, shape (n,)
    hidden : ndarray, shape (n,)
        Variance of a level acceleration that the tilt leaves room for, m^2/s^4.
    """
    rows, bias = epochs.values, smoothed.gyro_bias[:-1]
    seconds = rows[:, DURATION, None]
    matrix = to_dcm(smoothed.q[:-1])
    turned = rows[:, JB : JB + 9].reshape(-1, 3, 3)
    # the bias turns the axes, on average by half of what it does over the whole epoch
    gained = rows[:, DV : DV + 3]
    gained = gained - 0.5 * np.cross(np.einsum("nij,nj->ni", turned, bias), gained)
    force = np.einsum("nij,nj->ni", matrix, gained)[:, :2] / seconds
    # the Earth's rate, which the integration took off in its own axes
    earth = (np.einsum("nji,j->ni", matrix, epochs.omega_in_n) - epochs.omega_in_n) / seconds
    rate = rows[:, GYRO : GYRO + 3] - np.einsum("nji,nj->ni", turned, earth) - bias
    variance = np.einsum("nii->ni", smoothed.covariance_n)[:-1]
    tilted = GRAVITY**2 * variance[:, [1, 0]]
    constant = sensors.accel_bias**2 + (GRAVITY * sensors.rate_error) ** 2
    known = KNOWN_TILT**2 + 4.0 * constant
    agrees = np.zeros(len(rows), np.bool_)
    for begin, end in runs(still):
        part = slice(begin, end)
        steady = smoothed.gyro_bias_sigma[begin:end] ** 2 + sensors.zero_rate**2 + TRANSPORT_RATE**2
        agrees[part] = np.all(tilted[part] < known, axis=1)
        # short windows show what the mean of a long one hides: setting off at the end of a rest
        for wide in (min(LULL, end - begin), min(LONG_WINDOW, end - begin)):
            lasts = min(1.0, SWAY_LASTS / wide)
            level = tilted[part] + sensors.accel_bias**2 + lasts * rows[part, SWAY_FORCE, None]
            turning = steady + lasts * rows[part, SWAY_RATE, None]
            pulled = np.stack([mean_over(axis, wide) for axis in force[part].T], axis=1)
            turns = np.stack([mean_over(axis, wide) for axis in rate[part].T], axis=1)
            agrees[part] &= np.all(pulled**2 < ACCELERATES * level, axis=1)
            agrees[part] &= np.all(turns**2 < DENIED * turning, axis=1)
    return agrees, np.maximum(tilted.max(axis=1) - constant, 0.0)
