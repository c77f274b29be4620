"""Errors of a solution against attitude, position or velocity from a log or a file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sinstool.core.earth import horizontal_metres
from sinstool.core.errors import TopicError
from sinstool.core.finding import Finding
from sinstool.core.rotation import conjugate, exp, log, multiply, tilt_and_heading, wrapped
from sinstool.core.streams import Solution
from sinstool.core.timeline import SECOND, sorted_stream
from sinstool.core.units import DEGREE
from sinstool.io.readers.log import Channel, Log
from sinstool.io.readers.message_types import FIX_TYPES, VELOCITY_TYPES
from sinstool.io.readers.streams import Losses, read_fixes, read_velocity
from sinstool.io.readers.truth import at_times, read_truth

# Reference values further apart than this are not interpolated.
LONGEST_NS = 2 * SECOND
# Verticals of a result and of a reference that differ by more, deg, are not of the same body.
OTHER_AXES_DEG = 15.0
# Key, unit, and its size in SI units.
KINDS = (("attitude", "deg", DEGREE), ("position", "m", 1.0), ("velocity", "m/s", 1.0))


@dataclass(frozen=True)
class Truth:
    """Reference values by time.

    Attributes
    ----------
    attitude : tuple or None
        Times (ns) and quaternions q_nb, shape (k, 4).
    position : tuple or None
        Times and latitude, longitude (rad), height (m), shape (k, 3).
    velocity : tuple or None
        Times and north, east, down (m/s), shape (k, 3).
    names : tuple of str
        Topics and files.
    """

    attitude: tuple[np.ndarray, np.ndarray] | None = None
    position: tuple[np.ndarray, np.ndarray] | None = None
    velocity: tuple[np.ndarray, np.ndarray] | None = None
    names: tuple[str, ...] = ()


def read_references(log_: Log, names: tuple[str, ...], body_axes: str) -> Truth:
    """Read the references of ``--truth``.

    Parameters
    ----------
    names : tuple of str
        Topics of the log: with orientations (see :func:`sinstool.io.readers.truth.read_truth`),
        NavSatFix, TwistStamped or TwistWithCovarianceStamped; or CSV files with orientations.
    body_axes : {'flu', 'frd'}

    Raises
    ------
    TopicError, LogError
        There is no such topic or file, it is of another type or holds too little, or two give the
        same quantity.
    """
    references: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for name in names:
        if fixes := tuple(log_.channels_of(name, *FIX_TYPES)):
            what, (times, rows) = "position", _fixes(log_, fixes)
        elif velocities := tuple(log_.channels_of(name, *VELOCITY_TYPES[:2])):
            what, (times, rows) = "velocity", _velocity(log_, velocities)
        else:
            what = "attitude"
            times, rows = read_truth(log_, name, body_axes)
        if what in references:
            raise TopicError(
                log_.path,
                f"--truth {name}: another --truth gives the {what} already",
                "leave one of them out; positions are compared with a NavSatFix topic, velocities"
                " with a TwistStamped or TwistWithCovarianceStamped topic",
            )
        good = np.isfinite(rows).all(axis=1)
        if np.count_nonzero(good) < 2:
            raise TopicError(log_.path, f"--truth {name} holds fewer than two values")
        references[what] = (times[good], rows[good])
    return Truth(**references, names=names)


def _fixes(log_: Log, channels: tuple[Channel, ...]) -> tuple[np.ndarray, np.ndarray]:
    ordered = sorted_stream(read_fixes(log_, channels, Losses()))
    if ordered is None:
        return np.empty(0, np.int64), np.empty((0, 3))
    fixes = ordered.stream
    rows = np.stack([fixes.latitude, fixes.longitude, fixes.height], axis=1)
    rows[fixes.status < 0] = np.nan
    return fixes.time_ns, rows


def _velocity(log_: Log, channels: tuple[Channel, ...]) -> tuple[np.ndarray, np.ndarray]:
    ordered = sorted_stream(read_velocity(log_, channels, Losses()))
    if ordered is None:
        return np.empty(0, np.int64), np.empty((0, 3))
    return ordered.stream.time_ns, ordered.stream.velocity_n


@dataclass(frozen=True)
class AxisErrors:
    """Errors along north, east and down.

    Attributes
    ----------
    instants : int
        Number of comparisons.
    rms, largest, last : tuple of float
        Root mean square, largest size, and at the end.
    """

    instants: int
    rms: tuple[float, ...]
    largest: tuple[float, ...]
    last: tuple[float, ...]


@dataclass(frozen=True)
class VerticalErrors:
    """Inclination, the angle between the verticals, and heading by itself, deg.

    Attributes
    ----------
    inclination_rms, inclination_largest : float
        Of the inclination.
    heading_rms : float
        Of the heading.
    heading_drift : float
        Last error of heading less the first, within half a turn.
    heading_aligned : float or None
        First error of heading, subtracted from all headings if nothing references them to north;
        else None.
    """

    inclination_rms: float
    inclination_largest: float
    heading_rms: float
    heading_drift: float
    heading_aligned: float | None


@dataclass(frozen=True)
class RunErrors:
    """Errors of a run against references; None where there was nothing to compare.

    Attributes
    ----------
    names : tuple of str
        Topics and files of ``--truth``.
    attitude_deg : AxisErrors or None
        Small rotation from the true attitude to the computed one.
    vertical_deg : VerticalErrors or None
        The same, as inclination and heading.
    position_m, velocity_m_s : AxisErrors or None
        Computed less true.
    """

    names: tuple[str, ...]
    attitude_deg: AxisErrors | None = None
    vertical_deg: VerticalErrors | None = None
    position_m: AxisErrors | None = None
    velocity_m_s: AxisErrors | None = None

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Whether the reference seems not to be one of this attitude."""
        apart = self.vertical_deg
        if apart is None or apart.inclination_rms < OTHER_AXES_DEG:
            return ()
        return (
            Finding(
                "truth-axes",
                "the verticals of --truth and of the result differ by"
                f" {apart.inclination_rms:.0f} deg: the reference may be in other axes, from world"
                " to body, a placeholder or of other times, and then these are no errors",
                answer="give orientations from body to world, Forward-Left-Up in East-North-Up, or"
                " with --body-axes frd Forward-Right-Down in North-East-Down",
                numbers={"inclination_deg": apart.inclination_rms},
            ),
        )

    def kinds(self) -> Iterator[tuple[str, str, AxisErrors]]:
        """What was compared: its name, unit and errors."""
        for name, unit in (("attitude_deg", "deg"), ("position_m", "m"), ("velocity_m_s", "m/s")):
            errors = getattr(self, name)
            if errors is not None:
                yield name.partition("_")[0], unit, errors


class Errors:
    """Errors of solutions against the truth, collected block by block."""

    def __init__(self, truth: Truth) -> None:
        self.truth = truth
        # Nothing refers headings to north: they are compared as they change from the first.
        self.free_heading = False
        self._apart = _Apart()
        # By kind: instants compared; sums of squares, largest sizes and latest values by axis.
        self._sums: dict[str, tuple[int, np.ndarray, np.ndarray, np.ndarray]] = {}

    def kinds(self, solution: Solution) -> list[str]:
        """What of a solution can be compared."""
        computed = {
            "attitude": self.truth.attitude is not None,
            "position": self.truth.position is not None and solution.position is not None,
            "velocity": self.truth.velocity is not None and solution.velocity_n is not None,
        }
        return [kind for kind, _, _ in KINDS if computed[kind]]

    def push(self, kind: str, solution: Solution) -> np.ndarray:
        """Errors of solutions: what was computed less what is true, north, east, down.

        Parameters
        ----------
        kind : {'attitude', 'position', 'velocity'}

        Returns
        -------
        ndarray, shape (n, 3)
            rad (the small rotation in NED from the true attitude to the one computed), m or
            m/s; NaN where no truth is near.
        """
        times, values = getattr(self.truth, kind)
        error = np.full((len(solution), 3), np.nan)
        rows = _near(times, solution.time_ns)
        if rows.any():
            compared = solution.rows(rows)
            part = _around(times, compared.time_ns)
            if kind == "attitude":
                turn = _attitude_error(times[part], values[part], compared)
                good = log(self._apart.push(turn, self.free_heading))
            else:
                good = _error(kind, times[part], values[part], compared)
            error[rows] = good
            count, square, largest, _ = self._sums.get(kind, (0, *np.zeros((3, 3))))
            self._sums[kind] = (
                count + len(good),
                square + np.sum(good**2, axis=0),
                np.maximum(largest, np.max(np.abs(good), axis=0)),
                good[-1],
            )
        return error

    def summary(self) -> RunErrors:
        """Errors over the whole run."""
        errors: dict[str, AxisErrors | None] = dict.fromkeys(kind for kind, _, _ in KINDS)
        for kind, _, size in KINDS:
            if kind in self._sums:
                count, square, largest, last = self._sums[kind]
                by_axis = np.stack([np.sqrt(square / count), largest, last]) / size
                errors[kind] = AxisErrors(count, *(tuple(row) for row in by_axis.tolist()))
        return RunErrors(
            self.truth.names,
            errors["attitude"],
            self._apart.summary(self.free_heading),
            errors["position"],
            errors["velocity"],
        )


class _Apart:
    """Errors of inclination and of heading, separately."""

    def __init__(self) -> None:
        self._first: float | None = None
        self._count = 0
        self._squares = np.zeros(2)
        self._largest = self._last = 0.0

    def push(self, turn: np.ndarray, free_heading: bool) -> np.ndarray:
        """Take the rotations that lead from true attitudes to those computed, shape (n, 4).

        Returns
        -------
        ndarray, shape (n, 4)
            The same, without the first error of heading if that is free.
        """
        if self._first is None:
            self._first = float(tilt_and_heading(turn[0])[1])
        if free_heading:
            turn = multiply(exp([0.0, 0.0, -self._first]), turn)
        level, heading = tilt_and_heading(turn)
        tilt = np.linalg.norm(level, axis=1)
        self._count += len(turn)
        self._squares += np.sum(tilt**2), np.sum(heading**2)
        self._largest = max(self._largest, float(tilt.max()))
        self._last = float(heading[-1])
        return turn

    def summary(self, free_heading: bool) -> VerticalErrors | None:
        if self._first is None:
            return None
        inclination, heading = np.sqrt(self._squares / self._count) / DEGREE
        drift = self._last if free_heading else float(wrapped(self._last - self._first))
        return VerticalErrors(
            float(inclination),
            self._largest / DEGREE,
            float(heading),
            drift / DEGREE,
            self._first / DEGREE if free_heading else None,
        )


def _near(times: np.ndarray, at_ns: np.ndarray) -> np.ndarray:
    """Times that lie between two nearby instants of a reference."""
    after = np.clip(np.searchsorted(times, at_ns), 1, len(times) - 1)
    inside = (at_ns >= times[0]) & (at_ns <= times[-1])
    apart = times[after] - times[after - 1]
    return np.asarray(inside & ((apart <= LONGEST_NS) | (times[after] == at_ns)))


def _around(times: np.ndarray, at_ns: np.ndarray) -> slice:
    """The instants of a reference around times."""
    begin = int(np.searchsorted(times, at_ns[0], "right")) - 1
    begin = min(max(0, begin), len(times) - 2)
    return slice(begin, max(int(np.searchsorted(times, at_ns[-1], "left")) + 1, begin + 2))


def _attitude_error(times: np.ndarray, q_nb: np.ndarray, solution: Solution) -> np.ndarray:
    """Rotations in NED that lead from true attitudes to those computed."""
    return multiply(solution.q_nb, conjugate(at_times(times, q_nb, solution.time_ns)))


def _error(kind: str, times: np.ndarray, values: np.ndarray, solution: Solution) -> np.ndarray:
    if kind == "position":
        values = np.column_stack([values[:, 0], np.unwrap(values[:, 1]), values[:, 2]])
    seconds, at = (times - times[0]) * 1e-9, (solution.time_ns - times[0]) * 1e-9
    true = np.stack([np.interp(at, seconds, column) for column in values.T], axis=1)
    if kind == "velocity":
        return np.asarray(solution.velocity_n - true)
    off = np.asarray(solution.position - true)
    north, east = horizontal_metres(off[:, 0], wrapped(off[:, 1]), true[:, 0], true[:, 2])
    return np.stack([north, east, -off[:, 2]], axis=1)
