"""What each test runs: a plugin of pytest, for ``mutants.py``."""

from __future__ import annotations

import re
import sys
import threading
import time
from collections.abc import Generator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest
from numba.core import event

INNER = re.compile(r"\.<locals>\.<.*")


class Compiling(event.Listener):
    """CPU time that numba has compiled for; the compiler itself is not traced."""

    def __init__(self) -> None:
        self.depth, self.begun, self.seconds = 0, 0.0, 0.0
        self.trace: Any = None

    def on_start(self, _: event.Event) -> None:
        if not self.depth:
            self.begun = time.process_time()
            self.trace = sys.gettrace()
            sys.settrace(None)
        self.depth += 1

    def on_end(self, _: event.Event) -> None:
        self.depth -= 1
        if not self.depth:
            self.seconds += time.process_time() - self.begun
            sys.settrace(self.trace)


class Reached:
    """Records the functions that each test runs, in fixtures and at its file's import too.

    Attributes
    ----------
    tests : dict
        By node ID: functions (paths below the root, names), CPU time without compilation in s.
    failed : list of str
        Node IDs.
    """

    def __init__(self, root: Path) -> None:
        self.root = f"{root}/"
        self.tests: dict[str, dict[str, Any]] = {}
        self.failed: list[str] = []
        self.compiling = Compiling()
        event.register("numba:compile", self.compiling)
        self.now: set[CodeType] = set()
        self.of_fixtures: dict[Any, set[CodeType]] = {}
        self.of_files: dict[str, set[CodeType]] = {}
        sys.settrace(self._called)
        threading.settrace(self._called)

    def _called(self, frame: FrameType, *_: Any) -> None:
        self.now.add(frame.f_code)

    @pytest.hookimpl(wrapper=True)
    def pytest_make_collect_report(self, collector: pytest.Collector) -> Generator[Any, Any, Any]:
        outer, self.now = self.now, set()
        report = yield
        self.of_files[collector.nodeid] = self.now
        self.now = outer
        return report

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Generator[Any, Any, Any]:
        outer, self.now = self.now, set()
        try:
            return (yield)
        finally:
            self.of_fixtures[fixturedef] = self.now
            self.now = outer

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: Any) -> Generator[Any, Any, Any]:
        if sys.gettrace() is None:
            sys.settrace(self._called)
        self.now = set()
        begun, compiled = time.process_time(), self.compiling.seconds
        result = yield
        seconds = time.process_time() - begun - (self.compiling.seconds - compiled)
        self.tests[item.nodeid]["seconds"] = seconds
        return result

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: Any, call: Any) -> Generator[Any, Any, Any]:
        report = yield
        if report.failed:
            self.failed.append(item.nodeid)
        if call.when == "call" or (call.when == "setup" and not report.passed):
            codes = self.now | self.of_files.get(item.nodeid.partition("::")[0], set())
            for fixture in item._request._fixture_defs.values():
                codes |= self.of_fixtures.get(fixture, set())
            self.tests[item.nodeid] = {"functions": sorted(self._ours(codes))}
        return report

    def _ours(self, codes: set[CodeType]) -> set[tuple[str, str]]:
        return {
            (code.co_filename.removeprefix(self.root), INNER.sub("", code.co_qualname))
            for code in codes
            if code.co_filename.startswith(self.root)
        }
