"""How certain a heading is, by how much less likely other headings are.

The filter of a refinement is linear about the attitude that it starts from, and takes every change
of velocity that the IMU measures for one of the vehicle. If these are mostly those of a gait, of
waves or of vibration, which velocities derived from positions do not contain, every heading
explains the fixes about equally well, and the filter stays near its start with a small sigma. The
likelihood of other headings, with everything else estimated anew, shows this, and a better heading
elsewhere [1]_.

References
----------
.. [1] S. A. Murphy, A. W. van der Vaart, "On profile likelihood", J. American Statistical
   Association 95, 2000, 449-465.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.rotation import exp, to_dcm
from sinstool.core.units import DEGREE
from sinstool.methods.alignment.refine import THETA, Refined, S

# Other headings that are tried: so many sigmas away, and multiples of this angle, rad.
NEAR = np.array([2.0, 4.0, 8.0])
AROUND = 45.0 * DEGREE
LEAST_SIGMA = 0.5 * DEGREE
# The sigma of the filter is used if that of the profile is at most so many times as large.
WIDER = 1.5
# Another heading is clearly better if its squared innovations, in total, are smaller by this.
BETTER = 4.0


class Refinement(Protocol):
    """A refinement from an attitude to start from."""

    def __call__(self, dcm: FloatArray, held: FloatArray | None = None) -> Refined:
        """Refine; `held`, a unit vector in ib0, is an axis about which `dcm` is exact.

        That holds at the row of the answer, where the filter then begins instead.
        """


@dataclass(frozen=True)
class Profile:
    """Squared innovations with other headings.

    Attributes
    ----------
    offset, cost : ndarray, shape (k,)
        By which heading is turned, rad, in order; squared innovations in all.
    """

    offset: FloatArray
    cost: FloatArray

    def sigma(self, scale: float) -> float:
        """Standard deviation about offset 0, rad, where each square is one of `scale` sigmas."""
        density = np.exp(-0.5 * (self.cost - self.cost.min()) / scale)
        width = np.diff(np.concatenate([self.offset[-1:] - 2.0 * np.pi, self.offset]))
        width = 0.5 * (width + np.roll(width, -1))
        weight = density * width
        return float(np.sqrt(np.sum(weight * self.offset**2) / np.sum(weight)))


def profiled(
    refine: Refinement, first: Refined, down_i: FloatArray, many: int, lasting: bool = False
) -> tuple[Refined, FloatArray]:
    """The likeliest refinement, and how much less certain its heading is than it says.

    Parameters
    ----------
    refine : callable
        As `first` was made.
    first : Refined
    down_i : ndarray, shape (3,)
        The vertical, in the axes that `dcm` leads to.
    many : int
        Values that the fixes measure.
    lasting : bool, optional
        Innovations that follow one another are worth less.

    Returns
    -------
    Refined
    ndarray, shape (3, 3)
        What its covariance of theta lacks, rad^2, in ib0, widened by innovations that are larger
        than expected as it will be.
    """
    found = first
    for last in (False, True):
        profile = _profile(refine, found, down_i, many)
        best = int(np.argmin(profile.cost))
        expected = max(found.chi2, 1.0)
        scale = max(found.lasting, expected) if lasting else expected
        centre = profile.cost[profile.offset == 0.0][0]
        if last or centre - profile.cost[best] < BETTER * scale:
            break
        again = refine(_turned(_corrected(found), down_i, profile.offset[best]))
        if again.chi2 >= found.chi2:
            break
        found = again
    down_b = _corrected(found).T @ down_i
    claimed = float(down_b @ found.covariance[THETA:S, THETA:S] @ down_b)
    shown = profile.sigma(scale) ** 2
    variance = shown if shown > WIDER**2 * scale * claimed else scale * claimed
    lacking = variance - expected * claimed
    return found, lacking * np.outer(down_b, down_b)


def likeliest(refine: Refinement, dcm: FloatArray, down_i: FloatArray) -> Refined:
    """The refinement that explains the fixes best, of those from headings all around.

    Parameters
    ----------
    refine : callable
    dcm : ndarray, shape (3, 3)
        An attitude whose heading is not known.
    down_i : ndarray, shape (3,)
        The vertical, in the axes that `dcm` leads to.
    """
    angles = np.arange(0.0, 2.0 * np.pi, 0.5 * AROUND)
    tried = (refine(_turned(dcm, down_i, angle)) for angle in angles)
    return min(tried, key=lambda one: one.chi2)


def _profile(refine: Refinement, found: Refined, down_i: FloatArray, many: int) -> Profile:
    dcm = _corrected(found)
    down_b = dcm.T @ down_i
    sigma = np.sqrt(down_b @ found.covariance[THETA:S, THETA:S] @ down_b)
    near = NEAR * max(float(sigma), LEAST_SIGMA)
    near = near[near < 0.8 * AROUND]
    around = AROUND * np.arange(-3, 5)
    offset = np.unique(np.concatenate([-near, near, around]))
    cost = [many * refine(_turned(dcm, down_i, angle), down_b).chi2 for angle in offset]
    return Profile(offset, np.array(cost))


def _corrected(found: Refined) -> FloatArray:
    """``C_0`` with the correction where the answer holds."""
    return np.asarray(found.dcm @ to_dcm(exp(-found.state[None, THETA:S]))[0])


def _turned(dcm: FloatArray, axis: FloatArray, angle: float) -> FloatArray:
    return np.asarray(to_dcm(exp((angle * axis)[None]))[0] @ dcm)
