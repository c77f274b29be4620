"""Logs of scenarios: truth, sensor errors, topics, and the file."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from sinstool.core.errors import ConfigurationError, OutputError
from sinstool.core.options import span
from sinstool.core.rotation import from_euler
from sinstool.core.units import DEGREE
from sinstool.core.whole_file import check_mcap_name, check_output, commit_together, write_whole
from sinstool.methods.height.standard_atmosphere import geopotential, height_per_pascal, pressure_at
from sinstool.methods.sensor_errors import SIMULATED_GRADES, Part, SensorGrade, without
from sinstool.simulation import drive, flight, launch, motions, scenarios
from sinstool.simulation.car import Car, axle_motion
from sinstool.simulation.coning import classical_coning
from sinstool.simulation.coning_paper import coning_paper, paper_response
from sinstool.simulation.gnss import MODELS, GnssFaults, Jump, Receiver, gnss_samples
from sinstool.simulation.hse_rig import HseRigLog
from sinstool.simulation.log import (
    Axes,
    SimulatedTopic,
    baro_topic,
    bias_topic,
    gnss_topics,
    imu_topic,
    resting_fixes,
    truth_topics,
    vehicle_topic,
    write_simulated,
)
from sinstool.simulation.rig_log import lambda2_arcsec, rig_log, rig_table, rig_topics
from sinstool.simulation.sensors import (
    ImuErrors,
    barometer,
    idling,
    launch_grade,
    measured,
    saturated,
)
from sinstool.simulation.truth import ImuTruth, Trajectory, after_rest, sample_times, static
from sinstool.simulation.wheels import WheelSensor, wheel_readings, wheel_topic

SCHEMA = "sinstool.simulate/1"
START_NS = 1_700_000_000_000_000_000
# Seeds of one log's receiver, barometer, wheels and engine, apart from that of its IMU
GNSS_SEED, BARO_SEED, WHEEL_SEED, IDLE_SEED = 1000, 2000, 4000, 5000


@dataclass(frozen=True)
class Simulated:
    """A log that can be written, and the data it was made from.

    Attributes
    ----------
    scenario : Scenario
        Its options.
    topics : list of SimulatedTopic
        The contents of the log.
    truth, sensor : ImuTruth or None
        Exact samples, and measured ones; None for a turntable.
    errors : ImuErrors or None
        Errors of the sensor, without its noise.
    trajectory : Trajectory or None
        Motion of a vehicle over the Earth.
    rig : HseRigLog or None
        The log of a turntable.
    settings : dict of str to str
        How the log was made, for its Metadata record.
    """

    scenario: scenarios.Scenario
    topics: list[SimulatedTopic]
    truth: ImuTruth | None = None
    sensor: ImuTruth | None = None
    errors: ImuErrors | None = None
    trajectory: Trajectory | None = None
    rig: HseRigLog | None = None
    settings: dict[str, str] = field(init=False)

    def __post_init__(self) -> None:
        settings = {"scenario": name_of(self.scenario)}
        plain = scenarios.Car()
        for name, value in self.scenario:
            # options of a car that have their neutral default are left out
            if value not in (None, ()) and getattr(plain, name, None) != value:
                text = ",".join(map(str, value)) if isinstance(value, tuple) else str(value)
                settings[name] = text
        if self.errors is not None and self.scenario.truth:
            assert isinstance(self.scenario, scenarios.MotionScenario)
            settings |= _error_matrices(self.errors, Axes(self.scenario.body_axes))
        if self.rig is not None:
            settings["lambda2_arcsec"] = repr(lambda2_arcsec(self.rig))
        object.__setattr__(self, "settings", settings)


def _error_matrices(errors: ImuErrors, axes: Axes) -> dict[str, str]:
    """Scale errors and misalignments of sensors that have any, row by row in the log's axes."""
    turn = axes.turn(np.eye(3))
    return {
        f"{sensor}_matrix_ppm": ",".join(f"{x:.6g}" for x in (1e6 * turn.T @ m @ turn).flat)
        for sensor, m in (("gyro", errors.gyro_matrix), ("accel", errors.accel_matrix))
        if np.any(m)
    }


def name_of(scenario: scenarios.Scenario) -> str:
    """The scenario's name on the command line."""
    return next(name for name, kind in scenarios.SCENARIOS.items() if kind is type(scenario))


@dataclass(frozen=True)
class LogFiles:
    """Paths of a simulated log.

    Attributes
    ----------
    rig : Path or None
        File for the rig as its user believes it to be, TOML.
    """

    log: Path
    rig: Path | None = None
    overwrite: bool = False

    def check(self) -> None:
        """Refuse files that could not be written, before anything is computed.

        Raises
        ------
        ConfigurationError
            If the name of the log has the suffix of another format.
        OutputError
            If a file exists or cannot be written.
        """
        check_mcap_name(self.log, of_log=True)
        check_output(self.log, [], self.overwrite)
        if self.rig is not None:
            if self.rig.resolve() == self.log.resolve():
                raise OutputError(f"{self.log} is named twice", "choose another --rig-out")
            check_output(self.rig, [], self.overwrite)


def simulate(scenario: scenarios.Scenario) -> Simulated:
    """Make a log of a scenario.

    Raises
    ------
    ConfigurationError
        If the options do not allow a log.
    """
    try:
        if isinstance(scenario, scenarios.HseRig):
            log = rig_log(scenario)
            return Simulated(scenario, rig_topics(log, scenario.truth), rig=log)
        if isinstance(scenario, scenarios.Vehicle):
            return _vehicle(scenario)
        assert isinstance(scenario, scenarios.MotionScenario)
        return _motion(scenario)
    except ValueError as exc:
        raise ConfigurationError(str(exc)) from exc


def write_log(simulated: Simulated, files: LogFiles) -> dict[str, Any]:
    """Write a log and its rig file, all or nothing.

    Returns
    -------
    dict
        The values of ``--json``.
    """
    with commit_together():
        counts = write_simulated(files.log, simulated.topics, simulated.settings)
        if files.rig is not None and simulated.rig is not None:
            assert isinstance(simulated.scenario, scenarios.HseRig)
            table = rig_table(simulated.rig, simulated.scenario)
            write_whole(files.rig, tomli_w.dumps({"rig": table}))
    return {
        "schema": SCHEMA,
        "output": str(files.log),
        "topics": counts,
        "settings": simulated.settings,
    }


def simulate_one(scenario: scenarios.Scenario, files: LogFiles, _: Any = None) -> dict[str, Any]:
    """One of many logs: the values of ``--json`` with ``seed``, ``status`` and ``exit``.

    Raises
    ------
    SinstoolError
    """
    files.check()
    written = write_log(simulate(scenario), files)
    return {**written, "seed": scenario.seed, "status": "done", "exit": 0}


def _motion(scenario: scenarios.MotionScenario) -> Simulated:
    """Rotation about a point, or rest."""
    truth, perfect = _truth(scenario)
    sensor, errors = measured(perfect, _grade(scenario), scenario.seed)
    topics = _imu_topics(scenario, truth, sensor, errors)
    if isinstance(scenario, scenarios.Static):
        latitude, longitude = np.radians([scenario.latitude, scenario.longitude]).tolist()
        topics.append(resting_fixes(truth.time_ns, (latitude, longitude, scenario.height)))
    return Simulated(scenario, topics, truth, sensor, errors)


def _grade(scenario: scenarios.MotionScenario) -> SensorGrade:
    """The grade of the sensors, with only those kinds of error that are switched on."""
    grade = SIMULATED_GRADES[scenario.grade]
    if isinstance(scenario, scenarios.Launch) and scenario.launch_grade is not None:
        grade = launch_grade(scenario.launch_grade, scenario.accel_unit_reading)
    parts: dict[Part, bool] = {
        "scale": scenario.scale_errors,
        "misalignment": scenario.misalignment,
        "drift": scenario.bias_drift,
    }
    return without(grade, *(part for part, on in parts.items() if not on))


def _truth(s: scenarios.MotionScenario) -> tuple[ImuTruth, ImuTruth]:
    """The truth, and the readings of perfect sensors."""
    if isinstance(s, scenarios.Coning):
        truth = _coning(s)
        return truth, truth
    times = sample_times(s.rate, s.duration, START_NS)
    if isinstance(s, scenarios.ConingPaper):
        return coning_paper(
            times,
            s.noise_frequency,
            phase=s.phase,
            response=paper_response(s.gyro_response),
            half_angle=np.radians(s.half_angle_deg),
            frequency=s.frequency,
            noise_angle=np.radians(s.noise_deg),
        )
    if isinstance(s, scenarios.Static):
        attitude = from_euler(np.radians(s.attitude))
        truth = static(times, attitude, np.radians(s.latitude), s.height)
        return truth, truth
    if isinstance(s, scenarios.TwoFrequency):
        a, b = np.radians(s.half_angles_deg)
        motion = motions.two_frequency((a, b), s.frequencies)
    elif isinstance(s, scenarios.Broadband):
        motion = motions.broadband(float(np.radians(s.angle_deg)), s.band, seed=s.seed)
    else:
        assert isinstance(s, scenarios.Manoeuvre)
        size = float(np.radians(s.rate_rms_deg_s))
        motion = motions.random_manoeuvre(size, s.band, seed=s.seed)
    truth = motions.sample(motion, times)
    return truth, truth


def _coning(s: scenarios.Coning) -> ImuTruth:
    times = sample_times(s.rate, s.duration + s.lead_in, START_NS)
    begin = int(np.searchsorted(times, START_NS + round(s.lead_in * 1e9)))
    if begin >= len(times) - 1:
        raise ConfigurationError("--duration is shorter than one sample interval")
    truth = classical_coning(times[begin:], np.radians(s.half_angle_deg), s.frequency)
    if begin == 0:
        return truth
    # A cone of angle 0 is a rest.
    rest = classical_coning(times[: begin + 1], 0.0, s.frequency, q_nc=truth.q_nb[0])
    return after_rest(truth, rest)


def _vehicle(scenario: scenarios.Vehicle) -> Simulated:
    """A motion over the Earth, with a receiver and a barometer."""
    trajectory = _trajectory(scenario)
    limit = scenario.gyro_range if isinstance(scenario, scenarios.Launch) else None
    sensor, errors = measured(trajectory.imu, _grade(scenario), scenario.seed)
    if isinstance(scenario, scenarios.Drive) and any(scenario.idle):
        standing = np.linalg.norm(trajectory.velocity_n, axis=1) == 0.0
        sensor = idling(sensor, standing, *scenario.idle, scenario.seed + IDLE_SEED)
    if limit is not None:
        sensor = saturated(sensor, limit * DEGREE)
    topics = _imu_topics(scenario, trajectory.imu, sensor, errors, trajectory)
    if scenario.gnss_rate > 0.0:
        topics += _gnss(scenario, trajectory)
    if scenario.baro_rate > 0.0:
        topics.append(_baro(scenario, trajectory))
    if isinstance(scenario, scenarios.Drive):
        topics += _car_topics(scenario, trajectory)
    return Simulated(scenario, topics, trajectory.imu, sensor, errors, trajectory)


def _trajectory(s: scenarios.Vehicle) -> Trajectory:
    place: dict[str, Any] = {
        "latitude": s.latitude * DEGREE,
        "longitude": s.longitude * DEGREE,
        "height": s.height,
        "start_ns": START_NS,
    }
    heading = s.heading * DEGREE
    if isinstance(s, scenarios.Launch):
        return launch.launch(
            s.rate,
            s.duration,
            azimuth=heading,
            dynamics=s.dynamics,
            straight=s.straight,
            pad_s=s.pad,
            **place,
        )
    place["heading"] = heading
    if isinstance(s, scenarios.ManoeuvringFlight):
        return flight.manoeuvring_flight(
            s.duration, s.rate, turbulence=s.turbulence, seed=s.seed, **place
        )
    if isinstance(s, scenarios.Drive):
        return drive.road_drive(
            s.duration, s.rate, still_s=s.still, seed=s.seed, car=_car(s), **place
        )
    assert isinstance(s, scenarios.SpiralClimb)
    return flight.spiral_climb(s.duration, s.rate, **place)


def _car(s: scenarios.Car) -> Car:
    roll, pitch, yaw = (angle * DEGREE for angle in s.mount)
    return Car(
        mount=(roll, pitch, yaw),
        axle_lever=s.axle_lever,
        sideslip=s.sideslip,
        slip=s.slip,
        slip_time=s.slip_time,
        suspension=s.suspension,
        ferry=s.ferry,
    )


def _car_topics(s: scenarios.Drive, trajectory: Trajectory) -> list[SimulatedTopic]:
    """The wheels, and the truth of the car where it differs from that of its IMU."""
    car = _car(s)
    topics = []
    if s.truth and (car != Car() or s.wheels != "none"):
        axle = axle_motion(trajectory, car, trajectory.time_ns)
        topics.append(vehicle_topic(axle, Axes(s.body_axes)))
    if s.wheels != "none":
        sensor = WheelSensor(
            rate_hz=s.wheel_rate,
            scale=0.01 * s.wheel_scale,
            latency_s=s.wheel_latency,
            slip=0.01 * s.wheel_slip,
            slipping=s.wheel_slipping,
            noise=s.wheel_noise,
        )
        readings = wheel_readings(trajectory, car, sensor, s.seed + WHEEL_SEED)
        topics.append(wheel_topic(readings, s.wheels, s.wheel_radius))
    return topics


def _imu_topics(
    scenario: scenarios.MotionScenario,
    truth: ImuTruth,
    sensor: ImuTruth,
    errors: ImuErrors,
    trajectory: Trajectory | None = None,
) -> list[SimulatedTopic]:
    axes = Axes(scenario.body_axes)
    exact = truth_topics(truth, axes, trajectory) if scenario.truth else []
    if scenario.truth and np.any(errors.gyro_bias):
        exact.append(bias_topic(errors, axes))
    return [imu_topic(sensor, scenario.gyro_kind, axes), *exact]


def _spans(texts: tuple[str, ...]) -> tuple[tuple[float, float], ...]:
    return tuple(span(text) for text in texts)


def _gnss(s: scenarios.Vehicle, trajectory: Trajectory) -> list[SimulatedTopic]:
    regular: list[tuple[float, float]] = []
    if s.outages is not None:
        length, every = s.outages
        starts = np.arange(every, s.duration, every).tolist()
        regular = [(start, start + length) for start in starts]
    faults = GnssFaults(
        outages=(*_spans(s.gnss_outage), *regular),
        jumps=tuple(Jump(a, b, (100.0, 0.0, 0.0)) for a, b in _spans(s.gnss_jump)),
        outlier_fraction=s.gnss_outliers,
        outlier_position=100.0,
        outlier_velocity=20.0,
        flat=_spans(s.gnss_flat),
    )
    receiver = Receiver(
        rate_hz=s.gnss_rate,
        offset_s=s.gnss_offset,
        latency_s=s.gnss_latency,
        lever_arm_b=s.lever_arm,
        errors=MODELS[s.gnss_model],
        faults=faults,
    )
    return gnss_topics(gnss_samples(trajectory, receiver, s.seed + GNSS_SEED), s.velocity)


def _baro(s: scenarios.Vehicle, trajectory: Trajectory) -> SimulatedTopic:
    first, last = (int(trajectory.time_ns[k]) for k in (0, -1))
    count = int((last - first) * 1e-9 * s.baro_rate) + 1
    times = first + np.round(np.arange(count) * 1e9 / s.baro_rate).astype(np.int64)
    seconds = (trajectory.time_ns - first) * 1e-9
    height = np.interp((times - first) * 1e-9, seconds, trajectory.height)
    measured, _ = barometer(
        times,
        height,
        sigma=s.baro_sigma,
        correlation_time=s.baro_time,
        white=s.baro_white,
        seed=s.seed + BARO_SEED,
    )
    pressure = pressure_at(geopotential(measured))
    slope = float(np.median(np.abs(height_per_pascal(pressure))))
    return baro_topic(times, pressure, (s.baro_white / slope) ** 2)
