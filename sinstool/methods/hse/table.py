"""Headings at known azimuths before and after correction, as table 1 of the paper has them.

Yu et al., J. NUDT 35(4), 2013, 161-165: the system is turned to several azimuths on a stand and
aligned a few times at each. What is left of heading less azimuth, less its mean, shows
heading-sensitive error as a sinusoid of azimuth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sinstool.core.rotation import wrapped
from sinstool.methods.hse.positions import by_angle
from sinstool.methods.hse.statistics import Scatter, Sinusoid, fit_sinusoid, scatter

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Column:
    """Headings less azimuth of one treatment.

    Attributes
    ----------
    values : ndarray, shape (n,)
        rad, less their mean.
    mean : float
        What was subtracted: the azimuth of ``b0`` where the stand shows zero, rad, in
        [-pi, pi).
    sinusoid : Sinusoid or None
        None with fewer than three azimuths.
    """

    values: FloatArray
    mean: float
    scatter: Scatter
    sinusoid: Sinusoid | None


@dataclass(frozen=True)
class ValidationTable:
    """Headings at azimuths before and after correction.

    Attributes
    ----------
    ids : tuple of str
        Of the rows.
    azimuth : ndarray, shape (n,)
        Shown by the stand, rad.
    position : ndarray of int, shape (n,)
        Number of the azimuth of each row, ascending with it.
    position_azimuth : ndarray, shape (m,)
        Mean of the rows of each position, rad, in [0, 2 pi).
    """

    ids: tuple[str, ...]
    azimuth: FloatArray
    position: IntArray
    position_azimuth: FloatArray
    before: Column
    after: Column


def validation_table(
    azimuth: ArrayLike,
    heading: ArrayLike,
    corrected: ArrayLike,
    ids: Sequence[str] | None = None,
) -> ValidationTable:
    """Compare headings before and after correction.

    Parameters
    ----------
    azimuth : array_like, shape (n,)
        Shown by the stand, rad; rows within 0.5 deg are repeats at one position.
    heading, corrected : array_like, shape (n,)
        Before and after correction, rad.
    ids : sequence of str, optional
        Names of the rows; their numbers without.

    Returns
    -------
    ValidationTable
        In the order of the rows given.

    Raises
    ------
    ValueError
        If the columns differ in length or are empty.
    """
    a = np.asarray(azimuth, dtype=np.float64)
    before, after = np.asarray(heading, np.float64), np.asarray(corrected, np.float64)
    if a.ndim != 1 or not len(a) or a.shape != before.shape or a.shape != after.shape:
        raise ValueError(f"Expected equal columns, got {a.shape}, {before.shape}, {after.shape}.")
    names = tuple(ids) if ids is not None else tuple(str(i + 1) for i in range(len(a)))
    if len(names) != len(a):
        raise ValueError(f"Expected {len(a)} names, got {len(names)}.")
    group = by_angle(a)
    start = np.array([a[np.argmax(group == k)] for k in range(group.max() + 1)])
    mean = start + np.array(
        [wrapped(a[group == k] - start[k]).mean() for k in range(group.max() + 1)]
    )
    mean %= 2.0 * np.pi
    mean[2.0 * np.pi - mean < 1e-12] = 0.0
    order = np.argsort(mean)
    position = np.argsort(order)[group]
    return ValidationTable(
        ids=names,
        azimuth=a,
        position=position,
        position_azimuth=mean[order],
        before=_column(a, before, position),
        after=_column(a, after, position),
    )


def _column(azimuth: FloatArray, heading: FloatArray, position: IntArray) -> Column:
    difference = wrapped(heading - azimuth)
    # from the first row on: values either side of 180 deg are neighbours
    offset = wrapped(difference - difference[0])
    values = offset - offset.mean()
    sinusoid = None
    if position.max() >= 2:
        sinusoid = fit_sinusoid(azimuth, values)
    return Column(
        values=values,
        mean=float(wrapped(difference[0] + offset.mean())),
        scatter=scatter(values, position),
        sinusoid=sinusoid,
    )
