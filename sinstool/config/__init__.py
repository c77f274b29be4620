"""What a run is told: one model for the command line and the TOML file, validated once.

Each field is an option ``--name`` (underscores become hyphens) and a key of its group's table
in the file; the command line generates its options from these models, so the two cannot part.
"""

from sinstool.config.comparison import COMPARISON_OPTIONS, ComparisonOptions, check_comparison
from sinstool.config.coning import ConingOptions
from sinstool.config.input import InputOptions
from sinstool.config.load import build, dump_toml, load_toml
from sinstool.config.output import EMITS, OutputOptions
from sinstool.config.rig import CalibrationOptions
from sinstool.config.run import ALIGN_OPTIONS, PROCESS_OPTIONS, ProcessConfig
from sinstool.config.times import parse_time

__all__ = [
    "ALIGN_OPTIONS",
    "COMPARISON_OPTIONS",
    "EMITS",
    "PROCESS_OPTIONS",
    "CalibrationOptions",
    "ComparisonOptions",
    "ConingOptions",
    "InputOptions",
    "OutputOptions",
    "ProcessConfig",
    "build",
    "check_comparison",
    "dump_toml",
    "load_toml",
    "parse_time",
]
