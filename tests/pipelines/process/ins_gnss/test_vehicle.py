"""Rest, wheels and axles that cannot slide over whole logs: used where they hold."""

from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from scipy.spatial.transform import Rotation

from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.core.errors import ConfigurationError
from sinstool.core.rotation import conjugate, from_euler, log, multiply, to_dcm
from sinstool.io.readers import open_log
from sinstool.pipelines.process.errors_against_truth import read_references
from sinstool.pipelines.process.ins_gnss.vehicle import mount_of
from sinstool.pipelines.process.run import process
from tests.helpers.filter_logs import errors, nees, run, simulated
from tests.helpers.imulogs import T0, serialised, store
from tests.helpers.unseen_drives import GRADES, LEVER, boat, drive, multicopter, record, walk, write
from tests.io.readers.test_transforms import static

MOUNT = (2.0, -4.0, 5.0)
# A car's gyros level it by the axis about which they feel its turns: misaligned, not by the case
CAR = (
    "--duration", "420", "--grade", "mems", "--mount", "2,-4,5", "--axle-lever", "1.5", "--slip",
    "0.05", "--sideslip", "0.003", "--idle", "0.3,0.01", "--gnss-outage", "240:290",
    "--no-misalignment",
)  # fmt: skip


@pytest.fixture(scope="module")
def car(tmp_path_factory):
    path = tmp_path_factory.mktemp("vehicle") / "car.mcap"
    return simulated(
        path, "drive", *CAR, "--seed", "5", "--wheels", "odometry", "--wheel-scale", "3",
        "--wheel-latency", "0.2",
    )  # fmt: skip


def kinds(chosen):
    return {finding["kind"] for finding in chosen["findings"]}


def outage(path, solution):
    """Largest horizontal error in the outage, m."""
    off, _ = errors(path, solution)["position"]
    seconds = (solution.time_ns[::20] - solution.time_ns[0]) * 1e-9
    during = (seconds > 240.0) & (seconds < 290.0)
    return float(np.nanmax(np.hypot(off[during, 0], off[during, 1])))


@pytest.mark.slow
def test_each_constraint_makes_outages_shorter(tmp_path):
    """Four drives, as a single outage is long or short by chance."""
    squares = {"none": 0.0, "axle": 0.0, "all": 0.0}
    options = {"none": {"filter": {"vehicle": "none"}}, "axle": {"input": {"wheels": "none"}}}
    for seed in (5, 6, 7, 8):
        car = simulated(
            tmp_path / f"{seed}.mcap", "drive", *CAR, "--seed", str(seed), "--wheels", "odometry"
        )
        for name in squares:
            _, solution = run(car, **options.get(name, {}))
            squares[name] += outage(car, solution) ** 2
    assert squares["axle"] < 0.8**2 * squares["none"]
    assert squares["all"] < 0.8**2 * squares["axle"]


@pytest.mark.slow
def test_mount_axle_and_wheels_are_found(tmp_path):
    car = simulated(
        tmp_path / "car.mcap", "drive", *CAR, "--seed", "6", "--wheels", "odometry",
        "--wheel-scale", "3", "--wheel-latency", "0.2",
    )  # fmt: skip
    chosen, solution = run(car)
    assert outage(car, solution) < 10.0
    land = chosen["filter"]["vehicle"]["land"]
    assert land["mount_sigma_deg"][1] < 0.5
    for k in (1, 2):
        assert abs(land["mount_deg"][k] - MOUNT[k]) < 3.0 * land["mount_sigma_deg"][k - 1]
    assert abs(land["axle_m"] - 1.5) < 3.0 * land["axle_sigma_m"]
    wheels = land["wheels"]
    assert wheels["metres_per_unit"] == pytest.approx(1.0 / 1.03, abs=3e-3)
    assert abs(wheels["latency_s"] - 0.2) < 4.0 * wheels["latency_sigma_s"]
    assert {"wheel-scale", "wheel-latency"} <= kinds(chosen)
    attitude, position = (errors(car, solution)[kind] for kind in ("attitude", "position"))
    assert nees(*attitude)[0] < 1.5 and nees(*position)[0] < 2.5


@pytest.mark.slow
def test_the_attitude_of_the_vehicle_is_written(car, tmp_path):
    out = tmp_path / "out.mcap"
    options = {
        "navigation": {"mode": "ins-gnss"},
        "filter": {"smooth": True},
        "output": {"emit": ("imu", "vehicle")},
    }
    result = process(car, out, build(ProcessConfig, options))
    with open_log(car) as opened:
        times, q_true = read_references(opened, ("/truth/vehicle",), "flu").attitude
    with open_log(out) as opened:
        stamps, q_nv = read_references(opened, ("/sinstool/vehicle",), "flu").attitude
    k = np.searchsorted(times, stamps[5000::50])
    off = log(multiply(q_true[k], conjugate(q_nv[5000::50])))
    assert np.degrees(np.sqrt(np.mean(off**2))) < 1.0
    # A smoothed run uses the mount that the filter had in the end
    with open_log(out) as opened:
        _, q_nb = read_references(opened, ("/sinstool/imu",), "flu").attitude
    mount = from_euler(np.radians(result.filter.vehicle.land.mount_deg))
    assert np.abs(log(multiply(q_nv, conjugate(multiply(q_nb, conjugate(mount)))))).max() < 1e-6


@pytest.mark.slow
def test_a_vehicle_that_stands_stays_where_it_is(tmp_path):
    path = simulated(
        tmp_path / "stand.mcap", "drive", "--duration", "260", "--still", "150", "--grade", "mems",
        "--seed", "8", "--idle", "0.3,0.01",
    )  # fmt: skip
    chosen, solution = run(path, filter={"smooth": True})
    assert chosen["filter"]["vehicle"]["rest_s"] > 100.0
    seconds = (solution.time_ns - solution.time_ns[0]) * 1e-9
    stands = (seconds > 20.0) & (seconds < 145.0)
    assert np.sqrt(np.mean(np.sum(solution.velocity_n[stands] ** 2, axis=1))) < 0.02
    assert np.ptp(solution.position[stands, 2]) < 1.0


@pytest.mark.slow
def test_an_engine_that_idles_makes_no_tilt_too_certain(tmp_path):
    """Held at rest, the tilt follows the mean force, as well as what shakes it lets that be."""
    squares = []
    for seed in (3, 5, 7):
        path = simulated(
            tmp_path / f"{seed}.mcap", "drive", "--duration", "600", "--grade", "tactical",
            "--seed", str(seed), "--gnss-model", "coloured", "--idle", "0.3,0.01",
        )  # fmt: skip
        _, solution = run(path)
        off = errors(path, solution, 90.0)
        late = solution.time_ns >= solution.time_ns[0] + 90 * 10**9
        rows = solution.rows(np.flatnonzero(late)[::20])
        stands = np.linalg.norm(rows.velocity_n, axis=1) < 0.2
        error, covariance = off["attitude"]
        tilt = error[stands, :2] ** 2 / np.einsum("nii->ni", covariance)[stands, :2]
        squares.append(np.mean(tilt))
    assert np.mean(squares) < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("vehicle", ["auto", "none"])
def test_stops_within_outages_are_shaken_too(tmp_path, vehicle):
    """A first pass that does not know of the shaking is sure of a speed where the car stands."""
    squares = []
    for seed in (0, 1, 2, 3):
        path = simulated(
            tmp_path / f"{seed}.mcap", "drive", "--duration", "600", "--grade", "tactical",
            "--seed", str(seed), "--idle", "0.3,0.01", "--outages", "60,150",
        )  # fmt: skip
        _, solution = run(path, navigation={"imu_grade": "tactical"}, filter={"vehicle": vehicle})
        squares.append(nees(*errors(path, solution, 90.0)["attitude"])[0])
    assert 0.5 < np.mean(squares) < 1.3


@pytest.mark.slow
def test_fixes_that_wander_at_rest_get_a_larger_sigma(tmp_path):
    """Heights of a parked car that go up and down by more than the receiver says."""
    truth = drive(3, 240.0, rest=150.0)
    data = record(truth, GRADES["industrial"], 3, gnss_rate=2.0, sigma=0.3, sigma_v=0.05)
    heights = data.fixes.height + 3.0 * np.sin(0.03 * data.fixes.seconds)
    log = write(tmp_path / "log.mcap", replace(data, fixes=replace(data.fixes, height=heights)))
    arm = tuple(LEVER.tolist())
    chosen, solution = run(log, gnss={"lever_arm": arm}, input={"gyro_kind": "mean-rate"})
    assert "in height" in chosen["filter"]["gnss_noise"]
    seconds = (solution.time_ns - T0) * 1e-9
    parked = (seconds > 70.0) & (seconds < 145.0)
    k = np.searchsorted(truth.seconds, seconds[parked] - 1e-6)
    off = solution.position[parked, 2] - truth.height[k]
    sigma = np.sqrt(solution.covariance_position_n[parked, 2, 2])
    assert np.sqrt(np.mean((off / sigma) ** 2)) < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["manoeuvring-flight", "spiral-climb"])
def test_an_aircraft_is_left_alone(tmp_path, scenario):
    path = simulated(
        tmp_path / "flight.mcap", scenario, "--duration", "240", "--grade", "tactical",
        "--seed", "3",
    )  # fmt: skip
    chosen, _ = run(path, navigation={"imu_grade": "tactical"})
    assert chosen["filter"]["vehicle"]["kind"] == "none"
    assert chosen["filter"]["vehicle"]["land"] is None


@pytest.mark.slow
@pytest.mark.parametrize("motion", [boat, walk, multicopter])
def test_what_is_no_car_is_left_alone(tmp_path, motion):
    truth = motion(11, 300.0)
    data = record(truth, GRADES["industrial"], 11, gnss_rate=5.0, sigma=0.3, sigma_v=0.05)
    arm = tuple(LEVER.tolist())
    chosen, _ = run(write(tmp_path / "log.mcap", data), gnss={"lever_arm": arm})
    assert chosen["filter"]["vehicle"]["kind"] == "none", chosen["filter"]["vehicle"]["reason"]
    assert chosen["filter"]["vehicle"]["rest_s"] == 0.0


@pytest.mark.slow
def test_a_ferry_does_not_carry_the_constraint_away(tmp_path):
    squares = {"none": 0.0, "auto": 0.0}
    for seed in (4, 5):
        path = simulated(
            tmp_path / f"{seed}.mcap", "drive", "--duration", "500", "--grade", "mems",
            "--seed", str(seed), "--ferry", "200,120",
        )  # fmt: skip
        for vehicle in squares:
            _, solution = run(path, filter={"vehicle": vehicle})
            off, covariance = errors(path, solution, 30.0)["position"]
            squares[vehicle] += float(np.nanmean(np.sum(off[:, :2] ** 2, axis=1)))
            assert nees(off, covariance)[1] < 6.0
    assert squares["auto"] < 1.2**2 * squares["none"]


@pytest.mark.slow
def test_a_mount_that_motion_denies_is_said(car):
    chosen, _ = run(car, filter={"mount": (2.0, -4.0, 25.0)})
    assert chosen["filter"]["vehicle"]["kind"] == "none"
    assert "mount" in kinds(chosen)


def test_wheels_that_are_named_in_vain_are_said(tmp_path):
    path = simulated(
        tmp_path / "still.mcap", "drive", "--duration", "100", "--still", "70", "--grade", "mems",
        "--seed", "2", "--wheels", "twist",
    )  # fmt: skip
    chosen, _ = run(path, input={"wheels": "/wheels"})
    assert chosen["filter"]["vehicle"]["land"] is None
    assert "wheels-unused" in kinds(chosen)


@pytest.mark.slow
def test_wheels_that_are_read_once_a_second_are_used(tmp_path):
    """As by the diagnostic plug of a car."""
    car = simulated(
        tmp_path / "car.mcap", "drive", *CAR, "--seed", "6", "--wheels", "twist",
        "--wheel-rate", "1", "--wheel-noise", "0.1",
    )  # fmt: skip
    chosen, solution = run(car)
    assert chosen["filter"]["vehicle"]["land"]["wheels"]["used"] > 500
    assert nees(*errors(car, solution)["position"])[0] < 2.5


@pytest.mark.slow
def test_wheels_that_are_read_too_seldom_are_said_to_be_unused(tmp_path):
    car = simulated(
        tmp_path / "car.mcap", "drive", *CAR, "--seed", "5", "--wheels", "twist",
        "--wheel-rate", "0.5", "--wheel-latency", "0.3",
    )  # fmt: skip
    chosen, _ = run(car)
    assert chosen["filter"]["vehicle"]["land"]["wheels"]["used"] == 0
    assert "wheels-unused" in kinds(chosen) and "wheel-latency" not in kinds(chosen)


@pytest.mark.parametrize(
    "options, named",
    [
        ({"vehicle": "land", "feedback": "none"}, "--feedback"),
        ({"vehicle": "none", "mount": (0.0, 0.0, 90.0)}, "--mount"),
    ],
)
def test_what_cannot_be_is_refused(options, named):
    with pytest.raises(ConfigurationError, match=named):
        build(ProcessConfig, {"filter": options})


def with_transform(path, out, roll, pitch, yaw):
    """A log with a static transform that puts the IMU at these angles (forward, right, down)."""
    flip = np.diag([1.0, -1.0, -1.0])
    angles = np.radians([roll, pitch, yaw])
    c_flu = flip @ to_dcm(from_euler(angles)) @ flip
    message = static(("base_link", "imu_link", Rotation.from_matrix(c_flu).as_quat()))
    with path.open("rb") as source, out.open("wb") as target:
        writer = Writer(target)
        writer.start(profile="ros2")
        name = message.type_name
        text = store().generate_msgdef(name, ros_version=2)[0].encode()
        schema = writer.register_schema(name, "ros2msg", text)
        channel = writer.register_channel(message.topic, "cdr", schema)
        payload, numbers = serialised(message.message, name, 2), {}
        for kind, of, one in make_reader(source).iter_messages(log_time_order=True):
            if not numbers:
                writer.add_message(channel, one.log_time, payload, one.log_time)
            if of.id not in numbers:
                copied = writer.register_schema(kind.name, kind.encoding, kind.data)
                numbers[of.id] = writer.register_channel(of.topic, of.message_encoding, copied)
            writer.add_message(numbers[of.id], one.log_time, one.data, one.publish_time)
        writer.finish()
    return out


@pytest.mark.parametrize("yaw", [5.0, 95.0])
@pytest.mark.slow
def test_a_mount_of_the_logs_own_transforms_serves_where_motion_agrees(car, tmp_path, yaw):
    log = with_transform(car, tmp_path / "car.mcap", 2.0, -4.0, yaw)
    chosen, solution = run(log, input={"wheels": "none"})
    # Wheels that are not to be used are no velocity left out
    assert "velocity-left-out" not in kinds(chosen)
    land = chosen["filter"]["vehicle"]["land"]
    assert land["mount_deg"][2] == pytest.approx(MOUNT[2], abs=4.0 * land["mount_sigma_deg"][1])
    assert ("mount-transform" in kinds(chosen)) == (yaw != MOUNT[2])
    assert outage(log, solution) < 40.0


def test_a_transform_is_turned_into_the_axes_of_the_imu():
    turn = from_euler(np.radians([10.0, -20.0, 30.0]))
    forward_left_up = Rotation.from_euler("ZYX", [-30.0, 20.0, 10.0], degrees=True).as_quat()
    q = np.roll(forward_left_up, 1)
    assert np.allclose(mount_of(q, "flu"), to_dcm(turn), atol=1e-12)
    # An IMU whose axes are forward, right, down lies on its back in a frame forward, left, up
    on_its_back = np.roll(Rotation.from_euler("x", 180.0, degrees=True).as_quat(), 1)
    assert np.allclose(mount_of(on_its_back, "frd"), np.eye(3), atol=1e-12)
