"""One epoch of the filter, compiled: kind of rest, measurements, prediction; see `state`."""

from __future__ import annotations

from math import cos, log, pi, sin, sqrt

from sinstool.core.arrays import FloatArray
from sinstool.core.earth import SEMI_MAJOR_AXIS
from sinstool.core.parts import part
from sinstool.methods.attitude_smoother.epochs import (
    AT_REST,
    DP,
    DURATION,
    DV,
    FORCE_DOUBT,
    GAP,
    GYRO,
    JB,
    MOVING,
    OWN_RATE,
    QUIET,
    RATE_DOUBT,
    REST,
    SATURATED,
    STEADY,
    SWAY_FORCE,
    SWAY_RATE,
    TURN_DOUBT,
    TURNED,
    UNEVEN,
    W2,
)
from sinstool.methods.attitude_smoother.heading_update import measure_heading
from sinstool.methods.attitude_smoother.model import EPOCH_S, GRAVITY
from sinstool.methods.attitude_smoother.state import (
    XA,
    XB,
    XG,
    XP,
    XV,
    B,
    G,
    P,
    V,
    copy,
    copy_square,
    felt,
    inject,
    less,
    rotation_of,
    turn,
    update,
    update_row,
)
from sinstool.methods.products import add_product, product

# Parameters of a run
C1, C0, DENSITY, WALK, RATE_ERROR, BIAS_WALK, ZERO_RATE, VELOCITY_WALK, GRAVITY_WALK = range(9)
VELOCITY_VARIANCE, POSITION_VARIANCE, REST_FORCE, DRIFT, JUDGED_AGAIN = 9, 10, 11, 12, 13
OMEGA, FOLLOWS, STOP_RATE = 14, 17, 18
PARAMETERS = 19
# At rest the specific force is gravity alone: noise of that, and sigma of zero velocity.
REST_DENSITY = 0.1  # m/s^2/sqrt(Hz)
REST_VELOCITY = 0.02  # m/s
# A squared innovation this many times its variance refutes a rest.
DENIED = 5.0**2
# Taking travel for rest spoils all tilts before and after, the reverse hardly any. So velocity
# (three axes together) refutes a rest at a lower limit.
TRAVELS = 3.0**2
# A steady acceleration looks like steady travel if the tilt leaves room for it. So travel counts as
# steady only while the sigma of tilt is below this (as level specific force, m/s^2), and the force
# stays within a lower limit than that for a rest. Otherwise it shows the bias only.
STEADY_TILT = 0.2
ACCELERATES = 3.0**2
# Drift time of the bias allowed where later passes check rests again, s.
DRIFTED_S = 60.0
# Sway keeps its direction for this many epochs, so their means are correlated.
SWAY_LASTS = 10.0
# If the angle missed in an epoch is larger than this, rad, it may be any angle, and linearisation
# no longer holds.
MOST_MISSED = 1.2
# In a gap the body may turn as fast as beside it, plus this rate, rad/s; by half a turn at most.
GAP_RATE = 0.5
DIVERGED = -1e300


@part()
def _rate_at_rest(row: FloatArray, par: FloatArray, x: FloatArray) -> tuple[float, float, float]:
    """Mean angular rate of an epoch relative to NED, in body axes, less the estimated bias, rad/s.

    The rate of the epoch was taken relative to NED as the integrated attitude has it; the
    correction C gives the difference.
    """
    u, v, w = par[OMEGA], par[OMEGA + 1], par[OMEGA + 2]
    t = row[DURATION]
    north = (x[0] * u + x[3] * v + x[6] * w - u) / t
    east = (x[1] * u + x[4] * v + x[7] * w - v) / t
    down = (x[2] * u + x[5] * v + x[8] * w - w) / t
    return (
        row[GYRO] - row[JB] * north - row[JB + 3] * east - row[JB + 6] * down - x[B],
        row[GYRO + 1] - row[JB + 1] * north - row[JB + 4] * east - row[JB + 7] * down - x[B + 1],
        row[GYRO + 2] - row[JB + 2] * north - row[JB + 5] * east - row[JB + 8] * down - x[B + 2],
    )


@part()
def _along(row: FloatArray, x: FloatArray, i: int, j: int) -> float:
    """Integral over an epoch of the corrected attitude's matrix, element i, j, s."""
    return x[3 * i] * row[JB + j] + x[3 * i + 1] * row[JB + 3 + j] + x[3 * i + 2] * row[JB + 6 + j]


@part()
def rest_kind(
    row: FloatArray, par: FloatArray, x: FloatArray, p: FloatArray, dx: FloatArray, since: float
) -> int:
    """Kind of an epoch that is marked as rest: MOVING, QUIET, STEADY or AT_REST.

    Steady turns and steady travel look like rest. They are recognised by innovations of rate and
    level specific force, and by the velocity, under the filter's predicted bias, tilt and velocity;
    braking, which looks like steady travel, by the specific force at a lower limit. The last rest
    ended `since` seconds ago, since when the bias may have drifted. The sigma of an accelerometer
    bias is that of its grade.
    """
    t = row[DURATION]
    level = par[REST_FORCE] ** 2 + row[SWAY_FORCE]
    steady = par[ZERO_RATE] ** 2 + (par[DRIFT] * since) ** 2 + row[RATE_DOUBT]
    speed = 0.0
    most = STEADY
    force, rates = felt(x, row, DV, 0.5), _rate_at_rest(row, par, x)
    for i in range(3):
        rate = rates[i] - dx[XB + i]
        if rate * rate > DENIED * (p[XB + i, XB + i] + steady):
            return MOVING
        if i < 2:
            z = force[i] / t
            z += (-GRAVITY if i == 0 else GRAVITY) * dx[1 - i]
            for j in range(0 if par[C0] > 0.0 else len(p) - XP):
                z -= _along(row, x, i, j) / t * dx[XP + j]
            tilted = GRAVITY**2 * p[1 - i, 1 - i]
            if z * z > DENIED * (tilted + level):
                return MOVING
            if tilted > STEADY_TILT**2 or z * z > ACCELERATES * (tilted + level):
                most = QUIET
        v = x[V + i] + dx[XV + i]
        speed += v * v / (p[XV + i, XV + i] + REST_VELOCITY**2)
    kind = int(row[REST])
    if kind == AT_REST and speed <= TRAVELS:
        return AT_REST
    return min(kind, most)


@part()
def _turned(row: FloatArray, x: FloatArray, slope: FloatArray) -> float:
    """Angle by which an epoch turns about the vertical, rad; derivatives by the bias in `slope`."""
    angle = 0.0
    for j in range(3):
        down = x[6] * row[JB + j] + x[7] * row[JB + 3 + j] + x[8] * row[JB + 6 + j]
        angle += x[6 + j] * row[TURNED + j] - down * x[B + j]
        slope[XB + j] = -down
    return angle


@part()
def measure(
    row: FloatArray,
    field: FloatArray,
    k: int,
    par: FloatArray,
    n: int,
    x: FloatArray,
    p: FloatArray,
    gain: FloatArray,
    dx: FloatArray,
    half: FloatArray,
    kind: int,
) -> float:
    """Measurement updates of `dx` and `p` by epoch k: specific force, rest, heading.

    `gain` and `half` are arrays to work in. Returns the log likelihood of the specific force, 0 at
    rest; `DIVERGED` where the filter diverged.
    """
    if row[GAP] > 0.0:
        return 0.0
    rest = kind >= STEADY
    t = row[DURATION]
    c1 = 0.0 if rest else par[C1]
    c0 = 0.0 if rest else par[C0]
    hand = par[C0] > 0.0
    biased = n > XP and not hand
    travels = not hand and kind != AT_REST
    # what a level velocity of 1 m/s adds along itself and across it, and how both grow with a turn
    along, across = c1, 0.0
    along_more, across_more = 0.0, 0.0
    slope, by_bias = half[0], half[1]
    if travels:
        across = 2.0 * par[OMEGA + 2]
        if par[FOLLOWS] > 0.0 and not rest:
            turned = _turned(row, x, by_bias)
            along_more, across_more = sin(turned) / t, cos(turned) / t
            along += (1.0 - across_more * t) / t
            across += along_more
    r = REST_DENSITY if rest else par[DENSITY]
    missed = GRAVITY * min(par[STOP_RATE] * row[SATURATED], MOST_MISSED)
    variance = r * r / t + missed * missed
    if kind == STEADY:
        variance += row[FORCE_DOUBT]
    likelihood = 0.0
    force = felt(x, row, DV, 0.5)
    for i in range(3):
        z = force[i] / t
        own, other, pos = c1, c0, XV + i
        if i < 2 and travels:
            side = 1.0 if i == 0 else -1.0
            own, other, pos = along, side * across, XV + 1 - i
            z += other * x[V + 1 - i]
        z += own * x[V + i]
        if hand:
            z += c0 * x[P + i]
            pos = XP + i
        first, weight = XA + 1 - i, GRAVITY
        if i == 0:
            weight = -GRAVITY
        elif i == 2:
            z += GRAVITY + x[G]
            first, weight = XG, 1.0
        follows = i < 2 and across_more != 0.0
        if follows or biased:
            for j in range(n):
                slope[j] = 0.0
            slope[first], slope[pos], slope[XV + i] = weight, other, own
            if follows:
                grows = along_more * x[V + i] + side * across_more * x[V + 1 - i]
                for j in range(3):
                    slope[XB + j] = grows * by_bias[XB + j]
            for j in range(n - XP if biased else 0):
                slope[XP + j] = -_along(row, x, i, j) / t
            left, s = update_row(p, n, slope, -z, variance, gain, dx)
        else:
            left, s = update(p, n, first, weight, XV + i, own, pos, other, -z, variance, gain, dx)
        if not (s < 1e8 and abs(left) < 1e4):
            return DIVERGED
        likelihood -= 0.5 * (left * left / s + log(s))
    if kind != MOVING:
        likelihood = 0.0
    if kind == AT_REST:
        for i in range(3):
            z = -x[V + i]
            update(p, n, XV + i, 1.0, XA, 0.0, XA, 0.0, z, REST_VELOCITY**2, gain, dx)
    if kind != MOVING:
        steady = par[ZERO_RATE] ** 2 * EPOCH_S / t + row[OWN_RATE] + row[RATE_DOUBT]
        steady += SWAY_LASTS * max(0.0, row[SWAY_RATE] - row[OWN_RATE])
        if travels:
            # it turns with the vertical, so a level velocity looks like a bias for as long
            steady += SWAY_LASTS * EPOCH_S / t * par[VELOCITY_VARIANCE] / SEMI_MAJOR_AXIS**2
        rates = _rate_at_rest(row, par, x)
        for i in range(3):
            if row[TURN_DOUBT] == 0.0:
                update(p, n, XB + i, 1.0, XA, 0.0, XA, 0.0, rates[i], steady, gain, dx)
                continue
            # in navigation axes, as what it may turn is about the vertical
            z = 0.0
            for j in range(n):
                slope[j] = 0.0
            for j in range(3):
                slope[XB + j] = _along(row, x, i, j) / t
                z += slope[XB + j] * rates[j]
            doubt = row[TURN_DOUBT] if i == 2 else 0.0
            update_row(p, n, slope, z, steady + doubt, gain, dx)
    if len(field):
        measure_heading(field[k], n, x, p, gain, dx)
    return likelihood


@part()
def correct(
    near: FloatArray,
    k: int,
    x: FloatArray,
    dx: FloatArray,
    n: int,
    hand: bool,
    kind: int,
    e: FloatArray,
) -> None:
    """Add the estimated error to the state, or replace the state by that of an earlier pass.

    Where a vehicle comes to rest its estimated velocity may be wrong by tens of m/s. That times the
    correction of attitude is no velocity of a vehicle at rest: it would refute the rest.
    """
    if len(near) == 0:
        a, b, c = x[V] + dx[XV], x[V + 1] + dx[XV + 1], x[V + 2] + dx[XV + 2]
        inject(x, dx, n, hand, e)
        if kind == AT_REST:
            x[V], x[V + 1], x[V + 2] = a, b, c
        for m in range(n):
            dx[m] = 0.0
    else:
        copy(near[k], x)


@part()
def predict_error(
    near: FloatArray,
    k: int,
    x: FloatArray,
    f: FloatArray,
    dx: FloatArray,
    n: int,
    hand: bool,
    e: FloatArray,
    out: FloatArray,
) -> None:
    """Predict `dx`, relative to the states of an earlier pass; `x` is the predicted state."""
    if len(near) == 0:
        return
    less(x, near[k + 1], n, hand, out, e)
    for i in range(n):
        for m in range(n):
            out[i] += f[i, m] * dx[m]
    for i in range(n):
        dx[i] = out[i]
    copy(near[k + 1], x)


@part()
def predict_state(
    row: FloatArray,
    rate: float,
    par: FloatArray,
    n: int,
    x: FloatArray,
    f: FloatArray,
    q: FloatArray,
    e: FloatArray,
) -> None:
    """Predict the state over an epoch; outputs its transition `f` and process noise `q`."""
    for i in range(n):
        for j in range(n):
            f[i, j] = 0.0
            q[i, j] = 0.0
        f[i, i] = 1.0
    t = row[DURATION]
    gap = row[GAP] > 0.0
    hand = par[C0] > 0.0
    if gap:
        turned = min(sqrt(GAP_RATE**2 + rate * rate) * t, pi)
        for i in range(3):
            q[i, i] = turned * turned
            f[XV + i, XV + i] = 0.0
            q[XV + i, XV + i] = par[VELOCITY_VARIANCE]
            x[V + i] = 0.0
            if hand:
                f[XP + i, XP + i] = 0.0
                q[XP + i, XP + i] = par[POSITION_VARIANCE]
                x[P + i] = 0.0
    else:
        # M = -C Jb, what a bias does to the attitude; then C' = C exp(-Jb b) = exp(M b) C
        for i in range(3):
            for j in range(3):
                f[i, XB + j] = -_along(row, x, i, j)
                if n > XP and not hand:
                    f[XV + i, XP + j] = f[i, XB + j]
        weight = GRAVITY + x[G]
        half = 0.5 * t * t
        if hand:
            gained = felt(x, row, DP, 1.0 / 3.0)
            for i in range(3):
                x[P + i] += t * x[V + i] + gained[i]
            x[P + 2] += weight * half
        gained = felt(x, row, DV, 0.5)
        for i in range(3):
            x[V + i] += gained[i]
        x[V + 2] += weight * t
        rotation_of(
            f[0, XB] * x[B] + f[0, XB + 1] * x[B + 1] + f[0, XB + 2] * x[B + 2],
            f[1, XB] * x[B] + f[1, XB + 1] * x[B + 1] + f[1, XB + 2] * x[B + 2],
            f[2, XB] * x[B] + f[2, XB + 1] * x[B + 1] + f[2, XB + 2] * x[B + 2],
            e,
        )
        turn(x, e)
        # the Earth's rate was removed along NED of the integration, not of the corrected attitude
        u, v, w = par[OMEGA], par[OMEGA + 1], par[OMEGA + 2]
        if u != 0.0 or w != 0.0:
            rotation_of(
                t * (x[0] * u + x[1] * v + x[2] * w - u),
                t * (x[3] * u + x[4] * v + x[5] * w - v),
                t * (x[6] * u + x[7] * v + x[8] * w - w),
                e,
            )
            turn(x, e)
        if not hand:
            # a velocity that is known shows how the vertical turns, and the Coriolis acceleration
            north, east = x[V], x[V + 1]
            coriolis, curved = 2.0 * par[OMEGA + 2] * t, t / SEMI_MAJOR_AXIS
            x[V] += coriolis * east
            x[V + 1] -= coriolis * north
            f[XV, XV + 1], f[XV + 1, XV] = coriolis, -coriolis
            rotation_of(-curved * east, curved * north, 0.0, e)
            turn(x, e)
            f[0, XV + 1], f[1, XV] = -curved, curved
        f[XV, 1] = -GRAVITY * t
        f[XV + 1, 0] = GRAVITY * t
        f[XV + 2, XG] = t
        _crossed(x[V], x[V + 1], x[V + 2], f, XV)
        missed = min(par[STOP_RATE] * row[SATURATED], MOST_MISSED)
        spread = par[WALK] ** 2 * t + par[RATE_ERROR] ** 2 * row[W2] + missed * missed
        spread += row[UNEVEN]
        for i in range(3):
            q[i, i] = spread
        _spread(x[V], x[V + 1], x[V + 2], spread, q, XV)
        for i in range(3):
            q[XV + i, XV + i] += par[VELOCITY_WALK] ** 2 * t
        if hand:
            f[XP, 1] = -GRAVITY * half
            f[XP + 1, 0] = GRAVITY * half
            f[XP + 2, XG] = half
            for i in range(3):
                f[XP + i, XV + i] = t
            _crossed(x[P], x[P + 1], x[P + 2], f, XP)
            _spread(x[P], x[P + 1], x[P + 2], spread, q, XP)
            # noise that velocity and position share
            for i in range(3):
                for j in range(3):
                    s = 0.0
                    for m in range(3):
                        s += q[XV + i, m] * q[XP + j, m]
                    s = s / spread if spread > 0.0 else 0.0
                    q[XV + i, XP + j] = s
                    q[XP + j, XV + i] = s
    for i in range(3):
        q[XB + i, XB + i] = par[BIAS_WALK] ** 2 * t
    q[XG, XG] = par[GRAVITY_WALK] ** 2 * t


@part()
def _crossed(a: float, b: float, c: float, f: FloatArray, at: int) -> None:
    """Rows `at` of f, columns of the bias: [a, b, c]x times the rows of the attitude."""
    for j in range(XB, XB + 3):
        f[at, j] = -c * f[1, j] + b * f[2, j]
        f[at + 1, j] = c * f[0, j] - a * f[2, j]
        f[at + 2, j] = -b * f[0, j] + a * f[1, j]


@part()
def _spread(a: float, b: float, c: float, variance: float, q: FloatArray, at: int) -> None:
    """Process noise of a vector due to isotropic noise of attitude, and their covariance."""
    q[at, 1], q[at, 2] = -c * variance, b * variance
    q[at + 1, 0], q[at + 1, 2] = c * variance, -a * variance
    q[at + 2, 0], q[at + 2, 1] = -b * variance, a * variance
    for i in range(3):
        for j in range(3):
            q[j, at + i] = q[at + i, j]
    square = a * a + b * b + c * c
    q[at, at] = (square - a * a) * variance
    q[at + 1, at + 1] = (square - b * b) * variance
    q[at + 2, at + 2] = (square - c * c) * variance
    q[at, at + 1] = q[at + 1, at] = -a * b * variance
    q[at, at + 2] = q[at + 2, at] = -a * c * variance
    q[at + 1, at + 2] = q[at + 2, at + 1] = -b * c * variance


@part()
def predict_covariance(
    p: FloatArray, n: int, f: FloatArray, q: FloatArray, half: FloatArray
) -> None:
    """Predict the covariance: p <- f p f^T + q, for a sparse f."""
    product(f, p, n, n, n, half)
    # Turned in place, as rows are several times as quick to write as columns
    for i in range(n):
        for j in range(i):
            half[i, j], half[j, i] = half[j, i], half[i, j]
    copy_square(q, n, p)
    add_product(f, half, n, n, n, p)


@part()
def rate_at_gap(epochs: FloatArray, k: int) -> float:
    """Root mean square rate beside a gap, rad/s; 0 elsewhere."""
    if epochs[k, GAP] == 0.0:
        return 0.0
    square = 0.0
    for j in (k - 1, k + 1):
        if 0 <= j < len(epochs) and epochs[j, GAP] == 0.0 and epochs[j, DURATION] > 0.0:
            square = max(square, epochs[j, W2] / epochs[j, DURATION])
    return sqrt(square)
