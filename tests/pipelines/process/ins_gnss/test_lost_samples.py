"""Logs that lack single samples on a rough road: what happened in them is not known."""

import numpy as np
import pytest

from sinstool.core import rotation
from tests.helpers.filter_logs import run
from tests.helpers.unseen_drives import GRADES, LEVER, T0, drive, flight, record, write
from tests.helpers.unseen_errors import slower, with_lost


def over_sigmas(truth, solution):
    """Tilt and heading errors, deg, and over their sigmas, root mean squares."""
    seconds = (solution.time_ns - T0) * 1e-9
    error = truth.errors_of(
        seconds, *solution.position.T, solution.velocity_n, rotation.to_dcm(solution.q_nb)
    )[:, 6:]
    ratio = error / np.sqrt(np.einsum("nii->ni", solution.covariance_attitude_n))
    tilt, heading = slice(0, 2), slice(2, 3)
    return [
        float(np.sqrt(np.mean(np.square(values[:, of]))))
        for values in (np.degrees(error), ratio)
        for of in (tilt, heading)
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    "make, seed, every, share, tilt",
    [(drive, 903, 8, 0.005, 0.2), (flight, 902, 8, 0.03, 0.6)],
)
def test_attitude_is_as_uncertain_as_it_says(tmp_path, make, seed, every, share, tilt):
    """The first was more than a degree off, and without trust."""
    truth = make(seed, 240.0, 20.0) if make is drive else make(seed, 240.0, True)
    data = record(truth, GRADES["tactical"], 3, gnss_rate=2.0, sigma=0.05)
    data = with_lost(slower(data, every), 3, share)
    log = write(tmp_path / "log.mcap", data)
    result, solution = run(log, gnss={"lever_arm": tuple(LEVER.tolist())})
    kinds = {finding["kind"] for finding in result["findings"]}
    assert "missed-samples" in kinds
    assert "not-trusted" not in kinds
    off, turned, tilt_sigmas, heading_sigmas = over_sigmas(truth, solution)
    assert off < tilt
    assert turned < 3.0 * tilt
    assert tilt_sigmas < 1.5
    assert heading_sigmas < 1.5
