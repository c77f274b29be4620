"""`--mode ins`: attitude, velocity and position from inertial data, height damped or not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.earth import horizontal_metres
from sinstool.core.errors import ConfigurationError
from sinstool.core.progress import Progress, share
from sinstool.core.rotation import wrapped
from sinstool.core.streams import GnssEpochs, Solution
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE, MILLI_G
from sinstool.io.readers.log import Log
from sinstool.io.readers.streams import frame_id
from sinstool.methods.alignment.initial import Alignment
from sinstool.methods.height import layout
from sinstool.methods.height.network import gravity_gradient
from sinstool.methods.height.reference import HeightReference
from sinstool.methods.strapdown.free_inertial import InsRun, InsSettings, beginning_quickly
from sinstool.methods.strapdown.navigation import initial_state
from sinstool.pipelines import summary
from sinstool.pipelines.align.first_attitude import align
from sinstool.pipelines.process.common import odometry_frames, require_gravity
from sinstool.pipelines.process.height import (
    height_reference,
    height_summary,
    height_warnings,
    network,
)
from sinstool.pipelines.process.output import Result, choose_emits
from sinstool.survey.aiding import Aiding, read_baro
from sinstool.survey.coning import choose_algorithm
from sinstool.survey.grade import sensor_grade
from sinstool.survey.interval import nominal_interval
from sinstool.survey.source import Source, imu_blocks, prepare

# A velocity this near the start is that of the start.
VELOCITY_NS = 2 * SECOND
# What a MEMS accelerometer may well be off by: 1 mg.
EXAMPLE_BIAS = MILLI_G


def run_ins(
    log: Log, config: ProcessConfig, result: Result, progress: Progress | None
) -> dict[str, Any]:
    """Inertial navigation.

    Parameters
    ----------
    progress : callable, optional
        Called with the fraction done.

    Returns
    -------
    dict
        The summary.

    Raises
    ------
    SinstoolError
    """
    source = prepare(log, config, share(progress, log.size, 0.0), whole_gnss=True)
    require_gravity(source, config)
    aiding = source.aiding
    by_log_time = source.survey.time_source == "log"
    told_before = len(aiding.warnings)
    damping = config.vertical.height_damping
    if damping == "baro":
        read_baro(log, config.input, by_log_time, aiding)
    alignment = align(source, config)
    body = frame_id(log, source.topic.channels, source.topic.path) or "imu_link"
    state, notes = start(source, aiding, alignment, config)
    reference: HeightReference | None = None
    parameters = None
    grade, why = sensor_grade(source, config)
    if damping != "off":
        reference, more = height_reference(log, aiding, config, float(state[2]))
        chosen, even_more = network(config, grade, float(state[0]))
        parameters = layout.new_parameters(chosen, grade, baro_lag=config.vertical.baro_lag)
        if not velocity_known(source, aiding, alignment, config):
            parameters = beginning_quickly(parameters)
        notes += [*more, *even_more]
        if result.recorder is not None:
            good = reference.reason == layout.ACCEPTED
            result.recorder.refer_height(
                reference.topic, reference.time_ns[good], reference.height[good]
            )
    known = ["imu", "attitude", "odometry", "fix", "tf"]
    if damping != "off":
        known.append("height")
    if result.recorder is not None and aiding.gnss is not None:
        result.recorder.refer_track(aiding.gnss.latitude, aiding.gnss.longitude)
    emits, left_out = choose_emits(log, config, known, body)
    run = InsRun(state, _settings(source, alignment, config, parameters, reference))
    frames = replace(
        odometry_frames(source, alignment, config, body),
        origin=(float(state[0]), float(state[1]), float(state[2])),
    )
    result.open(source.topic.channels[0].message_encoding, emits, frames)
    blocks = imu_blocks(source, config, alignment.time_ns, share(progress, log.size, 0.5))
    for solution in run.run(blocks):
        result.push(solution)
    told = result.finish(lambda: summary.incomplete(summary.lost(source)))
    assert result.last is not None
    height = None
    if reference is not None:
        assert result.last.vertical is not None
        final = result.last.vertical[-1]
        height = height_summary(
            reference,
            chosen,
            run.channel,
            run.events,
            run.first_ns,
            (float(final[0]), float(final[1]), float(final[2])),
        )
        height["imu_grade"] = {"grade": grade, "why": why}
        notes += height_warnings(run.channel, run.events)
    else:
        seconds = (int(result.last.time_ns[-1]) - run.first_ns) / SECOND
        notes.append(undamped_warning(float(state[0]), seconds))
    return {
        **told,
        "imu": summary.imu(source),
        "alignment": summary.alignment(alignment),
        "coning": summary.coning(run.settings.algorithm, run.settings.gyro_kind, run.updates),
        "hse": None,
        "height": height,
        "filter": None,
        "gnss_difference": difference_to_gnss(result.last, aiding.gnss),
        "final": summary.final(result.last, source),
        "lost": summary.lost(source),
        "warnings": [
            *source.warnings,
            *aiding.warnings[told_before:],
            *alignment.warnings,
            *left_out,
            *notes,
            *_run_warnings(source, run),
        ],
    }


def _settings(
    source: Source,
    alignment: Alignment,
    config: ProcessConfig,
    parameters: np.ndarray | None,
    reference: HeightReference | None,
) -> InsSettings:
    nominal = nominal_interval(source, config)
    still = source.survey.lead_in if alignment.bias_source == "still" else None
    order = config.navigation.attitude_order
    return InsSettings(
        algorithm=choose_algorithm(source, config, nominal),
        gyro_kind=config.input.gyro_kind,
        nominal_ns=nominal,
        max_gap_ns=source.survey.max_gap_ns,
        gyro_bias=alignment.gyro_bias,
        sample_rate=config.input.imu_rate,
        still_until_ns=None if still is None else still.end_ns,
        order=0 if order == "exact" else int(order),
        parameters=parameters,
        reference=reference,
    )


def start(
    source: Source, aiding: Aiding, alignment: Alignment, config: ProcessConfig
) -> tuple[np.ndarray, list[str]]:
    """State at the start: position and velocity as told or by GNSS, attitude as aligned.

    Raises
    ------
    ConfigurationError
        The position is not known.
    """
    latitude, longitude, height = source.position
    if latitude is None:
        raise ConfigurationError(
            f"{source.log.path}: navigation needs a position, and the log has no fix",
            "give --latitude, --longitude and --height",
        )
    notes = []
    if longitude is None:
        longitude = 0.0
        notes.append("no longitude is known; it is counted from 0 (give --longitude)")
    if height is None:
        height = 0.0
        notes.append("no height is known at the start; 0 m is assumed (give --height)")
    velocity = start_velocity(source, aiding, alignment, config)
    if velocity is None:
        velocity = np.zeros(3)
        notes.append(
            "no velocity is known at the start and the vehicle is not seen at rest; 0 is assumed"
            " (give --initial-velocity)"
        )
    if not alignment.north_referenced:
        notes.append(
            "heading at the start is not referenced to north, so the track is turned by whatever"
            " heading the vehicle had; use --align log, fixed or one that finds north"
        )
    position = (latitude * DEGREE, longitude * DEGREE, height)
    return initial_state(*position, velocity, alignment.q_nb), notes


def start_velocity(
    source: Source, aiding: Aiding, alignment: Alignment, config: ProcessConfig
) -> np.ndarray | None:
    """Velocity at the start: as told, at rest, or by GNSS; None where nothing tells it."""
    told = config.navigation.initial_velocity
    if told is not None:
        return np.array(told)
    still = source.survey.lead_in
    if still is not None and alignment.bias_source == "still":
        return np.zeros(3)
    gnss = aiding.gnss
    if gnss is not None and gnss.has_velocity.any():
        rows = gnss.rows(gnss.has_velocity)
        k = int(np.argmin(np.abs(rows.time_ns - alignment.time_ns)))
        if abs(int(rows.time_ns[k]) - alignment.time_ns) <= VELOCITY_NS:
            return np.asarray(np.nan_to_num(rows.velocity_n[k]))
    return None if still is None else np.zeros(3)


def velocity_known(
    source: Source, aiding: Aiding, alignment: Alignment, config: ProcessConfig
) -> bool:
    """Whether the vertical velocity at the start is known, and not only assumed."""
    return start_velocity(source, aiding, alignment, config) is not None


def undamped_warning(latitude: float, seconds: float) -> str:
    """What becomes of height without damping, by the gravity that falls off with it.

    Parameters
    ----------
    latitude : float
        rad.
    seconds : float
        Length of the run.
    """
    rate = float(np.sqrt(gravity_gradient(latitude)))
    # at the ends of 10^4 s and more the numbers only say: very far
    grown = float(np.cosh(min(rate * seconds, 50.0)))
    by_bias = EXAMPLE_BIAS * (grown - 1.0) / rate**2
    return (
        f"height is not damped and runs away: in these {seconds:.0f} s an error of 1 m at the start"
        f" grows to {_three(grown)} m, and 1 mg of the vertical accelerometer makes"
        f" {_three(by_bias)} m;"
        " --height-damping baro or gnss holds it"
    )


def _three(value: float) -> str:
    """Three digits, zeros too."""
    return f"{value:#.3g}".rstrip(".")


def difference_to_gnss(last: Solution, gnss: GnssEpochs | None) -> dict[str, Any] | None:
    """Position less that of the last fix, while there are solutions around it.

    Parameters
    ----------
    last : Solution
        The last block of a run.
    gnss : GnssEpochs or None

    Returns
    -------
    dict or None
        ``time_ns``, and ``north_m``, ``east_m``, ``up_m``; ``up_m`` is None where the fix has no
        height.
    """
    if gnss is None or last.position is None:
        return None
    inside = (gnss.time_ns >= last.time_ns[0]) & (gnss.time_ns <= last.time_ns[-1])
    rows = np.flatnonzero(inside & gnss.has_position)
    if not len(rows):
        return None
    k = int(rows[-1])
    seconds = (last.time_ns - last.time_ns[0]) * 1e-9
    at = float(gnss.time_ns[k] - last.time_ns[0]) * 1e-9
    track = last.position.copy()
    track[:, 1] = np.unwrap(track[:, 1])
    ours = np.array([np.interp(at, seconds, column) for column in track.T])
    fix = np.array([gnss.latitude[k], gnss.longitude[k], gnss.height[k]])
    off = ours - fix
    north, east = horizontal_metres(off[0], wrapped(off[1]), ours[0], ours[2])
    return {
        "time_ns": str(int(gnss.time_ns[k])),
        "north_m": float(north),
        "east_m": float(east),
        "up_m": float(off[2]) if np.isfinite(fix[2]) else None,
    }


def _run_warnings(source: Source, run: InsRun) -> list[str]:
    notes = [f"lost: {part}" for part in source.log.lost]
    if run.settings.algorithm.caveat:
        notes.append(run.settings.algorithm.caveat)
    if run.gaps_s:
        notes.append(
            f"{run.gaps_s:.3g} s without Imu data: carried over by what was measured on either side"
            " where short, at constant velocity otherwise"
        )
    if run.diverged_ns is not None:
        seconds = (run.diverged_ns - run.first_ns) / SECOND
        notes.append(
            f"after {seconds:.0f} s the solution had left the Earth (1000 km or 20 km/s) and is"
            " held there: an undamped vertical channel runs away, or the start was wrong"
        )
    return notes
