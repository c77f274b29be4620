"""Inertial navigation and gaps of the IMU: which are bridged, and what is not trusted."""

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.core.finding import Severity
from sinstool.pipelines.process.run import process
from tests.helpers.imulogs import G, even_times, imu_log

RATE = 100.0
TURN = np.radians(20.0)
STATED = {
    "align": {
        "align": "fixed",
        "initial_attitude": [0.0, 0.0, 0.0],
        "latitude": 48.0,
        "longitude": 11.0,
        "height": 0.0,
    },
    "navigation": {"mode": "ins"},
    "output": {"only_results": True},
}


def turned(path, gap):
    """Rest for 10 s, turn by 200 deg in 10 s, rest for 10 s; no samples in the gap."""
    seconds = np.arange(round(30.0 * RATE)) / RATE
    noise = np.random.default_rng(3).standard_normal((2, len(seconds), 3))
    gyro, accel = 1e-4 * noise[0], 1e-3 * noise[1] + [0.0, 0.0, G]
    gyro[(seconds >= 10.0) & (seconds < 20.0), 2] -= TURN
    kept = (seconds < gap[0]) | (seconds >= gap[1])
    imu_log(path, even_times(len(seconds), RATE)[kept], gyro[kept], accel[kept])
    return process(path, path.with_name("out.mcap"), build(ProcessConfig, STATED))


@pytest.mark.parametrize("gap", [(14.0, 14.4), (10.5, 10.6)])
def test_a_short_gap_is_said_to_be_bridged_and_is(tmp_path, gap):
    result = turned(tmp_path / "log.mcap", gap)
    (text,) = [f.text for f in result.findings if f.kind == "gaps"]
    assert text.endswith("short enough to be integrated across")
    assert max(f.severity for f in result.findings) == Severity.WARNING
    assert result.final.heading_deg == pytest.approx(200.0, abs=0.3)


@pytest.mark.parametrize("gap", [(13.0, 15.0), (7.0, 12.0), (19.0, 22.0)])
def test_nothing_is_trusted_after_a_gap_in_motion(tmp_path, gap):
    result = turned(tmp_path / "log.mcap", gap)
    assert abs(result.final.heading_deg - 200.0) > 10.0
    (lost,) = [f for f in result.findings if f.kind == "moved-in-gap"]
    assert lost.severity == Severity.LOST
    assert f"from {gap[0]:.1f} to {gap[1]:.1f} s" in lost.text


@pytest.mark.parametrize("gap", [(3.0, 6.0), (24.0, 27.0)])
def test_a_gap_at_rest_loses_nothing(tmp_path, gap):
    result = turned(tmp_path / "log.mcap", gap)
    assert result.final.heading_deg == pytest.approx(200.0, abs=0.3)
    assert not [f for f in result.findings if f.kind == "moved-in-gap"]
