"""The table of first bytes, against files of other people's writers."""

import subprocess
import sys

import pytest

from sinstool.io.readers.formats import kind_of
from tests.helpers.logs import content, write_bag1, write_db3, write_mcap


@pytest.mark.parametrize(
    ("kind", "make"),
    [
        ("mcap", lambda p: write_mcap(p / "log", content(3))),
        ("rosbag1", lambda p: write_bag1(p / "log", content(3, 1))),
        ("sqlite", lambda p: write_db3(p / "log", content(3))),
    ],
)
def test_logs_are_told_by_their_first_bytes(tmp_path, kind, make):
    path = make(tmp_path)
    data = path.read_bytes()
    for size in (0, 1, 5, 16, len(data)):
        path.write_bytes(data[:size])
        with path.open("rb") as stream:
            assert kind_of(stream) == (kind if size >= 16 else "", data[:16][:size])


def test_asking_imports_nothing_heavy():
    """A folder of logs is listed, and a shell's completion answered, before numpy is there."""
    modules = (
        "sinstool.io.readers.formats, sinstool.io.readers.message_types, sinstool.campaign.inputs"
    )
    heavy = ("numpy", "numba", "scipy", "pydantic", "mcap", "rosbags")
    code = f"import sys, {modules}; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout == "[]\n", done.stderr
