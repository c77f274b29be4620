import pytest

import sinstool


@pytest.fixture(scope="session")
def drive(tmp_path_factory):
    """A short drive with GNSS and a barometer, and its log."""
    simulated = sinstool.simulate("drive", duration=90.0, rate=100.0, grade="tactical", seed=3)
    path = simulated.write(tmp_path_factory.mktemp("drive") / "drive.mcap")
    return simulated, path


@pytest.fixture(scope="session")
def navigated(drive):
    """Its solution in memory."""
    return sinstool.process(drive[1], imu_grade="tactical")
