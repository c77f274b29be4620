"""Names of the coning algorithms, and how each is built.

One line per family: a pattern for its names, the function that builds one (imported only
when asked for, so that naming algorithms costs nothing), the names shown to users, and
whether it takes the singular-perturbation options.
"""

from __future__ import annotations

import difflib
import re
from importlib import import_module
from typing import Any, NamedTuple, cast

from sinstool.coning.algorithm import ConingAlgorithm
from sinstool.errors import ConfigurationError


class Family(NamedTuple):
    """Algorithms that one function builds, from the numbers in their names.

    Attributes
    ----------
    pattern : str
        Regular expression of a whole name; its groups are numbers and the arguments.
    builder : str
        ``module:function`` inside :mod:`sinstool.coning`.
    names : tuple of str
        Shown to users; the pattern may allow more.
    options : bool
        Whether the function takes keyword options.
    """

    pattern: str
    builder: str
    names: tuple[str, ...]
    options: bool = False


FAMILIES = (
    Family(r"uncompensated", "lags:uncompensated", ("uncompensated",)),
    Family(r"previous-([1-3])", "lags:previous", ("previous-1", "previous-2", "previous-3")),
    Family(r"optimal-([2-6])", "lags:optimal", tuple(f"optimal-{n}" for n in range(2, 7))),
    Family(r"savage-(4)", "lags:optimal", ("savage-4",)),
    Family(r"savage-two-speed(?:-(\d+))?", "savage:two_speed", ("savage-two-speed",)),
    Family(
        r"singular-perturbation",
        "singular_perturbation:SingularPerturbation",
        ("singular-perturbation",),
        options=True,
    ),
)


def names() -> tuple[str, ...]:
    """Names of all coning algorithms, as on the command line.

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
        Options of the algorithm; only ``singular-perturbation`` has any, see
        :class:`~sinstool.coning.singular_perturbation.SingularPerturbation`.

    Returns
    -------
    ConingAlgorithm
        Ready for :meth:`~sinstool.coning.algorithm.ConingAlgorithm.rotation_vectors`.

    Raises
    ------
    ConfigurationError
        If the name is unknown, it takes no options, or their values are impossible.
    """
    for family in FAMILIES:
        match = re.fullmatch(family.pattern, name)
        if match is None:
            continue
        if options and not family.options:
            raise ConfigurationError(
                f"coning algorithm {name} has no option {', '.join(sorted(options))}",
                "leave it out, or choose singular-perturbation",
            )
        module, _, function = family.builder.partition(":")
        build = getattr(import_module(f"sinstool.coning.{module}"), function)
        numbers = [int(group) for group in match.groups() if group is not None]
        return cast(ConingAlgorithm, build(*numbers, **options))
    near = difflib.get_close_matches(name, names(), n=1, cutoff=0.0)
    raise ConfigurationError(
        f"unknown coning algorithm {name!r}",
        f"did you mean {near[0]}? There are {', '.join(names())}",
    )
