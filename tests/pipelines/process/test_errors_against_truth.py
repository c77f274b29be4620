"""Errors of solutions that are off a known truth by known amounts."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sinstool.api.process import process_one
from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.core.rotation import conjugate
from sinstool.core.streams import Solution
from sinstool.io.readers.frames import q_for_log
from sinstool.pipelines.process.errors_against_truth import Errors, Truth
from tests.helpers.optimal_filter import radii
from tests.pipelines.process.test_magnetometer import T0, turning_log

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
TURNING = np.array([0.02, -0.01, 0.3])


def seconds(time_ns):
    return (time_ns - START) * 1e-9


def attitude(time_ns):
    first = Rotation.from_euler("ZYX", [2.0, 0.1, -0.3])
    return first * Rotation.from_rotvec(np.outer(seconds(time_ns), TURNING))


def position(time_ns):
    """Eastward over the date line."""
    t = seconds(time_ns)
    longitude = np.pi - 4e-6 + 1e-6 * t
    return np.stack([0.8 - 2e-7 * t, (longitude + np.pi) % (2.0 * np.pi) - np.pi, 50.0 + t], 1)


def velocity(time_ns):
    return np.array([1.0, 2.0, 3.0]) + np.outer(seconds(time_ns), [0.3, -0.2, 0.1])


def truth(times):
    q = attitude(times).as_quat(scalar_first=True)
    return Truth((times, q), (times, position(times)), (times, velocity(times)), ("/truth",))


def off_by(time_ns, turn, metres, speed):
    """Solutions that are off by rotation vectors in NED, m and m/s."""
    q = (Rotation.from_rotvec(turn) * attitude(time_ns)).as_quat(scalar_first=True)
    place = position(time_ns)
    rm, rn = radii(place[:, 0])
    wrong = place.copy()
    wrong[:, 0] += metres[:, 0] / (rm + place[:, 2])
    wrong[:, 1] += metres[:, 1] / ((rn + place[:, 2]) * np.cos(place[:, 0]))
    wrong[:, 2] -= metres[:, 2]
    zero = np.zeros((len(time_ns), 3))
    return Solution(time_ns, time_ns, q, zero, zero, wrong, velocity(time_ns) + speed)


@pytest.mark.parametrize("block", [1, 7, 1000])
@pytest.mark.parametrize("count", [2, 3, 24])
def test_errors_of_every_kind(block, count):
    times = START + (np.linspace(0.0, 0.9 * (count - 1), count) * SECOND).astype(np.int64)
    # between instants of the truth, at its first and at its last, and beyond both ends
    at = np.arange(START, times[-1], SECOND // 7)
    at = np.concatenate([[START - SECOND // 2], at, [times[-1], times[-1] + 1]])
    random = np.random.default_rng(2)
    turn = 0.01 * random.standard_normal((len(at), 3))
    metres, speed = random.standard_normal((2, len(at), 3)) * [3.0, 2.0, 1.0]
    solution, errors = off_by(at, turn, metres, speed), Errors(truth(times))
    expected = {"attitude": turn, "position": metres, "velocity": speed}
    assert errors.kinds(solution) == list(expected)
    for kind, off in expected.items():
        parts = range(0, len(at), block)
        found = [errors.push(kind, solution.rows(slice(k, k + block))) for k in parts]
        found = np.concatenate(found)
        assert np.isnan(found[[0, -1]]).all()
        np.testing.assert_allclose(found[1:-1], off[1:-1], atol={"position": 2e-3}.get(kind, 1e-8))
    summary = errors.summary()
    for kind, unit, axes in summary.kinds():
        size = {"deg": np.pi / 180.0}.get(unit, 1.0)
        off = expected[kind][1:-1] / size
        assert axes.instants == len(off)
        np.testing.assert_allclose(axes.rms, np.sqrt(np.mean(off**2, axis=0)), atol=1e-3)
        np.testing.assert_allclose(axes.largest, np.abs(off).max(axis=0), atol=2e-3)
        np.testing.assert_allclose(axes.last, off[-1], atol=2e-3)


def test_inclination_and_heading_apart():
    times = START + np.arange(30) * SECOND
    at = np.arange(START, times[-1], SECOND // 10)
    heading, lean = 0.2 + 0.01 * seconds(at), 0.03 * np.cos(seconds(at))
    # a turn about the vertical after a lean about north
    turn = Rotation.from_euler("Z", heading[:, None]) * Rotation.from_euler("X", lean[:, None])
    zero = np.zeros((len(at), 3))
    for free in (False, True):
        errors = Errors(truth(times))
        errors.free_heading = free
        for part in np.array_split(np.arange(len(at)), 3):
            errors.push("attitude", off_by(at, turn.as_rotvec(), zero, zero).rows(part))
        apart = errors.summary().vertical_deg
        degree = np.pi / 180.0
        assert apart.inclination_rms == pytest.approx(np.sqrt(np.mean(lean**2)) / degree)
        assert apart.inclination_largest == pytest.approx(np.abs(lean).max() / degree)
        first = heading[0] if free else 0.0
        # tilt and heading by the shortest lean: beside a lean about north they are the same to 1 %
        assert apart.heading_rms == pytest.approx(
            np.sqrt(np.mean((heading - first) ** 2)) / degree, rel=0.01
        )
        assert apart.heading_drift == pytest.approx((heading[-1] - heading[0]) / degree, rel=0.01)
        aligned = apart.heading_aligned
        assert aligned == (pytest.approx(heading[0] / degree, rel=0.01) if free else None)


def test_a_hole_in_the_truth_is_not_bridged():
    times = START + np.concatenate([np.arange(0, 5), np.arange(30, 35)]) * SECOND
    at = START + np.arange(0, 340) * SECOND // 10
    zero = np.zeros((len(at), 3))
    found = Errors(truth(times)).push("velocity", off_by(at, zero, zero, zero))
    compared = np.isfinite(found).all(axis=1)
    # instants of the truth itself are compared, on both sides of the hole
    assert compared[at <= times[4]].all() and compared[at >= times[5]].all()
    assert not compared[(at > times[4]) & (at < times[5])].any()


@pytest.mark.parametrize("convention", ["right", "ned", "inverse", "placeholder"])
def test_a_reference_of_another_convention_is_doubted(tmp_path, convention):
    q_nb = turning_log(tmp_path / "log.mcap")
    written = q_for_log(q_nb, "flu", "enu")
    if convention == "ned":
        written = q_nb
    elif convention == "inverse":
        written = conjugate(written)
    elif convention == "placeholder":
        written = np.tile([1.0, 0.0, 0.0, 0.0], (len(q_nb), 1))
    table = tmp_path / "truth.csv"
    times = 0.02 * np.arange(len(q_nb)) + T0 * 1e-9
    rows = [f"{t:.9f},{w},{x},{y},{z}" for t, (w, x, y, z) in zip(times, written, strict=True)]
    table.write_text("\n".join(["time_s,qw,qx,qy,qz", *rows]))
    config = build(ProcessConfig, {"output": {"truth": (str(table),)}})
    result = process_one(tmp_path / "log.mcap", None, None, config, None)
    doubts = [f for f in result.findings if f.kind == "truth-axes"]
    assert len(doubts) == (convention != "right")
    assert all("these are no errors" in f.text for f in doubts)
