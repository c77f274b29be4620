"""GNSS and barometer out of a log: what is used, what is counted, what is refused."""

from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.config import InputOptions, ProcessConfig
from sinstool.config.load import build
from sinstool.core.errors import DataError, TopicError
from sinstool.core.streams import Gnss, Velocity
from sinstool.io.readers import open_log
from sinstool.io.readers.message_types import FIX_TYPE, JOINT_TYPE, PRESSURE_TYPE
from sinstool.survey.aiding import aiding_channels, read_barometer
from sinstool.survey.epochs import join
from sinstool.survey.gnss import read_gnss
from sinstool.survey.source import prepare
from tests.helpers.imulogs import (
    Message,
    even_times,
    handheld,
    header,
    imu_messages,
    store,
    write_log,
)

N = 60
TIMES = even_times(N, rate=2.0)
NORTH = np.linspace(0.0, 400.0, N)  # m, on a straight drive


def fix_message(k, time_ns, latitude, longitude, height=50.0, status=0, sigma=0.0):
    t = store(2).types
    return Message(
        "/fix",
        "sensor_msgs/msg/NavSatFix",
        int(time_ns),
        t["sensor_msgs/msg/NavSatFix"](
            header=header(int(time_ns), "gnss"),
            status=t["sensor_msgs/msg/NavSatStatus"](status=status, service=1),
            latitude=latitude,
            longitude=longitude,
            altitude=height,
            position_covariance=np.diag([sigma**2, 4 * sigma**2, 9 * sigma**2]).ravel(),
            position_covariance_type=2 if sigma else 0,
        ),
    )


def twist_message(time_ns, enu, variance=0.0, covariance=True):
    t = store(2).types
    vector = t["geometry_msgs/msg/Vector3"]
    twist = t["geometry_msgs/msg/Twist"](vector(*map(float, enu)), vector(0.0, 0.0, 0.0))
    name = "geometry_msgs/msg/TwistStamped"
    if covariance:
        matrix = np.zeros((6, 6))
        matrix[:3, :3] = np.diag([variance, 2 * variance, 3 * variance])
        twist = t["geometry_msgs/msg/TwistWithCovariance"](twist, matrix.ravel())
        name = "geometry_msgs/msg/TwistWithCovarianceStamped"
    made = t[name](header(int(time_ns), "gnss"), twist)
    return Message("/vel", name, int(time_ns), made)


def pressure_message(time_ns, pressure, topic="/baro"):
    made = store(2).types["sensor_msgs/msg/FluidPressure"](
        header(int(time_ns), "baro"), float(pressure), 4.0
    )
    return Message(topic, "sensor_msgs/msg/FluidPressure", int(time_ns), made)


def drive(latitude=48.0, scale=1.0, **options):
    """Fixes of a drive north, in degrees times ``scale``."""
    degrees = latitude + np.degrees(NORTH / 6.37e6)
    return [
        fix_message(k, TIMES[k], scale * degrees[k], scale * 11.0, 50.0 + k, **options)
        for k in range(N)
    ]


def gnss(tmp_path, messages, log_time=False, **options):
    ordered = sorted(messages, key=lambda m: m.time_ns if hasattr(m, "time_ns") else m[2])
    with open_log(write_log(tmp_path / "a.mcap", ordered)) as log:
        return read_gnss(log, InputOptions(**options), log_time)


def baro(tmp_path, messages, **options):
    with open_log(write_log(tmp_path / "a.mcap", messages)) as log:
        barometer = read_barometer(log, InputOptions(**options), False)
    if barometer.problem is not None:
        raise barometer.problem
    return barometer


def counted(aiding):
    """Messages by the kind of finding that counts them."""
    return {f.kind: f.numbers["messages"] for f in aiding.findings}


def test_position_and_velocity_of_an_epoch_share_a_row(tmp_path):
    velocity = [twist_message(TIMES[k] + 3_000_000, (1.0, 13.8, 0.2), 0.01) for k in range(0, N, 2)]
    into = gnss(tmp_path, drive(sigma=2.0) + velocity)
    epochs = into.gnss
    assert len(epochs) == N
    assert epochs.has_position.all()
    np.testing.assert_array_equal(epochs.has_velocity, np.arange(N) % 2 == 0)
    np.testing.assert_allclose(epochs.velocity_n[0], [13.8, 1.0, -0.2])
    np.testing.assert_allclose(epochs.sigma_position_n[0], [4.0, 2.0, 6.0])
    np.testing.assert_allclose(epochs.sigma_velocity_n[0], np.sqrt([0.02, 0.01, 0.03]))
    assert np.isnan(epochs.sigma_velocity_n[1]).all()
    np.testing.assert_array_equal(epochs.time_ns, TIMES)
    assert (into.fix_topic, into.velocity_topic) == ("/fix", "/vel")


def test_velocities_of_other_instants_get_rows_of_their_own():
    rows = np.arange(4) * 1_000_000_000
    n = len(rows)
    fixes = Gnss(rows, rows, np.full(n, 0.5), np.full(n, 0.1), np.zeros(n), np.zeros((n, 3, 3)),
                 np.zeros(n, int), np.zeros(n, int))  # fmt: skip
    times = np.array([-100_000_000, 1_005_000_000, 1_015_000_000, 2_500_000_000])
    velocity = Velocity(times, times, np.arange(12.0).reshape(4, 3), np.zeros((4, 3, 3)))
    epochs = join(fixes, velocity)
    assert epochs.time_ns.tolist() == sorted([*rows.tolist(), times[0], times[2], times[3]])
    assert epochs.has_velocity.sum() == 4
    at_one = np.flatnonzero(epochs.time_ns == rows[1])[0]
    np.testing.assert_array_equal(epochs.velocity_n[at_one], [3.0, 4.0, 5.0])
    assert len(join(None, velocity)) == 4 and len(join(fixes, None)) == 4
    assert join(None, None) is None


def test_what_is_no_fix_is_counted(tmp_path):
    messages = drive()
    messages[3] = fix_message(3, TIMES[3], 0.0, 0.0)
    messages[4] = fix_message(4, TIMES[4], 48.0, 11.0, status=-1)
    messages[5] = fix_message(5, TIMES[5], np.nan, 11.0)
    messages[6] = fix_message(6, TIMES[6], 48.0, 11.0, height=np.nan)
    into = gnss(tmp_path, messages)
    assert counted(into) == {"no-fix": 3}
    assert len(into.gnss) == N - 3
    assert np.isnan(into.gnss.height).sum() == 1 and into.gnss.has_position.all()


def test_a_receiver_without_a_fix_has_no_velocity_either(tmp_path):
    """Drivers go on sending one, of zero or of before, with a covariance of any size."""
    messages = drive(sigma=1.0)
    for k in range(20, 30):
        messages[k] = fix_message(k, TIMES[k], 48.0, 11.0, status=-1)
    messages += [twist_message(t + 10**6, [0.0, 0.0, 0.0], 1e-4) for t in TIMES[20:30]]
    messages += [twist_message(t + 10**6, [0.0, 13.6, 1.0], 1e-4) for t in TIMES[30:]]
    # of another instrument, and therefore believed
    messages.append(twist_message(TIMES[25] + 250_000_000, [0.0, 13.6, 1.0], 1e-4))
    into = gnss(tmp_path, messages)
    assert counted(into) == {"no-fix": 10, "no-fix-velocity": 10}
    assert len(into.gnss) == N - 9 and into.gnss.has_velocity.sum() == N - 29
    assert (into.gnss.velocity_n[into.gnss.has_velocity, 0] > 13.0).all()


@pytest.mark.parametrize(
    "place", [(1e6, 11.0, 50.0), (48.0, -1e4, 50.0), (48.0, 11.0, 1e6), (48.0, 11.0, -np.inf)]
)
def test_single_fixes_that_are_not_on_earth_are_left_out(tmp_path, place):
    messages = drive()
    messages[0] = fix_message(0, TIMES[0], *place)
    into = gnss(tmp_path, messages)
    assert counted(into) == {"not-on-earth": 1}
    assert [str(f) for f in into.findings] == ["topic /fix: 1 fix is not on Earth; left out"]
    np.testing.assert_array_equal(into.gnss.time_ns, TIMES[1:])
    # nor do they hide that the others are radians
    messages = drive(scale=np.pi / 180.0)
    messages[0] = fix_message(0, TIMES[0], *place)
    with pytest.raises(DataError, match="as in radians"):
        gnss(tmp_path, messages)


@pytest.mark.parametrize("enu", [(1e5, 0.0, 0.0), (0.0, np.nan, 0.0), (0.0, 0.0, -1e30)])
def test_single_velocities_of_no_vehicle_are_left_out(tmp_path, enu):
    velocity = [twist_message(TIMES[k], (1.0, 13.8, 0.2), 0.01) for k in range(N)]
    velocity[7] = twist_message(TIMES[7], enu, 0.01)
    into = gnss(tmp_path, drive() + velocity)
    assert counted(into) == {"no-vehicle-velocity": 1}
    assert str(into.findings[0]).startswith("topic /vel: 1 velocity is not finite or beyond 20000")
    np.testing.assert_array_equal(np.flatnonzero(~into.gnss.has_velocity), [7])


def test_a_huge_stated_sigma_is_limited(tmp_path):
    epochs = gnss(tmp_path, drive(sigma=1e150)).gnss
    np.testing.assert_array_equal(epochs.sigma_position_n, 1e6)


def test_order_and_repetition_are_reported(tmp_path):
    messages = drive()
    messages[10], messages[11] = messages[11], messages[10]
    messages.append(fix_message(0, TIMES[20], 10.0, 10.0))
    with open_log(write_log(tmp_path / "a.mcap", messages)) as log:
        into = read_gnss(log, InputOptions(), False)
    assert (np.diff(into.gnss.time_ns) > 0).all()
    assert counted(into) == {"out-of-order": 2, "repeated-stamps": 1}
    assert np.degrees(into.gnss.latitude[20]) > 40  # the first of a stamp stays
    assert len(into.findings) == 2


def test_radians_are_refused_unless_configured(tmp_path):
    messages = drive(scale=np.pi / 180.0)
    with pytest.raises(DataError, match=r"/fix.*0\.83.*radians.*--gnss-unit rad"):
        gnss(tmp_path, messages)
    into = gnss(tmp_path, messages, gnss_unit="rad")
    assert np.degrees(into.gnss.latitude[0]) == pytest.approx(48.0)
    # near 0 N, 0 E the distance covered tells
    velocity = [twist_message(TIMES[k], (0.0, 13.56, 0.0)) for k in range(N)]
    near_zero = [
        fix_message(k, TIMES[k], 0.5 + np.degrees(NORTH[k] / 6.37e6), 1.0, 50.0 + k)
        for k in range(N)
    ]
    into = gnss(tmp_path, near_zero + velocity)
    assert np.degrees(into.gnss.latitude[0]) == pytest.approx(0.5)
    with pytest.raises(DataError, match="radians"):
        gnss(tmp_path, messages + velocity)
    # one fix covers no distance: a traceback came out
    with pytest.raises(DataError, match="radians"):
        gnss(tmp_path, messages[:1] + velocity)


def test_a_first_fix_after_the_start_is_read_in_its_unit(tmp_path):
    times = even_times(600)
    gyro, accel = handheld(600, rest_s=1.0)[:2]
    place = np.radians([48.0, 11.0])
    late = [fix_message(k, times[400 + 20 * k], *place) for k in range(5)]
    messages = sorted([*imu_messages(times, gyro, accel), *late], key=lambda m: m.log_ns)
    log = write_log(tmp_path / "a.mcap", messages)
    options = {"input": {"gnss_unit": "rad"}, "navigation": {"mode": "attitude"}}
    with open_log(log) as opened:
        position = prepare(opened, build(ProcessConfig, options)).position
    assert position[:2] == pytest.approx((48.0, 11.0))


def test_radians_across_the_date_line_are_refused(tmp_path):
    east = np.linspace(-300.0, 300.0, N) / 6.37e6 / np.cos(0.8)
    longitude = (east + 2 * np.pi) % (2 * np.pi) - np.pi
    messages = [fix_message(k, TIMES[k], 0.8, longitude[k]) for k in range(N)]
    velocity = [twist_message(TIMES[k], (20.34, 0.0, 0.0)) for k in range(N)]
    assert np.ptp(longitude) > 6.0
    with pytest.raises(DataError, match="radians"):
        gnss(tmp_path, messages + velocity)


def test_angles_and_heights_of_no_globe_are_refused(tmp_path):
    with pytest.raises(DataError, match="which cannot be degrees"):
        gnss(tmp_path, drive(scale=1e7))
    millimetres = [fix_message(k, TIMES[k], 48.0 + k * 1e-5, 11.0, 120000.0) for k in range(N)]
    with pytest.raises(DataError, match="millimetres"):
        gnss(tmp_path, millimetres)


@pytest.mark.parametrize("stamp_ns", [0, int(TIMES[0])])
def test_messages_that_nobody_stamps_are_taken_at_their_log_times(tmp_path, stamp_ns):
    def unstamped(messages):
        for one in messages:
            one.message.header.stamp.sec, one.message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        return messages

    moving = [twist_message(t, (1.0, 13.8, 0.5), 0.01) for t in TIMES]
    into = gnss(tmp_path, unstamped(drive()) + moving)
    np.testing.assert_array_equal(into.gnss.time_ns, TIMES)
    assert into.gnss.has_position.all() and into.gnss.has_velocity.all()
    (said,) = [f for f in into.findings if f.kind == "time-source"]
    assert said.topic == "/fix"
    into = gnss(tmp_path, drive() + unstamped(moving))
    np.testing.assert_array_equal(into.gnss.time_ns, TIMES)
    read = baro(tmp_path, unstamped([pressure_message(t, 98500.0) for t in TIMES]))
    np.testing.assert_array_equal(read.stream.time_ns, TIMES)
    # one message, or several recorded at once, may have one stamp
    once = [one._replace(log_ns=int(TIMES[0])) for one in unstamped(drive())]
    assert "time-source" not in [f.kind for f in gnss(tmp_path, once).findings]


def test_a_velocity_without_a_vertical_part_is_horizontal(tmp_path):
    velocity = [twist_message(TIMES[k], (1.0, 13.8, 0.0), covariance=False) for k in range(N)]
    into = gnss(tmp_path, drive() + velocity)
    assert np.isnan(into.gnss.velocity_n[:, 2]).all()
    assert into.gnss.has_velocity.all()
    assert any("vertical velocity is always zero" in w for w in map(str, into.findings))
    assert np.isnan(into.gnss.sigma_velocity_n).all()


@pytest.mark.parametrize(
    ("unit", "scale"), [("hPa", 100.0), ("kPa", 1000.0), ("inHg", 3386.389)]
)  # fmt: skip
def test_units_of_pressure(tmp_path, unit, scale):
    messages = [pressure_message(t, 98500.0 / scale) for t in TIMES]
    with pytest.raises(DataError, match=rf"/baro.*{98500.0 / scale:.5g}.*--baro-unit {unit}"):
        baro(tmp_path, messages)
    into = baro(tmp_path, messages, baro_unit=unit)
    np.testing.assert_allclose(into.stream.pressure, 98500.0)
    np.testing.assert_allclose(into.stream.variance, 4.0 * scale**2)
    right = baro(tmp_path, [pressure_message(t, 98500.0) for t in TIMES])
    np.testing.assert_array_equal(right.stream.pressure, 98500.0)


def test_pressures_that_are_none(tmp_path):
    bad = [pressure_message(t, p) for t, p in zip(TIMES, [0.0, -1.0, np.nan] * 20, strict=True)]
    with pytest.raises(DataError, match="no pressure that is positive"):
        baro(tmp_path, bad, baro_topic="/baro")
    # A barometer that is not connected, and that nobody asks for, is in nobody's way
    unasked = baro(tmp_path, bad)
    assert unasked.stream is None and unasked.problem is None
    assert [f.kind for f in unasked.findings] == ["no-pressures"]
    with pytest.raises(DataError, match="which no atmosphere has"):
        baro(tmp_path, [pressure_message(t, 3.0) for t in TIMES])


def test_several_barometers_need_a_name(tmp_path):
    messages = [pressure_message(t, 1e5, f"/baro{k % 2}") for k, t in enumerate(TIMES)]
    with pytest.raises(TopicError, match="--baro-topic"):
        baro(tmp_path, messages)
    assert baro(tmp_path, messages, baro_topic="/baro1").topic == "/baro1"


def test_heights_instead_of_pressures(tmp_path):
    t = store(2).types
    messages = [
        Message("/h", "std_msgs/msg/Float64", int(TIMES[k]), t["std_msgs/msg/Float64"](100.0 + k))
        for k in range(N)
    ]
    into = baro(tmp_path, messages, baro_kind="height")
    np.testing.assert_array_equal(into.stream.height, 100.0 + np.arange(N))
    np.testing.assert_array_equal(into.stream.time_ns, TIMES)
    point = t["geometry_msgs/msg/Point"]
    messages = [
        Message("/h", "geometry_msgs/msg/PointStamped", int(TIMES[k]) + 5,
                t["geometry_msgs/msg/PointStamped"](header(int(TIMES[k])), point(1.0, 2.0, 7.0)))
        for k in range(N)
    ]  # fmt: skip
    into = baro(tmp_path, messages, baro_kind="height")
    np.testing.assert_array_equal(into.stream.height, 7.0)
    np.testing.assert_array_equal(into.stream.time_ns, TIMES)


def test_a_velocity_belongs_to_the_nearest_fix_only():
    """Of two fixes of one epoch one gets it; it would count twice otherwise.

    Nor does a fix far from any velocity take it away from its own: here most fixes have none.
    """
    times = np.array([0, 250, 500, 750, 1000, 1250, 1494, 1503, 1750]) * 1_000_000
    n = len(times)
    fixes = Gnss(times, times, np.full(n, 0.5), np.full(n, 0.1), np.zeros(n), np.zeros((n, 3, 3)),
                 np.zeros(n, int), np.zeros(n, int))  # fmt: skip
    at = np.array([501, 1500]) * 1_000_000
    epochs = join(fixes, Velocity(at, at, np.arange(6.0).reshape(2, 3), np.zeros((2, 3, 3))))
    np.testing.assert_array_equal(epochs.time_ns, times)
    np.testing.assert_array_equal(np.flatnonzero(epochs.has_velocity), [2, 7])
    np.testing.assert_array_equal(epochs.velocity_n[7], [3.0, 4.0, 5.0])


def test_only_what_will_be_read_is_kept():
    types = (FIX_TYPE, PRESSURE_TYPE, JOINT_TYPE, "sensor_msgs/msg/Imu")
    channels = {k: SimpleNamespace(type=t, topic=f"/{k}") for k, t in enumerate(types)}
    channels[4] = SimpleNamespace(type=FIX_TYPE, topic="/sinstool/fix")
    log = SimpleNamespace(channels=channels)
    assert aiding_channels(log, barometer=False, wheels=False) == [0]
    assert aiding_channels(log, barometer=True, wheels=False) == [0, 1]
    assert aiding_channels(log, barometer=False, wheels=True) == [0, 2]
