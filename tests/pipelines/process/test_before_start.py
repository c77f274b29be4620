"""What `process` says of samples before its first attitude, without a filter."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sinstool.core.finding import Severity
from sinstool.pipelines.process.mode import before_alignment
from tests.helpers.imulogs import in_log_axes, read_attitude
from tests.helpers.unseen_drives import GRADES, LEVER, T0, drive, record, write


@pytest.mark.parametrize(
    ("begin_s", "severity"), [(0.0, None), (0.9, None), (40.0, "warning"), (60.0, "lost")]
)
def test_it_is_lost_where_most_of_a_log_has_no_solution(begin_s, severity):
    second = 10**9
    source = SimpleNamespace(survey=SimpleNamespace(first_ns=T0, last_ns=T0 + 100 * second))
    begin_ns = T0 + round(begin_s * second)
    found = before_alignment(source, SimpleNamespace(time_ns=begin_ns))
    if severity is None:
        assert not found
        return
    (finding,) = found
    assert finding.severity is Severity[severity.upper()]
    assert f"the first {begin_s:.2f} s have no solution" in finding.text
    assert (finding.start_ns, finding.end_ns) == (T0, begin_ns)


@pytest.mark.parametrize("mode", ["attitude", "ins"])
def test_a_first_attitude_beyond_a_gap_is_told(tmp_path, sinstool, mode):
    """The samples before the gap got no attitude, and nothing said so."""
    data = record(drive(7, 120.0, rest=0.0), GRADES["industrial"], 7, gnss_rate=5.0, sigma_v=0.05)
    kept = np.abs(data.seconds - 40.0) > 0.05
    columns = {name: getattr(data, name)[kept] for name in ("seconds", "gyro", "accel")}
    log = write(tmp_path / "log.mcap", replace(data, **columns))
    words = ["--mode", mode, "--align", "svd", "--gyro-kind", "mean-rate", "--json"]
    status, out, _ = sinstool("process", log, "-o", tmp_path / "out.mcap", *words)
    printed = json.loads(out)
    without = printed["imu"]["n"] - printed["output"]["attitudes"]
    (finding,) = (f for f in printed["findings"] if f["kind"] == "before-start")
    assert without > 35 * 200
    assert "the first 40.05 s have no solution" in finding["text"]
    assert (status, finding["severity"]) == (0, "warning")


@pytest.mark.parametrize("seed", range(4))
def test_a_first_attitude_is_carried_back_over_a_few_lost_samples(tmp_path, sinstool, seed):
    """Of 0.06 s without samples in the middle of a log, its first half had no attitude."""
    truth = drive(seed, 120.0, rest=0.0)
    data = record(truth, GRADES["industrial"], seed, gnss_rate=5.0, sigma_v=0.05)
    kept = np.abs(data.seconds - 40.0) > 0.03
    columns = {name: getattr(data, name)[kept] for name in ("seconds", "gyro", "accel")}
    log, out = write(tmp_path / "log.mcap", replace(data, **columns)), tmp_path / "out.mcap"
    words = ["--mode", "ins", "--align", "svd", "--gyro-kind", "mean-rate", "--json"]
    words += ["--lever-arm", ",".join(map(str, LEVER))]
    _, printed, _ = sinstool("process", log, "-o", out, *words)
    printed = json.loads(printed)
    assert not [f for f in printed["findings"] if f["kind"] == "before-start"]
    assert printed["output"]["attitudes"] == printed["imu"]["n"]
    _, q = read_attitude(out)
    true = in_log_axes(Rotation.from_matrix(truth.c_nb[:1]).as_quat(scalar_first=True))
    off = (Rotation.from_quat(q[:1]) * true.inv()).as_rotvec(degrees=True)[0]
    # of ENU in the order of NED
    sigma = np.array(printed["alignment"]["sigma_deg"])[[1, 0, 2]]
    assert np.abs(off / sigma).max() < 3.5
