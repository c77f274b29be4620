"""Examples in the README and the documentation: found, run in order, and held to what is shown."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

from tests.helpers.paths import ROOT

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
SHELL = ("", "sh", "bash")
WHOLE = os.environ.get("SINSTOOL_EXAMPLES") == "whole"

# What an example may find beside it.
BESIDE = ("sample_data", "benchmarks", "tests", "docs", "docsite", "mkdocs.yml", "README.md")

FENCE = re.compile(
    r"(?:^<!-- (?P<mark>(?:example|output): [^>]*|tests) -->\n)?"
    r"^```(?P<language>[\w+-]*)\n(?P<body>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
NUMBER_IN_RE = re.compile(r"(?<![\w.])(?:\\[-+])?\d+(?:\\\.\d+)?(?:e(?:\\[-+])?\d+)?")
# The README's commands make their own environment first; a test has one.
INSTALL = re.compile(r"python3 -m venv \.venv && \.venv/bin/pip install --quiet \S+ && ")


@dataclass(frozen=True)
class Example:
    """A block of commands, and what is shown below it.

    Attributes
    ----------
    page : Path
    line : int
        Of its first command.
    text : str
    needs : str
        What it needs that no test has; '' where it can run.
    added : tuple of (str, str)
        Options that make a command short enough for a test.
    status : int
        With which the last command ends.
    shown : str or None
        What it prints; None where nothing is shown.
    unlike : str
        Why what is shown is not compared; '' where it is.
    """

    page: Path
    line: int
    text: str
    needs: str = ""
    added: tuple[tuple[str, str], ...] = ()
    status: int = 0
    shown: str | None = None
    unlike: str = ""

    @property
    def short(self) -> bool:
        """Whether less than what is written runs."""
        return bool(self.added) and not WHOLE

    @property
    def script(self) -> str:
        """What bash is given."""
        text = INSTALL.sub("", self.text).replace(".venv/bin/", "")
        if self.short:
            for command, options in self.added:
                # to the command's last line, where it goes on over several
                pattern = re.compile(rf"^{re.escape(command)}(?:.*\\\n)*[^\n|>]*", re.MULTILINE)
                text, n = pattern.subn(lambda m, o=options: f"{m[0].rstrip()} {o} ", text)
                assert n, f"{self.page}:{self.line}: there is no '{command}'"
        return text


def blocks(page: Path) -> list[tuple[str, str, str, int]]:
    """Language, text, comment above, and line of each fenced block."""
    text = page.read_text()
    return [
        (m["language"], m["body"], m["mark"] or "", text.count("\n", 0, m.start("body")) + 1)
        for m in FENCE.finditer(text)
    ]


def examples(page: Path) -> list[Example]:
    """The command blocks of a page, each with the output below it."""
    listed: list[Example] = []
    for language, body, mark, line in blocks(page):
        kind, _, note = mark.partition(": ")
        if language in SHELL:
            needs, added, status = "", (), 0
            if mark == "tests":
                needs = "nothing but is this very run"
            elif note.startswith("needs "):
                needs = note.removeprefix("needs ")
            elif note.startswith("status "):
                status = int(note.removeprefix("status "))
            elif note:
                added = tuple(tuple(part.split(" with ", 1)) for part in note.split("; "))
                assert all(len(part) == 2 for part in added), f"{page}:{line}: {mark}"
            listed.append(Example(page, line, body, needs, added, status))
        elif language == "text" and listed and listed[-1].shown is None:
            unlike = note if kind == "output" else ""
            listed.append(replace(listed.pop(), shown=body, unlike=unlike))
    return listed


def python_examples(page: Path) -> list[tuple[int, str, str]]:
    """Line and text of each Python block, and what is shown right below it ('' for nothing)."""
    text = page.read_text()
    listed: list[tuple[int, str, str]] = []
    end = -1
    for m in FENCE.finditer(text):
        if m["language"] == "python":
            listed.append((text.count("\n", 0, m.start("body")) + 1, m["body"], ""))
            end = m.end()
        elif m["language"] == "text" and end >= 0 and not text[end : m.start()].strip():
            listed[-1] = (*listed[-1][:2], m["body"])
    return listed


def scratch(folder: Path) -> Path:
    """A folder with what examples may find beside them."""
    for name in BESIDE:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(
                source, folder / name, ignore=shutil.ignore_patterns("__pycache__", "*.part")
            )
        else:
            shutil.copy(source, folder / name)
    return folder


def run(example: Example, folder: Path) -> tuple[int, str, str]:
    """Exit status, stdout and stderr of an example."""
    here = str(Path(sys.executable).parent)
    done = subprocess.run(
        ["bash", "-e", "-o", "pipefail", "-c", example.script],
        cwd=folder,
        env=os.environ | {"PATH": f"{here}{os.pathsep}{os.environ['PATH']}", "COLUMNS": "120"},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
    )
    return done.returncode, done.stdout, done.stderr


def missing(shown: str, printed: str) -> list[str]:
    """Lines that are shown and were not printed, in their order.

    ``...`` at the beginning, the end or in the middle of a line stands for anything.
    """
    lines = [" ".join(line.split()) for line in printed.splitlines()]
    at, absent = 0, []
    for line in shown.splitlines():
        expected = " ".join(line.split())
        if expected in ("", "..."):
            continue
        for k in range(at, len(lines)):
            if alike(expected, lines[k]):
                at = k + 1
                break
        else:
            absent.append(line)
    return absent


def alike(expected: str, printed: str) -> bool:
    """Whether two lines have the same words, and numbers that are nearly the same."""
    parts = expected.split("...")
    if len(parts) == 1:
        return _alike(expected, printed)
    # Where there are holes numbers must only be numbers.
    pattern = ".*".join(NUMBER_IN_RE.sub(r"[-+.\\deE]+", re.escape(part)) for part in parts)
    return re.fullmatch(pattern, printed) is not None


def _alike(expected: str, printed: str) -> bool:
    if NUMBER.sub("#", expected).split() != NUMBER.sub("#", printed).split():
        return False
    pairs = zip(NUMBER.findall(expected), NUMBER.findall(printed), strict=True)
    return all(near(a, b) for a, b in pairs)


def near(expected: str, printed: str) -> bool:
    """Within 1 %, or one and a half of the last digit shown; integers the same."""
    a, b = float(expected), float(printed)
    if re.fullmatch(r"[-+]?\d+", expected):
        return a == b
    mantissa, _, exponent = expected.lower().partition("e")
    digits = len(mantissa.partition(".")[2])
    last = 10.0 ** (int(exponent or 0) - digits)
    return abs(a - b) <= max(0.01 * abs(a), 1.5 * last)
