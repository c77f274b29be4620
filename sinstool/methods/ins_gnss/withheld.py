"""Distance of a solution from withheld fixes, outage by outage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.earth import horizontal_metres
from sinstool.core.rotation import rotate, wrapped
from sinstool.core.streams import GnssEpochs, Solution, concatenate
from sinstool.core.timeline import SECOND
from sinstool.methods.ins_gnss.results import GnssDiagnostics
from sinstool.methods.ins_gnss.smoothed_epochs import SmoothedEpochs

# Stamps of one fix in two places differ by rounding only.
SAME_NS = 100_000
# Withheld fixes further apart than this many usual intervals are two outages.
APART = 3.0


@dataclass(frozen=True)
class Outage:
    """Errors of a solution at the withheld fixes of one outage.

    Attributes
    ----------
    start_ns, duration_s : int, float
        First of the fixes, and time to the last.
    epochs : int
        Number of fixes.
    largest_horizontal_m, largest_vertical_m : float or None
        Largest errors; None without heights.
    largest_in_sigmas : float
        Largest error of an axis over its sigma. Solution and fix share slow errors of the receiver:
        what is known of them is taken off the error, and the sigma is that of the difference.
    rms_in_sigmas : float
        Root mean square of these for all axes at all fixes: near 1 over many outages where sigmas
        hold.
    """

    start_ns: int
    duration_s: float
    epochs: int
    largest_horizontal_m: float
    largest_vertical_m: float | None
    largest_in_sigmas: float
    rms_in_sigmas: float


@dataclass(frozen=True)
class WithheldScore:
    """Errors of a solution at all withheld fixes.

    Attributes
    ----------
    outages : tuple of Outage
        In order of time.
    rms_of_largest_horizontal_m : float
        Root mean square over the outages.
    """

    outages: tuple[Outage, ...]
    rms_of_largest_horizontal_m: float


class Withheld:
    """Scores of solutions against withheld fixes, collected as they stream by.

    Parameters
    ----------
    gnss : GnssEpochs
        All epochs, at the times at which they are valid.
    withheld : ndarray of bool
    lever_arm_b : array_like, shape (3,)
        From the IMU to the antenna, m.
    """

    def __init__(
        self, gnss: GnssEpochs, withheld: np.ndarray, lever_arm_b: tuple[float, float, float]
    ) -> None:
        rows = np.asarray(withheld) & gnss.has_position
        self._fixes = gnss.rows(rows)
        self._arm = np.asarray(lever_arm_b)
        placed = np.flatnonzero(gnss.has_position)
        steps = np.diff(gnss.time_ns[placed])
        usual = float(np.median(steps)) if len(steps) else float(SECOND)
        order = np.flatnonzero(rows[placed])
        between = np.diff(order) > 1
        between |= np.diff(self._fixes.time_ns) > APART * max(usual, 0.5 * SECOND)
        self._first = np.concatenate([[0], np.flatnonzero(between) + 1]).astype(np.int64)
        shape = (len(self._fixes), 3)
        self._error, self._sigma = np.full(shape, np.nan), np.full(shape, np.nan)
        # Errors less what is known of the fix's own, and sigmas of these; NaN until they are known
        self._apart, self._apart_sigma = np.full(shape, np.nan), np.full(shape, np.nan)
        self._slow = np.zeros(shape)
        self._last: Solution | None = None

    def push(self, solution: Solution) -> None:
        """Take the next solutions, in the order of time."""
        if not len(self._fixes) or not len(solution):
            return
        joined = solution if self._last is None else concatenate([self._last, solution])
        self._last = solution.rows(slice(-1, None))
        times, position, q = joined.time_ns, joined.position, joined.q_nb
        covariance = joined.covariance_position_n
        assert position is not None and q is not None and covariance is not None
        inside = (self._fixes.time_ns >= times[0]) & (self._fixes.time_ns <= times[-1])
        rows = np.flatnonzero(inside)
        if not len(rows) or len(times) < 2:
            return
        fixes = self._fixes.rows(rows)
        k = np.clip(np.searchsorted(times, fixes.time_ns), 1, len(times) - 1)
        near = times[k] - times[k - 1] < SECOND  # not within a gap of the IMU
        share = ((fixes.time_ns - times[k - 1]) / (times[k] - times[k - 1]))[:, None]
        step = position[k] - position[k - 1]
        step[:, 1] = wrapped(step[:, 1])
        at = position[k - 1] + share * step
        arm = rotate(q[k], self._arm)
        north, east = horizontal_metres(
            at[:, 0] - fixes.latitude, wrapped(at[:, 1] - fixes.longitude), at[:, 0], at[:, 2]
        )
        error = np.stack([north, east, fixes.height - at[:, 2]], axis=1) + arm
        said = np.nan_to_num(fixes.sigma_position_n)
        sigma = np.sqrt(np.einsum("nii->ni", covariance[k]) + said**2)
        self._error[rows[near]], self._sigma[rows[near]] = error[near], sigma[near]

    def filtered(self, gnss: GnssDiagnostics) -> None:
        """Take what the filter says of the fixes: innovations, and what these should be.

        Parameters
        ----------
        gnss : GnssDiagnostics
            Of a run whose solutions are scored.
        """
        rows, at = self._of(gnss)
        self._apart[rows] = gnss.innovation[at, :3]
        self._apart_sigma[rows] = gnss.innovation_sigma[at, :3]

    def smoothed(self, gnss: GnssDiagnostics, epochs: SmoothedEpochs) -> None:
        """Take what a smoother says of the fixes' errors.

        Parameters
        ----------
        gnss : GnssDiagnostics
            Of the filter.
        epochs : SmoothedEpochs
        """
        rows, at = self._of(gnss)
        t = gnss.time_ns[at]
        inside = (t >= epochs.time_ns[0]) & (t <= epochs.time_ns[-1])
        rows, at = rows[inside], at[inside]
        k = np.clip(np.searchsorted(epochs.time_ns, gnss.time_ns[at]), 1, len(epochs) - 1)
        begin = epochs.time_ns[k - 1]
        length = np.maximum(epochs.time_ns[k] - begin, 1)
        share = np.clip((gnss.time_ns[at] - begin) / length, 0.0, 1.0)[:, None]
        slow, variance = (
            column[k - 1] + share * (column[k] - column[k - 1])
            for column in (epochs.fix_error, epochs.fix_variance)
        )
        self._slow[rows] = slow
        self._apart_sigma[rows] = np.sqrt(variance + np.square(gnss.measurement_sigma[at, :3]))

    def _of(self, gnss: GnssDiagnostics) -> tuple[np.ndarray, np.ndarray]:
        """Fixes that the filter compared, and where it did."""
        at = np.flatnonzero(gnss.withheld & np.isfinite(gnss.innovation[:, 0]))
        if not len(at) or not len(self._fixes):
            return at[:0], at[:0]
        # The first fix that is not earlier, but for rounding
        rows = np.searchsorted(self._fixes.time_ns, gnss.time_ns[at] - SAME_NS)
        rows = np.minimum(rows, len(self._fixes) - 1)
        same = np.abs(self._fixes.time_ns[rows] - gnss.time_ns[at]) < SAME_NS
        return rows[same], at[same]

    def score(self) -> WithheldScore | None:
        """Errors by outage: its time and length, the largest errors, and their size in sigmas.

        None where no outage was seen.
        """
        apart = np.where(np.isfinite(self._apart), self._apart, self._error + self._slow)
        known = np.isfinite(self._apart_sigma)
        # Before the filter's start, what the receiver states and the solution's own
        every = np.where(known, apart / self._apart_sigma, self._error / self._sigma)
        outages = []
        for part in np.split(np.arange(len(self._fixes)), self._first[1:]):
            error, in_sigmas = self._error[part], every[part]
            if not np.isfinite(error).any():
                continue
            horizontal = np.hypot(error[:, 0], error[:, 1])
            times = self._fixes.time_ns[part]
            vertical = np.abs(error[:, 2])
            outages.append(
                Outage(
                    start_ns=int(times[0]),
                    duration_s=float(times[-1] - times[0]) / SECOND,
                    epochs=len(part),
                    largest_horizontal_m=float(np.nanmax(horizontal)),
                    largest_vertical_m=float(np.nanmax(vertical))
                    if np.isfinite(vertical).any()
                    else None,
                    largest_in_sigmas=float(np.nanmax(np.abs(in_sigmas))),
                    rms_in_sigmas=float(np.sqrt(np.nanmean(in_sigmas**2))),
                )
            )
        if not outages:
            return None
        largest = np.array([outage.largest_horizontal_m for outage in outages])
        return WithheldScore(tuple(outages), float(np.sqrt(np.mean(largest**2))))
