"""Headings of runs as a linear model: data columns, parameters, rejection of outliers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.earth import EARTH_RATE
from sinstool.core.rotation import wrapped
from sinstool.methods.hse.least_squares import LeastSquares, least_squares, outlier_limit
from sinstool.methods.hse.run import HseRun, positions, rate_groups

# Lean of the axis to the east below which heading-sensitive error is too small to be measured
MIN_C23 = 1e-4
MIN_C23_SIGMAS = 5.0
# Positions determine a delay only if their leans differ by this fraction of the largest
DISTINCT_LEAN = 0.2
# Residuals below this are rounding, not scatter, rad.
ROUNDING = 1e-12


@dataclass(frozen=True)
class RunColumns:
    """The data of ``n`` runs for a fit, as columns.

    Attributes
    ----------
    rate : ndarray, shape (n,)
        rad/s.
    offset : ndarray, shape (n,)
        Heading less ``reference`` of its position, rad: small numbers keep their digits.
    reference : ndarray, shape (number of positions,)
        Heading of the first run at each position, rad.
    sigma : ndarray, shape (n,)
        Of the headings, rad.
    C23, sigma_C23 : ndarray, shape (n,)
    lambda1 : ndarray, shape (n,)
        Omega - w sin L, rad/s.
    gain : ndarray, shape (n,)
        1 / (3 w cos L), s/rad.
    time : ndarray, shape (n,)
        s.
    position : ndarray of int, shape (n,)
    cell : ndarray of int, shape (n,)
        Runs of one cell are repeats: one rate at one position.
    """

    rate: FloatArray
    offset: FloatArray
    reference: FloatArray
    sigma: FloatArray
    C23: FloatArray
    sigma_C23: FloatArray
    lambda1: FloatArray
    gain: FloatArray
    time: FloatArray
    position: IntArray
    cell: IntArray


def run_columns(runs: Sequence[HseRun], time: FloatArray) -> RunColumns:
    """Columns of ``runs`` (at least one), which began at ``time`` (s)."""
    position = positions(runs)
    heading = np.array([r.heading for r in runs])
    first = [int(np.argmax(position == k)) for k in range(int(position.max()) + 1)]
    reference = heading[first]
    latitude = np.array([r.latitude for r in runs])
    rate = np.array([r.rate for r in runs])
    group = rate_groups(rate)
    return RunColumns(
        rate=rate,
        offset=wrapped(heading - reference[position]),
        reference=reference,
        sigma=np.array([r.sigma_heading for r in runs]),
        C23=np.array([r.C23 for r in runs]),
        sigma_C23=np.array([r.sigma_C23 for r in runs]),
        lambda1=rate - EARTH_RATE * np.sin(latitude),
        gain=1.0 / (3.0 * EARTH_RATE * np.cos(latitude)),
        time=time,
        position=position,
        cell=np.asarray(group + (group.max() + 1) * position),
    )


def distinct_rates(rate: FloatArray) -> tuple[float, ...]:
    """Mean of each distinct rate, rad/s, ascending."""
    group = rate_groups(rate)
    return tuple(float(rate[group == k].mean()) for k in np.unique(group))


class HeadingModel:
    """Design of a fit of headings and the meaning of its parameters.

    Heading is ``psi0[position] + lambda2 x + tau Omega + drift t`` with
    ``x = lambda1 C23 / (3 w cos L)``. Where the axis does not lean to the east ``x`` is zero
    and its place is taken by ``K lambda1``.

    Parameters
    ----------
    use : ndarray of bool, shape (n,)
        Runs to be fitted; at least one.
    joint : bool
        Estimate ``tau`` where the positions allow.
    drift : bool
        Estimate a drift.

    Attributes
    ----------
    design : ndarray, shape (n, p)
        For all runs; rows of runs not in use may lack their position.
    names : list of str
        Of the parameters.
    slope : int
        Index of ``lambda2`` (``observable``) or ``K``.
    positions : ndarray of int
        Those fitted, in the order of their parameters.
    C23, sigma_C23 : float
        Of the position that leans most; the sigma is that of one run, since the errors of the
        leans are mostly common to the runs.
    relative_C23 : float
        Relative uncertainty of lambda2 due to that of the leans.
    spread : float
        Widest range of C23 within a position over ``abs(C23)``.
    gain : float
        K / lambda2 at ``C23``, s/rad.
    varying : ndarray, shape (n, 1), or None
        The columns that vary among repeats on purpose.
    notes : list of str
        Why the model differs from what was asked for.
    """

    def __init__(self, data: RunColumns, use: BoolArray, joint: bool, drift: bool) -> None:
        self.notes: list[str] = []
        self.positions = np.unique(data.position[use])
        mean = np.array([data.C23[use & (data.position == k)].mean() for k in self.positions])
        noise = data.sigma_C23[use & np.isfinite(data.sigma_C23)]
        self.sigma_C23 = float(np.sqrt(np.mean(noise**2))) if len(noise) else 0.0
        self.C23 = float(mean[np.argmax(np.abs(mean))])
        ranges = [float(np.ptp(data.C23[use & (data.position == k)])) for k in self.positions]
        self.spread = max(ranges) / max(abs(self.C23), MIN_C23)
        self.gain = float(np.mean(data.gain[use])) * self.C23
        enough = max(MIN_C23, MIN_C23_SIGMAS * self.sigma_C23)
        span = float(np.ptp(mean))
        self.joint = joint and span > max(enough, DISTINCT_LEAN * abs(self.C23))
        if joint and not self.joint:
            self.notes.append(_why_not_joint(len(mean)))
        self.observable = self.joint or abs(self.C23) >= enough
        self.relative_C23 = 0.0
        if self.joint:
            self.relative_C23 = float(np.sqrt(2.0)) * self.sigma_C23 / span
        elif self.observable:
            self.relative_C23 = self.sigma_C23 / abs(self.C23)
        self._design(data, use, drift)

    def _design(self, data: RunColumns, use: BoolArray, drift: bool) -> None:
        self.names = [f"psi0[{k}]" for k in self.positions]
        columns = [(data.position == k).astype(np.float64) for k in self.positions]
        self.slope = len(columns)
        if self.observable:
            self.names.append("lambda2")
            columns.append(data.lambda1 * data.C23 * data.gain)
        else:
            self.names.append("K")
            columns.append(data.lambda1)
        if self.joint:
            self.names.append("tau")
            columns.append(data.rate)
        self.varying: FloatArray | None = None
        if drift:
            self.names.append("drift")
            columns.append(data.time - data.time[use].mean())
            self.varying = columns[-1][:, None]
        self.design = np.stack(columns, axis=1)

    def solve(self, data: RunColumns, use: BoolArray, weighted: bool) -> LeastSquares:
        """Fit the runs in use.

        Parameters
        ----------
        use : ndarray of bool, shape (n,)
        weighted : bool
            Weight the runs by ``data.sigma``, or all alike. A fit without redundancy is weighted
            in any case if possible, as nothing else gives the scatter.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the runs do not determine the parameters.
        """
        sigma = data.sigma[use]
        exact = len(sigma) == len(self.names) and bool(np.all(np.isfinite(sigma) & (sigma > 0.0)))
        return least_squares(
            self.design[use], data.offset[use], sigma if weighted or exact else None
        )

    def reject(
        self, data: RunColumns, use: BoolArray, weighted: bool, alpha: float
    ) -> list[tuple[int, float]]:
        """Leave out outlying repeats, one by one.

        Parameters
        ----------
        use : ndarray of bool, shape (n,)
            Cleared where a run is left out. At least two repeats of a cell remain.
        alpha : float
            Probability that any run is left out where all are sound.

        Returns
        -------
        list of (int, float)
            Number of the run and its externally studentised residual.
        """
        out: list[tuple[int, float]] = []
        while True:
            solved = self.solve(data, use, weighted)
            index = np.flatnonzero(use)
            repeats = np.array([np.sum(use & (data.cell == data.cell[i])) for i in index])
            score = np.abs(solved.studentised)
            score[(repeats <= 2) | (np.abs(solved.residual) < ROUNDING) | np.isnan(score)] = 0.0
            worst = int(np.argmax(score))
            if score[worst] <= outlier_limit(len(index), solved.dof, alpha):
                return out
            out.append((int(index[worst]), float(solved.studentised[worst])))
            use[index[worst]] = False


def _why_not_joint(n_positions: int) -> str:
    why = (
        "all runs are at one position"
        if n_positions < 2
        else f"the axis leans to the east by nearly the same at all {n_positions} positions"
    )
    return (
        f"{why}: a delay of the encoder looks like heading-sensitive error there, so the method is"
        " heading; add runs with the base turned by 180 deg"
    )
