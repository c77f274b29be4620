"""What an INS/GNSS filter is told."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sinstool.core.errors import ConfigurationError
from sinstool.core.units import ARCSEC
from sinstool.methods.height.network import HeightNetwork
from sinstool.methods.ins_gnss.noise import BARO_GRADES, BaroModel, GnssModel
from sinstool.methods.ins_gnss.states import FilterKind, FilterName, filter_kind
from sinstool.methods.sensor_errors import IMU_GRADES, Grade, SensorGrade, Triple, not_negative
from sinstool.methods.strapdown.navigation import SIZE as NAV_SIZE

FloatArray = NDArray[np.float64]

Adaptive = Literal["off", "sage-husa", "innovation"]
Feedback = Literal["closed", "none"]


@dataclass(frozen=True)
class DivergenceControl:
    """What keeps a filter from believing itself against its measurements.

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
    restart_after : int
        So many such epochs in a row: the filter begins anew. A gate without a restart would
        lock a wrong filter away from its measurements for ever. 0: no restart, for tests.
    gate_noise_epochs : int
        Before it turns a fix down the gate measures the noise of the fixes over so many epochs,
        and where that is more than it was told, the filter believes them that much less
        instead. Not with `adaptive`. 0: never.
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
    restart_after: int = 60
    gate_noise_epochs: int = 60

    @property
    def measured_epochs(self) -> int:
        """Epochs whose noise is measured; 0 where there is no gate, or R is adapted."""
        gate = self.gate_probability < 1.0 and self.adaptive == "off"
        return self.gate_noise_epochs if gate else 0

    def __post_init__(self) -> None:
        if self.adaptive not in ("off", "sage-husa", "innovation"):
            raise ConfigurationError(
                f"adaptive is {self.adaptive!r}", "one of off, sage-husa, innovation"
            )
        if not 0.0 <= self.schmidt_epsilon <= 1.0:
            raise ConfigurationError(
                f"schmidt_epsilon is {self.schmidt_epsilon:g}", "it must be within 0 and 1"
            )
        if not 0.0 < self.fading < 1.0:
            raise ConfigurationError(f"fading is {self.fading:g}", "it must be between 0 and 1")
        if not 0.5 <= self.gate_probability <= 1.0:
            raise ConfigurationError(
                f"gate_probability is {self.gate_probability:g}", "it must be within 0.5 and 1"
            )
        if not 0.0 < self.least <= 1.0 <= self.most:
            raise ConfigurationError(
                f"adapted variances are bounded by {self.least:g} and {self.most:g}",
                "the bounds must hold 1 between them",
            )
        if self.window < 2 or self.restart_after < 0 or self.gate_noise_epochs < 0:
            raise ConfigurationError(
                f"window is {self.window}, restart_after is {self.restart_after},"
                f" gate_noise_epochs is {self.gate_noise_epochs}",
                "at least 2, 0 and 0 epochs",
            )
        not_negative(
            "virtual noise",
            virtual_position=self.virtual_position,
            virtual_velocity=self.virtual_velocity,
            virtual_attitude=self.virtual_attitude,
        )
        if not self.virtual_bias_time > 0.0:
            raise ConfigurationError(
                f"virtual_bias_time is {self.virtual_bias_time:g} s", "it must be positive"
            )


@dataclass(frozen=True)
class Settings:
    """All that an INS/GNSS filter is told but for the data.

    Attributes
    ----------
    filter : str
        See :data:`~sinstool.methods.ins_gnss.states.FILTERS`.
    network : HeightNetwork, optional
        Of filters with one; by default the recommended one of the grade.
    grade : {"mems", "tactical", "navigation"}
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
    known_k4_input : bool
        Tell the filter what K4 times the vertical velocity does to the navigation. Without, a
        network with K4 is refused.
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
    gap_acceleration, gap_rate : float
        What the motion in a gap may have been beyond that, m/s^2 and rad/s (1 sigma).

    Raises
    ------
    ConfigurationError
        If a value is impossible.
    """

    filter: FilterName = "network-26a"
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
    known_k4_input: bool = True
    correction_sigma: float = 1e-5
    correction_walk: float = 1e-6
    baro_gate: float = 5.0
    max_gap: float = 5.0
    gap_acceleration: float = 1.0
    gap_rate: float = 0.1

    def __post_init__(self) -> None:
        kind = filter_kind(self.filter)
        if self.feedback not in ("closed", "none"):
            raise ConfigurationError(f"feedback is {self.feedback!r}", "one of closed, none")
        if kind.network and not self.known_k4_input and self.damping.k4 != 0.0:
            raise ConfigurationError(
                f"K4 is {self.damping.k4:g} s, and the filter is not told what it does",
                "K4 = 0, or known_k4_input",
            )
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
            gap_rate=self.gap_rate,
        )

    @property
    def kind(self) -> FilterKind:
        """The filter's states."""
        return filter_kind(self.filter)

    @property
    def damping(self) -> HeightNetwork:
        """The network, given or recommended."""
        from sinstool.methods.height.network import recommended

        return self.network if self.network is not None else recommended(self.grade)


@dataclass(frozen=True)
class Start:
    """Where a filter starts, and how well that is known.

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
    """

    nav: FloatArray
    covariance_position_n: FloatArray
    covariance_velocity_n: FloatArray
    covariance_attitude_n: FloatArray
    gyro_bias: FloatArray = field(default_factory=lambda: np.zeros(3))
    accel_bias: FloatArray = field(default_factory=lambda: np.zeros(3))
    gyro_bias_sigma: float | None = None
    accel_bias_sigma: float | None = None

    def __post_init__(self) -> None:
        if self.nav.shape != (NAV_SIZE,) or not np.all(np.isfinite(self.nav)):
            raise ValueError(f"Expected `nav` to be {NAV_SIZE} finite numbers.")
        for name in ("position", "velocity", "attitude"):
            block = getattr(self, f"covariance_{name}_n")
            if np.shape(block) != (3, 3) or not np.all(np.linalg.eigvalsh(block) >= 0.0):
                raise ValueError(f"Expected `covariance_{name}_n` to be a covariance (3, 3).")
        if np.shape(self.gyro_bias) != (3,) or np.shape(self.accel_bias) != (3,):
            raise ValueError("Expected `gyro_bias` and `accel_bias` to have shape (3,).")
