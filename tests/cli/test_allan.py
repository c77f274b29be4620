"""`sinstool allan` as a user calls it: what is measured, printed, written and refused."""

import json
import re
import tomllib
from functools import partial

import numpy as np
import pytest
import yaml

from sinstool.config.noise import read_noise
from tests.helpers.resting_logs import ACCEL, GYRO, RATE, T0, moved, noise, write

WALK = GYRO[1] / np.sqrt(RATE)  # rad/sqrt(s)
FORCE_WALK = ACCEL[1] / np.sqrt(RATE)  # (m/s)/sqrt(s)


@pytest.fixture
def allan(sinstool):
    """Runs the command in this process: status, stdout, stderr."""
    return partial(sinstool, "allan")


@pytest.fixture(scope="module")
def rest(tmp_path_factory):
    """Two minutes at rest, with a minute of motion in the middle."""
    rates, forces = moved(*noise(12000), 4000, 8000)
    return write(tmp_path_factory.mktemp("rest") / "rest.mcap", rates, forces)


def measured(out):
    return json.loads(out)["gyro"], json.loads(out)["accel"]


def test_noise_of_a_log_with_pauses(allan, rest):
    code, out, err = allan(rest, "--json")
    printed = json.loads(out)
    gyro, accel = printed["gyro"], printed["accel"]
    assert code == 0 and printed["schema"] == "sinstool.allan/1"
    assert len(printed["rest"]["stretches"]) == 2
    assert 78.0 < printed["rest"]["total_s"] < 80.0
    for axis in "xyz":
        for table, key, truth in (
            (gyro, "angle_random_walk_rad_per_sqrt_s", WALK),
            (accel, "velocity_random_walk_m_per_s_per_sqrt_s", FORCE_WALK),
        ):
            found = table[axis][key]
            assert found["value"] == pytest.approx(truth, rel=0.05)
            assert found["low"] < found["value"] < found["high"] < 1.1 * found["low"]
        # what is not in the data is not claimed
        for name in ("bias_instability_rad_per_s", "rate_random_walk_rad_per_s_per_sqrt_s"):
            assert gyro[axis][name]["value"] is None and gyro[axis][name]["high"] > 0.0
    assert [f["kind"] for f in printed["findings"]] == ["short-rest"]
    assert "neither bias instability nor random walk is visible" in err


def test_summary(allan, rest):
    code, out, _ = allan(rest)
    lines = {line.split("  ")[0]: line for line in out.splitlines()}
    assert code == 0
    assert "2 stretches" in lines["rest"]
    assert "deg/sqrt(h)" in lines["angle random walk"] and "0.68" in lines["angle random walk"]
    assert "below" in lines["bias instability"]
    assert allan(rest, "-q")[1] == ""


@pytest.mark.slow
def test_files_of_all_formats(allan, rest, tmp_path):
    """Each value is what its unit makes of the two figures that were simulated."""
    expected = {
        "kalibr": ("accelerometer_noise_density", FORCE_WALK, "gyroscope_noise_density", WALK),
        "openvins": ("accelerometer_noise_density", FORCE_WALK, "gyroscope_noise_density", WALK),
        "vins-fusion": ("acc_n", ACCEL[1], "gyr_n", GYRO[1]),
        "fast-lio": ("acc_cov", ACCEL[1] ** 2, "gyr_cov", GYRO[1] ** 2),
        "kf-gins": ("vrw", 60.0 * FORCE_WALK, "arw", 60.0 * np.degrees(WALK)),
        "robot-localization": (
            "linear_acceleration_covariance",
            ACCEL[1] ** 2,
            "angular_velocity_covariance",
            GYRO[1] ** 2,
        ),
    }
    for name, (accel_key, force, gyro_key, rate) in expected.items():
        file = tmp_path / f"{name}.yaml"
        assert allan(rest, "--format", name, "-o", file)[0] == 0
        text = file.read_text()
        read = yaml.safe_load(text)
        read = read.get("imu0") or read.get("mapping") or read.get("imunoise") or read
        for key, value in ((accel_key, force), (gyro_key, rate)):
            first = read[key][0] if isinstance(read[key], list) else read[key]
            assert isinstance(first, float)
            assert first == pytest.approx(value, rel=0.1), (name, key)
        # every line that holds a figure says its unit
        for line in text.splitlines():
            if ": " in line and not line.startswith("#") and "rostopic" not in line:
                assert "#" in line, line


def test_kalibr_file_has_the_keys_of_kalibr(allan, rest):
    code, out, _ = allan(rest, "--format", "kalibr")
    read = yaml.safe_load(out)
    assert code == 0
    assert set(read) == {
        "rostopic",
        "update_rate",
        "accelerometer_noise_density",
        "accelerometer_random_walk",
        "gyroscope_noise_density",
        "gyroscope_random_walk",
    }
    assert read["update_rate"] == pytest.approx(RATE) and read["rostopic"] == "/imu/data_raw"
    assert out.count("NOT VISIBLE") == 2


def test_own_file_is_read_back(allan, rest, tmp_path):
    file = tmp_path / "noise.toml"
    assert allan(rest, "-o", file, "--json")[0] == 0
    data = tomllib.loads(file.read_text())
    assert data["schema"] == "sinstool.imu-noise/1" and data["source"]["log"] == "rest.mcap"
    found = read_noise(file)
    for axis in "xyz":
        white = found.gyro[axis]["white"]
        assert white.value == pytest.approx(WALK, rel=0.05)
        assert white.low < white.value < white.high
        assert found.accel[axis]["flicker"].value is None
        assert found.accel[axis]["flicker"].high > 0.0
    code, _, err = allan(rest, "-o", file)
    assert code == 1 and "--overwrite" in err
    assert allan(rest, "-o", file, "--overwrite")[0] == 0


def test_gaps_are_not_bridged(allan, tmp_path):
    """What the bias does in a gap is in no difference."""
    rates, forces = noise(9000)
    time_ns = T0 + np.arange(9000) * 10_000_000
    late = np.arange(9000) >= 5000
    rates[late] += 2e-3
    log = write(tmp_path / "gap.mcap", rates, forces, time_ns + late * 1_300_000_000)
    code, out, _ = allan(log, "--json")
    printed = json.loads(out)
    assert code == 0 and len(printed["rest"]["stretches"]) == 2
    for axis in "xyz":
        assert printed["gyro"][axis]["rate_random_walk_rad_per_s_per_sqrt_s"]["value"] is None
        assert printed["gyro"][axis]["rate_ramp_rad_per_s2"]["value"] is None


def test_jitter_of_stamps_changes_nothing(allan, tmp_path):
    rates, forces = noise(6000)
    steady = T0 + np.arange(6000) * 10_000_000
    jitter = steady + np.random.default_rng(2).integers(-2_000_000, 2_000_000, 6000)
    logs = [write(tmp_path / f"{k}.mcap", rates, forces, t) for k, t in enumerate((steady, jitter))]
    (one, _), (other, _) = (measured(allan(log, "--json")[1]) for log in logs)
    key = "angle_random_walk_rad_per_sqrt_s"
    assert other["x"][key]["value"] == pytest.approx(one["x"][key]["value"], rel=2e-3)


@pytest.mark.slow
def test_dead_and_clipped_axes(allan, tmp_path):
    rates, forces = noise(6000)
    rates[:, 1] = 0.25
    forces[:, 2] = np.maximum(np.round(forces[:, 2], 3), -9.79)
    log = write(tmp_path / "faulty.mcap", rates, forces)
    file = tmp_path / "noise.toml"
    code, out, err = allan(log, "--json", "-o", file)
    gyro, accel = measured(out)
    assert code == 3
    assert [gyro[a]["status"] for a in "xyz"] == ["measured", "dead", "measured"]
    assert [accel[a]["status"] for a in "xyz"] == ["measured", "measured", "clipped"]
    assert "gyro y never changes" in err and "accelerometer z stays at one end" in err
    assert set(read_noise(file).gyro) == {"x", "z"}
    code, out, _ = allan(log, "--format", "robot-localization")
    assert code == 3 and "y was not measured" in out
    # a coarse converter is no clipped one, nor is a laser gyro, whose rates are made of angles
    rates, forces = noise(6000)
    turned = np.cumsum(0.01 * rates + 0.7, axis=0)
    log = write(
        tmp_path / "laser.mcap", np.diff(5e-6 * np.floor(turned), axis=0) * 100.0, forces[1:]
    )
    gyro = measured(allan(log, "--json")[1])[0]
    assert [gyro[a]["status"] for a in "xyz"] == ["measured"] * 3
    rates, forces = noise(6000)
    log = write(tmp_path / "coarse.mcap", np.round(rates, 3), np.round(forces, 2))
    code, out, _ = allan(log, "--json")
    assert code == 0 and {a["status"] for a in measured(out)[0].values() if "status" in a} == {
        "measured"
    }


@pytest.mark.slow
def test_units(allan, tmp_path):
    rates, forces = noise(6000)
    log = write(tmp_path / "g.mcap", rates, forces / 9.80665)
    code, _, err = allan(log)
    assert code == 1 and "--accel-unit g" in err
    code, out, _ = allan(log, "--json", "--accel-unit", "g")
    key = "velocity_random_walk_m_per_s_per_sqrt_s"
    assert code == 0
    assert measured(out)[1]["x"][key]["value"] == pytest.approx(FORCE_WALK, rel=0.05)
    log = write(tmp_path / "deg.mcap", np.degrees(rates), forces)
    code, _, err = allan(log)
    assert code == 1 and "--gyro-unit deg/s" in err
    code, out, _ = allan(log, "--json", "--gyro-unit", "deg/s")
    key = "angle_random_walk_rad_per_sqrt_s"
    assert code == 0 and measured(out)[0]["x"][key]["value"] == pytest.approx(WALK, rel=0.05)
    # a quiet gyro in deg/s seems at rest in rad/s too
    log = write(tmp_path / "quiet.mcap", np.degrees(0.2 * rates), forces)
    code, _, err = allan(log)
    assert code == 0 and "more than any gyro has: if its rates are in deg/s" in err


@pytest.mark.parametrize(("size", "unit"), [(0.2, "g"), (0.1, "m/s^2"), (2.0, "m/s^2")])
def test_an_accelerometer_in_a_wrong_unit_has_no_noise_to_trust(allan, tmp_path, size, unit):
    """A unit that the user states is used, though gravity denies it."""
    rates, forces = noise(3000)
    log = write(tmp_path / "a.mcap", rates, size * forces)
    code, out, err = allan(log, "--json", "--accel-unit", unit)
    (found,) = (f for f in json.loads(out)["findings"] if f["kind"] == "gravity-size")
    assert code == 3 and found["severity"] == "lost"
    assert "do not trust the accelerometer's noise" in err


def test_a_log_that_moves_all_the_time(allan, tmp_path):
    rates, forces = moved(*noise(6000), 0, 6000)
    log = write(tmp_path / "moves.mcap", rates, forces)
    code, _, err = allan(log, "-o", tmp_path / "noise.toml")
    assert code == 1 and not (tmp_path / "noise.toml").exists()
    assert "it never rests for 5 s" in err and "record it lying still" in err
    assert err.count("\n") == 1


def test_twenty_seconds_of_rest(allan, tmp_path):
    rates, forces = moved(*noise(6000), 2000, 6000)
    code, out, err = allan(write(tmp_path / "short.mcap", rates, forces), "--json")
    gyro, _ = measured(out)
    assert code == 0 and json.loads(out)["rest"]["total_s"] < 20.1
    assert gyro["x"]["angle_random_walk_rad_per_sqrt_s"]["value"] == pytest.approx(WALK, rel=0.1)
    assert gyro["x"]["bias_instability_rad_per_s"]["value"] is None
    assert "neither bias instability nor random walk" in err


@pytest.mark.slow
def test_drift_and_warm_up_are_said(allan, tmp_path):
    ramp = (*GYRO[:4], 2e-7)
    code, _, err = allan(write(tmp_path / "ramp.mcap", *noise(30000, gyro=ramp)))
    assert code == 0 and "gyro x, y, z drift steadily" in err and "--start" in err
    rates, forces = noise(60000)
    rates[:, 0] += 1.5e-3 * np.exp(-np.arange(60000) / 3000.0)
    code, _, err = allan(write(tmp_path / "warm.mcap", rates, forces))
    assert code == 0 and "gyro x settle at first: the IMU was warming up" in err
    _, _, err = allan(write(tmp_path / "cool.mcap", *noise(60000)))
    assert "warming" not in err


def test_knocks_are_left_out(allan, tmp_path):
    rates, forces = noise(9000)
    forces[3000:3020] += 0.3
    forces[6000:6020] += 0.12
    code, out, _ = allan(write(tmp_path / "knocks.mcap", rates, forces), "--json")
    rest = json.loads(out)["rest"]
    assert code == 0 and len(rest["stretches"]) == 3
    assert 0.5 <= rest["shaken_s"] <= 1.0  # the weaker one, which a still span may hold
    for axis in "xyz":
        assert measured(out)[1][axis]["bias_instability_m_per_s2"]["value"] is None


@pytest.mark.slow
def test_counts_that_change_seldom_are_not_knocks(allan, tmp_path):
    """Velocity in counts that gravity fills evenly, but for a count more or less now and then."""
    rates, forces = noise(12000)
    count = 1e-3
    velocity = np.cumsum(np.array([10.0, 20.0, -981.0]) + 0.02 * forces, axis=0)
    forces = np.diff(count * np.floor(velocity), axis=0, prepend=0.0) * RATE
    out = allan(write(tmp_path / "counts.mcap", rates, forces), "--json")[1]
    printed = json.loads(out)
    assert printed["rest"]["total_s"] > 119.0 and printed["rest"]["shaken_s"] == 0.0
    assert len(printed["rest"]["stretches"]) == 1


@pytest.mark.slow
@pytest.mark.parametrize(("walk", "visible"), [(1e-6, False), (1e-5, True)])
def test_counts_at_a_constant_rate(allan, tmp_path, walk, visible):
    """A laser gyro counts the Earth's rotation: its rounding beats, and is taken for no noise."""
    rng = np.random.default_rng(7)
    rates, forces = noise(60000)
    turned = np.cumsum([4e-5, -2e-5, 5e-5] + walk * RATE**0.5 * rng.standard_normal(rates.shape), 0)
    rates = np.diff(np.floor(turned / RATE / 5e-6) * 5e-6, axis=0, prepend=0.0) * RATE
    out = allan(write(tmp_path / "laser.mcap", rates, forces), "--json")[1]
    gyro, kinds = measured(out)[0], {f["kind"] for f in json.loads(out)["findings"]}
    assert not kinds & {"misfit", "coarse"}
    for axis in "xyz":
        found = gyro[axis]["angle_random_walk_rad_per_sqrt_s"]
        assert (found["value"] is not None) or not visible
        assert 0.9 * found["low"] < walk < 1.1 * found["high"] < 3.0 * walk
        assert gyro[axis]["bias_instability_rad_per_s"]["value"] is None


def test_rounding_that_hides_the_noise(allan, tmp_path):
    rates, forces = noise(12000)
    log = write(tmp_path / "coarse.mcap", np.round(rates / 0.006) * 0.006, forces)
    printed = json.loads(allan(log, "--json")[1])
    (coarse,) = (f for f in printed["findings"] if f["kind"] == "coarse")
    assert coarse["text"].startswith("gyro x, y, z: values are rounded")


def test_part_of_a_log(allan, rest):
    code, out, _ = allan(rest, "--json", "--end", "30")
    assert code == 0 and json.loads(out)["rest"]["total_s"] == pytest.approx(30.0, abs=0.6)


def test_page(allan, rest, tmp_path):
    page = tmp_path / "page.html"
    assert allan(rest, "--report", page, "-q")[0] == 0
    text = page.read_text()
    for words in ("Noise of an IMU at rest", "Gyro: Allan deviation", "What to put where",
                  "gyroscope_noise_density", "Angle random walk", "averaging time"):  # fmt: skip
        assert words in text
    figure = tmp_path / "figure.png"
    assert allan(rest, "--report", figure, "-q")[0] == 0 and figure.stat().st_size > 10_000


@pytest.mark.slow
def test_many_logs(allan, rest, tmp_path):
    other = write(tmp_path / "moves.mcap", *moved(*noise(3000), 0, 3000))
    folder = tmp_path / "noise"
    code, out, err = allan(rest, other, "-o", folder, "-j", "1")
    assert code == 1
    table = [line for line in out.splitlines() if "rest.mcap" in line]
    assert len(table) == 1 and "0.6" in table[0] and "<" in table[0]
    assert [path.name for path in folder.iterdir()] == ["rest.toml"]
    assert "2 logs: 1 done, 1 failed" in out and "never rests" in err
    code, out, _ = allan(rest, other, "--json", "-j", "1")
    lines = [json.loads(line) for line in out.splitlines()]
    assert [line["status"] for line in lines] == ["done", "failed"]


def test_usage(allan, rest, tmp_path):
    assert allan()[0] == 2
    code, _, err = allan(rest, "--format", "kalibr", "--json")
    assert code == 2 and "--output" in err
    code, _, err = allan(rest, "--format", "kaliber")
    assert code == 2 and "kalibr" in err
    code, out, _ = allan("--print-config")
    assert code == 0 and "imu_topic" in out
    code, _, err = allan(rest, "--report", tmp_path / "page.gif")
    assert code != 0 and "gif" in err


def test_noise_file_in_place_of_a_grade(sinstool, rest, tmp_path):
    """`process` and `align` take the file, say so, and refuse what contradicts it."""
    noise = tmp_path / "noise.toml"
    assert sinstool("allan", rest, "-o", noise, "-q")[0] == 0
    out = tmp_path / "out.mcap"
    code, said, err = sinstool("process", rest, "-o", out, "--imu-noise", noise, "--json")
    plan = json.loads(said)["plan"]
    assert code == 0, err
    assert plan["imu_noise"]["value"] == "noise.toml"
    assert "measured at rest, 0.68 deg/sqrt(h)" in plan["imu_noise"]["reason"]
    assert "by its gyro noise in noise.toml" in plan["imu_grade"]["reason"]
    code, said, _ = sinstool("align", rest, "--imu-noise", noise, "--json")
    assert code == 3 and json.loads(said)["plan"]["imu_noise"]["value"] == "noise.toml"
    options = ("--imu-noise", noise, "--imu-grade", "mems")
    code, _, err = sinstool("process", rest, "-o", tmp_path / "no.mcap", *options)
    assert code == 2 and "both say how noisy the IMU is" in err
    # A file that only bounds the white noise leaves it to the grade
    text = noise.read_text()
    noise.write_text(
        re.sub(r"(angle_random_walk)(_rad\S+) = (\S+)\n.*_95_.*\n", r"\1_below\2 = \3\n", text)
    )
    assert "angle_random_walk_below" in noise.read_text()
    code, said, err = sinstool("align", rest, "--imu-noise", noise, "--json")
    plan = json.loads(said)["plan"]
    assert code == 3 and plan["imu_noise"]["reason"] == "as configured: measured at rest"
    assert "by its gyro noise at rest" in plan["imu_grade"]["reason"]
    noise.write_text("schema = 3")
    code, _, err = sinstool("align", rest, "--imu-noise", noise)
    assert code == 2 and "noise.toml" in err
    _, said, _ = sinstool("info", rest, "--json")
    plan = json.loads(said)["process"]["plan"]
    assert plan["imu_noise"]["value"] == "of the grade"
    assert plan["imu_noise"]["reason"].startswith("as no noise file is given")


def test_sway_is_told_from_noise(allan, tmp_path):
    """A mooring turns gyro and gravity together; noise does not."""
    rates, forces = noise(12000)
    seconds = np.arange(12000) / RATE
    rates[:, 0] += 1e-3 * np.cos(2.0 * np.pi * seconds / 8.0)
    tilt = 1e-3 * 8.0 / (2.0 * np.pi) * np.sin(2.0 * np.pi * seconds / 8.0)
    forces[:, 1] += -9.8 * tilt
    code, out, err = allan(write(tmp_path / "moored.mcap", rates, forces), "--json")
    assert code == 0 and "sways at rest" in err
    found = {f["kind"]: f for f in json.loads(out)["findings"]}
    assert found["sway"]["numbers"]["sway_deg_s"] == pytest.approx(0.04, rel=0.3)
    rates, forces = noise(
        12000, gyro=(0.0, 2e-3, 0.0, 1e-5, 0.0), accel=(0.0, 2e-2, 2e-3, 0.0, 0.0)
    )
    code, _, err = allan(write(tmp_path / "still.mcap", rates, forces))
    assert code == 0 and "sways" not in err


def test_noise_file_for_many_logs(sinstool, rest, tmp_path, monkeypatch):
    """Its name counts from where the command was called, wherever workers stand."""
    monkeypatch.chdir(tmp_path)
    assert sinstool("allan", rest, "-o", "noise.toml", "-q")[0] == 0
    other = write(tmp_path / "other.mcap", *noise(1500))
    code, out, _ = sinstool("align", rest, other, "--imu-noise", "noise.toml", "--json", "-j", "1")
    lines = [json.loads(line) for line in out.splitlines()]
    assert code == 3
    assert [line["plan"]["imu_noise"]["value"] for line in lines] == ["noise.toml"] * 2


def test_a_dead_sensor_and_a_dead_imu(sinstool, allan, tmp_path):
    rates, forces = noise(3000)
    file = tmp_path / "noise.toml"
    log = write(tmp_path / "one.mcap", rates, np.tile(forces[:1], (3000, 1)))
    code, _, err = allan(log, "-o", file, "-q")
    assert code == 3 and "accelerometer x, y, z never changes" in err
    assert sinstool("align", log, "--imu-noise", file)[0] == 3
    still = [np.tile(columns[:1], (3000, 1)) for columns in (rates, forces)]
    log = write(tmp_path / "none.mcap", *still)
    code, _, err = allan(log, "-o", tmp_path / "no.toml")
    assert code == 1 and "shows noise where it rests" in err
    assert not (tmp_path / "no.toml").exists()


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("pause", [False, True])
def test_noise_as_loud_as_motion(allan, tmp_path, seed, pause):
    """Accelerometers for shocks: white noise of 0.6 m/s^2 a sample was "never at rest"."""
    rates, forces = noise(12000, seed, accel=(0.0, 0.6, 0.0, 0.0, 0.0))
    if pause:
        moved(rates, forces, 5000, 7000)
    code, out, _ = allan(write(tmp_path / "loud.mcap", rates, forces), "--json")
    _, accel = measured(out)
    assert code == 0 and json.loads(out)["rest"]["total_s"] > (70.0 if pause else 100.0)
    for axis in "xyz":
        found = accel[axis]["velocity_random_walk_m_per_s_per_sqrt_s"]
        assert found["value"] == pytest.approx(0.6 / np.sqrt(RATE), rel=0.04)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("correlated", [1, 3])
def test_a_drone_that_hovers_does_not_rest(allan, tmp_path, seed, correlated):
    """Its vibration is loud noise, too; but it never stays as level as that."""
    rates, forces = noise(12000, seed, accel=(0.0, 1.5, 0.0, 0.0, 0.0))
    random, kernel = np.random.default_rng(seed), np.hanning(150)
    sway = random.standard_normal((12149, 2)) / np.linalg.norm(kernel)
    for axis in (0, 1):
        lean = 0.03 * np.convolve(sway[:, axis], kernel, "valid")
        forces[:, 1 - axis] += 9.8 * lean
        rates[:, axis] += np.gradient(lean) * RATE
    forces += 1.5 * np.convolve(random.standard_normal(12000), np.ones(correlated), "same")[:, None]
    code, _, err = allan(write(tmp_path / "drone.mcap", rates, forces))
    assert code == 1 and "it never rests for 5 s" in err


@pytest.mark.parametrize("lost", [0.005, 0.03])
def test_lost_samples_change_nothing(allan, tmp_path, lost):
    """One in 200 lost made the noise 0.25 % too large: by the root of the mean interval."""
    rates, forces = noise(20000)
    kept = np.random.default_rng(2).random(20000) > lost
    time_ns = T0 + np.round(np.arange(20000) * 1e9 / RATE).astype(np.int64)
    for name, rows in (("all", slice(None)), ("lossy", kept)):
        log = write(tmp_path / f"{name}.mcap", rates[rows], forces[rows], time_ns[rows])
        code, out, _ = allan(log, "--json")
        assert code == 0
        assert json.loads(out)["averaging_s"][0] == pytest.approx(1.0 / RATE, rel=1e-6)
