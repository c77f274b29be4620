"""Simulated flights through increments and mechanisation, and how far they end from the truth."""

import numpy as np
from scipy.integrate import solve_ivp

from sinstool.core import earth, rotation
from sinstool.core.earth import ecef
from sinstool.core.streams import concatenate
from sinstool.methods.coning.registry import algorithm
from sinstool.methods.coning.stage import ConingStage
from sinstool.methods.strapdown.navigation import initial_state
from sinstool.methods.strapdown.velocity import IncrementStage
from tests.methods.strapdown.navigator import Navigator

EARTH_RATE_E = np.array([0.0, 0.0, earth.EARTH_RATE])


def stage(name, kind, interval):
    nominal = None if kind == "rate" else interval
    return IncrementStage(lambda: ConingStage(algorithm(name), kind, nominal_interval=nominal))


def samples(imu, kind):
    if kind == "rate":
        return imu.gyro_rate, imu.specific_force
    if kind == "mean-rate":
        return imu.gyro_mean_rate, imu.mean_specific_force
    return imu.gyro_increment, imu.mean_specific_force * imu.interval[:, None]


def joined(parts):
    return concatenate(parts)


def increments(imu, name="previous-1", kind="mean-rate"):
    run = stage(name, kind, float(imu.interval[0]))
    return joined([run.push(*samples(imu, kind), imu.time_ns), run.finish()])


def start(flight):
    return initial_state(
        flight.latitude[0],
        flight.longitude[0],
        flight.height[0],
        flight.velocity_n[0],
        flight.imu.q_nb[0],
    )


def q_en(latitude, longitude):
    latitude, longitude = np.broadcast_arrays(latitude, longitude)
    zero = np.zeros_like(latitude)
    about_polar = rotation.exp(np.stack([zero, zero, longitude], axis=-1))
    about_east = rotation.exp(np.stack([zero, -latitude - 0.5 * np.pi, zero], axis=-1))
    return rotation.multiply(about_polar, about_east)


class Errors:
    """Of a navigation against a flight: m in NED of the truth, m/s and rad in Earth axes."""

    def __init__(self, result, flight, rows):
        there = (flight.latitude[rows], flight.longitude[rows])
        turn = q_en(*there)
        apart = ecef(result.latitude, result.longitude, result.height) - ecef(
            *there, flight.height[rows]
        )
        self.position = rotation.rotate(rotation.conjugate(turn), apart)
        self.horizontal = float(np.hypot(self.position[:, 0], self.position[:, 1]).max())
        self.vertical = np.abs(result.height - flight.height[rows])
        q_found = q_en(result.latitude, result.longitude)
        velocity = rotation.rotate(q_found, result.velocity_n) - rotation.rotate(
            turn, flight.velocity_n[rows]
        )
        self.velocity = float(np.abs(velocity).max())
        attitude = rotation.multiply(
            rotation.conjugate(rotation.multiply(turn, flight.imu.q_nb[rows])),
            rotation.multiply(q_found, result.q_nb),
        )
        self.attitude = float(np.abs(rotation.log(attitude)).max())


def fly(flight, name="previous-1", kind="mean-rate", order=0):
    updates = increments(flight.imu, name, kind)
    result = Navigator(start(flight), order).push(
        updates.rotation_vector, updates.velocity_increment, updates.interval
    )
    return result, Errors(result, flight, updates.sample)


def geodetic(position):
    """Latitude, longitude, height of a place in Earth axes, by iteration from a sphere."""
    x, y, z = position
    outward = np.hypot(x, y)
    latitude = np.arctan2(z, outward * (1.0 - earth.ECCENTRICITY_SQUARED))
    for _ in range(6):
        transverse = float(earth.radii_of_curvature(latitude)[1])
        latitude = np.arctan2(
            z + earth.ECCENTRICITY_SQUARED * transverse * np.sin(latitude), outward
        )
    transverse = float(earth.radii_of_curvature(latitude)[1])
    below = transverse * (1.0 - earth.ECCENTRICITY_SQUARED * np.sin(latitude) ** 2)
    height = outward * np.cos(latitude) + z * np.sin(latitude) - below
    return latitude, np.arctan2(y, x), height


def integrate_in_earth_axes(state, rate_b, force_b, time):
    """Position, velocity and attitude in Earth axes by an adaptive integrator.

    A formulation that shares nothing with a local-level mechanisation: no transport rate, no
    radii of curvature but in the gravity model.
    """
    turn = q_en(state[0], state[1])
    first = np.concatenate(
        [
            ecef(state[0], state[1], state[2]),
            rotation.rotate(turn, state[3:6]),
            rotation.multiply(turn, state[6:10]),
        ]
    )

    def equation(t, y):
        latitude, longitude, height = geodetic(y[:3])
        gravity = rotation.rotate(q_en(latitude, longitude), earth.gravity_n(latitude, height))
        force = rotation.rotate(y[6:] / np.linalg.norm(y[6:]), force_b(t))
        coriolis = 2.0 * np.cross(EARTH_RATE_E, y[3:6])
        q_rate = 0.5 * (
            rotation.multiply(y[6:], [0.0, *rate_b(t)])
            - rotation.multiply([0.0, *EARTH_RATE_E], y[6:])
        )
        return np.concatenate([y[3:6], force + gravity - coriolis, q_rate])

    scale = np.concatenate([np.full(3, 1e-7), np.full(3, 1e-10), np.full(4, 1e-14)])
    return solve_ivp(
        equation,
        (time[0], time[-1]),
        first,
        method="DOP853",
        t_eval=time,
        rtol=1e-13,
        atol=scale,
    ).y.T
