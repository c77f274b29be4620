"""The published experiment run over frequencies of noise, for many settings and algorithms.

Samples of one frequency are made once for each gyro and shared by all algorithms, which are the
ones of :mod:`sinstool.methods.coning`, as ``sinstool process`` runs them. Their rotation vectors
are propagated for several frequencies side by side.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import factorial
from queue import Empty, SimpleQueue

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import njit
from sinstool.core.quaternion_kernels import product
from sinstool.core.rotation import log
from sinstool.core.threads import executor
from sinstool.methods.coning.gyro_response import GyroResponse
from sinstool.methods.coning.increments import RateIntegrator
from sinstool.pipelines.compare_coning.paper_cases import Case
from sinstool.simulation.coning_paper import (
    DURATION_S,
    FREQUENCY_HZ,
    RATE_HZ,
    Phase,
    Tone,
    cone,
    measured_rate,
    response_name,
    tone,
)
from sinstool.simulation.truth import sample_times

_LANES = 16  # frequencies that a thread takes at a time and the processor side by side


@dataclass(frozen=True)
class Setting:
    """The gyro of one run of the experiment.

    Attributes
    ----------
    phase : {"consistent", "literal"}
        Reading of eq. 20, see :mod:`sinstool.simulation.coning_paper`.
    response : GyroResponse
        Gain of the gyro.
    gyro : str
        Its short name.
    """

    phase: Phase
    response: GyroResponse = field(compare=False)  # two of one name are one
    gyro: str = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "gyro", response_name(self.response))

    @property
    def name(self) -> str:
        """Name in tables and files."""
        return f"{self.phase}, {self.gyro}"


@dataclass(frozen=True)
class Sweep:
    """Attitude errors of one algorithm in one setting.

    Attributes
    ----------
    frequency : ndarray, shape (m,)
        Of the noise, Hz.
    end : ndarray, shape (m, 3)
        ``log(q_true^-1 q)`` after the ten seconds, rad: body axes, z the cone's own.
    peak : ndarray, shape (m,)
        Largest length of that at any update, rad.
    """

    setting: Setting
    case: Case
    frequency: FloatArray
    end: FloatArray
    peak: FloatArray

    @property
    def end_deg(self) -> FloatArray:
        """Error after ten seconds, shape (m, 3), degrees."""
        return np.degrees(self.end)

    @property
    def z_deg(self) -> FloatArray:
        """Its signed z component, degrees: the coning that was not answered for."""
        return np.degrees(self.end[:, 2])

    @property
    def norm_deg(self) -> FloatArray:
        """Its length, degrees."""
        return np.asarray(np.degrees(np.linalg.norm(self.end, axis=1)))

    @property
    def peak_deg(self) -> FloatArray:
        """Largest length at any update, degrees."""
        return np.degrees(self.peak)

    @property
    def mean_deg(self) -> float:
        """Mean of the signed z component over all frequencies, degrees."""
        return float(np.mean(self.z_deg))

    def row(self, frequency: float) -> int:
        """Row of the frequency nearest to one in Hz."""
        return int(np.argmin(np.abs(self.frequency - frequency)))


def run_sweeps(
    plan: Mapping[Setting, Sequence[Case]],
    frequency: FloatArray,
    progress: Callable[[float], None] | None = None,
) -> dict[tuple[Setting, str], Sweep]:
    """Run algorithms over frequencies of noise.

    Parameters
    ----------
    plan : mapping of Setting to sequence of Case
        What is run with each gyro.
    frequency : ndarray, shape (m,)
        Of the noise, Hz.
    progress : callable, optional
        Takes the fraction done.

    Returns
    -------
    dict
        One :class:`Sweep` for each setting and key of a case. It does not depend on the number
        of threads.
    """
    frequency = np.asarray(frequency, dtype=np.float64)
    sweeps = {
        (setting, case.key): Sweep(
            setting, case, frequency, np.empty((len(frequency), 3)), np.empty(len(frequency))
        )
        for setting, cases in plan.items()
        for case in cases
    }
    runner = _Runner(plan, sweeps)
    blocks = [range(i, min(i + _LANES, len(frequency))) for i in range(0, len(frequency), _LANES)]
    threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    with executor(threads or 1, "sinstool-paper") as pool:
        for done, _ in enumerate(pool.map(lambda block: runner.run(block, frequency), blocks)):
            if progress is not None:
                progress((done + 1) / len(blocks))
    return sweeps


class _Runner:
    """Data shared by all frequencies, and the run of one block of them."""

    def __init__(
        self, plan: Mapping[Setting, Sequence[Case]], sweeps: dict[tuple[Setting, str], Sweep]
    ) -> None:
        self.plan = plan
        self.sweeps = sweeps
        self.times = sample_times(RATE_HZ, DURATION_S)
        truth = cone(self.times)
        self.interval, self.q = truth.interval, truth.q_nb
        self.motion = tone(self.times, self.interval, FREQUENCY_HZ)
        self.integrator = RateIntegrator()
        self._idle: SimpleQueue[_Workspace] = SimpleQueue()

    def run(self, rows: range, frequency: FloatArray) -> None:
        try:
            work = self._idle.get_nowait()
        except Empty:
            work = _Workspace(self)
        work.noise = [tone(self.times, self.interval, float(frequency[row])) for row in rows]
        for setting, cases in self.plan.items():
            work.begin(setting)
            for case in cases:
                end, peak = work.errors(case)
                sweep = self.sweeps[setting, case.key]
                sweep.end[rows.start : rows.stop] = end
                sweep.peak[rows.start : rows.stop] = peak
        self._idle.put(work)


class _Workspace:
    """Samples of one gyro at one block of frequencies, and where their runs are computed.

    The arrays are used again and again: to ask for memory takes longer than the runs.
    """

    def __init__(self, runner: _Runner) -> None:
        self._runner = runner
        self.noise: list[Tone] = []
        self._setting: Setting | None = None
        self._samples: dict[str, FloatArray] = {}
        self._made: set[str] = set()
        self._phi = np.zeros((_LANES, len(runner.times) - 1, 3))
        self._row = np.empty((3, _LANES))

    def begin(self, setting: Setting) -> None:
        """Forget the samples of another gyro."""
        self._setting = setting
        self._made.clear()

    def errors(self, case: Case) -> tuple[FloatArray, FloatArray]:
        """Return the errors at the end of the block's runs and their largest lengths."""
        size = case.algorithm.samples
        runner, lanes = self._runner, len(self.noise)
        samples = self._fed(case.feed)
        # Interpolated increments begin with the first interval; the others have a row before it.
        first = samples.shape[1] - len(runner.times) + 1
        count = (samples.shape[1] - first) // size
        phi = self._phi[:, :count]
        dt = runner.interval[: samples.shape[1]]
        for j in range(lanes):
            phi[j] = case.algorithm.rotation_vectors(samples[j], dt, first, count)
        if not max(phi.max(), -phi.min()) < _SMALL_ANGLE / np.sqrt(3.0):
            raise ValueError(f"{case.label}: an update turns by more than {_SMALL_ANGLE} rad.")
        q = np.repeat(runner.q[0][:, np.newaxis], _LANES, axis=1)
        e = np.empty_like(q)
        largest = np.zeros(_LANES)
        _propagate_differences(phi, self._row, runner.q, size, q, e, largest)
        return log(e.T[:lanes]), 2.0 * np.arcsin(np.minimum(np.sqrt(largest[:lanes]), 1.0))

    def _fed(self, feed: str) -> FloatArray:
        """Rows as an algorithm takes them, for each frequency of the block."""
        if feed not in self._made:
            if feed not in self._samples:
                rows = len(self._runner.times) - (feed == "interpolated")
                self._samples[feed] = np.empty((_LANES, rows, 3))
            self._make(feed, self._samples[feed])
            self._made.add(feed)
        return self._samples[feed]

    def _make(self, feed: str, out: FloatArray) -> None:
        runner, setting = self._runner, self._setting
        assert setting is not None
        if feed in ("rates", "increments"):
            for rows, noise in zip(out, self.noise, strict=False):
                measured_rate(
                    runner.motion,
                    noise,
                    mean=feed == "increments",
                    phase=setting.phase,
                    response=setting.response,
                    out=rows,
                )
                if feed == "increments":
                    rows *= runner.interval[:, np.newaxis]
            return
        for rows, rate in zip(out, self._fed("rates")[: len(self.noise)], strict=False):
            if feed == "rate x T":
                np.multiply(rate, runner.interval[:, np.newaxis], out=rows)
            else:
                rows[:] = runner.integrator.increments(rate, runner.interval, 1, len(rows))


# cos(h) and sin(h)/h in powers of h**2, which below the limit end under 1e-17.
_SMALL_ANGLE = 0.5
_C1, _C2, _C3, _C4, _C5, _C6 = ((-1) ** k / factorial(2 * k) for k in range(1, 7))
_S1, _S2, _S3, _S4, _S5, _S6 = ((-1) ** k / factorial(2 * k + 1) for k in range(1, 7))


@njit(cache=True, nogil=True, error_model="numpy")
def _propagate_differences(
    phi: FloatArray,
    row_phi: FloatArray,
    truth: FloatArray,
    step: int,
    q: FloatArray,
    e: FloatArray,
    largest: FloatArray,
) -> None:
    """Propagate several attitudes at once and compare each with the truth.

    Side by side they keep the processor's vector units busy, where one alone would wait for
    itself: each update needs the one before.

    Parameters
    ----------
    phi : ndarray, shape (m, n, 3)
        Rotation vectors of n updates of m = `_LANES` runs, shorter than `_SMALL_ANGLE`, rad.
    row_phi : ndarray, shape (3, m)
        Room for those of one update.
    truth : ndarray, shape (n * step + 1, 4)
        True attitude; update k ends at row ``(k + 1) * step``.
    q : ndarray, shape (4, m)
        Attitudes at the start; at the end on return.
    e : ndarray, shape (4, m)
        On return ``truth^-1 q`` after the last update.
    largest : ndarray, shape (m,)
        On return the largest squared length of its vector part at any update, which grows with
        the angle up to half a turn.
    """
    for k in range(phi.shape[1]):
        row = (k + 1) * step
        tw, tx, ty, tz = truth[row, 0], -truth[row, 1], -truth[row, 2], -truth[row, 3]
        # Loops of constant length over neighbours in memory become vector instructions.
        for j in range(_LANES):
            for i in range(3):
                row_phi[i, j] = phi[j, k, i]
        for j in range(_LANES):
            px, py, pz = row_phi[0, j], row_phi[1, j], row_phi[2, j]
            u = 0.25 * (px * px + py * py + pz * pz)
            c = (((((_C6 * u + _C5) * u + _C4) * u + _C3) * u + _C2) * u + _C1) * u + 1.0
            s = (((((_S6 * u + _S5) * u + _S4) * u + _S3) * u + _S2) * u + _S1) * u + 1.0
            s *= 0.5
            w, x, y, z = product(q[0, j], q[1, j], q[2, j], q[3, j], c, s * px, s * py, s * pz)
            # One Newton step towards 1/|q|: the length is 1 but for the rounding of one update.
            scale = 1.5 - 0.5 * (w * w + x * x + y * y + z * z)
            w, x, y, z = w * scale, x * scale, y * scale, z * scale
            q[0, j], q[1, j], q[2, j], q[3, j] = w, x, y, z
            ew, ex, ey, ez = product(tw, tx, ty, tz, w, x, y, z)
            e[0, j], e[1, j], e[2, j], e[3, j] = ew, ex, ey, ez
            square = ex * ex + ey * ey + ez * ez
            before = largest[j]
            largest[j] = square if square > before else before
