"""Short flights with sensors that are wrong in known ways, for the INS/GNSS filter."""

from dataclasses import replace
from functools import cache

import numpy as np

from sinstool.core import earth, rotation
from sinstool.core.streams import concatenate, take_rows
from sinstool.methods.coning.registry import algorithm
from sinstool.methods.coning.stage import ConingStage
from sinstool.methods.height.network import HeightNetwork
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.settings import BARO_GRADES, BaroModel, GnssModel, Settings
from sinstool.methods.sensor_errors import IMU_GRADES, SensorGrade
from sinstool.methods.strapdown.followed_rates import with_followed
from sinstool.methods.strapdown.velocity import IncrementStage
from sinstool.simulation.flight import manoeuvring_flight
from sinstool.simulation.gnss import GnssErrors, Receiver, gnss_samples
from sinstool.simulation.sensors import barometer
from tests.helpers.filter_start import start
from tests.helpers.gnss import epochs

DEGREE = np.pi / 180.0
G = 9.80665
RATE = 50.0
IMU = SensorGrade(
    angle_random_walk=0.05 * DEGREE / 60,
    velocity_random_walk=50e-6 * G,
    gyro_bias=1.0 * DEGREE / 3600,
    accel_bias=1e-3 * G,
    accel_scale=1e-4,
)
ATTITUDE = np.array([0.1, 0.1, 0.5]) * DEGREE
WHITE = GnssErrors((1.0, 1.0, 1.5), velocity_white=(0.05, 0.05, 0.08))
WHITE_MODEL = GnssModel((1.0, 1.0, 1.5), (0.1, 0.1, 0.1), 100.0, (0.05, 0.05, 0.08), (1e-3,) * 3)


@cache
def flight(duration=200.0, rate=RATE):
    return manoeuvring_flight(duration, rate, latitude=0.85, longitude=3.1412, seed=4)


def compensated(imu, gyro, accel):
    stage = IncrementStage(
        lambda: ConingStage(
            algorithm("previous-1"), "mean-rate", nominal_interval=float(imu.interval[1])
        )
    )
    parts = [stage.push(gyro, accel, imu.time_ns), stage.finish()]
    return next(with_followed([(concatenate(parts), None)]))[0]


class Flown:
    """A flight's samples, and a filter run over them."""

    def __init__(
        self, seed=1, duration=200.0, noise=IMU, errors=WHITE, baro=(0.0, 0.2), **receiver
    ):
        self.flight = flight(duration)
        imu = self.flight.imu
        random = np.random.default_rng(seed)
        n = len(imu.time_ns)
        root = np.sqrt(imu.interval[1])
        self.gyro_bias = noise.gyro_bias * random.standard_normal(3)
        self.accel_bias = noise.accel_bias * random.standard_normal(3)
        self.scale = noise.accel_scale * random.standard_normal(3)
        white = random.standard_normal((2, n, 3)) / root
        self.increments = compensated(
            imu,
            imu.gyro_mean_rate + self.gyro_bias + noise.angle_random_walk * white[0],
            imu.mean_specific_force * (1.0 + self.scale)
            + self.accel_bias
            + noise.velocity_random_walk * white[1],
        )
        receiver = {"rate_hz": 1.0, "offset_s": 0.37, **receiver}
        self.gnss_truth = gnss_samples(self.flight, Receiver(errors=errors, **receiver), seed)
        self.gnss = epochs(self.gnss_truth)
        self.baro_time = imu.time_ns[5::5] - 3_000_000
        heights = np.interp(self.baro_time, imu.time_ns, self.flight.height)
        self.baro_height, self.baro_error = barometer(
            self.baro_time,
            heights,
            sigma=baro[0],
            correlation_time=300.0,
            white=baro[1],
            seed=seed,
        )
        psi = ATTITUDE * random.standard_normal(3)
        self.start = start(
            float(self.flight.latitude[0]) + 2.0 / 6.37e6,
            float(self.flight.longitude[0]),
            float(self.flight.height[0]) - 3.0,
            self.flight.velocity_n[0] + 0.1 * random.standard_normal(3),
            rotation.multiply(rotation.exp(-psi), imu.q_nb[0]),
            5.0,
            0.1,
            ATTITUDE,
        )
        self.settings = Settings(
            imu=noise,
            gnss=WHITE_MODEL,
            baro=BaroModel(max(baro[0], 0.3), 300.0, baro[1]),
            network=HeightNetwork(5.0),
            grade="tactical",
        )

    def using(self, name="network-26a", **changes):
        if "network" not in changes and not name.startswith("network"):
            changes["network"] = None
        return replace(self.settings, filter=name, **changes)

    def run(self, settings=None, block=None, **more):
        """Push everything, in blocks of so many updates; return (run, blocks)."""
        settings = self.using() if settings is None else settings
        options = {key: more.pop(key) for key in ("store", "with_baro") if key in more}
        run = InsGnssFilter(
            more.pop("start", self.start), settings, **{"with_baro": True, **options}
        )
        stated = more.pop("increments", self.increments)
        gnss = more.pop("gnss", self.gnss)
        withheld = more.pop("withheld", np.zeros(len(gnss), dtype=bool))
        baro_time = more.pop("baro_time", self.baro_time)
        baro_height = more.pop("baro_height", self.baro_height)
        assert not more
        size = block or len(stated.interval)
        latency = round(settings.gnss_latency * 1e9)
        blocks = []
        fix = baro = 0
        for k in range(0, len(stated.interval), size):
            part = take_rows(stated, slice(k, k + size))
            # a little more than what has happened: the rest has to wait
            until = part.time_ns[-1] + 30_000_000
            to_fix = int(np.searchsorted(gnss.time_ns - latency, until))
            to_baro = int(np.searchsorted(baro_time, until))
            blocks.append(
                run.push(
                    part,
                    gnss.rows(slice(fix, to_fix)),
                    withheld[fix:to_fix],
                    baro_time[baro:to_baro],
                    baro_height[baro:to_baro],
                )
            )
            fix, baro = to_fix, to_baro
        return run, blocks

    def errors(self, updates, begin=0.0, end=np.inf):
        """Of navigation, shape (m, 9): m, m/s, rad; between seconds after the start."""
        at = np.searchsorted(self.flight.time_ns, updates.time_ns)
        elapsed = (updates.time_ns - self.flight.time_ns[0]) * 1e-9
        keep = (elapsed >= begin) & (elapsed <= end)
        at = at[keep]
        truth = self.flight
        lat, h = truth.latitude[at], truth.height[at]
        meridian, transverse = earth.radii_of_curvature(lat)
        turn = updates.longitude[keep] - truth.longitude[at]
        turn -= 2 * np.pi * np.round(turn / (2 * np.pi))
        return np.column_stack(
            [
                (updates.latitude[keep] - lat) * (meridian + h),
                turn * (transverse + h) * np.cos(lat),
                h - updates.height[keep],
                updates.velocity_n[keep] - truth.velocity_n[at],
                rotation.log(
                    rotation.multiply(truth.imu.q_nb[at], rotation.conjugate(updates.q_nb[keep]))
                ),
            ]
        )

    def rms(self, blocks, begin=60.0, end=np.inf):
        e = np.concatenate([self.errors(b.updates, begin, end) for b in blocks])
        return np.sqrt(np.mean(e * e, axis=0))


def joined(blocks, name):
    """A column of the diagnostics of all blocks."""
    return np.concatenate([getattr(b.gnss, name) for b in blocks])


def for_grade(grade, **changes):
    """Settings of a filter for a grade of IMU."""
    values = {"grade": grade, "imu": IMU_GRADES[grade], "baro": BARO_GRADES[grade], **changes}
    return Settings(**values)
