"""Increments of the first minutes, made once for several runs."""

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.core.streams import concatenate
from sinstool.io.readers import open_log
from sinstool.pipelines.planning import make_plan
from sinstool.survey import increments
from sinstool.survey.increments import SegmentIncrements, first_increments
from sinstool.survey.source import imu_blocks, prepare
from tests.helpers.filter_logs import simulated

SECOND = 1_000_000_000


@pytest.fixture
def log(tmp_path):
    path = simulated(tmp_path / "log.mcap", "drive", "--duration", "60", "--seed", "3")
    config = ProcessConfig(navigation={"mode": "attitude"})
    with open_log(path) as opened:
        source = prepare(opened, config, None)
        yield source, config, make_plan(source, config).algorithm


def test_they_are_those_of_the_log_and_made_once(log, monkeypatch):
    source, config, algorithm = log
    start_ns = source.survey.first_ns
    steps = SegmentIncrements(source, config, algorithm)
    each = [part for part, _, _ in steps.from_time(start_ns, start_ns + 20 * SECOND)]
    made = first_increments(source, config, algorithm, start_ns, 20 * SECOND, SECOND)
    np.testing.assert_array_equal(made.rotation_vector, concatenate(each).rotation_vector)
    monkeypatch.setattr(increments, "SegmentIncrements", None)
    assert first_increments(source, config, algorithm, start_ns, 20 * SECOND, SECOND) is made


def test_those_from_another_sample_take_their_place(log):
    source, config, algorithm = log
    start_ns = source.survey.first_ns
    for later in (0, 5):
        begin = start_ns + later * SECOND
        made = first_increments(source, config, algorithm, begin, 20 * SECOND, SECOND)
        assert abs(int(made.time_ns[0]) - begin) < SECOND // 10
    assert len(source.samples.made) == 1


def test_they_end_at_a_gap(log):
    source, config, algorithm = log
    start_ns = source.survey.first_ns
    assert first_increments(source, config, algorithm, start_ns, 20 * SECOND, 0) is None


@pytest.mark.parametrize("rows", [100, 777, 16384])
def test_they_are_of_so_many_seconds_wherever_blocks_end(log, monkeypatch, rows):
    """They went on to the end of a block, 164 s at 100 Hz."""
    source, config, algorithm = log
    start_ns = source.survey.first_ns

    def blocks(source, config, start_ns, progress):
        return imu_blocks(source, start_ns, progress, rows)

    each = concatenate(
        [part for part, _, _ in SegmentIncrements(source, config, algorithm).from_time(start_ns)]
    )
    monkeypatch.setattr(increments, "rate_blocks", blocks)
    made = first_increments(source, config, algorithm, start_ns, 20 * SECOND, SECOND)
    inside = each.time_ns <= start_ns + 20 * SECOND
    assert 0 < np.count_nonzero(inside) < len(inside)
    np.testing.assert_array_equal(made.time_ns, each.time_ns[inside])
    np.testing.assert_array_equal(made.rotation_vector, each.rotation_vector[inside])
    np.testing.assert_allclose(made.followed_rate, each.followed_rate[inside], atol=1e-9)
