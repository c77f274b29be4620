"""Slow error of fixes while a vehicle stands, compared with what the receiver states.

While nothing moves, fixes change by their error alone. A filter takes its slow part for a Gauss-
Markov process of the stated size; the likelihood of the fixes of all rests, less their unknown
means, shows by how much it is larger.

References
----------
.. [1] D. A. Harville, "Maximum likelihood approaches to variance component estimation and to
   related problems", J. American Statistical Association 72, 1977, 320-338: likelihood of
   contrasts, which no mean enters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.earth import horizontal_metres
from sinstool.core.rotation import wrapped
from sinstool.core.streams import GnssEpochs
from sinstool.methods.ins_gnss.constraints import STEP_NS
from sinstool.methods.ins_gnss.settings import USUAL_S, GnssModel

# Receivers filter their fixes: over seconds their errors are smoother than those of a Markov
# process, so only fixes further apart than this share of its correlation time are used, and of one
# rest at most so many.
SHARE_OF_TIME, MOST_FIXES = 0.1, 60
# Factors of the slow error's sigma that are tried. A receiver may state centimetres and wander by
# metres, of which --gnss-lasting leaves a small share.
FACTORS = 2.0 ** np.arange(0.0, 9.01, 0.25)
# By how much the log likelihood must rise before slow errors are enlarged: three sigmas of one
# parameter.
LEAST_GAIN = 4.5


@dataclass(frozen=True)
class Wander:
    """Factors of the slow errors' sigmas, 1 where fixes at rest agree with them.

    Attributes
    ----------
    level, vertical : float
        Of positions.
    seconds : float
        Of rest that showed it.
    """

    level: float = 1.0
    vertical: float = 1.0
    seconds: float = 0.0

    @property
    def ordinary(self) -> bool:
        """Whether both factors are 1."""
        return self.level == 1.0 and self.vertical == 1.0

    def __str__(self) -> str:
        shares = (("north and east", self.level), ("in height", self.vertical))
        far = [f"{factor:.2g} times as far {where}" for where, factor in shares if factor > 1.0]
        return f"fixes wander {' and '.join(far)}, by {self.seconds:.0f} s of rest"


AS_STATED = Wander()
"""Fixes that wander no further than their receiver states."""


def find_wander(
    rests: BoolArray, start_ns: int, gnss: GnssEpochs, latency_ns: int, model: GnssModel
) -> Wander:
    """How much the fixes wander while the vehicle stands, over what the receiver states.

    Parameters
    ----------
    rests : ndarray of bool, shape (g,)
        Steps of `STEP_NS` from `start_ns` on at which it stands.
    gnss : GnssEpochs
        Fixes that may be used, valid `latency_ns` before their stamps.
    model : GnssModel
        Their noise in the filter, whose slow part is taken to last as long as usual.
    """
    model = model.lasting(USUAL_S)
    gnss = gnss.rows(gnss.has_position)
    time_ns = gnss.time_ns - latency_ns
    parts = _at_rest(rests, start_ns, time_ns, SHARE_OF_TIME * model.position_time)
    if not parts:
        return AS_STATED
    gain = np.zeros((2, len(FACTORS)))
    for rows in parts:
        seconds = (time_ns[rows] - time_ns[rows[0]]) * 1e-9
        north, east = horizontal_metres(
            gnss.latitude[rows] - gnss.latitude[rows[0]],
            wrapped(gnss.longitude[rows] - gnss.longitude[rows[0]]),
            gnss.latitude[rows[0]],
            gnss.height[rows[0]],
        )
        places = (north, east, gnss.height[rows] - gnss.height[rows[0]])
        for axis, place in enumerate(places):
            white, slow = _sizes(model, axis, gnss.sigma_position_n[rows, axis])
            known = np.isfinite(place)
            if np.count_nonzero(known) > 1:
                gain[axis // 2] += _log_likelihoods(
                    seconds[known], place[known], white[known], slow, model.position_time
                )
    spans = [float(time_ns[rows[-1]] - time_ns[rows[0]]) * 1e-9 for rows in parts]
    return Wander(_likeliest(gain[0]), _likeliest(gain[1]), sum(spans))


def _at_rest(rests: BoolArray, start_ns: int, time_ns: IntArray, apart_s: float) -> list[IntArray]:
    """Rows of fixes in each rest that is long enough, so far apart, no more than some of them."""
    step = (time_ns - start_ns) // STEP_NS
    inside = (step >= 0) & (step < len(rests))
    number = np.cumsum(np.diff(rests.astype(np.int8), prepend=0) == 1)
    clipped = np.clip(step, 0, max(len(rests) - 1, 0))
    of = np.where(inside & rests[clipped], number[clipped], 0) if len(rests) else 0 * step
    parts = []
    for k in np.unique(of[of > 0]):
        rows = np.flatnonzero(of == k)
        spaces = int((time_ns[rows[-1]] - time_ns[rows[0]]) * 1e-9 / apart_s)
        if spaces > 0:
            wanted = np.linspace(time_ns[rows[0]], time_ns[rows[-1]], min(spaces + 1, MOST_FIXES))
            after = np.clip(np.searchsorted(time_ns[rows], wanted), 0, len(rows) - 1)
            parts.append(np.unique(rows[after]))
    return parts


def _sizes(model: GnssModel, axis: int, stated: FloatArray) -> tuple[FloatArray, float]:
    """White sigma of each fix and the slow one, m, as a filter takes them."""
    white, slow = model.position_white[axis], model.position_markov[axis]
    whole = np.where(np.isfinite(stated), stated, np.hypot(white, slow))
    rest = np.sqrt(np.maximum(whole**2 - slow**2, 0.0))
    return np.maximum(rest, whole * white / np.hypot(white, slow)), slow


def _log_likelihoods(
    seconds: FloatArray, place: FloatArray, white: FloatArray, slow: float, time: float
) -> FloatArray:
    """Of the contrasts of fixes of one place, for each of `FACTORS`; shape (k,)."""
    shape = slow**2 * np.exp(-np.abs(seconds[:, None] - seconds) / time)
    one = np.ones(len(place))
    out = np.empty(len(FACTORS))
    for k, factor in enumerate(FACTORS):
        covariance = factor**2 * shape + np.diag(white**2)
        _, size = np.linalg.slogdet(covariance)
        weighed, summed = np.linalg.solve(covariance, np.stack([place, one], axis=1)).T
        weight = float(one @ summed)
        square = float(place @ weighed) - float(one @ weighed) ** 2 / weight
        out[k] = -0.5 * (size + np.log(weight) + square)
    return out


def _likeliest(gain: FloatArray) -> float:
    """Root mean square of a factor by its likelihood; 1 unless that speaks clearly for more."""
    if gain.max() - gain[0] < LEAST_GAIN:
        return 1.0
    weight = np.exp(gain - gain.max())
    return float(np.sqrt(np.average(FACTORS**2, weights=weight)))
