"""Latency of fixes by the whole of a log."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.core.timeline import SECOND
from sinstool.pipelines.process.ins_gnss.whole_log_latency import (
    WholeLogLatency,
    latency_of_whole_log,
)
from tests.helpers.filter_logs import run, start_of
from tests.helpers.unseen_drives import GRADES, LEVER, drive, record, write

GROUPS = {"gnss": {"lever_arm": tuple(LEVER.tolist())}, "input": {"gyro_kind": "mean-rate"}}


@pytest.fixture(scope="module", params=[(11, 0.0), (12, 0.06)], ids=["0 ms", "60 ms"])
def late(request, tmp_path_factory):
    """A log of 20 minutes with RTK fixes, and their latency, s."""
    seed, latency = request.param
    data = record(drive(seed, 1200.0), GRADES["industrial"], seed, latency=latency)
    return write(tmp_path_factory.mktemp("late") / "log.mcap", data), latency


def test_twenty_minutes_show_more_than_six(late):
    log, latency = late
    first = start_of(log, **GROUPS)
    found = run(log, **GROUPS)[0]["filter"]
    shown = found["gnss_latency"]
    assert shown["sigma_s"] < 0.75 * first.offsets.sigma_s
    assert abs(shown["estimate_s"] - latency) < 3.5 * shown["sigma_s"]
    assert abs(found["gnss_latency_s"] - latency) < 3.5 * shown["sigma_s"]


def test_a_latency_that_is_given_is_used_as_it_is(late):
    log, latency = late
    gnss = {**GROUPS["gnss"], "gnss_latency": latency}
    found = run(log, gnss=gnss, input=GROUPS["input"])[0]["filter"]
    assert found["gnss_latency_s"] == latency
    assert found["gnss_latency"]["status"] == "given"


def test_the_first_position_is_as_uncertain_as_the_change_makes_it(late):
    start = start_of(late[0], **GROUPS)
    by = 0.1
    latency = start.settings.gnss_latency + by
    changed = WholeLogLatency(latency, start.offsets).used_by(start)
    assert changed.settings.gnss_latency == latency
    added = changed.start.covariance_position_n - start.start.covariance_position_n
    off = by * start.start.nav[3:6]
    assert added == pytest.approx(np.outer(off, off))


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
