import hashlib
import signal
import sys
import threading
import time

import pytest
from hypothesis import settings

from sinstool.cli import main as main_module
from tests.helpers import compiled
from tests.helpers.paths import ROOT

BEGUN = time.monotonic()

# The first call of a compiled loop takes seconds; a deadline would call that a failure. All runs
# have the same examples, so that a change is refused for what it does, not by chance: others come
# with --hypothesis-profile random.
settings.register_profile("same", deadline=None, derandomize=True)
settings.register_profile("random", deadline=None)
settings.load_profile("same")

# Where the tests run in the background or under nohup, these are ignored, and commands that the
# tests start would ignore them too.
if threading.current_thread() is threading.main_thread():
    for name, usual in (("SIGINT", signal.default_int_handler), ("SIGHUP", signal.SIG_DFL)):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, usual)


def pytest_addoption(parser):
    parser.addoption(
        "--seconds",
        type=float,
        default=float("inf"),
        help="Skip the tests that have not begun after so many seconds.",
    )

    parser.addoption(
        "--order",
        metavar="TEXT",
        help="Run the files in an order that this text decides, so that runs with other texts leave"
        " other tests without time.",
    )


def pytest_collection_modifyitems(config, items):
    text = config.getoption("order")
    if text is not None:
        items.sort(key=lambda item: hashlib.sha256(f"{text}{item.path}".encode()).digest())


def pytest_runtest_setup(item):
    if time.monotonic() - BEGUN > item.config.getoption("seconds"):
        pytest.skip("no time was left for it (--seconds)")


def pytest_sessionstart(session):
    """Fill numba's cache before the workers of a whole run begin, where a source has changed."""
    config = session.config
    whole = config.args_source == pytest.Config.ArgsSource.TESTPATHS
    if not whole or not config.getoption("numprocesses", None) or hasattr(config, "workerinput"):
        return
    newest = max(path.stat().st_mtime_ns for path in (ROOT / "sinstool").rglob("*.py"))
    if config.cache.get("sinstool/compiled", 0) != newest:
        compiled.main()
        config.cache.set("sinstool/compiled", newest)


@pytest.fixture
def sinstool(monkeypatch, capsys):
    """Runs the command line in this process: status, stdout, stderr."""

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["sinstool", *map(str, arguments)])
        with pytest.raises(SystemExit) as info:
            main_module.main()
        out, err = capsys.readouterr()
        assert "Traceback" not in err
        return info.value.code, out, err

    return call
