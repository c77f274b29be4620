"""The page of figures of `sinstool simulate`."""

from __future__ import annotations

import inspect
from pathlib import Path

import numpy as np

from sinstool.core.english import counted
from sinstool.core.options import Group
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.report.figure import Figure
from sinstool.report.figures import simulation as draw
from sinstool.report.pages.settings import config_settings, input_rows, read_file
from sinstool.report.sections import Column, Fact, Page, Prose, Section, Settings, Table
from sinstool.simulation.log import BARO_TOPIC, FIX_TOPIC
from sinstool.simulation.make import Simulated
from sinstool.simulation.rig_log import lambda2_arcsec
from sinstool.simulation.wheels import WHEEL_TOPIC

ABOUT = {
    "/imu/data_raw": "sensor data",
    "/truth/imu": "exact attitude, rates and specific force",
    "/truth/odometry": "exact attitude, place on a plane and velocity",
    "/truth/bias": "exact biases of the sensors",
    "/truth/fix": "exact place on the Earth",
    "/truth/vehicle": "exact attitude of the vehicle, place and velocity of its rear axle",
    FIX_TOPIC: "the receiver's positions",
    "/gnss/velocity": "the receiver's velocities",
    BARO_TOPIC: "the barometer's pressures",
    "/joint_states": "the encoder's angles",
    WHEEL_TOPIC: "speeds of the wheels",
}


def simulation_page(simulated: Simulated, config: Group, output: Path) -> Page:
    """The page of a simulated log.

    Parameters
    ----------
    config : Group
        With the scenario as its table ``simulate``.
    output : Path
        The log, as written.
    """
    scenario, topics = simulated.scenario, simulated.topics
    figures, facts = _rig(simulated) if simulated.rig is not None else _motion(simulated)
    time_ns = topics[0].time_ns
    seconds = (int(time_ns[-1]) - int(time_ns[0])) / SECOND
    about = (inspect.getdoc(type(scenario)) or "").split("\n\n")[0].replace("\n", " ")
    first = Fact(
        "Length", f"{seconds:.6g} s", f"{counted(len(time_ns), 'sample')} at {scenario.rate:g} Hz"
    )
    rows = tuple((t.topic, t.type_name, len(t.time_ns), ABOUT[t.topic]) for t in topics)
    columns = (Column("Topic"), Column("type"), Column("messages"), Column("holds"))
    sections: tuple[Section, ...] = (
        Prose((about,), "Result", (first, *facts)),
        *figures,
        Table("Output", columns, rows),
        Settings(config_settings(config, "simulate")),
        input_rows([read_file(output)], "Output"),
    )
    return Page(f"A simulated log: {simulated.settings['scenario']}", output.name, sections)


def _motion(simulated: Simulated) -> tuple[list[Figure], list[Fact]]:
    truth, trajectory = simulated.truth, simulated.trajectory
    assert truth is not None and simulated.sensor is not None
    figures = list(draw.motion_figures(truth, simulated.sensor, trajectory))
    if trajectory is not None:
        for topic in simulated.topics:
            rows = slice(0, len(topic.time_ns))
            if topic.topic == FIX_TOPIC:
                figures += draw.fix_figures(topic.time_ns, topic.columns(rows), trajectory)
            elif topic.topic == BARO_TOPIC:
                pressure = topic.columns(rows)["fluid_pressure"]
                figures += draw.baro_figures(topic.time_ns, pressure, trajectory)
    rate = np.linalg.norm(truth.gyro_rate, axis=1).max() / DEGREE
    force = np.linalg.norm(truth.specific_force, axis=1).max()
    facts = [
        Fact("Fastest rotation", f"{rate:.4g} deg/s"),
        Fact("Largest specific force", f"{force:.4g} m/s²"),
    ]
    if trajectory is not None:
        speed = np.linalg.norm(trajectory.velocity_n, axis=1)
        way = float(np.sum(0.5 * (speed[1:] + speed[:-1]) * np.diff(truth.time_ns)) / SECOND)
        low, high = trajectory.height.min(), trajectory.height.max()
        facts += [
            Fact("Way", f"{way / 1000.0:.4g} km", f"at most {speed.max():.4g} m/s"),
            Fact("Height", f"{low:.4g}–{high:.4g} m", "above the ellipsoid"),
        ]
    settings = simulated.settings
    grade = settings["grade"]
    if "launch_grade" in settings:
        grade = f"{settings['launch_grade']} deg/h"
    facts.append(Fact("Sensors", grade, f"gyro samples: {settings['gyro_kind']}"))
    return figures, facts


def _rig(simulated: Simulated) -> tuple[list[Figure], list[Fact]]:
    log, settings = simulated.rig, simulated.settings
    assert log is not None
    facts = [
        Fact("lambda2", f"{lambda2_arcsec(log):.4f} arcsec", "true values for a calibration"),
        Fact("Lean to the east", f"{log.truth.C23:.4g} rad", "C23, of the axis"),
        Fact("Heading of the base", f"{log.truth.heading / DEGREE:.4f} deg"),
        Fact("Rates", f"{settings['rates']} deg/s", f"{settings['plateau']} s at each"),
    ]
    return list(draw.rig_figures(log)), facts
