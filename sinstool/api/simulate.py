"""Simulated logs with exact truth, as columns or as a file."""

from __future__ import annotations

import tempfile
import weakref
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sinstool.api.log import Log, frozen, open_log
from sinstool.api.options import PathLike, configured_by, path_of
from sinstool.core.errors import ConfigurationError
from sinstool.core.streams import Baro, BaroHeight, GnssEpochs, Imu, Solution
from sinstool.core.suggest import nearest

if TYPE_CHECKING:
    from sinstool.simulation.make import Simulated as Made


class Simulated:
    """A simulated log; made by `simulate`.

    Its sensors are what reading the log gives, so that a file and columns are the same.

    Attributes
    ----------
    settings : dict of str to str
        What it was made from.
    """

    def __init__(self, made: Made) -> None:
        self._made = made
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self.settings = dict(made.settings)

    def imu(self) -> Imu:
        """Samples with their errors; see ``Log.imu``. Increments are given as mean rates."""
        with self._log() as log:
            return log.imu("/imu/data_raw")

    def gnss(self) -> GnssEpochs:
        """Positions and velocities of the receiver; see ``Log.gnss``.

        Raises
        ------
        TopicError
            The scenario has no receiver.
        """
        with self._log() as log:
            return log.gnss()

    def barometer(self) -> Baro | BaroHeight:
        """Pressures; see ``Log.barometer``.

        Raises
        ------
        TopicError
            The scenario has no barometer.
        """
        with self._log() as log:
            return log.barometer()

    @property
    def truth(self) -> Solution:
        """The true motion at the samples of the IMU: ``q_nb``, and where it moves over the Earth
        ``position`` and ``velocity_n``.

        Raises
        ------
        ConfigurationError
            The scenario is a turntable, whose truth is its angle.
        """
        made = self._made
        if made.truth is None:
            raise ConfigurationError(
                "a turntable has no true motion in columns", "write the log, with truth=True"
            )
        true, track = made.truth, made.trajectory
        position = velocity = None
        if track is not None:
            position = np.stack([track.latitude, track.longitude, track.height], axis=1)
            velocity = track.velocity_n
        times = true.time_ns
        return frozen(
            Solution(
                times, times, true.q_nb, true.gyro_rate, true.specific_force, position, velocity
            )
        )

    def write(self, path: PathLike, *, overwrite: bool = False) -> Path:
        """Write the log as MCAP, as ``sinstool simulate`` does.

        Parameters
        ----------
        overwrite : bool, optional
            Replace an existing file.

        Returns
        -------
        pathlib.Path

        Raises
        ------
        OutputError
            The file exists, or cannot be written.
        """
        from sinstool.simulation import make

        target = path_of(path, "output")
        files = make.LogFiles(target, None, overwrite)
        files.check()
        make.write_log(self._made, files)
        return target

    def __repr__(self) -> str:
        made = ", ".join(f"{name} {value}" for name, value in self.settings.items())
        return f"<Simulated: {made}>"

    def _log(self) -> Log:
        """The log, in a folder that goes when this object does."""
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="sinstool-")
            # Before its own finaliser, which warns
            weakref.finalize(self, self._folder.cleanup)
            self.write(Path(self._folder.name) / "simulated.mcap")
        conventions = {name: self.settings.get(name) for name in ("body_axes", "gyro_kind")}
        return open_log(Path(self._folder.name) / "simulated.mcap", **conventions)


def simulate(scenario: str, output: PathLike | None = None, **options: Any) -> Simulated:
    """Simulate a log with exact truth, as ``sinstool simulate`` does.

    Parameters
    ----------
    scenario : str
        ``coning``, ``static``, ``drive``, ``spiral-climb``, ``manoeuvring-flight``, ``launch``,
        ``hse-rig`` and the others of ``sinstool simulate --help``.
    output : path-like, optional
        MCAP to write. By default no file is written.
    **options
        The scenario's options: ``rate=400``, ``duration=60.0``, ``grade="mems"``, ``seed=1``.

    Returns
    -------
    Simulated
        ``imu()``, ``gnss()``, ``barometer()``, ``truth``, ``write(path)``.

    Raises
    ------
    ConfigurationError
        There is no such scenario or option, or no such log can be made.
    OutputError
        The file exists, or cannot be written.

    Examples
    --------
    >>> import sinstool
    >>> cone = sinstool.simulate("coning", duration=2.0, half_angle_deg=1.0)
    >>> len(cone.imu()), cone.truth.q_nb.shape
    (801, (801, 4))
    """
    from pydantic import create_model

    from sinstool.core.options import Group
    from sinstool.simulation import make
    from sinstool.simulation.scenarios import SCENARIOS

    kind = SCENARIOS.get(str(scenario))
    if kind is None:
        near = nearest(str(scenario), SCENARIOS)
        raise ConfigurationError(
            f"there is no scenario {scenario!r}", near or f"there are {', '.join(SCENARIOS)}"
        )
    model = create_model("Simulation", __base__=Group, simulate=(kind, kind()))
    config: Any = configured_by(model, f"scenario {scenario}", ("simulate",), options)
    config.simulate.check()
    made = Simulated(make.simulate(config.simulate))
    if output is not None:
        made.write(output)
    return made
