"""The page of figures of `sinstool simulate`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.report.figure import Figure
from sinstool.report.figures.simulation import (
    baro_figures,
    fix_figures,
    motion_figures,
    rig_figures,
)
from sinstool.report.page import write_report
from sinstool.report.pages.settings import Read, input_rows, option_settings
from sinstool.report.sections import (
    Column,
    Fact,
    Page,
    Prose,
    Section,
    Settings,
    Table,
)
from sinstool.simulation.log import BARO_TOPIC, FIX_TOPIC, SimulatedTopic

if TYPE_CHECKING:
    from sinstool.simulation.hse_rig import HseRigLog
    from sinstool.simulation.trajectory import Trajectory
    from sinstool.simulation.truth import ImuTruth

ABOUT = {
    "/imu/data_raw": "what the sensors measured",
    "/truth/imu": "exact attitude, rates and specific force",
    "/truth/odometry": "exact attitude, place on a plane and velocity",
    "/truth/fix": "exact place on the Earth",
    FIX_TOPIC: "the receiver's positions",
    "/gnss/velocity": "the receiver's velocities",
    BARO_TOPIC: "the barometer's pressures",
    "/joint_states": "the encoder's angles",
}


def write_motion(
    told: Mapping[str, Any],
    truth: ImuTruth,
    sensor: ImuTruth,
    topics: Sequence[SimulatedTopic],
    trajectory: Trajectory | None = None,
) -> None:
    """Write the page, or its first figure, that ``--report`` asks for.

    Parameters
    ----------
    told : mapping
        Options of the command line.
    truth, sensor : ImuTruth
        Exact, and as measured.
    topics : sequence of SimulatedTopic
        As written.
    trajectory : Trajectory, optional
        Where the vehicle is.
    """
    figures = list(motion_figures(truth, sensor, trajectory))
    if trajectory is not None:
        for topic in topics:
            rows = slice(0, len(topic.time_ns))
            if topic.topic == FIX_TOPIC:
                figures += fix_figures(topic.time_ns, topic.columns(rows), trajectory)
            elif topic.topic == BARO_TOPIC:
                pressure = topic.columns(rows)["fluid_pressure"]
                figures += baro_figures(topic.time_ns, pressure, trajectory)
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
    grade = told.get("launch_grade") or told["grade"]
    unit = " deg/h" if told.get("launch_grade") else ""
    facts.append(Fact("Sensors", f"{grade}{unit}", f"gyro samples: {told['gyro_kind']}"))
    _write(told, truth.time_ns, figures, facts, topics)


def write_rig(told: Mapping[str, Any], log: HseRigLog, topics: Sequence[SimulatedTopic]) -> None:
    """Write the page of a turntable's log.

    Parameters
    ----------
    told : mapping
        Options of the command line.
    topics : sequence of SimulatedTopic
        As written.
    """
    arcsec = DEGREE / 3600.0
    facts = [
        Fact("lambda2", f'{log.truth.lambda2 / arcsec:.4f}"', "what a calibration has to find"),
        Fact("Lean to the east", f"{log.truth.C23:.4g} rad", "C23, of the axis"),
        Fact("Heading of the base", f"{log.truth.heading / DEGREE:.4f} deg"),
        Fact("Rates", f"{', '.join(told['rates'])} deg/s", f"{told['plateau']:g} s at each"),
    ]
    _write(told, log.time_ns, rig_figures(log), facts, topics)


def _write(
    told: Mapping[str, Any],
    time_ns: np.ndarray,
    figures: Sequence[Figure],
    facts: Sequence[Fact],
    topics: Sequence[SimulatedTopic],
) -> None:
    command = click.get_current_context().command
    seconds = (int(time_ns[-1]) - int(time_ns[0])) / SECOND
    about = (command.help or "").split("\n\n")[0].replace("\n", " ")
    first = Fact("Length", f"{seconds:.6g} s", f"{len(time_ns)} samples at {told['rate']:g} Hz")
    rows = tuple((t.topic, t.type_name, len(t.time_ns), ABOUT[t.topic]) for t in topics)
    columns = (Column("Topic"), Column("type"), Column("messages"), Column("holds"))
    sections: tuple[Section, ...] = (
        Prose((about,), "Result", (first, *facts)),
        *figures,
        Table("What was written", columns, rows),
        Settings(option_settings(command, told)),
        input_rows([Read.of(told["output"])], "Output"),
    )
    page = Page(f"A simulated log: {command.name}", Path(told["output"]).name, sections)
    write_report(told["report"], page, inputs=[told["output"]], overwrite=told["overwrite"])
