"""What filters assume of sensors: inertial sensors by grade, GNSS, barometer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf

import numpy as np
from numpy.typing import NDArray

from sinstool.core.errors import ConfigurationError
from sinstool.core.units import DEGREE_PER_HOUR, DEGREE_PER_ROOT_HOUR, MICRO_G, MILLI_G

FloatArray = NDArray[np.float64]
Triple = tuple[float, float, float]


def not_negative(owner: str, **values: float | Triple) -> None:
    """Refuse sigmas and times that are negative or not a number.

    Parameters
    ----------
    owner : str
        For the message.
    **values
        By their names.

    Raises
    ------
    ConfigurationError
        If one is.
    """
    for name, value in values.items():
        if not np.all(np.asarray(value, dtype=np.float64) >= 0.0):
            raise ConfigurationError(f"{owner}: {name} is {value}", "it must be 0 or more")


@dataclass(frozen=True)
class ImuNoise:
    """Errors of gyros and accelerometers, each axis alike.

    Attributes
    ----------
    angle_random_walk : float
        rad/sqrt(s).
    velocity_random_walk : float
        (m/s)/sqrt(s).
    gyro_bias, accel_bias : float
        Standard deviation of what the biases are at the start beyond what is known, rad/s and
        m/s^2.
    gyro_instability, accel_instability : float
        Standard deviation of the part of a bias that wanders; 0: a bias stays.
    instability_time : float
        Its correlation time, s. A filter has one state for both parts: a random walk that
        moves, over times shorter than this one, as the wandering part does.
    accel_scale : float
        Standard deviation of scale factors, as a fraction.
    gyro_scale : float
        Standard deviation of scale factors and misalignments, as a fraction. They have no states:
        attitude gets less certain with each angle turned, by this fraction of a right angle
        in a turn by one.
    """

    angle_random_walk: float
    velocity_random_walk: float
    gyro_bias: float
    accel_bias: float
    gyro_instability: float = 0.0
    accel_instability: float = 0.0
    instability_time: float = 100.0
    accel_scale: float = 0.0
    gyro_scale: float = 0.0

    def __post_init__(self) -> None:
        not_negative("noise of the IMU", **vars(self))
        if self.instability_time == 0.0:
            raise ConfigurationError(
                "noise of the IMU: instability_time is 0 s", "it must be positive"
            )


# Tactical and navigation grade: data sheets; biases after warming up. MEMS: a consumer's, in a
# vehicle that shakes it. Its random walks are ten times and more those of a data sheet, for they
# stand in for vibration, sampling and scale factors too: with the data sheet's a filter is too sure
# of itself after seconds without fixes, and gates the first ones that come. Scale factors and
# cross-axis sensitivity of their gyros are 0.5 to 2 % on data sheets. Gyro biases of such
# sensors were seen to move by 100 deg/h from one stop of a car to one minutes later.
IMU_GRADES: dict[str, ImuNoise] = {
    "mems": ImuNoise(
        3.0 * DEGREE_PER_ROOT_HOUR,
        3000.0 * MICRO_G,
        50.0 * DEGREE_PER_HOUR,
        10.0 * MILLI_G,
        100.0 * DEGREE_PER_HOUR,
        1.0 * MILLI_G,
        100.0,
        3e-3,
        5e-3,
    ),
    "tactical": ImuNoise(
        0.05 * DEGREE_PER_ROOT_HOUR,
        50.0 * MICRO_G,
        1.0 * DEGREE_PER_HOUR,
        1.0 * MILLI_G,
        0.3 * DEGREE_PER_HOUR,
        0.05 * MILLI_G,
        300.0,
        3e-4,
    ),
    "navigation": ImuNoise(
        0.002 * DEGREE_PER_ROOT_HOUR,
        10.0 * MICRO_G,
        0.01 * DEGREE_PER_HOUR,
        0.05 * MILLI_G,
        0.002 * DEGREE_PER_HOUR,
        0.005 * MILLI_G,
        1000.0,
        5e-5,
    ),
}
"""By grade of IMU."""


@dataclass(frozen=True)
class GnssModel:
    """Errors of fixes: white noise, and a Markov process beside it that a filter may estimate.

    Attributes
    ----------
    position_white, position_markov : tuple of float
        Standard deviations of north, east and down, m.
    velocity_white, velocity_markov : tuple of float
        The same, m/s.
    position_time, velocity_time : float
        Correlation times of the Markov processes, s.
    """

    position_white: Triple = (2.0, 2.0, 3.0)
    position_markov: Triple = (5.0, 5.0, 8.0)
    position_time: float = 200.0
    velocity_white: Triple = (0.05, 0.05, 0.08)
    velocity_markov: Triple = (0.1, 0.1, 0.15)
    velocity_time: float = 60.0

    def __post_init__(self) -> None:
        not_negative("noise of GNSS", **vars(self))
        if self.position_time == 0.0 or self.velocity_time == 0.0:
            raise ConfigurationError(
                "noise of GNSS: a correlation time is 0 s", "it must be positive"
            )
        if min(*self.position_white, *self.velocity_white) <= 0.0:
            raise ConfigurationError(
                "noise of GNSS: a white part is 0", "without any, a filter cannot weigh fixes"
            )

    def scaled(self, position: float, velocity: float) -> GnssModel:
        """The same receiver, so many times as noisy.

        Parameters
        ----------
        position, velocity : float
            Factors of all standard deviations.
        """

        def times(values: Triple, factor: float) -> Triple:
            return (values[0] * factor, values[1] * factor, values[2] * factor)

        return replace(
            self,
            position_white=times(self.position_white, position),
            position_markov=times(self.position_markov, position),
            velocity_white=times(self.velocity_white, velocity),
            velocity_markov=times(self.velocity_markov, velocity),
        )


@dataclass(frozen=True)
class BaroModel:
    """Error of a barometric height: a Markov process, and white noise of each sample.

    Attributes
    ----------
    sigma : float
        Of the Markov process, m.
    correlation_time : float
        Of it, s; ``inf`` for an offset.
    white : float
        Of each sample, m.
    """

    sigma: float = 10.0
    correlation_time: float = 500.0
    white: float = 0.0

    def __post_init__(self) -> None:
        not_negative("noise of the barometer", **vars(self))
        if self.correlation_time == 0.0:
            raise ConfigurationError(
                "noise of the barometer: correlation_time is 0 s", "it must be positive"
            )

    @property
    def decay(self) -> float:
        """1/correlation time, 1/s."""
        return 0.0 if self.correlation_time == inf else 1.0 / self.correlation_time


BARO_GRADES: dict[str, BaroModel] = {
    "mems": BaroModel(3.0, 300.0, 0.3),
    "tactical": BaroModel(3.0, 300.0, 0.3),
    "navigation": BaroModel(10.0, 500.0, 0.0),
}
"""By grade of the IMU that the barometer usually comes with; that of a navigation grade IMU is
the one of the damping network's paper."""
