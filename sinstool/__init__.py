"""Turn recorded IMU logs into attitude, velocity and position.

Frames, axes, quaternions, units and time: see :mod:`sinstool.core.conventions`.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

from sinstool.core.version import VERSION as __version__

if TYPE_CHECKING:
    from sinstool.api import coning
    from sinstool.api.allan import allan
    from sinstool.api.arrays import integrate, navigate
    from sinstool.api.commands import align, calibrate_hse, compare_coning, survey
    from sinstool.api.log import Log, open_log
    from sinstool.api.process import Result, process
    from sinstool.api.simulate import simulate
    from sinstool.core.errors import SinstoolError
    from sinstool.core.streams import Imu

__all__ = [
    "Imu",
    "Log",
    "Result",
    "SinstoolError",
    "__version__",
    "align",
    "allan",
    "calibrate_hse",
    "compare_coning",
    "coning",
    "integrate",
    "navigate",
    "open_log",
    "process",
    "simulate",
    "survey",
]

# Where each name comes from. It is imported when it is used, so that `import sinstool` costs
# nothing; a colon parts a module and what is in it.
_HOMES = {
    "Imu": "sinstool.core.streams:Imu",
    "Log": "sinstool.api.log:Log",
    "Result": "sinstool.api.process:Result",
    "SinstoolError": "sinstool.core.errors:SinstoolError",
    "align": "sinstool.api.commands:align",
    "allan": "sinstool.api.allan:allan",
    "calibrate_hse": "sinstool.api.commands:calibrate_hse",
    "compare_coning": "sinstool.api.commands:compare_coning",
    "coning": "sinstool.api.coning",
    "integrate": "sinstool.api.arrays:integrate",
    "navigate": "sinstool.api.arrays:navigate",
    "open_log": "sinstool.api.log:open_log",
    "process": "sinstool.api.process:process",
    "simulate": "sinstool.api.simulate:simulate",
    "survey": "sinstool.api.commands:survey",
}


if not TYPE_CHECKING:  # a type checker would take any name for one that is there

    def __getattr__(name: str) -> Any:
        home = _HOMES.get(name)
        if home is None:
            raise AttributeError(f"module 'sinstool' has no attribute {name!r}")
        module, _, member = home.partition(":")
        value = import_module(module)
        if member:
            value = getattr(value, member)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _Package(ModuleType):
    """The package, in which no room takes the place of a function of its name.

    Importing ``sinstool.survey.imu`` would otherwise set ``sinstool.survey``, which is a function.
    """

    def __setattr__(self, name: str, value: Any) -> None:
        if isinstance(value, ModuleType) and name in _HOMES:
            return
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
