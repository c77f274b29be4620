"""Parameters of tests of which some are enough for a quick run."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def mostly_slow(values: Iterable[Any], *quick: Any) -> list[Any]:
    """All values as parameters, marked as slow but for the quick ones, which must be among them."""
    values = list(values)
    assert all(value in values for value in quick)
    return [v if v in quick else pytest.param(v, marks=pytest.mark.slow) for v in values]
