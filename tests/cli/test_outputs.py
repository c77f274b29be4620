"""Outputs of commands: whole or not at all, whatever happens to the process, the disk, the folder.

`python benchmarks/killed_runs.py` kills far more often than the test here.
"""

import functools
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from importlib import import_module
from pathlib import Path

import pytest

from benchmarks import killed_runs
from sinstool.core import whole_file as whole
from tests.helpers.one_line import last_words
from tests.helpers.paths import PROGRAM, ROOT

SAMPLES = ROOT / "sample_data"
# Root writes anywhere, unless it gives that right away.
RIGHTS = "-dac_override,-dac_read_search"
UNPRIVILEGED = (
    ["setpriv", "--bounding-set", RIGHTS, "--inh-caps", RIGHTS] if os.geteuid() == 0 else []
)
REST = SAMPLES / "static.mcap"
CONING = SAMPLES / "coning.mcap"
RIG = ("--config", SAMPLES / "hse" / "rig-a.toml")
TURNS = [SAMPLES / "hse" / f"a-{n}.mcap" for n in ("020", "110")]


def run(*arguments, **options):
    command = [*PROGRAM, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, **options)


@functools.cache
def result():
    """A result to export, in a folder that goes at the end."""
    folder = tempfile.TemporaryDirectory()
    path = Path(folder.name) / "result.mcap"
    assert run("process", REST, "-o", path, "--mode", "attitude", "-q").returncode == 0
    return folder, path


# Arguments for a folder to write to, and the names that appear there
COMMANDS = {
    "process": lambda f: (("process", CONING, "-o", f / "out.mcap"), ["out.mcap"]),
    "process --report": lambda f: (
        ("process", CONING, "-o", f / "out.mcap", "--report", f / "page.html"),
        ["out.mcap", "page.html"],
    ),
    "simulate": lambda f: (
        ("simulate", "static", "-o", f / "out.mcap", "--duration", 30),
        ["out.mcap"],
    ),
    "simulate hse-rig": lambda f: (
        (
            *("simulate", "hse-rig", "-o", f / "out.mcap", "--rig-out", f / "rig.toml"),
            *("--rates", "90,120", "--plateau", 10, "--rate", 100, "--encoder-rate", 50),
        ),
        ["out.mcap", "rig.toml"],
    ),
    "calibrate-hse": lambda f: (
        (
            *("calibrate-hse", *TURNS, *RIG, "-o", f / "hse.json", "--csv", f / "runs.csv"),
            *("--emit-config", f / "rig.toml", "--report", f / "page.html"),
        ),
        ["hse.json", "page.html", "rig.toml", "runs.csv"],
    ),
    "compare-coning": lambda f: (
        (
            *("compare-coning", CONING, "--csv", f / "tables", "--report", f / "page.html"),
            *("--gyro-kind", "mean-rate", "--algorithms", "optimal-2,optimal-3", "--window", 2),
        ),
        ["page.html", "tables", "tables/algorithms.csv", "tables/pairs.csv"],
    ),
    "align": lambda f: (
        ("align", REST, "--method", "level", "--report", f / "page.html"),
        ["page.html"],
    ),
    "align figure": lambda f: (
        ("align", REST, "--method", "level", "--report", f / "figure.png"),
        ["figure.png"],
    ),
    "export": lambda f: (("export", result()[1], "-o", f / "table.csv"), ["table.csv"]),
    "export parquet": lambda f: (
        ("export", result()[1], "-o", f / "table.parquet"),
        ["table.parquet"],
    ),
}


def names(folder):
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*"))


@pytest.fixture(params=COMMANDS)
def command(request):
    return COMMANDS[request.param]


# -- full disks ----------------------------------------------------------------------------------


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 5 MB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=5m", "tmpfs", str(folder)]
    if os.name != "posix" or shutil.which("mount") is None:
        pytest.skip("no file system can be mounted here")
    done = subprocess.run(mount, capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"mounting needs more rights: {done.stderr.strip()}")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


# Of 5 MB; a page has 0.5 MB and more
ROOM = {
    "process": 100_000,
    "process --report": 300_000,
    "simulate": 100_000,
    "simulate hse-rig": 100_000,
    "calibrate-hse": 300_000,
    "compare-coning": 300_000,
    "align": 300_000,
    "align figure": 8192,
    "export": 100_000,
    "export parquet": 100_000,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_a_full_disk_takes_one_line_and_leaves_nothing(small_disk, name):
    arguments, _ = COMMANDS[name](small_disk)
    filler = small_disk / "filler"
    filler.write_bytes(bytes(5 * 2**20 - ROOM[name]))
    done = run(*arguments)
    message = last_words(done.stderr)
    assert done.returncode == 1
    assert message.startswith("sinstool: ")
    assert message.endswith(
        ("No space left on device", "No space left on device; nothing was written")
    )
    assert names(small_disk) == ["filler"]
    assert done.stdout == ""


def test_a_disk_that_is_large_enough(small_disk):
    arguments, expected = COMMANDS["process"](small_disk)
    assert run(*arguments).returncode == 0
    assert names(small_disk) == expected


def small_files():
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="no limit on the size of files here")
@pytest.mark.parametrize("name", ["process", "simulate", "compare-coning"])
def test_files_that_may_not_grow(tmp_path, name):
    """As a full disk, without the rights to make one."""
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir()
    second.mkdir()
    # compiled loops keep files of their own, which this run makes, where they are not there yet
    assert run(*COMMANDS[name](first)[0]).returncode == 0
    done = run(*COMMANDS[name](second)[0], preexec_fn=small_files)
    assert done.returncode == 1
    assert last_words(done.stderr).endswith("failed: File too large")
    assert names(second) == []


def test_a_full_standard_output(tmp_path):
    out = tmp_path / "out.mcap"
    expected = f"standard output: No space left on device; {out} was complete by then"
    assert full_output("process", CONING, "-o", out) == f"sinstool: {expected}"
    assert names(tmp_path) == ["out.mcap"]


def full_output(*arguments):
    """The line that a command ends with when its own words find no room."""
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [*PROGRAM, *map(str, arguments)], stdout=full, stderr=subprocess.PIPE, text=True
        )
    assert done.returncode == 1
    return last_words(done.stderr)


@pytest.mark.slow
def test_a_full_standard_output_of_many_logs(tmp_path):
    """What workers have completed counts too."""
    logs, out = tmp_path / "in", tmp_path / "out"
    logs.mkdir()
    for name in ("a", "b"):
        shutil.copy(CONING, logs / f"{name}.mcap")
    said = "sinstool: standard output: No space left on device"
    message = full_output("process", logs, "-o", out, "-j", 1)
    assert message == f"{said}; 4 files were complete by then"
    # nothing but the table of all logs is made a second time
    message = full_output("process", logs, "-o", out, "-j", 1)
    assert message == f"{said}; {out}/index.html, {out}/summary.csv were complete by then"
    assert names(out) == ["a.mcap", "b.mcap", "index.html", "summary.csv"]
    # where there are many they are counted
    many = ("simulate", "static", "--duration", 1, "-o", tmp_path / "mc", "--monte-carlo", 5)
    assert full_output(*many, "-j", 1) == f"{said}; 5 files were complete by then"
    assert len(names(tmp_path / "mc")) == 5


# -- a reader of our words that goes away ---------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", ["process", "compare-coning", "calibrate-hse"])
def test_a_closed_pipe_costs_no_output(tmp_path, name):
    arguments, expected = COMMANDS[name](tmp_path)
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [*PROGRAM, *map(str, arguments)], stdout=writer, stderr=subprocess.PIPE, text=True
    )
    os.close(writer)
    assert "Traceback" not in done.stderr and "sinstool:" not in done.stderr
    assert done.returncode in (0, 3)
    assert names(tmp_path) == expected


@pytest.mark.parametrize("arguments", [("info", CONING), ("--help",)], ids=["info", "help"])
def test_a_closed_pipe_is_no_failure(arguments):
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [*PROGRAM, *map(str, arguments)], stdout=writer, stderr=subprocess.PIPE, text=True
    )
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, "")


def closing(*numbers):
    """What closes standard streams in a process, as a shell does by `>&-`."""
    return lambda: [os.close(number) for number in numbers]


@pytest.mark.skipif(os.name != "posix", reason="descriptors are closed as a shell does it")
@pytest.mark.parametrize("closed", [(1,), (2,), (0, 1, 2)], ids=str)
def test_closed_standard_streams_cost_no_output(tmp_path, closed):
    out = tmp_path / "out.mcap"
    command = [*PROGRAM, "process", str(CONING), "-o", str(out)]
    done = subprocess.run(command, preexec_fn=closing(*closed), capture_output=True, text=True)
    assert done.returncode == 0 and "Traceback" not in done.stderr
    assert names(tmp_path) == ["out.mcap"]
    command = [*PROGRAM, "info", str(tmp_path / "none.mcap")]
    done = subprocess.run(command, preexec_fn=closing(*closed), capture_output=True, text=True)
    assert done.returncode == 1 and "Traceback" not in done.stderr


@pytest.mark.parametrize("other", ["closed pipe", "read only"])
def test_messages_that_find_no_room_cost_no_output(tmp_path, other):
    """A pipe of both streams to `head`, and a file that takes none, as on a full disk."""
    reader, writer = os.pipe()
    os.close(reader)
    stream = os.open(CONING, os.O_RDONLY) if other == "read only" else writer
    command = [*PROGRAM, "process", str(CONING), "-o", str(tmp_path / "out.mcap")]
    done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=stream)
    assert done.returncode == 0
    assert names(tmp_path) == ["out.mcap"]
    done = subprocess.run([*PROGRAM, "info", "none.mcap"], stderr=stream, cwd=tmp_path)
    assert done.returncode == 1
    for one in {stream, writer}:
        os.close(one)


# -- what is asked for is written together --------------------------------------------------------


@pytest.mark.slow
def test_everything_appears(tmp_path, command):
    arguments, expected = command(tmp_path)
    done = run(*arguments)
    assert done.returncode in (0, 3), done.stderr
    assert names(tmp_path) == expected


def test_without_its_report_there_is_no_output(tmp_path):
    """The folder of the report takes no file any more when the log has been processed."""
    pages = tmp_path / "pages"
    pages.mkdir()
    code = (
        "import os, sys, sinstool.report.pages.process as report\n"
        "write = report.write_page\n"
        f"report.write_page = lambda *a: (os.rmdir({str(pages)!r}), write(*a))\n"
        "from sinstool.cli.main import main\n"
        "main()\n"
    )
    arguments = ("process", CONING, "-o", tmp_path / "out.mcap", "--report", pages / "page.html")
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)], capture_output=True, text=True
    )
    assert done.returncode == 1
    assert f"the folder {pages} does not exist" in last_words(done.stderr)
    assert names(tmp_path) == []


def test_the_folder_that_vanishes_meanwhile(tmp_path):
    folder = tmp_path / "gone"
    folder.mkdir()
    with pytest.raises(whole.OutputError, match=r"writing .*out\.mcap failed: No such file"):  # noqa: SIM117
        with whole.WholeFile(folder / "out.mcap") as file:
            file.stream.write(b"x")
            shutil.rmtree(folder)
    assert names(tmp_path) == []


def test_of_two_files_of_one_name_there_is_none(tmp_path):
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "a")
    with pytest.raises(whole.OutputError, match="named twice"), whole.commit_together():
        for path in (tmp_path / "a", link):
            with whole.WholeFile(path) as file:
                file.stream.write(b"x")
    assert names(tmp_path) == ["link"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_together_or_not_at_all(tmp_path, error):
    (tmp_path / "kept").write_bytes(b"old")
    with pytest.raises(error), whole.commit_together():
        whole.make_folder(tmp_path / "new" / "below")
        for path in (tmp_path / "kept", tmp_path / "new" / "below" / "a"):
            with whole.WholeFile(path) as file:
                file.stream.write(b"new")
        assert (tmp_path / "kept").read_bytes() == b"old"
        raise error
    assert names(tmp_path) == ["kept"]
    assert (tmp_path / "kept").read_bytes() == b"old"


# -- places ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_link_stays_one_and_what_it_leads_to_is_written(tmp_path):
    (tmp_path / "disk").mkdir()
    out, real = tmp_path / "out.mcap", tmp_path / "disk" / "real.mcap"
    out.symlink_to(real)
    assert run("process", CONING, "-o", out).returncode == 0
    assert out.is_symlink() and real.stat().st_size > 1000
    refused = run("process", CONING, "-o", out)
    assert refused.returncode == 1 and "exists already" in last_words(refused.stderr)
    assert run("process", CONING, "-o", out, "--overwrite").returncode == 0
    assert names(tmp_path) == ["disk", "disk/real.mcap", "out.mcap"]
    assert out.is_symlink()


def test_a_device_is_no_output():
    done = run("process", CONING, "-o", "/dev/null", "--overwrite")
    assert done.returncode == 1
    assert "is a device or a pipe" in last_words(done.stderr)
    assert not Path("/dev/null").is_file()


@pytest.mark.slow
def test_a_folder_that_may_only_be_read(small_disk):
    remount = ["mount", "-o", "remount,ro", str(small_disk)]
    subprocess.run(remount, check=True)
    for arguments, _ in (make(small_disk) for make in COMMANDS.values()):
        done = run(*arguments)
        assert done.returncode == 1
        message = last_words(done.stderr)
        assert "cannot be written to" in message or "Read-only file system" in message
    assert names(small_disk) == []


@pytest.mark.slow
def test_a_folder_without_permission(tmp_path, command):
    arguments, _ = command(tmp_path / "locked")
    (tmp_path / "locked").mkdir(mode=0o555)
    done = subprocess.run(
        [*UNPRIVILEGED, *PROGRAM, *map(str, arguments)], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 1
    assert "cannot be written to" in last_words(done.stderr)
    assert names(tmp_path / "locked") == []


@pytest.mark.slow
@pytest.mark.parametrize("length", [255, 256, 5000])
def test_long_names(tmp_path, length):
    out = tmp_path / ("x" * (length - 5) + ".mcap")
    done = run("process", CONING, "-o", out)
    if length > 255:
        assert done.returncode == 1
        assert last_words(done.stderr).endswith("File name too long: choose another -o")
    assert [p.name for p in tmp_path.iterdir()] == ([out.name] if length <= 255 else [])


def test_a_log_is_not_overwritten_by_its_report(tmp_path):
    log = tmp_path / "log.html"
    shutil.copy(CONING, log)
    link = tmp_path / "link.html"
    link.hardlink_to(log)
    for arguments in (
        ("process", log, "-o", tmp_path / "o.mcap"),
        ("align", log, "--method", "level"),
    ):
        done = run(*arguments, "--report", link, "--overwrite")
        assert done.returncode == 1
        assert "is the input itself" in last_words(done.stderr)
    assert log.read_bytes() == CONING.read_bytes()


# -- signals --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def writing(tmp_path_factory):
    """Commands that take a while to write."""
    return killed_runs.commands(tmp_path_factory.mktemp("writing"), 60)


@pytest.mark.slow
def test_killed_without_warning(writing):
    for command in writing:
        tally = killed_runs.kill_at_random(command, 3, random.Random(7))
        assert tally.faults == []
        for path in command.targets:
            path.unlink()


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("twice", [False, True], ids=["once", "twice"])
def test_ended_by_a_signal(writing, number, twice):
    command = writing[0]
    run = subprocess.Popen(
        [*PROGRAM, *command.arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    while run.poll() is None and not command.strays():
        time.sleep(0.001)
    run.send_signal(number)
    if twice:
        time.sleep(0.01)
        run.send_signal(number)
    stdout, stderr = run.communicate(timeout=60)
    assert run.returncode == 130, stderr
    assert last_words(stderr) == "sinstool: interrupted; nothing was written"
    assert stdout == ""
    assert names(command.folder) == []


FREEING = """
import os, signal, sys, time
from sinstool.cli import main as module

class Object:
    def __del__(self):
        os.kill(os.getpid(), signal.{name})
        time.sleep(0.001)

def command(**_):
    for _ in range({times}):
        Object()
        {then}
    time.sleep(30)

module.cli.main = command
module.main()
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
@pytest.mark.parametrize("times, then", [(1, ""), (2, "time.sleep(0.03)")], ids=["once", "twice"])
def test_ended_by_a_signal_while_an_object_is_freed(name, times, then):
    """Python swallows what is raised in `__del__`."""
    code = FREEING.format(name=name, times=times, then=then)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 130
    assert done.stderr == "sinstool: interrupted; nothing was written\n"


@pytest.mark.slow
def test_an_ignored_signal_stays_ignored(tmp_path):
    """As `nohup` has it."""
    arguments, expected = COMMANDS["process"](tmp_path)
    run = subprocess.Popen(
        [*PROGRAM, *map(str, arguments)],
        stdout=subprocess.DEVNULL,
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN),
    )
    while run.poll() is None and not names(tmp_path):
        time.sleep(0.001)
    run.send_signal(signal.SIGHUP)
    assert run.wait(timeout=60) == 0
    assert names(tmp_path) == expected


def test_an_interrupt_that_breaks_a_lock_of_python_is_one_all_the_same(monkeypatch, capsys):
    """Where it meets the acquiring of a lock, that fails, and the interrupt is its context."""
    module = import_module("sinstool.cli.main")

    def broken(**_):
        try:
            raise KeyboardInterrupt
        finally:
            raise RuntimeError("release unlocked lock")

    monkeypatch.setattr(module.cli, "main", broken)
    with pytest.raises(SystemExit) as ended:
        module._run([])
    assert ended.value.code == 130
    assert "interrupted; nothing was written" in capsys.readouterr().err
