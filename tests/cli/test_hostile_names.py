"""Names that a log or a file system brings along command no terminal, forge no line, end no run."""

import os
import sqlite3
import subprocess
import sys
import unicodedata

import pytest
from mcap.reader import make_reader

from sinstool.cli.main import _StandardOutput
from tests.helpers.imulogs import even_times, imu_messages, resting, serialised, write_log
from tests.helpers.logs import Row, rows, write_db3
from tests.helpers.paths import PROGRAM, ROOT

# Clears a screen, sets a title, rings, begins a line of its own, turns the direction of text
EVIL = "/imu\x1b[2J\x1b]0;owned\x07\r\nsinstool: done\u202egnp"
FRAME = "imu\x1b[31m\nsinstool: forged\u2066"


def run(*arguments, **environment):
    command = [*PROGRAM, *map(os.fsencode, map(str, arguments))]
    return subprocess.run(command, capture_output=True, env=os.environ | environment, cwd=ROOT)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    messages = rest(topic=EVIL, frame=FRAME)
    return write_log(tmp_path_factory.mktemp("names") / "evil.mcap", messages)


def rest(**options):
    """Imu messages of a sensor at rest for five seconds."""
    return imu_messages(even_times(500, 100.0), *resting(500), **options)


def is_clean(text):
    lines = text.split("\n")
    assert not any(line.lstrip().startswith("sinstool: ") for line in lines), text
    hidden = [c for c in text if unicodedata.category(c) in ("Cc", "Cf", "Cs") and c != "\n"]
    assert not hidden, (hidden, text)
    return True


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [
        ("info",),
        ("process",),
        ("align", "-v"),
        ("compare-coning", "-v", "--gyro-kind", "mean-rate"),
    ],
    ids=lambda command: command[0],
)
def test_no_name_of_a_log_reaches_the_terminal_raw(log, tmp_path, command):
    name, *options = command
    if name == "process":
        options = ["-v", "-o", tmp_path / "out.mcap", "--report", tmp_path / "page.html"]
    done = run(name, log, *options)
    assert done.returncode in (0, 3), done.stderr
    assert is_clean(done.stdout.decode())
    assert is_clean(done.stderr.decode())
    assert "owned" in done.stdout.decode()
    if name == "process":
        assert_page_and_copy(tmp_path, log)


def assert_page_and_copy(folder, log):
    page = (folder / "page.html").read_text("utf-8")
    assert "owned" in page
    assert not set("\x07\x1b\u202e\u2066") & set(page)
    with (folder / "out.mcap").open("rb") as stream, log.open("rb") as source:
        copied = {c.topic for c in make_reader(stream).get_summary().channels.values()}
        there = {c.topic for c in make_reader(source).get_summary().channels.values()}
    assert there <= copied  # byte for byte


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1", "ascii"])
def test_completion_offers_names_without_what_a_terminal_obeys(log, encoding):
    code = "import sys; sys.argv = ['sinstool']; from sinstool.cli.main import main; main()"
    asked = {
        "_SINSTOOL_COMPLETE": "bash_complete",
        "COMP_WORDS": f"sinstool process {log} --imu-topic /i",
        "COMP_CWORD": "4",
        "PYTHONIOENCODING": encoding,
    }
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, env=os.environ | asked, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    text = done.stdout.decode()
    assert "owned" in text and is_clean(text)


@pytest.mark.parametrize(
    ("encoding", "shown"),
    [("latin-1", b"\\u6e2c"), ("cp1252", b"\\u6e2c"), ("ascii", "\u6e2c".encode())],
)
def test_an_encoding_that_lacks_characters_ends_nothing(tmp_path, encoding, shown):
    path = write_db3(tmp_path / "a.db3", rows(), 3)
    with sqlite3.connect(path) as database:
        database.execute("UPDATE topics SET name = '/größe\u6e2c' WHERE name = '/baro'")
    database.close()
    done = run("info", path, PYTHONIOENCODING=encoding)
    assert done.returncode == 0, done.stderr
    assert shown in done.stdout


def test_standard_output_keeps_lines_and_tabs():
    class Stream:
        written = ""
        encoding = "latin-1"

        def reconfigure(self, encoding, errors):
            assert (encoding, errors) == ("latin-1", "backslashreplace")

        def write(self, text):
            self.written += text

    stream = Stream()
    assert _StandardOutput(stream).write("a\tb\nc\x1b[0m\rd\x9b") == 12
    assert stream.written == "a\tb\nc\ufffd[0m\ufffdd\ufffd"


@pytest.mark.skipif(sys.platform != "linux", reason="file names are text there")
def test_file_names_that_are_not_utf8(log, tmp_path):
    folder = os.fsencode(tmp_path)
    path = folder + b"/bad\xff\xfe.mcap"
    os.link(log, path)
    out, page = folder + b"/out\xff.mcap", folder + b"/page\xff.html"
    command = [*PROGRAM, "process", path, "-o", out, "--report", page]
    done = subprocess.run(command, capture_output=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert b"bad\xef\xbf\xbd\xef\xbf\xbd.mcap" in done.stdout
    with open(out, "rb") as stream:
        (record,) = [m for m in make_reader(stream).iter_metadata() if "input_name" in m.metadata]
    assert record.metadata["input_name"] == "bad??.mcap"
    with open(page, "rb") as stream:
        assert b"bad\xef\xbf\xbd" in stream.read()


def test_a_type_without_a_stored_definition_is_processed_and_said(sinstool, tmp_path):
    content = [
        Row(m.topic, m.log_ns, m.log_ns, serialised(m.message, m.type_name, 2)) for m in rest()
    ]
    content += [row for row in rows(30) if row.topic == "/baro"]
    path = write_db3(tmp_path / "a.db3", content, 3)
    with sqlite3.connect(path) as database:
        database.execute("UPDATE topics SET type = 'my_msgs/msg/Foo' WHERE name = '/baro'")
    database.close()
    status, _, err = sinstool("process", path, "-o", tmp_path / "out.mcap", "--mode", "attitude")
    assert status == 0, err
    assert "no definition of my_msgs/msg/Foo" in err
    with (tmp_path / "out.mcap").open("rb") as stream:
        copied = [m.data for _, _, m in make_reader(stream).iter_messages(topics=["/baro"])]
    assert copied == [row.payload for row in content if row.topic == "/baro"]


@pytest.mark.skipif(sys.platform != "linux", reason="file names are text there")
def test_a_folder_with_a_log_whose_name_is_not_utf8(log, tmp_path):
    logs, results = tmp_path / "logs", tmp_path / "results"
    logs.mkdir()
    os.link(log, os.fsencode(logs) + b"/bad\xff.mcap")
    os.link(log, logs / "good.mcap")
    done = run("process", logs, "-o", results, "--report", results, "-j", 1)
    assert done.returncode == 0, done.stderr
    assert is_clean(done.stdout.decode())
    page = (results / "index.html").read_text("utf-8")
    assert 'href="bad%FF.html"' in page
    assert (results / "summary.csv").read_text("utf-8").count("\n") == 3
