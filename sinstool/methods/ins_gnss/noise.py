"""What filters assume of the errors of GNSS and of a barometer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf

from sinstool.core.errors import ConfigurationError
from sinstool.methods.sensor_errors import not_negative

Triple = tuple[float, float, float]


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
