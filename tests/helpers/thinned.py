"""Simulated motions as slower logs would hold them."""

from __future__ import annotations

import numpy as np

from sinstool.simulation.truth import FloatArray, ImuTruth


def thin(truth: ImuTruth, factor: int) -> ImuTruth:
    """Every so manieth instant of a simulation: what a log at a lower rate would hold.

    Parameters
    ----------
    truth : ImuTruth
        At the higher rate.
    factor : int
        Instants to one, at least 1.

    Returns
    -------
    ImuTruth
        From instant ``factor - 1`` on, whose interval begins with that of row 0. Rates are
        those at the instants, increments and means over all of each new interval.

    Raises
    ------
    ValueError
        If fewer than two instants are left.
    """
    count = len(truth.time_ns) // factor if factor >= 1 else 0
    if count < 2:
        raise ValueError(f"Of {len(truth.time_ns)} instants, one in {factor} are fewer than two.")
    last = slice(factor - 1, count * factor, factor)

    def total(rows: FloatArray) -> FloatArray:
        whole = rows[: count * factor]
        return np.asarray(whole.reshape(count, factor, *rows.shape[1:]).sum(axis=1))

    interval = total(truth.interval)
    increment = total(truth.gyro_increment)
    velocity = total(truth.mean_specific_force * truth.interval[:, np.newaxis])
    return ImuTruth(
        time_ns=truth.time_ns[last],
        interval=interval,
        gyro_rate=truth.gyro_rate[last],
        gyro_mean_rate=increment / interval[:, np.newaxis],
        gyro_increment=increment,
        specific_force=truth.specific_force[last],
        mean_specific_force=velocity / interval[:, np.newaxis],
        q_nb=truth.q_nb[last],
    )
