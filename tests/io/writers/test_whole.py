"""Output appears whole or not at all, and an input is never touched."""

import errno
import os
from pathlib import Path

import pytest
from mcap.reader import make_reader

from sinstool.config import OutputOptions, ProcessConfig
from sinstool.core.errors import OutputError
from sinstool.core.whole_file import WholeFile, check_output
from sinstool.io.writers.mcap import McapWriter
from sinstool.methods.strapdown.attitude import AttitudeRun
from sinstool.pipelines.process.run import process
from tests.helpers.imulogs import even_times, imu_log, resting

OVERWRITE = ProcessConfig(output=OutputOptions(overwrite=True))


@pytest.fixture
def log(tmp_path):
    folder = tmp_path / "in"
    folder.mkdir()
    return imu_log(folder / "log.mcap", even_times(2000), *resting(2000))


@pytest.fixture
def out(tmp_path):
    """A name in a folder of its own, so that whatever is left behind is seen."""
    folder = tmp_path / "out"
    folder.mkdir()
    return folder / "out.mcap"


def names(path):
    return sorted(p.name for p in path.parent.iterdir())


def test_a_file_appears_when_it_is_complete(out):
    with WholeFile(out) as whole:
        whole.stream.write(b"whole")
        assert not out.exists()
    assert out.read_bytes() == b"whole"
    assert names(out) == ["out.mcap"]
    mask = os.umask(0)
    os.umask(mask)
    assert out.stat().st_mode & 0o777 == 0o666 & ~mask


@pytest.mark.parametrize("old", [None, b"old"])
@pytest.mark.parametrize("kind", [ValueError, KeyboardInterrupt, SystemExit])
def test_nothing_appears_when_something_fails(out, old, kind):
    if old:
        out.write_bytes(old)
    with pytest.raises(kind), WholeFile(out) as whole:
        whole.stream.write(bytes(3 * 2**20))
        raise kind
    assert names(out) == (["out.mcap"] if old else [])
    if old:
        assert out.read_bytes() == old


def test_a_full_disk_is_said_in_one_line(out):
    with (
        pytest.raises(OutputError, match=r"writing .*out\.mcap failed: No space left"),
        WholeFile(out),
    ):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert names(out) == []


@pytest.mark.parametrize("step", ["fsync", "replace"])
def test_a_failure_at_the_very_end_leaves_nothing(out, monkeypatch, step):
    def fail(*_):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, step, fail)
    with pytest.raises(OutputError, match="failed: Input/output error"), WholeFile(out) as whole:
        whole.stream.write(b"x")
    assert names(out) == []


def failing(after, error):
    """`AttitudeRun.run` that breaks off in the middle."""
    run = AttitudeRun.run

    def broken(self, blocks):
        for number, solution in enumerate(run(self, blocks)):
            if number == after:
                raise error
            yield solution

    return broken


@pytest.mark.parametrize("after", [0, 1])
@pytest.mark.parametrize("error", [RuntimeError("x"), KeyboardInterrupt(), MemoryError()])
def test_process_that_breaks_off_leaves_nothing(log, out, monkeypatch, after, error):
    before = log.read_bytes()
    monkeypatch.setattr(AttitudeRun, "run", failing(after, error))
    with pytest.raises(type(error)):
        process(log, out, ProcessConfig())
    assert names(out) == []
    assert log.read_bytes() == before
    monkeypatch.undo()
    process(log, out, ProcessConfig())
    assert names(out) == ["out.mcap"]


def test_process_on_a_full_disk_leaves_nothing(log, out, monkeypatch):
    def full(self, data):
        if self._position > 10_000:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._stream.write(data)
        self._position += len(data)

    monkeypatch.setattr(McapWriter, "_write", full)
    with pytest.raises(OutputError, match="No space left"):
        process(log, out, ProcessConfig())
    assert names(out) == []


def test_an_output_that_exists_stays(log, out):
    out.write_bytes(b"precious")
    with pytest.raises(OutputError, match="exists already"):
        process(log, out, ProcessConfig())
    assert out.read_bytes() == b"precious"
    assert names(out) == ["out.mcap"]


def test_an_output_is_replaced_when_asked(log, out):
    out.write_bytes(b"old")
    process(log, out, OVERWRITE)
    with out.open("rb") as stream:
        assert make_reader(stream).get_summary().statistics.message_count > 3 * 2000
    assert names(out) == ["out.mcap"]


def test_an_output_is_not_replaced_by_half_of_a_new_one(log, out, monkeypatch):
    out.write_bytes(b"old")
    monkeypatch.setattr(AttitudeRun, "run", failing(1, RuntimeError()))
    with pytest.raises(RuntimeError):
        process(log, out, OVERWRITE)
    assert out.read_bytes() == b"old"
    assert names(out) == ["out.mcap"]


def itself(log, out):
    return log


def dotted(log, out):
    return log.parent / ".." / log.parent.name / log.name


def symlink(log, out):
    out.symlink_to(log)
    return out


def link_to_link(log, out):
    first = out.with_name("first")
    first.symlink_to(log)
    out.symlink_to(first)
    return out


def hardlink(log, out):
    out.hardlink_to(log)
    return out


def linked_folder(log, out):
    folder = out.with_name("folder")
    folder.symlink_to(log.parent)
    return folder / log.name


@pytest.mark.parametrize("config", [ProcessConfig(), OVERWRITE], ids=["", "overwrite"])
@pytest.mark.parametrize(
    "name",
    [itself, dotted, symlink, link_to_link, hardlink, linked_folder],
    ids=lambda f: f.__name__,
)
def test_the_input_is_no_output(log, out, name, config):
    before = log.read_bytes()
    target = name(log, out)
    listed = names(out)
    with pytest.raises(OutputError, match="is the input itself"):
        process(log, target, config)
    assert log.read_bytes() == before
    assert names(log) == ["log.mcap"]
    assert names(out) == listed


@pytest.mark.parametrize("name", ["bag_0.db3", "new.mcap", "below/new.mcap"])
def test_the_folder_of_a_bag_takes_no_output(tmp_path, name):
    folder = tmp_path / "bag"
    (folder / "below").mkdir(parents=True)
    (folder / "bag_0.db3").write_bytes(b"")
    with pytest.raises(OutputError, match="in the input's own folder"):
        check_output(folder / name, [folder], overwrite=True)


def test_a_folder_is_no_output(log, out):
    with pytest.raises(OutputError, match="is a folder"):
        process(log, out.parent, OVERWRITE)


@pytest.mark.parametrize("parent", ["missing", "out.mcap"])
def test_the_folder_must_be_there(log, out, parent):
    if parent == out.name:
        out.write_bytes(b"a file")
    with pytest.raises(OutputError, match="does not exist"):
        process(log, out.parent / parent / "x.mcap", ProcessConfig())


def unwritable():
    """A folder that refuses files even to root, to whom permissions mean nothing."""
    folder = Path("/proc/self")
    if not folder.is_dir():
        pytest.skip("no /proc here, and permissions do not stop root")
    return folder


def test_a_folder_that_cannot_be_written_to(log):
    with pytest.raises(OutputError, match=r"cannot (be written to|write in)"):
        process(log, unwritable() / "out.mcap", ProcessConfig())


def test_a_name_as_long_as_names_can_be(out):
    name = out.with_name("x" * 250 + ".mcap")
    with WholeFile(name) as whole:
        whole.stream.write(b"whole")
    assert name.read_bytes() == b"whole"


def test_a_name_too_long_for_the_file_system(log, out):
    with pytest.raises(OutputError, match=r"[Nn]ame too long"):
        process(log, out.with_name("x" * 251 + ".mcap"), ProcessConfig())
    assert names(out) == []
