"""The antenna of a car on a smooth road, of which nobody said where it is, by a MEMS IMU.

Beside fixes of 2 cm the tilt that a filter finds from one fix to the next is mostly their noise,
and on an arm it looks like motion of the antenna.
"""

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.io.readers import open_log
from sinstool.pipelines.planning import make_plan
from sinstool.pipelines.process.ins_gnss import timing
from sinstool.pipelines.process.ins_gnss.start import with_noise
from sinstool.survey.source import prepare
from tests.helpers.filter_logs import start_of
from tests.helpers.unseen_drives import LEVER, drive, record, sensor_errors, write

MEMS = sensor_errors(0.25, 200.0, 0.05, 3000.0, 1000.0, 1.0)
GROUPS = {"input": {"gyro_kind": "mean-rate"}, "navigation": {"mode": "ins-gnss"}}


def logged(folder, seed, duration=240.0):
    truth = drive(seed, duration, 30.0, rough=0.0)
    data = record(truth, MEMS, seed, sigma=0.02, sigma_v=0.1, gnss_rate=5.0)
    return write(folder / "log.mcap", data)


def test_an_estimate_does_not_follow_the_height_at_which_the_antenna_is_assumed(tmp_path):
    config = ProcessConfig(**GROUPS)
    with open_log(logged(tmp_path, 2)) as opened:
        source = prepare(opened, config, None)
        plan = make_plan(source, config)
        begun = with_noise(source, config, plan.algorithm, plan.filter_start)
        about = timing.with_same_start(source, config, plan.algorithm, begun)
        down = [about(0.0, LEVER + np.array([0.0, 0.0, off])).arm_b[2] for off in (0.0, 3.0)]
    assert abs(down[1] - down[0]) < 0.5


@pytest.mark.parametrize("seed", [2, 4, pytest.param(5, marks=pytest.mark.slow)])
def test_the_antenna_is_where_its_sigmas_say(tmp_path, seed):
    start = start_of(logged(tmp_path, seed), **GROUPS)
    sigma = np.sqrt(np.diag(start.offsets_error)[1:])
    assert start.arm_status == "found"
    assert np.all(np.abs(start.settings.lever_arm_b - LEVER) < 2.5 * sigma)
    assert np.all(sigma[:2] < 0.1) and sigma[2] < 0.8
