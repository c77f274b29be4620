"""Options that have no effect in a mode, so that none is silently ignored."""

from __future__ import annotations

from collections.abc import Iterator

from sinstool.core.options import Group

# All but that of a system that turns on its table
_NAVIGATION = ("attitude", "ins", "ins-gnss")
# Modes in which an option, or a whole group of them, has an effect; all others have one in each
USED_IN: dict[str, tuple[str, ...]] = {
    "navigation.attitude": ("attitude",),
    "navigation.motion": ("attitude",),
    "navigation.magnetometer": ("attitude",),
    "navigation.declination": ("attitude",),
    "navigation.initial_velocity": ("ins",),
    "navigation.attitude_order": ("ins",),
    "input.wheels": ("ins-gnss",),
    "filter": ("ins-gnss",),
    "navigation.imu_grade": _NAVIGATION,
    "navigation.imu_noise": _NAVIGATION,
    "align": _NAVIGATION,
    "in_flight": _NAVIGATION,
    "vertical": _NAVIGATION,
    "coning": _NAVIGATION,
}
# Who asks for nothing gets it in every mode
NOTHING = ("none", "off")


def unused_options(config: Group, mode: str) -> dict[str, tuple[str, ...]]:
    """Options that differ from their default and have no effect in a mode.

    Parameters
    ----------
    mode : str
        ``attitude``, ``ins``, ``ins-gnss`` or ``turntable``.

    Returns
    -------
    dict
        The modes that would use them, by flag.
    """
    return {
        "--" + name.replace("_", "-"): modes
        for name, value, default, modes in _chosen(config)
        if mode not in modes and value != default and value not in NOTHING
    }


def _chosen(config: Group) -> Iterator[tuple[str, object, object, tuple[str, ...]]]:
    for path, modes in USED_IN.items():
        for table, name, field in type(config).options(path):
            yield name, getattr(getattr(config, table), name), field.default, modes


def listed(flags: list[str]) -> str:
    """Flags as the subject of a sentence: "--a, --b and --c have"."""
    if len(flags) == 1:
        return f"{flags[0]} has"
    return f"{', '.join(flags[:-1])} and {flags[-1]} have"
