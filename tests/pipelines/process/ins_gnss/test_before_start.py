"""Before a filter's start: a smoother's errors taken off it, and samples carried back."""

from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.core.finding import Severity
from sinstool.core.rotation import from_euler, rotate
from sinstool.methods.ins_gnss.states import ACCEL_BIAS, GYRO_BIAS, filter_kind
from sinstool.pipelines.process.ins_gnss.before_start import (
    before_start_finding,
    corrected_start,
)
from tests.helpers.filter_logs import errors, nees, run, simulated
from tests.helpers.filter_start import start


@pytest.mark.parametrize("name", ["plain-15", "network-26a"])
def test_a_start_less_its_error(name):
    kind = filter_kind(name)
    q = from_euler([0.1, -0.2, 2.0])
    known = {"gyro_bias": np.array([1e-4, 2e-4, 3e-4]), "accel_bias": np.array([0.1, 0.2, 0.3])}
    stated = start(-0.8, np.pi - 1e-7, 300.0, [3.0, -4.0, 0.5], q, 5.0, 0.2, 0.05, **known)
    error, covariance = np.zeros(kind.size), np.eye(kind.size)
    error[:9] = [10.0, -20.0, 3.0, 0.1, 0.2, -0.3, 0.0, 0.0, 0.02]
    # Biases are what is to be taken off: more of what the smoother finds
    gyro, accel = (kind.first(block) + np.arange(3) for block in (GYRO_BIAS, ACCEL_BIAS))
    error[gyro], error[accel] = [1e-5, -2e-5, 3e-5], [0.01, -0.02, 0.03]
    covariance[gyro, gyro], covariance[accel, accel] = [1e-10, 4e-10, 9e-10], [1e-4, 4e-4, 9e-4]
    result = corrected_start(stated, error, covariance, kind)
    assert (result.nav[0] + 0.8) * 6.37e6 == pytest.approx(-10.0, rel=0.01)
    # eastward over the date line, and still within half a turn
    assert -np.pi < result.nav[1] < -np.pi + 1e-4
    assert result.nav[2] == pytest.approx(303.0)
    assert np.allclose(result.nav[3:6], [2.9, -4.2, 0.8])
    # the true attitude is the one computed, turned about down
    forward = rotate(q, [1.0, 0.0, 0.0])
    turned = rotate(result.nav[6:10], [1.0, 0.0, 0.0])
    off = np.arctan2(turned[1], turned[0]) - np.arctan2(forward[1], forward[0])
    assert off == pytest.approx(0.02, abs=1e-9)
    assert np.allclose(result.covariance_attitude_n, np.eye(3))
    assert np.allclose(result.gyro_bias, [1.1e-4, 1.8e-4, 3.3e-4])
    assert np.allclose(result.accel_bias, [0.11, 0.18, 0.33])
    # one sigma for three axes: the largest
    assert result.gyro_bias_sigma == pytest.approx(3e-5)
    assert result.accel_bias_sigma == pytest.approx(0.03)


@pytest.mark.parametrize(
    ("first_fix_s", "solution_s", "lost"),
    [(0.0, 60.0, True), (0.0, 40.0, False), (70.0, 80.0, False), (70.0, 90.0, True)],
)
def test_most_of_a_log_without_a_solution_is_lost(first_fix_s, solution_s, lost):
    """Of what follows the first fix: before it there is none to be had."""
    fixes = np.array([first_fix_s - 1.0, first_fix_s, 99.0]) * 1e9
    used = SimpleNamespace(time_ns=fixes, has_position=np.array([False, True, True]))
    start = SimpleNamespace(time_ns=int(solution_s * 1e9), used=used)
    survey = SimpleNamespace(first_ns=0, last_ns=100_000_000_000)
    finding = before_start_finding(survey, start, None)
    assert finding.severity == (Severity.LOST if lost else Severity.WARNING)
    assert finding.kind == "before-start" and finding.text.endswith("have no solution")


@pytest.mark.parametrize("start_s, severity", [(0.01, Severity.NOTE), (3.0, Severity.WARNING)])
def test_a_moment_that_is_carried_back_is_no_reason_to_warn(start_s, severity):
    used = SimpleNamespace(time_ns=np.array([0, 99e9]), has_position=np.array([True, True]))
    start = SimpleNamespace(time_ns=round(start_s * 1e9), used=used)
    survey = SimpleNamespace(first_ns=0, last_ns=100_000_000_000)
    earliest = SimpleNamespace(time_ns=np.array([0]), covariance_position_n=None)
    assert before_start_finding(survey, start, earliest).severity == severity


@pytest.mark.parametrize(
    ("sigma_m", "fix_s", "lost"),
    [(90.0, 5.0, False), (110.0, 5.0, True), (9000.0, 5.0, True), (9000.0, 39.5, False)],
)
def test_what_is_carried_back_beside_fixes_that_are_much_better_is_lost(sigma_m, fix_s, lost):
    """280 of 367 s of a log were up to 9 km off, where it has fixes, and only a warning said so."""
    used = SimpleNamespace(time_ns=np.array([fix_s, 99.0]) * 1e9, has_position=np.array([True] * 2))
    start = SimpleNamespace(time_ns=40_000_000_000, used=used)
    survey = SimpleNamespace(first_ns=0, last_ns=100_000_000_000)
    covariance = np.diag([sigma_m, 3.0, 2e4])[None] ** 2
    earliest = SimpleNamespace(time_ns=np.array([0]), covariance_position_n=covariance)
    finding = before_start_finding(survey, start, earliest)
    assert finding.severity == (Severity.LOST if lost else Severity.WARNING)
    assert ("fixes there (1) are not used" in finding.text) == lost
    if lost:
        assert (finding.start_ns, finding.end_ns) == (0, start.time_ns)
        assert finding.numbers["position_m"] == pytest.approx(sigma_m)


@pytest.mark.slow
def test_fixes_that_begin_late(tmp_path):
    log = simulated(
        tmp_path / "late.mcap", "drive", "--grade", "tactical", "--seed", "4", "--duration", "180",
        "--gnss-offset", "25", "--still", "10",
    )  # fmt: skip
    for smooth in (False, True):
        chosen, solution = run(log, filter={"smooth": smooth})
        assert int(chosen["filter"]["start"]["time_ns"]) - solution.time_ns[0] > 20_000_000_000
        assert len(solution) == chosen["imu"]["n"]
        assert np.all(np.diff(solution.time_ns) > 0)
        early = solution.rows(slice(0, 2400))
        mean, most = nees(*errors(log, early)["attitude"])
        assert most < 4.5 and mean < 3.0
        mean, most = nees(*errors(log, early)["position"])
        assert most < 4.5
        assert any("carried back by the IMU alone" in w for w in chosen["warnings"])
