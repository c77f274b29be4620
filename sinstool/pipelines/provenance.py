"""Provenance of an output: the MCAP Metadata record ``sinstool``.

A log's result is a function of the log, the configuration and the version; the record holds all
three, so that a later run can tell whether an output is the one it would make itself.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Iterable, Mapping
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any

from mcap.exceptions import McapError

from sinstool.config import ProcessConfig
from sinstool.config.load import dump_toml
from sinstool.core import version
from sinstool.core.errors import OutputError
from sinstool.core.finding import Finding, Severity
from sinstool.core.result import as_json
from sinstool.io.readers.log import path_size
from sinstool.methods.coning.registry import origin

if TYPE_CHECKING:
    from sinstool.pipelines.process.travel import Travel

RECORD = "sinstool"
HASH_BYTES = 2**20


def identity(config: ProcessConfig) -> dict[str, str]:
    """Version and configuration as an output records them.

    Files that the configuration names are in it with their SHA-256, as the same name may hold
    something else tomorrow, and the coning algorithm of a plug-in with the plug-in's version. What
    does not bear on the content is left out: whether an output may be replaced, and the page of
    figures.
    """
    output = config.output.model_copy(update={"overwrite": False, "report": None})
    effective = config.model_copy(update={"output": output})
    unused = ["comparison", "export"]
    if config.hse.hse is None:
        unused.append("calibration")
    record = {"version": version.VERSION, "config": dump_toml(effective, *unused)}
    if plugin := origin(config.coning.coning):
        record["coning_from"] = plugin
    for name, path in files(config).items():
        record[f"{name}_sha256"] = sha256(path)
    return record


def figures_of(travel: Travel, findings: Iterable[Finding]) -> dict[str, str]:
    """Figures of a run for a table over many logs, as an output records them.

    Only the kinds of findings are in it: their texts may have names of folders.
    """
    kinds = dict.fromkeys(f.kind for f in findings if f.severity > Severity.NOTE)
    shown = {
        name: value if value is None else float(f"{value:.9g}")
        for name, value in as_json(travel).items()
        if not isinstance(value, dict)
    }
    return {"travel": json.dumps(shown), "findings": json.dumps(list(kinds))}


def read_figures(record: Mapping[str, str]) -> dict[str, Any]:
    """``travel``, and the ``kinds`` of findings, of a record; empty for one that has none."""
    if "travel" not in record or "findings" not in record:
        return {}
    try:
        return {"travel": json.loads(record["travel"]), "kinds": json.loads(record["findings"])}
    except (ValueError, RecursionError):  # damaged
        return {}


def files(config: ProcessConfig) -> dict[str, Path]:
    """Files on whose content a result depends, as far as they are there, by option."""
    named = {
        "hse": config.hse.hse,
        "imu_noise": config.navigation.imu_noise,
        "gyro_response": config.coning.gyro_response,
    }
    return {k: Path(v) for k, v in named.items() if v is not None and Path(v).is_file()}


def read_record(path: Path) -> dict[str, str] | None:
    """The record of an MCAP, None for a file that has none or is no whole MCAP."""
    from mcap.reader import SeekingReader

    try:
        with path.open("rb") as stream:
            values = None
            for record in SeekingReader(stream).iter_metadata():
                if record.name == RECORD:
                    values = dict(record.metadata)
            return values
    except (OSError, McapError, struct.error, ValueError, KeyError, EOFError, MemoryError):
        return None


def require_same(path: Path, log: Path, config: ProcessConfig) -> dict[str, str]:
    """The record of an output that this version would make of a log in the same way.

    Parameters
    ----------
    path : Path
        The output.

    Raises
    ------
    OutputError
        It says in what the output is another.
    """
    record = read_record(path)
    hint = "choose another -o, or replace it with --overwrite"
    if record is None or "input_sha256" not in record:
        raise OutputError(f"{path} exists and is no complete output of sinstool process", hint)
    here = identity(_as_made(config, record))
    if record.get("version") != here["version"]:
        raise OutputError(
            f"{path} was made by sinstool {record.get('version')}, this is {here['version']}", hint
        )
    for key, value in here.items():
        if record.get(key) != value:
            what = _difference(record.get("config", ""), value) if key == "config" else key
            raise OutputError(f"{path} was made with another configuration ({what})", hint)
    if record.get("input_size") != str(path_size(log)) or record["input_sha256"] != sha256(log):
        raise OutputError(f"{path} was made of another log than {log} is now", hint)
    return record


def _as_made(config: ProcessConfig, record: Mapping[str, str]) -> ProcessConfig:
    """A configuration with the ``--salvage`` of an output, where it made no difference to it.

    Without the option a damaged log is refused, so an output made so is of a whole log; with it,
    one from which nothing was lost.
    """
    salvage = not config.input.salvage
    if salvage and record.get("status") != "done":
        return config
    other = config.model_copy(
        update={"input": config.input.model_copy(update={"salvage": salvage})}
    )
    return other if identity(other)["config"] == record.get("config") else config


def _difference(there: str, here: str) -> str:
    """The first line of a configuration that only one of them has."""
    old, new = set(there.splitlines()), set(here.splitlines())
    for line in here.splitlines():
        if line not in old and "=" in line:
            return f"now {line}"
    for line in there.splitlines():
        if line not in new and "=" in line:
            return f"there {line}"
    return "config"


def sha256(path: Path, stop: Event | None = None) -> str:
    """SHA-256 of a log; stops early when ``stop`` is set.

    Of a directory: of the lines ``<sha256>  <relative name>`` of its files, sorted by name.
    """
    if path.is_dir():
        names = sorted(p.relative_to(path).as_posix() for p in path.rglob("*") if p.is_file())
        listing = "".join(f"{sha256(path / name, stop)}  {name}\n" for name in names)
        return hashlib.sha256(listing.encode()).hexdigest()
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while not (stop and stop.is_set()) and (part := stream.read(HASH_BYTES)):
            digest.update(part)
    return digest.hexdigest()
