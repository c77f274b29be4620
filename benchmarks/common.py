"""What several benchmarks need: units, options, tables, runs over seeds, increments and errors."""

from __future__ import annotations

import argparse
import multiprocessing
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from sinstool.core import earth, rotation
from sinstool.core.streams import concatenate, take_rows
from sinstool.core.units import DEGREE, STANDARD_GRAVITY
from sinstool.methods.coning.algorithm import GyroKind
from sinstool.methods.coning.registry import algorithm
from sinstool.methods.coning.stage import ConingStage
from sinstool.methods.strapdown.velocity import Increments, IncrementStage
from sinstool.simulation.truth import Trajectory

FloatArray = NDArray[np.float64]
Outcome = TypeVar("Outcome")

ARCSEC = DEGREE / 3600.0
DEG_H = DEGREE / 3600.0  # rad/s
DEG_SQRT_H = DEGREE / 60.0  # rad/sqrt(s)
G = STANDARD_GRAVITY
UG = 1e-6 * G

# --- options --------------------------------------------------------------------------------


def parser(about: str | None, **defaults: int | float) -> argparse.ArgumentParser:
    """A parser that has the first line of `about`, and an option of each name that is given."""
    made = argparse.ArgumentParser(description=(about or "").split("\n", 1)[0])
    for name, value in defaults.items():
        made.add_argument(f"--{name.replace('_', '-')}", type=type(value), default=value)
    return made


# --- tables ---------------------------------------------------------------------------------


def line(cells: Iterable[object]) -> str:
    """A row of a table in Markdown; '-' for what is missing."""
    texts = ("-" if cell is None else str(cell) for cell in cells)
    return "|" + "".join(f" {text} |" if text else " |" for text in texts)


def print_table(head: Sequence[str], rows: Iterable[Iterable[object]], title: str = "") -> None:
    """Print a table in Markdown, each row as soon as it is there."""
    if title:
        print(f"{title}\n")
    print(f"{line(head)}\n{'|---' * len(head)}|")
    for cells in rows:
        print(line(cells), flush=True)


def numbers(values: Iterable[float | None], form: str = ".3g", between: str = " ") -> str:
    """Numbers in one cell; '-' for those that are missing."""
    return between.join("-" if x is None else format(x, form) for x in values)


# --- runs -----------------------------------------------------------------------------------

_work: Callable[[int], Any] | None = None


def _one(seed: int) -> Any:
    assert _work is not None
    return _work(seed)


def over_seeds(
    work: Callable[[int], Outcome], seeds: Sequence[int], processes: int, chunk: int = 1
) -> list[Outcome]:
    """Outcomes of all seeds; what `work` refers to is shared with the processes, not sent."""
    global _work
    if processes <= 1:
        return [work(seed) for seed in seeds]
    _work = work
    with multiprocessing.get_context("fork").Pool(processes) as pool:
        return pool.map(_one, seeds, chunksize=chunk)


def best(
    run: Callable[[], object], repeats: int, clock: Callable[[], float] = time.perf_counter
) -> float:
    """Shortest time of several, s: the one that other programs disturbed least."""
    times = []
    for _ in range(repeats):
        begin = clock()
        run()
        times.append(clock() - begin)
    return min(times)


# --- navigation -----------------------------------------------------------------------------


def compensated(
    time_ns: NDArray[np.int64],
    gyro: FloatArray,
    accel: FloatArray,
    interval: float,
    name: str = "previous-1",
    kind: GyroKind = "mean-rate",
) -> Increments:
    """Increments of samples, compensated by a coning algorithm.

    Parameters
    ----------
    time_ns : (n,) array
    gyro, accel : (n, 3) array
        rad/s and m/s^2, of what `kind` says.
    interval : float
        Nominal, s.
    """
    stage = IncrementStage(
        lambda: ConingStage(algorithm(name), kind, nominal_interval=float(interval))
    )
    parts = [stage.push(gyro, accel, time_ns), stage.finish()]
    return concatenate(parts)


def rows_of(increments: Increments, rows: slice | FloatArray) -> Increments:
    """Some of the increments."""
    return take_rows(increments, rows)


def state_errors(flight: Trajectory, rows: Any, nav: FloatArray) -> FloatArray:
    """Errors of a navigation against the truth at `rows` of the flight.

    Parameters
    ----------
    nav : (m, 10) array
        Latitude and longitude (rad), height (m), velocity NED (m/s), q_nb.

    Returns
    -------
    (m, 9) array
        North and east (m), up turned to down (m), velocity NED (m/s), psi NED (rad).
    """
    latitude, height = flight.latitude[rows], flight.height[rows]
    meridian, transverse = earth.radii_of_curvature(latitude)
    east = (nav[:, 1] - flight.longitude[rows]) * (transverse + height) * np.cos(latitude)
    return np.column_stack(
        [
            (nav[:, 0] - latitude) * (meridian + height),
            east,
            height - nav[:, 2],
            nav[:, 3:6] - flight.velocity_n[rows],
            psi(nav[:, 6:10], flight.imu.q_nb[rows]),
        ]
    )


def psi(q_nb: FloatArray, q_true: FloatArray) -> FloatArray:
    """Small rotation from the computed to the true attitude, in n, rad."""
    return rotation.log(rotation.multiply(q_true, rotation.conjugate(q_nb)))


def off_by(
    flight: Trajectory, metres: FloatArray, velocity: FloatArray, attitude: FloatArray
) -> tuple[float, float, float, FloatArray, FloatArray]:
    """The flight's first state with errors: latitude, longitude, height, velocity, q_nb.

    Parameters
    ----------
    metres, velocity, attitude : (3,) array
        North, east, down: m, m/s, and psi in rad.
    """
    latitude, height = float(flight.latitude[0]), float(flight.height[0])
    meridian, transverse = earth.radii_of_curvature(latitude)
    east = metres[1] / ((transverse + height) * np.cos(latitude))
    return (
        latitude + metres[0] / (meridian + height),
        float(flight.longitude[0] + east),
        height - metres[2],
        flight.velocity_n[0] + velocity,
        rotation.multiply(rotation.exp(-attitude), flight.imu.q_nb[0]),
    )


# --- statistics -----------------------------------------------------------------------------


def rms(errors: FloatArray | Sequence[FloatArray]) -> FloatArray:
    """Of each column, over the rows of all runs."""
    together = errors if isinstance(errors, np.ndarray) else np.concatenate(errors)
    return np.sqrt(np.mean(together**2, axis=0))


def standard_error(errors: Sequence[FloatArray]) -> FloatArray:
    """Of :func:`rms`, from how much runs differ."""
    squares = np.array([np.mean(e**2, axis=0) for e in errors])
    if len(squares) < 2:
        return np.full(squares.shape[1], np.nan)
    spread = squares.std(axis=0, ddof=1) / np.sqrt(len(squares))
    return np.asarray(spread / (2.0 * np.sqrt(squares.mean(axis=0))))


def nees(errors: FloatArray, covariance: FloatArray) -> FloatArray:
    """Squares of errors by their covariance, over the number of states; rows are instants."""
    solved = np.linalg.solve(covariance, errors[..., None])[..., 0]
    return np.sum(errors * solved, axis=-1) / errors.shape[-1]
