import os
import shutil
import signal
import sqlite3
import struct
import threading

import numpy as np
import pytest

from sinstool.core.errors import DamagedLogError, NotALogError, SinstoolError
from sinstool.io.readers import lost as lost_module
from sinstool.io.readers import open_log
from sinstool.io.readers import sqlite as sqlite_module
from tests.helpers.logs import (
    IMU,
    TOPICS,
    Row,
    content,
    definition,
    memory_below,
    read_back,
    snapshot,
    write_db3,
)


@pytest.mark.parametrize("version", [1, 2, 3, 4])
def test_every_version_of_the_schema(tmp_path, version):
    path = write_db3(tmp_path / "a.db3", content(), version)
    before = snapshot(tmp_path)
    with open_log(path) as log:
        assert (log.format, log.profile) == ("rosbag2", "ros2")
        assert {c.topic: c.type for c in log.channels.values()} == TOPICS
        assert read_back(log) == content()
        channel = log.channels_of("/imu")[0]
        assert channel.message_encoding == "cdr"
        assert channel.schema_text == (definition(IMU)[0] if version == 4 else "")
        assert channel.definition(path).types
        expected = {"offered_qos_profiles": "- history: 1"} if version > 1 else {}
        expected |= {"type_description_hash": "RIHS01_00"} if version == 4 else {}
        assert channel.metadata == expected
        imu = [r for r in content() if r.topic == "/imu"]
        assert read_back(log, [channel.id]) == imu
        assert read_back(log, []) == []
    assert snapshot(tmp_path) == before


def test_order_is_that_of_insertion(tmp_path):
    mixed = [content()[k] for k in np.random.default_rng(0).permutation(len(content()))]
    with open_log(write_db3(tmp_path / "a.db3", mixed)) as log:
        assert read_back(log) == mixed


def test_batches_are_bounded_in_messages_and_in_bytes(tmp_path, monkeypatch):
    monkeypatch.setattr(sqlite_module, "BATCH", 100)
    with open_log(write_db3(tmp_path / "a.db3", content())) as log:
        sizes = [len(batch) for batch in log.batches()]
        assert max(sizes) == 100
        assert sum(sizes) == len(content())
        assert read_back(log) == content()
        one, two = log.batches(), log.batches([1])
        assert len(next(one)) and len(next(two)) and len(next(one))
    images = [Row("/imu", k, k, bytes([k]) * 3_000_000) for k in range(30)]
    path = write_db3(tmp_path / "b.db3", images)
    del images
    with memory_below(120 * 2**20), open_log(path) as log:
        assert sum(len(batch) for batch in log.batches()) == 30


@pytest.mark.parametrize("shared_memory", [True, False])
def test_rows_that_are_still_in_the_wal_are_read(tmp_path, shared_memory):
    path, database = write_db3(tmp_path / "live.db3", content(), wal=True)
    folder = tmp_path / "copy"
    folder.mkdir()
    for tail in ("", "-wal", "-shm")[: 3 if shared_memory else 2]:
        shutil.copyfile(f"{path}{tail}", folder / f"live.db3{tail}")
    before = snapshot(folder)
    with open_log(folder / "live.db3") as log:
        assert snapshot(folder) == before
        assert read_back(log) == content()
        assert snapshot(folder) == before
    assert snapshot(folder) == before
    with open_log(path) as log:  # while the recorder still runs
        assert read_back(log) == content()
    database.close()
    assert not (tmp_path / "live.db3-wal").exists()
    with open_log(path) as log:
        assert read_back(log) == content()


def test_wal_where_no_lock_file_can_be_made(tmp_path, monkeypatch):
    path, database = write_db3(tmp_path / "live.db3", content(), wal=True)
    folder = tmp_path / "copy"
    folder.mkdir()
    for tail in ("", "-wal"):
        shutil.copyfile(f"{path}{tail}", folder / f"live.db3{tail}")
    database.close()
    plain = sqlite_module._open

    def refuse(file, mode, **options):
        if mode.startswith("mode=ro"):  # as where SQLite has no such way to lock
            raise sqlite3.OperationalError("unable to open database file")
        return plain(file, mode, **options)

    monkeypatch.setattr(sqlite_module, "_open", refuse)
    before = snapshot(folder)
    with open_log(folder / "live.db3") as log:
        beside = log._beside.path
        assert read_back(log) == content()
    assert snapshot(folder) == before
    assert not os.path.exists(beside)


def test_names_that_mean_something_in_an_uri(tmp_path):
    path = write_db3(tmp_path / "a?mode=rw&b#c %41.db3", content(3))
    with open_log(path) as log:
        assert read_back(log) == content(3)


def test_a_damaged_database_says_how_to_recover(tmp_path):
    path = write_db3(tmp_path / "a.db3", content())
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with (
        pytest.raises(DamagedLogError, match=r"sqlite3 '.*a\.db3' \.recover"),
        open_log(path) as log,
    ):
        read_back(log)
    path.write_bytes(data[:100] + bytes(5000))
    with pytest.raises(DamagedLogError, match="recover") as strict:
        open_log(path)
    assert "--salvage" in str(strict.value)
    with pytest.raises(DamagedLogError, match="recover") as salvaging:  # no use to say it again
        open_log(path, salvage=True)
    assert "--salvage" not in str(salvaging.value)


def damage_pages(path, *numbers):
    """Overwrite the heads of the pages that hold these rows, counted from 0."""
    data = bytearray(path.read_bytes())
    for number in numbers:
        at = data.index(content()[number].payload) // 4096 * 4096
        data[at : at + 8] = b"\xa5" * 8
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("row", [0, 250, 399])
def test_salvage_passes_over_a_damaged_page(tmp_path, row):
    path = damage_pages(write_db3(tmp_path / "a.db3", content()), row)
    with open_log(path, salvage=True) as log:
        result = read_back(log)
        (part,) = log.lost
        first, *last = (int(word) for word in str(part).split() if word.isdigit())
        last = last[0] if last else len(content())
        assert first <= row + 1 <= last
        assert last - first < 30
        assert (first == 1) == (row == 0)
        assert result == content()[: first - 1] + content()[last:]
        assert part.start_ns == (content()[first - 2].log_time if first > 1 else None)
        assert part.end_ns == (content()[last].log_time if last < len(content()) else None)


def long_content():
    """Enough for a tree of three levels, with payloads of several pages among the others."""
    rows = content(12_000)
    long = {k: replaced(row, 9_000 + k) for k, row in enumerate(rows) if k % 500 == 20}
    return [long.get(k, row) for k, row in enumerate(rows)]


def replaced(row, size):
    return row._replace(payload=row.payload + bytes(k % 251 for k in range(size)))


@pytest.mark.slow
def test_a_cut_file_keeps_all_rows_before_the_cut(tmp_path):
    """The page that leads to the first rows lies in the part that is missing."""
    rows = long_content()
    data = write_db3(tmp_path / "a.db3", rows).read_bytes()
    number = {row.payload: k for k, row in enumerate(rows)}
    path = tmp_path / "cut.db3"
    for share in (0.2, 0.5, 0.8):
        path.write_bytes(data[: int(share * len(data))])
        with open_log(path, salvage=True) as log:
            result = read_back(log)
            assert result == rows[: len(result)]
            assert abs(len(result) / len(rows) - share) < 0.06
            some = log.channels_of("/imu")
            assert read_back(log, [c.id for c in some]) == [r for r in result if r.topic == "/imu"]
            # said once, whatever was read, and nothing of what was read is said to be lost
            assert [one.kind for one in log.lost] == ["end", "row"]
            said = int(str(log.lost[1]).split()[1])
            assert said <= len(result) + 1
            assert len({number[row.payload] for row in result}) == len(result)


def test_many_damaged_pages(tmp_path, monkeypatch):
    """Each counts once; where they are too many, what is left out is said, come what may."""
    damaged = (30, 90, 150, 210, 270, 330)
    path = damage_pages(write_db3(tmp_path / "a.db3", content()), *damaged)
    monkeypatch.setattr(sqlite_module, "MAX_PLACES", len(damaged) + 1)
    with open_log(path, salvage=True) as log:
        every = read_back(log)
        assert len(log.lost) == len(damaged)
        assert every[-1] == content()[-1]
    monkeypatch.setattr(sqlite_module, "MAX_PLACES", 4)
    monkeypatch.setattr(lost_module, "MAX_PARTS", 2)
    with open_log(path, salvage=True) as log:
        result = read_back(log)
        assert result == every[: len(result)] and len(result) > 150
        *_, answer, more = map(str, log.lost)
        assert len(log.lost) == 2 + 2
        assert answer.startswith("messages after ") and "were not read" in answer
        (behind, *_) = (int(word) for word in answer.split() if word.isdigit())
        assert content()[behind - 1] not in result
        assert content()[behind] not in result and content()[behind] in every
        assert more == "more than the 2 places listed"
        before = len(log.lost)
        read_back(log)
        assert len(log.lost) == before


def test_pages_that_lead_back_again_and_again(tmp_path, monkeypatch):
    """An inner page names one leaf over and over, and then one that cannot be read."""
    path = write_db3(tmp_path / "a.db3", content())
    database = sqlite3.connect(path)
    (root,) = database.execute(
        "SELECT rootpage FROM sqlite_master WHERE name = 'messages'"
    ).fetchone()
    database.close()
    data = bytearray(path.read_bytes())
    page = (root - 1) * 4096
    kind, _, count, _, _, last = struct.unpack_from(">BHHHBI", data, page)
    assert kind == 5  # an inner page: cells with the number of a leaf, and the last behind them
    cells = [page + at for at in struct.unpack_from(f">{count}H", data, page + 12)]
    leaf = data[cells[1] : cells[1] + 4]
    for cell in cells[3:]:
        data[cell : cell + 4] = leaf
    data[(last - 1) * 4096 : (last - 1) * 4096 + 8] = b"\xa5" * 8
    path.write_bytes(data)
    monkeypatch.setattr(sqlite_module, "MAX_PLACES", 20)
    with open_log(path, salvage=True) as log:
        count = 0
        for batch in log.batches():
            count += len(batch)
            assert count < 20_000, "an endless loop"
        assert count and "were not read" in str(log.lost[-1])


@pytest.mark.parametrize(
    ("name", "damaged"),
    [
        (b"messages(id INTEGER", b"messages(i\xe4 INTEGER"),
        (b"timestamp_idx", b"timestamp_\xe4\xf6x"),
    ],
)
def test_damaged_names_that_do_not_matter(tmp_path, name, damaged):
    """Python decodes the names of columns before anything else."""
    path = write_db3(tmp_path / "a.db3", content())
    data = path.read_bytes()
    assert name in data and len(name) == len(damaged)
    path.write_bytes(data.replace(name, damaged))
    with open_log(path) as log:
        assert read_back(log) == content()


def test_errors_of_sqlite_in_no_known_alphabet(tmp_path):
    """Its message quotes a name that is no text, which Python raises of instead."""
    path = write_db3(tmp_path / "a.db3", content())
    data = path.read_bytes()
    whole = b"topic_id INTEGER NOT NULL"
    assert data.count(whole) == 1
    path.write_bytes(data.replace(whole, b"topic_id INT COLLATE \xe4\xe4\xe4\xe4"))
    with pytest.raises(DamagedLogError), open_log(path) as log:
        read_back(log, [1])
    with open_log(path, salvage=True) as log:
        assert read_back(log, [1]) == [] and log.lost


def test_cells_of_any_type(tmp_path):
    path = write_db3(tmp_path / "a.db3", content(30))
    database = sqlite3.connect(path)
    database.execute("UPDATE messages SET data = 'text' WHERE id = 4")
    database.execute("UPDATE messages SET timestamp = 1.5 WHERE id = 5")
    database.execute("UPDATE messages SET topic_id = 77 WHERE id = 6")
    database.commit()
    database.close()
    with open_log(path) as log, pytest.raises(DamagedLogError, match="SQLite cannot read it"):
        read_back(log)
    with open_log(path, salvage=True) as log:
        assert read_back(log) == content(30)[:3] + content(30)[6:]
        assert [str(part).split(":")[0] for part in log.lost] == [
            "message 4",
            "message 5",
            "messages of channel 77, which the log does not define (0 of 1 messages kept)",
        ]


def test_other_databases_are_no_logs(tmp_path):
    path = tmp_path / "a.db3"
    database = sqlite3.connect(path)
    database.execute("CREATE TABLE notes(x)")
    database.commit()
    database.close()
    with pytest.raises(NotALogError, match="not of a ROS 2 bag"):
        open_log(path)


def test_flipped_bytes_give_an_error_of_ours_or_nothing(tmp_path):
    data = write_db3(tmp_path / "a.db3", content(30), 4).read_bytes()
    path = tmp_path / "b.db3"
    rng = np.random.default_rng(0)
    for _ in range(150):
        broken = bytearray(data)
        for at in rng.integers(16, len(data), 4):
            broken[at] = rng.integers(0, 256)
        path.write_bytes(broken)
        for salvage in (False, True):
            try:
                with open_log(path, salvage) as log:
                    read_back(log)
            except SinstoolError as exc:
                assert "\n" not in str(exc)


ENDLESS = """
    CREATE VIEW messages AS
    WITH RECURSIVE more(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM more)
    SELECT id AS rowid, id, 1 AS topic_id, id AS timestamp, x'00' AS data FROM more
"""


@pytest.mark.parametrize("salvage", [False, True])
@pytest.mark.parametrize(
    ("name", "create"),
    [
        ("messages", ENDLESS),
        ("messages", ENDLESS.replace("VIEW messages", "VIEW Messages")),
        ("messages", "CREATE VIRTUAL TABLE messages USING fts5(topic_id, timestamp, data)"),
        ("topics", "CREATE VIEW topics AS SELECT 1 AS id, '/a' AS name, 't/T' AS type"),
    ],
    ids=["view", "case", "virtual", "topics"],
)
def test_tables_that_are_computed_are_refused(tmp_path, name, create, salvage):
    path = write_db3(tmp_path / "a.db3", content())
    with sqlite3.connect(path) as database:
        database.execute(f"DROP TABLE {name}")
        database.execute(create)
    database.close()
    with pytest.raises(NotALogError, match=rf"(?i){name} is a (view|table) that computes its rows"):
        open_log(path, salvage)


@pytest.fixture
def interruptible():
    """SIGINT raises KeyboardInterrupt, whatever runs the tests has made of it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("salvage", [False, True])
def test_a_signal_ends_what_sqlite_does(tmp_path, monkeypatch, salvage):
    """A signal comes while a statement runs that would go on for minutes."""
    monkeypatch.setattr(sqlite_module, "_STEPS", 1000)
    with open_log(write_db3(tmp_path / "a.db3", content()), salvage) as log:
        endless = "WITH RECURSIVE more(n) AS (SELECT 1 UNION ALL SELECT 1 FROM more)"
        query = f"{endless} SELECT count(*) FROM (SELECT n FROM more LIMIT 1000000000)"
        timer = threading.Timer(0.2, signal.raise_signal, (signal.SIGINT,))
        timer.start()
        with pytest.raises(sqlite3.OperationalError, match="interrupted") as info:
            log._database.execute(query).fetchone()
        timer.join()
        with pytest.raises(KeyboardInterrupt):
            raise log._damaged(info.value)
