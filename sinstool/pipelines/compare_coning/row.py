"""What one algorithm came to in a comparison."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sinstool.pipelines.compare_coning.divergence import DriftStatistics, Parting
from sinstool.pipelines.compare_coning.runs import Candidate

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Row:
    """One candidate's result.

    Attributes
    ----------
    drift : DriftStatistics or None
        None where it has no instants in common with the reference.
    end, slope : ndarray, shape (3,)
        psi at the run's end (all segments added), rad, and its slope, rad/s.
    largest : float
        Largest norm of psi in any segment, rad.
    ns_per_sample : float
        Processor time for each sample it was fed.
    resolved : bool
        Its divergence is well above what the reference itself can be trusted to.
    curves : tuple of Parting
        Per segment, for figures.
    """

    candidate: Candidate
    update_hz: float
    drift: DriftStatistics | None
    end: FloatArray
    slope: FloatArray
    largest: float
    ns_per_sample: float
    resolved: bool
    curves: tuple[Parting, ...]
