"""Two parts of a log with an outage between: a start before the fixes of the first part."""

import numpy as np
import pytest

from tests.helpers.filter_logs import start_of
from tests.helpers.unseen_drives import (
    T0,
    flight,
    record,
    sensor_errors,
    without_fixes,
    write,
)

# As phones have them
CHIP = sensor_errors(0.4, 360.0, 0.12, 20000.0, 5000.0, 100.0)
OUTAGE = (231.0, 311.0)


@pytest.mark.slow
def test_fixes_before_an_outage_are_used_although_those_after_it_show_more(tmp_path):
    """Carried back over the outage, what those after it show is too uncertain for a start."""
    motion = flight(13, 420.0)
    data = without_fixes(record(motion, CHIP, 13, gnss_rate=5.0, sigma=8.0), [OUTAGE])
    found = start_of(write(tmp_path / "log.mcap", data), input={"gyro_kind": "mean-rate"})
    begins = (found.time_ns - T0) * 1e-9
    assert begins < 5.0
    true = motion.c_nb[np.searchsorted(motion.seconds, begins)]
    heading = np.arctan2(true[1, 0], true[0, 0])
    sigma = np.sqrt(found.start.covariance_attitude_n[2, 2])
    w, x, y, z = found.start.nav[6:10]
    off = np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z)) - heading
    assert abs((off + np.pi) % (2.0 * np.pi) - np.pi) < 3.0 * sigma
