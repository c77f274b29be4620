"""Figures of a run of `process`, collected while its solutions stream by.

A run pushes every block of solutions; its memory does not grow with the log. What a kind of run
knows besides, such as a filter's innovations, it adds as figures of its own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sinstool.core.envelope import Envelope
from sinstool.core.rotation import to_euler
from sinstool.core.streams import Solution
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.pipelines.process.errors_against_truth import KINDS, Errors, RunErrors, Truth
from sinstool.pipelines.process.result import ProcessResult
from sinstool.report.figure import Figure
from sinstool.report.figures import process as draw
from sinstool.report.figures.parts import AXES, track
from sinstool.report.text.account import heading_origin

if TYPE_CHECKING:
    from sinstool.pipelines.process.summary import FilterCourse

# Events shown as lines in a figure; more would be a wall.
MARKS = 12
# Fixes drawn on the track; of more, every so many.
FIXES = 4000


class Recorder:
    """Collects the content of a run's page while it runs.

    Parameters
    ----------
    truth : Truth, optional
        The run is compared with it.
    """

    def __init__(self, truth: Truth | None = None) -> None:
        # Of a kind of run; they stand among the checks, after errors and sigmas.
        self.extra: list[Figure] = []
        self._errors = None if truth is None else Errors(truth)
        self._origin_ns = 0
        self._columns: list[str] = []
        self._motion: Envelope | None = None
        self._heading = 0.0
        self._off: dict[str, Envelope] = {}
        self._fixes: np.ndarray | None = None
        self._reference: tuple[str, np.ndarray, np.ndarray] | None = None
        self._difference = Envelope(2)
        self._compared = 0
        self._last: tuple[int, float] | None = None

    def refer_height(self, name: str, time_ns: np.ndarray, height: np.ndarray) -> None:
        """Heights that the run is held to, to be shown beside its own.

        Parameters
        ----------
        time_ns : ndarray of int64, shape (m,)
        height : ndarray, shape (m,)
            Those that could be used, m.
        """
        order = np.argsort(time_ns, kind="stable")
        self._reference = (name, time_ns[order], height[order])

    def refer_track(self, latitude: np.ndarray, longitude: np.ndarray) -> None:
        """Fixes, to be shown beside the computed track.

        Parameters
        ----------
        latitude, longitude : ndarray, shape (m,)
            rad; NaN where a fix has no position.
        """
        valid = np.flatnonzero(np.isfinite(latitude) & np.isfinite(longitude))
        rows = valid[:: max(1, -(-len(valid) // FIXES))]
        self._fixes = np.stack([latitude[rows], longitude[rows]], axis=1)

    def free_heading(self) -> None:
        """Hold headings against the truth as they change from the first."""
        if self._errors is not None:
            self._errors.free_heading = True

    def refer_filter(self, course: FilterCourse) -> None:
        """Innovations, their squares and biases of a filter that has come to its end."""
        from sinstool.report.figures.filter import filter_figures

        self.extra += filter_figures(course)

    def push(self, solution: Solution) -> None:
        """Take the next solutions, in the order of time."""
        if not len(solution):
            return
        values = self._values(solution)
        if self._motion is None:
            self._origin_ns = int(solution.time_ns[0])
            self._columns = list(values)
            self._motion = Envelope(len(values))
        self._motion.push(solution.time_ns, np.stack(list(values.values()), axis=1))
        if self._errors is not None:
            for kind in self._errors.kinds(solution):
                error = self._errors.push(kind, solution)
                self._off.setdefault(kind, Envelope(3)).push(solution.time_ns, error)
        height = values.get("height")
        if height is not None and self._reference is not None:
            self._compare(solution.time_ns, height)

    def _values(self, solution: Solution) -> dict[str, np.ndarray]:
        roll, pitch, heading = (to_euler(solution.q_nb) / DEGREE).T
        # without steps, so that extremes of a group make sense
        turned = np.unwrap(np.concatenate([[self._heading], heading]), period=360.0)[1:]
        self._heading = float(turned[-1])
        values = {
            "roll": roll,
            "pitch": pitch,
            "heading": turned,
            "rate": np.linalg.norm(solution.omega_ib_b, axis=1) / DEGREE,
            "force": np.linalg.norm(solution.specific_force_b, axis=1),
        }
        if solution.position is not None:
            values |= dict(
                zip(("latitude", "longitude", "height"), solution.position.T, strict=True)
            )
        if solution.velocity_n is not None:
            values |= dict(zip(AXES, solution.velocity_n.T, strict=True))
            values["speed"] = np.hypot(*solution.velocity_n[:, :2].T)
        if solution.vertical is not None:
            names = ("height", "up", "correction")
            values |= dict(zip(names, solution.vertical.T, strict=True))
        sigmas = {
            "position": solution.covariance_position_n,
            "velocity": solution.covariance_velocity_n,
            "attitude": solution.covariance_attitude_n,
        }
        for kind, _, size in KINDS:
            covariance = sigmas[kind]
            if covariance is not None:
                sigma = np.sqrt(np.einsum("nii->ni", covariance)) / size
                values |= {f"{kind} {axis}": sigma[:, k] for k, axis in enumerate(AXES)}
        return values

    def _compare(self, time_ns: np.ndarray, height: np.ndarray) -> None:
        """Difference to the height reference, at its instants."""
        assert self._reference is not None
        _, stamps, heights = self._reference
        if self._last is None:
            self._compared = int(np.searchsorted(stamps, time_ns[0]))
        else:
            time_ns = np.concatenate([[self._last[0]], time_ns])
            height = np.concatenate([[self._last[1]], height])
        self._last = (int(time_ns[-1]), float(height[-1]))
        end = int(np.searchsorted(stamps, time_ns[-1], "right"))
        rows = slice(self._compared, end)
        if end <= self._compared:
            return
        self._compared = end
        origin = self._origin_ns
        ours = np.interp((stamps[rows] - origin) * 1e-9, (time_ns - origin) * 1e-9, height)
        both = np.stack([heights[rows], ours - heights[rows]], axis=1)
        self._difference.push(stamps[rows], both)

    def errors(self) -> RunErrors | None:
        """Errors of the run; None without a truth."""
        return None if self._errors is None else self._errors.summary()

    def figures(self, result: ProcessResult) -> tuple[tuple[Figure, ...], tuple[Figure, ...]]:
        """The figures of the run.

        Returns
        -------
        results : tuple of Figure
            Where the vehicle was and how it pointed, the main figure first.
        checks : tuple of Figure
            How good that is, and what it was computed from.
        """
        if self._motion is None:
            return (), ()
        seconds, values = self._motion.curves(self._origin_ns)
        curves = draw.Curves(seconds, dict(zip(self._columns, values.T, strict=True)))
        axes = _axes(result)
        attitude = draw.heading(curves, axes, heading_origin(result))
        tilt = draw.tilt(curves, " ".join([axes, *self._about_curves()]))
        vertical = draw.vertical(curves, self._held(), self._marks(result))
        off = {kind: values.curves(self._origin_ns) for kind, values in self._off.items()}
        errors = draw.errors(off, curves)
        shown = [figure.key.removeprefix("error-") for figure in errors]
        checks = [*errors, *draw.sigmas(curves, shown), *self.extra]
        sizes = [
            curves.figure("rate", "Angular rate", "norm, deg/s", ("rate",),
                          "As used, less the known gyro bias."),
            curves.figure("force", "Specific force", "norm, m/s²", ("force",), "At rest it is"
                          " gravity, about 9.8 m/s²."),
        ]  # fmt: skip
        results = [attitude, *vertical[:1], *tilt]
        if "speed" in curves.of:
            speed = curves.figure("speed", "Speed", "speed, m/s", ("speed",), "Over ground.")
            velocity = curves.figure("velocity", "Velocity", "velocity, m/s", AXES, "Over ground.")
            results = [attitude, *vertical[:1], speed, *tilt, velocity]
        if "latitude" in curves.of:
            results.insert(0, self._track())
        hse = result.hse
        if hse is not None:
            results.insert(0, draw.stretches(hse))
        return tuple(results), (*checks, *vertical[1:], *sizes)

    def _track(self) -> Figure:
        assert self._motion is not None
        _, samples = self._motion.samples(self._origin_ns)
        k = self._columns.index("latitude")
        speed = samples[:, self._columns.index("speed")] if "speed" in self._columns else None
        return track("computed", samples[:, k], samples[:, k + 1], self._fixes, speed)

    def _about_curves(self) -> list[str]:
        assert self._motion is not None
        rows = self._motion.rows_per_group
        if rows == 1:
            return []
        return [f"Curves go through the lowest and the highest of every {rows} samples."]

    def _marks(self, result: ProcessResult) -> draw.Marks:
        height = result.height
        if height is None:
            return ()
        return tuple(
            (e.kind, (e.time_ns - self._origin_ns) / SECOND)
            for e in height.events
            if e.kind != "engaged"
        )[:MARKS]

    def _held(self) -> tuple[str, np.ndarray, np.ndarray] | None:
        """Reference of the height: its name, seconds, height and difference."""
        if self._reference is None or not self._compared:
            return None
        return (self._reference[0], *self._difference.curves(self._origin_ns))


def _axes(result: ProcessResult) -> str:
    """Whose angles the figures show."""
    axes = "Of the IMU's Forward-Right-Down axes."
    land = None if result.filter is None else result.filter.vehicle.land
    if land is None:
        return axes
    roll, pitch, yaw = land.mount_deg
    return (
        f"{axes} In the vehicle the IMU is turned by roll {roll:.1f}, pitch {pitch:.1f}, yaw"
        f" {yaw:.1f} deg: the vehicle's own attitude is in /sinstool/vehicle."
    )
