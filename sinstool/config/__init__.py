"""Options of a run: one model for the command line and the TOML file, validated once.

Each field is an option ``--name`` (underscores become hyphens) and a key of its group's table
in the file; the command line generates its options from these models, so the two cannot part.
"""

from __future__ import annotations

from sinstool.config.align import AlignOptions, GnssOptions, InFlightOptions
from sinstool.config.coning import ComparisonOptions, ConingOptions, check_coning
from sinstool.config.export import ExportOptions
from sinstool.config.logs import GNSS_INPUT, IMU_INPUT, InputOptions, OutputOptions
from sinstool.config.navigation import FilterOptions, HeightOptions, NavigationOptions
from sinstool.config.rig import CalibrationOptions, HseOptions, RigTable
from sinstool.config.unused import listed, unused_options
from sinstool.core.errors import ConfigurationError
from sinstool.core.options import Group

# What `info`, `allan`, `align`, `process` and `export` take, in the order of their help
INFO_OPTIONS = ("input",)
ALLAN_OPTIONS = (*IMU_INPUT, *GNSS_INPUT)
ALIGN_OPTIONS = (
    *IMU_INPUT,
    *GNSS_INPUT,
    "align",
    "gnss",
    "in_flight",
    "navigation.imu_grade",
    "navigation.imu_noise",
    "output.overwrite",
)
PROCESS_OPTIONS = (
    "navigation",
    "input",
    "coning",
    "align",
    "gnss",
    *(f"in_flight.{name}" for name in InFlightOptions.model_fields if name != "at"),
    "filter",
    "vertical",
    "hse",
    "output",
)
EXPORT_OPTIONS = (
    "export",
    "input.start",
    "input.end",
    "input.salvage",
    "output.overwrite",
)


class ProcessConfig(Group):
    """The configuration of a run; each command takes the groups that concern it.

    One file can thus serve `calibrate-hse` and `process` of the same rig.
    """

    input: InputOptions = InputOptions.model_construct()
    coning: ConingOptions = ConingOptions.model_construct()
    align: AlignOptions = AlignOptions.model_construct()
    gnss: GnssOptions = GnssOptions.model_construct()
    in_flight: InFlightOptions = InFlightOptions.model_construct()
    navigation: NavigationOptions = NavigationOptions.model_construct()
    vertical: HeightOptions = HeightOptions.model_construct()
    filter: FilterOptions = FilterOptions.model_construct()
    hse: HseOptions = HseOptions.model_construct()
    rig: RigTable | None = None
    calibration: CalibrationOptions = CalibrationOptions.model_construct()
    comparison: ComparisonOptions = ComparisonOptions.model_construct()
    output: OutputOptions = OutputOptions.model_construct()
    export: ExportOptions = ExportOptions.model_construct()

    def check(self) -> None:
        """Whether the options fit each other."""
        check_coning(self.coning)
        self.align.check()
        self.in_flight.check()
        self.navigation.check()
        for name in ("arw", "vrw"):
            if self.navigation.imu_noise is not None and getattr(self.in_flight, name) is not None:
                raise ConfigurationError(
                    f"--imu-noise and --{name} both say how noisy the IMU is",
                    "leave one of them out",
                )
        self.vertical.check()
        self.filter.check()
        if self.hse.hse is not None and self.rig is None:
            raise ConfigurationError(
                "--hse needs the rig that was calibrated",
                "give its table [rig] with --config RIG.toml",
            )
        self._check_effects()

    def _check_effects(self) -> None:
        """Whether every option has an effect; in mode auto that is known with the log only."""
        mode = self.navigation.mode
        unused = {} if mode == "auto" else unused_options(self, mode)
        if unused:
            used_by = " or ".join(dict.fromkeys(m for modes in unused.values() for m in modes))
            raise ConfigurationError(
                f"{listed(list(unused))} no effect with --mode {mode}",
                f"leave out what is not needed, or choose --mode {used_by}",
            )
