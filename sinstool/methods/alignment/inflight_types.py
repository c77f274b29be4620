"""Data of in-flight alignment: increments, fixes, settings, series.

Sigmas of sensors and fixes are those of one axis; all three axes are taken alike.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.errors import AlignmentError
from sinstool.core.streams import take_rows
from sinstool.methods.sensor_errors import SIMULATED_GRADES, SensorGrade, without

Status = Literal["ok", "degraded", "level-only", "unobservable", "failed"]

OK_SIGMA = float(np.deg2rad(1.0))
"""Worst-axis sigma up to which an alignment is ``ok``; also of tilt for ``level-only``."""

REFUSE_SIGMA = float(np.deg2rad(5.0))
"""Worst-axis sigma beyond which no heading is given."""

UNIFORM_SIGMA = float(np.pi / np.sqrt(3.0))
"""Standard deviation of a heading of which nothing is known, rad (104 deg)."""


@dataclass(frozen=True)
class ImuIncrements:
    """Inertial increments in body axes (FRD).

    Attributes
    ----------
    time_ns : ndarray of int64, shape (n,)
        Ends of the intervals, increasing.
    delta_theta : ndarray, shape (n, 3)
        Integral of angular rate over (t[k-1], t[k]], rad. Row 0 only serves as history.
    delta_velocity : ndarray, shape (n, 3)
        Integral of specific force, m/s.

    Raises
    ------
    ValueError
        If shapes do not fit.
    AlignmentError
        If time runs backward or a value is not finite. Rows of equal time are not checked
        here: alignment drops them.
    """

    time_ns: IntArray
    delta_theta: FloatArray
    delta_velocity: FloatArray

    def __post_init__(self) -> None:
        _columns(self, (("delta_theta", 3), ("delta_velocity", 3)))
        _forward(self.time_ns, "IMU")
        if not (np.isfinite(self.delta_theta).all() and np.isfinite(self.delta_velocity).all()):
            raise AlignmentError(
                "IMU increments hold values that are not finite", "drop these samples first"
            )

    def __len__(self) -> int:
        return len(self.time_ns)

    def rows(self, which: Any) -> ImuIncrements:
        """Rows by slice, mask or index array."""
        return take_rows(self, which)


@dataclass(frozen=True)
class GnssFixes:
    """Position and velocity of the antenna, as stamped (latency not removed).

    Attributes
    ----------
    time_ns : ndarray of int64, shape (m,)
        Increasing, on the clock of the IMU.
    latitude, longitude, height : ndarray, shape (m,)
        rad and m. A fix without position (NaN) is not used.
    velocity_n : ndarray, shape (m, 3)
        North, east, down, m/s; NaN where missing.
    sigma_v : ndarray, shape (m,), optional
        Velocity noise of each fix, m/s per axis.
    derived_s : ndarray, shape (m,), optional
        Of velocities that are derived from positions, see
        :class:`~sinstool.core.streams.DerivedEpochs`; by default they are of an instant.

    Raises
    ------
    ValueError
        If shapes do not fit.
    AlignmentError
        If time runs backward.
    """

    time_ns: IntArray
    latitude: FloatArray
    longitude: FloatArray
    height: FloatArray
    velocity_n: FloatArray
    sigma_v: FloatArray | None = None
    derived_s: FloatArray | None = None

    def __post_init__(self) -> None:
        scalars = ["latitude", "longitude", "height"]
        scalars += [name for name in ("sigma_v", "derived_s") if getattr(self, name) is not None]
        _columns(self, (("velocity_n", 3), *((name, 0) for name in scalars)))
        _forward(self.time_ns, "GNSS")

    def __len__(self) -> int:
        return len(self.time_ns)

    def rows(self, which: Any) -> GnssFixes:
        """Rows by slice, mask or index array."""
        return take_rows(self, which)


def _columns(of: Any, shapes: tuple[tuple[str, int], ...]) -> None:
    object.__setattr__(of, "time_ns", np.ascontiguousarray(of.time_ns, dtype=np.int64))
    count = len(of.time_ns)
    for name, width in shapes:
        values = np.ascontiguousarray(getattr(of, name), dtype=np.float64)
        shape = (count, width) if width else (count,)
        if values.shape != shape:
            raise ValueError(f"Expected `{name}` to have shape {shape}, got {values.shape}.")
        object.__setattr__(of, name, values)


def _forward(time_ns: IntArray, what: str) -> None:
    back = np.flatnonzero(np.diff(time_ns) < 0)
    if len(back):
        raise AlignmentError(
            f"{what} time runs backward after sample {int(back[0])}",
            "alignment needs both streams in order on one clock",
        )


TACTICAL = replace(
    without(SIMULATED_GRADES["tactical"], "misalignment", "drift"),
    gyro_scale=1e-4,
    accel_scale=1e-4,
)
"""Sensors of a gliding vehicle."""


@dataclass(frozen=True)
class GateLimits:
    """Limits of the start (12) and the stop (13) of Qu et al., and of sensors that clip.

    Attributes
    ----------
    f_set, f_step_set : float
        Specific force, m/s^2, and its change per time, m/s^3.
    w_set, w_step_set : float
        Angular rate, rad/s, and its change per time, rad/s^2.
    t_set1, n_set1 : float, int
        Seconds after lift-off, and samples in a row, before the start.
    t_set2, n_set2 : float, int
        Seconds after the start, and calm samples in a row, before the stop.
    smooth : int
        Samples averaged before the tests; more than 1 for noisy or shaken sensors.
    """

    f_set: float = 12.0
    f_step_set: float = 100.0
    w_set: float = float(np.deg2rad(5.0))
    w_step_set: float = float(np.deg2rad(100.0))
    t_set1: float = 40.0
    n_set1: int = 1
    t_set2: float = 200.0
    n_set2: int = 200
    smooth: int = 1


@dataclass(frozen=True)
class AlignmentSettings:
    """How to align; the defaults suit a gliding vehicle with a tactical IMU.

    Attributes
    ----------
    method : {'svd', 'quest', 'davenport', 'triad'}
        Solver. ``triad`` uses two integrated vectors and ignores `vectors`.
    vectors : {'win', 'cen', 'int', 'diff', 'diffc', 'pos'}
        Pairs: differences of the integrated vectors over a sliding window, the integrated
        vectors less their mean, less their start, differentiated velocity (backward,
        central), or twice integrated (positions only).
    window_s : float
        Of ``win``.
    fade_s : float
        Time constant with which old pairs are forgotten; infinite for never.
    gate : {'paper', 'mask', 'off'}
        ``paper`` starts by eq. (12) and stops by eq. (13); ``mask`` starts at lift-off and
        leaves out pairs that span samples which are not calm, and is meant for ``win``, as
        pairs from the start soon span some and ``cen`` has no span; ``off`` uses all.
    start_ns, end_ns : int, optional
        Use only what lies between; a given start replaces eq. (12).
    max_gap_ns : float, optional
        Longest interval of the IMU that is no gap; three usual ones by default.
    t0_ns : int, optional
        Lift-off; by default the first time that specific force stays above 2 g for 0.1 s.
    sigma_stop : float, optional
        Stop as soon as the worst-axis sigma is below, rad, and the vehicle calm.
    gnss_sigma_v : float
        Velocity noise where the fixes give none, m/s per axis.
    gnss_sigma_p, gnss_drift_p, gnss_drift_s : float
        Position noise: white, m; slowly varying, m, and its correlation time, s. For ``pos``.
    gnss_latency_s : float
        A fix is valid this long before its stamp.
    lever_arm_b : tuple of float
        From the IMU to the antenna, FRD, m.
    kappa : float
        Factor on the variances of sensor errors; 1 for constant errors, 4 covers biases that
        wander during the run.
    refine : bool
        Refine the answer by a Kalman filter over the same vectors.
    around : bool
        Refine from headings all around, whatever the solver's heading is. It is meant for vehicles
        so slow that sensor errors hide their heading from a solver, and that of an antenna on an
        arm: the lever arm and the latency are then taken to be little known.
    refine_lever_sigma, refine_latency_sigma : float
        How well the lever arm, m, and the latency, s, are known to it.
    at : {'end', 'start'} or int
        When the answer is wanted: the last fix used, the start of the segment, or a time in
        ns inside it.
    gyro_limit, accel_limit : float, optional
        Ranges of the sensors, rad/s and m/s^2; samples that reach them break the chain.
    refuse_sigma : float
        About its worst axis, rad: an attitude that is less certain is not given.
    screen : bool
        Screen fixes for outliers first.
    series : bool
        Give the solution at every fix.
    sample_s : float
        By how much samples may be of another time, s, as likely as not: the sigmas of the answer
        then include how far the body turns meanwhile.
    lasting : bool
        Velocities whose errors last show heading less well than white noise of their size: its
        sigma then allows for it, as far as the innovations show it.
    """

    method: str = "svd"
    vectors: str = "win"
    window_s: float = 2.0
    fade_s: float = float("inf")
    gate: str = "paper"
    limits: GateLimits = field(default_factory=GateLimits)
    start_ns: int | None = None
    end_ns: int | None = None
    max_gap_ns: float | None = None
    t0_ns: int | None = None
    sigma_stop: float | None = None
    gnss_sigma_v: float = 0.1
    gnss_sigma_p: float = 1.0
    gnss_drift_p: float = 4.9
    gnss_drift_s: float = 60.0
    gnss_latency_s: float = 0.0
    lever_arm_b: tuple[float, float, float] = (0.0, 0.0, 0.0)
    grade: SensorGrade = TACTICAL
    kappa: float = 4.0
    refine: bool = False
    around: bool = False
    refine_lever_sigma: float = 0.0
    refine_latency_sigma: float = 0.05
    at: str | int = "end"
    gyro_limit: float | None = None
    accel_limit: float | None = None
    refuse_sigma: float = REFUSE_SIGMA
    screen: bool = True
    series: bool = True
    sample_s: float = 0.0
    lasting: bool = False


@dataclass(frozen=True)
class AlignmentSeries:
    """The solution at every fix of the segment, each from the data before it.

    For ``pos`` about every two seconds.

    Attributes
    ----------
    time_ns : ndarray of int64, shape (m,)
        When the fixes were valid.
    q_nb : ndarray, shape (m, 4)
    sigma : ndarray, shape (m, 3)
        Of rotations about north, east, down, rad; NaN before there are pairs.
    sigma_worst : ndarray, shape (m,)
        About the worst axis, rad.
    rho : ndarray, shape (m,)
        Geometry, 0 (one direction only) to 1.
    singular_values : ndarray, shape (m, 3)
    calm : ndarray of bool, shape (m,)
        All four limits of the gate hold.
    """

    time_ns: IntArray
    q_nb: FloatArray
    sigma: FloatArray
    sigma_worst: FloatArray
    rho: FloatArray
    singular_values: FloatArray
    calm: BoolArray


@dataclass(frozen=True)
class RefinedErrors:
    """Sensor errors that the refinement estimated beside attitude.

    Attributes
    ----------
    gyro_bias, accel_bias, gyro_scale, accel_scale, lever_arm_b : ndarray, shape (3,)
        rad/s, m/s^2, relative, relative, m: what the measurements have too much, and what
        the lever arm is more than given.
    latency_s : float
        In addition to the latency given.
    sigma : dict of str to ndarray or float
        One sigma of each, by the same names.
    inflated : int
        Fixes whose noise was inflated because they did not fit.
    chi2 : float
        Mean squared innovation by its covariance, over 3: about 1.
    """

    gyro_bias: FloatArray
    accel_bias: FloatArray
    gyro_scale: FloatArray
    accel_scale: FloatArray
    lever_arm_b: FloatArray
    latency_s: float
    sigma: dict[str, Any]
    inflated: int
    chi2: float
