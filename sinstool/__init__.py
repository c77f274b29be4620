"""Turn recorded IMU logs into attitude, velocity and position.

The conventions below hold in every module and are stated only here.

Frames
    ``i`` inertial, ``e`` Earth (WGS-84), ``n`` navigation = North-East-Down (NED),
    ``b`` body = Forward-Right-Down (FRD). ``C_nb`` and ``q_nb`` take a vector from ``b``
    to ``n``: ``v_n = C_nb @ v_b``. A vector has its frame as a suffix and the frames
    that it relates as subscripts: ``omega_ib_b`` is the rate of ``b`` against ``i``, in ``b``.

    Logs follow REP-103 (body Forward-Left-Up, world East-North-Up). The code that reads
    streams and the code that writes solutions convert them; no other code does.
    If nothing in a log references heading to north, heading starts at 0 and the attitude is
    in the frame ``odom``; a north-referenced attitude is in ``map``.

Quaternions
    Hamilton, unit, scalar first ``[w, x, y, z]``. ROS messages are scalar last
    and are converted on reading and writing. ``q_nb`` composes on the right with body rotations:
    ``q_nb(k+1) = q_nb(k) * exp(rotation_vector)``.

Angles
    Roll, pitch, heading are the 3-2-1 Euler angles of FRD in NED: heading positive from
    North to East, pitch positive nose up, roll positive right wing down.

Gravity
    An accelerometer measures specific force, acceleration less gravity: at rest 9.8 m/s^2 upward,
    so +9.8 on z of a Forward-Left-Up log and -9.8 on z of a Forward-Right-Down one. Logs whose
    driver has removed gravity are good for attitude only.

Units
    SI and radians internally. Degrees, deg/h and arc seconds appear only on the command line
    and in reports, where the unit is part of the name.

Height
    Ellipsoidal, metres, positive up. The ``down`` of NED is negative height change.

Time
    ``int64`` nanoseconds throughout. Seconds as ``float64`` appear only
    as differences of two times.

Samples
    ``increment``: sample k is the integral of angular rate (or specific force) over
    (t[k-1], t[k]]. ``mean-rate``: that integral divided by the interval. ``rate``: the
    value at the instant t[k]. They are not interchangeable. The attitude at t[k] is that at
    the end of the interval.
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
