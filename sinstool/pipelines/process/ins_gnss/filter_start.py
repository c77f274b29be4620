"""Start data of a run of the INS/GNSS filter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.streams import GnssEpochs
from sinstool.methods.height.pressure import HeightReference
from sinstool.methods.ins_gnss.receiver_offsets import LATENCY_S, ReceiverOffsets
from sinstool.methods.ins_gnss.settings import Settings, Start
from sinstool.survey.grade import ImuGrade


@dataclass(frozen=True)
class FilterStart:
    """A filter's settings, start and measurements: all but the samples.

    Attributes
    ----------
    time_ns : int
        An Imu sample's: the first update of the filter begins there.
    how : str
        Where the start comes from, in words.
    gnss : GnssEpochs
        Valid `settings.gnss_latency` before their stamps.
    withheld : ndarray of bool
        Epochs that are scored, not used.
    reference : HeightReference or None
        Barometer heights.
    offsets : ReceiverOffsets or None
        Latency and arm as the log shows them; None before it was asked, or with too few fixes.
    latency_status : {'given', 'found', 'not settled', 'not observable'}
        ``given`` by the user; ``not settled`` where what the log shows is not what is used.
    lag : float
        By which velocities are taken to be stamped later than positions, s.
    warnings, attitude_warnings : tuple of str
        About settings and measurements, and about how the attitude was found.
    """

    settings: Settings
    start: Start
    time_ns: int
    how: str
    gnss: GnssEpochs
    withheld: np.ndarray
    reference: HeightReference | None
    offsets: ReceiverOffsets | None
    latency_status: str
    lag: float
    grade: ImuGrade
    gnss_why: str
    warnings: tuple[str, ...]
    attitude_warnings: tuple[str, ...]

    @property
    def used(self) -> GnssEpochs:
        """Epochs that are not withheld."""
        return self.gnss.rows(~self.withheld)

    @property
    def offsets_error(self) -> FloatArray:
        """Second moments of the errors of the latency and lever arm used, of s and m, (4, 4).

        A latency that nobody gave and that the log does not show is as uncertain as latencies are.
        """
        configured = self.latency_status == "given"
        if self.offsets is not None:
            return self.offsets.error_of(self.settings.gnss_latency, configured)
        return np.diag([0.0 if configured else LATENCY_S**2, 0.0, 0.0, 0.0])


def measurements(p: FilterStart) -> dict[str, Any]:
    """Measurements that a filter gets with its first increments."""
    columns: dict[str, Any] = {"gnss": p.gnss, "withheld": p.withheld}
    if p.reference is not None:
        r = p.reference
        later = r.arrival_ns >= p.time_ns
        columns["baro_time_ns"] = r.time_ns[later]
        columns["baro_height"] = r.height[later]
        columns["baro_reason"] = r.reason[later]
    return columns
