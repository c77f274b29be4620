import os
import subprocess
import sys

import numba
import numpy as np
import pytest

# A kernel of a part of a part, in a module that can be cached
MODULE = """
import numpy as np
from sinstool.core.parts import kernel, part

@part()
def square(x):
    return x * x

@part(error_model="numpy")
def add_squares(record, values):
    for k in range(len(values)):
        record.total += square(values[k]) / record.scale

@kernel()
def total(record, values):
    add_squares(record, values)
    return record.total

def made(scale):
    record = np.zeros(1, np.dtype((np.record, [("total", "f8"), ("scale", "f8")])))[0]
    record.scale = scale
    return record
"""
# Its kernel from Python, in a first run and a second, and what of it was compiled
RUN = """
import numpy as np
from sinstool import parts_of_a_test as module
from sinstool.core.compiling import watched
seen = []
with watched(seen.append):
    print(module.total(module.made(2.0), np.array([1.0, 3.0])), seen)
"""


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """The module as one of the package, and the environment of a run of it."""
    import sinstool

    folder = tmp_path / "more"
    folder.mkdir()
    (folder / "parts_of_a_test.py").write_text(MODULE)
    start = f"import sinstool; sinstool.__path__.append({str(folder)!r})\n"
    monkeypatch.setattr(sinstool, "__path__", [*sinstool.__path__, str(folder)])
    return start, os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}, tmp_path / "cache"


def test_a_kernel_is_kept_whole_and_its_parts_are_not(installed):
    start, environment, cache = installed
    outputs = [
        subprocess.run(
            [sys.executable, "-c", start + RUN],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        ).stdout.strip()
        for _ in range(2)
    ]
    assert outputs == ["5.0 [True, False]", "5.0 []"]
    kept = {path.name.partition("-")[0] for path in cache.rglob("*.nbc")}
    assert kept == {"parts_of_a_test.total"}


def test_parts_are_called_from_python_too(installed):
    from sinstool import parts_of_a_test as module

    assert module.square(3.0) == 9.0
    record = module.made(1.0)
    module.add_squares(record, np.array([2.0]))
    assert record.total == 4.0
    assert module.total(record, np.array([2.0])) == 8.0  # after the parts by themselves
    assert module.square(2) == 4


def test_parts_are_called_by_the_compiled_code_of_others(installed):
    from sinstool.core.quaternion_kernels import cross
    from sinstool.methods.ins_gnss.model import radii

    @numba.njit
    def of_others(x):
        return radii(x, 0.0)[0] + cross(x, 0.0, 0.0, 0.0, x, 0.0)[2]

    assert of_others(0.5) == pytest.approx(radii(0.5, 0.0)[0] + 0.25, rel=1e-15)
