"""Figures of a simulated log: the motion, and its sensor data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.earth import horizontal_metres
from sinstool.core.rotation import to_euler, wrapped
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.height.standard_atmosphere import geometric, pressure_altitude
from sinstool.report.figure import Figure, Series, heading_curve
from sinstool.report.figures.parts import AXES, BODY, track
from sinstool.simulation.hse_rig import HseRigLog
from sinstool.simulation.truth import ImuTruth, Trajectory

TIME = "time, s"
# What a sensor measures that is off by less is exact but for rounding.
EXACT = 1e-12
# A closer look is drawn where the rate about an axis changes sign more often than this, Hz, and
# is so long, in samples.
FAST_HZ = 1.0
CLOSE = 200


def motion_figures(
    truth: ImuTruth, sensor: ImuTruth, trajectory: Trajectory | None
) -> tuple[Figure, ...]:
    """The true motion and the errors of the sensors, the main figure first.

    Parameters
    ----------
    truth : ImuTruth
        Exact.
    sensor : ImuTruth
        As measured.
    trajectory : Trajectory, optional
        Where the vehicle is.
    """
    seconds = _seconds(truth.time_ns, truth.time_ns)
    attitude = attitude_figures(seconds, truth.q_nb)
    rate = _three(
        "rate", "Angular rate", seconds, truth.gyro_rate / DEGREE, BODY, "rate, deg/s",
        "True, relative to inertial space: it includes the Earth's rate if the scenario has it.",
    )  # fmt: skip
    force = _three(
        "force", "Specific force", seconds, truth.specific_force, BODY, "specific force, m/s²",
        "True. At rest it is -9.8 m/s² along down.",
    )  # fmt: skip
    figures: list[Figure] = []
    if trajectory is not None:
        figures += _travel(seconds, trajectory)
    close = _closer(seconds, truth.gyro_rate / DEGREE)
    figures += [*([close] if close else []), *attitude, rate, force]
    return (*figures, *_errors(seconds, truth, sensor))


def attitude_figures(seconds: FloatArray, q_nb: FloatArray) -> list[Figure]:
    """Roll, pitch and heading.

    Parameters
    ----------
    seconds : ndarray, shape (n,)
    q_nb : ndarray, shape (n, 4)
    """
    roll, pitch, heading = (to_euler(q_nb) / DEGREE).T
    turned, within = heading_curve(seconds, heading)
    tilt = (Series("roll", roll), Series("pitch", pitch))
    return [
        Figure("tilt", "Roll and pitch", seconds, tilt, TIME, "angle, deg",
               notes=("True attitude of the Forward-Right-Down axes in North-East-Down.",)),
        Figure("heading", "Heading", turned, (Series("heading", within),), TIME, "heading, deg",
               notes=("True, from north over east.",)),
    ]  # fmt: skip


def _seconds(time_ns: IntArray, first: IntArray) -> FloatArray:
    return np.asarray((time_ns - first[0]) / SECOND, dtype=np.float64)


def _three(
    key: str,
    title: str,
    seconds: FloatArray,
    values: FloatArray,
    names: Sequence[str],
    ylabel: str,
    note: str,
) -> Figure:
    series = tuple(Series(name, values[:, k]) for k, name in enumerate(names))
    return Figure(key, title, seconds, series, TIME, ylabel, notes=(note,))


def _closer(seconds: FloatArray, rate: FloatArray) -> Figure | None:
    """Some samples from the middle of a motion that is too fast to be seen as a whole."""
    centred = rate - rate.mean(axis=0)
    turns = np.count_nonzero(np.diff(np.signbit(centred), axis=0), axis=0)
    if len(rate) <= CLOSE or turns.max() / (seconds[-1] - seconds[0]) < 2.0 * FAST_HZ:
        return None
    middle = len(rate) * 2 // 3
    rows = slice(middle - CLOSE // 2, middle + CLOSE // 2)
    note = f"{CLOSE} samples, each a point of the curves; the whole log is below."
    return _three(
        "closer", "Angular rate, a closer look", seconds[rows], rate[rows], BODY, "rate, deg/s",
        note,
    )  # fmt: skip


def _travel(seconds: FloatArray, trajectory: Trajectory) -> list[Figure]:
    return [
        track("true", trajectory.latitude, trajectory.longitude),
        Figure("height", "Height", seconds, (Series("true", trajectory.height),), TIME,
               "height, m", notes=("True, above the ellipsoid.",)),
        _three("velocity", "Velocity", seconds, trajectory.velocity_n, AXES, "velocity, m/s",
               "True, over ground."),
    ]  # fmt: skip


def _errors(seconds: FloatArray, truth: ImuTruth, sensor: ImuTruth) -> list[Figure]:
    """Measured less true values, as means over each interval."""
    figures = []
    for key, title, off, size, unit in (
        ("gyro-error", "Error of the gyros", sensor.gyro_mean_rate - truth.gyro_mean_rate,
         DEGREE / 3600.0, "deg/h"),
        ("accel-error", "Error of the accelerometers",
         sensor.mean_specific_force - truth.mean_specific_force, 1e-3, "mm/s²"),
    ):  # fmt: skip
        if np.abs(off).max() > EXACT:
            whole = np.cumsum(off * truth.interval[:, None], axis=0)
            figures.append(
                _three(key, title, seconds, off / size, BODY, f"error, {unit}",
                       "Measured less true, of each sample: bias, noise and scale errors.")
            )  # fmt: skip
            if key == "gyro-error":
                text = "The errors integrated: noise averages out, a bias is a slope."
                figures.append(
                    _three("gyro-sum", "Angle that the gyro errors add up to", seconds,
                           whole / DEGREE, BODY, "angle, deg", text)
                )  # fmt: skip
    return figures


def fix_figures(
    time_ns: IntArray, columns: Mapping[str, FloatArray], trajectory: Trajectory
) -> list[Figure]:
    """Errors of the fixes against the true motion at their stamps.

    Parameters
    ----------
    time_ns : ndarray of int64, shape (m,)
        Of the fixes.
    columns : mapping
        ``latitude``, ``longitude`` (deg) and ``altitude`` (m), shape (m,).
    """
    seconds = _seconds(trajectory.time_ns, trajectory.time_ns)
    at = _seconds(time_ns, trajectory.time_ns)
    latitude = np.interp(at, seconds, trajectory.latitude)
    longitude = np.interp(at, seconds, np.unwrap(trajectory.longitude))
    height = np.interp(at, seconds, trajectory.height)
    north, east = horizontal_metres(
        columns["latitude"] * DEGREE - latitude,
        wrapped(columns["longitude"] * DEGREE - longitude),
        latitude,
        height,
    )
    off = np.stack([north, east, height - columns["altitude"]], axis=1)
    series = tuple(Series(name, off[:, k], style="points") for k, name in enumerate(AXES))
    notes = (
        "Fix minus true position of the IMU at the fix's stamp; includes lever arm and latency.",
    )
    return [
        Figure("fix-error", "Error of the fixes", at, series, TIME, "error, m", notes=notes)
    ]  # fmt: skip


def baro_figures(time_ns: IntArray, pressure: FloatArray, trajectory: Trajectory) -> list[Figure]:
    """Error of the barometer's height.

    Parameters
    ----------
    time_ns : ndarray of int64, shape (m,)
    pressure : ndarray, shape (m,)
        Pa.
    """
    seconds = _seconds(trajectory.time_ns, trajectory.time_ns)
    at = _seconds(time_ns, trajectory.time_ns)
    off = geometric(pressure_altitude(pressure)) - np.interp(at, seconds, trajectory.height)
    note = "Height of the pressure in the standard atmosphere minus the true height."
    series = (Series("error", off),)
    return [
        Figure("baro-error", "Error of the barometer", at, series, TIME, "error, m", notes=(note,))
    ]


def rig_figures(log: HseRigLog) -> tuple[Figure, ...]:
    """Motion of a turntable, and its sensors' measurements."""
    seconds = _seconds(log.time_ns, log.time_ns)
    axes = ("x", "y", "z")
    tilt, heading = attitude_figures(seconds, log.truth.q_nb)
    return (
        Figure("table", "Rate of the table", seconds,
               (Series("rate", log.truth.rate / DEGREE),), TIME, "rate, deg/s",
               notes=("True, positive clockwise seen from above.",)),
        tilt,
        heading,
        _three("gyro", "Raw rates of the triad", seconds, log.gyro / DEGREE, axes, "rate, deg/s",
               "As measured, means over the intervals; a skewed triad shares the turning."),
        _three("accel", "Raw specific force of the triad", seconds, log.accel, axes,
               "specific force, m/s²", "As measured, means over the intervals."),
    )  # fmt: skip
