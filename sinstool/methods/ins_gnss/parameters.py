"""Settings of an INS/GNSS filter as numbers for its compiled loop."""

from __future__ import annotations

from typing import Any

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.chi_square import upper_point
from sinstool.methods.ins_gnss import states
from sinstool.methods.ins_gnss.constraints import LandVehicle
from sinstool.methods.ins_gnss.settings import TURN, Settings, Start
from sinstool.methods.sensor_errors import SensorGrade

_ADAPTIVE = {"off": 0.0, "sage-husa": 1.0, "innovation": 2.0}
CHANNEL_GATE = 8.0  # m, of the vertical channel


def initial_covariance(
    kind: states.FilterKind, start: Start, settings: Settings, vehicle: LandVehicle | None = None
) -> FloatArray:
    """Covariance at the start.

    Returns
    -------
    ndarray, shape (n, n)
    """
    p = np.zeros((states.SIZE, states.SIZE))
    gyro, accel = _bias_sigmas(start, settings)
    gnss = settings.gnss
    for first, block in (
        (states.POSITION, start.covariance_position_n),
        (states.VELOCITY, start.covariance_velocity_n),
        (states.ATTITUDE, start.covariance_attitude_n),
    ):
        p[first : first + 3, first : first + 3] = block
    variance = np.diagonal(p).copy()
    variance[states.CORRECTION] = settings.correction_sigma**2
    variance[states.BARO] = settings.baro.sigma**2
    variance[states.GYRO_BIAS : states.GYRO_BIAS + 3] = gyro**2
    variance[states.ACCEL_SCALE : states.ACCEL_SCALE + 3] = settings.imu.accel_scale**2
    variance[states.ACCEL_BIAS : states.ACCEL_BIAS + 3] = accel**2
    variance[states.GYRO_SCALE : states.GYRO_SCALE + 3] = settings.imu.gyro_scale**2
    variance[states.GYRO_AXES : states.GYRO_AXES + 6] = settings.imu.gyro_misalignment**2
    variance[states.ACCEL_AXES : states.ACCEL_AXES + 6] = settings.imu.accel_misalignment**2
    variance[states.GNSS_POSITION : states.GNSS_POSITION + 3] = np.square(gnss.position_markov)
    variance[states.GNSS_VELOCITY : states.GNSS_VELOCITY + 3] = np.square(gnss.velocity_markov)
    if vehicle is not None:
        variance[states.LAND_VEHICLE : states.SIZE] = vehicle.variances()
    np.fill_diagonal(p, variance)
    if start.by_fixes:
        _share_slow_errors(p, states.POSITION, states.GNSS_POSITION)
        _share_slow_errors(p, states.VELOCITY, states.GNSS_VELOCITY)
    return np.ascontiguousarray(p[np.ix_(kind.states, kind.states)])


def _share_slow_errors(p: FloatArray, navigation: int, gnss: int) -> None:
    """Covariance of a navigation that fixes gave with their slow errors, which it holds.

    Taken for independent of them, the first fix would be one more measurement, with an error of its
    own: where slow errors are the larger part, a sigma 1.4 times too small for minutes.
    """
    own, slow = (np.arange(first, first + 3) for first in (navigation, gnss))
    block, variance = p[np.ix_(own, own)], p[slow, slow]
    if not np.all(variance > 0.0):
        return
    shared = np.minimum(np.diagonal(block), variance)
    # No more than leaves a covariance
    scale = np.sqrt(variance) / shared
    left = float(np.linalg.eigvalsh(block * np.outer(scale, scale))[0])
    shared *= np.sqrt(min(left, 1.0))
    p[own, slow] = p[slow, own] = shared


def decay_rates(kind: states.FilterKind, settings: Settings) -> FloatArray:
    """One over the correlation times of the Markov states, 1/s; shape (n,)."""
    rate = np.zeros(states.SIZE)
    rate[states.BARO] = settings.baro.decay
    rate[states.GNSS_POSITION : states.GNSS_POSITION + 3] = 1.0 / settings.gnss.position_time
    rate[states.GNSS_VELOCITY : states.GNSS_VELOCITY + 3] = 1.0 / settings.gnss.velocity_time
    return rate[kind.states]


def sensor_densities(imu: SensorGrade) -> dict[int, float]:
    """Power densities of what sensors drive, by the first state of each block of three."""
    wander = 2.0 / imu.bias_time_s
    return {
        states.VELOCITY: imu.velocity_random_walk**2,
        states.ATTITUDE: imu.angle_random_walk**2,
        states.GYRO_BIAS: wander * imu.gyro_instability**2,
        states.ACCEL_BIAS: wander * imu.accel_instability**2,
        states.ACCEL_SCALE: wander * (imu.scale_wander * imu.accel_scale) ** 2,
        states.GYRO_SCALE: wander * (imu.scale_wander * imu.gyro_scale) ** 2,
    }


def noise_densities(kind: states.FilterKind, start: Start, settings: Settings) -> FloatArray:
    """Power densities of the process noise, virtual noise included; shape (n,).

    All are diagonal, as the noise of gyros and accelerometers is alike in each axis.
    """
    q = np.zeros(states.SIZE)
    imu, gnss, control = settings.imu, settings.gnss, settings.control
    gyro, accel = _bias_sigmas(start, settings)
    for block, density in sensor_densities(imu).items():
        q[block : block + 3] = density
    q[states.CORRECTION] = settings.correction_walk**2
    q[states.BARO] = 2.0 * settings.baro.decay * settings.baro.sigma**2
    q[states.GNSS_POSITION : states.GNSS_POSITION + 3] = (
        2.0 * np.square(gnss.position_markov) / gnss.position_time
    )
    q[states.GNSS_VELOCITY : states.GNSS_VELOCITY + 3] = (
        2.0 * np.square(gnss.velocity_markov) / gnss.velocity_time
    )
    if control.virtual_noise:
        q[states.POSITION : states.POSITION + 3] += control.virtual_position**2
        q[states.VELOCITY : states.VELOCITY + 3] += control.virtual_velocity**2
        q[states.ATTITUDE : states.ATTITUDE + 3] += control.virtual_attitude**2
        q[states.GYRO_BIAS : states.GYRO_BIAS + 3] += gyro**2 / control.virtual_bias_time
        q[states.ACCEL_BIAS : states.ACCEL_BIAS + 3] += accel**2 / control.virtual_bias_time
    return q[kind.states]


def _bias_sigmas(start: Start, settings: Settings) -> tuple[float, float]:
    imu = settings.imu
    gyro = imu.gyro_bias if start.gyro_bias_sigma is None else start.gyro_bias_sigma
    accel = imu.accel_bias if start.accel_bias_sigma is None else start.accel_bias_sigma
    # A bias known at the start still wanders.
    return float(np.hypot(gyro, imu.gyro_instability)), float(
        np.hypot(accel, imu.accel_instability)
    )


def loop_parameters(kind: states.FilterKind, settings: Settings) -> dict[str, Any]:
    """Fields of :data:`sinstool.methods.ins_gnss.layout.MODEL` by their names."""
    control, gnss = settings.control, settings.gnss
    # Errors of gyros that have no states of their own are what a turn makes uncertain
    own = settings.imu.gyro_scale if kind.first(states.GYRO_SCALE) < 0 else 0.0
    across = settings.imu.gyro_misalignment if kind.first(states.GYRO_AXES) < 0 else 0.0
    white = np.square([*gnss.position_white, *gnss.velocity_white])
    slow = np.square([*gnss.position_markov, *gnss.velocity_markov])
    tau = settings.damping.tau
    return {
        "substep": min(settings.substep, tau / 8.0) if kind.network else settings.substep,
        "k4": settings.damping.k4 if kind.network else 0.0,
        "closed": settings.feedback == "closed",
        "has_network": kind.network,
        "correction_row": kind.correction_row,
        "baro_row": kind.baro_row or (kind.network and settings.baro_row),
        "row_interval": settings.row_interval,
        "lever": settings.lever_arm_b,
        "baro_decay": settings.baro.decay,
        "baro_white": settings.baro.white**2,
        "baro_sigma": settings.baro.sigma,
        "correction_variance": settings.correction_sigma**2,
        "adaptive": _ADAPTIVE[control.adaptive],
        "fading": control.fading,
        "least": control.least,
        "most": control.most,
        "epsilon": control.schmidt_epsilon,
        "restart_after": control.restart_after,
        "escalate": control.escalate,
        "max_gap": settings.max_gap,
        "gap_acceleration": settings.gap_acceleration,
        "gap_tilt_rate": settings.gap_tilt_rate,
        "gap_rate": settings.gap_rate,
        "baro_gate": settings.baro_gate,
        "measured": control.measured_epochs > 0,
        "turn_variance": own**2 * TURN,
        "across_variance": across**2 * TURN,
        "gnss_white": white,
        "gnss_markov": slow,
        "gnss_all": white + slow,
        "channel_gate": CHANNEL_GATE,
        "gates": [
            np.inf,
            *(upper_point(rows, 1.0 - control.gate_probability) for rows in range(1, 7)),
        ],
    }
