import os
import sqlite3

import numpy as np
import pytest
import zstandard
from rosbags.rosbag2 import Reader
from ruamel.yaml import YAML

from sinstool.core.errors import DamagedLogError, NotALogError, UnsupportedLogError
from sinstool.io.readers import open_log
from sinstool.io.readers import rosbag2 as rosbag2_module
from tests.helpers.logs import (
    IMU,
    TOPICS,
    Row,
    content,
    definition,
    read_back,
    real,
    snapshot,
    write_bag2,
    write_db3,
    write_mcap,
)


def metadata(folder, files, storage="sqlite3", extra=""):
    listed = "".join(f"  - {name}\n" for name in files)
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  version: 4\n"
        f"  storage_identifier: {storage}\n{extra}  relative_file_paths:\n{listed}"
    )


@pytest.mark.parametrize("storage", ["db3", "mcap"])
@pytest.mark.parametrize("mode", [None, "file", "message"])
def test_bags_of_rosbags_writer(tmp_path, storage, mode):
    path = write_bag2(tmp_path / "bag", content(), storage, mode)
    before = snapshot(path)
    with open_log(path) as log:
        assert (log.format, log.profile) == ("rosbag2", "ros2")
        assert {c.topic: c.type for c in log.channels.values()} == TOPICS
        assert read_back(log) == content()
        assert read_back(log, [log.channels_of("/baro")[0].id]) == [
            row for row in content() if row.topic == "/baro"
        ]
        assert log.channels_of("/imu")[0].schema_text == definition(IMU)[0]
        unpacked = log._unpacked.path if log._unpacked else ""
        assert bool(unpacked) == (mode == "file")
        assert not log.lost
    assert not (unpacked and os.path.exists(unpacked))
    assert snapshot(path) == before


def split(folder, storage="db3", pieces=12):
    """A bag in pieces, with other channel numbers in each."""
    folder.mkdir()
    names = []
    for k in range(pieces):
        part = content()[k * 400 // pieces : (k + 1) * 400 // pieces]
        part = sorted(part, key=lambda row: (row.topic == "/imu") == (k % 2 == 0))
        names.append(f"bag_{k}.{storage}")
        if storage == "db3":
            write_db3(folder / names[-1], part, 3 if k else 1)
        else:
            write_mcap(folder / names[-1], part)
    return names


def in_order(folder, names):
    out = []
    for name in names:
        with open_log(folder / name) as log:
            out += read_back(log)
    return out


@pytest.mark.parametrize("storage", ["db3", "mcap"])
def test_channels_are_the_same_in_all_files(tmp_path, storage):
    folder = tmp_path / "bag"
    names = split(folder, storage)
    expected = in_order(folder, names)
    assert sorted(expected) == sorted(content())
    backwards = names[::-1]
    metadata(folder, [f"bag/{n}" for n in backwards], {"db3": "sqlite3"}.get(storage, storage))
    with open_log(folder) as log:
        assert len(log.channels) == 2
        assert read_back(log) == in_order(folder, backwards)
        assert [part.path.name for part in log.parts] == backwards
        assert sum(log.counts.values()) == (len(content()) if storage == "mcap" else 0)
    (folder / "metadata.yaml").unlink()
    with open_log(folder) as log:  # in natural order: bag_2 before bag_10
        assert read_back(log) == expected


def test_a_topic_whose_type_changes_is_two_channels(tmp_path):
    folder = tmp_path / "bag"
    folder.mkdir()
    write_db3(folder / "a.db3", content(10))
    path = write_db3(folder / "b.db3", content(10))
    database = sqlite3.connect(path)
    database.execute("UPDATE topics SET type = 'sensor_msgs/msg/Temperature' WHERE name = '/baro'")
    database.commit()
    database.close()
    with open_log(folder) as log:
        assert len(log.channels_of("/imu")) == 1
        assert [c.type.split("/")[-1] for c in log.channels_of("/baro")] == [
            "FluidPressure",
            "Temperature",
        ]
        assert read_back(log) == content(10) * 2


def test_a_file_that_is_missing(tmp_path):
    folder = tmp_path / "bag"
    names = split(folder)
    metadata(folder, names)
    (folder / names[3]).unlink()
    with pytest.raises(DamagedLogError, match=r"lists bag_3\.db3, which is missing.*--salvage"):
        open_log(folder)
    with open_log(folder, salvage=True) as log:
        assert read_back(log) == in_order(folder, names[:3] + names[4:])
        assert [str(p) for p in log.lost] == ["metadata.yaml lists bag_3.db3, which is missing"]


def test_a_damaged_file_is_named(tmp_path):
    folder = tmp_path / "bag"
    names = split(folder, "mcap", 3)
    metadata(folder, names, "mcap")
    expected = in_order(folder, names)
    data = (folder / names[1]).read_bytes()
    (folder / names[1]).write_bytes(data[:-3])
    with pytest.raises(DamagedLogError, match=r"bag_1\.mcap: cut short"):
        open_log(folder)
    with open_log(folder, salvage=True) as log:
        assert read_back(log) == expected
        assert log.lost[0].file == "bag_1.mcap"
        assert str(log.lost[0]).startswith("bag_1.mcap: cut short")


def test_salvaging_a_folder_does_not_say_how_to_salvage(tmp_path):
    folder = tmp_path / "bag"
    names = split(folder, "db3", 3)
    expected = in_order(folder, names[:2])
    (folder / names[2]).write_bytes((folder / names[2]).read_bytes()[:100] + bytes(5000))
    with pytest.raises(DamagedLogError, match="--salvage"):
        open_log(folder)
    with open_log(folder, salvage=True) as log:
        assert read_back(log) == expected
        (part,) = map(str, log.lost)
        assert names[2] in part and ".recover" in part and "--salvage" not in part


@pytest.mark.parametrize(
    "text", ["", "just text", "a: [", "rosbag2_bagfile_information: 3", "\x00"]
)
def test_metadata_that_cannot_be_used(tmp_path, text):
    folder = tmp_path / "bag"
    names = split(folder, pieces=3)
    (folder / "metadata.yaml").write_text(text)
    with pytest.raises(DamagedLogError, match=r"metadata\.yaml cannot be used") as caught:
        open_log(folder)
    assert "\n" not in str(caught.value)
    with open_log(folder, salvage=True) as log:
        assert read_back(log) == in_order(folder, names)


def test_what_we_do_not_read_is_named(tmp_path):
    folder = tmp_path / "bag"
    names = split(folder, pieces=1)
    metadata(folder, names, "leveldb")
    with pytest.raises(UnsupportedLogError, match=r"'leveldb'.*sqlite3 and mcap"):
        open_log(folder)
    metadata(folder, names, extra="  compression_mode: FILE\n  compression_format: lz4\n")
    with pytest.raises(UnsupportedLogError, match="compressed with 'lz4'"):
        open_log(folder)


def test_folders_that_are_no_bags(tmp_path):
    with pytest.raises(NotALogError, match="holds no files"):
        open_log(tmp_path)
    (tmp_path / "a.csv").write_text("1,2")
    write_mcap(tmp_path / "a.mcap", content(3))
    write_mcap(tmp_path / "b.mcap", content(3))
    with pytest.raises(NotALogError, match=r"holds 1 \.csv, 2 \.mcap: name one log"):
        open_log(tmp_path)


def test_compressed_files_that_are_cut_or_corrupt(tmp_path):
    path = write_bag2(tmp_path / "bag", content(1200), "mcap", "file")
    file = next(p for p in path.iterdir() if p.suffix == ".zstd")
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 2])
    with pytest.raises(DamagedLogError, match="ends too early"):
        open_log(path)
    with open_log(path, salvage=True) as log:
        result = read_back(log)
        assert result == content(1200)[: len(result)]
    file.write_bytes(data[:4] + b"\xff" * 8 + data[12:])
    with pytest.raises(DamagedLogError, match="zstd data is corrupt"):
        open_log(path)


def test_compressed_files_of_several_frames(tmp_path):
    path = write_bag2(tmp_path / "bag", content(), "db3", "file")
    file = next(p for p in path.iterdir() if p.suffix == ".zstd")
    plain = zstandard.ZstdDecompressor().stream_reader(file.read_bytes()).read()
    frames = [plain[:5000], plain[5000:9000], plain[9000:]]
    file.write_bytes(b"".join(zstandard.compress(f) for f in frames))
    with open_log(path) as log:
        assert read_back(log) == content()


@pytest.mark.parametrize("salvage", [False, True])
def test_a_compressed_file_that_swells_without_end_is_not_unpacked(tmp_path, monkeypatch, salvage):
    monkeypatch.setattr(rosbag2_module, "ORDINARY_BLOCK", 2**20)
    monkeypatch.setattr(rosbag2_module, "MOST_SWELLING", 64)
    folder = write_bag2(tmp_path / "bag", content(30), mode="file")
    (file,) = folder.glob("*.zstd")
    plain = zstandard.ZstdDecompressor().stream_reader(file.read_bytes()).read()
    # Behind its last page SQLite looks at nothing.
    file.write_bytes(zstandard.compress(plain) + 32 * zstandard.compress(bytes(2**20)))
    largest = max(2**20, 64 * file.stat().st_size)
    if salvage:
        with open_log(folder, salvage=True) as log:
            assert read_back(log) == content(30)
            assert log.parts[0].size < largest + 2**21
            (lost,) = [part for part in log.lost if part.kind == "file"]
            assert f"more than {largest} bytes" in str(lost)
    else:
        with pytest.raises(DamagedLogError, match=f"more than {largest} bytes"):
            open_log(folder)


def test_compressed_messages_that_are_damaged_or_swell(tmp_path, monkeypatch):
    monkeypatch.setattr("sinstool.io.readers.rosbag2.ORDINARY_BLOCK", 2**22)
    path = write_bag2(tmp_path / "bag", content(30), "db3", "message")
    file = next(path.glob("*.db3"))
    unsized = zstandard.ZstdCompressor(write_content_size=False)
    database = sqlite3.connect(file)
    database.execute("UPDATE messages SET data = x'28b52ffd00' WHERE id = 3")
    database.execute("UPDATE messages SET data = x'1234' WHERE id = 4")
    database.execute(
        "UPDATE messages SET data = ? WHERE id = 5", (unsized.compress(content(30)[4].payload),)
    )
    bomb = unsized.compress(bytes(2**22 + 1))
    database.execute("UPDATE messages SET data = ? WHERE id = 6", (bomb,))
    database.commit()
    database.close()
    with open_log(path) as log, pytest.raises(DamagedLogError, match="a message's zstd"):
        read_back(log)
    with open_log(path, salvage=True) as log:
        assert read_back(log) == content(30)[:2] + content(30)[4:5] + content(30)[6:]
        assert log.lost


@pytest.mark.parametrize("storage", ["db3", "mcap"])
@pytest.mark.parametrize("mode", [None, "message"])
@pytest.mark.parametrize("said", ["nothing", "none", "message"])
def test_messages_show_whether_they_are_compressed(tmp_path, storage, mode, said):
    """Metadata that are lost, or made by hand, do not say it, or say it wrongly."""
    path = write_bag2(tmp_path / "bag", content(30), storage, mode)
    metadata = path / "metadata.yaml"
    if said == "nothing":
        metadata.unlink()
    else:
        yaml = YAML(typ="safe")
        about = yaml.load(metadata.read_text())
        information = about["rosbag2_bagfile_information"]
        information["compression_mode"] = "" if said == "none" else "MESSAGE"
        information["compression_format"] = "" if said == "none" else "zstd"
        with metadata.open("w") as stream:
            yaml.dump(about, stream)
    with open_log(path) as log:
        assert read_back(log) == content(30)


def test_a_file_of_compressed_messages_alone_says_so(tmp_path):
    from sinstool.io.messages.decode import Decoder

    path = write_bag2(tmp_path / "bag", content(3), "db3", "message")
    file = next(path.glob("*.db3"))
    with open_log(file) as log:
        channel = log.channels_of("/imu")[0]
        decoder = Decoder(channel.definition(file), {"x": ["angular_velocity.x"]})
        for batch in log.batches([channel.id]):
            assert not decoder.decode(batch.buffer, batch.offset, batch.length).valid.any()
    assert "open the bag's folder" in decoder.problem


# -- real ones -----------------------------------------------------------------------------


@pytest.mark.parametrize("inside", ["", "/ardrone_imu_ros2_db3.db3"])
def test_real_bag_reads_as_rosbags_reads_it(inside):
    path = real(f"imu_tools/ardrone_imu_ros2_db3{inside}")
    with Reader(path) as reader:
        theirs = [Row(c.topic, t, t, bytes(data)) for c, t, data in reader.messages()]
    with open_log(path) as log:
        assert sorted(read_back(log)) == sorted(theirs)
        for channel in log.channels.values():
            assert channel.definition(path).types


def test_a_ros1_bag_and_its_ros2_conversion_hold_the_same_numbers():
    from sinstool.io.messages.decode import Decoder

    columns = {
        "gyro": [f"angular_velocity.{axis}" for axis in "xyz"],
        "sec": ["header.stamp.sec"],
        "nanosec": ["header.stamp.nanosec"],
    }
    listed = []
    for name in ("imu_tools/ardrone_imu.bag", "imu_tools/ardrone_imu_ros2_db3"):
        path = real(name)
        with open_log(path) as log:
            imu = next(c for c in log.channels.values() if c.type == IMU)
            decoder = Decoder(imu.definition(path), columns)
            parts = [decoder.decode(b.buffer, b.offset, b.length) for b in log.batches([imu.id])]
        assert all(part.valid.all() for part in parts)
        whole = {key: np.concatenate([p.values[key] for p in parts]) for key in columns}
        order = np.lexsort((whole["nanosec"], whole["sec"]))
        listed.append({key: values[order] for key, values in whole.items()})
    for key in columns:
        assert np.array_equal(listed[0][key], listed[1][key])
