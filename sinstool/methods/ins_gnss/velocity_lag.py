"""Velocities of a receiver that are of an earlier instant than its positions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from sinstool.core.earth import horizontal_metres
from sinstool.core.streams import GnssEpochs, concatenate
from sinstool.core.timeline import SECOND
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
    late = correlate(times, travelled, fixes.time_ns, position, -span, span)
    return replace(late, latency_s=-late.latency_s)


def split_position_velocity(gnss: GnssEpochs, velocity_lag_s: float) -> GnssEpochs:
    """Epochs whose positions and velocities have rows of their own, half a lag to either side.

    Parameters
    ----------
    velocity_lag_s : float
        See :func:`velocity_lag`; with 0 the epochs stay as they are.

    Returns
    -------
    GnssEpochs
        By time, all of them valid one and the same latency before their stamps.
    """
    if velocity_lag_s == 0.0:
        return gnss
    lag, half = round(velocity_lag_s * SECOND), round(0.5 * velocity_lag_s * SECOND)
    nothing, triple = np.full(len(gnss), np.nan), np.full((len(gnss), 3), np.nan)
    positions = replace(
        gnss, time_ns=gnss.time_ns + half, velocity_n=triple, sigma_velocity_n=triple
    )
    velocities = replace(
        gnss,
        time_ns=gnss.time_ns - lag + half,
        latitude=nothing,
        longitude=nothing,
        height=nothing,
        sigma_position_n=triple,
    )
    both = concatenate([positions.rows(gnss.has_position), velocities.rows(gnss.has_velocity)])
    return both.rows(np.argsort(both.time_ns, kind="stable"))


def message_times(gnss: GnssEpochs, velocity_lag_s: float) -> NDArray[np.int64]:
    """Stamps of the messages that epochs of :func:`split_position_velocity` come from, ns."""
    lag, half = round(velocity_lag_s * SECOND), round(0.5 * velocity_lag_s * SECOND)
    return np.asarray(gnss.time_ns - half + np.where(gnss.has_position, 0, lag))
