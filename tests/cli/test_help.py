"""Help, version, and what is imported for them."""

import re
import subprocess
import sys

import pytest

from sinstool.cli.main import COMMANDS
from sinstool.methods.coning.registry import names
from tests.cli.test_configuration import fields
from tests.helpers.paths import ROOT


def test_help_imports_nothing_heavy():
    code = (
        "import sys\nfrom sinstool.cli.main import cli\n"
        "cli.main(['--help'], standalone_mode=False)\n"
        "print('loaded', sorted({m.split('.')[0] for m in sys.modules}))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    shown, loaded = run.stdout.split("loaded ")
    heavy = {"numpy", "numba", "scipy", "pydantic", "rich", "mcap", "rosbags", "zstandard", "lz4"}
    assert heavy & set(re.findall(r"'(\w+)'", loaded)) == set()
    assert all(name in shown for name in COMMANDS)


def test_printing_a_configuration_compiles_nothing():
    code = (
        "import sys\nfrom sinstool.cli.main import cli\n"
        "cli.main(['process', '--print-config'], standalone_mode=False)\n"
        "print('loaded', sorted({m.split('.')[0] for m in sys.modules}))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = re.findall(r"'(\w+)'", run.stdout.split("loaded ")[1])
    assert {"scipy", "rosbags", "mcap", "rich"} & set(loaded) == set()


def loaded_by(words):
    """Modules that a command has imported, the second time, with its kernels compiled."""
    code = (
        "import sys\nfrom sinstool.cli.main import cli\n"
        f"cli.main({words!r}, standalone_mode=False)\n"
        "print('loaded', sorted(sys.modules))"
    )
    for _ in range(2):
        run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    return re.findall(r"'([\w.]+)'", run.stdout.split("loaded ")[1])


@pytest.mark.slow
def test_a_run_imports_only_what_it_uses(tmp_path):

    out = str(tmp_path / "out.mcap")
    words = ["process", str(ROOT / "sample_data/static.mcap"), "-o", out, "--overwrite", "-q"]
    loaded = loaded_by([*words, "--mode", "attitude"])
    others = {"scipy.linalg", "scipy.spatial", "scipy.special", "numba", "numpy.f2py"}
    assert others & set(loaded) == set()
    assert {"sinstool.report.markup", "rosbags.typesys.stores.ros2_dashing"} & set(loaded) == set()


@pytest.mark.slow
@pytest.mark.parametrize("mode", [["ins-gnss", "--smooth"], ["ins", "--height-damping", "gnss"]])
def test_a_navigation_runs_without_scipy(sinstool, tmp_path, mode):
    """Importing it takes longer than filtering ten minutes."""
    log, out = str(tmp_path / "drive.mcap"), str(tmp_path / "out.mcap")
    assert sinstool("simulate", "drive", "-o", log, "--duration", "200", "--rate", "50")[0] == 0
    loaded = loaded_by(["process", log, "-o", out, "--overwrite", "-q", "--mode", *mode])
    assert {"scipy", "numba"} & set(loaded) == set()


@pytest.mark.parametrize("command", [(), *((name,) for name in COMMANDS), ("simulate", "coning")])
@pytest.mark.parametrize("flag", ["-h", "--help"])
def test_help(sinstool, command, flag):
    status, out, err = sinstool(*command, flag)
    assert (status, err) == (0, "")
    assert out.startswith("Usage: ")


def test_help_of_process_names_every_algorithm_and_option(sinstool):
    _, out, _ = sinstool("process", "--help-all")
    help_text = " ".join(out.split())
    assert all(name in help_text for name in names())
    assert all("--" + name.replace("_", "-") in help_text for _, name in fields())


@pytest.mark.parametrize("command", [("export",), ("simulate", "drive"), ("conventions",)])
def test_where_help_is_all_help_all_is_the_same(sinstool, command):
    """The README says of every command that --help-all shows all of its options."""
    short, full = (sinstool(*command, flag) for flag in ("--help", "--help-all"))
    assert full[0] == 0 and full[1] == short[1] and "--help-all" not in short[1]


LONG = ("info", "process", "align", "compare-coning", "calibrate-hse")


@pytest.mark.parametrize("command", LONG)
def test_help_fits_a_screen_and_the_full_help_is_in_groups(sinstool, command):
    short, full = (sinstool(command, flag)[1] for flag in ("--help", "--help-all"))
    assert len(short.strip().split("\n")) <= 60
    assert max(map(len, short.split("\n"))) <= 100
    assert re.search(r"--help-all +show all \d+ options", short)
    headings = re.findall(r"^(\S[^:\n]*):$", full, re.M)
    assert headings[0] == "Main options" and headings[-1] == "Messages"
    assert len(headings) == len(set(headings)) >= 5
    # all of the short help's options are in the full one, which has more
    options = [set(re.findall(r"^  (?:-\w, )?(--[\w-]+)", text, re.M)) for text in (short, full)]
    assert options[0] <= options[1] and len(options[1]) > len(options[0])


def test_what_matters_most_comes_first(sinstool):
    lines = sinstool("process", "--help")[1].split("Main options:\n")[1].split("\n")
    first = re.findall(r"--[\w-]+", "\n".join(lines[:6]))
    assert {"--output", "--mode", "--smooth", "--report"} <= set(first)


def test_version(sinstool):
    from sinstool import __version__

    assert sinstool("--version") == (0, f"sinstool, version {__version__}\n", "")
    module = subprocess.run(
        [sys.executable, "-m", "sinstool", "--version"], capture_output=True, text=True, check=True
    )
    assert module.stdout.endswith(f", version {__version__}\n") and not module.stderr
