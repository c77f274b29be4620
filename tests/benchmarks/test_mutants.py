"""What a changed line reaches, so that its tests run and nothing else is compiled again."""

import json
import os

import pytest

from benchmarks import mutants
from benchmarks.mutant_lines import Program, sites
from benchmarks.mutants import Copy, of_same_size

FILES = {
    "sinstool/methods/inner.py": '''"""Inner loop."""
import numba

@numba.njit(cache=True)
def twice(x):
    return 2.0 * x

def plain(x):
    return x + 1

def said(x):
    log_choice("rests", x + 1)
    return ", ".join(x[:10])
''',
    "sinstool/methods/outer.py": '''"""Outer loop."""
import numba
from sinstool.core.parts import kernel, part
from sinstool.methods.inner import twice

@kernel()
def four(x):
    return half(twice(twice(x)))

@part(allocates=True)
def half(x):
    return 2.0 * (0.5 * x)

@numba.njit(cache=True)
def other(x):
    return x - 1.0

KERNELS = {"four": four}
''',
    "tests/methods/test_outer.py": """
from sinstool.methods.outer import KERNELS, other

def test_four():
    assert KERNELS["four"](1.0) == 4.0

def test_other():
    assert other(1.0) == 0.0
""",
}


@pytest.fixture
def root(tmp_path, monkeypatch):
    monkeypatch.setattr(mutants, "ROOT", tmp_path / "checkout")
    for name, text in FILES.items():
        path = tmp_path / "project" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path / "project"


def mutant_of(root, inside, old):
    (found,) = (m for m in sites(root, "") if m.inside == inside and m.old == old)
    return found


def test_a_compiled_function_is_felt_by_those_that_call_it(root):
    program = Program(root)
    mutant = mutant_of(root, "twice", "*")
    compiled, _ = program.compiled_with(mutant)
    assert {f.inside for f in compiled} == {"twice", "four"}
    reached = program.reached_from(mutant)
    assert ("tests/methods/test_outer.py", "test_four") in reached
    assert ("tests/methods/test_outer.py", "test_other") not in reached


def test_a_part_is_felt_by_the_kernel_it_is_part_of(root):
    program = Program(root)
    mutant = mutant_of(root, "half", "0.5")
    compiled, _ = program.compiled_with(mutant)
    assert {f.inside for f in compiled} == {"half", "four"}
    assert ("tests/methods/test_outer.py", "test_four") in program.reached_from(mutant)


def test_a_plain_function_makes_nothing_compile(root):
    program = Program(root)
    mutant = mutant_of(root, "plain", "+")
    assert program.compiled_with(mutant) == (set(), set())
    assert program.reached_from(mutant) == {("sinstool/methods/inner.py", "plain")}


def test_words_are_no_numbers(root):
    assert not [m for m in sites(root, "") if m.inside == "said"]


@pytest.mark.parametrize(("inside", "old", "new"), [("twice", "2.0", "3.0"), ("plain", "+", "-")])
def test_a_mutant_changes_neither_size_nor_time_of_its_file(root, inside, old, new):
    mutant = mutant_of(root, inside, old)
    text = (root / mutant.path).read_bytes()
    assert mutant.new == new
    assert len(of_same_size(text, mutant)) == len(text)


@pytest.mark.parametrize("new", ["0.000000000002", "2"])
def test_a_docstring_makes_up_for_longer_and_shorter_mutants(root, new):
    mutant = mutant_of(root, "twice", "2.0")
    changed = type(mutant)(**{**vars(mutant), "new": new})
    text = (root / mutant.path).read_bytes()
    result = of_same_size(text, changed)
    assert len(result) == len(text)
    scope = {}
    exec(result.decode().replace("@numba.njit(cache=True)", ""), scope)
    assert scope["twice"](1.0) == float(new)


def test_compiled_loops_come_back_after_a_mutant(root, monkeypatch):
    copy = Copy(root.parent)
    mutant = mutant_of(root, "twice", "2.0")
    path = root / mutant.path
    cache = path.parent / "__pycache__"
    cache.mkdir()
    names = ("inner.twice-4.py311.a.nbc", "outer.four-6.py311.b.nbc", "outer.other-9.py311.c.nbc")
    for name in names:
        (cache / name).write_text("of the original")
    before = path.read_bytes(), path.stat().st_mtime_ns

    def tests(nodes, seconds):
        assert sorted(p.name for p in cache.iterdir()) == [names[2]]
        assert b"3.0" in path.read_bytes()
        assert path.stat().st_mtime_ns == before[1]
        (cache / names[0]).write_text("of the mutant")
        return "killed"

    monkeypatch.setattr(copy, "_run", lambda nodes, seconds, marks: tests(nodes, seconds))
    assert copy.judge(mutant, ["a"], 1.0) == "killed"
    assert (path.read_bytes(), path.stat().st_mtime_ns) == before
    assert sorted(os.listdir(cache)) == sorted(names)
    assert all((cache / name).read_text() == "of the original" for name in names)


def test_tests_that_changed_are_learnt_again_and_others_are_known(root, monkeypatch):
    first = Copy(root.parent)
    known = {"a.py::one": "as before", "tests/methods/test_outer.py::test_four": "gone"}
    first.known.write_text(json.dumps({"tests": known, "failed": ["a.py::one"]}))
    changed = mutants.ROOT / "tests" / "methods" / "test_outer.py"
    changed.parent.mkdir(parents=True)
    changed.write_text("def test_new(): pass")
    copy = Copy(root.parent)
    assert (root / "tests/methods/test_outer.py").read_text() == "def test_new(): pass"

    def learnt(files, seconds, learn):
        assert learn and files == ["tests/methods/test_outer.py"]
        new = {f"{files[0]}::test_new": {"seconds": 1.0, "functions": [["p.py", "f"]]}}
        copy.known.write_text(json.dumps({"tests": new, "failed": []}))

    monkeypatch.setattr(copy, "_run", learnt)
    copy.learn(["tests"])
    assert copy.reaching["p.py", "f"] == {"tests/methods/test_outer.py::test_new"}
    assert copy.failed == {"a.py::one"}
