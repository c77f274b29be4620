"""Stretches that are not to be trusted are named, and decide how the command ends."""

from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.core.finding import Finding, exit_status
from sinstool.methods.ins_gnss.results import FilterEvent, GnssDiagnostics, UpdateColumns
from sinstool.pipelines.process.ins_gnss.run import FilterRun
from sinstool.pipelines.process.ins_gnss.trust import (
    MOST_NAMED,
    doubts,
    marked,
    of_another_clock,
    untrusted,
)

SECOND = 10**9


def epochs(gated=(), number=200):
    """One a second, of which some were rejected."""
    flags = np.zeros(number, bool)
    rejected = flags.copy()
    rejected[list(gated)] = True
    nothing = np.full((number, 6), np.nan)
    return GnssDiagnostics(
        time_ns=np.arange(number) * SECOND,
        innovation=nothing,
        innovation_sigma=nothing,
        measurement_sigma=nothing,
        noise_ratio=nothing,
        nis=np.ones(number),
        rows=np.full(number, 3),
        used=~rejected,
        gated=rejected,
        restarted=flags,
        withheld=flags,
    )


def test_a_sound_run_has_no_findings():
    assert untrusted(epochs(gated=[50, 120]), [], 1.0, 0) == []


def test_before_a_restart_nothing_is_to_be_trusted():
    gnss = epochs(gated=range(80, 95))
    findings = untrusted(gnss, [FilterEvent("restart", 95 * SECOND, 99.0)], 1.0, -10 * SECOND)
    assert [f.kind for f in findings] == ["not-trusted"]
    assert "from 89.0 to 105.0 s" in findings[0].text
    assert (findings[0].start_ns, findings[0].end_ns) == (79 * SECOND, 95 * SECOND)
    assert exit_status(findings) == 3


def test_a_gap_is_a_warning():
    findings = untrusted(epochs(), [FilterEvent("imu-gap-restart", 60 * SECOND, 8.0)], 1.0, 0)
    assert "from 60.0 to 68.0 s: the Imu is silent" in findings[0].text
    assert exit_status(findings) == 0


def test_many_stretches_are_named_in_part():
    events = [FilterEvent("restart", k * 1000 * SECOND, 99.0) for k in range(1, 10)]
    findings = untrusted(epochs(number=10_000), events, 1.0, 0)
    assert len(findings) == MOST_NAMED + 1
    assert findings[-1].text.startswith("4 more such stretches")


def test_smoothed_sigmas_admit_a_doubted_stretch():
    gnss = epochs(gated=range(80, 95))
    gnss.innovation[80:95, :3] = [30.0, -40.0, 5.0]
    gnss.innovation[50, :3] = 500.0  # taken, and long before
    doubtful = doubts(gnss, [FilterEvent("restart", 95 * SECOND, 99.0)])
    time_ns = np.array([60, 90, 120]) * SECOND
    nothing, eye = np.zeros((3, 3)), np.tile(0.01 * np.eye(3), (3, 1, 1))
    updates = UpdateColumns(
        time_ns, *np.zeros((3, 3)), nothing, np.zeros((3, 4)), nothing, nothing, np.zeros(3),
        eye, eye, eye,
    )  # fmt: skip
    sigma = [
        np.sqrt(np.diagonal(block, axis1=1, axis2=2))
        for block in (
            marked(updates, doubtful).covariance_position_n,
            marked(updates, doubtful).covariance_velocity_n,
        )
    ]
    assert np.allclose(sigma[0][[0, 2]], 0.1)
    assert np.allclose(sigma[0][1], np.hypot(0.1, [30.0, 40.0, 5.0]))
    # No velocities of the receiver: 40 m within the 16 s from the last fix that was taken
    assert sigma[1][1, 1] == pytest.approx(np.hypot(0.1, 40.0 / 16.0))
    assert np.allclose(updates.covariance_position_n, eye)


def test_an_uncorrected_navigation_beyond_a_linear_filter_is_not_to_be_trusted():
    (finding,) = untrusted(epochs(), [FilterEvent("far-from-gnss", 70 * SECOND, 12.0)], 1.0, 0)
    assert exit_status([finding]) == 3 and finding.start_ns == 70 * SECOND
    assert "from 70.0 s" in finding.text and "--feedback" in finding.answer


@pytest.mark.parametrize(
    ("status", "sigma_s", "contradicts", "trusted"),
    [
        ("found", 0.01, False, True),
        ("found", 0.2, False, False),  # whose estimates follow what they are made about
        ("given", 0.01, False, True),
        ("given", 0.01, True, False),
        ("not settled", 0.01, False, False),
        ("not observable", 0.2, False, False),
    ],
)
def test_only_motion_makes_up_for_another_clock(status, sigma_s, contradicts, trusted):
    shown = SimpleNamespace(sigma_s=sigma_s, latency_contradicts=lambda _: contradicts)
    settings = SimpleNamespace(gnss_latency=0.0)
    start = SimpleNamespace(offsets=shown, latency_status=status, settings=settings)
    clock = Finding("receiver-clock", "two", answer="give it", numbers={"ahead_s": 2.0})
    findings = of_another_clock([clock], start)
    assert exit_status(findings) == (0 if trusted else 3)
    assert trusted or findings[0].answer == "give it"
    assert not of_another_clock([Finding("other", "else")], start)


@pytest.mark.parametrize(("many", "status"), [(30, 0), (50, 3)])
def test_too_many_rejected(many, status):
    assert exit_status(untrusted(epochs(gated=range(0, 4 * many, 4)), [], 1.0, 0)) == status


@pytest.mark.parametrize(("nis", "word"), [(0.02, "too large"), (9.0, "too small")])
def test_sigmas_that_say_nothing(nis, word):
    (finding,) = untrusted(epochs(), [], nis, 0)
    assert finding.kind == "sigmas-off" and word in finding.text


@pytest.mark.parametrize(
    ("kind", "scale", "more"),
    [("imu-noise", 0.5, True), ("imu-noise", 1.0, False), ("latency", 0.5, False)],
)
def test_a_noisy_imu_may_be_fixes_that_were_trusted_too_far(kind, scale, more):
    run = SimpleNamespace(config=ProcessConfig(filter={"gnss_noise_scale": scale}))
    finding = FilterRun._completed(run, Finding(kind, "text", answer="choose another grade"))
    assert ("--gnss-noise-scale is too small" in finding.answer) == more
    assert finding.answer.startswith("choose another grade")
