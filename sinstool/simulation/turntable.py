"""The angle of a turntable that steps from rate to rate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sinstool.core.arrays import ArrayLike, FloatArray


class TableProfile:
    """Angle of a table that goes from rate to rate, exact at any time.

    Parameters
    ----------
    plateaus : sequence of (float, float)
        ``(rate, duration)``, rad/s and s; one at least.
    acceleration : float
        Acceleration between plateaus, rad/s^2. The table already turns at the first rate at the
        beginning, and still at the last one at the end.
    """

    def __init__(
        self, plateaus: Sequence[tuple[float, float]], acceleration: float = np.radians(5.0)
    ) -> None:
        parts: list[tuple[float, float, float]] = []  # duration, rate at start, acceleration
        before = plateaus[0][0]
        for rate, duration in plateaus:
            if rate != before:
                ramp = abs(rate - before) / acceleration
                parts.append((ramp, before, (rate - before) / ramp))
            parts.append((duration, rate, 0.0))
            before = rate
        length, self._rate, self._acceleration = (
            np.array(column) for column in zip(*parts, strict=True)
        )
        self._start = np.concatenate(([0.0], np.cumsum(length)))
        turned = self._rate * length + 0.5 * self._acceleration * length**2
        self._angle = np.concatenate(([0.0], np.cumsum(turned)))

    @property
    def duration(self) -> float:
        """Duration of the profile, s."""
        return float(self._start[-1])

    def angle(self, t: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Angle, rate and acceleration.

        Parameters
        ----------
        t : array_like
            Time, s; beyond both ends the rate stays constant.

        Returns
        -------
        angle, rate, acceleration : ndarray
            rad, rad/s, rad/s^2.
        """
        at = np.asarray(t, dtype=np.float64)
        part = np.clip(np.searchsorted(self._start, at, side="right") - 1, 0, len(self._rate) - 1)
        since = at - self._start[part]
        acceleration = self._acceleration[part]
        rate = self._rate[part] + acceleration * since
        angle = self._angle[part] + (self._rate[part] + 0.5 * acceleration * since) * since
        return angle, rate, acceleration
