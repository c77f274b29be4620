"""ULog files of PX4: written here byte by byte, read through pyulog as any other log."""

import struct
import sys

import numpy as np
import pytest

import sinstool
from sinstool.core.errors import DamagedLogError, NotALogError, UnsupportedLogError
from sinstool.core.streams import concatenate
from sinstool.io.readers import open_log
from sinstool.io.readers.streams import Losses, read_fixes, read_velocity
from sinstool.io.readers.ulog import ROWS
from tests.helpers.paths import ROOT

DATA = ROOT.parent / "shared" / "data" / "px4"
KINDS = {"Q": "uint64_t", "f": "float", "i": "int32_t", "B": "uint8_t", "d": "double",
         "I": "uint32_t"}  # fmt: skip
IMU = (
    ("Q", "timestamp"), ("f", "gyro_rad[3]"), ("I", "gyro_integral_dt"),
    ("i", "accelerometer_timestamp_relative"), ("f", "accelerometer_m_s2[3]"),
)  # fmt: skip
GPS = (
    ("Q", "timestamp"), ("i", "lat"), ("i", "lon"), ("i", "alt"), ("i", "alt_ellipsoid"),
    ("f", "s_variance_m_s"), ("f", "eph"), ("f", "epv"), ("f", "vel_n_m_s"), ("f", "vel_e_m_s"),
    ("f", "vel_d_m_s"), ("B", "fix_type"), ("B", "vel_ned_valid"),
)  # fmt: skip
NEW_GPS = (
    ("Q", "timestamp"), ("d", "latitude_deg"), ("d", "longitude_deg"),
    ("d", "altitude_ellipsoid_m"), *GPS[5:],
)  # fmt: skip
AIR = (("Q", "timestamp"), ("Q", "timestamp_sample"), ("f", "baro_pressure_pa"))
OLD_BARO = (("Q", "timestamp"), ("f", "pressure"))
MAG = (("Q", "timestamp"), ("Q", "timestamp_sample"), ("f", "magnetometer_ga[3]"))


def ulog(*topics):
    """A file with topics, each a name, its fields and its rows."""

    def message(kind, body):
        return struct.pack("<HB", len(body), ord(kind)) + body

    def declared(kind, name):
        base, bracket, size = name.partition("[")
        return f"{KINDS[kind]}{bracket}{size} {base};"

    parts = [b"ULog\x01\x125\x01", struct.pack("<Q", 1_000_000)]
    for name, fields, _ in topics:
        text = "".join(declared(*field) for field in fields)
        parts.append(message("F", f"{name}:{text}".encode()))
    data = []
    for number, (name, fields, rows) in enumerate(topics):
        parts.append(message("A", struct.pack("<BH", 0, number) + name.encode()))
        layout = "<H" + "".join(k * (3 if "[3]" in n else 1) for k, n in fields)
        data += [(row[0], message("D", struct.pack(layout, number, *row))) for row in rows]
    return b"".join([*parts, *(one for _, one in sorted(data))])


def imu_rows(count=2000, step=5000):
    """A body at rest, Forward-Right-Down, turning slowly about its axes."""
    return [
        (2_000_000 + k * step, 0.01, -0.02, 0.03, step, 0, 0.1, -0.2, -9.8) for k in range(count)
    ]


def gps_rows(count=10):
    return [
        (2_100_000 + k * 200_000, 363691284 + k, 1273683809, 51037, 71028, 0.25, 0.5, 1.5,
         1.0, 2.0, -3.0, 3, 1)
        for k in range(count)
    ]  # fmt: skip


@pytest.fixture
def file(tmp_path):
    def write(*topics):
        path = tmp_path / "flight.ulg"
        path.write_bytes(ulog(*topics))
        return path

    return write


def test_the_imu_is_in_frd_with_the_stamps_of_the_file(file):
    rows = imu_rows()
    with sinstool.open_log(file(("sensor_combined", IMU, rows))) as log:
        assert log.format == "ulog"
        imu = log.imu()
    assert imu.time_ns.tolist() == [1000 * row[0] for row in rows]
    assert np.abs(imu.gyro - [0.01, -0.02, 0.03]).max() < 1e-8
    assert np.abs(imu.accel - [0.1, -0.2, -9.8]).max() < 1e-6


def test_samples_without_an_accelerometer_are_left_out(file):
    rows = imu_rows()
    rows[7] = (*rows[7][:5], 2**31 - 1, *rows[7][6:])
    imu = sinstool.open_log(file(("sensor_combined", IMU, rows))).imu()
    assert 1000 * rows[7][0] not in imu.time_ns and len(imu) == len(rows) - 1


def test_fixes_and_velocities(file):
    topics = ("sensor_combined", IMU, imu_rows()), ("vehicle_gps_position", GPS, gps_rows())
    gnss = sinstool.open_log(file(*topics)).gnss()
    degrees = np.degrees([gnss.latitude[0], gnss.longitude[0]])
    assert degrees == pytest.approx([36.3691284, 127.3683809], abs=1e-9)
    assert gnss.height == pytest.approx(71.028)
    assert np.abs(gnss.velocity_n - [1.0, 2.0, -3.0]).max() < 1e-6
    assert gnss.sigma_position_n[0] == pytest.approx([0.5, 0.5, 1.5])
    assert gnss.sigma_velocity_n[0] == pytest.approx([0.25] * 3)


def test_fixes_of_newer_versions(file):
    rows = [(r[0], 36.5, 127.25, 71.5, *r[5:]) for r in gps_rows()]
    topics = ("sensor_combined", IMU, imu_rows()), ("sensor_gps", NEW_GPS, rows)
    gnss = sinstool.open_log(file(*topics)).gnss()
    assert np.degrees([gnss.latitude[0], gnss.longitude[0]]) == pytest.approx([36.5, 127.25])
    assert gnss.height == pytest.approx(71.5)


def test_what_is_no_fix_is_none(file):
    rows = [(*r[:-2], 1, 0) for r in gps_rows()]
    topics = ("sensor_combined", IMU, imu_rows()), ("sensor_gps", GPS, rows)
    with open_log(file(*topics)) as log:
        counts = {channel.topic: log.counts[n] for n, channel in log.channels.items()}
    assert counts == {"/px4/imu": 2000, "/px4/gps/fix": 10, "/px4/gps/velocity": 0}


def test_a_2d_fix_is_no_fix_and_a_fix_may_lack_its_velocity(file):
    rows = gps_rows()
    rows[0] = (*rows[0][:-2], 2, 1)
    rows[1] = (*rows[1][:-2], 3, 0)
    topics = ("sensor_combined", IMU, imu_rows()), ("sensor_gps", GPS, rows)
    with open_log(file(*topics)) as log:
        fixes = concatenate(list(read_fixes(log, log.channels_of("/px4/gps/fix"), Losses())))
        moving = concatenate(
            list(read_velocity(log, log.channels_of("/px4/gps/velocity"), Losses()))
        )
    assert fixes.status.tolist() == [-1] + [0] * 9
    assert moving.time_ns.tolist() == fixes.time_ns[2:].tolist()


@pytest.mark.parametrize(
    ("name", "fields", "row"),
    [
        ("vehicle_air_data", AIR, lambda t: (t, t - 700, 95000.0)),
        ("sensor_baro", OLD_BARO, lambda t: (t, 950.0)),
    ],
)
def test_pressure_is_in_pa_at_the_time_of_its_sample(file, name, fields, row):
    rows = [row(2_050_000 + 50_000 * k) for k in range(100)]
    path = file(("sensor_combined", IMU, imu_rows()), (name, fields, rows))
    baro = sinstool.open_log(path).barometer()
    assert baro.pressure == pytest.approx(95000.0)
    assert baro.time_ns.tolist() == [1000 * (r[1] if len(r) == 3 else r[0]) for r in rows]


def test_the_field_is_in_tesla(file):
    rows = [(2_050_000 + 20_000 * k, 2_049_000 + 20_000 * k, 0.2, -0.1, 0.4) for k in range(500)]
    path = file(("sensor_combined", IMU, imu_rows()), ("vehicle_magnetometer", MAG, rows))
    field = sinstool.open_log(path).magnetometer().field
    assert np.abs(field - [2e-5, -1e-5, 4e-5]).max() < 1e-11


def test_it_is_processed_as_any_other_log(file, tmp_path):
    path = file(("sensor_combined", IMU, imu_rows()), ("vehicle_gps_position", GPS, gps_rows()))
    result = sinstool.process(path, tmp_path / "out.mcap", mode="attitude")
    assert len(result.solution) == 2000
    with open_log(tmp_path / "out.mcap") as log:
        topics = {channel.topic for channel in log.channels.values()}
    assert {"/px4/imu", "/px4/gps/fix", "/sinstool/attitude"} <= topics


def test_messages_come_by_time_in_blocks_with_all_their_bytes(file):
    path = file(("sensor_combined", IMU, imu_rows(2 * ROWS, 40)), ("sensor_gps", GPS, gps_rows()))
    with open_log(path) as log:
        times, positions, counts = [], [], {}
        for batch in log.batches():
            times.append(batch.log_time)
            positions.append(batch.position)
            for number in batch.channel.tolist():
                counts[number] = counts.get(number, 0) + 1
        assert counts == log.counts and len(positions) > 2
        assert positions == sorted(positions) and positions[-1] == path.stat().st_size
    assert (np.diff(np.concatenate(times)) >= 0).all()


def test_without_pyulog_the_extra_is_named(file, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyulog", None)
    with pytest.raises(UnsupportedLogError, match=r"a ULog of PX4.*pip install 'sinstool\[px4\]'"):
        open_log(file(("sensor_combined", IMU, imu_rows())))


def test_a_ulog_that_cannot_be_read_is_damaged(tmp_path):
    path = tmp_path / "cut.ulg"
    path.write_bytes(b"ULog\x01\x125\x01")
    with pytest.raises(DamagedLogError, match="pyulog cannot read this ULog"):
        open_log(path)


@pytest.mark.parametrize("salvage", [False, True])
def test_what_pyulog_prints_of_damage_is_not_our_output(file, capsys, salvage):
    """It would stand before the JSON that a program reads."""
    path = file(("sensor_combined", IMU, imu_rows(20)))
    nobodys = struct.pack("<HBH", 4, ord("D"), 77) + bytes(2)
    path.write_bytes(path.read_bytes() + nobodys)
    if salvage:
        open_log(path, salvage).close()
    else:
        with pytest.raises(DamagedLogError, match="corrupt"):
            open_log(path)
    assert capsys.readouterr().out == ""


def test_a_field_that_is_missing_is_named(file):
    path = file(("sensor_combined", IMU[:-1], [row[:6] for row in imu_rows()]))
    with pytest.raises(DamagedLogError, match="sensor_combined has no field accelerometer_m_s2"):
        open_log(path)


@pytest.mark.skipif(not DATA.exists(), reason="real logs are not beside the checkout")
@pytest.mark.parametrize("name", ["px4_sample_2016_auavx21", "px4_fmuv6c_inflight_6s"])
def test_real_logs_are_what_others_made_of_them(name):
    ours = sinstool.open_log(DATA / f"{name}.ulg").imu()
    theirs = sinstool.open_log(DATA / f"{name}.mcap", body_axes="frd").imu()
    assert np.abs(ours.time_ns - theirs.time_ns).max() <= 1000
    assert np.abs(ours.gyro - theirs.gyro).max() < 1e-6
    assert np.abs(ours.accel - theirs.accel).max() < 1e-5


@pytest.mark.parametrize(
    ("head", "said"),
    [
        (b"PK\x03\x04" + bytes(20), "not a log: it is a zip archive: unpack it"),
        (b"\x1f\x8b\x08" + bytes(20), "compressed with gzip: unpack it with gunzip"),
        (b"\xa3\x95\x80" + bytes(20), "a DataFlash log of ArduPilot"),
        (b"time,ax,ay,az\n0,1,2,3\n", 'not a log: it is text that begins with "time,ax,ay,az'),
        (b"\x00\x01\xfe\xff" + bytes(20), "not a log: it begins with the bytes 00 01 fe ff"),
        (b"ULog\x02" + bytes(20), "not a log: it begins with the bytes 55 4c 6f 67 02"),
    ],
)
def test_what_is_no_log_is_named_by_how_it_begins(tmp_path, head, said):
    path = tmp_path / "x.bin"
    path.write_bytes(head)
    with pytest.raises(NotALogError) as info:
        open_log(path)
    assert said in str(info.value) and "sinstool reads MCAP" in str(info.value)
    assert "b'" not in str(info.value)
