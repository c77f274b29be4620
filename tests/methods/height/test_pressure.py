"""Which pressures can be used, in what unit they are, and where a sensor hangs."""

import numpy as np
import pytest

from sinstool.methods.height.layout import ACCEPTED, NOT_FINITE, OUT_OF_RANGE
from sinstool.methods.height.pressure import frozen_spans, pressure_reason, suspected_unit


def ns(seconds):
    return np.round(np.asarray(seconds) * 1e9).astype(np.int64)


def test_reasons():
    p = [np.nan, np.inf, 0.0, -3.0, 867.0, 868.1, 101325.0, 1.2e5, 120001.0]
    expected = [NOT_FINITE] * 2 + [OUT_OF_RANGE] * 3 + [ACCEPTED] * 3 + [OUT_OF_RANGE]
    assert pressure_reason(p).tolist() == expected


@pytest.mark.parametrize(
    ("factor", "unit"),
    [(1.0, "Pa"), (0.01, "hPa"), (0.001, "kPa"), (1 / 3386.389, "inHg"), (10.0, "unknown")],
)
@pytest.mark.parametrize("pressure", [101325.0, 70000.0])
def test_unit(factor, unit, pressure):
    rng = np.random.default_rng(1)
    values = (pressure + 50 * rng.standard_normal(300)) * factor
    values[:40:2] = np.nan
    values[1:40:8] = 0.0
    values[200:] = 7.0  # later samples have no say
    suspected = suspected_unit(values)
    assert suspected.unit == unit
    assert suspected.samples == 100
    assert suspected.median == pytest.approx(pressure * factor, rel=1e-3)


def test_unit_of_a_log_that_begins_high_up():
    assert suspected_unit([1197.0, 1201.0, 1203.0]).unit == "Pa"
    assert suspected_unit([4000.0]).unit == "Pa"


def test_unit_of_nothing():
    assert suspected_unit([np.nan, 0.0, -1.0]).unit == "unknown"
    assert suspected_unit([]).samples == 0


def test_frozen_spans():
    t = np.arange(0.0, 200.0, 0.5)
    p = 1e5 + np.arange(400.0)
    p[100:161] = 99000.0  # 30 s from first to last
    p[200:260] = 98000.0  # half a second less
    p[350:] = 97000.0
    assert frozen_spans(ns(t), p) == [(50 * 10**9, 80 * 10**9)]
    assert len(frozen_spans(ns(t), p, 20.0)) == 3
    assert frozen_spans([], []) == []
