"""Every MCAP that a command of the README writes opens in every client, with the same counts."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.acceptance import clients
from tests.docs import examples as found

README = found.ROOT / "README.md"
BLOCKS = [e for e in found.examples(README) if not e.needs]
# What stands in the table of commands for any log, and options that make the command short; a
# scenario that is not here has no output that was looked at.
SHORT = {
    "coning": "--duration 5 --rate 200",
    "coning-paper": "--duration 2",
    "two-frequency": "--duration 5 --rate 200",
    "broadband": "--duration 5 --rate 200",
    "manoeuvre": "--duration 5 --rate 200",
    "hse-rig": "--rates 90,120 --plateau 8 --rate 100 --encoder-rate 50",
    "spiral-climb": "--duration 60 --rate 50",
    "manoeuvring-flight": "--duration 60 --rate 50",
    "drive": "--duration 40 --still 15 --rate 50",
    "launch": "--duration 20 --rate 50",
    "static": "--duration 20 --rate 50",
}
DRIVE = "sinstool simulate drive -o LOG --duration 60 --still 20 --rate 50 --grade mems"
EVERYTHING = "--emit imu,attitude,euler,odometry,pose,fix,tf,height,diagnostics"
# More of `process`, which the table has in two lines
MORE = [
    f"{DRIVE} && sinstool process LOG -o OUT.mcap {EVERYTHING}",
    f"{DRIVE} && sinstool process LOG -o OUT.mcap {EVERYTHING} --smooth --only-results"
    " --world ned --compression lz4",
    f"{DRIVE} && sinstool process LOG -o OUT.mcap --mode attitude --compression none",
]


def of_the_table():
    """Commands of the README's table that write an MCAP, each with a log to work on."""
    rows = re.findall(r"^\| `(sinstool [^`]*)` \|", README.read_text(), re.MULTILINE)
    wanted = []
    for row in rows:
        if row.startswith("sinstool simulate "):
            for name in re.search(r"simulate (\S+)", row)[1].replace("\\|", "|").split("|"):
                wanted.append(f"sinstool simulate {name} -o LOG {SHORT[name]}")
        elif "OUT.mcap" in row:
            wanted.append(f"{DRIVE} && {row}")
    assert len(wanted) > 10
    return wanted


COMMANDS = [*of_the_table(), *MORE]


@pytest.fixture
def home(tmp_path):
    folder = tmp_path / "home"
    folder.mkdir()
    return folder


def in_node(packages, paths):
    """What @mcap/core finds, by index and as a stream."""
    script = shutil.copy(Path(__file__).with_name("read_all.mjs"), packages)
    command = ["node", "--single-threaded", script, *paths]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def run(command, folder):
    """MCAP files that a command writes, in a folder that has what the README's reader has."""
    found.scratch(folder)
    before = set(folder.rglob("*.mcap"))
    command = command.replace("LOG", "log.mcap").replace("OUT.mcap", "out.mcap")
    status, _, err = found.run(found.Example(README, 0, command), folder)
    assert status in (0, 3), err
    made = sorted(set(folder.rglob("*.mcap")) - before)
    assert made
    return made


def short(command):
    return command.split("&& ")[-1].removeprefix("sinstool ")[:60]


@pytest.fixture(
    scope="module",
    params=[*(b.text for b in BLOCKS), *COMMANDS],
    ids=[*(f"block {k}" for k in range(len(BLOCKS))), *map(short, COMMANDS)],
)
def written(request, tmp_path_factory):
    """The files that a command wrote."""
    text = found.INSTALL.sub("", request.param).replace(".venv/bin/", "")
    return run(text, tmp_path_factory.mktemp("readme"))


def test_python_clients(written, home):
    for path in written:
        counts = clients.check_everywhere(path, home)
        assert counts.total() > 0


def test_mcap_core(written, npm_packages):
    for path, said in zip(written, in_node(npm_packages, written), strict=True):
        expected = +clients.declared(path)[0]
        total = expected.total()
        assert said["indexed"] == {"counts": expected, "ascending": True, "declared": total}
        assert said["streamed"] == {"counts": expected, "headers": 1, "done": True}


def test_rerun(written, home):
    for path in written:
        assert clients.by_rerun(path, home) == set(+clients.declared(path)[0])


def test_evo(written, home):
    for path in written:
        for topic, count in clients.poses(path).items():
            assert clients.by_evo(path, topic, home) == count
