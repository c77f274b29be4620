"""Velocities of a receiver that are of an earlier instant than its positions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from sinstool.core.earth import horizontal_metres
from sinstool.core.streams import GnssEpochs, concatenate
from sinstool.methods.ins_gnss.latency import Latency, correlate


def velocity_lag(gnss: GnssEpochs) -> Latency:
    """How much later the velocities of a receiver are stamped than its positions.

    Some receivers difference positions, or average the Doppler shift over the interval that ends
    at the fix: their velocity is that of half an interval before. Found from the fixes alone, by
    sliding positions along the integral of the velocities.

    Returns
    -------
    Latency
        Positive where velocities are late.
    """
    fixes = gnss.rows(gnss.has_position & gnss.has_velocity)
    if len(fixes) < 20:
        return Latency(0.0, np.inf, "not observable", 0)
    t = (fixes.time_ns - fixes.time_ns[0]) * 1e-9
    usual = float(np.median(np.diff(t)))
    span = min(2.0 * usual, 1.0)
    way = PchipInterpolator(t, fixes.velocity_n[:, :2]).antiderivative()
    # Down is often known worse than it moves
    fine = np.arange(0.0, t[-1], min(0.02, 0.1 * usual))
    travelled = np.column_stack([way(fine), np.zeros_like(fine)])
    longitude = np.unwrap(fixes.longitude)
    north, east = horizontal_metres(
        fixes.latitude - fixes.latitude[0], longitude - longitude[0], fixes.latitude[0]
    )
    position = np.column_stack([north, east, np.full(len(fixes), np.nan)])
    times = fixes.time_ns[0] + np.round(fine * 1e9).astype(np.int64)
    found = correlate(times, travelled, fixes.time_ns, position, -span, span)
    return replace(found, latency_s=-found.latency_s)


def separate(gnss: GnssEpochs, velocity_lag_s: float) -> GnssEpochs:
    """Epochs whose velocities have rows of their own, stamped as the positions are.

    Parameters
    ----------
    velocity_lag_s : float
        See :func:`velocity_lag`.

    Returns
    -------
    GnssEpochs
        By time: positions at their stamps, velocities that much earlier.
    """
    n = len(gnss)
    nothing, triple = np.full(n, np.nan), np.full((n, 3), np.nan)
    positions = replace(gnss, velocity_n=triple, sigma_velocity_n=triple)
    velocities = replace(
        gnss,
        time_ns=gnss.time_ns - round(velocity_lag_s * 1e9),
        latitude=nothing,
        longitude=nothing,
        height=nothing,
        sigma_position_n=triple,
    )
    both = concatenate([positions.rows(gnss.has_position), velocities.rows(gnss.has_velocity)])
    return both.rows(np.argsort(both.time_ns, kind="stable"))
