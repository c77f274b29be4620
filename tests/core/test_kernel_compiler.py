"""Kernels compute what numba's own compiler makes of the same functions."""

import numba
import numpy as np
import pytest
from numba import version_info
from numba.core.caching import NullCache

from sinstool.core import dispatchers
from sinstool.core.dispatchers import INSIDES, supported
from sinstool.core.parts import kernel, part

RECORD = np.dtype(
    (
        np.record,
        [("scale", "f8"), ("count", "i8"), ("vector", "f8", (3,)), ("square", "f8", (3, 3))],
    )
)


@part()
def scaled(x, by):
    return x * by, x**2


@part(inline="always")
def add(source, out):
    for i in range(len(source)):
        out[i] += source[i]


def record(r):
    for i in range(3):
        r.vector[i] += r.square[i, -1] * r.scale
        r.square[2 - i, 0] = r.vector[-1]
        r.count += i
    r.vector[1], r.square[1, 1] = scaled(r.vector[0], r.scale)
    add(r.square[2], r.vector)
    return r.vector[-3]


def strided(a, b):
    total = 0.0
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            if j == 1:
                continue
            b[j, i] = a[i, j] ** 2 - a[-1, j]
            total += b[j, i]
    row, column = a[0, 1:], b[:, 0]
    row[0] = column[-1]
    return total


def integers(a, k):
    n = len(a)
    a[k] = a[-k] // 3
    a[np.uint8(2)] = a[n - 1] % 7
    a[3] = 2.9
    while k > 0:
        k -= 2
        a[0] += k << 1
    best = a[0]
    for x in a:
        if not x <= best:
            best = x
    return best, min(k, 5), n and k


def wide(a):
    a[1, 0, -1] = a[0, 1, 1]
    return a[-1, -1, -1] + np.sqrt(a[0, 0, 0]) + abs(a[1, 1, 1])


def bools(flags, x):
    inside = (x > 0.0 and x < 1.0) or flags[-1]
    flags[0] = inside
    return not inside


ARRAY = np.arange(12.0).reshape(3, 4) + 0.3
CASES = {
    "a record": (record, lambda: (_record(),)),
    "rows": (strided, lambda: (ARRAY.copy(), np.zeros((4, 3)))),
    "columns": (strided, lambda: (np.asfortranarray(ARRAY), np.zeros((4, 3)))),
    "every second": (strided, lambda: (np.repeat(ARRAY, 2, 1)[:, ::2], np.zeros((3, 4)).T)),
    "backwards": (strided, lambda: (ARRAY.copy()[::-1], np.zeros((4, 3)))),
    "integers": (integers, lambda: (np.arange(20, 28), 5)),
    "short integers": (integers, lambda: (np.arange(20, 28, dtype=np.int16), 5)),
    "three dimensions": (wide, lambda: (np.arange(8.0).reshape(2, 2, 2),)),
    "not aligned": (wide, lambda: (_shifted(np.arange(8.0).reshape(2, 2, 2)),)),
    "Booleans": (bools, lambda: (np.array([False, True]), 2.0)),
}


def _record():
    r = np.zeros(1, RECORD)[0]
    r.scale, r.count, r.vector, r.square = 1.7, 3, [1.0, 2.0, 3.5], np.arange(9.0).reshape(3, 3)
    return r


def _shifted(array):
    raw = np.zeros(array.nbytes + 1, np.uint8)[1:]
    shifted = raw.view(np.float64).reshape(array.shape)
    shifted[...] = array
    assert not shifted.flags.aligned
    return shifted


@pytest.mark.parametrize("name", CASES)
def test_kernels_compute_what_numba_makes_of_them(name):
    function, arguments = CASES[name]
    ours, theirs = arguments(), arguments()
    compiled = kernel()(function)
    if supported():
        # Not by numba's own compiler, then
        from sinstool.core.kernel_compiler import is_plain

        assert is_plain(function, [numba.typeof(each) for each in ours])
    results = compiled(*ours), numba.njit(error_model="numpy")(function)(*theirs)
    np.testing.assert_array_equal(*results)
    for own, other in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(own, other)


def test_our_compiler_is_used_in_the_versions_it_was_written_for():
    assert supported() == (version_info.short in INSIDES)


def test_another_numba_compiles_in_its_own_way(monkeypatch):
    monkeypatch.setattr(dispatchers, "INSIDES", set())
    assert not supported.__wrapped__()
    monkeypatch.setattr(dispatchers, "supported", lambda: False)

    @part()
    def twice(x):
        return 2.0 * x

    @kernel()
    def fill(a):
        for i in range(len(a)):
            a[i] = twice(a[i])

    types = {type(each) for each in (twice.dispatcher, fill.dispatcher, numba.njit(lambda x: x))}
    assert len(types) == 1
    a = np.arange(3.0)
    fill(a)
    np.testing.assert_array_equal(a, [0.0, 2.0, 4.0])


def test_what_is_done_only_with_an_argument_is_left_out_where_it_is_none():
    # An addition of an array and a number has no meaning without memory: compiled, it would fail
    @kernel()
    def noted(x, events):
        x[0] = 2.0
        if events is not None and x[1] > 0.0:
            x[0] = (events + 1.0)[0]
        return x[0]

    assert noted(np.ones(2), None) == 2.0
    with pytest.raises(numba.core.errors.NumbaError):
        noted(np.ones(2), np.ones(2))


def test_kernels_with_closures_and_exceptions_are_left_to_numba():
    @kernel()
    def both(x):
        def double(y):
            return 2.0 * y

        if x[0] < 0.0:
            raise ValueError("negative")
        return double(x[0])

    assert both(np.array([1.5])) == 3.0
    with pytest.raises(ValueError, match="negative"):
        both(np.array([-1.5]))


def test_loops_over_several_elements_at_a_time_can_be_done_without():
    def sums(a, b):
        for i in range(len(a)):
            a[i] += 3.0 * b[i]

    for vectorizes in (True, False):
        compiled = kernel(vectorizes=vectorizes)(sums)
        if supported():
            compiled = compiled.dispatcher._for_python
        compiled._cache = NullCache()  # which keeps no text of the code
        a = np.arange(37.0)
        compiled(a, a[::-1].copy())
        np.testing.assert_array_equal(a, np.arange(37.0) + 3.0 * np.arange(36.0, -1.0, -1.0))
        (code,) = compiled.inspect_llvm().values()
        assert ("x double>" in code) == (vectorizes or not supported())


def counted(a, b, n):
    total, down, k = 0.0, n, 0
    for i in range(n):
        for j in range(i, n):
            total += a[i * n + j] - b[j - n] + a[k]
        down -= 1
        b[down] = total
        b[down - n] += a[i - 1]
        k += i
    for i in range(-2, 2):
        total += a[i]
    for i in range(n - 1, -1, -1):
        total += b[i] * a[min(i, n) - 1]
    back = 0
    while back > -n:
        total += a[back] * b[back]
        back += -1
    m = 1
    for i in range(3):
        m = i if i > 0 else m - 2
        total += b[m]
    return total


def test_indices_that_count_and_indices_from_the_end():
    ours, theirs = np.arange(1.0, 5.0), np.arange(1.0, 5.0)
    a = np.sqrt(np.arange(16.0))
    assert kernel()(counted)(a, ours, 4) == counted(a, theirs, 4)
    np.testing.assert_array_equal(ours, theirs)


def widened(a, n):
    x, y, z = 0, 1, 0
    for i in range(n):
        z = y // 2
        y = x + 1
        x = a[i] if i > 1 else i
    return x, y, z


def test_types_that_change_in_a_loop():
    a = np.array([0.25, 1.75, 2.5, 3.25, 4.5])
    result = kernel()(widened)(a, 5)
    assert result == widened(a, 5) == numba.njit(widened)(a, 5)
    assert [type(each) for each in result] == [float, float, float]


def chosen(a, n):
    for i in range(n):
        if a[i] > 0.0:
            best = a[i]
            if i > 2:
                best, a[0] = a[0], best
        elif i == 1:
            best = -a[i]
            while best > 1.0:
                best /= 2.0
        a[i] = best
    return best


def test_variables_with_several_values():
    ours, theirs = np.array([1.0, -7.0, 3.0, 5.0, -2.0]), np.array([1.0, -7.0, 3.0, 5.0, -2.0])
    assert kernel()(chosen)(ours, 5) == chosen(theirs, 5)
    np.testing.assert_array_equal(ours, theirs)
