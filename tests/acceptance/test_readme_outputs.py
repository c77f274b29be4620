"""Every MCAP that a command of the README writes opens in every client, with the same counts."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from sinstool.cli.simulate import command
from tests.acceptance import clients
from tests.docs import examples as docs

pytestmark = pytest.mark.slow

README = docs.ROOT / "README.md"
BLOCKS = [e for e in docs.examples(README) if not e.needs and "sinstool process" in e.text]
# Scenarios of `simulate`, and options that make each short
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
# Modes of `process` that the README names
PROCESSED = [
    f"{DRIVE} && sinstool process LOG -o OUT.mcap --mode ins --height-damping baro",
    f"{DRIVE} && sinstool process LOG -o OUT.mcap {EVERYTHING}",
    f"{DRIVE} && sinstool process LOG -o OUT.mcap {EVERYTHING} --smooth --only-results"
    " --world ned --compression lz4",
    f"{DRIVE} && sinstool process LOG -o OUT.mcap --mode attitude --compression none",
]


SIMULATED = [f"sinstool simulate {name} -o LOG {more}" for name, more in SHORT.items()]
COMMANDS = [*PROCESSED, *SIMULATED]


def test_every_scenario_is_here():
    assert set(command.commands) == set(SHORT)


def test_the_readme_has_blocks_that_write():
    assert len(BLOCKS) >= 3


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


def run(text, folder):
    """MCAP files that commands write, in a folder that has what the README's reader has."""
    docs.scratch(folder)
    before = set(folder.rglob("*.mcap"))
    text = text.replace("LOG", "log.mcap").replace("OUT.mcap", "out.mcap")
    status, _, err = docs.run(docs.Example(README, 0, text), folder)
    assert status in (0, 3), err
    made = sorted(set(folder.rglob("*.mcap")) - before)
    assert made
    return made


def short(text):
    return text.split("&& ")[-1].removeprefix("sinstool ")[:60]


@pytest.fixture(
    scope="module",
    params=[*(b.script for b in BLOCKS), *COMMANDS],
    ids=[*(f"block {k}" for k in range(len(BLOCKS))), *map(short, COMMANDS)],
)
def written(request, tmp_path_factory):
    """The files that a command wrote."""
    return run(request.param, tmp_path_factory.mktemp("readme"))


def test_python_clients(written, home):
    for path in written:
        assert clients.check_everywhere(path, home).total() > 0


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
