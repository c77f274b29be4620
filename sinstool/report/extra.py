"""Optional packages of the report, imported only when they are used."""

from __future__ import annotations

import importlib
from typing import Any

from sinstool.core.errors import ConfigurationError


def borrowed(module: str) -> Any:
    """Import a module of the extra ``report``.

    Parameters
    ----------
    module : str
        Its full name, such as ``"matplotlib.figure"``.

    Returns
    -------
    module

    Raises
    ------
    ConfigurationError
        If the extra is not installed.
    """
    package = module.partition(".")[0]
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as exc:
        # Something that is missing inside the package is another trouble, and not ours to name
        if (exc.name or "").partition(".")[0] != package:
            raise
        raise ConfigurationError(
            f"the report needs {package}", "pip install 'sinstool[report]'"
        ) from exc
