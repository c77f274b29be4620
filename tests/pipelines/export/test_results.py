"""Results unlike those of an ordinary run: other axes, encodings and writers, and damage."""

import numpy as np
import pandas
import pytest
from evo.tools import file_interface
from mcap.reader import make_reader
from mcap.writer import Writer

import sinstool
from sinstool.core.errors import SinstoolError
from sinstool.pipelines.export.run import export
from tests.helpers.imulogs import imu_messages, write_log
from tests.helpers.paths import ROOT
from tests.pipelines.export.settings import configured


def test_a_result_of_a_turntable_is_exported_in_its_own_axes(tmp_path):
    samples = ROOT / "sample_data" / "hse"
    logs, rigs = sorted(samples.glob("a-*.mcap")), [samples / f"rig-{site}.toml" for site in "ab"]
    sinstool.calibrate_hse(logs, rigs[0], tmp_path / "hse.json")
    options = {"config": rigs[1], "hse": tmp_path / "hse.json"}
    result = sinstool.process(samples / "b-200.mcap", tmp_path / "r.mcap", **options)
    export(tmp_path / "r.mcap", tmp_path / "file.csv", configured())
    result.export(tmp_path / "memory.csv")
    frames = [pandas.read_csv(tmp_path / f"{name}.csv") for name in ("file", "memory")]
    assert list(frames[0].columns) == list(frames[1].columns)
    assert np.allclose(*frames, rtol=0.0, atol=1e-9)


def test_a_result_in_the_encoding_of_ros_1_is_read_alike(tmp_path):
    times = 1_700_000_000_000_000_000 + 10_000_000 * np.arange(1000)
    gyro = np.stack([0.1 * np.sin(times / 1e9), 0.2 * np.cos(times / 1e9), 0.1 + 0.0 * times], 1)
    tables = []
    for ros in (1, 2):
        messages = imu_messages(times, gyro, (0.0, 0.0, 9.81), ros=ros)
        log = write_log(tmp_path / f"ros{ros}.mcap", messages, ros)
        sinstool.process(
            log,
            tmp_path / f"out{ros}.mcap",
            align="fixed",
            initial_attitude=(0, 0, 0),
            attitude="inertial",
        )
        export(tmp_path / f"out{ros}.mcap", tmp_path / f"{ros}.csv", configured())
        tables.append((tmp_path / f"{ros}.csv").read_text())
    assert tables[0] == tables[1] and len(tables[0].splitlines()) == 1001


def rewritten(source, target, keep):
    """A copy of a result, made by mcap's own writer, without some of its messages."""
    with source.open("rb") as stream, target.open("wb") as out:
        reader, writer = make_reader(stream), Writer(out, chunk_size=100_000)
        writer.start("ros2")
        channels = {}
        topics = ["/sinstool/imu", "/sinstool/attitude"]
        for schema, channel, message in reader.iter_messages(topics):
            if not keep(channel.topic, message.log_time):
                continue
            if channel.topic not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, "cdr", number)
            writer.add_message(
                channels[channel.topic], message.log_time, message.data, message.publish_time
            )
        for metadata in reader.iter_metadata():
            writer.add_metadata(metadata.name, metadata.metadata)
        writer.finish()
    return target


def test_rows_that_one_topic_lacks_are_left_out_and_chunks_make_no_difference(made, tmp_path):
    path, result = made["attitude"]
    every = result.solution.time_ns
    gone = {"/sinstool/attitude": set(every[100:200].tolist()), "/sinstool/imu": {int(every[-1])}}
    copy = rewritten(path, tmp_path / "all.mcap", lambda topic, time: True)
    fewer = rewritten(
        path,
        tmp_path / "fewer.mcap",
        lambda topic, time: time not in gone.get(topic, ()),
    )
    for name, source in (("path", path), ("copy", copy), ("fewer", fewer)):
        export(source, tmp_path / f"{name}.csv", configured())
    texts = [(tmp_path / f"{n}.csv").read_text().splitlines() for n in ("path", "copy", "fewer")]
    assert texts[0] == texts[1]
    assert texts[2] == [texts[0][0], *texts[0][1:101], *texts[0][201:-1]]


def test_results_that_were_merged_are_refused(made, tmp_path):
    path, _ = made["attitude"]
    with path.open("rb") as stream, (tmp_path / "two.mcap").open("wb") as out:
        writer = Writer(out)
        writer.start("ros2")
        for schema, channel, message in make_reader(stream).iter_messages(["/sinstool/imu"]):
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            channel = writer.register_channel(channel.topic, "cdr", number)
            for _ in range(2):
                writer.add_message(channel, message.log_time, message.data, message.publish_time)
        writer.finish()
    with pytest.raises(SinstoolError, match=r"times of /sinstool/imu go back or repeat"):
        export(tmp_path / "two.mcap", tmp_path / "x.csv", configured())
    assert not (tmp_path / "x.csv").exists()


def test_rows_that_damage_left_without_an_attitude_are_left_out_and_counted(made, tmp_path):
    path, result = made["attitude"]
    topic, last = "/sinstool/attitude", int(result.solution.time_ns[199])
    copy = rewritten(path, tmp_path / "copy.mcap", lambda one, t: one == topic and t <= last)
    with copy.open("rb") as stream, (tmp_path / "bad.mcap").open("wb") as out:
        writer = Writer(out)
        writer.start("ros2")
        for row, (schema, channel, message) in enumerate(make_reader(stream).iter_messages()):
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            number = writer.register_channel(channel.topic, "cdr", number)
            # the quaternion is the last that the message holds
            data = message.data[:-32] + bytes(32) if row == 7 else message.data
            data = data[:-1] if row == 9 else data
            writer.add_message(number, message.log_time, data, message.publish_time)
        writer.finish()
    for suffix in ("csv", "tum"):
        exported = export(tmp_path / "bad.mcap", tmp_path / f"x.{suffix}", configured())
        assert exported.exit_status == 3
        kinds = {finding.kind: finding.text for finding in exported.findings}
        assert kinds["malformed"].endswith(": 1 message")
        assert kinds["not-finite"].endswith(": 1 row") and "no-record" in kinds
    whole, bad = pandas.read_csv(tmp_path / "x.csv").time_ns, tmp_path / "x.tum"
    assert len(whole) == file_interface.read_tum_trajectory_file(str(bad)).num_poses
    assert len(whole) == 198
