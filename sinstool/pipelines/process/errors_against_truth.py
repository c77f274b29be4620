"""What `process` is held against: attitude, position or velocity that a log or a file knows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from sinstool.core.earth import horizontal_metres
from sinstool.core.errors import TopicError
from sinstool.core.rotation import conjugate, log, multiply, wrapped
from sinstool.core.streams import Solution
from sinstool.core.timeline import SECOND, sorted_stream
from sinstool.core.units import DEGREE
from sinstool.io.readers.log import Channel, Log
from sinstool.io.readers.message_types import FIX_TYPE, VELOCITY_TYPES
from sinstool.io.readers.streams import Losses, read_fixes, read_velocity
from sinstool.io.readers.truth import at_times, read_truth

# Instants further apart tell nothing of what was between them.
LONGEST_NS = 2 * SECOND
# Key, unit, and what of an error in SI is one of that unit.
KINDS = (
    ("attitude", "deg", DEGREE),
    ("position", "m", 1.0),
    ("velocity", "m/s", 1.0),
)


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
    """Read what ``--truth`` names.

    Parameters
    ----------
    names : tuple of str
        Topics of the log: with orientations (see :func:`sinstool.io.readers.truth.read_truth`),
        NavSatFix, TwistStamped or TwistWithCovarianceStamped; or CSV files with orientations.
    body_axes : {'flu', 'frd'}

    Raises
    ------
    TopicError, LogError
        There is none of that name, it is of another type or holds too little, or two give the
        same.
    """
    references: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for name in names:
        channels = tuple(log_.channels_of(name))
        kind = channels[0].type if channels else ""
        if kind == FIX_TYPE:
            what, (times, rows) = "position", _fixes(log_, channels)
        elif kind in VELOCITY_TYPES[:2]:
            what, (times, rows) = "velocity", _velocity(log_, channels)
        else:
            what = "attitude"
            times, rows, _ = read_truth(log_, name, body_axes)
        if what in references:
            raise TopicError(log_.path, f"--truth {name}: another one gives {what} already")
        good = np.isfinite(rows).all(axis=1)
        if np.count_nonzero(good) < 2:
            raise TopicError(log_.path, f"--truth {name} holds fewer than two instants")
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
    """Errors north, east, down: root mean square, largest, and at the end."""

    instants: int
    rms: tuple[float, ...]
    largest: tuple[float, ...]
    last: tuple[float, ...]


@dataclass(frozen=True)
class RunErrors:
    """Errors of a run against what was named; None where there was nothing to compare."""

    names: tuple[str, ...]
    attitude_deg: AxisErrors | None = None
    position_m: AxisErrors | None = None
    velocity_m_s: AxisErrors | None = None

    def kinds(self) -> Iterator[tuple[str, str, AxisErrors]]:
        """What was compared: its name, unit and errors."""
        for name, unit in (("attitude_deg", "deg"), ("position_m", "m"), ("velocity_m_s", "m/s")):
            errors = getattr(self, name)
            if errors is not None:
                yield name.partition("_")[0], unit, errors


@dataclass
class Errors:
    """How far solutions are from the truth, collected as they stream by.

    Attributes
    ----------
    count, square, largest, last : dict
        By kind: instants compared; sums of squares, largest sizes and latest values of the
        three components.
    """

    truth: Truth
    count: dict[str, int] = field(default_factory=dict)
    square: dict[str, np.ndarray] = field(default_factory=dict)
    largest: dict[str, np.ndarray] = field(default_factory=dict)
    last: dict[str, np.ndarray] = field(default_factory=dict)

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
        held = getattr(self.truth, kind)
        error = np.full((len(solution), 3), np.nan)
        rows = _near(held[0], solution.time_ns)
        if rows.any():
            error[rows] = _error(kind, _part(held, solution.time_ns[rows]), solution.rows(rows))
            good = error[rows]
            none = np.zeros(3)
            self.count[kind] = self.count.get(kind, 0) + len(good)
            self.square[kind] = self.square.get(kind, none) + np.sum(good**2, axis=0)
            self.largest[kind] = np.maximum(
                self.largest.get(kind, none), np.max(np.abs(good), axis=0)
            )
            self.last[kind] = good[-1]
        return error

    def summary(self) -> RunErrors:
        """Errors over the whole run."""
        errors = {kind: self._of(kind, size) for kind, _, size in KINDS if kind in self.count}
        return RunErrors(
            tuple(self.truth.names),
            errors.get("attitude"),
            errors.get("position"),
            errors.get("velocity"),
        )

    def _of(self, kind: str, size: float) -> AxisErrors:
        rms = np.sqrt(self.square[kind] / self.count[kind])
        return AxisErrors(
            self.count[kind],
            tuple((rms / size).tolist()),
            tuple((self.largest[kind] / size).tolist()),
            tuple((self.last[kind] / size).tolist()),
        )


def _near(known_ns: np.ndarray, at_ns: np.ndarray) -> np.ndarray:
    """Which times lie between two instants that are known and not far apart."""
    after = np.searchsorted(known_ns, at_ns)
    inside = (at_ns >= known_ns[0]) & (at_ns <= known_ns[-1])
    after = np.clip(after, 1, len(known_ns) - 1)
    apart = known_ns[after] - known_ns[after - 1]
    return np.asarray(inside & ((apart <= LONGEST_NS) | (known_ns[after] == at_ns)))


def _part(
    held: tuple[np.ndarray, np.ndarray], wanted_ns: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The stretch of a reference around times, and those."""
    times, values = held
    begin = int(np.searchsorted(times, wanted_ns[0], "right")) - 1
    begin = min(max(0, begin), len(times) - 2)
    end = max(int(np.searchsorted(times, wanted_ns[-1], "left")) + 1, begin + 2)
    return times[begin:end], values[begin:end], wanted_ns


def _error(
    kind: str, part: tuple[np.ndarray, np.ndarray, np.ndarray], solution: Solution
) -> np.ndarray:
    times, values, instants = part
    if kind == "attitude":
        true = at_times(times, values, instants)
        return log(multiply(solution.q_nb, conjugate(true)))
    seconds, at = (times - times[0]) * 1e-9, (instants - times[0]) * 1e-9
    if kind == "velocity":
        assert solution.velocity_n is not None
        true = np.stack([np.interp(at, seconds, column) for column in values.T], axis=1)
        return np.asarray(solution.velocity_n - true)
    assert solution.position is not None
    values = values.copy()
    values[:, 1] = np.unwrap(values[:, 1])
    true = np.stack([np.interp(at, seconds, column) for column in values.T], axis=1)
    off = solution.position - true
    north, east = horizontal_metres(off[:, 0], wrapped(off[:, 1]), true[:, 0], true[:, 2])
    return np.stack([north, east, -off[:, 2]], axis=1)
