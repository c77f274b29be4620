"""Gains of the damping network for barometer samples that come when they come.

Between samples the channel runs free, with the correction A taken off the acceleration. At a
sample, T after the one before, the difference e moves the state at once:

    h -= L1 e,    v -= L2 e,    A += L3 e.                                            (1)

L is chosen so that, without gravity's gradient, (I - L c) Phi(T) has the poles r, r, r with
r = exp(-T/tau), c = (1, K4, 0), for every T: the sampled network is the continuous one seen at
the samples. A gain that is held over T, K e, is unstable from T = 0.676 tau on; this one never,
also where T changes from sample to sample.
"""

from __future__ import annotations

import math

from numba import njit


@njit(cache=True, nogil=True)
def pole_matched_gains(
    interval: float, tau: float, k4: float, w2: float
) -> tuple[float, float, float]:
    """Gains L1, L2 (1/s), L3 (1/s^2) for a sample.

    Compiled; callable from compiled loops.

    Parameters
    ----------
    interval : float
        T, time since the accepted sample before, s; positive.
    tau, k4 : float
        Of the network, s.
    w2 : float
        Gravity's gradient, 1/s^2: its share in L2 cancels what gravity adds over T.

    Returns
    -------
    l1, l2, l3 : float
        L/T tends to the continuous gains K as T tends to 0.
    """
    r = math.exp(-interval / tau)
    q = -math.expm1(-interval / tau)
    x = k4 / interval * q  # K4/tau for short intervals
    l1 = q * ((1.0 + r + r * r) - 1.5 * x * (1.0 + r) + x * x)
    l2 = q * q * (3.0 * (1.0 + r) - 2.0 * x) / (2.0 * interval)
    l2 += w2 * interval * (1.0 - 0.5 * l1)
    l3 = q * q * q / (interval * interval)
    return l1, l2, l3
