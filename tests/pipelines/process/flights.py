"""Short flights as logs, with a barometer that is as bad as a test wants it."""

from dataclasses import dataclass

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.core.rotation import to_euler
from sinstool.core.streams import Solution
from sinstool.io.readers import open_log
from sinstool.io.readers.streams import Losses, read_columns
from sinstool.methods.height.standard_atmosphere import geopotential, pressure_at
from sinstool.methods.sensor_errors import SIMULATED_GRADES, without
from sinstool.pipelines.process.run import process
from sinstool.simulation.flight import manoeuvring_flight
from sinstool.simulation.gnss import MODELS, Receiver, gnss_samples
from sinstool.simulation.log import (
    Axes,
    baro_topic,
    gnss_topics,
    imu_topic,
    truth_topics,
    write_simulated,
)
from sinstool.simulation.sensors import with_errors
from tests.helpers.filter_logs import Capture

AXES = Axes("flu")
# Of sensors in tests of other things: no scale factors, misalignments and drift
NOISE_AND_BIASES = {
    grade: without(errors, "scale", "misalignment", "drift")
    for grade, errors in SIMULATED_GRADES.items()
}
T0 = 1_700_000_000_000_000_000
# South of the equator, west of the date line, which the flight crosses.
PLACE = {"latitude": np.radians(-43.5), "longitude": np.radians(179.997), "heading": 1.4}


@dataclass
class FlightLog:
    """A flight, its barometer, and what a run of it says."""

    flight: object
    seed: int = 0

    def __post_init__(self):
        f = self.flight
        self.baro_ns = T0 + np.arange(0, int(f.time_ns[-1] - T0), 20_000_000, dtype=np.int64)
        seconds = (self.baro_ns - T0) * 1e-9
        self.height = np.interp(seconds, (f.time_ns - T0) * 1e-9, f.height)
        noise = 0.2 * np.random.default_rng(self.seed).standard_normal(len(seconds))
        self.pressure = pressure_at(geopotential(self.height + noise))

    @property
    def seconds(self):
        return (self.baro_ns - T0) * 1e-9

    def spoil(self, metres, where):
        """Move the barometer by so many metres."""
        self.pressure[where] = pressure_at(geopotential(self.height[where] + metres))

    def write(self, path, kind="mean-rate", grade="perfect", baro=True, imu=None, gnss=True):
        sensor = (
            with_errors(self.flight.imu, NOISE_AND_BIASES[grade], self.seed) if imu is None else imu
        )
        topics = [imu_topic(sensor, kind, AXES), *truth_topics(self.flight.imu, AXES, self.flight)]
        if gnss:
            receiver = Receiver(rate_hz=1.0, errors=MODELS["perfect"])
            topics += gnss_topics(gnss_samples(self.flight, receiver, 1))
        if baro:
            topics.append(baro_topic(self.baro_ns, self.pressure, 0.0))
        write_simulated(path, topics, {})
        return path

    def options(self, kind="mean-rate", **groups):
        """Groups of options that start the run at the truth."""
        options = {
            "input": {"gyro_kind": kind, "gyro_unit": "rad/s"},
            "align": {
                "align": "fixed",
                "initial_attitude": tuple(
                    map(float, np.degrees(to_euler(self.flight.imu.q_nb[0])))
                ),
                "gyro_bias": "none",
            },
            "navigation": {"mode": "ins"},
            "output": {"only_results": True},
        }
        for name, group in groups.items():
            options[name] = options.get(name, {}) | group
        return options


class Collected(Capture):
    """Keeps every solution, by columns too."""

    def column(self, name):
        return np.concatenate([getattr(p, name) for p in self.parts])


def flight_log(duration=240.0, rate=100.0, seed=3, turbulence=0.0, **place):
    place = {**PLACE, "height": 1200.0, **place}
    return FlightLog(
        manoeuvring_flight(duration, rate, seed=seed, turbulence=turbulence, start_ns=T0, **place)
    )


def run(path, out, options):
    """Process; (summary, what was computed)."""
    collected = Collected()
    result = process(path, out, build(ProcessConfig, options), sink=collected)
    return result.to_json(), collected


def read(path, topic, fields):
    """Stamps and columns of a topic."""
    columns = {"sec": ["header.stamp.sec"], "nanosec": ["header.stamp.nanosec"], "v": list(fields)}
    with open_log(path) as log:
        blocks = [v for _, v in read_columns(log, log.channels_of(topic), columns, Losses())]
    sec, nanosec, values = (np.concatenate([b[c] for b in blocks]) for c in columns)
    return sec.astype(np.int64) * 10**9 + nanosec.astype(np.int64), values


def finite(solutions: list[Solution]):
    """Whether not one number of any column is NaN or infinite."""
    columns = (column for solution in solutions for column in vars(solution).values())
    return all(np.isfinite(column).all() for column in columns if column is not None)
