"""What compiled loops depend on: what they call and the constants they name, and nothing else."""

import importlib.util
import os
import sys

import pytest

from sinstool.core import compiled_sources
from sinstool.core.compiled_sources import stamp
from sinstool.core.parts import part

SOURCES = {
    "made_constants": "FAR = 3.0\nOTHER = 1.0\nPAIR = (1, 2.0)\nHOLDS = (object(), 1)\n",
    "made_deep": (
        "from sinstool.core.parts import part\n"
        "@part()\n"
        "def deep(x):\n"
        "    return x + 1.0\n"
    ),
    "made_loop": (
        "from sinstool import made_constants\n"
        "from sinstool.made_constants import PAIR, HOLDS\n"
        "from sinstool.made_deep import deep\n"
        "from sinstool.core.parts import kernel, part\n"
        "@part()\n"
        "def middle(x):\n"
        "    return deep(x) * made_constants.FAR + PAIR[0]\n"
        "@kernel()\n"
        "def loop(a):\n"
        "    for i in range(len(a)):\n"
        "        a[i] = middle(a[i])\n"
    ),
    "made_beside": "UNUSED = 1\n",
}  # fmt: skip


@pytest.fixture
def made(tmp_path, monkeypatch):
    """Modules of the package for as long as a test lasts."""
    import sinstool

    modules = {}
    for name, text in SOURCES.items():
        path = tmp_path / f"{name}.py"
        path.write_text(text)
        spec = importlib.util.spec_from_file_location(f"sinstool.{name}", path)
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, f"sinstool.{name}", module)
        monkeypatch.setattr(sinstool, name, module, raising=False)
        spec.loader.exec_module(module)
        modules[name] = module
    compiled_sources._state.cache_clear()
    yield modules
    compiled_sources._state.cache_clear()


def again(module):
    compiled_sources._state.cache_clear()
    return stamp(module.loop.py_func)


def test_the_same_sources_have_the_same_stamp(made):
    loop = made["made_loop"]
    first = again(loop)
    assert again(loop) == first
    names = [each[0] for each in first]
    assert names == ["made_constants.py", "made_deep.py", "made_loop.py", "FAR", "PAIR"]


@pytest.mark.parametrize("name", ["made_constants", "made_deep", "made_loop", "made_beside"])
def test_a_changed_file_matters_where_something_of_it_is_used(made, name):
    loop = made["made_loop"]
    first = again(loop)
    path = made[name].__file__
    os.utime(path, ns=(1, os.stat(path).st_mtime_ns + 1_000_000_000))
    assert (again(loop) == first) == (name == "made_beside")


def test_a_changed_constant_matters(made):
    loop = made["made_loop"]
    first = again(loop)
    made["made_constants"].OTHER = 2.0
    assert again(loop) == first
    made["made_constants"].FAR = 3.5
    assert again(loop) != first
    made["made_constants"].FAR = 3.0
    assert again(loop) == first
    loop.PAIR = (2, 2.0)
    assert again(loop) != first


def test_functions_that_call_one_another_are_looked_at_once():
    @part()
    def countdown(n):
        return 0 if n <= 0 else countdown(n - 1)

    assert stamp(countdown.py_func)
