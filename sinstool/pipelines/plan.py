"""The plan for a log: how it is processed, each choice with its reason and the option for it.

`info` prints the plan, `process` and `align` carry it out, and every result holds it;
:mod:`~sinstool.pipelines.planning` makes it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sinstool.core.finding import Finding
from sinstool.methods.alignment.initial import Alignment
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.survey.magnetometer import MagneticTopic

if TYPE_CHECKING:
    from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart

LABELS = {"imu_topic": "IMU topic", "imu_grade": "IMU grade", "imu_noise": "IMU noise"}


@dataclass(frozen=True)
class Choice:
    """One choice of the plan.

    Attributes
    ----------
    value : str
        What is chosen.
    reason : str
        As the end of a sentence: "as the log has ...".
    option : str
        The option that overrides it.
    """

    value: str
    reason: str
    option: str

    @property
    def configured(self) -> bool:
        """Whether the user chose it."""
        return self.reason == "as configured"

    def __str__(self) -> str:
        return f"{self.value}, {self.reason}"


@dataclass(frozen=True)
class Plan:
    """All choices about the processing of a log, each with its reason.

    Attributes
    ----------
    imu_topic : Choice
        The topic.
    mode : Choice
        ``attitude``, ``ins``, ``ins-gnss`` or ``turntable``.
    attitude : Choice
        ``smoothed``, ``inertial``, or ``filtered`` by the INS/GNSS filter.
    gyro_samples : Choice
        ``rate``, ``mean-rate`` or ``increment``.
    magnetometer : Choice
        The topic, or ``none``.
    first_attitude : Choice
        ``level``, ``gyrocompass``, ``log``, ``fixed``, ``level-moving``, a solver in motion such
        as ``svd``, or ``whole-turn`` on a turntable.
    imu_grade : Choice
        The grade of the sensors.
    imu_noise : Choice
        The noise file, or ``of the grade``.
    coning : Choice
        The coning algorithm.
    height_reference : Choice
        ``none``, ``baro`` or ``gnss``.
    wheels : Choice
        The topic with their speeds, or ``none``.
    vehicle : Choice
        Constraints on the motion, in mode ``ins-gnss``: ``land``, ``none``, or ``auto`` if a first
        pass of the filter will decide.
    findings : tuple of Finding
        What had to be given up.
    """

    imu_topic: Choice
    mode: Choice
    attitude: Choice
    gyro_samples: Choice
    magnetometer: Choice
    first_attitude: Choice
    imu_grade: Choice
    imu_noise: Choice
    coning: Choice
    height_reference: Choice
    wheels: Choice
    vehicle: Choice
    _algorithm: ConingAlgorithm | None = None
    _findings: tuple[Finding, ...] = ()
    _alignment: Alignment | None = None
    _filter_start: FilterStart | None = None
    _magnetic: MagneticTopic | None = None

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings about choices that had to be dropped."""
        return self._findings

    @property
    def algorithm(self) -> ConingAlgorithm:
        """The coning algorithm, of every mode but ``turntable``."""
        assert self._algorithm is not None
        return self._algorithm

    @property
    def alignment(self) -> Alignment:
        """The first attitude, of every mode but ``ins-gnss`` and ``turntable``."""
        assert self._alignment is not None
        return self._alignment

    @property
    def filter_start(self) -> FilterStart:
        """First attitude of the filter, in mode ``ins-gnss``."""
        assert self._filter_start is not None
        return self._filter_start

    @property
    def magnetic(self) -> MagneticTopic | None:
        """The magnetometer's topic, where one is used."""
        return self._magnetic

    @property
    def choices(self) -> dict[str, Choice]:
        """The choices by name."""
        return {name: value for name, value in vars(self).items() if isinstance(value, Choice)}

    def rows(self) -> list[tuple[str, str]]:
        """The choices as pairs of label and text, each with the option that overrides it."""
        return [
            (LABELS.get(name, name.replace("_", " ")), f"{choice} ({choice.option})")
            for name, choice in self.choices.items()
        ]
