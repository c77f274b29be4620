"""Freed memory is used again, whatever limits the environment sets, and given back at the end."""

import os
import subprocess
import sys

import pytest

from sinstool.core import memory

COUNT = """
import resource
import sys
from contextlib import nullcontext

import numpy as np

from sinstool.core.memory import memory_held

def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

def resident():
    with open("/proc/self/statm") as stream:
        return int(stream.read().split()[1])

before = resident()
with memory_held() if sys.argv[1] == "kept" else nullcontext():
    np.ones(2**19)
    begun = faults()
    for _ in range(50):
        np.ones(2**19)  # 4 MB: a thousand pages
    made = faults() - begun
print(made, resident() - before)
"""


@pytest.mark.skipif(memory._glibc() is None, reason="of glibc")
def test_pages_are_used_again_where_dask_has_them_given_back():
    environment = {**os.environ, "MALLOC_TRIM_THRESHOLD_": "65536"}  # as Dask sets it
    counts = {}
    for how in ("kept", "as it is"):
        command = [sys.executable, "-c", COUNT, how]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        counts[how] = [int(word) for word in done.stdout.split()]
    assert counts["as it is"][0] > 10 * counts["kept"][0]
    # at the end both have given it back
    assert counts["kept"][1] < 1_000


def test_without_glibc_nothing_happens(monkeypatch):
    monkeypatch.setattr(memory, "_glibc", lambda: None)
    with memory.memory_held():
        pass
