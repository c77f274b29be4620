"""The field of magnetised iron that turns with the body, estimated from its rotation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import FloatArray

ROUNDS = 12
# One sigma of an offset before any turn has shown it, as a share of the field's size.
PRIOR = 0.1
# Residuals of epochs are correlated over some seconds: this many count as one.
CORRELATION = 25.0
# Errors that do not average out, as a share of the field's size: those of the attitude (a quarter
# of a degree).
TOGETHER = 0.005
# The residuals of a field that changes from place to place are correlated with the turns of the
# body, so they do not average out either. Of their variance a ninth per axis looks like iron where
# the body turns about all axes (3 of the 27 coefficients between three axes of the field and the
# nine numbers of the attitude), and half where it turns about one. White noise is not part of it,
# nor are residuals above OTHER_FIELD, a share of the field's size, which are of another source.
LIKE_IRON, OTHER_FIELD = 0.25, 0.1
# Residuals below this share of the field's size all have the same weight.
LEAST_RESIDUAL = 0.005
# An offset is removed if it exceeds this many sigmas.
SIGNIFICANT = 3.0
# An offset across the horizontal field whose sigma exceeds this share of the Earth's field was not
# observable: a usual one, of 0.3 of the field, would be less than three sigma.
UNSEEN = 0.1


@dataclass(frozen=True)
class HardIron:
    """A field that is fixed in the body.

    Attributes
    ----------
    offset : ndarray, shape (3,)
        In body axes, T.
    sigma : float
        Standard deviation of its part across the horizontal field, which is the part that turns a
        heading, T: the root mean square over the attitudes of the log.
    size : float
        Median size of the measured field, less the offset if that is removed, T.
    applied : bool
        It is significant, and is removed.
    """

    offset: FloatArray
    sigma: float
    size: float
    applied: bool

    @property
    def seen(self) -> bool:
        """Whether the body turned enough to tell it from the Earth's field."""
        return self.sigma <= UNSEEN * self.size


def find_hard_iron(field: FloatArray, attitude: FloatArray, piece: np.ndarray) -> HardIron:
    """Offset of a magnetometer under which the Earth's field stays constant as the body turns.

    ``field = h + attitude offset`` by robust least squares (Geman and McClure's weights) with a
    vertical h that is one for the log and a horizontal one for each piece, as heading drifts.

    Parameters
    ----------
    field : ndarray, shape (n, 3)
        In navigation axes, vertical last, T.
    attitude : ndarray, shape (n, 3, 3)
        Body to navigation axes.
    piece : ndarray of int, shape (n,)
        Number of the piece that each belongs to, in order.
    """
    size = float(np.median(np.linalg.norm(field, axis=1)))
    starts = np.flatnonzero(np.diff(piece, prepend=piece[0] - 1))
    lengths = np.diff(starts, append=len(piece))

    def centred(columns: FloatArray, weight: FloatArray) -> FloatArray:
        """Less the weighted means: of the pieces along the horizon, of the log along the vertical.

        `columns` has shape (n, 3, m).
        """
        weighted = columns * weight[:, None, None]
        out = columns.copy()
        level = np.add.reduceat(weighted[:, :2], starts, axis=0)
        level /= np.add.reduceat(weight, starts)[:, None, None]
        out[:, :2] -= np.repeat(level, lengths, axis=0)
        out[:, 2] -= weighted[:, 2].sum(axis=0) / weight.sum()
        return out

    columns = np.concatenate([attitude, field[:, :, None]], axis=2)
    weight = np.ones(len(field))
    prior = np.eye(3) / (PRIOR * size) ** 2
    offset = np.zeros(3)
    for _ in range(ROUNDS):
        part = centred(columns, weight)
        turned, left = part[:, :, :3], part[:, :, 3]
        information = np.einsum("n,nki,nkj->ij", weight, turned, turned)
        shown = np.einsum("n,nki,nk->i", weight, turned, left)
        residual = left - turned @ offset
        # of one axis; 1.54 times it is the median length of a vector of three
        scale = np.median(np.linalg.norm(residual, axis=1)) / 1.54
        variance = max(scale, LEAST_RESIDUAL * size) ** 2
        offset = np.linalg.solve(information / variance + prior, shown / variance)
        residual = left - turned @ offset
        square = np.einsum("nk,nk->n", residual, residual)
        weight = (9.0 * variance / (9.0 * variance + square)) ** 2
    covariance = CORRELATION * np.linalg.inv(information / variance + prior)
    spread = information / weight.sum()
    residual[square > (OTHER_FIELD * size) ** 2] = 0.0
    hanging = np.einsum("nk,nk->", residual[1:], residual[:-1]) / (3.0 * len(residual))
    lasting = (TOGETHER * size) ** 2 + LIKE_IRON * max(hanging, 0.0)
    covariance += np.linalg.inv(spread / lasting + np.eye(3) / size**2)
    # across the mean horizontal field, in body axes
    level = field[:, :2] - np.einsum("nij,j->ni", attitude[:, :2], offset)
    level /= np.maximum(np.linalg.norm(level, axis=1), 1e-3 * size)[:, None]
    across = level[:, :1] * attitude[:, 1] - level[:, 1:] * attitude[:, 0]
    sigma = np.sqrt(np.einsum("ni,ij,nj->n", across, covariance, across).mean())
    distance = float(offset @ np.linalg.solve(covariance, offset))
    applied = distance > SIGNIFICANT**2
    if applied:
        size = float(np.median(np.linalg.norm(field - attitude @ offset, axis=1)))
    return HardIron(offset, float(sigma), size, applied)
