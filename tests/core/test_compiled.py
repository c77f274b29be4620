import os
import re
import resource
import shutil
import subprocess
import sys

import pytest

from sinstool.core.compiled_files import CompiledFiles
from tests.helpers.paths import ROOT

CODE = """
import sys
import numpy as np
from sinstool.core.quaternion_kernels import cross
assert cross(1.0, 0.0, 0.0, 0.0, 2.0, 0.0) == (0.0, 0.0, 2.0)
print("numba" in sys.modules)
import numba

@numba.njit
def length(x):
    return np.linalg.norm(np.array(cross(x, 0.0, 0.0, 0.0, x, 0.0)))

print(length(3.0))
"""


@pytest.mark.slow
def test_what_is_compiled_runs_without_numba_and_the_rest_is_compiled(tmp_path):
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


@pytest.mark.slow
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


def emptied(paths):
    for path in paths:
        path.write_bytes(b"")


def cut_short(paths):
    for path in paths:
        path.write_bytes(path.read_bytes()[:20])


def changed(paths):
    for path in paths:
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)


def exchanged(paths):
    contents = [path.read_bytes() for path in paths]
    for path, content in zip(paths, contents[1:] + contents[:1], strict=True):
        path.write_bytes(content)


@pytest.mark.slow
@pytest.mark.parametrize("damage", [emptied, cut_short, changed, exchanged])
def test_a_damaged_cache_is_made_anew(tmp_path, damage):
    cache = {"NUMBA_CACHE_DIR": str(tmp_path)}
    assert loop(ROOT, cache) == ""
    damaged = sorted(tmp_path.rglob("*.nbc"))
    assert len(damaged) > 1
    damage(damaged)
    assert loop(ROOT, cache) == ""
    assert sorted(tmp_path.rglob("*.nbc")) == damaged
    assert all(path.stat().st_size > 100 for path in damaged)


def test_processes_that_compile_at_the_same_time_keep_all_of_it(tmp_path):
    # numba's own index would have given both the same file
    one, other = (CompiledFiles(str(tmp_path), "module.loop-1", "source") for _ in range(2))
    assert one.load("int64") is None and other.load("float64") is None
    one.save("int64", b"code for integers")
    other.save("float64", b"code for numbers")
    for files in (one, other):
        assert files.load("int64") == b"code for integers"
        assert files.load("float64") == b"code for numbers"


def test_code_of_an_earlier_source_is_not_run_and_does_not_stay(tmp_path):
    old, new = (CompiledFiles(str(tmp_path), "module.loop-1", stamp) for stamp in "ab")
    neighbour = CompiledFiles(str(tmp_path), "module.loop-12", "a")
    old.save("int64", b"old")
    neighbour.save("int64", b"another loop")
    assert new.load("int64") is None
    new.save("int64", b"new")
    assert new.load("int64") == b"new" and old.load("int64") is None
    assert neighbour.load("int64") == b"another loop"
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.slow
def test_first_runs_at_the_same_time_with_an_empty_cache(tmp_path):
    command = [sys.executable, "-m", "sinstool", "process", "-q", "-o"]
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    log = ROOT / "sample_data" / "coning.mcap"
    outputs = [tmp_path / f"{k}.mcap" for k in range(3)]
    for _ in range(2):
        runs = [
            subprocess.Popen(
                [*command, out, log, "--overwrite", "--latitude", "45"],
                cwd=ROOT,
                env=environment,
                stderr=subprocess.PIPE,
                text=True,
            )
            for out in outputs
        ]
        said = [run.communicate()[1] for run in runs]
        assert [run.returncode for run in runs] == [0] * len(runs), said
        # What the log has to be warned of, and nothing of compiling
        assert len(set(said)) == 1 and "4.8 deg" in said[0] and "compil" not in said[0], said
        assert len({out.read_bytes() for out in outputs}) == 1
    assert not [path for path in tmp_path.rglob("*.nb*") if path.suffix != ".nbc"]


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
