"""A plain INS/GNSS Kalman filter of 33 states and its smoother: the yardstick for the product's.

It shares no code with the product. Where it gets the true noise of the sensors and the receiver it
is optimal, as far as a linearised filter can be; whoever is worse than it by a factor has a model
that does not fit. It knows no outliers, no latency and no barometer. It goes on after gaps of the
IMU, but after minutes without samples its heading is off by more than it says: a heading that may
be anything is not linear.

Frames and signs are the usual ones: n is north, east, down; b is forward, right, down; C_nb takes
b to n. Errors are true less computed. The attitude error psi is the small rotation in n with
``C_true = exp(psi) C_computed``. Of the axes, 1 is what each sensor (x, y, z) measures along the
next axis (y, z, x), and 2 along the next but one; sensors without misalignments leave the usual 21
states.

=======  ==================  =======
index    error               unit
=======  ==================  =======
0 - 2    position, in n      m
3 - 5    velocity, in n      m/s
6 - 8    attitude psi, in n  rad
9 - 11   gyro bias           rad/s
12 - 14  accelerometer bias  m/s^2
15 - 17  gyro scale          1
18 - 20  accelerometer scale 1
21 - 23  gyro axes, 1        rad
24 - 26  gyro axes, 2        rad
27 - 32  accelerometer axes  rad
=======  ==================  =======

References
----------
.. [1] P. D. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
   Systems", 2nd ed., 2013: the Earth, section 2.4; mechanisation, 5.4; error states in local
   navigation axes, 14.2.4; process noise, 14.2.6; GNSS measurements, 14.3.
.. [2] P. G. Savage, "Strapdown Inertial Navigation Integration Algorithm Design", J. Guidance,
   Control, and Dynamics 21, 1998: coning and sculling from this increment and the previous one.
.. [3] H. E. Rauch, F. Tung, C. T. Striebel, "Maximum likelihood estimates of linear dynamic
   systems", AIAA Journal 3(8), 1965.
"""

from dataclasses import dataclass, replace

import numba
import numpy as np

A = 6378137.0  # WGS-84: semi-major axis, m
F = 1.0 / 298.257223563  # flattening
E2 = F * (2.0 - F)
RATE = 7.292115e-5  # rad/s
MU = 3.986004418e14  # m^3/s^2

SIZE = 33
P, V, PSI, BG, BA, SG, SA, G1, G2, A1, A2 = (slice(k, k + 3) for k in range(0, SIZE, 3))
MARKOV = slice(9, 21)
LEAST = 1e-9  # of the sigma of a misalignment, rad: a state needs one

INTERVAL = 0.1  # s between predictions of the covariance
LONGEST = 0.05  # s: a longer interval between samples is a gap
# What a vehicle may do unseen within a gap: how its acceleration and its rate of turn wander, and
# how far velocity, tilt and heading get at most
GAP_ACCELERATION, GAP_RATE = 3.0, 0.2
GAP_MOST = np.array([20.0, 20.0, 2.0, 0.1, 0.1, 1.0])


@dataclass(frozen=True)
class SensorErrors:
    """White noise, and biases and scale factors that are first-order Gauss-Markov processes.

    Attributes
    ----------
    angle_random_walk, velocity_random_walk : float
        rad/sqrt(s), m/s/sqrt(s).
    gyro_bias, accel_bias, gyro_scale, accel_scale : float
        Standard deviations of an axis, rad/s, m/s^2, 1, 1.
    time : float
        Their correlation time, s.
    misalignment : float
        Of each of the six angles of either triad, rad; constant.
    """

    angle_random_walk: float
    velocity_random_walk: float
    gyro_bias: float
    accel_bias: float
    gyro_scale: float
    accel_scale: float
    time: float
    misalignment: float = 0.0

    @property
    def markov(self):
        """Standard deviations of the errors that states 9 to 20 are of."""
        each = [self.gyro_bias, self.accel_bias, self.gyro_scale, self.accel_scale]
        return np.repeat(each, 3)

    @property
    def spread(self):
        """Standard deviations of states 9 to 32."""
        return np.append(self.markov, np.full(12, max(self.misalignment, LEAST)))


@dataclass(frozen=True)
class Fixes:
    """Positions of the antenna, and its velocities where they are not NaN.

    Attributes
    ----------
    seconds : ndarray, shape (f,)
        When they are valid; in order.
    latitude, longitude, height : ndarray, shape (f,)
        rad, rad, m.
    sigma : float
        Of each axis, white, m.
    velocity_n : ndarray, shape (f, 3)
        m/s.
    sigma_v : float
        m/s.
    """

    seconds: np.ndarray
    latitude: np.ndarray
    longitude: np.ndarray
    height: np.ndarray
    sigma: float
    velocity_n: np.ndarray
    sigma_v: float = 0.1

    def rows(self, which):
        """Some of the fixes."""
        names = ("seconds", "latitude", "longitude", "height", "velocity_n")
        return replace(self, **{name: getattr(self, name)[which] for name in names})


@dataclass(frozen=True)
class Navigation:
    """States at some instants.

    Attributes
    ----------
    seconds, latitude, longitude, height : ndarray, shape (m,)
        s, rad, rad, m.
    velocity_n : ndarray, shape (m, 3)
    c_nb : ndarray, shape (m, 3, 3)
    sensors : ndarray, shape (m, 24)
        States 9 to 26 as estimated.
    covariance : ndarray, shape (m, 33, 33)
    """

    seconds: np.ndarray
    latitude: np.ndarray
    longitude: np.ndarray
    height: np.ndarray
    velocity_n: np.ndarray
    c_nb: np.ndarray
    sensors: np.ndarray
    covariance: np.ndarray

    def __len__(self):
        return len(self.seconds)


@dataclass(frozen=True)
class Filtered:
    """What the filter knew at each instant, and what the smoother needs beside it.

    Attributes
    ----------
    after : Navigation
        With the fix of that instant, where there is one.
    transition : ndarray, shape (m, 33, 33)
        From the instant before.
    noise : ndarray, shape (m, 33)
        Variances of the process noise since then; half of it before the transition.
    correction : ndarray, shape (m, 33)
        By the fix.
    """

    after: Navigation
    transition: np.ndarray
    noise: np.ndarray
    correction: np.ndarray


# --- Earth -----------------------------------------------------------------------------------


@numba.njit(cache=True)
def radii(latitude):
    """Meridian and transverse radius of curvature, m; [1]_ eqs. 2.105 and 2.106."""
    x = 1.0 - E2 * np.sin(latitude) ** 2
    return A * (1.0 - E2) / x**1.5, A / np.sqrt(x)


@numba.njit(cache=True)
def gravity(latitude, height):
    """Down component of gravity, m/s^2; [1]_ eqs. 2.134 and 2.139."""
    sin2 = np.sin(latitude) ** 2
    surface = 9.7803253359 * (1.0 + 0.001931853 * sin2) / np.sqrt(1.0 - E2 * sin2)
    m = RATE**2 * A**2 * A * (1.0 - F) / MU
    slope = 1.0 + F * (1.0 - 2.0 * sin2) + m
    return surface * (1.0 - 2.0 / A * slope * height + 3.0 / A**2 * height**2)


@numba.njit(cache=True)
def rates(latitude, height, v):
    """Earth rate and transport rate in n, rad/s; [1]_ eqs. 2.123 and 5.44."""
    meridian, transverse = radii(latitude)
    earth = RATE * np.array([np.cos(latitude), 0.0, -np.sin(latitude)])
    east = v[1] / (transverse + height)
    transport = np.array([east, -v[0] / (meridian + height), -east * np.tan(latitude)])
    return earth, transport


def metres(latitude, longitude, height, from_latitude, from_longitude, from_height):
    """North, east, down from one place to another near it, m."""
    meridian, transverse = radii(from_latitude)
    return np.stack(
        [
            (latitude - from_latitude) * (meridian + from_height),
            (longitude - from_longitude) * (transverse + from_height) * np.cos(from_latitude),
            from_height - height,
        ],
        axis=-1,
    )


def moved(latitude, longitude, height, offset):
    """The place at north, east, down from a place, m."""
    meridian, transverse = radii(latitude)
    return (
        latitude + offset[..., 0] / (meridian + height),
        longitude + offset[..., 1] / ((transverse + height) * np.cos(latitude)),
        height - offset[..., 2],
    )


# --- mechanisation -----------------------------------------------------------------------------


@numba.njit(cache=True)
def cross(a, b):
    """Of two vectors."""
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


@numba.njit(cache=True)
def skew(a):
    """Matrix of the cross product."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


@numba.njit(cache=True)
def rotation(a):
    """Matrix of a rotation vector; [1]_ eq. 5.73."""
    square = a[0] ** 2 + a[1] ** 2 + a[2] ** 2
    size = np.sqrt(square)
    if size < 1e-4:
        first, second = 1.0 - square / 6.0, 0.5 - square / 24.0
    else:
        first, second = np.sin(size) / size, (1.0 - np.cos(size)) / square
    k = skew(a)
    return np.eye(3) + first * k + second * (k @ k)


@numba.njit(cache=True)
def across(angles, values):
    """What misaligned sensors measure along the other axes."""
    return angles[:3] * np.roll(values, -1) + angles[3:] * np.roll(values, -2)


@numba.njit(cache=True)
def mechanise(place, v, c, sensors, earlier, dt, gyro, accel):
    """Navigate over some samples; [1]_ section 5.4 in increments, with [2]_.

    Parameters
    ----------
    place, v, c : ndarray
        Latitude, longitude, height; velocity; C_nb. Changed.
    sensors : ndarray, shape (24,)
        Biases, scale factors and misalignments to be taken off.
    earlier : ndarray, shape (2, 3)
        Increments of the sample before. Changed.
    dt, gyro, accel : ndarray, shape (k,), (k, 3), (k, 3)
        Increments as measured.

    Returns
    -------
    ndarray, shape (8, 3, 3)
        Integrals of C, of the specific force in n (first column), and of C times the diagonal
        matrices of the specific force and of the rate, each along the axis itself, the next and
        the next but one.
    """
    integrals = np.zeros((8, 3, 3))
    for k in range(len(dt)):
        step = dt[k]
        turn = (gyro[k] - sensors[:3] * step) / (1.0 + sensors[6:9])
        push = (accel[k] - sensors[3:6] * step) / (1.0 + sensors[9:12])
        turn = turn - across(sensors[12:18], turn)
        push = push - across(sensors[18:], push)
        phi = turn + cross(earlier[0], turn) / 12.0
        dv = push + 0.5 * cross(turn, push)
        dv += (cross(earlier[0], push) + cross(earlier[1], turn)) / 12.0
        earlier[0], earlier[1] = turn, push

        earth, transport = rates(place[0], place[2], v)
        zeta = (earth + transport) * step
        dv_n = c @ dv
        dv_n -= 0.5 * cross(zeta, dv_n)
        down = np.array([0.0, 0.0, gravity(place[0], place[2])])
        middle = v + 0.5 * (dv_n + down * step)
        earth, transport = rates(place[0], place[2], middle)
        change = dv_n + (down - cross(2.0 * earth + transport, middle)) * step
        middle = v + 0.5 * change
        meridian, transverse = radii(place[0])
        place[0] += middle[0] * step / (meridian + place[2])
        place[1] += middle[1] * step / ((transverse + place[2]) * np.cos(place[0]))
        place[2] -= middle[2] * step
        v += change

        half = c @ rotation(0.5 * phi)
        c[:] = rotation(-zeta) @ (half @ rotation(0.5 * phi))
        integrals[0] += half * step
        integrals[1, :, 0] += dv_n
        for i in range(3):
            integrals[2 + i] += half * np.roll(push, -i)
            integrals[5 + i] += half * np.roll(turn, -i)
    return integrals


# --- filter ------------------------------------------------------------------------------------


def transition(place, v, integrals, tau, errors):
    """Transition matrix, second order; [1]_ eqs. 14.63 to 14.71 less what is of order v/R.

    Parameters
    ----------
    integrals : ndarray
        Of :func:`mechanise`.
    tau : float
        s.
    """
    earth, transport = rates(place[0], place[2], v)
    meridian, transverse = radii(place[0])
    north, east = 1.0 / (meridian + place[2]), 1.0 / (transverse + place[2])
    a = np.zeros((SIZE, SIZE))
    a[P, V] = tau * np.eye(3)
    a[5, 2] = tau * 2.0 * gravity(place[0], place[2]) / A
    a[V, V] = -tau * skew(2.0 * earth + transport)
    a[V, PSI] = -skew(integrals[1, :, 0])
    a[V, BA] = -integrals[0]
    a[V, SA], a[V, A1], a[V, A2] = -integrals[2:5]
    a[6, 4], a[7, 3], a[8, 4] = -tau * east, tau * north, tau * east * np.tan(place[0])
    a[PSI, PSI] = -tau * skew(earth + transport)
    a[PSI, BG] = -integrals[0]
    a[PSI, SG], a[PSI, G1], a[PSI, G2] = -integrals[5:]
    phi = np.eye(SIZE) + a + 0.5 * a @ a
    phi[MARKOV, MARKOV] *= np.exp(-tau / errors.time)
    return phi


def process_noise(tau, errors):
    """Variances that a time adds; [1]_ section 14.2.6."""
    q = np.zeros(SIZE)
    q[V] = errors.velocity_random_walk**2 * tau
    q[PSI] = errors.angle_random_walk**2 * tau
    q[MARKOV] = errors.markov**2 * -np.expm1(-2.0 * tau / errors.time)
    return q


def predicted(covariance, phi, noise):
    """Covariance a transition later, half of the noise before it and half after."""
    half = np.diag(0.5 * noise)
    return phi @ (covariance + half) @ phi.T + half


def measurement(place, v, c, rate, lever, fixes, k):
    """Innovation of a fix, its rows of H, and variances; [1]_ eqs. 14.102, 14.103 and 14.108."""
    arm, swing = c @ lever, c @ np.cross(rate, lever)
    h = np.zeros((6, SIZE))
    h[:3, P], h[:3, PSI] = np.eye(3), -skew(arm)
    h[3:, V], h[3:, PSI], h[3:, BG] = np.eye(3), -skew(swing), c @ skew(lever)
    at = fixes.latitude[k], fixes.longitude[k], fixes.height[k]
    z = np.concatenate([metres(*at, *place) - arm, fixes.velocity_n[k] - v - swing])
    r = np.repeat(np.square([fixes.sigma, fixes.sigma_v]), 3)
    rows = np.isfinite(z)
    return z[rows], h[rows], r[rows]


def navigate(seconds, gyro, accel, fixes, start, errors, lever, interval=INTERVAL):
    """Filter a log, closed loop.

    Parameters
    ----------
    seconds : ndarray, shape (n,)
    gyro, accel : ndarray, shape (n, 3)
        Increments over (seconds[k-1], seconds[k]], rad and m/s; the first row is not used.
    fixes : Fixes
        Valid at samples, else at the next one.
    start : Navigation
        Of one row, at the first sample.
    errors : SensorErrors
    lever : ndarray, shape (3,)
        From the IMU to the antenna, in b, m.

    Returns
    -------
    Filtered
        At least every `interval`, and at each fix.
    """
    dt = np.diff(seconds, prepend=seconds[0])
    tick = np.floor((seconds - seconds[0]) / interval + 1e-6)
    at_fix = np.searchsorted(seconds, fixes.seconds - 1e-6)
    reached = at_fix < len(seconds)
    fix_of = dict(zip(at_fix[reached].tolist(), np.flatnonzero(reached).tolist(), strict=True))
    gap = np.flatnonzero(dt > LONGEST)
    nodes = np.unique(
        np.concatenate(
            [[0], np.flatnonzero(np.diff(tick, prepend=0.0)), list(fix_of), gap - 1, gap]
        ).astype(int)
    )
    m = len(nodes)
    place = np.array([start.latitude[0], start.longitude[0], start.height[0]])
    v, c = start.velocity_n[0].copy(), start.c_nb[0].copy()
    sensors, p = start.sensors[0].copy(), start.covariance[0].copy()
    earlier = np.zeros((2, 3))
    places, vs, cs = np.empty((m, 3)), np.empty((m, 3)), np.empty((m, 3, 3))
    every, ps = np.empty((m, SIZE - 9)), np.empty((m, SIZE, SIZE))
    phis, qs, corrections = np.zeros((m, SIZE, SIZE)), np.zeros((m, SIZE)), np.zeros((m, SIZE))
    gyro, accel = np.ascontiguousarray(gyro), np.ascontiguousarray(accel)
    for k, node in enumerate(nodes):
        if k:
            part = slice(nodes[k - 1] + 1, node + 1)
            tau = float(dt[part].sum())
            if dt[node] > LONGEST:
                integrals = across_gap(place, v, c, sensors, tau)
                noise = process_noise(tau, errors) + gap_noise(tau)
                earlier[:] = 0.0
            else:
                integrals = mechanise(
                    place, v, c, sensors, earlier, dt[part], gyro[part], accel[part]
                )
                noise = process_noise(tau, errors)
            sensors[:12] *= np.exp(-tau / errors.time)
            phi = transition(place, v, integrals, tau, errors)
            p = predicted(p, phi, noise)
            phis[k], qs[k] = phi, noise
        if node in fix_of:
            rate = earlier[0] / dt[node] if dt[node] > 0.0 else np.zeros(3)
            z, h, r = measurement(place, v, c, rate, lever, fixes, fix_of[node])
            gain = np.linalg.solve(h @ p @ h.T + np.diag(r), h @ p).T
            x = gain @ z
            rest = np.eye(SIZE) - gain @ h
            p = rest @ p @ rest.T + (gain * r) @ gain.T
            place[:] = moved(*place, x[P])
            v += x[V]
            c = rotation(x[PSI]) @ c
            sensors += x[9:]
            corrections[k] = x
        p = 0.5 * (p + p.T)
        places[k], vs[k], cs[k], every[k], ps[k] = place, v, c, sensors, p
    after = Navigation(seconds[nodes], *places.T, vs, cs, every, ps)
    return Filtered(after, phis, qs, corrections)


def across_gap(place, v, c, sensors, tau):
    """Straight on where samples are missing; returns what :func:`mechanise` does."""
    place[:] = moved(*place, v * tau)
    integrals = np.zeros((8, 3, 3))
    integrals[0] = c * tau
    integrals[1, 2, 0] = -gravity(place[0], place[2]) * tau
    return integrals


def gap_noise(tau):
    """Variances of what the vehicle did unseen."""
    wander = np.repeat([GAP_ACCELERATION, GAP_RATE], 3) * np.maximum(tau, np.sqrt(tau))
    q = np.zeros(SIZE)
    q[3:9] = np.minimum(wander, GAP_MOST) ** 2
    return q


# --- smoother ----------------------------------------------------------------------------------


def smooth(filtered):
    """Look back over a filter's run; [3]_.

    Returns
    -------
    Navigation
        At the filter's instants.
    """
    f = filtered.after
    x, p = np.zeros(SIZE), f.covariance[-1]
    errors, covariance = np.zeros((len(f), SIZE)), np.empty_like(f.covariance)
    covariance[-1] = p
    for k in range(len(f) - 2, -1, -1):
        phi, before = filtered.transition[k + 1], f.covariance[k]
        after = predicted(before, phi, filtered.noise[k + 1])
        # States differ by many orders of magnitude; in their sigmas they do not
        unit = np.sqrt(np.diagonal(after))
        gain = (np.linalg.solve(after / np.outer(unit, unit), (phi @ before) / unit[:, None])).T
        gain /= unit
        x = gain @ (x + filtered.correction[k + 1])
        p = before + gain @ (p - after) @ gain.T
        p = 0.5 * (p + p.T)
        errors[k], covariance[k] = x, p
    place = moved(f.latitude, f.longitude, f.height, errors[:, P])
    turned = np.array([rotation(psi) for psi in errors[:, PSI]]) @ f.c_nb
    return Navigation(
        f.seconds,
        *place,
        f.velocity_n + errors[:, V],
        turned,
        f.sensors + errors[:, 9:],
        covariance,
    )
