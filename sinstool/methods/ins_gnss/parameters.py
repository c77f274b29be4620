"""Settings of an INS/GNSS filter as numbers for its compiled loop."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from sinstool.core.arrays import FloatArray
from sinstool.methods.ins_gnss import layout, states
from sinstool.methods.ins_gnss.constraints import LandVehicle
from sinstool.methods.ins_gnss.settings import Settings, Start

_ADAPTIVE = {"off": 0.0, "sage-husa": 1.0, "innovation": 2.0}
CHANNEL_GATE = 8.0  # m, of the vertical channel
TURN = np.pi / 2.0  # rad: after such a turn, errors of gyro axes have done what their sigma says


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
    variance[states.GNSS_POSITION : states.GNSS_POSITION + 3] = np.square(gnss.position_markov)
    variance[states.GNSS_VELOCITY : states.GNSS_VELOCITY + 3] = np.square(gnss.velocity_markov)
    if vehicle is not None:
        variance[states.LAND_VEHICLE : states.SIZE] = vehicle.variances()
    np.fill_diagonal(p, variance)
    return np.ascontiguousarray(p[np.ix_(kind.states, kind.states)])


def decay_rates(kind: states.FilterKind, settings: Settings) -> FloatArray:
    """One over the correlation times of the Markov states, 1/s; shape (n,)."""
    rate = np.zeros(states.SIZE)
    rate[states.BARO] = settings.baro.decay
    rate[states.GNSS_POSITION : states.GNSS_POSITION + 3] = 1.0 / settings.gnss.position_time
    rate[states.GNSS_VELOCITY : states.GNSS_VELOCITY + 3] = 1.0 / settings.gnss.velocity_time
    return rate[kind.states]


def noise_densities(kind: states.FilterKind, start: Start, settings: Settings) -> FloatArray:
    """Power densities of the process noise, virtual noise included; shape (n,).

    All are diagonal, as the noise of gyros and accelerometers is alike in each axis.
    """
    q = np.zeros(states.SIZE)
    imu, gnss, control = settings.imu, settings.gnss, settings.control
    gyro, accel = _bias_sigmas(start, settings)
    q[states.VELOCITY : states.VELOCITY + 3] = imu.velocity_random_walk**2
    q[states.ATTITUDE : states.ATTITUDE + 3] = imu.angle_random_walk**2
    q[states.CORRECTION] = settings.correction_walk**2
    q[states.BARO] = 2.0 * settings.baro.decay * settings.baro.sigma**2
    q[states.GYRO_BIAS : states.GYRO_BIAS + 3] = 2.0 * imu.gyro_instability**2 / imu.bias_time_s
    q[states.ACCEL_BIAS : states.ACCEL_BIAS + 3] = 2.0 * imu.accel_instability**2 / imu.bias_time_s
    # Scale factors wander as the accelerometers' biases do: the temperature moves both
    share = min(1.0, imu.accel_instability / imu.accel_bias) if imu.accel_bias > 0.0 else 0.0
    for block, scale in (
        (states.ACCEL_SCALE, imu.accel_scale),
        (states.GYRO_SCALE, imu.gyro_scale),
    ):
        q[block : block + 3] = 2.0 * (share * scale) ** 2 / imu.bias_time_s
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


def loop_parameters(kind: states.FilterKind, settings: Settings) -> FloatArray:
    """Numbers by the names ``P_...`` of :mod:`~sinstool.methods.ins_gnss.layout`."""
    p = np.zeros(layout.PARAMETERS)
    control, gnss = settings.control, settings.gnss
    p[layout.P_SUBSTEP] = settings.substep
    if kind.network:
        p[layout.P_SUBSTEP] = min(settings.substep, settings.damping.tau / 8.0)
        p[layout.P_K4] = settings.damping.k4
    p[layout.P_CLOSED] = float(settings.feedback == "closed")
    p[layout.P_NETWORK] = float(kind.network)
    p[layout.P_CORRECTION_ROW] = float(kind.correction_row)
    p[layout.P_BARO_ROW] = float(kind.baro_row or (kind.network and settings.baro_row))
    p[layout.P_ROW_INTERVAL] = settings.row_interval
    p[layout.P_LEVER : layout.P_LEVER + 3] = settings.lever_arm_b
    p[layout.P_BARO_DECAY] = settings.baro.decay
    p[layout.P_BARO_WHITE] = settings.baro.white**2
    p[layout.P_BARO_SIGMA] = settings.baro.sigma
    p[layout.P_CORRECTION_VARIANCE] = settings.correction_sigma**2
    p[layout.P_ADAPTIVE] = _ADAPTIVE[control.adaptive]
    p[layout.P_FADING] = control.fading
    p[layout.P_LEAST], p[layout.P_MOST] = control.least, control.most
    p[layout.P_EPSILON] = control.schmidt_epsilon
    p[layout.P_RESTART_AFTER] = control.restart_after
    p[layout.P_ESCALATE] = float(control.escalate)
    p[layout.P_MAX_GAP] = settings.max_gap
    p[layout.P_GAP_ACCELERATION] = settings.gap_acceleration
    p[layout.P_GAP_RATE] = settings.gap_rate
    p[layout.P_BARO_GATE] = settings.baro_gate
    # Scale factors without states of their own are taken for errors of the axes
    own = settings.imu.gyro_scale if kind.first(states.GYRO_SCALE) < 0 else 0.0
    p[layout.P_TURN] = (own**2 + settings.imu.gyro_misalignment**2) * TURN
    white = np.square([*gnss.position_white, *gnss.velocity_white])
    slow = np.square([*gnss.position_markov, *gnss.velocity_markov])
    p[layout.P_GNSS_WHITE : layout.P_GNSS_WHITE + 6] = white
    p[layout.P_GNSS_MARKOV : layout.P_GNSS_MARKOV + 6] = slow
    p[layout.P_GNSS_ALL : layout.P_GNSS_ALL + 6] = white + slow
    p[layout.P_CHANNEL_GATE] = CHANNEL_GATE
    p[layout.P_GATES] = np.inf
    p[layout.P_GATES + 1 : layout.P_GATES + 7] = chdtri(
        np.arange(1, 7), 1.0 - control.gate_probability
    )
    return p
