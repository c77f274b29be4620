"""What `info` counts of a topic, block by block, against all of its times at once."""

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.pipelines.info.result import UnusableImu
from sinstool.pipelines.info.run import TopicTraffic, inspect, topic_of
from tests.helpers.imulogs import even_times, imu_messages, write_log

SECOND = 1_000_000_000


@pytest.mark.parametrize("blocks", [1, 2, 9])
@pytest.mark.parametrize("seed", range(3))
def test_times_of_a_topic_are_those_of_all_its_messages(seed, blocks):
    """Recorded out of order: neither the first nor the last message need be the edge."""
    random = np.random.default_rng(seed)
    times = 50 * SECOND + np.arange(200) * SECOND // 10
    times += random.integers(-SECOND, SECOND, 200)
    traffic = TopicTraffic()
    for part in np.array_split(times, blocks):
        traffic.add(part, 24 * len(part))
    steps = np.diff(times)
    assert (traffic.low, traffic.high) == (times.min(), times.max())
    assert (traffic.first, traffic.last) == (times[0], times[-1])
    assert traffic.longest == steps.max() and traffic.backward == np.count_nonzero(steps < 0)
    assert (traffic.count, traffic.size) == (200, 4800)
    topic = topic_of("/imu", traffic)
    assert topic.rate_hz == pytest.approx(199.0 / ((times.max() - times.min()) * 1e-9))


def test_the_messages_of_an_imu_that_cannot_be_used_are_counted(tmp_path):
    messages = imu_messages(even_times(30), [np.nan, 0.0, 0.0], [0.0, 0.0, 9.8])
    (imu,) = inspect(write_log(tmp_path / "a.mcap", messages), ProcessConfig()).imu
    assert isinstance(imu, UnusableImu) and imu.n == 30
    assert "30 hold NaN" in imu.problem
