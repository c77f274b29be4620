"""Fixes that are stamped a second late or more, as by phones and slow serial lines: found.

Drives and flights by another program (`pyins.sim`), with consumer sensors.
"""

import numpy as np
import pytest

from tests.helpers.filter_logs import run, start_of
from tests.helpers.unseen_drives import CONSUMER, drive, flight, record, write

KIND = {"gyro_kind": "mean-rate"}


@pytest.fixture(scope="module")
def motions():
    return {"road": drive(2, 200.0, 20.0), "rough air": flight(1, 200.0, turbulent=True)}


@pytest.mark.slow
@pytest.mark.parametrize("late_s", [1.0, -1.7, 2.4])
@pytest.mark.parametrize("kind", ["road", "rough air"])
def test_late_fixes_are_used_at_their_time(tmp_path, motions, kind, late_s):
    data = record(
        motions[kind], CONSUMER, 7, gnss_rate=5.0, sigma=1.5, sigma_v=0.1, latency=abs(late_s)
    )
    if late_s < 0.0:
        # The same fixes, stamped earlier than they are valid
        data.fixes.seconds[:] -= 2.0 * abs(late_s)
    found = start_of(write(tmp_path / "log.mcap", data), input=dict(KIND))
    assert found.latency_status == "found"
    error = abs(found.settings.gnss_latency - late_s)
    assert error < max(4.0 * found.offsets.sigma_s, 0.02)


@pytest.mark.slow
def test_a_given_latency_is_denied_by_fixes_that_are_later(tmp_path, motions):
    data = record(motions["road"], CONSUMER, 7, gnss_rate=5.0, sigma=1.5, sigma_v=0.1, latency=1.5)
    log = write(tmp_path / "log.mcap", data)
    result, _ = run(log, input=dict(KIND), gnss={"gnss_latency": 0.1})
    denied = next(f for f in result["findings"] if f["kind"] == "latency")
    assert denied["numbers"]["latency_s"] == pytest.approx(1.5, abs=0.03)
    right, _ = run(log, input=dict(KIND), gnss={"gnss_latency": 1.5})
    assert not any(f["kind"] == "latency" for f in right["findings"])


def test_fixes_in_time_are_not_made_late(tmp_path, motions):
    data = record(motions["road"], CONSUMER, 7, gnss_rate=5.0, sigma=1.5, sigma_v=0.1)
    found = start_of(write(tmp_path / "log.mcap", data), input=dict(KIND))
    assert np.isclose(found.settings.gnss_latency, 0.0, atol=0.03)
