"""Noise files: read as they are written, and refused with the key that is wrong."""

import pytest

from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.config.noise import KEYS, key_of, read_noise
from sinstool.core.errors import ConfigurationError

GOOD = """
schema = "sinstool.imu-noise/1"
[source]
rate_hz = 100
[gyro.x]
angle_random_walk_rad_per_sqrt_s = 1e-4
angle_random_walk_95_rad_per_sqrt_s = [9e-5, 1.1e-4]
bias_instability_below_rad_per_s = 2e-5
[accel.z]
velocity_random_walk_m_per_s_per_sqrt_s = 1e-3
acceleration_random_walk_m_per_s2_per_sqrt_s = 3e-5
"""


def test_values_intervals_and_bounds(tmp_path):
    file = tmp_path / "noise.toml"
    file.write_text(GOOD)
    noise = read_noise(file)
    white, flicker = noise.gyro["x"]["white"], noise.gyro["x"]["flicker"]
    assert (white.low, white.value, white.high) == (9e-5, 1e-4, 1.1e-4)
    assert flicker.value is None and flicker.high == 2e-5
    walk = noise.accel["z"]["random_walk"]
    assert (walk.low, walk.value, walk.high) == (3e-5, 3e-5, 3e-5)
    assert noise.rate_hz == 100.0 and set(noise.gyro) == {"x"}


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('schema = "sinstool.imu-noise/1"', "", "no noise file"),
        ("imu-noise/1", "imu-noise/9", "reads 'sinstool.imu-noise/1'"),
        ("= 1e-3", f"= {10**400}", "must be a number above 0"),
        ("rate_hz = 100", "rate_hz = 0", "source.rate_hz = 0: must be a number above 0"),
        ("[gyro.x]", "[gyro.w]", "unknown key gyro.w"),
        ("[accel.z]", "[accel]", "unknown key accel.velocity_random_walk"),
        ("bias_instability_below", "bias_instabilty_below", "did you mean bias_instability"),
        ("= 1e-3", '= "much"', "accel.z.velocity_random_walk_m_per_s_per_sqrt_s = 'much'"),
        ("= 1e-3", "= -1e-3", "must be a number above 0"),
        ("[9e-5, 1.1e-4]", "[2e-4, 3e-4]", "does not hold the value"),
        ("[9e-5, 1.1e-4]", "[9e-5]", "a list of two numbers"),
        ("bias_instability_below_rad_per_s = 2e-5",
         "bias_instability_below_rad_per_s = 2e-5\nbias_instability_rad_per_s = 1e-5",
         "contradict each other"),
        ("velocity_random_walk_m_per_s_per_sqrt_s = 1e-3\n"
         "acceleration_random_walk_m_per_s2_per_sqrt_s = 3e-5", "", "table accel.z is empty"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(tmp_path, old, new, said):
    file = tmp_path / "noise.toml"
    assert old in GOOD
    file.write_text(GOOD.replace(old, new))
    with pytest.raises(ConfigurationError) as info:
        read_noise(file)
    assert said in str(info.value) and str(file) in str(info.value)


def test_a_file_of_one_sensor(tmp_path):
    file = tmp_path / "noise.toml"
    file.write_text(GOOD.partition("[accel.z]")[0])
    assert read_noise(file).accel == {}
    file.write_text(GOOD.partition("[gyro.x]")[0])
    with pytest.raises(ConfigurationError, match="neither gyro nor accel"):
        read_noise(file)


def test_every_key_says_its_unit():
    for sensor, terms in KEYS.items():
        for term, (name, unit) in terms.items():
            assert key_of(sensor, term, "95") == f"{name}_95_{unit}"


@pytest.mark.parametrize(
    "options",
    [
        {"navigation": {"imu_noise": "n.toml", "imu_grade": "mems"}},
        {"navigation": {"imu_noise": "n.toml"}, "in_flight": {"arw": 0.1}},
        {"navigation": {"imu_noise": "n.toml"}, "in_flight": {"vrw": 50.0}},
    ],
)
def test_two_that_say_how_noisy_an_imu_is_are_refused(options):
    with pytest.raises(ConfigurationError, match="both say how noisy the IMU is"):
        build(ProcessConfig, options)
