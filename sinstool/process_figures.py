"""Figures of a run of `process`, collected while its solutions stream by.

A run pushes every block of solutions; what is kept does not grow with the log. What a kind of run
knows besides, such as a filter's innovations, it adds as figures of its own.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sinstool.earth import radii_of_curvature
from sinstool.envelope import Envelope
from sinstool.figures import Figure, Series
from sinstool.process_truth import AXES, KINDS, Errors, Truth
from sinstool.rotation import to_euler
from sinstool.streams import Solution
from sinstool.timeline import SECOND
from sinstool.units import DEGREE

TIME = "time since the first sample, s"
# Events shown as lines in a figure; more would be a wall.
MARKS = 12
# Smaller errors of attitude than this, deg, are shown in arc seconds.
SMALL_ANGLE_DEG = 0.1


class Recorder:
    """What the page of a run shows, collected while it runs.

    Parameters
    ----------
    truth : Truth, optional
        What the run is held against.

    Attributes
    ----------
    extra : list of Figure
        Of a kind of run, shown after the common ones.
    """

    def __init__(self, truth: Truth | None = None) -> None:
        self.extra: list[Figure] = []
        self._errors = None if truth is None else Errors(truth)
        self._origin_ns = 0
        self._columns: list[str] = []
        self._motion: Envelope | None = None
        self._heading = 0.0
        self._off: dict[str, Envelope] = {}
        self._reference: tuple[str, np.ndarray, np.ndarray] | None = None
        self._difference = Envelope(2)
        self._compared = 0
        self._last: tuple[int, float] | None = None

    def refer_height(self, name: str, time_ns: np.ndarray, height: np.ndarray) -> None:
        """Heights that the run is held to, to be shown beside its own.

        Parameters
        ----------
        name : str
        time_ns : ndarray of int64, shape (m,)
        height : ndarray, shape (m,)
            Those that could be used, m.
        """
        order = np.argsort(time_ns, kind="stable")
        self._reference = (name, time_ns[order], height[order])

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
            values |= dict(zip(("north", "east", "down"), solution.velocity_n.T, strict=True))
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

    def errors(self) -> dict[str, Any] | None:
        """``truth`` of the summary; None where there is nothing to be held against."""
        return None if self._errors is None else self._errors.summary()

    def figures(self, summary: dict[str, Any]) -> tuple[Figure, ...]:
        """The figures of the run.

        Parameters
        ----------
        summary : dict
            Of the run: the values of ``--json``.
        """
        if self._motion is None:
            return ()
        seconds, values = self._motion.curves(self._origin_ns)
        curve = dict(zip(self._columns, values.T, strict=True))
        marks = self._marks(summary)
        rows = self._motion.rows_per_group
        note = (f"Curves go through the lowest and highest of every {rows} samples.",)
        found = [
            Figure(
                "tilt",
                "Roll and pitch",
                seconds,
                tuple(Series(name, curve[name]) for name in ("roll", "pitch")),
                TIME,
                "angle, deg",
                notes=note if rows > 1 else (),
            ),
            self._headings(seconds, curve["heading"]),
            *self._vertical(seconds, curve, marks),
            *self._track(),
        ]
        if "north" in curve:
            names = ("north", "east", "down")
            found.append(_figure("velocity", "Velocity", seconds, "velocity, m/s", curve, names))
        found += [*self._against_truth(), *_sigmas(seconds, curve)]
        found += self.extra
        found += [
            _figure("rate", "Angular rate", seconds, "size, deg/s", curve, ("rate",)),
            _figure("force", "Specific force", seconds, "size, m/s^2", curve, ("force",)),
        ]
        hse = summary.get("hse")
        if hse is not None:
            found.insert(0, _stretches(hse))
        return tuple(found)

    def _marks(self, summary: dict[str, Any]) -> tuple[tuple[str, float], ...]:
        height = summary.get("height")
        if not height:
            return ()
        return tuple(
            (e["kind"], (int(e["time_ns"]) - self._origin_ns) / SECOND)
            for e in height.get("events", ())
            if e["kind"] != "engaged"
        )[:MARKS]

    def _headings(self, seconds: np.ndarray, turned: np.ndarray) -> Figure:
        """Heading within a turn, with holes where it goes over north."""
        turns = np.floor(turned / 360.0)
        within = turned - 360.0 * turns
        steps = np.diff(turns)
        over = np.flatnonzero((steps != 0.0) & np.isfinite(steps)) + 1
        seconds, within = np.insert(seconds, over, seconds[over]), np.insert(within, over, np.nan)
        return Figure(
            "heading", "Heading", seconds, (Series("heading", within),), TIME, "heading, deg"
        )

    def _vertical(
        self,
        seconds: np.ndarray,
        curve: dict[str, np.ndarray],
        marks: tuple[tuple[str, float], ...],
    ) -> list[Figure]:
        if "height" not in curve:
            return []
        series = [Series("computed", curve["height"])]
        held = self._reference is not None and self._compared > 0
        if held:
            assert self._reference is not None
            at, values = self._difference.curves(self._origin_ns)
            name = self._reference[0]
            series.append(Series(name, values[:, 0], x=at, style="dashed"))
        found = [Figure("height", "Height", seconds, tuple(series), TIME, "height, m", marks=marks)]
        if held:
            off = (Series("computed less reference", values[:, 1], x=at),)
            found.append(
                Figure("difference", f"Height less that of {name}", at, off, TIME, "difference, m",
                       marks=marks)
            )  # fmt: skip
        if "up" in curve:
            up = (Series("up", curve["up"]),)
            found.append(
                Figure("up", "Vertical velocity", seconds, up, TIME, "up, m/s", marks=marks)
            )
            taken = (Series("correction", curve["correction"]),)
            found.append(
                Figure("correction", "Taken off the vertical accelerometer", seconds, taken, TIME,
                       "correction, m/s^2", marks=marks)
            )  # fmt: skip
        return found

    def _track(self) -> list[Figure]:
        if "latitude" not in self._columns:
            return []
        assert self._motion is not None
        _, values = self._motion.samples(self._origin_ns)
        k = self._columns.index("latitude")
        latitude, longitude = values[:, k], values[:, k + 1].copy()
        good = np.isfinite(longitude)
        longitude[good] = np.unwrap(longitude[good])
        meridian, transverse = radii_of_curvature(latitude[0])
        north = (latitude - latitude[0]) * float(meridian)
        east = (longitude - longitude[0]) * float(transverse) * np.cos(latitude)
        note = (
            f"From {latitude[0] / DEGREE:.6f} deg, {longitude[0] / DEGREE:.6f} deg; both axes need"
            " not have one scale.",
        )
        size, unit = _length(np.concatenate([north, east]))
        track = (Series("track", north / size),)
        labels = f"east, {unit}", f"north, {unit}"
        return [Figure("track", "Track", east / size, track, *labels, notes=note)]

    def _against_truth(self) -> list[Figure]:
        found = []
        for kind, unit, size in KINDS:
            if kind not in self._off:
                continue
            seconds, error = self._off[kind].curves(self._origin_ns)
            error = error / size
            finite = error[np.isfinite(error)]
            if not len(finite):
                continue
            if unit == "deg" and np.abs(finite).max() < SMALL_ANGLE_DEG:
                unit, error = "arcsec", error * 3600.0
            if unit == "m":
                size, unit = _length(error)
                error = error / size
            series = tuple(Series(axis, error[:, k]) for k, axis in enumerate(AXES))
            note = "Computed less true."
            if kind == "attitude":
                note = (
                    "The small rotation, about these axes, from the true attitude to the one"
                    " computed: about down it is an error of heading."
                )
            found.append(
                Figure(f"error-{kind}", f"Error of {kind}", seconds, series, TIME,
                       f"error, {unit}", notes=(note,))
            )  # fmt: skip
        return found


def _length(values: np.ndarray) -> tuple[float, str]:
    """A unit in which lengths in m read well."""
    most = np.nanmax(np.abs(values), initial=0.0)
    return (1000.0, "km") if most > 5000.0 else (1.0, "m")


def _figure(
    key: str,
    title: str,
    seconds: np.ndarray,
    label: str,
    curve: dict[str, np.ndarray],
    names: tuple[str, ...],
) -> Figure:
    series = tuple(Series(name, curve[name]) for name in names)
    return Figure(key, title, seconds, series, TIME, label)


def _sigmas(seconds: np.ndarray, curve: dict[str, np.ndarray]) -> list[Figure]:
    """Standard deviations, where a run has covariances."""
    return [
        Figure(
            f"sigma-{kind}",
            f"Standard deviation of {kind}",
            seconds,
            tuple(Series(axis, curve[f"{kind} {axis}"]) for axis in AXES),
            TIME,
            f"sigma, {unit}",
        )
        for kind, unit, _ in KINDS
        if f"{kind} {AXES[0]}" in curve
    ]


def _stretches(hse: dict[str, Any]) -> Figure:
    """Heading of every stretch at constant rate, before and after its correction."""
    rates = np.array([s["rate_deg_s"] for s in hse["segments"]])
    raw = np.array([s["heading_raw_deg"] for s in hse["segments"]])
    corrected = np.array([s["heading_deg"] for s in hse["segments"]])
    middle = float(np.median(corrected))

    def shown(heading: np.ndarray) -> np.ndarray:
        return ((heading - middle + 180.0) % 360.0 - 180.0) * 3600.0

    return Figure(
        "stretches",
        "Heading of each stretch at constant rate",
        rates,
        (
            Series("as aligned", shown(raw), style="points"),
            Series("corrected", shown(corrected), style="points"),
        ),
        "rate, deg/s",
        "heading, arcsec",
        notes=(f"Less {middle:.6f} deg, the median of the corrected ones.",),
    )
