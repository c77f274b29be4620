"""Receivers that give no height, or none where a filter starts."""

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.filter_logs import run
from tests.helpers.unseen_drives import GRADES, LEVER, T0, drive, flight, record, write


@pytest.mark.slow
@pytest.mark.parametrize("make", [drive, flight])
@pytest.mark.parametrize("without", ["all", "first"])
def test_a_position_without_heights(tmp_path, make, without):
    """Horizontally it is as good as its sigmas say; they say of the height what is known of it."""
    truth = make(3, 200.0)
    data = record(truth, GRADES["industrial"], 3, gnss_rate=2.0, sigma=0.5, sigma_v=0.05)
    none = np.full(len(data.fixes.seconds), True) if without == "all" else data.fixes.seconds < 60.0
    fixes = replace(data.fixes, height=np.where(none, np.nan, data.fixes.height))
    log = write(tmp_path / "log.mcap", replace(data, fixes=fixes))
    result, solution = run(log, gnss={"lever_arm": tuple(LEVER.tolist())})
    assert not [f for f in result["findings"] if f["severity"] == "lost"]
    assert ("no-heights" in {f["kind"] for f in result["findings"]}) == (without == "all")
    seconds = (solution.time_ns - T0) * 1e-9
    late = seconds > (20.0 if without == "all" else 100.0)
    rows = solution.rows(late)
    error = truth.errors_of(seconds[late], *rows.position.T, rows.velocity_n, np.eye(3)[None])
    sigma = np.sqrt(np.einsum("nii->ni", rows.covariance_position_n))
    ratio = np.abs(error[:, :3]) / sigma
    assert np.sqrt(np.mean(ratio[:, :2] ** 2)) < 1.6 and np.hypot(*error[:, :2].T).max() < 3.0
    assert ratio[:, 2].max() < 4.0
    assert (sigma[:, 2].min() > 900.0) if without == "all" else (sigma[:, 2].max() < 3.0)
