"""Noise of an IMU at rest that is far beyond what options give it."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from sinstool.config import ProcessConfig
from sinstool.io.readers import open_log
from sinstool.methods.sensor_errors import IMU_GRADES
from sinstool.pipelines.process.ins_gnss.filter_settings import too_good
from sinstool.survey.source import prepare
from tests.helpers.unseen_drives import GRADES, drive, record, sensor_errors, write

# Of MEMS: gyros, and accelerometers, whose noise is 0.15 m/s/sqrt(h)
GYROS = replace(
    GRADES["tactical"], angle_random_walk=sensor_errors(0.4, 0, 0, 0, 0, 1).angle_random_walk
)
ACCELEROMETERS = sensor_errors(0.003, 0.027, 0.15, 1500.0, 3000.0, 1.0)


@pytest.mark.parametrize(
    ("errors", "grade", "named"),
    [
        (GRADES["tactical"], "tactical", []),
        (GYROS, "tactical", ["the gyro's noise at rest is 0.4 deg"]),
        (ACCELEROMETERS, "tactical", ["the accelerometers' noise at rest is 0.15 m/s"]),
        (ACCELEROMETERS, "industrial", []),
        (ACCELEROMETERS, "auto", []),
    ],
)
def test_sensors_noisier_at_rest_than_their_grade_are_named(tmp_path, errors, grade, named):
    log = write(tmp_path / "log.mcap", record(drive(3, 40.0, 30.0), errors, 3))
    config = ProcessConfig(navigation={"mode": "ins-gnss", "imu_grade": grade})
    imu = IMU_GRADES["tactical" if grade == "auto" else grade]
    with open_log(log) as opened:
        said = too_good(prepare(opened, config), config, SimpleNamespace(imu=imu))
    assert [text[: len(name)] for text, name in zip(said, named, strict=True)] == named
