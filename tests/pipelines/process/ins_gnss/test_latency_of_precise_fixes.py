"""Latency by precise fixes that a filter follows closely, as it takes its sensors for noisier.

What the filter's velocity and attitude have of the noise of fixes is then no motion that shows a
latency. Smooth flights by another program (`pyins.sim`) show little of it besides.
"""

import numpy as np
import pytest

from tests.helpers.filter_logs import start_of
from tests.helpers.unseen_drives import LEVER, PHONE, flight, record, write

LATE_S = 0.2


@pytest.mark.slow
@pytest.mark.parametrize("sigma_v", [None, 0.05])
def test_the_noise_of_fixes_is_no_latency(tmp_path, sigma_v):
    ratios = []
    for seed in (1, 2, 3, 7):
        motion = flight(seed, 400.0)
        data = record(
            motion, PHONE, seed, gnss_rate=10.0, sigma=0.06, sigma_v=sigma_v, latency=LATE_S
        )
        log = write(tmp_path / f"{seed}.mcap", data)
        found = start_of(
            log, input={"gyro_kind": "mean-rate"}, gnss={"lever_arm": tuple(LEVER.tolist())}
        )
        assert found.latency_status == "found"
        ratios.append((found.offsets.latency_s - LATE_S) / found.offsets.sigma_s)
    assert np.sqrt(np.mean(np.square(ratios))) < 1.5
