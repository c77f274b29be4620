"""How unlikely a log's fixes are with a filter's start and settings: -2 log likelihood.

The innovations of the right model are the likeliest (Schweppe 1965), so models are compared by
runs over the same fixes.

References
----------
.. [1] F. C. Schweppe, "Evaluation of likelihood functions for Gaussian signals", IEEE Trans.
   Information Theory 11(1), 1965, 61-70.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.chi_square import upper_point
from sinstool.core.streams import GnssEpochs, take_rows
from sinstool.methods.ins_gnss.constraints import Constraints
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.results import GnssDiagnostics
from sinstool.methods.ins_gnss.settings import Settings, Start
from sinstool.methods.strapdown.velocity import Increments

# Fewer epochs do not tell models apart.
LEAST_EPOCHS = 40
# Normalised squares are limited to this: larger ones are bad fixes.
GATE = upper_point(6, 1e-4)


def innovations(
    start: Start,
    settings: Settings,
    motion: Increments,
    fixes: GnssEpochs,
    constraints: Constraints | None = None,
) -> GnssDiagnostics:
    """Innovations of a filter that runs over the motion without a barometer."""
    run = InsGnssFilter(start, settings, with_baro=False, output=False, constraints=constraints)
    epochs = run.push(motion, fixes).gnss
    return take_rows(epochs, np.isfinite(epochs.nis))


def unlikely(epochs: GnssDiagnostics) -> FloatArray:
    """-2 log likelihood of the innovations of each epoch, less terms common to all models.

    Returns
    -------
    ndarray, shape (n,)
    """
    spread = 2.0 * np.nansum(np.log(epochs.innovation_sigma), axis=1)
    return np.asarray(np.minimum(epochs.nis, GATE) + spread)


def innovation_cost(epochs: GnssDiagnostics, fewest: int = LEAST_EPOCHS) -> float:
    """-2 log likelihood of all innovations; infinite where there are fewer than the fewest."""
    return float(np.sum(unlikely(epochs))) if len(epochs) >= fewest else np.inf


def mean_square(epochs: GnssDiagnostics) -> float:
    """Squared innovations, those of an epoch up to `GATE`, over those expected.

    A filter's rejected fixes count as well: settings that reject good ones do not look better by
    it, and bad ones do not dominate. Infinite without any.
    """
    rows = int(epochs.rows.sum())
    return float(np.minimum(epochs.nis, GATE).sum() / rows) if rows else np.inf
