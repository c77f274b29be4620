"""Intervals hold the truth as often as they say; more of it in benchmarks/allan_intervals.py."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.allan_intervals import CASES, Case, fit_of, visible
from sinstool.methods.allan.likelihood import NAMES

RUNS = 100
# Of 100 runs with 95 % each, fewer come once in a thousand tests.
FEWEST = 0.87
BY_NAME = {case.name: case for case in CASES}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "rest"),
    [("white only", (12000,)), ("mems", (40000,)), ("walking", (3000, 6000, 9000, 12000))],
)
def test_intervals_hold_and_nothing_is_claimed(name: str, rest: tuple[int, ...]) -> None:
    case: Case = BY_NAME[name]
    fits = [fit_of(case, rest, seed) for seed in range(RUNS)]
    there = visible(case.terms, rest)
    for term, truth in zip(NAMES, case.terms, strict=True):
        found = [fit.terms[term] for fit in fits]
        held = np.mean([t.low <= truth <= t.high for t in found])
        claimed = sum(t.value is not None for t in found)
        assert held >= FEWEST, (term, held)
        if not there[term]:
            assert claimed <= 1, (term, claimed)
