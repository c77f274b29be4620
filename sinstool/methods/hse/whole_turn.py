"""Heading, tilt and axial rate error from sums over whole turns.

Gravity gives the vertical in ``b0``, and the mean rate less that of the table gives north; for a
base at rest and white noise of the gyros this is the maximum-likelihood estimate. The rate error
along the axis stays along the axis in ``b0``, and the tilt of the axis gives it an east component:
that is the heading-sensitive error of :mod:`sinstool.methods.hse`, which must stay in the heading
here to be measured. (Estimators that let the base turn freely, or that carry a bias along z,
distort or remove it.)

The same error also shows directly: gyros and encoder disagree about the rate along the axis by
the fraction ``c = X33``, and ``lambda2 = -3 c``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core import rotation
from sinstool.core.arrays import ArrayLike, FloatArray
from sinstool.core.earth import EARTH_RATE, earth_rate_n, normal_gravity
from sinstool.core.errors import AlignmentError, ConfigurationError
from sinstool.core.result import fields_in
from sinstool.methods.hse.rig import Rig
from sinstool.methods.hse.run import MAX_LATITUDE, HseRun
from sinstool.methods.hse.segments import TurnStatistics
from sinstool.methods.hse.turn_noise import FEWEST_TURNS_FOR_SCATTER, sigma_of_mean

SIGNIFICANT_TILT_DRIFT = 3.0
"""Sigmas of the tilt's drift beyond which ``level_rate='auto'`` removes it."""

LEVEL_RATES = ("off", "auto", "on")
# Gyros and encoder that differ by more than this disagree about sign, unit or axis.
_LARGEST_AXIAL_ERROR = 0.05


@dataclass(frozen=True, eq=False)
class WholeTurnAlignment:
    """Attitude of the base, with statistics of the turns.

    Attributes
    ----------
    C_nb0 : ndarray, shape (3, 3)
        Attitude of the base, as a mean over the turns; rows are north, east and down in ``b0``.
    rate : float
        Omega, mean rate of the table, rad/s.
    latitude : float
        rad.
    c_axial : float
        Relative rate error along the axis, X33.
    sigma_c_axial : float
        From the scatter of the turns and ``gyro_bias_sigma``; NaN without either.
    sigma_heading : float
        From the scatter of the turns, rad; NaN with fewer than four.
    sigma_C23 : float
        Of :attr:`C23`, likewise.
    per_turn_heading : ndarray, shape (N,)
        Heading of each turn by itself on the common vertical, rad, near :attr:`heading`.
    quality : dict of str to float
        See :func:`align_whole_turns`.
    """

    C_nb0: FloatArray
    rate: float
    latitude: float
    c_axial: float
    sigma_c_axial: float
    sigma_heading: float
    sigma_C23: float
    per_turn_heading: FloatArray
    quality: dict[str, float]

    @property
    def heading(self) -> float:
        """Heading psi of the base, rad, in [0, 2 pi)."""
        return float(np.arctan2(self.C_nb0[1, 0], self.C_nb0[0, 0]) % (2.0 * np.pi))

    @property
    def theta(self) -> float:
        """Pitch of the base, rad."""
        return float(-np.arcsin(np.clip(self.C_nb0[2, 0], -1.0, 1.0)))

    @property
    def gamma(self) -> float:
        """Roll of the base, rad."""
        return float(np.arctan2(self.C_nb0[2, 1], self.C_nb0[2, 2]))

    @property
    def C23(self) -> float:
        """East component of the axis of rotation."""
        return float(self.C_nb0[1, 2])

    def q_nb(self, alpha: ArrayLike, heading_correction: float = 0.0) -> FloatArray:
        """Attitude of the turning body, ``C_nb = C_nb0 Rz(alpha)``.

        Parameters
        ----------
        alpha : array_like, shape (...)
            Angle of the table, rad.
        heading_correction : float
            Heading error to be subtracted, rad.

        Returns
        -------
        ndarray, shape (..., 4)
        """
        half = 0.5 * np.asarray(alpha, dtype=np.float64)
        turned = np.zeros((*half.shape, 4))
        turned[..., 0], turned[..., 3] = np.cos(half), np.sin(half)
        corrected = rotation.multiply(
            rotation.exp([0.0, 0.0, -heading_correction]), rotation.from_dcm(self.C_nb0)
        )
        return rotation.multiply(corrected, turned)


def align_whole_turns(
    turns: TurnStatistics, rig: Rig, level_rate: str = "off", gyro_bias_sigma: float = 0.0
) -> WholeTurnAlignment:
    """Align on whole turns.

    Parameters
    ----------
    rig : Rig
        With latitude.
    level_rate : {'off', 'auto', 'on'}
        Whether to remove the rate at which the base tilts, as measured by the accelerometers.
        This adds noise to the east rate, ``sqrt(12) VRW / (g T**1.5)`` with the velocity random
        walk VRW in (m/s)/sqrt(s), so ``'auto'`` does it only where the tilt drifts by more than
        three sigmas.
    gyro_bias_sigma : float
        Standard deviation of each gyro's bias, rad/s. It becomes part of the sigma of ``c_axial``,
        as the scatter of turns does not show it.

    Returns
    -------
    WholeTurnAlignment
        In its ``quality``: ``rate_north_residual``, ``rate_down_residual`` (rad/s; the latter
        holds the axial error), ``force_residual`` (m/s^2, against normal gravity at height 0),
        ``heading_trend_t`` (Student's t of a line through the headings of the turns),
        ``lag1_correlation`` of these headings, ``tilt_drift_north``, ``tilt_drift_east`` (rad
        over the turns, of the axis) with ``tilt_drift_sigma``, ``axial_drift`` and
        ``axial_drift_sigma`` (rad/s^2, slope of the rate along the axis over the turns),
        ``level_rate_used`` (0 or 1), ``stamp_jitter_s``, ``stamp_wander_s``. NaN where there are
        too few turns.

    Raises
    ------
    ConfigurationError
        If the latitude is missing, or gyros and encoder disagree about direction or size of
        the rate; says what to set.
    AlignmentError
        If there is no turn, no force, or the latitude is beyond 85 degrees.
    """
    latitude = rig.require_latitude()
    _check(turns, latitude, level_rate)
    duration = turns.duration[:, np.newaxis]
    total = float(turns.duration.sum())
    omega = _in_b0(turns, turns.S[:, :, :3], rig.gyro_to_b, rig.gyro_bias)
    force = _in_b0(turns, turns.S[:, :, 3:], rig.accel_to_b, rig.accel_bias)
    _check_axial(float(omega[:, 2].sum()) / total, turns.rate)
    table = np.zeros((len(turns), 3))
    table[:, 2] = turns.direction * 2.0 * np.pi
    w_turn = (omega - table) / duration
    f_turn = force / duration
    w = (omega - table).sum(axis=0) / total
    f = force.sum(axis=0) / total
    size = float(np.linalg.norm(f))
    middles = np.cumsum(turns.duration) - turns.duration / 2.0
    tilting, tilting_sigma = _tilting(f, f_turn, middles)
    significant = np.linalg.norm(tilting) > SIGNIFICANT_TILT_DRIFT * tilting_sigma
    used = level_rate == "on" or (level_rate == "auto" and bool(significant))
    if used and np.isfinite(tilting).all():
        w = w - tilting
        w_turn = w_turn - tilting
    else:
        used = False

    C_nb0 = _attitude(f, w)
    r1, r2, r3 = C_nb0

    north_rate = EARTH_RATE * np.cos(latitude)
    earth = earth_rate_n(latitude)
    u_z = float(C_nb0[:, 2] @ earth)
    c_axial = float((w[2] - u_z) / (turns.rate + u_z))
    east_rate = w_turn @ r2
    axial_drift, axial_drift_sigma = slope_of_columns(middles, w_turn[:, 2:])
    heading = float(np.arctan2(C_nb0[1, 0], C_nb0[0, 0]) % (2.0 * np.pi))
    per_turn = heading - east_rate / north_rate
    sigma_heading = sigma_of_mean(east_rate) / north_rate
    sigma_c = np.array([sigma_of_mean(w_turn[:, 2]), gyro_bias_sigma]) / abs(turns.rate + u_z)
    white = float(sigma_c[0])
    sigma_c_axial = float(np.hypot(*sigma_c)) if np.isfinite(white) else _or_nan(sigma_c[1])
    level = _scatter(f_turn @ r2) / size
    sigma_C23 = float(np.hypot(level, C_nb0[0, 2] * sigma_heading))
    in_n = C_nb0 @ tilting
    quality = {
        "rate_north_residual": float(r1 @ w - earth[0]),
        "rate_down_residual": float(r3 @ w - earth[2]),
        "force_residual": size - float(normal_gravity(latitude)),
        "heading_trend_t": slope_t(middles, per_turn),
        "lag1_correlation": _lag1(per_turn),
        # the axis leans to where a turn of the base about East (North) takes it
        "tilt_drift_north": float(in_n[1]) * total,
        "tilt_drift_east": -float(in_n[0]) * total,
        "tilt_drift_sigma": tilting_sigma * total,
        "axial_drift": float(axial_drift[0]),
        "axial_drift_sigma": float(axial_drift_sigma[0]),
        "level_rate_used": float(used),
        "stamp_jitter_s": turns.jitter_s,
        "stamp_wander_s": turns.wander_s,
    }
    return WholeTurnAlignment(
        C_nb0=C_nb0,
        rate=turns.rate,
        latitude=latitude,
        c_axial=c_axial,
        sigma_c_axial=sigma_c_axial,
        sigma_heading=sigma_heading,
        sigma_C23=sigma_C23,
        per_turn_heading=per_turn,
        quality=quality,
    )


def run_from_turns(
    turns: TurnStatistics,
    rig: Rig,
    *,
    id: str,
    source: str,
    log_start_ns: int | None = None,
    level_rate: str = "off",
    gyro_bias_sigma: float = 0.0,
) -> HseRun:
    """One alignment as a run for the calibration.

    Parameters
    ----------
    turns, rig, level_rate, gyro_bias_sigma
        See :func:`align_whole_turns`.
    id : str
        Unique in a calibration.
    source : str
        The log.
    log_start_ns : int, optional
        Stamp at the start of the log.
    """
    a = align_whole_turns(turns, rig, level_rate, gyro_bias_sigma)
    return HseRun(
        **fields_in(a, HseRun),
        id=id,
        source=source,
        t_start_s=turns.start_s,
        duration_s=float(turns.duration.sum()),
        n_turns=len(turns),
        log_start_ns=log_start_ns,
    )


def _check(turns: TurnStatistics, latitude: float, level_rate: str) -> None:
    if level_rate not in LEVEL_RATES:
        raise ConfigurationError(
            f"level-rate correction is {level_rate!r}", f"give one of {', '.join(LEVEL_RATES)}"
        )
    if abs(latitude) > MAX_LATITUDE:
        raise AlignmentError(
            f"at latitude {np.degrees(latitude):.2f} degrees the Earth rate is nearly vertical",
            "heading can be found below 85 degrees only",
        )
    if not len(turns):
        raise AlignmentError("no whole turn of the table", "record for longer")


def _tilting(f: FloatArray, f_turn: FloatArray, middles: FloatArray) -> tuple[FloatArray, float]:
    """Rate at which the base tilts, rad/s in ``b0``, by the drift of its force, and its sigma."""
    size = float(np.linalg.norm(f))
    if not size > 0.0:
        raise AlignmentError(
            "the mean specific force is zero, so the vertical is unknown",
            "check the accelerometers",
        )
    drift, drift_sigma = slope_of_columns(middles, f_turn)
    sigma = float(np.linalg.norm(drift_sigma)) / size / np.sqrt(3.0)
    return np.cross(f, drift) / -(size**2), sigma


def _attitude(f: FloatArray, w: FloatArray) -> FloatArray:
    """North, east and down in ``b0`` as rows, by mean specific force and mean rate."""
    r3 = -f / float(np.linalg.norm(f))
    east = np.cross(r3, w)
    if not np.linalg.norm(east) > 0.0:
        raise AlignmentError(
            "the mean rate has no horizontal part, so north is unknown", "check the gyros"
        )
    r2 = east / np.linalg.norm(east)
    C_nb0 = np.stack([np.cross(r2, r3), r2, r3])
    C_nb0.flags.writeable = False
    return C_nb0


def _in_b0(
    turns: TurnStatistics, sums: FloatArray, to_b: FloatArray, bias: FloatArray
) -> FloatArray:
    """Integrals over the turns of a vector in ``b0``; shape (N, 3)."""
    weights = np.concatenate([turns.circle, turns.duration[:, np.newaxis]], axis=1)
    in_b = (sums - weights[:, :, np.newaxis] * bias) @ to_b.T
    # Samples and weights are means over intervals in which b turns, each of which attenuates a
    # vector that is fixed in b0 by the mean of the cosine
    half = 0.5 * turns.rate * turns.interval_s
    cos, sin = np.moveaxis(in_b[:, :2], 1, 0) * (half / np.sin(half)) ** 2
    return np.stack([cos[:, 0] - sin[:, 1], sin[:, 0] + cos[:, 1], in_b[:, 2, 2]], axis=1)


def _check_axial(gyro: float, encoder: float) -> None:
    both = (
        f"the gyros turn at {np.degrees(gyro):+.3f} deg/s about the axis, "
        f"the encoder at {np.degrees(encoder):+.3f} deg/s"
    )
    if not np.isfinite(gyro) or abs(gyro / encoder - 1.0) > _LARGEST_AXIAL_ERROR:
        if abs(gyro / encoder + 1.0) < _LARGEST_AXIAL_ERROR:
            raise ConfigurationError(
                both,
                "change the sign of rig.encoder.sign, or reverse rig.e (rig.C_s_to_b) if its z axis"
                " does not point down",
            )
        raise ConfigurationError(
            both,
            "check the unit of the gyros, rig.encoder.unit, rig.gyro_frame and rig.C_s_to_b, and"
            " that the joint is the table's",
        )


def _or_nan(value: float) -> float:
    return float(value) if value > 0.0 else float("nan")


def _scatter(values: FloatArray) -> float:
    """Sigma of the mean; NaN if there are too few values to tell."""
    if len(values) < FEWEST_TURNS_FOR_SCATTER:
        return float("nan")
    return float(values.std(ddof=1) / np.sqrt(len(values)))


def slope_of_columns(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Slope of a line through columns of y (n, k), and its sigma; NaN for fewer than four."""
    if len(x) < FEWEST_TURNS_FOR_SCATTER:
        return np.full(y.shape[1], np.nan), np.full(y.shape[1], np.nan)
    u = x - x.mean()
    slope = u @ y / (u @ u)
    rest = y - y.mean(axis=0) - np.outer(u, slope)
    return slope, np.sqrt((rest**2).sum(axis=0) / (len(x) - 2) / (u @ u))


def slope_t(x: FloatArray, y: FloatArray) -> float:
    """Student's t of a slope."""
    slope, sigma = slope_of_columns(x, y[:, np.newaxis])
    return float(slope[0] / sigma[0]) if sigma[0] > 0.0 else float("nan")


def _lag1(values: FloatArray) -> float:
    """Correlation of each value with the next."""
    if len(values) < FEWEST_TURNS_FOR_SCATTER:
        return float("nan")
    d = values - values.mean()
    power = float(d @ d)
    return float(d[1:] @ d[:-1]) / power if power > 0.0 else float("nan")
