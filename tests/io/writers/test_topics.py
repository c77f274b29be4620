"""What is written of a navigation solution, read back by another library."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sinstool.core import earth
from sinstool.core.streams import Diagnostics, Solution
from sinstool.io.writers.mcap import McapWriter
from sinstool.io.writers.solution import SolutionWriter
from sinstool.io.writers.solution_topics import Frames, topic_of
from tests.helpers.imulogs import ENU_NED, FLU_FRD, T0, read_topic

N = 50
ORIGIN = (np.radians(-33.4), np.radians(151.2), 80.0)
NAMES = ("nis", "innovation north m")


def solution(seed=0):
    rng = np.random.default_rng(seed)
    times = T0 + np.arange(N) * 5_000_000
    q = Rotation.random(N, rng=rng)
    position = np.array(ORIGIN) + rng.normal(size=(N, 3)) * [1e-4, 1e-4, 30.0]
    return q, Solution(
        times,
        times + 7,
        q.as_quat(scalar_first=True),
        rng.normal(size=(N, 3)),
        rng.normal(size=(N, 3)),
        position,
        rng.normal(size=(N, 3)) * 10,
        rng.normal(size=(N, 3)),
        *(_positive(rng) for _ in range(3)),
    )


def _positive(rng):
    a = rng.normal(size=(N, 3, 3))
    return a @ np.swapaxes(a, 1, 2)


def write(path, made, frames, encoding="cdr", diagnostics=None):
    with open(path, "wb") as stream:
        writer = McapWriter(stream, "ros1" if encoding == "ros1" else "ros2", "test")
        emits = ["imu", "odometry", "fix", "height", "tf", "pose", "diagnostics"]
        out = SolutionWriter(writer, encoding, emits, frames, lambda _: None, NAMES)
        if diagnostics is not None:
            out.note(diagnostics)
        for k in range(0, N, 7):
            out.push(made.rows(slice(k, k + 7)))
        out.finish()
        writer.finish()
    return path


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
@pytest.mark.parametrize(("axes", "world"), [("flu", "enu"), ("frd", "ned"), ("flu", "ned")])
def test_odometry_fix_and_height(tmp_path, encoding, axes, world):
    q, made = solution()
    frames = Frames(world, "map", "imu_link", axes, ORIGIN)
    path = write(tmp_path / "a.mcap", made, frames, encoding)
    messages = [m for _, m in read_topic(path, "/sinstool/odometry")]
    assert len(messages) == N
    turn = ENU_NED if world == "enu" else Rotation.identity()
    flip = FLU_FRD if axes == "flu" else Rotation.identity()
    body = turn * q * flip  # the log's body in the written world
    m = messages[3]
    assert m.header.frame_id == ("map" if world == "enu" else "map_ned")
    assert m.child_frame_id == "imu_link"
    o = m.pose.pose.orientation
    assert (Rotation.from_quat([o.x, o.y, o.z, o.w]).inv() * body[3]).magnitude() < 1e-12
    # position: a step along the meridian or the parallel is its radius times the angle, nearly
    p = m.pose.pose.position
    meridian, transverse = earth.radii_of_curvature(ORIGIN[0])
    d = made.position[3] - ORIGIN
    about = [
        d[0] * (meridian + 80.0),
        d[1] * (transverse + 80.0) * np.cos(ORIGIN[0]),
        -d[2],
    ]
    np.testing.assert_allclose([p.x, p.y, p.z], turn.apply(about), atol=0.5)
    t = m.twist.twist.linear
    world_velocity = body[3].apply([t.x, t.y, t.z])
    np.testing.assert_allclose(turn.inv().apply(world_velocity), made.velocity_n[3], atol=1e-12)
    covariance = np.array(m.pose.covariance).reshape(6, 6)
    matrix = turn.as_matrix()
    np.testing.assert_allclose(
        covariance[:3, :3], matrix @ made.covariance_position_n[3] @ matrix.T, atol=1e-12
    )
    np.testing.assert_allclose(
        covariance[3:, 3:], matrix @ made.covariance_attitude_n[3] @ matrix.T, atol=1e-12
    )
    twist = np.array(m.twist.covariance).reshape(6, 6)[:3, :3]
    c_nb = (q * flip)[3].as_matrix()
    x, y, z = made.velocity_n[3]
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned = across @ made.covariance_attitude_n[3] @ across.T
    np.testing.assert_allclose(
        c_nb @ twist @ c_nb.T, made.covariance_velocity_n[3] + turned, rtol=1e-12, atol=1e-12
    )

    fix = [m for _, m in read_topic(path, "/sinstool/fix")][4]
    assert np.radians(fix.latitude) == pytest.approx(made.position[4, 0], abs=1e-15)
    assert np.radians(fix.longitude) == pytest.approx(made.position[4, 1], abs=1e-15)
    assert fix.altitude == made.position[4, 2]
    assert fix.position_covariance_type == 3 and fix.status.status == 0
    enu = ENU_NED.as_matrix()
    np.testing.assert_allclose(
        np.array(fix.position_covariance).reshape(3, 3),
        enu @ made.covariance_position_n[4] @ enu.T,
        atol=1e-12,
    )
    height = [m for _, m in read_topic(path, "/sinstool/height")][5].vector
    np.testing.assert_array_equal([height.x, height.y, height.z], made.vertical[5])
    tf = [m for _, m in read_topic(path, "/tf")][3].transforms[0].transform.translation
    pose = [m for _, m in read_topic(path, "/sinstool/pose")][3].pose.position
    assert (tf.x, tf.y, tf.z) == (pose.x, pose.y, pose.z) == (p.x, p.y, p.z)


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_diagnostics_are_numbers_as_text(tmp_path, encoding):
    _, made = solution()
    times = made.time_ns[::10]
    values = np.array([[1.25, -3e-7], [-1e300, 0.0], [np.nan, -1.0], [2.0, np.inf], [3.0, 4.0]])
    level = np.array([0, 1, 2, 0, 0])
    diagnostics = Diagnostics(times, times + 7, level, values)
    path = write(
        tmp_path / "a.mcap", made, Frames("enu", "map", "x", "flu", ORIGIN), encoding, diagnostics
    )
    messages = [m for _, m in read_topic(path, topic_of("diagnostics"))]
    assert len(messages) == 5
    read = np.array([[float(v.value) for v in m.status[0].values] for m in messages])
    np.testing.assert_allclose(read, values, rtol=1e-6)
    assert [v.key for v in messages[0].status[0].values] == list(NAMES)
    assert [m.status[0].message.strip() for m in messages[:3]] == [
        "ok",
        "measurement off",
        "restarted",
    ]


def test_local_position_is_that_of_the_tangent_plane():
    """Against the sagitta of the ellipsoid: north d drops by d^2/2R, to third order."""
    d = 2e4
    meridian, _ = earth.radii_of_curvature(ORIGIN[0])
    north = earth.local_position_n(
        ORIGIN, [ORIGIN[0] + d / (meridian + ORIGIN[2]), ORIGIN[1], ORIGIN[2]]
    )
    assert north[0] == pytest.approx(d, rel=3e-5)
    assert north[1] == pytest.approx(0.0, abs=1e-9)
    assert north[2] == pytest.approx(d**2 / (2 * meridian), rel=1e-3)
    up = earth.local_position_n(ORIGIN, [ORIGIN[0], ORIGIN[1], ORIGIN[2] + 100.0])
    np.testing.assert_allclose(up, [0.0, 0.0, -100.0], atol=1e-8)
