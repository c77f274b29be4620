"""Whole commands on damaged inputs and odd arguments, and checks that see what is wrong.

`python benchmarks/fuzz_commands.py` runs far more of them.
"""

import subprocess
import sys

import pytest

from benchmarks import fuzz_commands as fuzz
from tests.helpers.logs import rows, write_mcap
from tests.helpers.paths import ROOT


@pytest.mark.slow
def test_a_hundred_commands_end_as_they_should(tmp_path):
    # A program of its own: a copy of a process that has threads cannot be relied on.
    command = [sys.executable, "benchmarks/fuzz_commands.py", "--count", "105", "--seed", "7"]
    done = subprocess.run(
        [*command, "--keep", tmp_path], cwd=ROOT, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "105 commands; failures 0" in done.stdout


GOOD = fuzz.Run(["info", "--json"], 0, '{"a": 1}\n', "", 0.1, 200)
REFUSED = fuzz.Run(["info"], 1, "", "sinstool: a.mcap: it is damaged\n", 0.1, 200)


@pytest.mark.parametrize("result", [GOOD, REFUSED])
def test_a_run_as_it_should_be(tmp_path, result):
    assert fuzz.faults(result, tmp_path, set()) == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"status": -11}, "status -11"),
        ({"status": 70}, "status 70"),
        ({"out": "no object"}, "no JSON"),
        ({"out": "[1]"}, "no JSON"),
        ({"err": "Traceback (most recent call last):\n"}, "traceback"),
        ({"err": "a name: \x1b[2J\n"}, r"'\x1b' in stderr"),
        ({"out": '{"a": "\u202e"}'}, "in stdout"),
        ({"status": 1}, "no line says why"),
        ({"seconds": 11.0}, "11.0 s of CPU"),
        ({"megabytes": 900}, "900 MB"),
    ],
)
def test_what_is_wrong_with_a_run_is_seen(tmp_path, change, said):
    result = fuzz.Run(**{**vars(GOOD), **change})
    assert any(said in text for text in fuzz.faults(result, tmp_path, set()))


def test_files_that_a_failed_run_left_are_seen(tmp_path):
    (tmp_path / "rows.csv").write_text("t,x\n")
    assert fuzz.faults(REFUSED, tmp_path, set()) == ["failed and left ['rows.csv']"]
    (tmp_path / ".rows.part").write_text("")
    assert any(".rows.part" in text for text in fuzz.faults(GOOD, tmp_path, set()))


def test_an_output_that_is_not_whole_is_seen(tmp_path):
    path = write_mcap(tmp_path / "out.mcap", rows(300))
    assert fuzz.faults(GOOD, tmp_path, set()) == []
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    (wrong,) = fuzz.faults(GOOD, tmp_path, set())
    assert "out.mcap cannot be read" in wrong
