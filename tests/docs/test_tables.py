"""Tables of the documentation that list what the program has."""

from __future__ import annotations

import re

from sinstool.config.logs import EMITS
from sinstool.io.writers.solution import DIAGNOSTICS_TYPE, TOPICS, topic_of
from tests.docs.examples import ROOT

PROGRAM = re.compile(r"^\| `(\w+\.py)\b", re.MULTILINE)


def test_every_topic_that_can_be_written_is_in_the_table():
    text = (ROOT / "docs" / "formats.md").read_text()
    rows = re.findall(r"^\| `(\w+)` \| `(/[\w/]+)` \| (\w+/\w+) \|", text, re.MULTILINE)
    types = {name: topic.type_name for name, topic in TOPICS.items()}
    types["diagnostics"] = DIAGNOSTICS_TYPE
    wanted = {name: (topic_of(name), types[name].replace("/msg/", "/")) for name in EMITS}
    assert {name: (topic, kind) for name, topic, kind in rows} == wanted


def test_every_benchmark_is_in_the_table():
    folder = ROOT / "benchmarks"
    listed = PROGRAM.findall((folder / "README.md").read_text())
    programs = [p.name for p in folder.glob("*.py") if '__name__ == "__main__"' in p.read_text()]
    assert sorted(listed) == sorted(programs)
