"""Settings of an INS/GNSS filter, its models of sensor errors, and its start."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import inf
from typing import Literal

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.errors import ConfigurationError
from sinstool.core.units import ARCSEC
from sinstool.methods.height.network import HeightNetwork, recommended
from sinstool.methods.ins_gnss.states import GYRO_SCALE, FilterKind, FilterName, filter_kind
from sinstool.methods.sensor_errors import IMU_GRADES, Grade, SensorGrade, Triple, not_negative
from sinstool.methods.strapdown.navigation import SIZE as NAV_SIZE

# rad: after such a turn, errors of gyro axes have done what their sigma says
TURN = np.pi / 2.0
# s: gyros whose noise turns an attitude by more in this time do not show how the axes lie
SHOWN_WITHIN = 60.0

Adaptive = Literal["off", "sage-husa", "innovation"]
Feedback = Literal["closed", "none"]
# Correlation time of slow errors of positions, s, unless a log shows another
USUAL_S = 200.0


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
    position_time: float = USUAL_S
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

    @property
    def position_wander(self) -> float:
        """By how much the slow error of a horizontal axis has changed after a second, m."""
        return max(self.position_markov[:2]) * float(np.sqrt(2.0 / self.position_time))

    def with_slow_position(self, level: float, vertical: float) -> GnssModel:
        """The same receiver, the slow part of whose positions is so many times as large.

        Parameters
        ----------
        level, vertical : float
            Factors of standard deviations.
        """
        north, east, down = self.position_markov
        return replace(self, position_markov=(level * north, level * east, vertical * down))

    def lasting(self, seconds: float) -> GnssModel:
        """The same receiver, the slow part of whose positions lasts so long."""
        return replace(self, position_time=seconds)

    def with_slow_velocity(self, level: float, vertical: float) -> GnssModel:
        """The same receiver, the slow part of whose velocities is so many times as large."""
        north, east, down = self.velocity_markov
        return replace(self, velocity_markov=(level * north, level * east, vertical * down))


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
    "consumer": BaroModel(3.0, 300.0, 0.3),
    "mems": BaroModel(3.0, 300.0, 0.3),
    "industrial": BaroModel(3.0, 300.0, 0.3),
    "tactical": BaroModel(3.0, 300.0, 0.3),
    "navigation": BaroModel(10.0, 500.0, 0.0),
}
"""By grade of the IMU that the barometer usually comes with; that of a navigation grade IMU is
the one of the damping network's paper."""


@dataclass(frozen=True)
class DivergenceControl:
    """Settings against divergence of a filter from its measurements.

    Attributes
    ----------
    virtual_noise : bool
        Fictitious process noise, against errors of the model (Schlee, Standish, Toda 1967).
    virtual_position, virtual_velocity, virtual_attitude : float
        Its size, m, m/s and rad per sqrt(s).
    virtual_bias_time : float
        Biases wander by their initial sigma in this time, s.
    adaptive : {"off", "sage-husa", "innovation"}
        Measurement noise from the innovations: with fading memory (Sage, Husa 1969), or over a
        window (Mehra 1970; Mohamed, Schwarz 1999). Against bad fixes; it makes errors of the
        process model worse.
    fading : float
        Of ``sage-husa``, 0.95 to 0.99.
    window : int
        Epochs of ``innovation``.
    least, most : float
        Bounds of the adapted variance, as multiples of the given one. Of ``sage-husa``, an
        innovation beyond the upper one sets the variance to it at once.
    schmidt_epsilon : float
        Weight of the newest measurement beyond its due, 0 to 1 (Schmidt 1967; Jazwinski 1970,
        ch. 8).
    gate_probability : float
        Epochs whose normalised innovation squared exceeds this quantile are not used; 1 turns
        the gate off.
    restart_after : float
        So long nothing but such epochs, s, and at least three: the filter begins anew. A gate
        without a restart would lock a wrong filter away from its measurements for ever. 0: no
        restart, for tests.
    escalate : bool
        Within two minutes of a restart, which then did not help, a third of `restart_after` is
        enough for the next, which enlarges the sigmas of the start. Without it estimates stay near
        their values, and only so faults of settings or sensors show.
    gate_noise_epochs : int
        Before it rejects a fix the gate measures the noise of the fixes over this many epochs. If
        that is more than the nominal noise, their variance is increased instead. Not with
        `adaptive`. 0: never.
    """

    virtual_noise: bool = True
    virtual_position: float = 0.01
    virtual_velocity: float = 1e-3
    virtual_attitude: float = 0.1 * ARCSEC
    virtual_bias_time: float = 600.0
    adaptive: Adaptive = "off"
    fading: float = 0.99
    window: int = 60
    least: float = 0.5
    most: float = 100.0
    schmidt_epsilon: float = 0.0
    gate_probability: float = 0.9999
    restart_after: float = 30.0
    escalate: bool = True
    gate_noise_epochs: int = 60

    @property
    def measured_epochs(self) -> int:
        """Epochs whose noise is measured; 0 where there is no gate, or R is adapted."""
        gate = self.gate_probability < 1.0 and self.adaptive == "off"
        return self.gate_noise_epochs if gate else 0


@dataclass(frozen=True)
class Settings:
    """Settings of an INS/GNSS filter.

    Attributes
    ----------
    filter : str
        See :data:`~sinstool.methods.ins_gnss.states.FILTERS`.
    network : HeightNetwork, optional
        Of filters with one; by default the recommended one of the grade.
    grade : {"consumer", "mems", "industrial", "tactical", "navigation"}
        For the recommended network.
    feedback : {"closed", "none"}
        Whether mechanisation, sensors and network are corrected by the filter (closed loop),
        or only what comes out.
    lever_arm_b : tuple of float
        From the IMU to the antenna, FRD, m.
    gnss_latency : float
        From the time at which a fix is valid to its stamp, s.
    substep : float
        Longest time over which a transition matrix is made, s; not longer than tau/8 either.
    row_interval : float
        Time between measurements of the network's correction or of the baro height, s.
    baro_row : bool
        Use the baro height as a measurement in a filter with a network, too.
    correction_sigma : float
        Initial, m/s^2, and of the measurement of the network's correction.
    correction_walk : float
        Its process noise, (m/s^2)/sqrt(s).
    baro_gate : float
        Baro rows further off than so many sigmas are not used, until they agree with each
        other.
    max_gap : float
        IMU gaps up to this are bridged with the motion next to them, s; after longer ones the
        filter begins anew.
    gap_acceleration, gap_tilt_rate, gap_rate : float
        What the motion in a gap may have been beyond that, m/s^2, and rad/s across and about the
        vertical (1 sigma).

    Raises
    ------
    ConfigurationError
        If a value is impossible.
    """

    filter: FilterName = "network-29a"
    imu: SensorGrade = field(default_factory=lambda: IMU_GRADES["mems"])
    gnss: GnssModel = field(default_factory=GnssModel)
    baro: BaroModel = field(default_factory=lambda: BARO_GRADES["mems"])
    network: HeightNetwork | None = None
    grade: Grade = "mems"
    feedback: Feedback = "closed"
    control: DivergenceControl = field(default_factory=DivergenceControl)
    lever_arm_b: Triple = (0.0, 0.0, 0.0)
    gnss_latency: float = 0.0
    substep: float = 0.25
    row_interval: float = 1.0
    baro_row: bool = False
    correction_sigma: float = 1e-5
    correction_walk: float = 1e-6
    baro_gate: float = 5.0
    max_gap: float = 5.0
    gap_acceleration: float = 1.0
    gap_tilt_rate: float = 0.1
    gap_rate: float = 0.1

    def __post_init__(self) -> None:
        filter_kind(self.filter)
        if not np.all(np.isfinite([*self.lever_arm_b, self.gnss_latency])):
            raise ConfigurationError("lever arm or latency is not a number", "metres, seconds")
        if not (self.substep > 0.0 and self.row_interval > 0.0 and self.baro_gate > 0.0):
            raise ConfigurationError(
                "substep, row_interval or baro_gate is not positive", "they are s, s, sigmas"
            )
        not_negative(
            "filter",
            correction_sigma=self.correction_sigma,
            correction_walk=self.correction_walk,
            max_gap=self.max_gap,
            gap_acceleration=self.gap_acceleration,
            gap_tilt_rate=self.gap_tilt_rate,
            gap_rate=self.gap_rate,
        )

    @property
    def kind(self) -> FilterKind:
        """The filter's states: those of misaligned axes only where a log can show them."""
        kind = filter_kind(self.filter)
        shown = self.imu.gyro_misalignment * TURN > self.imu.angle_random_walk * SHOWN_WITHIN**0.5
        return kind.with_axes if shown and GYRO_SCALE in kind.blocks else kind

    @property
    def ungated(self) -> Settings:
        """Without a gate, which rejects what contradicts a start: for runs that judge one."""
        control = replace(self.control, gate_probability=1.0, adaptive="off")
        return replace(self, network=None, control=control)

    @property
    def damping(self) -> HeightNetwork:
        """The network, given or recommended."""
        return self.network if self.network is not None else recommended(self.grade)


@dataclass(frozen=True)
class Start:
    """Initial state of a filter, and its sigmas.

    Attributes
    ----------
    nav : ndarray, shape (10,)
        :func:`sinstool.methods.strapdown.navigation.initial_state`, at the start of the first IMU
        update.
    covariance_position_n, covariance_velocity_n, covariance_attitude_n : ndarray, shape (3, 3)
        m^2, (m/s)^2, and rad^2 of the small rotation in NED that takes the attitude given to
        the true one.
    gyro_bias, accel_bias : ndarray, shape (3,)
        Known already, rad/s and m/s^2: to be taken off the increments.
    gyro_bias_sigma, accel_bias_sigma : float, optional
        How well; by default as the noise of the IMU says.
    by_fixes : bool, optional
        Position and velocity are those of fixes, and so hold the slow errors that these have then.
    """

    nav: FloatArray
    covariance_position_n: FloatArray
    covariance_velocity_n: FloatArray
    covariance_attitude_n: FloatArray
    gyro_bias: FloatArray = field(default_factory=lambda: np.zeros(3))
    accel_bias: FloatArray = field(default_factory=lambda: np.zeros(3))
    gyro_bias_sigma: float | None = None
    accel_bias_sigma: float | None = None
    by_fixes: bool = False

    def __post_init__(self) -> None:
        if self.nav.shape != (NAV_SIZE,) or not np.all(np.isfinite(self.nav)):
            raise ValueError(f"Expected `nav` to be {NAV_SIZE} finite numbers.")
        for name in ("position", "velocity", "attitude"):
            block = getattr(self, f"covariance_{name}_n")
            if np.shape(block) != (3, 3) or not np.all(np.linalg.eigvalsh(block) >= 0.0):
                raise ValueError(f"Expected `covariance_{name}_n` to be a covariance (3, 3).")
        if np.shape(self.gyro_bias) != (3,) or np.shape(self.accel_bias) != (3,):
            raise ValueError("Expected `gyro_bias` and `accel_bias` to have shape (3,).")
