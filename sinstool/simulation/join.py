"""Motions one after the other."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from sinstool.simulation.truth import ImuTruth


def after_rest(motion: ImuTruth, rest: ImuTruth) -> ImuTruth:
    """A rest that ends at the instant at which the motion begins.

    Parameters
    ----------
    rest : ImuTruth
        Its last instant is the motion's first; of the motion's first row nothing is used but
        the rate at the instant, since the interval before it belongs to the rest.

    Returns
    -------
    ImuTruth

    Raises
    ------
    ValueError
        The two do not meet.
    """
    if rest.time_ns[-1] != motion.time_ns[0]:
        raise ValueError("the rest does not end where the motion begins")
    if not np.allclose(np.abs(rest.q_nb[-1] @ motion.q_nb[0]), 1.0, atol=1e-12):
        raise ValueError("the attitude of the rest is not the first of the motion")
    joined = {}
    for f in fields(ImuTruth):
        joined[f.name] = np.concatenate([getattr(rest, f.name), getattr(motion, f.name)[1:]])
    at = len(rest.time_ns) - 1
    joined["gyro_rate"][at] = motion.gyro_rate[0]
    joined["specific_force"][at] = motion.specific_force[0]
    return ImuTruth(**joined)
