"""The Earth's rate, where nothing shows in which direction it is."""

import pytest

import sinstool
from tests.helpers.filter_logs import simulated
from tests.helpers.quick import mostly_slow


@pytest.mark.parametrize("seed", mostly_slow([3, 4, 5], 4))
def test_a_latitude_does_not_tilt_good_gyros_of_unknown_heading(tmp_path, seed):
    """It was removed as if the log began northwards: 7 deg of tilt in an hour, status 0."""
    options = ["--grade", "navigation", "--still", "5", "--gnss-rate", "0", "--rate", "50"]
    length = ["--seed", str(seed), "--duration", "1200"]
    path = simulated(tmp_path / "in.mcap", "drive", *options, *length)

    def run(**options):
        result = sinstool.process(
            path, mode="attitude", latitude=48.1, truth="/truth/imu", **options
        )
        said = [one for one in result.findings if one.kind == "earth-rate"]
        return result.summary.truth.vertical_deg, said

    held, said = run()
    assert held.inclination_rms < 0.2 and not said
    integrated, (said,) = run(attitude="inertial")
    assert integrated.inclination_largest > 0.5
    assert 19.0 < said.numbers["drift_deg_h"] < 21.0
