"""The initial attitude of a run, and the gyro bias that is removed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sinstool.core.errors import AlignmentError
from sinstool.core.rotation import conjugate, exp, from_euler, multiply, rotate
from sinstool.core.units import STANDARD_GRAVITY
from sinstool.methods.alignment.still import StillSpan, Windows

ROUGH_S = 1.0
NOT_STILL = "the log does not begin at rest"
# m/s^2: less is no gravity.
LEAST_GRAVITY = 0.1 * STANDARD_GRAVITY
# A tilt less certain than this is not good, rad; one of which nothing is known has the other.
GOOD_TILT = np.deg2rad(5.0)
UNIFORM = np.pi / np.sqrt(3.0)


@dataclass(frozen=True)
class Alignment:
    """A first attitude.

    Attributes
    ----------
    q_nb : ndarray, shape (4,)
    method : str
        ``level``, ``log``, ``fixed``, ``level-moving``, ``gyrocompass``, or a solver in motion.
    time_ns : int
        When it holds.
    sigma_rad : tuple of float or None
        Of roll, pitch, heading; None where nothing is known.
    status : {'ok', 'degraded', 'level-only'}
    north_referenced : bool
        Heading counts from north.
    gyro_bias : ndarray, shape (3,)
        To subtract from the rates, rad/s, body axes.
    gyro_bias_sigma : float or None
        rad/s an axis, where the alignment itself gives the bias.
    bias_searched : bool
        The bias was found by trying, as the alignment was no good without it.
    bias_source : str
        ``still`` (the lead-in), ``rest`` (another), ``alignment``, ``given`` or ``none``.
    covariance_n : ndarray or None, shape (3, 3)
        Of a small rotation in NED, rad^2, where more is known than sigmas.
    held_ns : int or None
        When the attitude was found, if it was carried to ``time_ns`` from there.
    """

    q_nb: np.ndarray
    method: str
    time_ns: int
    sigma_rad: tuple[float | None, float | None, float | None]
    status: str
    north_referenced: bool
    gyro_bias: np.ndarray = field(default_factory=lambda: np.zeros(3))
    bias_source: str = "none"
    warnings: tuple[str, ...] = ()
    covariance_n: np.ndarray | None = None
    held_ns: int | None = None
    gyro_bias_sigma: float | None = None
    bias_searched: bool = False


def level(specific_force_b: np.ndarray) -> np.ndarray:
    """Attitude of a body at rest from its specific force, with heading 0.

    At rest ``f_b = -C_bn g_n``, so the measured specific force points up.

    Parameters
    ----------
    specific_force_b : ndarray, shape (3,)
        Mean specific force in body axes (FRD), m/s^2; its size does not matter.

    Returns
    -------
    ndarray, shape (4,)
        q_nb.

    Raises
    ------
    ValueError
        The specific force is zero.

    References
    ----------
    Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems,
    2nd ed., eqs (5.100)-(5.101).
    """
    f = np.asarray(specific_force_b, dtype=np.float64)
    if f.shape != (3,):
        raise ValueError(f"specific_force_b must have shape (3,), got {f.shape}")
    if not np.linalg.norm(f) > 0.0:
        raise ValueError("specific force is zero: it has no direction")
    roll = np.arctan2(-f[1], -f[2])
    pitch = np.arctan2(f[0], np.hypot(f[1], f[2]))
    return from_euler([roll, pitch, 0.0])


def tilted(
    q_nb: np.ndarray, covariance: np.ndarray, specific_force_b: np.ndarray, accel_bias: float
) -> tuple[np.ndarray, np.ndarray]:
    """Improve an attitude at rest, from another source, by the specific force.

    Parameters
    ----------
    q_nb : ndarray, shape (4,)
    covariance : ndarray, shape (3, 3)
        Of psi in NED, rad^2: `q_nb` is ``(I + [psi x])`` times the true one.
    specific_force_b : ndarray, shape (3,)
        Mean at rest, body axes (FRD), m/s^2.
    accel_bias : float
        Its uncertainty about each axis, m/s^2.

    Returns
    -------
    q_nb : ndarray, shape (4,)
    covariance : ndarray, shape (3, 3)
        After one update with both horizontal components: at rest these are zero, and
        ``f_N = g psi_E`` up to sign where an attitude is wrong.
    """
    measured, noise = _off_gravity(q_nb, specific_force_b, accel_bias)
    h = np.eye(2, 3)
    gain = covariance @ h.T @ np.linalg.inv(h @ covariance @ h.T + noise**2 * np.eye(2))
    keep = np.eye(3) - gain @ h
    better = keep @ covariance @ keep.T + noise**2 * gain @ gain.T
    return multiply(exp(-(gain @ measured)), q_nb), better


def off_level(
    q_nb: np.ndarray, covariance: np.ndarray, specific_force_b: np.ndarray, accel_bias: float
) -> float:
    """By how many sigmas an attitude denies that a mean specific force is gravity alone.

    Parameters
    ----------
    q_nb, covariance, specific_force_b, accel_bias
        See :func:`tilted`.

    Returns
    -------
    float
        Of both horizontal components together: the root of what has a chi-square distribution of
        two degrees of freedom if the vehicle rests.
    """
    measured, noise = _off_gravity(q_nb, specific_force_b, accel_bias)
    expected = covariance[:2, :2] + noise**2 * np.eye(2)
    return float(np.sqrt(measured @ np.linalg.solve(expected, measured)))


def _off_gravity(
    q_nb: np.ndarray, specific_force_b: np.ndarray, accel_bias: float
) -> tuple[np.ndarray, float]:
    """psi_N and psi_E by a specific force at rest, shape (2,), and their sigma, rad."""
    size = float(np.linalg.norm(specific_force_b))
    seen = rotate(q_nb, specific_force_b) / size
    # -e_d turned by psi: (-psi_E, psi_N, -1).
    return np.array([seen[1], -seen[0]]), accel_bias / size


def shown_tilt_error(span: StillSpan) -> float:
    """What a still span shows of the errors of its tilt, rad.

    The larger of the accelerometer's noise over the span and what it disagrees with gravity.
    """
    noise = span.accel_std / np.sqrt(span.samples)
    excess = abs(float(np.linalg.norm(span.accel)) - STANDARD_GRAVITY)
    return float(max(noise, excess) / STANDARD_GRAVITY)


def from_still(span: StillSpan, time_ns: int, accel_bias: float = 0.0) -> Alignment:
    """Tilt from a still span, heading 0.

    Its sigma is that of the accelerometer's bias across gravity, or what the span shows of errors
    if that is more, but no more than if nothing were known. Along gravity a bias shows, across it
    does not: agreement with gravity proves no tilt.

    Parameters
    ----------
    accel_bias : float
        Sigma of the bias of one axis, m/s^2.

    Raises
    ------
    AlignmentError
        The specific force holds no gravity.
    """
    size = float(np.linalg.norm(span.accel))
    if not size > LEAST_GRAVITY:
        raise AlignmentError(
            "the specific force at rest contains no gravity",
            "give the first attitude with --align log or --align fixed",
        )
    shown = shown_tilt_error(span)
    status = "ok"
    warnings: tuple[str, ...] = ()
    if shown > GOOD_TILT:
        status = "degraded"
        warnings = (
            f"the specific force at rest is {size:.3g} m/s^2, not {STANDARD_GRAVITY:.2f}: do not"
            " trust the tilt; check --accel-unit and --gyro-kind",
        )
    sigma = min(max(shown, accel_bias / STANDARD_GRAVITY), UNIFORM)
    return Alignment(
        level(span.accel), "level", time_ns, (sigma, sigma, None), status, False, warnings=warnings
    )


def from_motion(windows: Windows, time_ns: int) -> Alignment:
    """Tilt from the mean specific force of the first second of a log that does not begin still."""
    first = windows.start_ns < windows.start_ns[0] + int(ROUGH_S * 1e9)
    count = windows.count[first].astype(float)
    accel = count @ windows.accel[first] / count.sum()
    if not np.linalg.norm(accel) > LEAST_GRAVITY:
        raise AlignmentError(
            f"{NOT_STILL} and its specific force contains no gravity",
            "give the first attitude with --align log or --align fixed",
        )
    return Alignment(
        level(accel),
        "level-moving",
        time_ns,
        (None, None, None),
        "degraded",
        False,
        warnings=(
            f"{NOT_STILL}: tilt is from the mean specific force of its first second, and is off by"
            " about 6 deg for each m/s^2 by which the vehicle speeds up or turns meanwhile",
        ),
    )


def from_log(q_nb: np.ndarray, time_ns: int) -> Alignment:
    """The orientation that the IMU topic itself gives."""
    return Alignment(q_nb, "log", time_ns, (None, None, None), "ok", True)


def from_angles(roll_pitch_heading: tuple[float, float, float], time_ns: int) -> Alignment:
    """An attitude from the user's angles, in radians."""
    q = from_euler(np.asarray(roll_pitch_heading))
    return Alignment(q, "fixed", time_ns, (None, None, None), "ok", True)


def still_bias(span: StillSpan, q_nb: np.ndarray, omega_ie_n: np.ndarray | None) -> np.ndarray:
    """Gyro bias of a span at rest: its mean rate less the Earth's, where the latitude is known.

    Parameters
    ----------
    q_nb : ndarray, shape (4,)
        Attitude during the span.
    omega_ie_n : ndarray, shape (3,), optional
        Earth rate in NED, rad/s.

    Returns
    -------
    ndarray, shape (3,)
        rad/s in body axes. Without a latitude the Earth's rate is part of it.
    """
    if omega_ie_n is None:
        return span.gyro.copy()
    return span.gyro - rotate(conjugate(q_nb), omega_ie_n)
