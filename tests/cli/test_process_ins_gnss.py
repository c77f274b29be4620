"""`sinstool process --mode ins-gnss`, as a user runs it."""

import json
import struct

import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from mcap.writer import Writer

from sinstool.cli.main import cli
from sinstool.core.errors import ConfigurationError, TopicError
from sinstool.io.readers import open_log
from tests.helpers.filter_logs import CAUSES, simulated
from tests.helpers.logs import memory_below, real
from tests.helpers.one_line import one_line


def process(log, out, *options):
    result = CliRunner().invoke(
        cli, ["process", str(log), "-o", str(out), "--mode", "ins-gnss", "--json", *options]
    )
    assert result.exit_code in (0, 3), result.output
    return json.loads(result.stdout)


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    path = tmp_path_factory.mktemp("cli") / "drive.mcap"
    return simulated(
        path, "drive", "--grade", "mems", "--seed", "2", "--duration", "150", "--still", "20"
    )


def test_log_in_log_out(drive, tmp_path):
    out, page = tmp_path / "out.mcap", tmp_path / "page.html"
    result = process(
        drive, out, "--smooth", "--withhold-gnss", "100:115", "--report", str(page),
        "--truth", "/truth/imu", "--truth", "/truth/fix",
    )  # fmt: skip
    assert result["output"]["attitudes"] == result["imu"]["n"] == 15001
    assert result["filter"]["smoothed"] and result["height"] is not None
    assert result["filter"]["withheld"]["outages"][0]["epochs"] == 60
    assert max(result["truth"]["attitude_deg"]["rms"]) < 1.0
    text = page.read_text()
    for title in (
        "Innovations of position",
        "Gyro bias",
        "Track",
        "Error of attitude",
        "3 sigma, north",
    ):
        assert title in text
    with open_log(out) as written:
        counts = {c.topic: written.counts[number] for number, c in written.channels.items()}
    assert counts["/sinstool/odometry"] == 15001
    assert counts["/sinstool/diagnostics"] == 601
    assert counts["/imu/data_raw"] == 15001  # what came in is still there


def test_no_fixes_is_said(tmp_path):
    log = simulated(tmp_path / "none.mcap", "drive", "--duration", "60", "--gnss-rate", "0")
    result = CliRunner().invoke(
        cli, ["process", str(log), "-o", str(tmp_path / "out.mcap"), "--mode", "ins-gnss"]
    )
    assert isinstance(result.exception, TopicError)
    assert "has no GNSS fixes" in str(result.exception)
    assert not (tmp_path / "out.mcap").exists()


def test_a_rate_in_place_of_stamps_leaves_fixes_without_samples(drive, tmp_path):
    out = tmp_path / "out.mcap"
    arguments = ["process", str(drive), "-o", str(out), "--imu-rate", "100", "--json"]
    result = CliRunner().invoke(cli, [*arguments, "--mode", "ins-gnss"])
    assert isinstance(result.exception, ConfigurationError)
    assert "leave --imu-rate out" in str(result.exception)
    assert not out.exists()
    alone = json.loads(CliRunner().invoke(cli, arguments).stdout)
    assert alone["filter"] is None
    assert any("attitude only" in text and "--imu-rate" in text for text in alone["warnings"])


@pytest.mark.parametrize("text", ["10", "20:10", "a:b"])
def test_spans_that_are_none(drive, tmp_path, text):
    result = CliRunner().invoke(
        cli,
        ["process", str(drive), "-o", str(tmp_path / "o.mcap"), "--withhold-gnss", text],
    )
    assert isinstance(result.exception, ConfigurationError)
    assert "START:END" in str(result.exception)


def outages(first, length, period, end):
    result = []
    begin = first
    while begin + length < end:
        result += ["--withhold-gnss", f"{begin}:{begin + length}"]
        begin += period
    return result


@pytest.mark.slow
def test_rtk_drive(tmp_path):
    log = real("rtk_drive/rtk_drive_mems_100hz.mcap")
    hidden = outages(40.0, 15.0, 45.0, 545.0)
    result = process(log, tmp_path / "out.mcap", "--smooth", *hidden)
    used = result["filter"]
    # Stamps of the IMU are late by about 0.125 s, and velocities by half a fix's interval
    assert used["gnss_latency_s"] == pytest.approx(-0.125, abs=0.025)
    lag = used["gnss_latency"]["velocity_s"] - used["gnss_latency"]["position_s"]
    assert lag == pytest.approx(0.125, abs=0.01)
    assert used["restarts"] == 0 and used["epochs_gated"] < 50
    scores = used["withheld"]
    assert len(scores["outages"]) == 11
    assert scores["rms_of_largest_horizontal_m"] < 0.46  # published, looking back
    assert scores["filter"]["rms_of_largest_horizontal_m"] < 8.0  # published: 7.4


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "settle"),
    [("yk_urban_short_turn_loop_nominal_002", 60.0), ("yk_urban_stop_go_large_mount_001", 150.0)],
)
def test_car_beside_its_receiver(tmp_path, name, settle):
    log = real(f"vehicle_gnss/{name}.mcap")
    out = tmp_path / "out.mcap"
    begin = {60.0: 100.0, 150.0: 250.0}[settle]
    result = process(log, out, "--smooth", "--withhold-gnss", f"{begin}:{begin + 60.0}")
    scores = result["filter"]["withheld"]
    assert (CAUSES - {"latency"}).isdisjoint(finding["kind"] for finding in result["findings"])
    assert result["filter"]["restarts"] == 0
    assert scores["filter"]["outages"][0]["largest_in_sigmas"] < 3.0
    smooth, plain = (s["rms_of_largest_horizontal_m"] for s in (scores, scores["filter"]))
    assert smooth < 0.5 * plain


def test_an_error_of_the_alignment_names_the_log(sinstool, drive, tmp_path):
    span = ("--start", "50", "--end", "52")
    for options in ((), ("--print-plan",)):
        out = tmp_path / "out.mcap"
        status, _, err = sinstool("process", drive, "-o", out, "--align", "svd", *span, *options)
        assert status == 1 and one_line(err).startswith(f"sinstool: {drive}: alignment in flight")
        assert not out.exists()


def set_forward(source, target, at_s, by_s, topics=()):
    """A log whose clock was set while it was recorded, for some topics or all."""
    with source.open("rb") as stream, target.open("wb") as out:
        writer = Writer(out)
        writer.start(profile="ros2")
        numbers, begin = {}, None
        for schema, channel, message in make_reader(stream).iter_messages():
            begin = message.log_time if begin is None else begin
            if channel.topic not in numbers:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                numbers[channel.topic] = writer.register_channel(channel.topic, "cdr", number)
            data, time = bytearray(message.data), message.log_time
            if time - begin >= at_s * 10**9 and (not topics or channel.topic in topics):
                time += by_s * 10**9
                # The stamp's seconds follow the four bytes that say how a message is encoded
                struct.pack_into("<i", data, 4, struct.unpack_from("<i", data, 4)[0] + by_s)
            writer.add_message(numbers[channel.topic], time, bytes(data), time)
        writer.finish()


@pytest.mark.slow
@pytest.mark.parametrize("topics", [(), ("/imu/data_raw",)], ids=["all", "the IMU"])
@pytest.mark.parametrize("at_s", [30, 100])
def test_a_clock_that_is_set_forward_by_a_year_takes_no_memory(drive, tmp_path, at_s, topics):
    """As of a computer without a clock of its own that finds its time server."""
    log = tmp_path / "year.mcap"
    set_forward(drive, log, at_s, 30_000_000, topics)
    with memory_below(2**27):
        made = process(log, tmp_path / "out.mcap", "--smooth")
    assert "gaps" in {finding["kind"] for finding in made["findings"]}
