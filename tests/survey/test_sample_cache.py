"""The samples of the first pass, kept for the second, change nothing but the time it takes."""

import numpy as np
import pytest

from sinstool.config import InputOptions, ProcessConfig
from sinstool.core.streams import concatenate
from sinstool.io.readers import open_log
from sinstool.io.readers.streams import ImuUnits
from sinstool.io.readers.topics import choose_imu
from sinstool.pipelines.process.run import process
from sinstool.survey import samples as sample_store
from sinstool.survey.imu import survey
from sinstool.survey.samples import SampleCache
from sinstool.survey.source import imu_blocks, prepare
from tests.helpers.imulogs import even_times, handheld, imu_log


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Samples late by up to three places, some twice, and a gap."""
    rng = np.random.default_rng(5)
    gyro, accel, _ = handheld(1500)
    times = even_times(1500)
    times[900:] += 10**9
    order = np.argsort(np.arange(1500) + rng.integers(0, 4, 1500), kind="stable")
    order = np.repeat(order, np.where(rng.random(1500) < 0.02, 2, 1))
    # received in the order of the file, at times of the recorder's own
    log_ns = times[0] + 10**6 * np.arange(len(order))
    path = tmp_path_factory.mktemp("kept") / "log.mcap"
    return imu_log(path, times[order], gyro[order], accel[order], log_ns=log_ns)


@pytest.mark.parametrize("most", [0, 1, 1000])
@pytest.mark.parametrize("span", [{}, {"start": "1.5", "end": "4.25"}])
def test_the_output_is_the_same_when_samples_are_read_again(log, tmp_path, monkeypatch, most, span):
    config = ProcessConfig(input=InputOptions(**span))
    process(log, tmp_path / "kept.mcap", config)
    monkeypatch.setattr(sample_store, "CACHED_SAMPLES", most)
    process(log, tmp_path / "again.mcap", config)
    assert (tmp_path / "kept.mcap").read_bytes() == (tmp_path / "again.mcap").read_bytes()


@pytest.mark.parametrize(("most", "cached"), [(0, False), (100, False), (10**6, True)])
def test_all_or_none_are_kept(log, monkeypatch, most, cached):
    monkeypatch.setattr(sample_store, "CACHED_SAMPLES", most)
    samples = SampleCache()
    with open_log(log) as opened:
        result = survey(opened, choose_imu(opened, None), ImuUnits(), read=samples)
    if cached:
        assert sum(map(len, samples.blocks)) == result.count + result.order.duplicates
    else:
        assert samples.blocks is None


def test_samples_that_were_let_go_are_read_again(log):
    with open_log(log) as opened:
        source = prepare(opened, ProcessConfig())
        begin = source.survey.first_ns
        first, last, again = (
            concatenate(list(imu_blocks(source, begin, rows=400, last=last)))
            for last in (False, True, False)
        )
        assert source.samples.blocks is None
    for one in (last, again):
        for name in ("time_ns", "log_time_ns", "gyro", "accel"):
            np.testing.assert_array_equal(getattr(first, name), getattr(one, name))
