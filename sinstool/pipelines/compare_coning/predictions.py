"""Drift of each candidate as the log's coning spectrum predicts it, without simulation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sinstool.methods.coning.increments import GyroKind
from sinstool.methods.coning.spectrum import ConingSpectrum, predicted_drift, pseudo_coning
from sinstool.pipelines.compare_coning.divergence import DEG_H
from sinstool.pipelines.compare_coning.runs import Candidate

FloatArray = NDArray[np.float64]

# What a candidate is fed with, where that is not what the log holds
KINDS: dict[str, GyroKind] = {"sums": "increment", "points": "rate"}


@dataclass(frozen=True)
class Prediction:
    """What the spectrum says of one candidate.

    Attributes
    ----------
    drift : ndarray, shape (3,)
        Predicted drift against the true attitude, deg/h. The difference of two candidates is
        how they part from each other; what is held to be motion does not enter there.
    pseudo : ndarray, shape (3,) or None
        Of it, what is noise if nothing moves above the stopband, deg/h; None without one.
    exception : str
        Why the prediction cannot hold for this candidate; '' where it should.
    """

    drift: FloatArray
    pseudo: FloatArray | None
    exception: str


def predict(
    candidate: Candidate,
    spectrum: ConingSpectrum,
    passband: float | None,
    stopband: float | None,
) -> Prediction:
    """Predict a candidate's drift.

    Parameters
    ----------
    spectrum : ConingSpectrum
        Of the log as it is.
    passband, stopband : float or None
        Hz.

    Returns
    -------
    Prediction
    """
    kind = KINDS.get(candidate.thinning)
    interval = spectrum.interval * candidate.decimate

    drift = DEG_H * predicted_drift(
        spectrum, candidate.algorithm, passband=passband, interval=interval, gyro_kind=kind
    )
    pseudo = None
    if stopband is not None:
        pseudo = DEG_H * pseudo_coning(
            spectrum, candidate.algorithm, stopband, interval=interval, gyro_kind=kind
        )
    return Prediction(drift, pseudo, _exception(candidate))


def _exception(candidate: Candidate) -> str:
    """Known reasons for which the spectrum cannot predict a run."""
    if candidate.algorithm.takes == "rates":
        return "takes rates: its skew in time moves the ends of a run"
    if candidate.algorithm.samples > 1:
        return "several samples an update: frequencies fold at the update rate"
    if candidate.decimate > 1:
        return "decimated: frequencies fold at the lower rate"
    return ""
