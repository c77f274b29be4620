"""Latency of fixes by the whole of a log."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.core.errors import AlignmentError
from sinstool.core.rotation import to_dcm
from sinstool.core.timeline import SECOND
from sinstool.methods.ins_gnss.clock_rate import ClockRate
from sinstool.pipelines.process.ins_gnss import run as filter_run
from sinstool.pipelines.process.ins_gnss import whole_log_latency
from sinstool.pipelines.process.ins_gnss.whole_log_latency import (
    WholeLogLatency,
    latency_of_whole_log,
)
from tests.helpers.filter_logs import run, start_of
from tests.helpers.unseen_drives import GRADES, LEVER, T0, drive, record, write

GROUPS = {"gnss": {"lever_arm": tuple(LEVER.tolist())}, "input": {"gyro_kind": "mean-rate"}}


@pytest.fixture(scope="module", params=[(11, 0.0), (12, 0.06)], ids=["0 ms", "60 ms"])
def late(request, tmp_path_factory):
    """A log of 20 minutes with RTK fixes, and their latency, s."""
    seed, latency = request.param
    data = record(drive(seed, 1200.0), GRADES["industrial"], seed, latency=latency)
    return write(tmp_path_factory.mktemp("late") / "log.mcap", data), latency


@pytest.mark.slow
def test_twenty_minutes_show_a_latency_better_than_the_first_six(late):
    """With some half of the sigma: the first part has 400 s of motion, the log 1080 s."""
    log, latency = late
    first = start_of(log, **GROUPS)
    found = run(log, **GROUPS)[0]["filter"]
    shown = found["gnss_latency"]
    assert 0.3 < shown["sigma_s"] / first.offsets.sigma_s < 0.65
    assert shown["sigma_s"] < 1.3e-3
    assert abs(shown["estimate_s"] - latency) < 2.5 * shown["sigma_s"]
    # Receivers that stamp well have none
    used = shown["estimate_s"] if latency else 0.0
    assert found["gnss_latency_s"] == pytest.approx(used, abs=0.3 * shown["sigma_s"])
    assert shown["clock_ppm"] == 0.0


@pytest.mark.slow
def test_a_latency_that_is_given_is_used_as_it_is(late):
    log, latency = late
    gnss = {**GROUPS["gnss"], "gnss_latency": latency}
    found = run(log, gnss=gnss, input=GROUPS["input"])[0]["filter"]
    assert found["gnss_latency_s"] == latency
    assert found["gnss_latency"]["status"] == "given"


def drive_by_two_clocks(path, seed, rate):
    """A log of 20 minutes whose receiver's clock is faster than the IMU's, and its truth."""
    truth = drive(seed, 1200.0)
    data = record(truth, GRADES["industrial"], seed)
    stamps = data.fixes.seconds * (1.0 + rate)
    return write(path, replace(data, fixes=replace(data.fixes, seconds=stamps))), truth


def no_start(*_):
    raise AlignmentError("no start")


@pytest.mark.parametrize(
    "seed, rate, begins_anew",
    [(5, 40e-6, True), (7, -25e-6, True), (5, 40e-6, False), (5, 150e-6, True)],
)
@pytest.mark.slow
def test_a_clock_of_the_receivers_own_is_corrected(tmp_path, monkeypatch, seed, rate, begins_anew):
    """It would move the solution by half a metre.

    Without a new start the first one serves, whose noise of the fixes is that of wrong stamps.
    """
    log, truth = drive_by_two_clocks(tmp_path / "log.mcap", seed, rate)
    if not begins_anew:
        monkeypatch.setattr(filter_run, "earliest_start", no_start)
    summary, solution = run(log, filter={"smooth": True}, **GROUPS)
    latency = summary["filter"]["gnss_latency"]
    assert latency["clock_ppm"] == pytest.approx(1e6 * rate, abs=10.0)
    # In the middle of the log, as it says
    assert latency["estimate_s"] == pytest.approx(600.0 * rate, abs=0.004)
    (finding,) = (one for one in summary["findings"] if one["kind"] == "clock-rate")
    assert ("faster" if rate > 0.0 else "slower") in finding["text"]
    seconds = (solution.time_ns - T0) * 1e-9
    late = np.flatnonzero(seconds > 300.0)[::100]
    error = truth.errors_of(
        seconds[late], *solution.position[late].T, solution.velocity_n[late],
        to_dcm(solution.q_nb[late]),
    )  # fmt: skip
    assert np.sqrt(np.mean(error[:, :2] ** 2)) < 0.05
    sigma = np.sqrt(np.diagonal(solution.covariance_position_n[late], axis1=1, axis2=2))
    assert (0.4 if begins_anew else 0.2) < np.sqrt(np.mean((error[:, :3] / sigma) ** 2)) < 1.6


@pytest.mark.slow
def test_the_first_position_is_as_uncertain_as_the_change_makes_it(late):
    start = start_of(late[0], **GROUPS)
    by = 0.1
    latency = start.settings.gnss_latency + by
    changed = WholeLogLatency(latency, start.offsets).used_by(start)
    assert changed.settings.gnss_latency == latency
    added = changed.start.covariance_position_n - start.start.covariance_position_n
    off = by * start.start.nav[3:6]
    assert added == pytest.approx(np.outer(off, off))


@pytest.mark.slow
def test_nothing_is_sought_where_it_would_not_matter(late):
    """Nothing is estimated: there are no increments to do so by."""
    start, config = start_of(late[0], **GROUPS), ProcessConfig(**GROUPS)
    times = [SimpleNamespace(time_ns=start.time_ns + np.array([0, t * SECOND])) for t in (0, 1150)]
    given = replace(start, latency_status="given")
    assert latency_of_whole_log(given, config, times) is None
    assert latency_of_whole_log(start, config, times[:1]) is None
    noise = replace(start.settings.gnss, position_white=(3.0, 3.0, 5.0))
    poor = replace(start, settings=replace(start.settings, gnss=noise))
    assert latency_of_whole_log(poor, config, times) is None
    with pytest.raises(AttributeError):
        latency_of_whole_log(start, config, times)


@pytest.mark.slow
@pytest.mark.parametrize("rate", [0.0, 3e-5], ids=["no rate", "a rate within its sigma"])
def test_nothing_is_estimated_twice(late, monkeypatch, rate):
    """The search for a clock's rate begins, and may end, where that for the latency begins."""
    start, config = start_of(late[0], **GROUPS), ProcessConfig(**GROUPS)
    times = [SimpleNamespace(time_ns=start.time_ns + np.array([0, t * SECOND])) for t in (0, 1150)]
    asked = []

    def shown(_start, settings, parts, fixes, *_):
        gated = settings.control == start.settings.control
        asked.append((settings.gnss_latency, len(parts), tuple(fixes.time_ns), gated))
        return replace(start.offsets, clock=ClockRate(rate, 1.2e-5, start.time_ns, 1150.0))

    monkeypatch.setattr(whole_log_latency, "estimate_offsets", shown)
    latency_of_whole_log(start, config, times)
    assert len(asked) == len(set(asked)) > 1
