"""Logs whose gyros are clipped: what is beyond the range is not known."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.core import rotation
from tests.helpers.filter_logs import run
from tests.helpers.unseen_drives import CONSUMER, LEVER, T0, drive, multicopter, record, write


def clipped(data, share):
    """A record with gyros cut off at this share of the largest rate of each axis."""
    limit = share * np.abs(data.gyro).max(axis=0)
    return replace(data, gyro=np.clip(data.gyro, -limit, limit))


def largest_ratio(truth, solution):
    """Errors of velocity, tilt and heading over their sigmas, root mean squares."""
    seconds = (solution.time_ns - T0) * 1e-9
    error = truth.errors_of(
        seconds, *solution.position.T, solution.velocity_n, rotation.to_dcm(solution.q_nb)
    )[:, 3:]
    sigma = np.sqrt(
        np.hstack(
            [
                np.einsum("nii->ni", solution.covariance_velocity_n),
                np.einsum("nii->ni", solution.covariance_attitude_n),
            ]
        )
    )
    return np.sqrt(np.mean(np.square(error / sigma), axis=0)).max()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "seed", "smooth"),
    [(multicopter, 1, True), (multicopter, 2, True), (drive, 1, True), (drive, 2, False)],
)
def test_a_solution_is_as_uncertain_as_it_says_where_gyros_are_clipped(
    tmp_path, make, seed, smooth
):
    """Heading was 5 sigmas off in both drives, and other faults were named with the second log."""
    truth = make(seed, 240.0)
    data = record(truth, CONSUMER, seed, gnss_rate=5.0, sigma=0.5, sigma_v=0.06)
    log = write(tmp_path / "log.mcap", clipped(data, 0.6))
    result, solution = run(
        log,
        input={"gyro_kind": "mean-rate"},
        filter={"smooth": smooth},
        gnss={"lever_arm": tuple(LEVER.tolist())},
    )
    kinds = {finding["kind"] for finding in result["findings"]}
    assert "saturation" in kinds
    assert not kinds & {"gyros-do-not-fit", "divergence", "not-trusted"}
    assert largest_ratio(truth, solution) < 2.0
