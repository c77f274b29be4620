"""What a run is told: one model for the command line and the TOML file, validated once.

Each field is an option ``--name`` (underscores become hyphens) and a key of its group's table
in the file; the command line generates its options from these models, so the two cannot part.
"""

from sinstool.config.align import AlignOptions, GnssOptions, InFlightOptions
from sinstool.config.comparison import COMPARISON_OPTIONS, ComparisonOptions, check_comparison
from sinstool.config.coning import ConingOptions
from sinstool.config.filter import FilterOptions
from sinstool.config.input import InputOptions
from sinstool.config.load import build, dump_toml, load_toml
from sinstool.config.navigation import HeightOptions, NavigationOptions
from sinstool.config.output import EMITS, OutputOptions
from sinstool.config.rig import CalibrationOptions, HseOptions
from sinstool.config.run import ProcessConfig
from sinstool.config.times import parse_time
from sinstool.core.options import Group

__all__ = [
    "COMPARISON_OPTIONS",
    "EMITS",
    "AlignOptions",
    "CalibrationOptions",
    "ComparisonOptions",
    "ConingOptions",
    "FilterOptions",
    "GnssOptions",
    "Group",
    "HeightOptions",
    "HseOptions",
    "InFlightOptions",
    "InputOptions",
    "NavigationOptions",
    "OutputOptions",
    "ProcessConfig",
    "build",
    "check_comparison",
    "dump_toml",
    "load_toml",
    "parse_time",
]
