"""The names of `import sinstool`: what they cost, what they are, and what is said of them."""

from __future__ import annotations

import doctest
import inspect
import re
import subprocess
import sys
from types import ModuleType

import pytest

import sinstool
from tests.helpers.paths import ROOT

HEAVY = ("numpy", "scipy", "numba", "mcap", "rosbags", "pydantic", "click", "rich", "matplotlib")
NAMES = [name for name in sinstool.__all__ if name != "__version__"]
# Their docstrings are those of the rooms they come from
ELSEWHERE = ("coning", "SinstoolError")


def public():
    """Functions and classes of the API, and the public methods that are written for it."""
    for name in NAMES:
        value = getattr(sinstool, name)
        if name in ELSEWHERE:
            continue
        yield name, value
        if inspect.isclass(value):
            for key, member in vars(value).items():
                if not key.startswith("_") and not isinstance(member, str):
                    member = getattr(member, "fget", None) or getattr(member, "__func__", member)
                    if inspect.isfunction(member):
                        yield f"{name}.{key}", member
    simulated = type(sinstool.simulate("static", duration=1.0))
    yield "Simulated", simulated


def test_import_brings_nothing_heavy_along(capsys):
    script = (
        "import sys, time; begin = time.perf_counter(); import sinstool;"
        " print(1e3 * (time.perf_counter() - begin));"
        f" print(*[name for name in {HEAVY} if name in sys.modules])"
    )
    out = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    spent, heavy = out.split("\n")[:2]
    with capsys.disabled():
        print(f"\nimport sinstool: {float(spent):.1f} ms")
    assert heavy == ""


def test_all_names_are_there_and_no_others():
    assert sorted(NAMES) == sorted(sinstool._HOMES)
    assert set(sinstool.__all__) <= set(dir(sinstool))
    assert 12 <= len(NAMES) <= 16
    with pytest.raises(AttributeError, match="no attribute 'proces'"):
        _ = sinstool.proces
    assert (ROOT / "sinstool" / "py.typed").exists()


def test_a_room_does_not_hide_a_function():
    script = (
        "import sinstool.survey.imu, sinstool; from sinstool.survey import grade;"
        " print(callable(sinstool.survey), sinstool.process.__module__, grade.__name__)"
    )
    out = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    assert out.split() == ["True", "sinstool.api.process", "sinstool.survey.grade"]


def test_docstrings_name_every_parameter_and_what_is_raised():
    seen = 0
    for name, value in public():
        text = inspect.getdoc(value) or ""
        assert text, name
        if inspect.isclass(value):
            continue
        signature = inspect.signature(value)
        for parameter in signature.parameters.values():
            if parameter.name in ("self", "cls"):
                continue
            stars = "*" * (parameter.kind - 2) if parameter.kind in (2, 4) else ""
            stars = {inspect.Parameter.VAR_KEYWORD: "**"}.get(parameter.kind, stars)
            assert re.search(rf"^{re.escape(stars + parameter.name)}\b", text, re.MULTILINE), (
                f"{name}: {parameter.name}"
            )
        if "." not in name:
            seen += 1
            assert "Returns\n---" in text and "Raises\n---" in text, name
            assert "Examples\n---" in text, name
    assert seen >= 9


# What takes more than a few seconds
LONG = ("navigate", "calibrate_hse", "compare_coning")


def run_examples(name, value, monkeypatch):
    monkeypatch.chdir(ROOT)
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    runner = doctest.DocTestRunner(optionflags=flags)
    tests = doctest.DocTestFinder(recurse=False).find(value, name, globs={})
    for test in tests:
        said = []
        runner.run(test, out=said.append)
        assert not runner.failures, "".join(said)
    return runner.tries


@pytest.mark.parametrize("name", [name for name, _ in public() if name not in LONG])
def test_examples_run(name, monkeypatch):
    value = dict(public())[name]
    assert not isinstance(value, ModuleType)
    tries = run_examples(name, value, monkeypatch)
    text = inspect.getdoc(value)
    assert tries or ">>>" not in text


@pytest.mark.slow
@pytest.mark.parametrize("name", LONG)
def test_long_examples_run(name, monkeypatch):
    assert run_examples(name, getattr(sinstool, name), monkeypatch) >= 2
