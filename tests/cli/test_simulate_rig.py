"""`simulate hse-rig`: the log, the rig beside it, and what is refused."""

import tomllib

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sinstool.methods.hse.rig import from_table
from sinstool.simulation.rig_log import lean
from tests.helpers.hse_rigs import ARCSEC, simulate, sinstool
from tests.helpers.imulogs import read_attitude, read_topic

SHORT = {"rates": "60,-30", "plateau": 6, "rate": 20, "encoder_rate": 10}


@pytest.mark.parametrize("heading", [0.0, 0.7, 2.5, 4.0, -1.2])
@pytest.mark.parametrize(("north", "east"), [(0.0, 0.0), (0.0, 0.3), (-0.2, 0.1), (8e-4, -5e-3)])
def test_lean_is_where_the_axis_points(heading, north, east):
    theta, gamma = lean(heading, north, east)
    down = Rotation.from_euler("ZYX", [heading, theta, gamma]).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(down[:2], [north, east], atol=1e-15)


def test_log_and_rig(tmp_path):
    options = {"heading": 75, "tilt_east": 0.01, "tilt_north": -0.02, "latitude": -40}
    log, rig = simulate(tmp_path, "rig", truth=True, **SHORT, **options)
    times, q = read_attitude(log, "/truth/imu")
    # 6 s, 18 s from one rate to the other, 6 s
    assert len(times) == 30 * 20
    assert np.diff(times) == pytest.approx(5e7)
    down = Rotation.from_quat(q).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(down[:, :2], np.tile([-0.02, 0.01], (600, 1)), atol=1e-12)
    imu = [m for _, m in read_topic(log, "/imu/data_raw")]
    assert len(imu) == 600
    assert imu[0].header.frame_id == "gyro_triad"
    raw = np.array([[getattr(m.angular_velocity, a) for a in "xyz"] for m in imu])
    joint = [m for _, m in read_topic(log, "/joint_states")]
    assert len(joint) == 30 * 10 + 1
    assert joint[0].name == ["table"]
    angle = np.unwrap([m.position[0] for m in joint])
    rate = np.diff(angle) * 10.0
    np.testing.assert_allclose(np.degrees(rate[[0, -1]]), [60.0, -30.0], atol=1e-9)

    # the rig is the one that its user believes in: wrong by epsilon, right along the axis but for
    # a third of their sum
    table = tomllib.loads(rig.read_text())["rig"]
    believed = from_table(table)
    in_b = raw @ believed.gyro_to_b.T
    error = in_b[:50, 2].mean() / np.radians(60.0) - 1.0
    earth = 7.292115e-5 * np.sin(np.radians(40)) / np.radians(60.0)
    assert error - earth == pytest.approx(4.2 * ARCSEC / 3.0, abs=2e-6)
    assert table["latitude_deg"] == -40
    assert table["encoder"] == {"joint": "table", "sign": 1}


def test_encoder_the_other_way(tmp_path):
    log, rig = simulate(tmp_path, "rig", encoder_sign=-1, **SHORT)
    joint = [m for _, m in read_topic(log, "/joint_states")]
    angle = np.unwrap([m.position[0] for m in joint])
    assert angle[5] - angle[0] == pytest.approx(-np.radians(60.0) * 0.5)
    assert tomllib.loads(rig.read_text())["rig"]["encoder"]["sign"] == -1


def test_same_seed_same_bytes(tmp_path):
    noise = {"arw": 1e-3, "vrw": 50, "gyro_bias": 0.01, "accel_bias": 50, "gyro_drift": 0.001}
    first = simulate(tmp_path, "first", seed=5, **SHORT, **noise)[0].read_bytes()
    again = simulate(tmp_path, "again", seed=5, **SHORT, **noise)[0].read_bytes()
    other = simulate(tmp_path, "other", seed=6, **SHORT, **noise)[0].read_bytes()
    assert first == again
    assert first != other


def test_rig_can_be_written_anew_while_the_log_is_new(tmp_path):
    _, rig = simulate(tmp_path, "rig", **SHORT)
    words = ("--rates", "60", "--plateau", "2", "--rate", "20")
    status, _, err = sinstool(
        "simulate", "hse-rig", "-o", tmp_path / "new.mcap", "--rig-out", rig, "--overwrite", *words
    )
    assert (status, err) == (0, "")


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (("--rates", "20,fast"), 2, "'20,fast' is not numbers separated by commas"),
        (("--plateau", "0"), 2, "--plateau 0.0: must be greater than 0"),
        (("--encoder-rate", "-1"), 2, "--encoder-rate -1.0: must be greater than 0"),
        (("--latitude", "91"), 2, "--latitude 91.0: must be less than or equal to 90"),
        (("--rates", ""), 2, "'' is not numbers"),
        (("--rates", "20,nan"), 2, "--rates nan: must be a finite number"),
        (("--heading", "nan"), 2, "--heading nan: must be a finite number"),
        (("--kappa", "0,inf,0"), 2, "--kappa inf: must be a finite number"),
        (("--arw", "-1"), 2, "--arw -1.0: must be greater than or equal to 0"),
        (("--tilt-east", "2"), 2, "the axis leans by"),
        (("--rates", "20", "--plateau", "0.001"), 2, "fewer than two samples"),
        (("--epsilon", "1,2"), 2, "is not 3 numbers"),
        (("--rig-out", "OUTPUT"), 1, "is named twice"),
    ],
)
def test_refusals(tmp_path, arguments, status, message):
    output = tmp_path / "rig.mcap"
    arguments = [output if a == "OUTPUT" else a for a in arguments]
    code, _, err = sinstool("simulate", "hse-rig", "-o", output, *arguments)
    assert code == status
    assert message in err
    assert list(tmp_path.iterdir()) == []


def test_existing_files_are_kept(tmp_path):
    log, rig = simulate(tmp_path, "rig", **SHORT)
    before = rig.read_bytes()
    for arguments in (("-o", log), ("-o", tmp_path / "b.mcap", "--rig-out", rig)):
        status, _, err = sinstool("simulate", "hse-rig", *arguments, "--plateau", "5")
        assert status == 1
        assert "exists already" in err
    assert rig.read_bytes() == before
    assert not (tmp_path / "b.mcap").exists()
