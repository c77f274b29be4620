"""Shell completion: scripts that the shells take, and what is offered where."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from sinstool.cli.main import COMMANDS, cli
from tests.helpers.paths import ROOT

SAMPLE = ROOT / "sample_data" / "coning.mcap"
SHELLS = ("bash", "zsh", "fish")


def script(shell):
    done = CliRunner().invoke(cli, ["completion", shell])
    assert done.exit_code == 0
    return done.output


def offered(line, monkeypatch):
    """What the program answers to bash for a line, in bash's protocol."""
    words = line.split(" ")
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(len(words) - 1))
    monkeypatch.setenv("_SINSTOOL_COMPLETE", "bash_complete")
    done = CliRunner().invoke(cli, [], prog_name="sinstool")
    return [answer.partition(",")[::2] for answer in done.output.splitlines()]


@pytest.mark.parametrize("shell", SHELLS)
def test_scripts_are_the_shells_own(shell, tmp_path):
    text = script(shell)
    assert "_SINSTOOL_COMPLETE" in text and f"{shell}_complete" in text
    path = shutil.which(shell)
    if path is None:
        pytest.skip(f"no {shell} here")
    (tmp_path / "script").write_text(text)
    done = subprocess.run([path, "-n", tmp_path / "script"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_unknown_shells_are_refused():
    done = CliRunner().invoke(cli, ["completion", "fsh"])
    assert done.exit_code == 2 and "did you mean fish?" in done.output


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("sinstool ", list(COMMANDS)),
        ("sinstool pro", ["process"]),
        ("sinstool simulate l", ["launch"]),
        ("sinstool process --gyro-k", ["--gyro-kind"]),
        ("sinstool process --gyro-kind ", ["auto", "rate", "mean-rate", "increment"]),
        ("sinstool process --align l", ["level", "log"]),
        ("sinstool process --coning look", ["lookahead-8", "lookahead-12"]),
        ("sinstool process --emit imu,h", ["imu,height"]),
        ("sinstool compare-coning --algorithms previous-3,savage-t",
         ["previous-3,savage-two-speed"]),
        (f"sinstool process {SAMPLE} --imu-topic ", ["/imu/data_raw", "/truth/imu"]),
        (f"sinstool process {SAMPLE} --velocity-topic ", ["/truth/odometry", "none"]),
        (f"sinstool process {SAMPLE} --gnss-topic ", ["none"]),
        (f"sinstool process {SAMPLE} --magnetometer n", ["none"]),
        ("sinstool process --wheels ", ["none"]),
        ("sinstool process no.mcap --imu-topic ", []),
        ("sinstool process --imu-topic ", []),
    ],
)  # fmt: skip
def test_what_is_offered(line, expected, monkeypatch):
    assert [value for kind, value in offered(line, monkeypatch) if kind == "plain"] == expected


@pytest.mark.parametrize(
    "line", ["sinstool process --config ", "sinstool info ", "sinstool process --hse "]
)
def test_files_are_left_to_the_shell(line, monkeypatch):
    assert ("file", "") in [(kind, value) for kind, value in offered(line, monkeypatch)]


def test_bash_completes(tmp_path):
    """The script in a bash of its own, driven as a key press would."""
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("no bash here")
    (tmp_path / "completion").write_text(script("bash"))
    commands = f"""
        . {tmp_path}/completion
        complete -p sinstool
        COMP_WORDS=(sinstool process {SAMPLE} --imu-topic /imu)
        COMP_CWORD=4
        _sinstool_completion sinstool
        echo "${{COMPREPLY[@]}}"
    """
    done = subprocess.run(
        [bash, "--norc", "-c", commands],
        capture_output=True,
        text=True,
        env={"PATH": f"{Path(sys.executable).parent}:/usr/bin:/bin"},
    )
    first, *rest = done.stdout.strip().split("\n")
    assert "-F _sinstool_completion" in first, done.stderr
    assert rest == ["/imu/data_raw"]


def test_completing_a_command_imports_no_other(monkeypatch):
    code = (
        "import os, sys; os.environ.update(COMP_WORDS='sinstool pro', COMP_CWORD='1',"
        " _SINSTOOL_COMPLETE='bash_complete')\n"
        "import atexit; atexit.register(lambda: print([m for m in sys.modules if m in"
        " ('numpy', 'numba', 'pydantic', 'scipy')]))\n"
        "from sinstool.cli.main import cli\n"
        "cli(prog_name='sinstool')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.splitlines() == ["plain,process", "[]"], done.stderr
