"""Heights that a vertical channel is held to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sinstool.methods.height.pressure import BaroReference


@dataclass(frozen=True)
class HeightReference:
    """Heights that damp the vertical channel.

    Attributes
    ----------
    kind : {'baro', 'gnss'}
    time_ns : ndarray of int64, shape (m,)
        When measured, in the order of arrival.
    height : ndarray, shape (m,)
        Above the ellipsoid as far as the reference says, m.
    reason : ndarray of int64, shape (m,)
        Why a sample is not to be used; 0 where it is.
    sigma : float
        Median of what the sensor says of its own noise, m; 0 where it says nothing.
    baro : BaroReference or None
    """

    kind: Literal["baro", "gnss"]
    topic: str
    time_ns: np.ndarray
    height: np.ndarray
    reason: np.ndarray
    sigma: float
    baro: BaroReference | None

    @property
    def arrival_ns(self) -> np.ndarray:
        """When samples are used, shape (m,): in the order of the stamps they were sorted by."""
        return np.asarray(np.maximum.accumulate(self.time_ns))
