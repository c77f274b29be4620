"""Shared by the tests of commands."""

import pytest

from tests.helpers.imulogs import even_times, handheld, imu_log


@pytest.fixture
def log(tmp_path):
    """A good log, alone in its folder."""
    folder = tmp_path / "logs"
    folder.mkdir()
    gyro, accel, _ = handheld(1000, rest_s=2.0)
    return imu_log(folder / "good.mcap", even_times(1000), gyro, accel)
