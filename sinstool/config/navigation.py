"""What is computed: attitude alone, or a whole navigation solution."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from sinstool.config.group import Group


class NavigationOptions(Group):
    """What is computed, and from where it starts."""

    mode: Literal["auto", "attitude"] = Field(
        "auto", description="what is computed; auto is attitude"
    )
