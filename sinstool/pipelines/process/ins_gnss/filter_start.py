"""All that a run of the INS/GNSS filter starts from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.streams import GnssEpochs
from sinstool.methods.height.pressure import HeightReference
from sinstool.methods.ins_gnss.latency import Latency
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
    latency : Latency or None
        As estimated; None where the user gives it.
    lag : float
        By which velocities are taken to be stamped later than positions, s.
    """

    settings: Settings
    start: Start
    time_ns: int
    how: str
    gnss: GnssEpochs
    withheld: np.ndarray
    reference: HeightReference | None
    latency: Latency | None
    lag: float
    grade: ImuGrade
    gnss_why: str
    warnings: tuple[str, ...]

    @property
    def used(self) -> GnssEpochs:
        """Epochs that are not withheld."""
        return self.gnss.rows(~self.withheld)
