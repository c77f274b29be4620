"""Compile the loops of the package into numba's cache, before several workers run the tests.

python -m tests.helpers.compiled

Workers that begin together with an empty cache would each compile what the others are compiling.
Two programs here compile different parts at the same time; with a full cache they take seconds.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from tests.helpers.paths import ROOT

SAMPLES = ROOT / "sample_data"
CONING = SAMPLES / "coning.mcap"
RIG = ("--config", SAMPLES / "hse" / "rig-a.toml")
DRIVE = ("simulate", "drive", "-o", "drive.mcap", "--still", 15, "--duration", 60, "--rate", 50)
# One after the other within a group; the groups at the same time
GROUPS = (
    (
        (*DRIVE, "--grade", "mems", "--gnss-rate", 5),
        ("process", "drive.mcap", "-o", "out.mcap", "--mode", "ins-gnss", "--smooth"),
        ("export", "out.mcap", "-o", "out.csv"),
        ("align", "drive.mcap"),
    ),
    (
        ("simulate", "static", "-o", "static.mcap", "--duration", 60),
        ("align", "static.mcap"),
        ("allan", "static.mcap"),
        ("compare-coning", CONING, "--gyro-kind", "mean-rate"),
        ("calibrate-hse", *sorted((SAMPLES / "hse").glob("a-*.mcap")), *RIG, "-o", "hse.json"),
        ("simulate", "spiral-climb", "-o", "climb.mcap", "--duration", 20),
    ),
)


def run_group(group, folder):
    """Start a program that runs commands one after the other."""
    words = [[str(word) for word in command] for command in group]
    code = (
        "import sys\n"
        "from sinstool.cli.main import cli\n"
        f"for words in {words!r}:\n"
        "    cli.main(words, standalone_mode=False)\n"
    )
    return subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def main():
    """Compile; what goes wrong is for the tests to say."""
    with tempfile.TemporaryDirectory() as name:
        folders = [Path(name) / str(number) for number in range(len(GROUPS))]
        for folder in folders:
            folder.mkdir()
        runs = [run_group(*pair) for pair in zip(GROUPS, folders, strict=True)]
        for run in runs:
            run.wait()


if __name__ == "__main__":
    main()
