"""Two parts of a log with an outage between: a start before the fixes of the first part."""

import numpy as np
import pytest

from sinstool.core.rotation import from_dcm, to_euler, wrapped
from tests.helpers.filter_logs import start_of
from tests.helpers.unseen_drives import (
    PHONE,
    T0,
    flight,
    record,
    without_fixes,
    write,
)

OUTAGE = (231.0, 311.0)


@pytest.mark.slow
def test_fixes_before_an_outage_are_used_although_those_after_it_show_more(tmp_path):
    """Carried back over the outage, what those after it show is too uncertain for a start."""
    motion = flight(13, 420.0)
    data = without_fixes(record(motion, PHONE, 13, gnss_rate=5.0, sigma=8.0), [OUTAGE])
    found = start_of(write(tmp_path / "log.mcap", data), input={"gyro_kind": "mean-rate"})
    begins = (found.time_ns - T0) * 1e-9
    assert begins < 5.0
    true = from_dcm(motion.c_nb[np.searchsorted(motion.seconds, begins)])
    heading, expected = (to_euler(q)[2] for q in (found.start.nav[6:10], true))
    sigma = np.sqrt(found.start.covariance_attitude_n[2, 2])
    assert abs(wrapped(heading - expected)) < 3.0 * sigma
