"""Names of the coning algorithms, and how each is built.

One line per family: a pattern for its names, the function that builds an algorithm (imported only
when it is used, so that listing the names is cheap), the names shown to users, and the options that
it takes.

Other distributions add algorithms with an entry point of the group ``sinstool.coning``, and
programs with `register`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from sinstool.core import plugins
from sinstool.core.errors import ConfigurationError
from sinstool.core.suggest import nearest

if TYPE_CHECKING:
    from sinstool.methods.coning.algorithm import ConingAlgorithm


class Family(NamedTuple):
    """Algorithms that one function builds, from the numbers in their names.

    Attributes
    ----------
    pattern : str
        Regular expression of a whole name; its groups are numbers and the arguments.
    builder : str
        ``module:function`` inside :mod:`sinstool.methods.coning`.
    names : tuple of str
        Shown to users; the pattern may allow more.
    options : tuple of str
        Keyword options of the function.
    """

    pattern: str
    builder: str
    names: tuple[str, ...]
    options: tuple[str, ...] = ()


FAMILIES = (
    Family(r"uncompensated", "lags:uncompensated", ("uncompensated",)),
    Family(r"previous-([1-9])", "lags:previous", ("previous-1", "previous-2", "previous-3")),
    Family(
        r"optimal-([2-9])(?:-previous-([1-9]))?",
        "lags:optimal",
        tuple(f"optimal-{n}" for n in range(2, 7)),
    ),
    Family(r"savage-(4)", "lags:optimal", ("savage-4",)),
    Family(r"savage-two-speed(?:-(\d+))?", "savage:two_speed", ("savage-two-speed",)),
    Family(
        r"singular-perturbation",
        "singular_perturbation:SingularPerturbation",
        ("singular-perturbation",),
        options=("variant", "preset", "epsilon", "beta_gain", "beta"),
    ),
    Family(r"picard-(\d+)", "picard:picard", ("picard-4", "picard-8")),
    Family(r"quatfiter-(\d+)", "quatfiter:quatfiter", ("quatfiter-4", "quatfiter-8")),
    Family(r"lookahead-(\d+)", "lookahead:Lookahead", ("lookahead-8", "lookahead-12")),
    Family(
        r"gyro-tuned",
        "gyro_tuned:GyroTuned",
        ("gyro-tuned",),
        options=("passband", "stopband", "gyro_response", "interval", "lags"),
    ),
)


GROUP = "sinstool.coning"
_registered: dict[str, Callable[[], ConingAlgorithm]] = {}


def register(name: str, build: Callable[[], ConingAlgorithm]) -> None:
    """Register an algorithm under a name, in this process.

    Parameters
    ----------
    name : str
        As for ``--coning``: small letters, digits and hyphens.
    build : callable
        Returns a new :class:`~sinstool.methods.coning.algorithm.ConingAlgorithm`; may be the class
        itself, if it takes no arguments. Replaces what was registered under the name before.

    Raises
    ------
    ConfigurationError
        sinstool has an algorithm of that name itself, or the name has other characters.
    """
    if re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", name) is None:
        raise ConfigurationError(
            f"{name!r} cannot name a coning algorithm", "use small letters, digits and hyphens"
        )
    if _own(name):
        raise ConfigurationError(
            f"{name} is one of sinstool's own coning algorithms", "choose another name"
        )
    _registered[name] = build


def all_names() -> tuple[str, ...]:
    """Names of sinstool's own algorithms, and of those of programs and other distributions."""
    return tuple(dict.fromkeys((*names(), *_registered, *plugins.plugins(GROUP))))


def names() -> tuple[str, ...]:
    """Names of sinstool's own coning algorithms, as on the command line.

    Returns
    -------
    tuple of str
        In the order of the registry.
    """
    return tuple(name for family in FAMILIES for name in family.names)


def algorithm(name: str, **options: Any) -> ConingAlgorithm:
    """Build a coning algorithm by name.

    Parameters
    ----------
    name : str
        One of :func:`names`, or another member of a numbered family.
    **options
        Options of the algorithm; ``singular-perturbation`` and ``gyro-tuned`` have some, see
        :class:`~sinstool.methods.coning.singular_perturbation.SingularPerturbation` and
        :class:`~sinstool.methods.coning.gyro_tuned.GyroTuned`.

    Returns
    -------
    ConingAlgorithm
        Ready for :meth:`~sinstool.methods.coning.algorithm.ConingAlgorithm.rotation_vectors`.

    Raises
    ------
    ConfigurationError
        If the name is unknown, the algorithm has no such option, or a value is impossible.
    """
    for family in FAMILIES:
        match = re.fullmatch(family.pattern, name)
        if match is None:
            continue
        strange = sorted(set(options) - set(family.options))
        if strange:
            raise ConfigurationError(
                f"coning algorithm {name} has no option {', '.join(strange)}", _whose(strange)
            )
        module, _, function = family.builder.partition(":")
        build = getattr(import_module(f"sinstool.methods.coning.{module}"), function)
        numbers = [int(group) for group in match.groups() if group is not None]
        return cast("ConingAlgorithm", build(*numbers, **options))
    if name in _registered or name in plugins.plugins(GROUP):
        return _foreign(name, options)
    there_are = all_names()
    near = nearest(name, there_are)
    hint = f"there are {', '.join(there_are)}, and most numbered ones with other numbers too"
    raise ConfigurationError(
        f"unknown coning algorithm {name!r}", f"{near} {hint.capitalize()}" if near else hint
    )


def _foreign(name: str, options: dict[str, Any]) -> ConingAlgorithm:
    """An algorithm that is not sinstool's own; it has no options."""
    from sinstool.methods.coning.algorithm import ConingAlgorithm

    if options:
        raise ConfigurationError(
            f"coning algorithm {name} has no option {', '.join(sorted(options))}", "leave it out"
        )
    made = _registered[name] if name in _registered else plugins.load(GROUP, name)
    try:
        built = made()
    except Exception as exc:  # whatever the code of somebody else does
        raise ConfigurationError(
            f"coning algorithm {name} cannot be built: {type(exc).__name__}: {exc}"
        ) from exc
    if not isinstance(built, ConingAlgorithm):
        raise ConfigurationError(
            f"coning algorithm {name} is a {type(built).__name__}",
            "it must be a subclass of sinstool.coning.ConingAlgorithm, or return one",
        )
    return built


def _own(name: str) -> bool:
    return any(re.fullmatch(family.pattern, name) for family in FAMILIES)


def options_of(name: str) -> tuple[str, ...]:
    """Keyword options of an algorithm; those of other distributions have none."""
    return next((f.options for f in FAMILIES if re.fullmatch(f.pattern, name)), ())


def origin(name: str) -> str:
    """Where an algorithm comes from.

    Returns
    -------
    str
        Distribution and version; '' for sinstool's own.
    """
    if _own(name):
        return ""
    if name in _registered:
        return "registered by the program"
    dist = plugins.plugins(GROUP)[name].dist
    return "" if dist is None else f"{dist.name} {dist.version}"


def _whose(options: list[str]) -> str:
    """Say which algorithms have these options."""
    owners = [f.names[0] for f in FAMILIES if set(options) <= set(f.options)]
    if not owners:
        return "leave it out"
    return f"leave it out, or choose {' or '.join(owners)}"
