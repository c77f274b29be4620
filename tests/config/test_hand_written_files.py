"""Files that people write by hand, when they are none: too long, too deep, no text."""

import os
import threading

import pytest

from sinstool.config import ProcessConfig
from sinstool.config.load import build, load_toml
from sinstool.config.noise import read_noise
from sinstool.core.errors import ConfigurationError
from sinstool.core.small_file import MOST, read_text
from sinstool.methods.coning.gyro_response import gyro_response
from sinstool.pipelines.calibrate_hse.calibration_file import loads

DEPTHS = (100, 900, 3000)


@pytest.mark.parametrize("read", [load_toml, read_noise, read_text])
def test_a_file_that_never_ends_is_refused(tmp_path, read):
    path = tmp_path / "endless.toml"
    path.symlink_to("/dev/zero")
    with pytest.raises(ConfigurationError, match=r"endless\.toml.*longer than the 1 MiB"):
        read(path)


def test_the_longest_file_is_read(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text("#" * MOST)
    assert load_toml(path) == {}
    path.write_text("#" * (MOST + 1))
    with pytest.raises(ConfigurationError, match="longer"):
        load_toml(path)


def test_a_pipe_is_read_as_a_shell_gives_it(tmp_path):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    writer = threading.Thread(target=path.write_text, args=("[input]\n",))
    writer.start()
    assert load_toml(path) == {"input": {}}
    writer.join()


def test_the_mark_with_which_editors_of_windows_begin_is_none_of_the_text(tmp_path):
    path = tmp_path / "a.toml"
    path.write_bytes(b"\xef\xbb\xbf[input]\r\nstart = 5\r\n")
    assert load_toml(path) == {"input": {"start": 5}}


NESTED = {
    "open lists": lambda depth: "a=" + "[" * depth,
    "lists": lambda depth: f"a={'[' * depth}{']' * depth}",
    "tables": lambda depth: "a={b=" * depth,
    "keys": lambda depth: "a." * depth + "a=1",
    "a value": lambda depth: f"[input]\nstart={'[' * depth}{']' * depth}",
}


@pytest.mark.parametrize("depth", DEPTHS)
@pytest.mark.parametrize("kind", NESTED)
def test_deeply_nested_toml_is_refused_in_one_line(tmp_path, kind, depth):
    path = tmp_path / "deep.toml"
    path.write_text(NESTED[kind](depth))
    with pytest.raises(ConfigurationError, match=r"deep\.toml"):
        build(ProcessConfig, load_toml(path), str(path))


@pytest.mark.parametrize("depth", DEPTHS)
@pytest.mark.parametrize("head", ["", '{"schema": ', '{"a": '])
def test_a_deeply_nested_calibration_is_refused_in_one_line(depth, head):
    with pytest.raises(ConfigurationError):
        loads(head + "[" * depth)
    with pytest.raises(ConfigurationError):
        loads(head + "[" * depth + "]" * depth + ("}" if head else ""))


def test_a_table_of_a_gyro_that_is_no_text_is_refused(tmp_path):
    path = tmp_path / "gyro.txt"
    path.write_bytes(b"\xff\xfe\n")
    with pytest.raises(ConfigurationError, match="not text"):
        gyro_response(str(path))
