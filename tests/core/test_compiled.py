import os
import re
import resource
import shutil
import subprocess
import sys

import pytest

from tests.helpers.paths import ROOT

CODE = """
import sys
import numba
import numpy as np
from sinstool.core.compiled import set_up_cache
set_up_cache()
from sinstool.core.quaternion_kernels import cross
assert cross(1.0, 0.0, 0.0, 0.0, 2.0, 0.0) == (0.0, 0.0, 2.0)
print("numba.np.linalg" in sys.modules)

@numba.njit
def length(x):
    return np.linalg.norm(np.array(cross(x, 0.0, 0.0, 0.0, x, 0.0)))

print(length(3.0))
"""


def test_what_is_compiled_is_loaded_without_the_compiler_and_the_rest_is_compiled(tmp_path):
    outputs = [
        subprocess.run(
            [sys.executable, "-c", CODE],
            env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()
        for _ in range(2)
    ]
    assert outputs == [["True", "9.0"], ["False", "9.0"]]


# One loop of the package, and which warnings it gives
LOOP = """
import warnings
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    from sinstool.core.quaternion_kernels import cross
    assert cross(1.0, 0.0, 0.0, 0.0, 2.0, 0.0) == (0.0, 0.0, 2.0)
    assert cross(1, 0, 0, 0, 2, 0) == (0, 0, 2)
    print(*(f"{w.category.__name__}: {w.message}" for w in caught), sep="\\n")
"""
RIGHTS = "-dac_override,-dac_read_search"
UNPRIVILEGED = (
    ["setpriv", "--bounding-set", RIGHTS, "--inh-caps", RIGHTS] if os.geteuid() == 0 else []
)


def loop(folder, environment, limit=None):
    """What the loop says, run from a folder."""

    def prepare():
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    done = subprocess.run(
        [*UNPRIVILEGED, sys.executable, "-c", LOOP],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"} | environment,
        capture_output=True,
        text=True,
        preexec_fn=prepare,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_a_full_cache_folder_costs_a_warning_and_no_more(tmp_path):
    cache = {"NUMBA_CACHE_DIR": str(tmp_path)}
    said = loop(ROOT, cache, limit=0)  # no file can have a byte
    assert re.fullmatch(r"UncachedWarning: .*File too large.* NUMBA_CACHE_DIR .*", said)
    assert loop(ROOT, cache) == ""
    assert list(tmp_path.rglob("*.nbc"))


@pytest.mark.skipif(
    bool(UNPRIVILEGED) and not shutil.which("setpriv"), reason="root cannot be kept from writing"
)
def test_an_installation_that_cannot_be_written_works_without_a_home(tmp_path):
    installed = tmp_path / "installed"
    shutil.copytree(
        ROOT / "sinstool", installed / "sinstool", ignore=shutil.ignore_patterns("__pycache__")
    )
    nowhere = {"HOME": "/proc", "XDG_CACHE_HOME": "/proc"}
    core = installed / "sinstool" / "core"
    core.chmod(0o555)
    said = loop(installed, nowhere)
    assert re.fullmatch(r"UncachedWarning: .*NUMBA_CACHE_DIR .*", said)
    # What whoever installed it has compiled is used.
    core.chmod(0o755)
    assert loop(installed, nowhere) == ""
    (core / "__pycache__").chmod(0o555)
    core.chmod(0o555)
    assert loop(installed, nowhere) == ""


@pytest.mark.parametrize("ending", [".nbi", ".nbc"])
def test_a_damaged_cache_is_made_anew(tmp_path, ending):
    cache = {"NUMBA_CACHE_DIR": str(tmp_path)}
    assert loop(ROOT, cache) == ""
    damaged = list(tmp_path.rglob(f"*{ending}"))
    assert damaged
    for path in damaged:
        path.write_bytes(path.read_bytes()[:20] if ending == ".nbc" else b"")
    assert loop(ROOT, cache) == ""
    assert all(path.stat().st_size > 100 for path in damaged)


# What those who watch are told, in a first run and in a second
WATCHED = """
from sinstool.core.compiling import watched
seen = []
with watched(seen.append):
    from sinstool.core.quaternion_kernels import cross
    cross(1.0, 0.0, 0.0, 0.0, 2.0, 0.0)
print(seen)
"""


def test_compilation_is_announced_where_the_cache_is_empty(tmp_path):
    outputs = [
        subprocess.run(
            [sys.executable, "-c", WATCHED],
            env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        ).stdout.strip()
        for _ in range(2)
    ]
    assert outputs == ["[True, False]", "[]"]
