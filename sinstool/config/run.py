"""Everything one command is told: its groups of options, and whether they fit each other."""

from __future__ import annotations

from sinstool.config.align import AlignOptions
from sinstool.config.coning import ConingOptions, check_coning
from sinstool.config.group import Group
from sinstool.config.input import InputOptions
from sinstool.config.navigation import NavigationOptions
from sinstool.config.output import OutputOptions


class ProcessConfig(Group):
    """Everything `sinstool process` is told."""

    input: InputOptions = InputOptions()
    coning: ConingOptions = ConingOptions()
    align: AlignOptions = AlignOptions()
    navigation: NavigationOptions = NavigationOptions()
    output: OutputOptions = OutputOptions()

    def check(self) -> None:
        """Whether the options fit each other."""
        check_coning(self.coning)
        self.align.check()
