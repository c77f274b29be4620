"""State at the start of `--mode ins`: position and velocity as specified, at rest, or by GNSS."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.arrays import FloatArray
from sinstool.core.earth import displaced, horizontal_metres
from sinstool.core.errors import ConfigurationError
from sinstool.core.order_statistics import median
from sinstool.core.rotation import rotate, wrapped
from sinstool.core.streams import GnssEpochs, Solution, concatenate
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.alignment.initial import Alignment
from sinstool.methods.alignment.still import StillSpan
from sinstool.methods.strapdown.free_inertial import InsRun, InsSettings
from sinstool.methods.strapdown.navigation import initial_state
from sinstool.pipelines.align.first_attitude import rest_held
from sinstool.survey.source import Source, imu_blocks

if TYPE_CHECKING:
    from sinstool.pipelines.process.ins_gnss.initial_state import StartFixes

# Fixes within this time of the start show the state there: velocities, or positions alone, which
# need longer. Errors of tilt make a longer time no better.
NEAR_NS, NEAR_PLACES_NS = 2 * SECOND, 5 * SECOND
# The first of them may be so much later: a receiver that is switched on needs time for its first.
FAR_NS = 60 * SECOND
# Samples read at a time for that.
ROWS = 1024


def start_state(
    source: Source, alignment: Alignment, settings: InsSettings, config: ProcessConfig
) -> tuple[FloatArray, list[str], bool]:
    """State at the first attitude.

    Parameters
    ----------
    settings : InsSettings
        Of an undamped navigation from there.

    Returns
    -------
    state : ndarray, shape (SIZE,)
        See :func:`~sinstool.methods.strapdown.navigation.initial_state`.
    notes : list of str
        What is unknown, and what is assumed instead.
    known : bool
        Whether the velocity is known.

    Raises
    ------
    ConfigurationError
        The position is not known.
    """
    latitude, longitude, height = source.position
    if latitude is None:
        raise ConfigurationError(
            f"{source.path}: navigation needs a position, and the log has no fix",
            "give --latitude, --longitude and --height",
        )
    notes = []
    if longitude is None:
        longitude = 0.0
        notes.append("the longitude is unknown; it counts from 0 (give --longitude)")
    if height is None:
        height = 0.0
        notes.append("the height at the start is unknown; 0 m is assumed (give --height)")
    place = np.array([latitude * DEGREE, longitude * DEGREE, height])
    rest = rest_held(source, alignment)
    fixes, given = source.aiding.gnss, config.navigation.initial_velocity
    velocity: FloatArray | None = None
    if given is not None or rest is not None:
        velocity = np.array(given or (0.0, 0.0, 0.0))
    if config.align.latitude is not None:
        if velocity is None:
            velocity = _by_fixes(fixes, place, None, alignment, settings, source, config)[0]
    elif rest is not None:
        place = _of_imu(_where_it_rests(fixes, place, rest), alignment, config)
    else:
        velocity, place = _by_fixes(fixes, place, velocity, alignment, settings, source, config)
    known = velocity is not None
    if velocity is None:
        velocity = np.zeros(3)
        if source.survey.lead_in is None:
            notes.append(
                "the velocity at the start is unknown and the vehicle is not at rest; 0 is assumed"
                " (give --initial-velocity)"
            )
        else:
            known = True
    return _state(place, velocity, alignment), notes, known


def fixes_that_show(source: Source, config: ProcessConfig) -> GnssEpochs | None:
    """Fixes for an alignment in motion, with velocities from positions if the log has none."""
    gnss = source.aiding.gnss
    if gnss is None or gnss.has_velocity.any():
        return gnss
    return _with_velocities(gnss, config).shown


def _with_velocities(gnss: GnssEpochs, config: ProcessConfig) -> StartFixes:
    # The filter takes longer to import than most logs to process
    from sinstool.pipelines.process.ins_gnss.initial_state import StartFixes
    from sinstool.pipelines.process.ins_gnss.receiver import gnss_model

    return StartFixes.of(gnss, gnss_model(gnss, config)[0])


def _where_it_rests(gnss: GnssEpochs | None, place: FloatArray, rest: StillSpan) -> FloatArray:
    """Median of the fixes in a rest, as the first of a receiver are often its worst."""
    if gnss is None:
        return place
    rows = gnss.rows(gnss.has_position & (gnss.time_ns <= rest.end_ns))
    off = np.column_stack([rows.latitude, rows.longitude, rows.height]) - place
    off[:, 1] = wrapped(off[:, 1])
    return place + _middle(off)


def _of_imu(place: FloatArray, alignment: Alignment, config: ProcessConfig) -> FloatArray:
    """Latitude, longitude and height of the IMU, from those of the antenna."""
    latitude, longitude, height = place.tolist()
    arm_b = np.array(config.gnss.lever_arm or (0.0, 0.0, 0.0))
    north, east, down = rotate(alignment.q_nb, arm_b).tolist()
    if alignment.north_referenced:
        there = displaced(latitude, longitude, height, -north, -east)
        latitude, longitude = float(there[0]), float(there[1])
    return np.array([latitude, longitude, height + down])


def _by_fixes(
    fixes: GnssEpochs | None,
    place: FloatArray,
    velocity: FloatArray | None,
    alignment: Alignment,
    settings: InsSettings,
    source: Source,
    config: ProcessConfig,
) -> tuple[FloatArray | None, FloatArray]:
    """Velocity, None where no fix shows it, and place of the IMU at the start by fixes near it.

    Those that follow are led back by a navigation from a guess. That needs the heading: without
    one, and where fixes only precede it, the nearest fix is that of the start.

    Parameters
    ----------
    place : ndarray, shape (3,)
        Of the antenna, rad, rad, m, where no fix is near.
    velocity : ndarray, shape (3,), optional
        If it is known.
    """
    late = round((config.gnss.gnss_latency or 0.0) * SECOND)
    if fixes is None:
        return velocity, _of_imu(place, alignment, config)
    near_ns = NEAR_NS
    if not fixes.has_velocity.any():
        fixes, near_ns = _with_velocities(fixes, config).gnss, NEAR_PLACES_NS
    after_ns = fixes.time_ns - late - alignment.time_ns
    if alignment.north_referenced:
        follows = after_ns[after_ns >= 0]
        reach_ns = near_ns + int(follows[0] if len(follows) and follows[0] < FAR_NS else 0)
    else:
        reach_ns = near_ns
    near = np.flatnonzero((after_ns >= -near_ns) & (after_ns <= reach_ns))
    nearest = near[np.argsort(np.abs(after_ns[near]), kind="stable")]
    placed, moving = nearest[fixes.has_position[nearest]], nearest[fixes.has_velocity[nearest]]
    if len(placed):
        k = placed[0]
        at = np.array([fixes.latitude[k], fixes.longitude[k], fixes.height[k]])
        place = np.where(np.isfinite(at), at, place)
    place = _of_imu(place, alignment, config)
    guess = velocity
    if guess is None and len(moving):
        guess = np.nan_to_num(fixes.velocity_n[moving[0]])
    later = near[after_ns[near] >= -0.5 * source.survey.interval_ns]
    if guess is None or not len(later) or not alignment.north_referenced:
        return guess, place
    run = _navigated(place, guess, alignment, settings, source, int(after_ns[later[-1]]))
    arm_b = np.array(config.gnss.lever_arm or (0.0, 0.0, 0.0))
    seconds = after_ns[later] / SECOND
    place_off, velocity_off = errors_at_fixes(fixes.rows(later), seconds, run, arm_b)
    change = np.zeros(3)
    if velocity is not None:
        off = _middle(place_off)
    elif near_ns == NEAR_PLACES_NS and len(later) > 2:
        off, change = np.polynomial.polynomial.polyfit(seconds, place_off, 1)
    else:
        change = _middle(velocity_off)
        off = _middle(place_off - change * seconds[:, None])
    latitude, longitude = displaced(place[0], place[1], place[2], off[0], off[1])
    return guess + change, np.array([float(latitude), float(longitude), place[2] - off[2]])


def _state(place: FloatArray, velocity: FloatArray, alignment: Alignment) -> FloatArray:
    latitude, longitude, height = place.tolist()
    return initial_state(latitude, longitude, height, velocity, alignment.q_nb)


def _navigated(
    place: FloatArray,
    velocity: FloatArray,
    alignment: Alignment,
    settings: InsSettings,
    source: Source,
    for_ns: int,
) -> Solution:
    """Navigation from a first state, for so long at least if there is no gap."""
    run = InsRun(_state(place, velocity, alignment), settings)
    pieces: list[Solution] = []
    for solution in run.run(imu_blocks(source, alignment.time_ns, rows=ROWS)):
        pieces.append(solution)
        if solution.time_ns[-1] - alignment.time_ns > for_ns:
            break
    return concatenate(pieces)


def errors_at_fixes(
    fixes: GnssEpochs, seconds: FloatArray, run: Solution, arm_b: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """By how much a navigation is off: position, m, and velocity, m/s, shape (n, 3), NED.

    Parameters
    ----------
    seconds : ndarray, shape (n,)
        Of the fixes, since its start.
    """
    assert run.position is not None and run.velocity_n is not None
    t = (run.time_ns - run.time_ns[0]) / SECOND
    k = np.clip(np.searchsorted(t, seconds), 0, len(t) - 1)
    arm = rotate(run.q_nb[k], np.broadcast_to(arm_b, (len(k), 3)))
    swing = rotate(run.q_nb[k], np.cross(run.omega_ib_b[k], arm_b))
    place = run.position.copy()
    place[:, 1] = np.unwrap(place[:, 1])
    latitude, longitude, height, *velocity = (
        np.interp(seconds, t, column) for column in (*place.T, *run.velocity_n.T)
    )
    north, east = horizontal_metres(
        fixes.latitude - latitude, wrapped(fixes.longitude - longitude), latitude, height
    )
    off = np.column_stack([north, east, height - fixes.height]) - arm
    return off, fixes.velocity_n - swing - np.column_stack(velocity)


def _middle(values: FloatArray) -> FloatArray:
    """Medians of the columns of an array of shape (n, 3), without NaN; 0 where all are NaN."""
    finite = (column[np.isfinite(column)] for column in values.T)
    return np.array([float(median(column)) if len(column) else 0.0 for column in finite])
