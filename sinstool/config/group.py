"""What all groups of options share."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, model_validator


class Group(BaseModel):
    """Options that belong together: a table of the configuration file."""

    # strict: a word is no number and a number is no yes or no
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _tuples(cls, data: Any) -> Any:
        """Lists, which TOML has, as the tuples that strict models want."""
        return {k: _tuple(v) for k, v in data.items()} if isinstance(data, dict) else data

    def check(self) -> None:
        """What no single option can know: whether they fit each other.

        Raises
        ------
        ConfigurationError
        """


def _tuple(value: Any) -> Any:
    return tuple(map(_tuple, value)) if isinstance(value, list) else value
