"""Every command block of the README and of the documentation runs, and prints what is shown."""

from __future__ import annotations

import re
import tomllib

import pytest

from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.config.noise import SCHEMA, read_noise
from tests.docs import examples as docs
from tests.docs.examples import (
    FENCE,
    PAGES,
    ROOT,
    Example,
    alike,
    blocks,
    examples,
    missing,
    near,
    python_examples,
)

WITH_EXAMPLES = [page for page in PAGES if examples(page)]
ALL = [example for page in PAGES for example in examples(page)]

# What cannot run here, and what is not compared. More than these want a reason of their own.
NEEDS = {
    "README.md": 2,  # installs; is this very run
    "adding-an-algorithm.md": 1,  # a file that the reader writes
    "benchmarks.md": 1,  # logs that are not part of the project
    "campaign.md": 2,  # a cluster; certificates
    "contributing.md": 1,  # installs
    "index.md": 1,  # installs
    "ins-gnss.md": 1,  # a log that is not part of the project
}
UNLIKE = {
    "compare-coning.md": 2,  # cost in ns; tests/cli/test_compare_coning.py compares the rest
    "vertical-channel.md": 1,  # printed by a command further up, in more runs than a test has
}


def name_of(page):
    return str(page.relative_to(ROOT)).removeprefix("docs/")


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_EXAMPLES, ids=name_of)
def test_commands_run_and_print_what_is_shown(page, tmp_path):
    folder = docs.scratch(tmp_path)
    for example in examples(page):
        if example.needs:
            continue
        where = f"{name_of(page)}:{example.line}"
        status, out, err = docs.run(example, folder)
        assert status == example.status, (
            f"{where}: status {status}\n{example.script}\n{err[-2000:]}"
        )
        assert "Traceback" not in err, f"{where}: {err}"
        if example.shown is not None and not example.unlike and not example.short:
            absent = missing(example.shown, out)
            assert not absent, f"{where} did not print\n" + "\n".join(absent) + f"\nbut\n{out}"


def test_hardly_any_command_is_left_out():
    counts = {}
    for example in ALL:
        if example.needs:
            name = name_of(example.page)
            counts[name] = counts.get(name, 0) + 1
            print(f"{name}:{example.line} is not run: it needs {example.needs}")
            assert len(example.needs) > 8
    assert counts == NEEDS
    assert len(ALL) > 40


def test_hardly_any_output_is_not_compared():
    counts = {}
    for example in ALL:
        if example.unlike:
            counts[name_of(example.page)] = counts.get(name_of(example.page), 0) + 1
    assert counts == UNLIKE


def test_every_block_has_a_known_language():
    for page in PAGES:
        for language, text, _, line in blocks(page):
            assert language in ("", "sh", "text", "toml", "python", "json"), f"{page}:{line}"
            assert language or page.name == "README.md", f"{page}:{line}: say which language"
            assert text.strip()


def test_toml_is_a_configuration_or_a_noise_file(tmp_path):
    seen = 0
    for page in PAGES:
        for language, text, _, line in blocks(page):
            if language == "toml":
                seen += 1
                if text.startswith(f'schema = "{SCHEMA}"'):
                    (tmp_path / "noise.toml").write_text(text)
                    assert read_noise(tmp_path / "noise.toml").gyro
                    continue
                build(ProcessConfig, tomllib.loads(text), f"{name_of(page)}:{line}")
    assert seen >= 1


WITH_PYTHON = [page for page in PAGES if python_examples(page)]


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_PYTHON, ids=name_of)
def test_python_runs_and_prints_what_is_shown(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(docs.scratch(tmp_path))
    monkeypatch.setenv("MPLBACKEND", "Agg")
    # one session, as in a notebook
    names = {"__name__": "example"}
    for line, code, shown in python_examples(page):
        where = f"{name_of(page)}:{line}"
        exec(compile(code, where, "exec"), names)
        printed = capsys.readouterr().out
        absent = missing(shown, printed)
        assert not absent, f"{where} did not print\n" + "\n".join(absent) + f"\nbut\n{printed}"
        assert bool(shown) == bool(printed), f"{where}: what is printed is not shown, or not all"


def test_commands_are_not_hidden_in_indented_text():
    for page in PAGES:
        text = FENCE.sub("", page.read_text())
        assert not re.findall(r"^ {4,}(?:sinstool|python) .*$", text, re.MULTILINE), page


@pytest.mark.parametrize(
    ("documented", "printed", "same"),
    [
        ("sigma 0.453 deg", "sigma 0.4534 deg", True),
        ("sigma 0.453 deg", "sigma 0.46 deg", False),
        ("sigma 0.453 deg", "sigma 0.453 rad", False),
        ("12 runs", "13 runs", False),
        ("v 1.5e-08 m", "v 1.6e-08 m", True),
        ("v 1.5e-08 m", "v 1.9e-08 m", False),
        ("roll -0.000", "roll 0.000", True),
        ("a b ...", "a b 17 c", True),
        ("a 1.5 ... z", "a 1.9 and z", True),
        ("a b ...", "a c 17 c", False),
        ("/imu/x-1: 3", "/imu/x-2: 3", False),
    ],
)
def test_lines_are_compared_by_words_and_numbers(documented, printed, same):
    assert alike(documented, printed) is same


def test_lines_are_looked_for_in_order():
    assert missing("a 1.0\n\nb 2\n", "x\na   1.001\ny\nb 2\n") == []
    assert missing("b 2\na 1.0\n", "a 1.0\nb 2\n") == ["a 1.0"]
    assert near("1e-3", "0.001") and not near("3", "4")


def test_options_are_added_to_the_command_that_is_named(tmp_path):
    text = "sinstool simulate drive \\\n    -o d.mcap\nsinstool info d.mcap > x\n"
    example = Example(tmp_path, 1, text, added=(("sinstool simulate", "--duration 9"),))
    assert example.script.split("\n")[1].strip() == "-o d.mcap --duration 9" or docs.WHOLE
