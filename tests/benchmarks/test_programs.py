"""Every benchmark can be started, as a file or as a module, and says what it does."""

import re
import runpy
import subprocess
import sys

import pytest

from tests.helpers.paths import ROOT

PROGRAMS = sorted(
    path.stem
    for path in (ROOT / "benchmarks").glob("*.py")
    if '__name__ == "__main__"' in path.read_text()
)


@pytest.mark.parametrize("name", [name for name in PROGRAMS if name != "hse_paper"])
def test_help(name, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [f"{name}.py", "--help"])
    # Other tests may have imported it, which runpy would warn of
    monkeypatch.delitem(sys.modules, f"benchmarks.{name}", raising=False)
    with pytest.raises(SystemExit) as ended:
        runpy.run_module(f"benchmarks.{name}", run_name="__main__")
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith(f"usage: {name}.py")


@pytest.mark.parametrize("start", [["benchmarks/every_cut.py"], ["-m", "benchmarks.every_cut"]])
def test_both_ways_of_starting(start):
    done = subprocess.run(
        [sys.executable, *start, "--help"], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("usage: every_cut.py")


@pytest.mark.parametrize("name", PROGRAMS)
def test_tests_are_found_when_started_as_a_file(name):
    """The package `benchmarks`, once imported, is what makes `tests` importable."""
    text = (ROOT / "benchmarks" / f"{name}.py").read_text()
    imports = re.findall(r"^(?:from|import) (benchmarks|tests)\b", text, re.MULTILINE)
    assert imports == sorted(imports)
    assert "tests" not in imports or "benchmarks" in imports
