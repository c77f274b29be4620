"""Noise of an IMU over that of its grade, and bounds of it by rest and by motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.methods.ins_gnss.settings import Settings
from sinstool.methods.ins_gnss.states import ACCEL_AXES
from sinstool.methods.sensor_errors import LOW_COST
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.survey.grade import random_walks
from sinstool.survey.noise_in_motion import walks_in_motion
from sinstool.survey.source import Source

Bounds = tuple[float, float]
ANY: Bounds = (0.0, np.inf)


@dataclass(frozen=True)
class NoiseFactors:
    """Factors on the noise that a grade has.

    Attributes
    ----------
    gyro, accel : float
        On white noise and bias instability.
    scale : float
        On the share of the scale factors that wanders.
    white : tuple of tuple of float
        Least and largest factor on the white noise of gyros, and on that of accelerometers, as the
        log shows it at rest and in motion.
    """

    gyro: float
    accel: float
    scale: float = 1.0
    white: tuple[Bounds, Bounds] = (ANY, ANY)

    @property
    def ordinary(self) -> bool:
        """Whether all factors are 1."""
        return self.gyro == self.accel == self.scale == 1.0

    def of(self, settings: Settings, virtual_noise: bool) -> Settings:
        """Settings with this noise.

        Parameters
        ----------
        virtual_noise : bool
            Whether fictitious process noise, if there is any, remains.
        """
        imu, control = settings.imu, settings.control
        gyro, accel = (
            min(max(factor, least), most)
            for factor, (least, most) in zip((self.gyro, self.accel), self.white, strict=True)
        )
        noisier = replace(
            imu,
            angle_random_walk=gyro * imu.angle_random_walk,
            gyro_instability=self.gyro * imu.gyro_instability,
            velocity_random_walk=accel * imu.velocity_random_walk,
            accel_instability=self.accel * imu.accel_instability,
            scale_wander=min(1.0, self.scale * imu.scale_wander),
        )
        virtual = replace(control, virtual_noise=control.virtual_noise and virtual_noise)
        return replace(settings, imu=noisier, control=virtual)

    def __str__(self) -> str:
        parts = [] if self.scale == 1.0 else [f"scale factors {self.scale:.2g}"]
        if self.gyro != self.accel:
            parts += [f"gyros {self.gyro:.2g}", f"accelerometers {self.accel:.2g}"]
        elif not parts:
            parts.append(f"{self.gyro:.2g}")
        elif self.gyro != 1.0:
            parts.append(f"gyros and accelerometers {self.gyro:.2g}")
        return ", ".join(parts) + " times"


def noise_at_rest(source: Source, start: FilterStart) -> FloatArray:
    """Noise of gyros and accelerometers at rest over that of the settings; NaN without a rest."""
    walks, imu = random_walks(source), start.settings.imu
    if walks is None:
        return np.full(2, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.divide(walks, (imu.angle_random_walk, imu.velocity_random_walk))


def white_noise_bounds(
    source: Source, start: FilterStart, rest: FloatArray
) -> tuple[Bounds, Bounds]:
    """Bounds of the white noise of gyros and accelerometers, over that of the settings.

    Sensors are at least as noisy as at rest (unless the grade was judged by drift: then the noise
    at rest is that of the vehicle), and at most as noisy as in motion. The white noise of
    accelerometers is not bounded above if the filter has no states for misaligned axes, whose
    errors it stands in for; that of low-cost grades, which stands in for more, not at all.

    Parameters
    ----------
    rest : ndarray, shape (2,)
        See :func:`noise_at_rest`.
    """
    moving, imu = walks_in_motion(source), start.settings.imu
    assumed = imu.angle_random_walk, imu.velocity_random_walk
    if start.grade.grade in LOW_COST or not all(assumed):
        return ANY, ANY
    shown = np.full(2, np.inf) if moving is None else np.divide(moving, assumed)
    rest = np.zeros(2) if start.grade.by_drift else np.nan_to_num(rest)
    gyro, accel = np.minimum(np.minimum(rest, shown), 1.0).tolist()
    most_gyro, most_accel = np.maximum(shown, 1.0).tolist()
    has_axes = start.settings.kind.first(ACCEL_AXES) >= 0
    return (gyro, most_gyro), (accel, most_accel if has_axes else np.inf)
