"""Whether an output is what would be made again."""

import hashlib

import pytest

from sinstool.config import ProcessConfig
from sinstool.core.errors import OutputError
from sinstool.pipelines import provenance


@pytest.mark.parametrize(("now", "same"), [(b"abc", True), (b"abd", False), (b"abcd", False)])
@pytest.mark.parametrize("size", ["3", "4"])
def test_an_output_of_another_log_is_not_the_same(tmp_path, monkeypatch, now, same, size):
    config, log = ProcessConfig(), tmp_path / "log.mcap"
    log.write_bytes(now)
    record = {**provenance.identity(config), "input_size": size,
              "input_sha256": hashlib.sha256(b"abc").hexdigest()}  # fmt: skip
    monkeypatch.setattr(provenance, "read_record", lambda _: record)
    if same and size == "3":
        assert provenance.require_same(tmp_path / "out.mcap", log, config) == record
        return
    with pytest.raises(OutputError, match="another log"):
        provenance.require_same(tmp_path / "out.mcap", log, config)


@pytest.mark.parametrize(
    ("made", "now", "status", "same"),
    [
        (False, True, "done", True),
        (False, True, "lost", True),  # a heading was withheld: without the option logs are whole
        (True, False, "done", True),
        (True, False, "lost", False),
    ],
)
def test_salvage_makes_no_other_output_of_a_whole_log(
    tmp_path, monkeypatch, made, now, status, same
):
    """One damaged log of a campaign needs --salvage; the outputs of the others stay complete."""
    log = tmp_path / "log.mcap"
    log.write_bytes(b"abc")

    def config(salvage):
        return ProcessConfig.model_validate({"input": {"salvage": salvage}})

    record = {**provenance.identity(config(made)), "status": status, "input_size": "3",
              "input_sha256": hashlib.sha256(b"abc").hexdigest()}  # fmt: skip
    monkeypatch.setattr(provenance, "read_record", lambda _: record)
    if same:
        assert provenance.require_same(tmp_path / "out.mcap", log, config(now)) == record
        return
    with pytest.raises(OutputError, match="salvage"):
        provenance.require_same(tmp_path / "out.mcap", log, config(now))
