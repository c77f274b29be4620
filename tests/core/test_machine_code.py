"""Kernels run from machine code that is kept as they do just after numba has compiled them."""

import subprocess
import sys
import threading

import numpy as np
import pytest

from sinstool.core import compiled_files, dispatchers, machine_code
from sinstool.core.machine_code import described
from sinstool.core.parts import kernel, part
from tests.core.test_kernel_compiler import ARRAY, CASES
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.skipif(
    not dispatchers.supported(), reason="another numba keeps what it compiles itself"
)


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """A folder of its own for what a test compiles."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    compiled_files.folder_of.cache_clear()
    yield tmp_path
    compiled_files.folder_of.cache_clear()


@pytest.fixture
def without_numba(monkeypatch):
    """From now on nothing may be compiled or run by numba."""

    def forbid():
        def compile_nothing(*args, **keywords):
            raise AssertionError("numba is asked")

        monkeypatch.setattr(dispatchers, "way_in", compile_nothing)
        monkeypatch.setattr(dispatchers, "dispatcher", compile_nothing)

    return forbid


def single(x):
    return np.float32(x * 2.0)


def mixed(flag, count, small, x, single):
    return not flag, count + small, x + single, count > 3


def nothing(a, unused):
    a[0] = 5.0


def halves(a):
    for i in range(len(a)):
        a[i] = np.exp(a[i]) + a[i] ** 0.3


MORE = {
    "a number of 32 bits": (single, lambda: (1.1,)),
    "scalars": (
        mixed,
        lambda: (True, -9, np.int16(-5), 0.1, np.float32(0.1)),
    ),
    "large integers": (mixed, lambda: (np.bool_(False), np.uint64(2**63), np.uint64(1), 2.0, 3.0)),
    "nothing": (nothing, lambda: (np.zeros(2), None)),
    "an empty array": (halves, lambda: (np.zeros(0),)),
    "functions of C": (halves, lambda: (np.arange(1.0, 9.0),)),
    "a constant array": (lambda a: a.sum(), lambda: (np.broadcast_to(3.0, (2, 3)),)),
}


@pytest.mark.parametrize("name", [*CASES, *MORE])
def test_kept_code_computes_what_was_compiled(name, cache, without_numba):
    function, arguments = (CASES | MORE)[name]
    first, again, plain = arguments(), arguments(), arguments()
    result = kernel()(function)(*first)
    without_numba()
    kept = kernel()(function)(*again)
    np.testing.assert_array_equal(kept, result)
    assert type(kept) is type(result)
    if isinstance(kept, tuple):
        assert [type(each) for each in kept] == [type(each) for each in result]
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, other)
    if name in MORE:  # the others are compared with what numba makes of them elsewhere
        expected = function(*plain)
        assert kept is None if expected is None else kept == pytest.approx(expected, rel=1e-14)
        for one, other in zip(first, plain, strict=True):
            assert one is other is None or one == pytest.approx(other, rel=1e-14)


def test_other_types_other_options_and_other_sources_are_other_code(cache):
    def twice(a):
        a[0] = a[0] * 2

    kept = set()
    for argument in (np.ones(1), np.ones(1, np.float32), np.ones(2, int), np.ones((2, 2))[:, 0]):
        kernel()(twice)(argument)
        assert argument[0] == 2
        names = {path.name for path in cache.rglob("*.nbc")}
        assert kept < names
        kept = names
    kernel(fastmath={"contract", "nnan"})(twice)(np.ones(1))
    assert len(list(cache.rglob("*.nbc"))) == len(kept) + 1


def test_functions_made_in_functions_are_told_apart():
    def made(by):
        @kernel()
        def scale(a):
            a[0] *= by

        return scale

    a = np.ones(1)
    for by in (3.0, 5.0):
        made(by)(a)
    assert a[0] == 15.0


def test_code_that_needs_what_is_missing_is_not_run(monkeypatch):
    a = np.arange(3.0)
    assert kernel()(halves)(a) is None
    seen = []
    load = machine_code._linked
    monkeypatch.setattr(
        machine_code,
        "_linked",
        lambda code: seen.append(code) or load(code._replace(needs=("no_such_function",))),
    )
    b = np.arange(3.0)
    kernel()(halves)(b)
    assert {"exp", "pow"} >= set(seen[0].needs)
    np.testing.assert_array_equal(a, b)


def test_threads_run_the_same_kernel_at_the_same_time():
    @kernel()
    def count(a, upto):
        total = 0
        for i in range(upto):
            total += i * a[0]
        return total

    found = {}
    threads = [
        threading.Thread(target=lambda k=k: found.update({k: count(np.array([k]), 1000)}))
        for k in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == {k: k * 499500 for k in range(8)}


@pytest.mark.parametrize("argument", [2**63, "text", [1.0], 1j, np.ma.zeros(1)])
def test_what_kernels_do_not_take_is_left_to_numba(argument):
    assert described((1.0, argument))[0] is None


def test_a_part_is_told_by_its_types_alone():
    a = ARRAY[:, 1]
    assert described((a, 2, None)) == (
        ((a.dtype, 1, 0, 0x500), "int64", None),
        ("qqqq", [a.ctypes.data, 3, 32, 2]),
    )


def test_parts_called_from_python_are_kept_too(cache, without_numba):
    def half(x):
        return x / 2.0, x > 1.0

    assert part()(half)(3.0) == (1.5, True)
    without_numba()
    assert part()(half)(1.0) == (0.5, False)


def test_addresses_are_those_that_numpy_gives():
    whole = np.arange(24.0).reshape(4, 6)
    locked = np.zeros(5, np.uint8)
    locked.flags.writeable = False
    record = np.zeros(3, [("a", "i8"), ("b", "f8", (2, 2))])
    for array in (whole, whole[1:, 2:], whole[::-2].T, locked[3:], np.empty(0), record["b"]):
        expected = array.__array_interface__["data"][0]
        assert machine_code.address(array) == machine_code._asked_address(array) == expected


def test_another_python_asks_numpy_for_addresses(monkeypatch):
    monkeypatch.setattr(machine_code.sys.implementation, "name", "other")
    assert machine_code._way_to_addresses() is machine_code._asked_address


PROGRAM = """
import sys, numpy as np
__name__ = "sinstool.halves"
from sinstool.core.parts import kernel

@kernel()
def halves(a):
    for i in range(len(a)):
        a[i] = np.arctan2(a[i], 2.0)

for kind in sys.argv[1:]:
    a = np.memmap("mapped", float, "w+", shape=3) if kind == "mapped" else np.ones(3)
    halves(a)
print("numba" in sys.modules)
"""


@pytest.fixture
def ran(cache, monkeypatch):
    """Runs a program with a kernel that calls functions of C; whether numba was imported."""
    file = cache / "sinstool_halves.py"
    file.write_text(PROGRAM)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))

    def run(*kinds):
        command = [sys.executable, str(file), *kinds]
        one = subprocess.run(command, cwd=cache, capture_output=True, text=True, check=True)
        return one.stdout == "True\n"

    return run


def test_the_first_kernel_of_a_process_may_call_functions_of_c(ran):
    assert [ran("array") for _ in range(2)] == [True, False]


def test_code_is_kept_beside_that_of_numba_for_other_arguments(ran):
    ran("array", "mapped")  # of an array of another class, which numba runs
    assert not ran("array")


def test_kernels_of_one_name_are_told_apart(cache):
    """Machine code lies in one place, where names of functions are not."""

    def once(a):
        a[0] += 1.0

    def twice(a):
        a[0] += 2.0

    twice.__name__, twice.__qualname__ = once.__name__, once.__qualname__
    for kept in (False, True):
        a = np.zeros(1)
        for function in (once, twice):
            compiled = kernel()(function)
            compiled(a)
            compiled(a)
        assert a[0] == 6.0, kept
