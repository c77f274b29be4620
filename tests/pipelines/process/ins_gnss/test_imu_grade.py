"""A quiet Imu whose biases are not those of the grade that its noise at rest looks like."""

import numpy as np
import pytest

from sinstool.core.errors import AlignmentError
from sinstool.core.units import DEGREE_PER_ROOT_HOUR
from tests.helpers.filter_logs import simulated, start_of
from tests.helpers.unseen_drives import GRADES, LEVER, drive, record, with_outliers, write


@pytest.mark.parametrize(("grade", "expected"), [("industrial", "industrial"), ("tactical", None)])
def test_what_drifts_as_a_worse_grade_is_taken_for_one(tmp_path, grade, expected):
    data = record(drive(9, 260.0, 20.0), GRADES[grade], 32, gnss_rate=10.0, sigma=0.9)
    if expected is None:  # bad fixes refute no Imu
        data = with_outliers(data, 31)
    log = write(tmp_path / "log.mcap", data)
    gnss = {"lever_arm": tuple(LEVER.tolist()), "gnss_latency": 0.0}
    start = start_of(log, input={"gyro_kind": "mean-rate"}, gnss=gnss)
    assert (start.grade.grade == "industrial") == (expected == "industrial"), start.grade
    bias = np.rad2deg(start.settings.imu.gyro_bias) * 3600.0
    # Of 0.027 deg/h, which the noise of a navigation grade does not exclude
    assert bias > 20.0 if expected else 0.027 < bias < 2.0
    assert ("too much without fixes" in start.grade.why) == (expected is not None)
    # 0.0064 deg/sqrt(h) at rest
    assert expected or start.settings.imu.angle_random_walk < 0.007 * DEGREE_PER_ROOT_HOUR


@pytest.mark.parametrize(
    ("part", "grade", "named"),
    [
        ({"end": "20"}, "auto", False),
        ({"start": "25"}, "auto", True),
        ({"start": "25"}, "mems", False),
    ],
)
def test_a_grade_is_asked_for_where_no_rest_shows_it_and_nothing_starts(
    tmp_path, part, grade, named
):
    # Standing shows no heading to a MEMS, nor do seven seconds of driving
    log = simulated(
        tmp_path / "log.mcap", "drive", "--duration", "32", "--still", "15", "--grade", "mems",
        "--rate", "50", "--baro-rate", "0",
    )  # fmt: skip
    with pytest.raises(AlignmentError) as refused:
        start_of(log, input=part, navigation={"imu_grade": grade})
    assert ("--imu-grade" in refused.value.hint) == named


@pytest.mark.parametrize(
    ("grade", "option", "expected"),
    [
        ("mems", "auto", True),
        ("tactical", "auto", False),
        ("tactical", "on", True),
        ("mems", "off", False),
    ],
)
def test_fictitious_noise_is_added_for_mems_or_as_asked_for(tmp_path, grade, option, expected):
    log = simulated(
        tmp_path / "log.mcap", "drive", "--duration", "60", "--still", "10", "--grade", grade,
        "--rate", "50", "--baro-rate", "0",
    )  # fmt: skip
    start = start_of(
        log,
        navigation={"imu_grade": grade},
        filter={"virtual_noise": option},
        gnss={"gnss_latency": 0.0},
        align={"align": "fixed", "initial_attitude": (0.0, 0.0, 0.0)},
    )
    assert start.settings.control.virtual_noise == expected
