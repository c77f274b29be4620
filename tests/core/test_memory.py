"""Freed memory is used again, whatever limits the environment sets, and given back at the end."""

import os
import subprocess
import sys

import numpy as np
import pytest

from sinstool.core import memory
from sinstool.core.errors import NotALogError
from sinstool.io.readers import open_log

COUNT = """
import resource
import sys
from contextlib import nullcontext

import numpy as np

from sinstool.core.memory import keep_freed_memory, memory_held

def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

def resident():
    with open("/proc/self/statm") as stream:
        return int(stream.read().split()[1])

size = int(sys.argv[2])
before = resident()
if sys.argv[1] == "learnt":
    keep_freed_memory()
with memory_held() if sys.argv[1] == "kept" else nullcontext():
    np.ones(size)
    begun = faults()
    for _ in range(50):
        np.ones(size)
    made = faults() - begun
print(made, resident() - before)
"""


@pytest.mark.skipif(memory._glibc() is None, reason="of glibc")
def test_pages_are_used_again_where_dask_has_them_given_back():
    environment = {**os.environ, "MALLOC_TRIM_THRESHOLD_": "65536"}  # as Dask sets it
    counts = {}
    for how in ("kept", "as it is"):
        command = [sys.executable, "-c", COUNT, how, str(2**19)]  # 4 MB: a thousand pages
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        counts[how] = [int(word) for word in done.stdout.split()]
    assert counts["as it is"][0] > 10 * counts["kept"][0]
    # at the end both have given it back
    assert counts["kept"][1] < 1_000


@pytest.mark.skipif(memory._glibc() is None, reason="of glibc")
def test_pages_are_used_again_by_a_program_that_reads_a_log():
    """Pieces of some sizes in turn, as columns and chunks have them, which glibc gives back."""
    program = COUNT.replace("np.ones(size)", "[np.ones(size >> k) for k in range(4)]")
    limits = ("MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_")
    environment = {name: value for name, value in os.environ.items() if name not in limits}
    counts = {}
    for how in ("learnt", "as it is"):
        command = [sys.executable, "-c", program, how, str(2**18)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        counts[how] = int(done.stdout.split()[0])
    assert counts["as it is"] > 10 * counts["learnt"]


def test_opening_a_log_keeps_memory(monkeypatch, tmp_path):
    opened = []
    monkeypatch.setattr("sinstool.io.readers.open.keep_freed_memory", lambda: opened.append(True))
    with pytest.raises(NotALogError):
        open_log(tmp_path / "none.mcap")
    assert opened


def test_without_glibc_nothing_happens(monkeypatch):
    monkeypatch.setattr(memory, "_glibc", lambda: None)
    with memory.memory_held():
        pass


def test_blocks_are_joined_in_order_and_given_up():
    rng = np.random.default_rng(3)
    blocks = [rng.normal(size=(rows, 3)) for rows in (5, 0, 1, 1000)]
    whole = np.concatenate(blocks)
    np.testing.assert_array_equal(memory.joined(blocks), whole)
    assert blocks == []


def test_joining_blocks_takes_the_memory_of_one_copy():
    program = (
        "import resource, numpy as np\n"
        "from sinstool.core.memory import joined\n"
        "peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "blocks = [np.ones((100, 40)) for _ in range(3000)]  # 96 MB\n"
        "before = peak()\n"
        "joined(blocks)\n"
        "print(peak() - before)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert int(done.stdout) < 45_000, done.stderr
