"""The command line in the tests' own process."""

import sys

import pytest

from sinstool.cli import main as main_module


@pytest.fixture
def sinstool(monkeypatch, capsys):
    """Runs the command line in this process: status, stdout, stderr."""

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["sinstool", *map(str, arguments)])
        with pytest.raises(SystemExit) as info:
            main_module.main()
        out, err = capsys.readouterr()
        return info.value.code, out, err

    return call
