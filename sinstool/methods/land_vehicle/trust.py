"""Motion of a vehicle's axle on an unconstrained track: does it slide, and how much?

The velocity of a smoother without constraints, in the vehicle's axes, shows the error of a
constraint. Innovations of a constrained filter do not: its mount and lever would adapt first.

References
----------
.. [1] K.-Y. Liang, S. L. Zeger, "Longitudinal data analysis using generalized linear models",
   Biometrika 73, 1986, 13-22: variances of estimates from data that are alike within groups.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core import earth
from sinstool.core.arrays import BoolArray, FloatArray
from sinstool.core.order_statistics import SIGMA_PER_MAD
from sinstool.core.rotation import exp, to_dcm
from sinstool.core.units import DEGREE
from sinstool.methods.ins_gnss.constraints import (
    AXLE_SIGMA,
    MOUNT_SIGMA,
    SIDESLIP_SIGMA,
    SQUAT_SIGMA,
    STEP_NS,
    LandVehicle,
)
from sinstool.methods.land_vehicle.track import Means, Track, within

# Rows in motion: faster than this, m/s, and than this share of the largest speed.
SLOW, SHARE_OF_FASTEST = 1.0, 0.3
LEAST_ROWS, LEAST_S = 60, 30.0
# Robust least squares: rounds, and sigmas beyond which a row has no weight.
ROUNDS, FAR = 5, 4.0
# Errors of velocity that are in no smoother's sigma, m/s.
LEAST_EXCESS = 0.03
# At least this share of the residuals' rms counts as the vehicle's: the smoother's own sigma is too
# large, as its process noise is generous.
LEAST_SHARE = 0.35
# Limits of the correlation time of a slide, s, and of its sigma as a mean over 1 s, m/s; and that
# sigma if the log does not show it.
LEAST_TIME, MOST_TIME = 0.5, 10.0
LEAST_SIGMA, MOST_SIGMA, UNSHOWN_SIGMA = 0.1, 1.0, 0.3
# A vehicle slides beyond this residual over speed, rad, or this share of rows that are far off.
MOST_ANGLE, MOST_FAR = 2.0 * DEGREE, 0.05
# Least length of the mean direction of travel in the body: below it there is no forward axis.
LEAST_CONCENTRATION = 0.8
# A track less certain than this across its way, rad, does not show whether the vehicle slides.
MOST_OWN = 2.0 * DEGREE
# Share of the centripetal acceleration that is felt sideways: 1 in a car, 0 in an aircraft, which
# leans into its turns; the limit is halfway, by so many sigmas. A less certain share shows neither,
# nor do turns that vary by less than this, m/s^2, as a steady circle: errors of the velocity have
# the same size.
LEAST_PUSH, PUSH_SIGMAS, MOST_PUSH_SIGMA, LEAST_TURN = 0.5, 2.0, 0.2, 0.05
# Duration of a slide, s.
SLIDE_S = 5.0
# Time, s, over which a sideways force is correlated.
SPAN_S = 10.0
# Sigma of a mount that is given, rad, and the angle of the way beyond which it is rejected.
OPTION_SIGMA, MOST_OFF = 1.0 * DEGREE, 5.0 * DEGREE
# Time on either side of a bad row without constraints, s.
BESIDE_S = 5.0
# Largest distance of an axle from the IMU, m.
LONGEST_VEHICLE = 20.0


@dataclass(frozen=True)
class AxisTrust:
    """Size of the velocity along an axis where it should be 0.

    Attributes
    ----------
    rms : float
        Of the residuals, m/s.
    own : float
        What the track's own sigma explains of it, m/s.
    angle, own_angle : float
        Robust residual, and the track's own sigma, over the median speed, rad.
    far : float
        Share of rows that are far off.
    time : float
        Correlation time, s.
    sigma : float
        As a mean over 1 s, m/s.
    """

    rms: float
    own: float
    angle: float
    own_angle: float
    far: float
    time: float
    sigma: float


@dataclass(frozen=True)
class Trust:
    """Whether a vehicle can be held not to slide.

    Attributes
    ----------
    vehicle : LandVehicle or None
        None where the track does not show one.
    rolls : ndarray of bool, shape (g,)
        Steps of the means where it may be held.
    """

    vehicle: LandVehicle | None
    holds: bool
    reason: str
    rolls: BoolArray
    lateral: AxisTrust | None = None
    vertical: AxisTrust | None = None


def find_trust(
    means: Means,
    track: Track,
    c_vb: FloatArray | None = None,
    option_sigma: float = OPTION_SIGMA,
) -> Trust:
    """Whether a vehicle's axle slides, by a track without constraints.

    Parameters
    ----------
    c_vb : ndarray, shape (3, 3), optional
        The mount, where it is known.
    option_sigma : float, optional
        How well, rad, for pitch and yaw.
    """
    # What the user knows serves where the log does not show it
    mounted, mount_sigma = None, MOUNT_SIGMA
    if c_vb is not None:
        mount_sigma = option_sigma
        mounted = LandVehicle(c_vb, 0.0, UNSHOWN_SIGMA, UNSHOWN_SIGMA, mount_sigma=mount_sigma)
    anywhere = np.ones(len(means), bool)
    if len(track.time_ns) < LEAST_ROWS:
        return Trust(mounted, False, "there are too few fixes to tell", anywhere)
    speed, sigma = track.speed, track.speed_sigma
    seen = track.outside_outages
    fastest = np.quantile(speed[seen], 0.95) if seen.any() else 0.0
    moving = seen & (speed > max(SLOW, SHARE_OF_FASTEST * fastest)) & (sigma < 0.5 * speed)
    rolling = seen & (speed > SLOW) & (sigma < 0.5 * speed)
    rolling &= np.isfinite(_at(means, means.force, track)).all(axis=1)
    moving &= rolling
    seconds = np.diff(track.time_ns, append=track.time_ns[-1:]) * 1e-9
    if np.count_nonzero(moving) < LEAST_ROWS or seconds[moving].clip(max=1.5).sum() < LEAST_S:
        slow = f"the fixes show too little motion faster than {SLOW:g} m/s to tell"
        return Trust(mounted, False, slow, anywhere)
    if c_vb is None:
        c_vb, concentration = _mount(means, track, moving)
        if concentration < LEAST_CONCENTRATION:
            return Trust(None, False, "it moves in many directions of its own body", anywhere)
    rows = _Rows.of(means, track, c_vb)
    # Cars turn slowly: what turns show is of slower rows too
    lateral, axle, yaw, far_y = _axis(rows, moving, rolling, 1)
    vertical, _, pitch, far_z = _axis(rows, moving, rolling, 2)
    reason = _doubt(lateral, vertical, axle) or _leans(rows, rolling)
    if mounted is None:
        # What goes to the right and down in proportion to the speed is of the mount
        c_vb = to_dcm(exp([0.0, pitch, -yaw])) @ c_vb
    else:
        upright, _ = _mount(means, track, moving)
        # Roll has no state, and neither row shows it
        roll = np.arctan2(upright[1] @ c_vb[2], upright[2] @ c_vb[2])
        if max(abs(yaw), abs(pitch)) > MOST_OFF:
            # What are slopes of the velocity here are angles while they are small
            off = float(np.arccos(np.clip(upright[0] @ c_vb[0], -1.0, 1.0))) / DEGREE
            reason = f"it moves {off:.0f} deg off the forward axis of the mount"
        elif abs(roll) > MOST_OFF:
            off = abs(roll) / DEGREE
            reason = f"gravity is {off:.0f} deg off the down axis of the mount"
    vehicle = LandVehicle(c_vb, axle, lateral.sigma, vertical.sigma, mount_sigma=mount_sigma)
    far = track.time_ns[moving][far_y | far_z]
    beside = np.zeros(len(means), bool)
    step = (far - means.start_ns) // STEP_NS
    beside[step[(step >= 0) & (step < len(means))]] = True
    reach = round(BESIDE_S * 1e9 / STEP_NS)
    rolls = ~within(beside, reach, reach)
    if reason:
        return Trust(vehicle, False, reason, rolls, lateral, vertical)
    return Trust(
        vehicle,
        True,
        f"its velocity sideways and up stays within {lateral.rms:.2f} and {vertical.rms:.2f} m/s",
        rolls,
        lateral,
        vertical,
    )


def _doubt(lateral: AxisTrust, vertical: AxisTrust, axle: float) -> str:
    """Reason not to constrain a vehicle; empty where there is none."""
    for name, axis in (("sideways", lateral), ("up and down", vertical)):
        if axis.own_angle > MOST_OWN:
            return (
                f"its direction of motion {name} is known to {axis.own_angle / DEGREE:.1f} deg only"
            )
        if axis.angle > MOST_ANGLE:
            return f"it moves {name} by {axis.angle / DEGREE:.1f} deg off its axis"
        if axis.far > MOST_FAR:
            return f"it slides {name} in {axis.far:.0%} of the time"
    if abs(axle) > LONGEST_VEHICLE:
        return f"an axle that does not slide would be {abs(axle):.0f} m from the IMU"
    return ""


def _leans(rows: _Rows, moving: BoolArray) -> str:
    """Reason why turns show no land vehicle; empty where they show one."""
    share, sigma = _push(rows, moving)
    if sigma < MOST_PUSH_SIGMA and share - PUSH_SIGMAS * sigma > LEAST_PUSH:
        return ""
    if sigma < MOST_PUSH_SIGMA and share < LEAST_PUSH:
        return "it leans into its turns, as aircraft do"
    return "it turns too little to tell what it is"


def _push(rows: _Rows, moving: BoolArray) -> tuple[float, float]:
    """Share of the centripetal acceleration that is felt sideways, and its sigma.

    Less the means of both, as the mean force is the roll of the mount. Other sideways forces, as by
    the road's camber, last for seconds, so the sigma is from sums over spans of that length [1]_.
    """
    turn = (rows.velocity[:, 0] * rows.rate[:, 2])[moving]
    push = rows.right[moving]
    turn, push = turn - turn.mean(), push - push.mean()
    size = float(turn @ turn)
    if size <= LEAST_TURN**2 * len(turn):
        return 0.0, np.inf
    share = float(turn @ push) / size
    _, span = np.unique(np.floor(rows.time[moving] / SPAN_S), return_inverse=True)
    spans = int(span[-1]) + 1
    sums = np.bincount(span, weights=turn * (push - share * turn))
    few = np.sqrt(spans / (spans - 1.0)) if spans > 1 else np.inf
    return share, float(few * np.sqrt(sums @ sums)) / size


def _at(means: Means, values: FloatArray, track: Track) -> FloatArray:
    """Means at the times of a track; NaN outside."""
    step = (track.time_ns - means.start_ns) // STEP_NS
    inside = (step >= 0) & (step < len(means))
    out = np.full((len(step), 3), np.nan)
    out[inside] = values[step[inside]]
    return out


def _mount(means: Means, track: Track, moving: BoolArray) -> tuple[FloatArray, float]:
    """``C_vb`` by the direction of travel and the mean force, and how sure that direction is."""
    velocity = track.velocity_b[moving]
    direction = velocity / np.linalg.norm(velocity, axis=1, keepdims=True)
    forward = np.median(direction, axis=0)
    concentration = float(np.linalg.norm(forward))
    forward /= max(concentration, 1e-9)
    down = -np.median(_at(means, means.force, track)[moving], axis=0)
    down -= (down @ forward) * forward
    down /= max(float(np.linalg.norm(down)), 1e-9)
    return np.stack([forward, np.cross(down, forward), down]), concentration


@dataclass(frozen=True)
class _Rows:
    """A track in a vehicle's axes: velocity, rate, accelerations, own sigmas of the velocity.

    `forward` is the acceleration in this direction, `right` the specific force in that one.
    """

    time: FloatArray
    velocity: FloatArray
    rate: FloatArray
    forward: FloatArray
    right: FloatArray
    own: FloatArray

    @classmethod
    def of(cls, means: Means, track: Track, c_vb: FloatArray) -> _Rows:
        b = c_vb @ track.dcm_nb.transpose(0, 2, 1)
        force = _at(means, means.force, track) @ c_vb.T
        # Of errors dv and psi, which is dv_v = B dv + (v x B) psi
        h = np.concatenate([b, np.cross(track.velocity_n[:, None, :], b)], axis=2)
        own = np.sqrt(np.maximum(np.einsum("mij,mjk,mik->mi", h, track.covariance, h), 0.0))
        return cls(
            (track.time_ns - track.time_ns[0]) * 1e-9,
            np.einsum("mij,mj->mi", b, track.velocity_n),
            _at(means, means.rate, track) @ c_vb.T,
            force[:, 0] + b[:, 0, 2] * earth.NORMAL_GRAVITY_EQUATOR,
            force[:, 1],
            own,
        )


def _axis(
    rows: _Rows, moving: BoolArray, rolling: BoolArray, axis: int
) -> tuple[AxisTrust, float, float, BoolArray]:
    """Trust along an axis, 1 right or 2 down; the lever, m; the angle of the way; far rows.

    The residuals are those of the moving rows, the fit is to all that roll. A lever that no turn
    shows stays what it is in cars, near 0.
    """
    v = rows.velocity[rolling]
    rate = rows.rate[rolling]
    speed = v[:, 0]
    if axis == 1:
        columns, bend = [speed, rate[:, 2], speed**2 * rate[:, 2]], SIDESLIP_SIGMA
    else:
        columns, bend = [speed, -rate[:, 1], speed * rows.forward[rolling]], SQUAT_SIGMA
    design = np.stack(columns, axis=1)
    prior = np.diag([0.0, AXLE_SIGMA**-2, bend**-2])
    fast = moving[rolling]
    # Rows of one slide say as much as one
    alike = max(1.0, SLIDE_S / float(np.median(np.diff(rows.time[rolling]))))
    keep = np.ones(len(v), bool)
    rho, robust = v[fast, axis], LEAST_EXCESS
    solution = np.zeros(3)
    for _ in range(ROUNDS):
        of = design[keep]
        weight = alike * max(robust, LEAST_EXCESS) ** 2
        solution = np.linalg.solve(of.T @ of + weight * prior, of.T @ v[keep, axis])
        rho = v[:, axis] - design @ solution
        robust = SIGMA_PER_MAD * float(np.median(np.abs(rho[fast])))
        keep = np.abs(rho) < FAR * max(robust, 1e-6)
    v, speed, rho = v[fast], speed[fast], rho[fast]
    own = rows.own[moving, axis]
    excess = max(LEAST_EXCESS**2, robust**2 - float(np.median(own)) ** 2)
    far = np.abs(rho) > FAR * np.sqrt(own**2 + excess)
    good = rho[~far]
    rms = float(np.sqrt(np.mean(good**2))) if len(good) else np.inf
    usual = float(np.sqrt(np.mean(own[~far] ** 2))) if len(good) else 0.0
    time = _correlation_time(rows.time[moving][~far], good)
    beyond = max(LEAST_EXCESS**2, rms**2 - usual**2, (LEAST_SHARE * rms) ** 2)
    sigma = float(np.clip(np.sqrt(2.0 * time * beyond), LEAST_SIGMA, MOST_SIGMA))
    usual_speed = float(np.median(np.abs(speed)))
    trust = AxisTrust(
        rms, usual, robust / usual_speed, usual / usual_speed, float(np.mean(far)), time, sigma
    )
    return trust, float(solution[1]), float(solution[0]), far


def _correlation_time(time: FloatArray, values: FloatArray) -> float:
    """Sum of the autocorrelation up to `MOST_TIME`, s, over rows that need not be even."""
    if len(time) < LEAST_ROWS:
        return LEAST_TIME
    step = float(np.median(np.diff(time)))
    grid = np.round((time - time[0]) / step).astype(np.int64)
    dense = np.zeros(int(grid[-1]) + 1)
    there = np.zeros(len(dense))
    dense[grid], there[grid] = values, 1.0
    variance = float(np.mean(values**2))
    total = 0.5
    for lag in range(1, min(int(MOST_TIME / step), len(dense) - 1) + 1):
        pairs = float(there[lag:] @ there[:-lag])
        if pairs < LEAST_ROWS:
            break
        correlation = float(dense[lag:] @ dense[:-lag]) / pairs / variance
        if correlation < 0.0:
            break
        total += correlation
    return float(np.clip(total * step, LEAST_TIME, MOST_TIME))
