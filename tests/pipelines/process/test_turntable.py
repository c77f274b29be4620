"""`process --hse`: headings corrected at other sites, attitudes against the truth, refusals."""

import json
from collections import Counter

import numpy as np
import pytest
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

from sinstool.core.rotation import to_euler
from sinstool.core.units import DEGREE
from tests.helpers.hse_rigs import (
    ARCSEC,
    WITHOUT_OFFSET,
    arcsec,
    edited,
    simulate,
    sinstool,
    wrapped,
)
from tests.helpers.imulogs import read_attitude, read_topic
from tests.helpers.one_line import last_words

CALIBRATION = {"min_turns": 4, "min_duration": 15.0}
# e1 - e2 + e3 is not 0: a constant heading that is no heading-sensitive error stays
EPSILON = (2.2, 0.8, 1.2)
D = -(EPSILON[0] - EPSILON[1] + EPSILON[2]) * ARCSEC / (2.0 * np.sqrt(3.0))
BASE_LEAN = 8e-4


def leaning(heading_deg):
    """The axis leans to the right of the base, which is turned on a level stand: north, east."""
    heading = np.radians(heading_deg)
    return -BASE_LEAN * np.sin(heading), BASE_LEAN * np.cos(heading)


def log_at(folder, name, heading, latitude, rates, epsilon=EPSILON, **options):
    north, east = leaning(heading)
    log, rig = simulate(
        folder, name, heading=heading, latitude=np.degrees(latitude), rates=rates, plateau=54,
        rate=20, encoder_rate=20, tilt_north=north, tilt_east=east,
        epsilon=",".join(map(str, epsilon)), **options,
    )  # fmt: skip
    return log, edited(rig, name, calibration=CALIBRATION)


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    """Calibration at one site: four azimuths, both directions, no noise."""
    folder = tmp_path_factory.mktemp("calibrated")
    logs = [log_at(folder, f"az{h}", h, 0.49, "60,30,-30,-60") for h in (20, 110, 200, 290)]
    hse = folder / "hse.json"
    paths = [log for log, _ in logs]
    status, _, err = sinstool("calibrate-hse", *paths, "--config", logs[0][1], "-o", hse)
    assert status == 0, err
    return hse, json.loads(hse.read_text()), logs[0]


def process(folder, log, rig, hse, *more):
    out = folder / f"{log.stem}.out.mcap"
    status, text, err = sinstool(
        "process", log, "-o", out, "--config", rig, "--hse", hse, "--json", *more
    )
    return status, json.loads(text) if text else None, err, out


def test_calibration_at_four_azimuths(calibrated):
    _, cal, _ = calibrated
    assert cal["status"] == "ok"
    assert cal["fit"]["n_runs"] == 16
    assert cal["lambda2_arcsec"] == pytest.approx(-4.2, abs=1e-3)
    assert abs(cal["delay_s"]) < 1e-9
    # the constant of eq. (12) is the same at all azimuths of one latitude, but for tilt
    error = wrapped(np.array(cal["psi0_rad"]) - np.radians([20, 110, 200, 290]))
    np.testing.assert_allclose(error, -D, atol=0.003 * ARCSEC)


@pytest.mark.parametrize("latitude", [0.9, -0.6, 0.0])
@pytest.mark.parametrize("heading", [65, 245])
def test_headings_at_other_sites(calibrated, tmp_path, latitude, heading):
    hse, _, _ = calibrated
    log, rig = log_at(tmp_path, "site", heading, latitude, "40,-40")
    status, printed, err, _ = process(tmp_path, log, rig, hse, "--only-results")
    assert (status, err) == (0, "")
    segments = printed["hse"]["segments"]
    assert [round(s["rate_deg_s"]) for s in segments] == [40, -40]
    north, _ = leaning(heading)
    constant = -D * (1.0 + north * np.tan(latitude))
    for s in segments:
        left = wrapped(np.radians(s["heading_deg"] - heading)) - constant
        assert abs(arcsec(left)) < 0.003
        # which was not so before
        was = wrapped(np.radians(s["heading_raw_deg"] - heading)) - constant
        assert abs(arcsec(was)) > 3.0
        assert s["correction_arcsec"] == pytest.approx(arcsec(was), abs=0.003)


def payloads(path, skip=("/sinstool/",)):
    listed = []
    with path.open("rb") as stream:
        for _, channel, m in make_reader(stream).iter_messages():
            if not channel.topic.startswith(skip):
                listed.append((channel.topic, m.log_time, m.publish_time, m.data))
    return sorted(listed)


def test_every_attitude_is_the_truth(calibrated, tmp_path):
    hse, _, _ = calibrated
    epsilon = tuple(map(float, WITHOUT_OFFSET.split(",")))
    log, rig = log_at(tmp_path, "turning", 65, 0.9, "40,-40", epsilon, truth=True)
    # the same sum of errors, another K_g: the coefficient is the same, the rig is not
    status, _, err, out = process(tmp_path, log, rig, hse)
    assert status == 2 and "another configuration" in last_words(err)
    assert not out.exists()
    status, printed, err, out = process(tmp_path, log, rig, hse, "--world", "ned", "--force")
    assert status == 0
    assert "warning: --force: " in err
    times, q = read_attitude(out)
    true_times, true = read_attitude(log, "/truth/imu")
    np.testing.assert_array_equal(times, true_times)
    assert len(times) == printed["imu"]["n"] == printed["output"]["attitudes"]
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-14)
    error = (Rotation.from_quat(q).inv() * Rotation.from_quat(true)).magnitude()
    # ramps through rest and the ends of the log included
    assert error.max() < 0.003 * ARCSEC
    # within the log the rate goes from 40 to -40 deg/s
    assert np.ptp([m.angular_velocity.z for _, m in read_topic(out, "/sinstool/imu")]) > 1.3
    assert payloads(out) == payloads(log)
    last = to_euler(np.roll(true[-1], 1))
    final = printed["final"]
    np.testing.assert_allclose(
        np.radians([final["roll_deg"], final["pitch_deg"], final["heading_deg"]]), last, atol=2e-8
    )


def test_a_reference_is_of_the_turning_body(calibrated, tmp_path):
    """It was read as of a body in FLU: 104 deg of heading were off, and no word said why."""
    hse, _, _ = calibrated
    epsilon = tuple(map(float, WITHOUT_OFFSET.split(",")))
    log, rig = log_at(tmp_path, "turning", 65, 0.9, "40,-40", epsilon, truth=True)
    options = ("--force", "--truth", "/truth/imu", "--only-results")
    status, printed, _, _ = process(tmp_path, log, rig, hse, *options)
    assert status == 0
    assert max(printed["truth"]["attitude_deg"]["largest"]) < 0.003 * ARCSEC / DEGREE


def test_attitude_survives_a_late_encoder(calibrated, tmp_path):
    """What the delay adds to the base's heading it takes from the table's angle."""
    hse, _, _ = calibrated
    log, rig = log_at(tmp_path, "late", 65, 0.49, "40,-40", truth=True, encoder_delay=100)
    status, printed, _, out = process(tmp_path, log, rig, hse, "--world", "ned", "--only-results")
    assert status == 0
    shift = [wrapped(np.radians(s["heading_deg"] - 65)) + D for s in printed["hse"]["segments"]]
    np.testing.assert_allclose(shift, np.radians([40, -40]) * 1e-4, atol=0.01 * ARCSEC)
    _, q = read_attitude(out)
    _, true = read_attitude(log, "/truth/imu")
    error = (Rotation.from_quat(q).inv() * Rotation.from_quat(true)).magnitude()
    steady = slice(100, 900)
    assert abs(error[steady] - abs(D)).max() < 0.02 * ARCSEC


def test_corrupt_or_foreign_calibration(calibrated, tmp_path):
    hse, cal, (log, rig) = calibrated
    bad = tmp_path / "bad.json"

    def refused(text, message):
        if text is not None:
            bad.write_text(text)
        status, _, err, _ = process(tmp_path, log, rig, bad)
        assert status == 2
        assert message in last_words(err)
        assert str(bad) in err
        assert list(tmp_path.glob("*.mcap*")) == []

    refused(None, "cannot be read (No such file or directory)")
    refused("", "is no calibration")
    refused('{"schema": ', "is no calibration")
    refused("[1, 2]", "has no schema")
    refused(json.dumps({**cal, "schema": "sinstool.hse/2"}), "sinstool.hse/2")
    refused(json.dumps({**cal, "lambda2_arcsec": 4.2}), "it was edited")
    refused(json.dumps({**cal, "lambda2_rad": "much"}), "valid number")
    refused(json.dumps({k: v for k, v in cal.items() if k != "runs"}), "lacks runs")
    refused(hse.read_text().replace("rate_rad_s", "rate"), "rate")
    bad.write_bytes(b"\xff\xfe\x00")
    refused(None, "it is not text")


def test_without_a_rig(calibrated, tmp_path):
    hse, _, (log, _) = calibrated
    status, _, err = sinstool("process", log, "-o", tmp_path / "o.mcap", "--hse", hse)
    assert status == 2
    assert "[rig]" in last_words(err)


def test_modes_of_a_vehicle_are_refused(calibrated, tmp_path):
    hse, _, (log, rig) = calibrated
    status, _, err, out = process(tmp_path, log, rig, hse, "--mode", "ins")
    assert status == 2
    assert "--mode ins does not go with --hse" in last_words(err)
    assert not out.exists()


def test_nothing_to_align_on(calibrated, tmp_path):
    hse, _, (log, rig) = calibrated
    short = edited(rig, "long", calibration={"min_turns": 50})
    status, _, err, out = process(tmp_path, log, short, hse)
    assert status == 1
    assert "50 whole ones are needed" in last_words(err)
    assert not out.exists()


def test_outside_what_was_calibrated(calibrated, tmp_path):
    hse, _, _ = calibrated
    log, rig = simulate(
        tmp_path, "fast", rates="120", plateau=30, tilt_east=2e-3, heading=10, encoder_rate=20
    )
    rig = edited(rig, "fast", calibration=CALIBRATION)
    status, printed, err, _ = process(tmp_path, log, rig, hse, "--only-results")
    assert status == 0
    assert "its rate, 120.00 deg/s, is outside the calibrated range" in err
    assert "leans to the east by 2.00e-03 rad, more than in the calibration" in err
    (segment,) = printed["hse"]["segments"]
    assert segment["outside_rate"] and segment["outside_C23"]


def with_messages(log, path, wanted):
    """The log without the messages that `wanted(topic, s since its start, number)` refuses."""
    from mcap.writer import Writer

    with log.open("rb") as stream, path.open("wb") as out:
        writer = Writer(out)
        writer.start(profile="ros2")
        channels, count, start = {}, Counter(), None
        for schema, channel, m in make_reader(stream).iter_messages():
            start = m.log_time if start is None else start
            if channel.topic not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, "cdr", number)
            count[channel.topic] += 1
            if wanted(channel.topic, (m.log_time - start) * 1e-9, count[channel.topic]):
                writer.add_message(channels[channel.topic], m.log_time, m.data, m.publish_time)
        writer.finish()
    return path


def test_gap_in_the_encoder(calibrated, tmp_path):
    """Samples without an angle get no attitude, and that is told."""
    hse, _, _ = calibrated
    log, rig = log_at(tmp_path, "whole", 65, 0.49, "40,-40")
    holed = with_messages(
        log,
        tmp_path / "holed.mcap",
        lambda topic, at, _: topic != "/joint_states" or not 56 < at < 58,
    )
    status, printed, err, _ = process(tmp_path, holed, rig, hse, "--only-results")
    assert status == 0
    missing = printed["imu"]["n"] - printed["output"]["attitudes"]
    assert 35 < missing < 45
    assert (
        f"warning: {missing} samples without attitude, where the encoder or the gyro has a gap"
        in err
    )
    assert len(printed["hse"]["segments"]) == 2


def test_lost_samples_are_filled_and_said(calibrated, tmp_path):
    """One message in fifty lost: the same stretches, and no attitude where there is no sample."""
    hse, _, _ = calibrated
    log, rig = log_at(tmp_path, "all", 65, 0.49, "40,-40")
    lossy = with_messages(
        log,
        tmp_path / "lossy.mcap",
        lambda topic, at, number: topic == "/joint_states" or number % 50,
    )
    _, complete, _, _ = process(tmp_path, log, rig, hse, "--only-results")
    status, printed, err, out = process(tmp_path, lossy, rig, hse, "--only-results")
    assert status == 0
    lost = complete["imu"]["n"] - printed["imu"]["n"]
    assert lost == complete["imu"]["n"] // 50
    assert f"{lost} of {complete['imu']['n']} samples of /imu/data_raw are missing" in err
    times, _ = read_attitude(out)
    assert len(times) == printed["output"]["attitudes"] == printed["imu"]["n"]
    for one, whole in zip(printed["hse"]["segments"], complete["hse"]["segments"], strict=True):
        assert one["turns"] == whole["turns"]
        assert abs(one["heading_deg"] - whole["heading_deg"]) * 3600.0 < 1.0


@pytest.mark.parametrize("more", [(), ("--print-plan",)])
def test_a_noise_file_is_read_though_it_has_no_effect(calibrated, tmp_path, more):
    hse, _, (log, rig) = calibrated
    command = ("process", log, "-o", tmp_path / "o.mcap", "--config", rig, "--hse")
    status, _, err = sinstool(*command, hse, "--imu-noise", tmp_path / "none.json", *more)
    assert status == 2 and "none.json: cannot be read" in err
    status, _, err = sinstool(*command, tmp_path / "none.json", *more)
    assert status == 2 and "none.json: cannot be read" in err
    status, _, err = sinstool(*command, hse, "--imu-grade", "mems", *more)
    assert status == 0 and (more or "--imu-grade has no effect in mode turntable" in err)
