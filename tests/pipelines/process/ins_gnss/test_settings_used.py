"""What a run says of the settings that it used."""

from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.core.finding import Finding
from sinstool.core.units import DEGREE
from sinstool.pipelines.process.ins_gnss.settings_used import about_options, heading_open

GIVEN = SimpleNamespace(latency_status="given")
# An aircraft that circles at 16 m/s, 20 deg/s: late fixes turn its heading by the rate, an antenna
# ahead of the IMU by rate over speed.
RATE, SPEED = 20.0 * DEGREE, 16.0
BY = np.array([RATE, -RATE / SPEED, 0.0, 0.0])
TURNS = np.outer(BY, BY)


def told(moment, before=0.1 * DEGREE):
    """What is said of errors of latency and arm with these second moments."""
    square = float(np.sum(TURNS * moment))
    return heading_open(moment, TURNS, np.sqrt(square), before), np.sqrt(square) / DEGREE


@pytest.mark.parametrize(
    ("late_s", "arm_m", "shared", "answer"),
    [
        (0.0, 1.0, 0.0, "give --lever-arm"),
        (0.005, 1.0, 0.0, "give --lever-arm"),
        (0.1, 0.0, 0.0, "give --gnss-latency"),
        (0.1, 0.1, 0.0, "give --gnss-latency"),
        # 1 m is 62 ms of flight
        (0.0625, 1.0, 0.0, "give --lever-arm and --gnss-latency"),
        # Positions show their sum only: what is known of one shows the other
        (0.0625, 1.0, -0.999, "give --lever-arm or --gnss-latency"),
    ],
)
def test_the_option_is_named_that_makes_heading_certain(late_s, arm_m, shared, answer):
    both = shared * late_s * arm_m
    moment = np.diag([late_s**2, arm_m**2, 0.01, 0.01])
    if arm_m == 0.0:
        moment[1:, 1:] = 0.0
    moment[0, 1] = moment[1, 0] = both
    (finding,), sigma = told(moment)
    assert finding.answer == answer
    assert finding.numbers["sigma_deg"] == pytest.approx(sigma)
    assert finding.numbers["otherwise_deg"] == pytest.approx(0.1)


def test_nothing_is_said_where_other_errors_are_larger_or_all_are_small():
    arm = np.diag([0.0, 1.0, 1.0, 1.0])
    assert not told(arm, before=2.0 * DEGREE)[0]
    assert not told(1e-3 * arm, before=0.0)[0]


@pytest.mark.parametrize(
    ("kind", "scale", "more"),
    [("imu-noise", 0.5, True), ("imu-noise", 1.0, False), ("latency", 0.5, False)],
)
def test_a_noisy_imu_may_be_fixes_that_were_trusted_too_far(kind, scale, more):
    config = ProcessConfig(filter={"gnss_noise_scale": scale})
    (finding,) = about_options(
        [Finding(kind, "text", answer="choose another grade")], GIVEN, config
    )
    assert ("--gnss-noise-scale is too small" in finding.answer) == more
    assert finding.answer.startswith("choose another grade")
