"""GPSFix messages, of gpsd and others: fixes with the receiver's velocity in them."""

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from sinstool.config import InputOptions
from sinstool.io.readers import open_log
from sinstool.survey.gnss import read_gnss
from tests.helpers.imulogs import Message, even_times, header, write_log

N = 60
TIMES = even_times(N, rate=1.0)
STATUS = "std_msgs/Header header\nint16 status\n"
REST = "pitch roll dip time gdop pdop hdop vdop tdop err err_horz err_vert err_track err_speed"
FLOATS = f"latitude longitude altitude track speed climb {REST}".split()
FIX = "\n".join(
    [
        "std_msgs/Header header",
        "PACKAGE/GPSStatus status",
        *(f"float64 {name}" for name in FLOATS),
        "float64[9] position_covariance",
        "uint8 position_covariance_type",
    ]
)


def messages(types, package, ros):
    """A way to the south-east that climbs, at rest for the first ten seconds, with no fix twice."""
    speed = np.where(np.arange(N) < 10, 0.0, 8.0)
    way = np.cumsum(speed) - speed
    made = types.types[f"{package}/msg/GPSFix"]
    status = types.types[f"{package}/msg/GPSStatus"]
    for k, time_ns in enumerate(TIMES):
        there = header(time_ns, "gps", ros)
        moves = bool(speed[k])
        yield Message(
            "/extended_fix",
            f"{package}/msg/GPSFix",
            int(time_ns),
            made(
                header=there,
                status=status(header=there, status=-1 if k in (30, 31) else 0),
                latitude=48.0 - np.degrees(way[k] * np.cos(np.radians(45.0)) / 6.37e6),
                longitude=11.0 + np.degrees(way[k] * np.sin(np.radians(45.0)) / 4.27e6),
                altitude=500.0 + 0.1 * way[k],
                track=135.0 if moves else np.nan,  # as gpsd has it at rest
                speed=speed[k],
                climb=0.8 * moves,
                position_covariance=np.diag([4.0, 9.0, 16.0]).ravel(),
                position_covariance_type=2,
                **dict.fromkeys(REST.split(), 0.0),
            ),
        )


@pytest.mark.parametrize(("ros", "package"), [(2, "gps_msgs"), (1, "gps_common")])
def test_fix_and_velocity_of_one_message(tmp_path, ros, package):
    types = get_typestore(Stores.ROS2_HUMBLE if ros == 2 else Stores.ROS1_NOETIC)
    types.register(get_types_from_msg(STATUS, f"{package}/msg/GPSStatus"))
    types.register(get_types_from_msg(FIX.replace("PACKAGE", package), f"{package}/msg/GPSFix"))
    path = write_log(tmp_path / "a.mcap", list(messages(types, package, ros)), ros, types)
    with open_log(path) as log:
        into = read_gnss(log, InputOptions(), False)
        none = read_gnss(log, InputOptions(velocity_topic="none"), False)
    epochs = into.gnss
    assert into.fix_topic == into.velocity_topic == "/extended_fix"
    assert len(epochs) == N - 2 and epochs.has_position.all() and epochs.has_velocity.all()
    np.testing.assert_array_equal(epochs.velocity_n[:10], 0.0)
    np.testing.assert_allclose(
        epochs.velocity_n[10:], [[-5.657, 5.657, -0.8]] * (N - 12), atol=1e-3
    )
    np.testing.assert_allclose(epochs.sigma_position_n, [[3.0, 2.0, 4.0]] * (N - 2))
    assert np.isnan(epochs.sigma_velocity_n).all()
    assert not none.gnss.has_velocity.any() and none.gnss.has_position.all()
