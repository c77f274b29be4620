"""Tables of the documentation that list what the program has."""

from __future__ import annotations

import ast
import re
from typing import get_args

import pytest

from sinstool.config.logs import EMITS
from sinstool.core.units import DEGREE_PER_HOUR, DEGREE_PER_ROOT_HOUR, MICRO_G, MILLI_G
from sinstool.io.writers.solution_topics import DIAGNOSTICS_TYPE, TOPICS, topic_of
from sinstool.methods.ins_gnss.states import FilterName
from sinstool.methods.sensor_errors import SIMULATED_GRADES
from sinstool.simulation.scenarios import MotionScenario
from tests.docs.examples import ROOT

PROGRAM = re.compile(r"^\| `(\w+\.py)\b", re.MULTILINE)


def test_every_topic_that_can_be_written_is_in_the_table():
    text = (ROOT / "docs" / "formats.md").read_text()
    rows = re.findall(r"^\| `(\w+)` \| `(/[\w/]+)` \| (\w+/\w+) \|", text, re.MULTILINE)
    types = {name: topic.type_name for name, topic in TOPICS.items()}
    types["diagnostics"] = DIAGNOSTICS_TYPE
    expected = {name: (topic_of(name), types[name].replace("/msg/", "/")) for name in EMITS}
    assert {name: (topic, kind) for name, topic, kind in rows} == expected


def test_simulated_grades_have_the_errors_of_the_table():
    text = (ROOT / "docs" / "commands" / "simulate.md").read_text()
    head, *rows = (
        [cell.strip(" `") for cell in line.split("|")[1:-1]]
        for line in re.findall(r"^\|.*\|$", text[text.index("| `--grade` |") :], re.MULTILINE)[:13]
        if "---" not in line
    )
    names = {
        "angular random walk": ("angle_random_walk", DEGREE_PER_ROOT_HOUR),
        "accelerometer noise": ("velocity_random_walk", MICRO_G),
        "gyro bias": ("gyro_bias", DEGREE_PER_HOUR),
        "accelerometer bias": ("accel_bias", MILLI_G),
        "gyro bias that wanders": ("gyro_instability", DEGREE_PER_HOUR),
        "accelerometer bias that wanders": ("accel_instability", MILLI_G),
        "correlation time of both": ("bias_time_s", 1.0),
        "gyro scale factor": ("gyro_scale", 1e-6),
        "accelerometer scale factor": ("accel_scale", 1e-6),
        "misalignment of each axis of the gyros": ("gyro_misalignment", 1e-6),
        "misalignment of each axis of the accelerometers": ("accel_misalignment", 1e-6),
    }
    assert {*head[1:]} == {*get_args(MotionScenario.model_fields["grade"].annotation)} - {"perfect"}
    assert {row[0].rpartition(",")[0] for row in rows} == {*names}
    for title, *values in rows:
        name, unit = names[title.rpartition(",")[0]]
        for grade, value in zip(head[1:], values, strict=True):
            assert getattr(SIMULATED_GRADES[grade], name) == pytest.approx(float(value) * unit)


def test_every_benchmark_is_in_the_table():
    folder = ROOT / "benchmarks"
    listed = PROGRAM.findall((folder / "README.md").read_text())
    programs = [p.name for p in folder.glob("*.py") if '__name__ == "__main__"' in p.read_text()]
    assert sorted(listed) == sorted(programs)


def test_every_file_that_the_documentation_names_is_there():
    place = re.compile(r"`((?:sinstool|tests|benchmarks|docs|sample_data)/[\w/.-]+)`")
    pages = [*(ROOT / "docs").rglob("*.md"), ROOT / "README.md", ROOT / "benchmarks" / "README.md"]
    named = {(page.name, name) for page in pages for name in place.findall(page.read_text())}
    assert len(named) > 10
    assert [pair for pair in sorted(named) if not (ROOT / pair[1]).exists()] == []


def kinds_of_findings():
    """Kinds that the code gives findings by name, and all its strings."""
    named, strings = set(), set()
    for path in (ROOT / "sinstool").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                strings.add(node.value)
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.args:
                kind = node.args[0]
                makes = node.func.id in ("Finding", "note", "warned", "_counted")
                if makes and isinstance(kind, ast.Constant):
                    named.add(kind.value)
    return named, strings


def test_every_kind_of_finding_is_in_the_table():
    text = (ROOT / "docs" / "findings.md").read_text()
    rows = re.findall(r"^\| (`[^|]*) \|", text, re.MULTILINE)
    listed = [kind for row in rows for kind in re.findall(r"`([\w-]+)`", row)]
    named, strings = kinds_of_findings()
    assert len(named) > 100
    assert named - set(listed) == set()
    assert len(listed) == len(set(listed))
    made = {f"{status}-axis" for status in ("dead", "clipped", "too-short")}  # of a status
    assert set(listed) - strings - made == set()


def test_every_filter_is_in_the_glossary():
    text = (ROOT / "docs" / "glossary.md").read_text()
    assert [name for name in get_args(FilterName) if f"`{name}`" not in text] == []
