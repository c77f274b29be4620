"""Logs whose gyros are stamped later, or earlier, than the accelerometers beside them."""

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.filter_logs import run, start_of
from tests.helpers.logs import real
from tests.helpers.unseen_drives import (
    CONSUMER,
    boat,
    drive,
    flight,
    multicopter,
    record,
    walk,
    write,
)
from tests.helpers.unseen_errors import crossed, g_sensitive, shaken
from tests.helpers.unseen_vehicles import motorcycle, tractor

KIND = {"gyro_kind": "mean-rate"}
MOTIONS = {
    "walk": walk,
    "boat": boat,
    "multicopter": multicopter,
    "motorcycle": motorcycle,
    "tractor": tractor,
    "turbulence": lambda seed, duration: flight(seed, duration, True),
}


def late(data, delay):
    """The same with gyros of so many seconds ago."""
    angle = np.cumsum(data.gyro, axis=0)
    before = [np.interp(data.seconds - delay, data.seconds, column) for column in angle.T]
    gyro = np.diff(np.stack(before, axis=1), axis=0)
    return replace(data, gyro=np.concatenate([gyro[:1], gyro]))


def logged(folder, truth, seed, delay, worse=lambda data: data):
    data = record(truth, CONSUMER, seed, gnss_rate=2.0, sigma=1.0, sigma_v=0.1, lever=np.zeros(3))
    return write(folder / "log.mcap", worse(late(data, delay)))


def shown(log):
    offsets = start_of(log, input=KIND).offsets
    return offsets.gyros


@pytest.mark.slow
def test_late_gyros_of_a_walk_are_named(tmp_path):
    """They turned the attitude by degrees, at status 0."""
    result, _ = run(logged(tmp_path, walk(2, 150.0), 2, 0.1), input=KIND)
    found = next(f for f in result["findings"] if f["kind"] == "gyro-delay")
    assert found["severity"] == "lost"
    assert "later" in found["text"]
    assert found["numbers"]["delay_s"] == pytest.approx(0.1, abs=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("kind", MOTIONS)
@pytest.mark.parametrize("delay", [0.1, -0.15])
def test_a_delay_is_found_where_motions_show_it(tmp_path, kind, delay):
    gyros = shown(logged(tmp_path, MOTIONS[kind](1, 400.0), 1, delay))
    assert gyros.shown
    assert gyros.delay_s == pytest.approx(delay, abs=3.0 * gyros.sigma_s)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["multicopter", "motorcycle", "tractor", "turbulence", "walk"])
def test_a_long_delay_is_its_own_estimate(tmp_path, kind):
    """By the first one, 0.3 s looked like 0 to 0.15 s, with a sigma of 10 ms."""
    gyros = shown(logged(tmp_path, MOTIONS[kind](3, 400.0), 3, 0.3))
    assert gyros.delay_s == pytest.approx(0.3, abs=3.0 * gyros.sigma_s)
    assert gyros.sigma_s < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("kind", [*MOTIONS, "drive"])
@pytest.mark.parametrize(
    "worse",
    [
        lambda data: data,
        lambda data: crossed(data, 5, 0.01),
        lambda data: g_sensitive(data, 5, 2e-3),
        lambda data: shaken(data, 5, 3.0, 0.1),
    ],
    ids=["plain", "crossed", "g-sensitive", "shaken"],
)
def test_gyros_in_time_are_not_late(tmp_path, kind, worse):
    truth = drive(4, 400.0, 30.0) if kind == "drive" else MOTIONS[kind](4, 300.0)
    gyros = shown(logged(tmp_path, truth, 4, 0.0, worse))
    assert not gyros.shown
    assert abs(gyros.delay_s) < 4.0 * gyros.sigma_s


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "rtk_drive/rtk_drive_mems_100hz.mcap",
        "vehicle_gnss/yk_urban_short_turn_loop_nominal_002.mcap",
        "vehicle_gnss/yk_urban_stop_go_large_mount_001.mcap",
    ],
)
def test_gyros_of_recorded_drives_are_not_late(name):
    gyros = start_of(real(name)).offsets.gyros
    assert not gyros.shown
    assert abs(gyros.delay_s) < 0.02
