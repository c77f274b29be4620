"""An antenna whose place is in the log's static transforms."""

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.io.readers import open_log
from sinstool.survey.source import prepare
from tests.helpers.filter_logs import run
from tests.helpers.imulogs import serialised
from tests.helpers.unseen_drives import GRADES, LEVER, T0, drive, record, write
from tests.io.readers.test_transforms import NONE, static

# The antenna at LEVER, seen from a vehicle whose IMU is turned by half a turn about its z axis
IN_IMU = LEVER * (1.0, -1.0, -1.0)
HALF_TURN = (0.0, 0.0, 1.0, 0.0)
RIGHT = (
    ("base_link", "imu_link", HALF_TURN, (0.2, 0.0, 0.5)),
    ("base_link", "gps", NONE, (0.2 - IN_IMU[0], -IN_IMU[1], 0.5 + IN_IMU[2])),
)
WRONG = (RIGHT[0], ("base_link", "gps", NONE, (3.0, 1.0, 0.0)))


@pytest.fixture(scope="module")
def road():
    truth = drive(3, 240.0, 20.0)
    return record(truth, GRADES["industrial"], 3, gnss_rate=2.0, sigma_v=0.05)


def logged(folder, data, rows):
    message = static(*rows)
    tree = (T0, message.topic, message.type_name, serialised(message.message, message.type_name, 2))
    return write(folder / "log.mcap", data, [tree])


def place(log, axes="flu", **gnss):
    config = ProcessConfig(input={"body_axes": axes}, gnss=gnss)
    with open_log(log) as opened:
        return prepare(opened, config).antenna_b


def test_transforms_place_the_antenna_unless_an_option_does(tmp_path):
    data = record(drive(3, 20.0, 20.0), GRADES["industrial"], 3)
    right = logged(tmp_path, data, RIGHT)
    np.testing.assert_allclose(place(right), LEVER, atol=1e-12)
    # What such a log calls z points down
    np.testing.assert_allclose(place(right, "frd"), IN_IMU, atol=1e-12)
    assert place(right, lever_arm=(0.0, 0.0, 0.0)) is None


@pytest.mark.parametrize("away", [0.0, 1000.0])
def test_a_tree_that_nobody_filled_in_places_no_antenna(tmp_path, away):
    data = record(drive(3, 20.0, 20.0), GRADES["industrial"], 3)
    rows = [("base_link", "imu_link", NONE, (0, 0, 0)), ("base_link", "gps", NONE, (away, 0, 0))]
    assert place(logged(tmp_path, data, rows)) is None


@pytest.mark.slow
def test_the_antenna_of_a_transform_is_used_as_one_of_an_option(tmp_path, road):
    result, _ = run(logged(tmp_path, road, RIGHT), input={"gyro_kind": "mean-rate"})
    np.testing.assert_allclose(result["filter"]["lever_arm_m"], LEVER, atol=1e-12)
    said = {f["kind"]: f for f in result["findings"]}
    assert said["lever-arm-transform"]["severity"] == "note"
    assert "lever-arm-used" not in said
    assert "/tf_static" in said["lever-arm-transform"]["text"]


@pytest.mark.slow
def test_a_transform_that_the_motion_denies_is_named_and_not_used(tmp_path, road):
    log = logged(tmp_path, road, WRONG)
    result, _ = run(log, input={"gyro_kind": "mean-rate"})
    np.testing.assert_allclose(result["filter"]["lever_arm_m"], LEVER, atol=0.2)
    said = {f["kind"]: f["severity"] for f in result["findings"]}
    assert said["lever-arm-transform"] == "warning"
    assert "lever-arm-used" in said
    told, _ = run(log, input={"gyro_kind": "mean-rate"}, gnss={"lever_arm": tuple(LEVER.tolist())})
    assert told["filter"]["lever_arm_m"] == LEVER.tolist()
    assert "lever-arm-transform" not in {f["kind"] for f in told["findings"]}
