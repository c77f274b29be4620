"""What a run says of the settings that it used."""

from types import SimpleNamespace

import pytest

from sinstool.config import ProcessConfig
from sinstool.core.finding import Finding
from sinstool.pipelines.process.ins_gnss.settings_used import about_options

GIVEN = SimpleNamespace(latency_status="given")


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
