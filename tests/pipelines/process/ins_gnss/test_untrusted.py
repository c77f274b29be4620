"""Stretches that are not to be trusted are named, and decide how the command ends."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.core.finding import exit_status
from sinstool.methods.ins_gnss.results import FilterEvent, GnssDiagnostics, UpdateColumns
from sinstool.pipelines.process.ins_gnss.untrusted import (
    MOST_NAMED,
    doubts,
    marked,
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
        innovation=nothing.copy(),
        innovation_sigma=nothing,
        measurement_sigma=nothing,
        noise_ratio=nothing,
        nis=np.ones(number),
        rows=np.full(number, 3),
        used=~rejected,
        gated=rejected,
        restarted=flags.copy(),
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


@pytest.mark.parametrize("apart", [False, True])
def test_the_fix_with_which_a_filter_restarts_does_not_end_its_doubts(apart):
    """It is used, and valid before the update that restarts; velocities are believed throughout."""
    gnss = epochs(gated=range(80, 96))
    position = np.ones(200, bool)
    if apart:
        position[::2] = False
        gnss.used[80:97:2], gnss.gated[80:97:2] = True, False
    gnss.innovation[position, :3], gnss.innovation[~position, 3:] = 30.0, 0.1
    gnss.used[95], gnss.gated[95], gnss.restarted[95] = True, False, True
    restart = FilterEvent("restart", 95 * SECOND + 4_000_000, 99.0)
    (finding,) = untrusted(gnss, [restart], 1.0, 0)
    assert (finding.start_ns, finding.end_ns) == (79 * SECOND, restart.time_ns)
    ((begin, end, far),) = doubts(gnss, [restart])
    assert (begin, end) == (79 * SECOND, restart.time_ns) and far[0] == 30.0


def test_a_gap_is_a_warning():
    findings = untrusted(epochs(), [FilterEvent("imu-gap-restart", 60 * SECOND, 8.0)], 1.0, 0)
    assert "from 60.0 to 68.0 s: the IMU has a gap" in findings[0].text
    assert exit_status(findings) == 0


def test_many_stretches_are_named_in_part():
    events = [FilterEvent("restart", k * 1000 * SECOND, 99.0) for k in range(1, 10)]
    findings = untrusted(epochs(number=10_000), events, 1.0, 0)
    assert len(findings) == MOST_NAMED + 1
    assert findings[-1].text.startswith("4 more such stretches")


@pytest.mark.parametrize("to_one_side", [True, False])
def test_fixes_that_a_diverged_filter_takes_for_noise(to_one_side):
    """Its way from them grew with each, as their noise did that it measured: 180 m, status 0."""
    gnss = epochs(gated=range(80, 84))
    rows = np.arange(80, 96)
    way = np.outer(12.0 * (rows - 79), [0.3, -1.0, 0.0])
    nu = way if to_one_side else np.random.default_rng(3).normal(0.0, 60.0, (len(rows), 3))
    gnss.innovation[:, :3], gnss.noise_ratio[:, :3] = 0.01, 1.0
    gnss.innovation[rows, :3], gnss.noise_ratio[rows[4:], :3] = nu, 1e6
    findings = untrusted(gnss, [], 1.0, 0)
    assert exit_status(findings) == (3 if to_one_side else 0)
    if to_one_side:
        assert (findings[0].start_ns, findings[0].end_ns) == (80 * SECOND, 95 * SECOND)
        [(_, _, far)] = doubts(gnss, [])
        assert far[1] == pytest.approx(192.0)


@pytest.mark.parametrize("still_far", [True, False])
def test_a_filter_whose_sigmas_grow_until_it_takes_fixes_that_are_as_far_as_ever(still_far):
    """It had followed a receiver that was wrong: 10 m off for 25 s, status 0."""
    gnss = epochs(gated=range(80, 95))
    gnss.innovation[:, :3] = 0.01
    gnss.innovation[80:95, :3] = [8.0, -6.0, 1.0]
    if still_far:
        gnss.innovation[95, :3], gnss.nis[95] = [7.0, -6.0, 1.0], 15.0
    findings = untrusted(gnss, [], 1.0, 0)
    assert exit_status(findings) == (3 if still_far else 0)
    if still_far:
        assert (findings[0].start_ns, findings[0].end_ns) == (79 * SECOND, 95 * SECOND)
        [(_, _, far)] = doubts(gnss, [])
        assert far[0] == 8.0
    # At the end of a log nothing is known
    cut = epochs(gated=range(80, 200))
    cut.innovation[:, :3] = 0.01
    assert doubts(cut, []) == []


def test_a_few_seconds_after_which_sigmas_have_grown_are_no_reason_to_distrust():
    gnss = epochs(gated=range(80, 95))
    gnss.innovation[:, :3] = 0.01
    gnss.innovation[80:96, :3], gnss.nis[95] = [8.0, -6.0, 1.0], 15.0
    assert len(doubts(gnss, [])) == 1
    assert doubts(replace(gnss, time_ns=gnss.time_ns // 10), []) == []


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


@pytest.mark.parametrize(("many", "status"), [(30, 0), (50, 3)])
def test_too_many_rejected(many, status):
    assert exit_status(untrusted(epochs(gated=range(0, 4 * many, 4)), [], 1.0, 0)) == status


@pytest.mark.parametrize(("nis", "word"), [(0.02, "too large"), (9.0, "too small")])
def test_sigmas_that_say_nothing(nis, word):
    (finding,) = untrusted(epochs(), [], nis, 0)
    assert finding.kind == "sigmas-off" and word in finding.text
    # Sigmas that are too small make promises that nobody keeps
    assert exit_status([finding]) == (3 if "small" in word else 0)
